"""The state behind the page: the film in view, its settings, the detector of one frame, and the run."""

from __future__ import annotations

import json
import secrets
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from synthcam_shared.errors import InputError
from synthcam_shared.outputs import check_writable, write_atomically
from synthcam_shared.settings import build_settings
from tracker.app.film_view import FilmView
from tracker.app.frame_detector import PreparedDetector, list_balls, prepare_detector
from tracker.app.run_settings import RunPlan, RunSettings, join_words, make_plan, name_as_argument
from tracker.app.track_process import TrackProcess
from tracker.camera.camera_json import read_source
from tracker.camera.frames import GREY
from tracker.camera.recordings import RecordingSource
from tracker.report.estimates_text import (
    METHODS,
    describe_recommendation,
    describe_status,
    list_quantities,
    order_methods,
    rows_as_dicts,
)
from tracker.results import finite

MAX_COLLISIONS = 20  # whose numbers the page lists; the report has all
MAX_POSITIONS = 200_000  # of tracks that the page draws
QUANTITIES = ("v0", "b", "r", "mu_k", "C", "tau1", "tau2", "energy_fraction", "momentum_fraction")


@dataclass(frozen=True)
class DetectorStatus:
    """How far the preparation of the detector is: state "preparing", "ready" or "failed"."""

    state: str = "preparing"
    name: str = ""
    point: str = ""
    channel: str = ""
    seconds: float = 0.0
    notes: tuple[str, ...] = ()
    error: str = ""


