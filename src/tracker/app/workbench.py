"""The state behind the page: the film in view, its settings, the detector of one frame, and the run."""

from __future__ import annotations

import json
import re
import secrets
import shutil
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from synthcam_shared.errors import InputError
from synthcam_shared.json_values import replace_non_finite
from synthcam_shared.outputs import check_writable, write_atomically
from synthcam_shared.settings import build_settings
from tracker.app.film_view import FilmView
from tracker.app.frame_detector import PreparedDetector, list_balls, prepare_detector
from tracker.app.mending import EditHistory
from tracker.app.opened_results import OpenedResults, SearchedResiduals, TracksAlone
from tracker.app.run_settings import (
    KnownPoints,
    RunPlan,
    RunSettings,
    join_words,
    make_plan,
    name_as_argument,
    read_run_settings,
)
from tracker.app.scene_previews import ScenePreviews
from tracker.app.track_process import RunStatus, TrackProcess
from tracker.camera.camera_json import read_source
from tracker.camera.frames import GREY
from tracker.camera.recordings import RecordingSource, open_source
from tracker.edits import EDITS, TrackEdits
from tracker.results import clip_folder

FILES_OF_RUNS = dict.fromkeys(("results", "set", "search", "made"), "") | {  # endings of the names, as results_1
    "command": ".txt", "edits": ".yaml", "camera": ".json", "calibrated": ".json", "points": ".csv", "model": ".yaml",
    "scene": ".yaml",
}  # fmt: skip
MAX_WAIT_AT_END_S = 2.0  # for the preparation of a detector, which ends with the program
OPENED = 0  # the number of the results that the session was opened with; its runs count from 1


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
    """One page's work on one source. Methods may be called from any thread.

    opened: the results that are shown at the start; their film is the source. others: results of the same set.
    """

    def __init__(
        self,
        source: RecordingSource,
        folder: Path | None = None,
        opened: OpenedResults | None = None,
        others: Sequence[Path] = (),
    ) -> None:
        shown = opened.folder if opened else source.path
        beside = shown.resolve()
        self.source = source
        self.view: FilmView
        self.has_film = not isinstance(source, TracksAlone)
        self.results = {} if opened is None else {OPENED: opened}  # by number; runs of this session alone
        self.others = [path.absolute() for path in others]
        self.pages: dict[int, Path] = {}  # by number: what this session has made of results
        self.searches: dict[int, SearchedResiduals] = {}  # by number
        self._start = RunSettings() if opened is None else read_run_settings(opened.run)
        self.folder = (folder or beside.with_name(f"{beside.stem}_workbench")).absolute()
        if self.folder.exists() and not self.folder.is_dir():
            raise InputError(f"{self.folder}: a file, expected a folder for the results")
        if beside.is_dir() and beside in (self.folder, *self.folder.parents):
            raise InputError(f"{self.folder}: lies in {shown}, expected a folder outside it")
        self.home = self.folder  # of the datasets that the page makes
        self.process = TrackProcess(self._note_change, take=self._take_result)
        self.previews = ScenePreviews()
        self.report_key = secrets.token_urlsafe(24)  # part of the addresses of reports
        self.version = 0  # grows with every change of detector and run
        self.detector: PreparedDetector | None = None
        self.detector_status = DetectorStatus()
        self._mark = ""  # what the detector depends on
        self._lock = threading.RLock()
        self._opening = threading.Lock()  # taken before the other: opening a film takes seconds
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
        self.previews.close()
        self._worker.join(timeout=MAX_WAIT_AT_END_S)

    def _note_change(self) -> None:
        self.version += 1

    def _take_result(self, status: RunStatus) -> None:
        """Take what a run made that has ended. Raises InputError."""
        if (status.command, status.state) == ("calibrate", "done"):
            self._take_camera(self._file("calibrated", status.number))
        if (status.command, status.state) == ("generate", "done"):
            self._open_source(self._made(status.number))
        if status.command == "generate" and status.state in ("cancelled", "failed"):
            made = self._made(status.number)  # the page cannot continue it
            shutil.rmtree(made.with_name(f"{made.name}.partial"), ignore_errors=True)

    # --- the film

    def open_clip(self, index: int) -> None:
        """Show another clip of the source, without settings. Raises InputError."""
        with self._opening:
            if not 0 <= index < len(self.source):
                raise InputError(f"clip: expected 0 to {len(self.source) - 1}, not {index}")
            self._check_idle()
            shown = _open_film(self.source, index, self._start)
            with self._lock:
                self._check_idle()  # a run may have started meanwhile
                self._show(
                    *shown, self._read_edits(shown[0], self.source, self.folder, self._list_finished(shown[0].number))
                )

    def _check_idle(self) -> None:
        if self.process.is_running:
            raise InputError("clip: a run is under way; wait for it, or cancel it")

    def _open_source(self, dataset: Path) -> None:
        """Show a dataset in place of the source, with a folder of its own. Raises InputError."""
        with self._opening:
            source, start, folder = open_source(dataset), RunSettings(), dataset.with_name(f"{dataset.name}_workbench")
            shown = _open_film(source, 0, start)
            mending = self._read_edits(shown[0], source, folder, ())
            with self._lock:  # all of it, or nothing
                self.source, self.has_film, self._start, self.folder = source, True, start, folder
                self.results, self.others, self.pages, self.searches = {}, [], {}, {}
                self._show(*shown, mending)

    def _read_edits(self, view: FilmView, source: RecordingSource, folder: Path, runs: Sequence[int]) -> EditHistory:
        """The edits of a clip: those of its file, else those of the results that have the most."""
        file = folder / (EDITS if len(source) == 1 else f"edits_clip_{view.number:06d}.yaml")
        applied = [self._list_applied(number, view.number) for number in runs]
        return EditHistory(file, max(applied, key=len, default=[]))

    def _show(self, view: FilmView, given: Mapping[str, Any] | None, plan: RunPlan, mending: EditHistory) -> None:
        """Put a clip in place of the one in view."""
        if "view" in vars(self):
            self.view.close()
        self.view, self.given, self.mending = view, given, mending
        self._take(plan)

    @property
    def film(self) -> Path:
        """The film in view, as `tracker track` takes it."""
        if not self.source.dataset:
            return self.source.path
        return self.view.location.parent

    def describe(self) -> dict[str, Any]:
        """All that the page needs when it is loaded."""
        with self._lock:
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
                "given": None if self.given is None else replace_non_finite(dict(self.given)),
                "folder": f"{self.folder}",
                "has_film": self.has_film,
                "opened": self.results[OPENED].describe_clips() if OPENED in self.results else [],
                "results": max(self._list_finished(self.view.number), default=None),
                "search": max((number for number, one in self.searches.items() if one.is_there), default=None),
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
            return {
                "camera": None if plan.keys is None else json.dumps(replace_non_finite(plan.keys), indent=1),
                "camera_file": f"{self._file('camera', number)}" if plan.needs_file else "",
                "command": join_words(self._write_command(number)),
            }

    def _take(self, plan: RunPlan) -> None:
        """Use a plan from now on, and prepare its detector if that may differ."""
        self.plan = plan
        mark = json.dumps([plan.keys, *vars(plan.settings.options).values(), plan.channel, self.view.mark])
        if not self.has_film:
            self.detector_status = DetectorStatus("failed", error="The film of these results is not here.")
        elif mark != self._mark:
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
                ready = prepare_detector(plan.open_apart(), plan.channel)
                seconds, channel = round(time.monotonic() - began, 2), ready.clip.channel
                status = DetectorStatus("ready", ready.name, ready.point, channel, seconds, ready.notes)
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
            detector, view = self.detector, self.view
        numbers = view.clip.frames.numbers
        if not 0 <= index < len(numbers):
            raise InputError(f"frame {index}: expected 0 to {len(numbers) - 1}")
        if detector is None:
            return None
        if detector.clip.channel == GREY:
            view.read(index)  # the page asks for it, too: it is decoded once
        began, own = time.monotonic(), detector.clip.frames.numbers
        row = int(np.searchsorted(own, numbers[index]))
        inside = row < len(own) and bool(own[row] == numbers[index])
        balls = list_balls(detector.detect(row)) if inside else []
        spent = round(1e3 * (time.monotonic() - began), 1)
        return {"balls": balls, "radius": detector.radius_px, "point": detector.point, "ms": spent, "read": inside}

    # --- the run

    def _next_number(self, folder: Path | None = None) -> int:
        """The first number without a file of an earlier run, finished, interrupted or claimed."""
        taken = {path.name.removesuffix(".partial") for path in (folder or self.folder).glob("*_*")}
        names = ({_name_file(kind, n) for kind in FILES_OF_RUNS} for n in count(1))
        return next(n for n, own in enumerate(names, 1) if not own & taken)

    def _file(self, kind: str, number: int, folder: Path | None = None) -> Path:
        """A file or folder of a run: its kind is a key of FILES_OF_RUNS."""
        return (folder or self.folder) / _name_file(kind, number)

    def _made(self, number: int) -> Path:
        return self._file("made", number, self.home)

    def start_calibration(self, values: Any) -> dict[str, Any]:
        """Start `tracker calibrate`: the scale by the balls, or the perspective by known points. Raises InputError.

        values: RunSettings, and perhaps `points`, four numbers each: x and y in px, x and y in m. When it is done, its
        camera file becomes that of the film.
        """
        rest = {key: value for key, value in values.items() if key != "points"} if isinstance(values, dict) else values
        settings = build_settings(rest, RunSettings, "settings")
        given = build_settings({"points": values.get("points")}, KnownPoints, "points")
        known = self.given or {}
        wanted = {"--diameter": settings.ball_diameter or known.get("ball_diameter")}
        wanted |= {"--fps": settings.fps or known.get("fps"), "--exposure": settings.exposure}
        if not self.has_film:
            raise InputError("calibrate: the film of these results is not here")
        if not (wanted["--diameter"] and wanted["--fps"]):
            raise InputError("calibrate: set the ball diameter and the frames a second; the film then gives the rest")
        with self._lock:
            number = self._claim_number()
            words = ["tracker", "calibrate", name_as_argument(self.film), "-o", f"{self._file('calibrated', number)}"]
            for name, value in wanted.items():
                words += [name, f"{value:.12g}"] if value else []
            if given.points is not None:
                table = self._file("points", number)
                lines = [",".join(f"{value:.12g}" for value in point) for point in given.points]
                write_atomically(table, "\n".join(["x_px,y_px,x,y", *lines, ""]))
                words += ["--points", f"{table}"]
            self._start_process(number, words)
            return self.describe_status()

    def _take_camera(self, file: Path) -> None:
        """Use another camera file for the film, and keep the settings that it does not contain."""
        with self._lock:
            kept = self.plan.settings.model_dump(include={"balls", "region", "frames", "channel", "colour"})
            self.source, self.given = replace(self.source, camera=file), read_source(file)
            self._take(make_plan(build_settings(kept, RunSettings, "settings"), self.view, self.given, where=f"{file}"))

    def _claim_number(self, folder: Path | None = None) -> int:
        """The number of the next run, which no other session takes from now on. Raises InputError."""
        if self.process.is_running:
            raise InputError("run: one is under way; wait for it, or cancel it")
        folder = folder or self.folder
        check_writable(folder)
        folder.mkdir(parents=True, exist_ok=True)
        while True:
            number = self._next_number(folder)
            with suppress(FileExistsError):
                self._file("command", number, folder).touch(exist_ok=False)
                return number

    def _start_process(self, number: int, words: list[str], folder: Path | None = None) -> None:
        """Start a run, and note its command beside its results."""
        write_atomically(self._file("command", number, folder), join_words(words) + "\n")
        self.process.start(number, words)

    def start_generation(self, values: Any) -> dict[str, Any]:
        """Start `synthcam generate`, with a scene as the page shows it. When it is done, its dataset is opened.

        values: the request of the preview, and `clips`, their number. Raises InputError.
        """
        max_clips = 1000  # on the page; the command makes more
        asked = dict(values) if isinstance(values, dict) else {}
        clips, seed = asked.pop("clips", 1), asked.get("seed", 0)
        if not isinstance(clips, int) or isinstance(clips, bool) or not 1 <= clips <= max_clips:
            raise InputError(f"make: expected 1 to {max_clips} clips")
        if not isinstance(seed, int) or isinstance(seed, bool) or seed < 0:
            raise InputError(f"make: seed: expected a whole number, 0 or more, not {seed!r}")
        scene = self.previews.ask({**asked, "sharp": False}).get("yaml")
        if scene is None:
            raise InputError("make: expected the name of a scene")
        with self._lock:
            number = self._claim_number(self.home)
            file = self._file("scene", number, self.home)
            write_atomically(file, scene)
            words = ["synthcam", "generate", f"{file}", "-o", f"{self._made(number)}"]
            self._start_process(number, [*words, "--clips", f"{clips}", "--seed", f"{seed}"], self.home)
            return self.describe_status()

    def start_run(self) -> dict[str, Any]:
        """Start `tracker track` with the settings of the page. Raises InputError."""
        with self._lock:
            number, plan = self._claim_number(), self.plan
            if plan.needs_file and self.has_film:
                text = json.dumps(replace_non_finite(plan.keys), indent=1)
                write_atomically(self._file("camera", number), text + "\n")
            if self.mending.edits:
                write_atomically(self._file("edits", number), TrackEdits.of({"edits": self.mending.edits}).write())
            self.results[number] = OpenedResults(self._file("results", number))
            self._start_process(number, self._write_command(number))
            return self.describe_status()

    def _write_command(self, number: int) -> list[str]:
        """The words of the command of run `number`: of results without their film, the one that measures tracks."""
        edits = ["--edits", f"{self._file('edits', number)}"] if self.mending.edits else []
        if self.has_film:
            camera = self._file("camera", number) if self.plan.needs_file else self.source.camera
            return [*self.plan.write_command(self.film, camera, self._file("results", number)), *edits]
        own = clip_folder(self.source.path, self.view.number)
        words = ["tracker", "measure", name_as_argument(own / "tracks.parquet"), "--camera", f"{own / 'camera.json'}"]
        return [*words, "-o", f"{self._file('results', number)}", *edits]

    def describe_status(self) -> dict[str, Any]:
        """State of the detector and of the run."""
        run = self.process.status
        made = run.number in self.pages and (self.pages[run.number] / "index.html").is_file()
        return {
            "version": self.version,
            "detector": vars(self.detector_status),
            "run": {key: value for key, value in vars(run).items() if key not in ("summary", "began")},
            "seconds": round(self.process.seconds, 1) if self.process.is_running else None,
            "page": f"/report/{self.report_key}/{run.number}/index.html" if made else "",
        }

    # --- comparisons

    def start_combination(self) -> dict[str, Any]:
        """Start `tracker combine`, for the results that were opened, or for the latest run of each clip."""
        with self._lock:
            folders = [found.folder for found in self._list_set()]
            if not folders:
                raise InputError("combine: expected results, track a film first")
            number = self._claim_number()
            self.pages[number] = self._file("set", number)
            words = ["tracker", "combine", *map(name_as_argument, folders), "-o", f"{self.pages[number]}"]
            self._start_process(number, words)
            return self.describe_status()

    def start_search(self, name: Any) -> dict[str, Any]:
        """Start `discrepancy find` with a model file of the folder; "" is the model of all defaults."""
        if not isinstance(name, str) or not re.fullmatch(r"(\w[\w.-]*)?", name):
            raise InputError(f"search: expected the name of a model file in {self.folder}")
        if name and not (self.folder / name).is_file():
            raise InputError(f"search: there is no file {self.folder / name}")
        with self._lock:
            found = self._list_set()
            if len(found) != 1:
                raise InputError(f"search: expected one folder of results, there are {len(found)}")
            number = self._claim_number()
            model = self.folder / name if name else self._file("model", number)
            if not name:
                write_atomically(model, "model: {}  # all defaults\n")
            self.pages[number] = self._file("search", number)
            self.searches[number] = SearchedResiduals(self.pages[number], found[0])
            words = ["discrepancy", "find", name_as_argument(found[0].folder), "--model", f"{model}"]
            self._start_process(number, [*words, "-o", f"{self.pages[number]}"])
            return self.describe_status()

    def _list_set(self) -> list[OpenedResults]:
        if OPENED in self.results:
            return [self.results[OPENED], *map(OpenedResults, self.others)]
        latest: dict[tuple[int, ...], OpenedResults] = {}
        for number, found in self.results.items():
            with suppress(InputError):
                latest[tuple(self.find_results(number).numbers)] = found
        return list(latest.values())

    def describe_search(self, number: int) -> dict[str, Any]:
        """The residuals of the clip in view that a search of this session has left. Raises InputError."""
        search = self.searches.get(number)
        if search is None or not search.is_there:
            raise InputError(f"search {number}: not one of this page")
        return {"number": number, **search.describe(self.view.number)}

    def find_page_folder(self, number: int) -> Path:
        """The folder of results, or of what was made of them, whose pages are shown. Raises InputError."""
        return self.pages[number] if number in self.pages else self.find_results(number).folder

    # --- results and their edits

    def describe_results(self, number: int) -> dict[str, Any]:
        """The recommended numbers of the clip in view in one of the results, with their errors. Raises InputError."""
        found, clip = self.find_results(number), self._find_clip(number)
        page = found.find_page(clip)
        address = f"/report/{self.report_key}/{number}/{page}" if page else ""
        return {"number": number, **found.describe_collisions(clip), "page": address}

    def describe_tracks(self) -> dict[str, Any]:
        """The tracks of the clip in view as the edits leave them, and the edits. Raises InputError.

        pending: how many edits the shown results do not have yet; None if no results fit to the edits.
        """
        with self._lock:
            edits, base = self.mending.edits, self._find_base()
            about = {"edits": edits, "can_redo": bool(self.mending.undone), "file": f"{self.mending.file}"}
            if base is None:
                return {**about, "tracks": [], "pending": None}
            rest = edits[len(self._list_applied(base, self.view.number)) :]
            return {**about, "tracks": self._list_tracks(base, rest), "pending": len(rest)}

    def mend(self, values: Any) -> dict[str, Any]:
        """Add an edit, undo or redo one, and write the file of edits. Raises InputError."""
        with self._lock:

            def check(edits: list[dict[str, Any]]) -> None:
                base = self._find_base(edits)
                if base is not None:
                    self._list_tracks(base, edits[len(self._list_applied(base, self.view.number)) :])

            if not self.results:
                raise InputError("edits: track the film before you correct its tracks")
            self.mending.take(values, check)
            return {**self.describe_tracks(), "plan": self.describe_plan()}

    def _list_tracks(self, number: int, edits: list[dict[str, Any]]) -> list[dict[str, Any]]:
        found, clip = self.find_results(number), self._find_clip(number)
        film = self.view.clip.frames.numbers if self.has_film else None
        return found.list_tracks(clip, TrackEdits.of({"edits": edits}), film)

    def _list_applied(self, number: int, clip: int) -> list[dict[str, Any]]:
        """The edits that results have, of those that a run from this source applies."""
        return [] if number == OPENED and not self.has_film else self.results[number].list_edits(clip)

    def _find_base(self, edits: list[dict[str, Any]] | None = None) -> int | None:
        """The results of the clip in view that have the most of the edits, and no others; the latest of equal ones."""
        wanted, best = self.mending.edits if edits is None else edits, None
        for number in self._list_finished(self.view.number):
            applied = self._list_applied(number, self.view.number)
            if applied == wanted[: len(applied)] and (best is None or len(applied) >= best[0]):
                best = len(applied), number
        return None if best is None else best[1]

    def _list_finished(self, clip: int) -> list[int]:
        """The numbers of the results that have a clip."""
        out = []
        for number in self.results:
            with suppress(InputError):
                if clip in self.find_results(number).numbers:
                    out.append(number)
        return out

    def _find_clip(self, number: int) -> int:
        if self.view.number not in self.find_results(number).numbers:
            raise InputError(f"run {number}: of another clip")
        return self.view.number

    def find_results(self, number: int) -> OpenedResults:
        """Results that this session has opened or made. Raises InputError."""
        found = self.results.get(number)
        if found is None or not (found.folder / "estimates.parquet").is_file():
            raise InputError(f"run {number}: not one of this page")
        return found


def _name_file(kind: str, number: int) -> str:
    return f"{kind}_{number}{FILES_OF_RUNS[kind]}"


def _open_film(
    source: RecordingSource, index: int, start: RunSettings
) -> tuple[FilmView, Mapping[str, Any] | None, RunPlan]:
    """Open a clip: its view, the keys of its camera file, and the plan of a run with these settings."""
    view = FilmView(source, index)
    file = replace(source, clips=(source.clips[index],)).camera_files()
    given: Mapping[str, Any] | None = read_source(file[0]) if file else None
    return view, given, make_plan(start, view, given, where=f"{file[0]}" if file else "")
