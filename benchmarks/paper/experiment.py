"""The experiment as published, in series of films: what is filmed, and its tracks, kept as tables.

Every clip is drawn, filmed and tracked in memory. The tables keep the ball centres that the tracker found, and its
estimates. An interrupted run continues with the missing clips. Nothing here reads the truth.
"""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import synthcam
import tracker
from benchmarks.paper.readings import Films
from synthcam_shared.jobs import run_all_jobs, use_one_thread
from tracker.measurement.positions import to_ball_tracks

Progress = Callable[[int, int], None]
SEED = 2000
FRAMES, FPS = 100, 250.0
SPEEDS = (0.10, 0.60)  # m/s, of the strikers
ENTERS = {"heading": {"uniform": [-0.1, 0.1]}, "contact": [-0.028, 0.0]}  # from the left, leaving to the right


@dataclass(frozen=True)
class Series:
    """Clips of one kind.

    launch: of clip `number` of `clips`. values: numbers of the model by dotted name, where they are not the paper's.
    """

    name: str
    about: str
    clips: int
    launch: Callable[[int, int], dict[str, Any]]
    contact_frame: Any = field(default_factory=lambda: {"uniform": [20.0, 24.0]})
    values: tuple[tuple[str, float], ...] = ()

    def scene(self, number: int) -> synthcam.Scene:
        """The scene of one clip."""
        base = {name: value for name, value in self.values if "." not in name}
        effects: dict[str, dict[str, float]] = {}
        for name, value in self.values:
            effect, dot, parameter = name.rpartition(".")
            if dot:
                effects.setdefault(effect, {})[parameter] = value
        return synthcam.Scene.read(
            "painter_behringer",
            launch=ENTERS | self.launch(number, self.clips),
            timing={"frames": FRAMES, "fps": FPS, "contact_frame": self.contact_frame},
            model=base,
            effects=effects,
        )

    def of(self, model: str, values: Mapping[str, float]) -> Series:
        """The same clips, same noise, under another model."""
        return dataclasses.replace(self, name=f"{model}/{self.name}", values=tuple(sorted(values.items())))

    def settings(self) -> str:
        """All that decides the clips, to know by whether kept tables are still theirs."""
        launches = [self.launch(number, self.clips) for number in range(self.clips)]
        return json.dumps([SEED, FRAMES, FPS, ENTERS, launches, self.contact_frame, self.values], sort_keys=True)


def _rolling(number: int, clips: int) -> dict[str, Any]:
    return {"kind": "single", "v0": even(number, clips, 0.05, 0.25), "contact": [0.0, 0.0]}


def _speeds(number: int, clips: int) -> dict[str, Any]:
    return {"v0": even(number, clips, *SPEEDS), "b": {"uniform": [-0.05, 0.05]}}


def _histogram(number: int, clips: int) -> dict[str, Any]:
    return {"v0": {"uniform": list(SPEEDS)}, "b": {"uniform": [-0.25, 0.25]}}


def _angles(number: int, clips: int) -> dict[str, Any]:
    return {"v0": 0.3, "b": even(number, clips, -0.9, 0.9)}


def _spins(number: int, clips: int) -> dict[str, Any]:
    return {"v0": {"uniform": list(SPEEDS)}, "b": {"uniform": [-0.5, 0.5]}}


def _slow(number: int, clips: int) -> dict[str, Any]:
    return {"v0": 0.10, "b": 0.096, "heading": 0.0}  # 5.5 degrees, as the caption of the angle says


def _fast(number: int, clips: int) -> dict[str, Any]:
    return {"v0": 0.37, "b": 0.25, "heading": 0.0}  # the speed at which a slide of .06 s follows from the paper's fit


def even(number: int, clips: int, low: float, high: float) -> float:
    """Evenly spread values, one a clip."""
    return float(low + (high - low) * (number / max(clips - 1, 1)))