class Workbench:
    """One page's work on one source. Methods may be called from any thread."""

    def __init__(self, source: RecordingSource, folder: Path | None = None) -> None:
        beside = source.path.resolve()
        self.source = source
        self.folder = (folder or beside.with_name(f"{beside.stem}_workbench")).absolute()
        if self.folder.exists() and not self.folder.is_dir():
            raise InputError(f"{self.folder}: a file, expected a folder for the results")
        if beside.is_dir() and beside in (self.folder, *self.folder.parents):
            raise InputError(f"{self.folder}: lies in {source.path}, expected a folder outside it")
        self.process = TrackProcess(self._hear_process)
        self.report_key = secrets.token_urlsafe(24)  # part of the addresses of reports
        self.made: set[int] = set()  # numbers of the runs of this session
        self.version = 0  # grows with every change of detector and run
        self.detector: PreparedDetector | None = None
        self.detector_status = DetectorStatus()
        self._mark = ""  # what the detector depends on
        self._lock = threading.RLock()
        self._wake = threading.Event()
        self._closed = self._prepared_before = False
        self.open_clip(0)
        self._worker = threading.Thread(target=self._prepare_always, daemon=True)
        self._worker.start()

    def close(self) -> None:
        """End the run, if one is under way, and the preparation."""
        self._closed = True
        self._wake.set()
        self.view.close()  # ends a pass of the detector over the film
        self.process.close()
        self._worker.join()

    def _note_change(self) -> None:
        self.version += 1

    def _hear_process(self) -> None:
        status = self.process.status
        if (status.command, status.state) == ("calibrate", "done"):
            self._take_camera(self._calibrated(status.number))
        self._note_change()

    # --- the film

    def open_clip(self, index: int) -> None:
        """Show another clip of the source, without settings. Raises InputError."""
        if not 0 <= index < len(self.source):
            raise InputError(f"clip: expected 0 to {len(self.source) - 1}, not {index}")
        if self.process.is_running:
            raise InputError("clip: a run is under way; wait for it, or cancel it")
        view = FilmView(self.source, index)
        file = replace(self.source, clips=(self.source.clips[index],)).camera_files()
        given: Mapping[str, Any] | None = read_source(file[0]) if file else None
        plan = make_plan(RunSettings(), view, given, where=f"{file[0]}" if file else "")
        with self._lock:
            self.view, self.given = view, given
            self._take(plan)

    @property
    def film(self) -> Path:
        """The film in view, as `tracker track` takes it."""
        if not self.source.dataset:
            return self.source.path
        return self.view.location.parent

    def describe(self) -> dict[str, Any]:
        """All that the page needs when it is loaded."""
        frames, view = self.view.clip.frames, self.view
        even = bool((frames.numbers == np.arange(len(frames))).all())
        return {
            "film": f"{self.film}",
            "clips": [number for number, _ in self.source.clips],
            "clip": view.index,
            "mark": view.mark,
            "frames": len(frames),
            "numbers": None if even else frames.numbers.tolist(),
            "size": view.size,
            "fps": round(frames.fps, 6),
            "channels": view.channels,
            "notes": [str(note) for note in view.clip.notes],
            "given": None if self.given is None else finite(dict(self.given)),
            "folder": f"{self.folder}",
            "settings": self.plan.settings.model_dump(),
            "plan": self.describe_plan(),
            "status": self.describe_status(),
        }

    # --- settings

    def apply(self, values: Any) -> dict[str, Any]:
        """Check settings and take them: camera.json and command line. Raises InputError."""
        settings = build_settings(values, RunSettings, "settings")
        with self._lock:
            self._take(make_plan(settings, self.view, self.given))
            return self.describe_plan()

    def describe_plan(self) -> dict[str, Any]:
        """The settings as camera.json and as a command line."""
        with self._lock:
            number, plan = self._next_number(), self.plan
            camera = self._camera_file(number) if plan.needs_file else self.source.camera
            command = join_words(plan.write_command(self.film, camera, self._results(number)))
            return {
                "camera": None if plan.keys is None else json.dumps(finite(plan.keys), indent=1),
                "camera_file": f"{camera}" if plan.needs_file else "",
                "command": command,
            }

    def _take(self, plan: RunPlan) -> None:
        """Use a plan from now on, and prepare its detector if that may differ."""
        self.plan = plan
        mark = json.dumps([plan.keys, *vars(plan.settings.options).values(), plan.settings.channel, self.view.index])
        if mark != self._mark:
            self._mark, self.detector, self.detector_status = mark, None, DetectorStatus()
            self._note_change()
            self._wake.set()

    # --- the detector of one frame

    def _prepare_always(self, *, pause_s: float = 0.3) -> None:
        """Prepare the detector of the newest settings, when they have not changed for a moment: somebody types."""
        while True:
            self._wake.wait()
            while self._wake.is_set() and not self._closed:
                self._wake.clear()
                if self._prepared_before:
                    self._wake.wait(pause_s)
            if self._closed:
                return
            with self._lock:
                mark, plan = self._mark, self.plan
            if self.detector is not None:
                continue
            began, ready, status = time.monotonic(), None, DetectorStatus("failed")
            try:
                ready = prepare_detector(plan.open_apart(), plan.settings.channel or None)
                status = DetectorStatus(
                    state="ready",
                    name=ready.name,
                    point=ready.point,
                    channel=ready.clip.channel,
                    seconds=round(time.monotonic() - began, 2),
                    notes=ready.notes,
                )
            except InputError as error:
                status = replace(status, error=f"{error}")
            except Exception as error:  # the film can still be looked at
                status = replace(status, error=f"this film cannot be searched ({type(error).__name__}: {error})")
            with self._lock:
                if mark == self._mark:
                    self.detector, self.detector_status = ready, status
                    self._prepared_before = True
                    self._note_change()

    def find_balls(self, index: int) -> dict[str, Any] | None:
        """The balls of a frame of the film; None while the detector is prepared. Raises InputError."""
        with self._lock:
            detector, numbers = self.detector, self.view.clip.frames.numbers
        if not 0 <= index < len(numbers):
            raise InputError(f"frame {index}: expected 0 to {len(numbers) - 1}")
        if detector is None:
            return None
        if detector.clip.channel == GREY:
            self.view.read(index)  # the page asks for it, too: it is decoded once
        began, own = time.monotonic(), detector.clip.frames.numbers
        row = int(np.searchsorted(own, numbers[index]))
        inside = row < len(own) and bool(own[row] == numbers[index])
        balls = list_balls(detector.detect(row)) if inside else []
        spent = round(1e3 * (time.monotonic() - began), 1)
        return {"balls": balls, "radius": detector.radius_px, "point": detector.point, "ms": spent, "read": inside}

    # --- the run

    def _next_number(self) -> int:
        """The first number without a file of an earlier run, finished, interrupted or claimed."""
        taken = {path.name.removesuffix(".partial") for path in self.folder.glob("*_*")}
        paths = ((self._command_file(n), self._camera_file(n), self._calibrated(n), self._results(n)) for n in count(1))
        names = ({path.name for path in own} for own in paths)
        return next(n for n, own in enumerate(names, 1) if not own & taken)

    def _command_file(self, number: int) -> Path:
        return self.folder / f"command_{number}.txt"

    def _camera_file(self, number: int) -> Path:
        return self.folder / f"camera_{number}.json"

    def _results(self, number: int) -> Path:
        return self.folder / f"results_{number}"

    def _calibrated(self, number: int) -> Path:
        return self.folder / f"calibrated_{number}.json"

    def start_calibration(self, values: Any) -> dict[str, Any]:
        """Start `tracker calibrate`, which measures the scale by the balls. Raises InputError.

        When it is done, its camera file becomes that of the film.
        """
        settings = build_settings(values, RunSettings, "settings")
        wanted = {"--diameter": settings.ball_diameter, "--fps": settings.fps, "--exposure": settings.exposure}
        given = self.given or {}
        wanted["--diameter"] = wanted["--diameter"] or given.get("ball_diameter")
        wanted["--fps"] = wanted["--fps"] or given.get("fps")
        if not (wanted["--diameter"] and wanted["--fps"]):
            raise InputError("calibrate: set the ball diameter and the frames a second; the balls then give the scale")
        with self._lock:
            number = self._claim_number()
            words = ["tracker", "calibrate", name_as_argument(self.film), "-o", f"{self._calibrated(number)}"]
            for name, value in wanted.items():
                words += [name, f"{value:.12g}"] if value else []
            self._start(number, words)
            return self.describe_status()

    def _take_camera(self, file: Path) -> None:
        """Use another camera file for the film, and keep the settings that it does not contain."""
        with self._lock:
            kept = self.plan.settings.model_dump(include={"balls", "region", "frames", "channel"})
            self.source, self.given = replace(self.source, camera=file), read_source(file)
            self._take(make_plan(build_settings(kept, RunSettings, "settings"), self.view, self.given, where=f"{file}"))

    def _claim_number(self) -> int:
        """The number of the next run, which no other session takes from now on. Raises InputError."""
        if self.process.is_running:
            raise InputError("run: one is under way; wait for it, or cancel it")
        check_writable(self.folder)
        self.folder.mkdir(parents=True, exist_ok=True)
        while True:
            number = self._next_number()
            with suppress(FileExistsError):
                self._command_file(number).touch(exist_ok=False)
                return number

    def _start(self, number: int, words: list[str]) -> None:
        """Start a run, and note its command beside its results."""
        write_atomically(self._command_file(number), join_words(words) + "\n")
        self.process.start(number, words)

    def start_run(self) -> dict[str, Any]:
        """Start `tracker track` with the settings of the page. Raises InputError."""
        with self._lock:
            number, plan = self._claim_number(), self.plan
            camera = self.source.camera
            if plan.needs_file:
                camera = self._camera_file(number)
                write_atomically(camera, json.dumps(finite(plan.keys), indent=1) + "\n")
            self.made.add(number)
            self._start(number, plan.write_command(self.film, camera, self._results(number)))
            return self.describe_status()

    def describe_status(self) -> dict[str, Any]:
        """State of the detector and of the run."""
        run = self.process.status
        return {
            "version": self.version,
            "detector": vars(self.detector_status),
            "run": {key: value for key, value in vars(run).items() if key != "summary"},
        }

    def describe_results(self, number: int) -> dict[str, Any]:
        """The recommended numbers of a run of this session, with their errors. Raises InputError."""
        folder = self.find_results(number)
        table = pd.read_parquet(folder / "estimates.parquet")
        return {
            "folder": f"{folder}",
            "collisions": [_describe_collision(row) for row in rows_as_dicts(table.head(MAX_COLLISIONS))],
            "more": max(len(table) - MAX_COLLISIONS, 0),
            "page": f"/report/{self.report_key}/{number}/index.html" if (folder / "index.html").is_file() else "",
        }

    def list_tracks(self, number: int) -> list[dict[str, Any]]:
        """The tracks of a run of this session, each with its frames and positions, px. Raises InputError."""
        (file,) = (self.find_results(number) / "clips").glob("*/tracks.parquet")
        table = pd.read_parquet(file, columns=["frame", "particle", "x", "y"])
        if len(table) > MAX_POSITIONS:
            raise InputError(f"tracks: {len(table)} positions, the page draws at most {MAX_POSITIONS}")
        return [
            {"particle": name, **table[table["particle"] == name][["frame", "x", "y"]].round(3).to_dict("list")}
            for name in table["particle"].unique().tolist()
        ]

    def find_results(self, number: int) -> Path:
        """The folder of a run that was made in this session. Raises InputError."""
        if number not in self.made or not (self._results(number) / "estimates.parquet").is_file():
            raise InputError(f"run {number}: not one of this page")
        return self._results(number)


def _describe_collision(row: Mapping[str, Any]) -> dict[str, Any]:
    methods = order_methods(row)
    return {
        "title": f"Collision {row['collision']}",
        "status": describe_status(row),
        "why": describe_recommendation(row),
        "method": METHODS[next(iter(methods))],
        "rows": [
            [line.quantity.plain_symbol, line.values[0], line.quantity.unit, line.quantity.meaning]
            for line in list_quantities(row, QUANTITIES)
        ],
    }
