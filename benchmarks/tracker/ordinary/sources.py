"""Sources of the inputs: simulated collisions, films of them, and tables of their positions."""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import ROOT
from benchmarks.tracker.ordinary.case import Words
from synthcam.scene.scene import Scene

sys.path.insert(0, str(ROOT / "tests" / "helpers"))
discs: Any = importlib.import_module("tracker_discs")

VALUES = ("v0", "b", "r", "mu_k")
NOISE_PX = 0.02  # of the positions in tables
PLAIN = ("fps", "size", "scale", "ball_diameter")  # keys of camera.json that any user knows
RADIUS = 8.0  # px, of the discs


@dataclass(frozen=True, kw_only=True)
class Filmed:
    """Frames (n, h, w), camera.json, the true values, and the true centres (balls, n, 2), px."""

    frames: NDArray[Any]
    camera: Mapping[str, Any]
    truth: Mapping[str, float]
    places: NDArray[np.float64]


@cache
def film_glints() -> Filmed:
    """A film of steel balls, as the camera of this project sees it: 60 frames of 200 x 160."""
    clip = Scene.read(
        "painter_behringer",
        camera={"size": [200, 160], "scale": 3e-4},
        timing={"frames": 60, "contact_frame": 20},
    ).draw(1)
    frames = np.array(list(clip.pictures()))
    truth = {name: clip.truth[name] for name in VALUES}
    return Filmed(frames=frames, camera=clip.camera_json, truth=truth, places=read_places(clip))


@cache
def film_discs() -> Filmed:
    """A film of matte balls: 64 frames of 240 x 180."""
    return draw_discs(120.0, 64)


@cache
def film_uneven() -> tuple[Filmed, tuple[int, ...]]:
    """The same collision in frames 4 to 12 ms apart, and their times, ms."""
    steps = np.random.default_rng(6).choice([4, 8, 8, 8, 12], 63)
    times = (0, *np.cumsum(steps).tolist())
    return draw_discs(1000.0, times[-1] + 1, times), times


def draw_discs(fps: float, count: int, kept: Sequence[int] = ()) -> Filmed:
    """Some frames of a collision of matte balls, drawn by supersampling on a texture; camera.json says 120 a second."""
    clip = Scene.read(
        "matte_white",
        camera={"size": [240, 180], "scale": 0.01 / RADIUS, "height": 10.0},
        model={"restitution": 0.85, "spin_transfer": 0.2, "sliding_friction": 0.2, "rolling_decel": 0.03},
        launch={"v0": 0.5, "b": 0.2, "heading": 0.4, "contact": [0, 0]},
        timing={"fps": fps, "frames": count, "contact_frame": round(0.2 * fps), "exposure": 1e-4},
    ).draw(1)
    places = read_places(clip)[:, list(kept) or slice(None)]
    rng = np.random.default_rng(0)
    ground = discs.plate(rng, size=(180, 240))
    frames = discs.film(rng, places, ground=ground, radius=RADIUS)
    camera = {name: clip.camera_json[name] for name in PLAIN}
    truth = {name: clip.truth[name] for name in VALUES}
    return Filmed(frames=frames, camera={**camera, "fps": 120.0}, truth=truth, places=places)


def read_places(clip: Any) -> NDArray[np.float64]:
    """True centres (balls, frames, 2) of a clip, px."""
    table = clip.tracks.pivot(index="particle", columns="frame")
    return np.stack([table[name].to_numpy() for name in ("x_mean_px", "y_mean_px")], axis=-1)


@cache
def list_rows() -> tuple[tuple[int, int, float, float], ...]:
    """Rows (frame, ball, x, y) of the film of glints, px: true centres with noise, to 4 decimals."""
    places = film_glints().places
    noisy = np.round(places + NOISE_PX * np.random.default_rng(0).standard_normal(places.shape), 4)
    return tuple((k, ball, *noisy[ball, k].tolist()) for k in range(places.shape[1]) for ball in (0, 1))


def know_table() -> dict[str, Any]:
    """camera.json of the tables."""
    return {name: film_glints().camera[name] for name in PLAIN}


def write_camera(folder: Path, camera: Mapping[str, Any]) -> None:
    """Write camera.json."""
    (folder / "camera.json").write_text(json.dumps(dict(camera)))


def track(
    write: Callable[[Path], Path],
    filmed: Callable[[], Filmed] = film_glints,
    *options: str,
    **changes: Any,
) -> Callable[[Path], Words]:
    """Make a case's input: a film, its camera.json with changes, and `tracker track` of it."""

    def make(folder: Path) -> Words:
        write_camera(folder, {**filmed().camera, **changes})
        film = write(folder)
        given = ["--camera", "camera.json"]
        return ["tracker", "track", film.name, *given, "-o", "new", "--no-pages", *options]

    return make


def measure(name: str, write: Callable[[Path], object], *options: str, **camera: Any) -> Callable[[Path], Words]:
    """Make a case's input: a table, its camera.json, and `tracker measure` of it."""

    def make(folder: Path) -> Words:
        write_camera(folder, camera or know_table())
        write(folder / name)
        return ["tracker", "measure", name, "--camera", "camera.json", "-o", "new", "--no-pages", *options]

    return make