SERIES = {
    series.name: series
    for series in (
        Series("rolling", "single balls rolling, 5 to 25 cm/s", 12, _rolling, 50.0),
        Series("histogram", "28 collisions, 10 to 60 cm/s, |b/2R| under .25", 28, _histogram),
        Series("speeds", "28 nearly head-on collisions, speeds from 10 to 60 cm/s", 28, _speeds),
        Series("angles", "24 collisions at 30 cm/s, b/2R from -.9 to .9", 24, _angles),
        Series("spins", "25 collisions, 50 balls, 10 to 60 cm/s, |b/2R| under .5", 25, _spins),
        Series("slow", "one collision at 10 cm/s, b/2R = .096, as captioned", 1, _slow, 15.3),
        Series("fast", "one collision at 37 cm/s, b/2R = .25", 1, _fast, 15.3),
    )
}
OF_MODELS = ("histogram", "speeds", "spins", "slow")  # filmed for each model that is compared


def smaller(series: Series) -> Series:
    """A quick look: a fifth of the clips."""
    return dataclasses.replace(series, clips=max(series.clips // 5, min(series.clips, 3)))


@dataclass(frozen=True)
class Filmed:
    """A tracked series: centres of balls as arrays, and the tracker's estimates, a row a clip."""

    films: Films
    estimates: pd.DataFrame


def film(series: Series, output: Path, workers: int, progress: Progress) -> None:
    """Film and track the missing clips of a series into output/NAME.parquet and NAME.estimates.parquet."""
    done, parts = output / f"{series.name}.parquet", output / f"{series.name}.partial"
    if _settings(done) == series.settings():
        return
    parts.mkdir(parents=True, exist_ok=True)
    said = parts / "settings.json"
    if not said.exists() or said.read_text() != series.settings():
        for old in parts.iterdir():
            old.unlink()
        said.write_text(series.settings())
    todo = [n for n in range(series.clips) if not (parts / f"{n}.estimates.parquet").exists()]
    progress(series.clips - len(todo), series.clips)
    task = functools.partial(_film_one, series, parts)
    for count, _ in enumerate(run_all_jobs(task, todo, workers, output), 1):
        progress(series.clips - len(todo) + count, series.clips)
    for kind in (".estimates.parquet", ".parquet"):
        table = pd.concat([pd.read_parquet(parts / f"{n}{kind}") for n in range(series.clips)], ignore_index=True)
        table.attrs = {"settings": series.settings()}
        _write(table, output / f"{series.name}{kind}")
    for part in parts.iterdir():
        part.unlink()
    parts.rmdir()


def _film_one(series: Series, parts: Path, number: int) -> int:
    use_one_thread()
    clip = series.scene(number).draw(number, seed=SEED)
    camera = clip.camera_json
    result = tracker.track(clip.film(), camera, number=number)
    row = result.rows[0]
    rows = []
    for course in to_ball_tracks(result.found, result.camera):
        ball = {row.get("particle1"): 1, row.get("particle2"): 2}.get(course.particle, 2)
        x, y = course.position.T
        rows.append(pd.DataFrame({"clip": number, "ball": ball, "frame": course.frame, "x": x, "y": y}))
    _write(pd.concat(rows, ignore_index=True), parts / f"{number}.parquet")
    _write(result.estimates.assign(clip=number), parts / f"{number}.estimates.parquet")
    return number


def _write(table: pd.DataFrame, path: Path) -> None:
    aside = path.with_suffix(".aside")
    table.to_parquet(aside)
    aside.replace(path)


def _settings(path: Path) -> str:
    return str(pd.read_parquet(path).attrs.get("settings", "")) if path.exists() else ""


def filmed(name: str, output: Path, diameter: float = 2.38e-3) -> Filmed:
    """Read a series back."""
    table = pd.read_parquet(output / f"{name}.parquet")
    estimates = pd.read_parquet(output / f"{name}.estimates.parquet")
    clips = int(table["clip"].max()) + 1
    position = np.full((2, clips, FRAMES, 2), np.nan)
    position[table["ball"] - 1, table["clip"], table["frame"]] = table[["x", "y"]]
    return Filmed(Films(position, FPS, diameter), estimates)
