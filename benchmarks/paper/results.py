"""The tracked series, and the paper's readings of them, computed once for figures, numbers and page."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.paper import experiment, kondic
from benchmarks.paper.experiment import Filmed
from benchmarks.paper.models.observed import FINAL
from benchmarks.paper.readings import Corners, Films, corners, least_separation, read
from tracker.measurement.estimate import fit_all_jointly

Floats = NDArray[np.float64]
WINDOW = "6 ms"  # both frames lie within .01 s after the hit, as the paper says of its readings
TYPICAL = 10  # frames over which a roller's speed is differenced


@dataclass(frozen=True)
class Rolling:
    """Speed (m/s) and acceleration (m/s^2) of single balls by differences, and the line through them."""

    speed: Floats
    acceleration: Floats
    drag: float
    drag_error: float
    decel: float
    decel_error: float


@dataclass(frozen=True)
class Course:
    """One collision against time (s, 0 at frame 0): velocities (2, frames, 2) by differences; the paper's directions.

    slide: for each ball the unit vector of its change of velocity after the hit, so turned that its momentum is
    positive.
    """

    time: Floats
    position: Floats
    velocity: Floats
    contact: float
    v0: float
    slide: Floats
    read: pd.Series
    ends: Corners


@dataclass(frozen=True, eq=False)
class Results:
    """Everything that was tracked, in output/series."""

    output: Path

    @property
    def series(self) -> Path:
        """Folder of the tables of all series."""
        return self.output / "series"

    def filmed(self, name: str) -> Filmed:
        """A series' tracks and estimates."""
        return _filmed(self.series, name)

    def count(self, name: str) -> int:
        """How many collisions, or single balls, of a series were filmed."""
        return len(self.filmed(name).films)

    @cached_property
    def quick(self) -> bool:
        """True where the series hold only the clips of a quick run."""
        kept = (name for name in experiment.SERIES if (self.series / f"{name}.parquet").exists())
        return any(self.count(name) < experiment.SERIES[name].clips for name in kept)

    def read(self, name: str) -> pd.DataFrame:
        """A series as the paper would read it."""
        return _read(self.series, name)

    def readings(self, model: str) -> dict[str, pd.DataFrame]:
        """Readings of the series that are filmed for a model."""
        return {name: self.read(name if model == "base" else f"{model}/{name}") for name in experiment.OF_MODELS}

    @cached_property
    def fitted(self) -> kondic.Fitted:
        """The paper's chi^2 on the series of speeds, read as the paper reads."""
        speeds = self.read("speeds")
        return kondic.fit(speeds["v0"].to_numpy(), speeds[FINAL].to_numpy())

    @cached_property
    def joint(self) -> dict[str, Any]:
        """The tracker's own fits: of the collisions nearly head-on, and of the rollers."""
        rolling = fit_all_jointly(self.filmed("rolling").estimates)["rolling"]
        return fit_all_jointly(self.filmed("speeds").estimates) | {"rolling": rolling}

    @cached_property
    def rolling(self) -> Rolling:
        """The rolling loss by differences of velocities, over stretches of 40 ms."""
        films = self.filmed("rolling").films
        place = films.position[1, :, ::TYPICAL]
        step = TYPICAL / films.fps
        velocity = np.hypot(*np.moveaxis(np.diff(place, axis=1), -1, 0)) / step
        speed = ((velocity[:, 1:] + velocity[:, :-1]) / 2).ravel()
        loss = (np.diff(velocity, axis=1) / step).ravel()
        good = np.isfinite(loss)
        (slope, level), cov = np.polyfit(speed[good], loss[good], 1, cov=True)
        errors = np.sqrt(np.diag(cov))
        return Rolling(speed[good], loss[good], -slope, float(errors[0]), -level, float(errors[1]))

    @cached_property
    def scan(self) -> pd.DataFrame:
        """The wide scan over models, a row for each candidate, size and way of reading."""
        return pd.DataFrame(json.loads((self.output / "scan.json").read_text()))

    def course(self, name: str) -> Course:
        """The collision of the series slow or fast against time."""
        films = self.filmed(name).films
        row, ends = self.read(name).iloc[0], corners(films, least_separation(films))
        position = films.position[:, 0]
        velocity = np.full(position.shape, np.nan)
        velocity[:, 1:-1] = (position[:, 2:] - position[:, :-2]) * films.fps / 2
        k = int(row["k"])
        for frame in (k, k + 1):  # the hit lies between their neighbours: forward from k + 1, backward up to k
            side = slice(k + 1, k + 3) if frame == k + 1 else slice(k - 2, k)
            velocity[:, frame] = np.diff(position[:, side], axis=1)[:, 0] * films.fps
        first = np.diff(position[:, k + 1 : k + 3], axis=1)[:, 0] * films.fps
        change = ends.velocity[:, 0] - first
        slide = change / np.hypot(*change.T)[:, None]
        forward = np.array([row["direction_x"], row["direction_y"]])
        slide *= np.sign(slide @ forward)[:, None]
        time = np.arange(position.shape[1]) / films.fps
        return Course(
            np.asarray(time, dtype=np.float64),
            position,
            velocity,
            row["contact"] / films.fps,
            row["v0"],
            slide,
            row,
            ends,
        )


@cache
def _filmed(folder: Path, name: str) -> Filmed:
    return experiment.filmed(name, folder)


@cache
def _read(folder: Path, name: str) -> pd.DataFrame:
    return read(_filmed(folder, name).films)


def noisy(films: Films, error: float, seed: int = 0) -> Films:
    """The same positions with further errors, m, as of a cruder tracker."""
    shake = np.random.default_rng(seed).normal(0, error, films.position.shape)
    return Films(films.position + shake, films.fps, films.diameter)
