"""Cases of large films and long datasets: what a command takes, and the processor time that it may use."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from benchmarks.tracker.ordinary.case import Case, Judge, Outcome, Verdict, Words
from benchmarks.tracker.ordinary.judges import Found, Said
from benchmarks.tracker.ordinary.sources import write_camera

discs: Any = importlib.import_module("tracker_discs")
START_S = 2.0  # of processor time that any command may take to start, to link and to fit


@dataclass(frozen=True)
class Within:
    """Another judge is content, and the command took so many seconds of processor time at most."""

    judge: Judge
    seconds: float

    @property
    def right(self) -> str:
        return f"{self.judge.right}; {self.seconds:.3g} s at most"

    def __call__(self, outcome: Outcome) -> Verdict:
        verdict = self.judge(outcome)
        return Verdict(f"{verdict.got}; {outcome.seconds:.3g} s", verdict.right and outcome.seconds <= self.seconds)


def place_side_by_side(width: int, height: int, radius: float, count: int) -> NDArray[np.float64]:
    """Centres (2, frames, 2) of two balls that move side by side, px."""
    x = 0.2 * width + 0.5 * width * np.arange(count) / count
    return np.array([np.stack([x, 0.5 * height + side * 3 * radius + 0.1 * x], axis=-1) for side in (-1, 1)])


def track_discs(places: NDArray[np.float64], width: int, height: int, radius: float) -> Callable[[Path], Words]:
    """A film of matte balls on a texture, and `tracker track` of it."""

    def make(folder: Path) -> Words:
        rng = np.random.default_rng(0)
        ground = discs.plate(rng, size=(height, width))
        tifffile.imwrite(folder / "film.tif", discs.film(rng, places, ground=ground, radius=radius))
        write_camera(folder, {**discs.CAMERA, "size": [width, height], "ball_diameter": 2 * radius * 1e-3})
        return ["tracker", "track", "film.tif", "--camera", "camera.json", "-o", "new", "--no-pages"]

    return make


def generate(clips: int, width: int, height: int) -> Callable[[Path], Words]:
    """A dataset of clips of 200 frames with their films."""
    scene = {"camera.size": [width, height], "timing.frames": 200, "timing.contact_frame": 60}
    options = [word for key, value in scene.items() for word in ("--set", f"{key}={value}")]
    return lambda folder: ["synthcam", "generate", "painter_behringer", "-o", "new", "--clips", f"{clips}", *options]


def list_cases() -> list[Case]:
    """Cases of large films and of a long dataset."""
    films = {  # width, height, radius of a ball (px), frames, seconds a frame
        "1920 x 1440, discs of 60 px": (1920, 1440, 30.0, 24, 0.08),
        "3840 x 2880, discs of 110 px": (3840, 2880, 55.0, 10, 0.3),
    }
    cases = []
    for kind, (width, height, radius, count, each) in films.items():
        places = place_side_by_side(width, height, radius, count)
        judge = Within(Found(places), START_S + count * each)
        cases.append(Case("pace", kind, track_discs(places, width, height, radius), judge))
    made = Within(Said((), files=("new/clips/000009/frames.tif",)), START_S + 2000 / 1000)
    return [*cases, Case("pace", "generate, 2,000 frames of 512 x 256", generate(10, 512, 256), made)]
