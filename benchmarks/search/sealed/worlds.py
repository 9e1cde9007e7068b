"""Hostile worlds: strikers that do not roll, friction that varies by clip, other programs' tracks.

Each is drawn as plain numbers, `name` among them, which a truth holds under "world". Two hold laws that no library has
(LAWS); the others are the library's world, seen badly or launched otherwise.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, uniform_filter1d
from scipy.signal import savgol_filter

from synthcam.dynamics.launch import SPIN_COLUMNS
from synthcam.effect import parameter

from .outsiders import Outsider, dice

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
World = dict[str, Any]

ABROAD = 1.15  # diameters: a third ball comes no nearer to either of the two
DIAMETER = 2.38e-3 / 1.6e-4  # px
LONGEST_GAP = 5  # frames that a tracker leaves out at most because a ball is slow
FINER = 5  # times the frame rate, at which the motion is solved where frames are at uneven times
TRIES = 500


@dataclass(frozen=True)
class FrictionOfClip(Outsider):
    """Sliding friction that is another in each clip, by nothing that the tracks show."""

    FREE_LAW: ClassVar[str] = "friction_clip"
    size: float = parameter("1", typical=0.05, low=0, high=0.4)
    off: float = parameter("1", typical=1.0, fixed=True, given=True, default=0.0)

    def friction(self, mu: Any) -> Any:
        return mu * (1 + self.size * self.off)

    def _in(self, clip: int, a_strikes: bool, launch: Array) -> Outsider:
        return dataclasses.replace(self, off=float(dice(clip)))


def _filter(rng: np.random.Generator) -> World:
    kind = str(rng.choice(["mean", "savgol", "gauss"]))
    width = int({"mean": rng.choice([3, 5]), "savgol": rng.choice([7, 9, 11]), "gauss": rng.choice([1, 2])}[kind])
    return {"filter": kind, "width": width}


def _third(rng: np.random.Generator) -> World:
    return {"passes": float(rng.uniform(0.3, 1.0))}


WORLDS: dict[str, Callable[[np.random.Generator], World]] = {
    "strikers_slide": lambda rng: {"slip": 0.3, "side": 0.3},
    "strikers_spin": lambda rng: {"side": 0.4},
    "friction_of_clip": lambda rng: {},
    "two_laws": lambda rng: {},
    "quantised": lambda rng: {"step": float(rng.choice([0.1, 0.2, 0.25, 0.5, 1.0]))},
    "smoothed": _filter,
    "gaps": lambda rng: {"lost": float(rng.uniform(0.1, 0.4)), "longest": int(rng.integers(4, 16))},
    "third_passes": _third,
    "third_taken": lambda rng: _third(rng) | {"taken": int(rng.integers(3, 9))},
    "uneven": lambda rng: {"by": float(rng.uniform(0.2, 0.4)), "share": float(rng.choice([0.25, 1.0]))},
    "thinned": lambda rng: (
        {"every": int(rng.choice([2, 3]))} if rng.random() < 0.5 else {"nearer": float(rng.uniform(1.0, 6.0))}
    ),
}
LAWS = ("friction_of_clip", "two_laws")
UNDETECTABLE = ("two_laws",)  # where no effect of the library need be named: a law left free may hold it
UNFIT = {  # effects that cannot be told, or not be drawn, in a world; by name or by the law that they bend
    "strikers_slide": ("magnetic_attraction",),
    "strikers_spin": ("magnetic_attraction",),
    "quantised": ("pixel_locking",),
    "uneven": ("clock", "exposure", "measure"),
}


def launch(world: World) -> dict[str, Any]:
    """A scene's launch, as far as this world has another."""
    slip, side = world.get("slip", 0.0), world.get("side", 0.0)
    spins = dict(zip(SPIN_COLUMNS, ({"uniform": [-x, x]} for x in (slip, slip / 2, side)), strict=True))
    own = {name: spin for name, spin in spins.items() if spin["uniform"][1]}
    return own | ({"v0": {"uniform": [0.3, 0.6]}} if slip else {})  # or it would come out of the target


def spins(drawn: dict[str, Any]) -> list[float]:
    """Return the spin of a launch beside its six numbers: three numbers, or none."""
    own = [float(drawn.get(name, 0.0)) for name in SPIN_COLUMNS]
    return own if any(own) else []


def scale_noise(world: World, std: float, scale: float) -> float:
    """The noise, m, of an axis with what rounding adds."""
    return float(np.hypot(std, world.get("step", 0.0) * scale / 12**0.5))


def kept(world: World, number: int, pixels: Array, seed: int) -> Mask:
    """Which frames of each ball are in the table, (2, frames). pixels: where the balls are, (2, frames, 2)."""
    there = np.ones(pixels.shape[:2], dtype=bool)
    rng = np.random.default_rng([seed, number, 2])
    frames = pixels.shape[1]
    if "lost" in world:
        there &= rng.random(there.shape) >= world["lost"]
        for ball in there:
            first = int(rng.integers(frames))
            ball[first : first + int(rng.integers(world["longest"] + 1))] = False
    if "every" in world:
        there[:, np.arange(frames) % world["every"] != number % world["every"]] = False
    if "nearer" in world:
        for ball, path in zip(there, pixels, strict=True):
            last = 0
            for k in range(1, frames):
                ball[k] = np.hypot(*(path[k] - path[last])) >= world["nearer"] or k - last >= LONGEST_GAP
                last = k if ball[k] else last
    return there


def late(world: World, number: int, frames: int, seed: int) -> Array:
    """By how many frames each frame of a clip is late, in parts of 1 / FINER: (frames,)."""
    rng = np.random.default_rng([seed, number, 3])
    if "by" not in world or rng.random() >= world["share"]:
        return np.zeros(frames)
    out = np.round(FINER * rng.uniform(-world["by"], world["by"], frames)) / FINER
    out[0] = max(out[0], 0.0)
    return np.asarray(out)


def processed(world: World, pixels: Array, there: Mask) -> Array:
    """Tracks (2, frames, 2), px, as a filter or a grid leaves them; each unbroken stretch is filtered alone."""
    out = pixels.copy()
    if "filter" in world:
        for ball in (0, 1):
            rows = np.flatnonzero(there[ball])
            for part in np.split(rows, np.flatnonzero(np.diff(rows) != 1) + 1):
                out[ball, part] = _smooth(world, pixels[ball, part])
    if "step" in world:
        out = np.round(out / world["step"]) * world["step"]
    return out


def _smooth(world: World, path: Array) -> Array:
    if world["filter"] == "mean":
        return np.asarray(uniform_filter1d(path, world["width"], axis=0, mode="nearest"))
    if world["filter"] == "gauss":
        return np.asarray(gaussian_filter1d(path, world["width"], axis=0, mode="nearest"))
    if len(path) < world["width"]:
        return path
    return np.asarray(savgol_filter(path, world["width"], 2, axis=0))


def within(path: Array, size: list[int]) -> Mask:
    """In which frames a whole ball is in the picture."""
    return np.asarray(((path > DIAMETER / 2) & (path < np.array(size) - DIAMETER / 2)).all(axis=-1))


def third(world: World, number: int, pixels: Array, there: Mask, seed: int) -> tuple[Array, Array] | None:
    """A third ball's path (frames, 2), px, and the frames (n,) in which it is mistaken for ball 1; None: no ball.

    It rolls by one of the two, `ABROAD` diameters from either at least, and is nearest to the striker.
    """
    rng = np.random.default_rng([seed, number, 4])
    if "passes" not in world or rng.random() >= world["passes"]:
        return None
    frames = pixels.shape[1]
    time = (np.arange(frames) - frames / 2) / 250
    for _ in range(TRIES):
        meets = int(rng.integers(5, frames - 5))
        speed, heading, side = rng.uniform(0.05, 0.5), rng.uniform(0, 2 * np.pi), rng.uniform(1.2, 2.5) * DIAMETER
        way = np.array([np.cos(heading), np.sin(heading)])
        gone = (speed * (time - time[meets]) - 0.05 * (time - time[meets]) ** 2) / 1.6e-4  # it slows down by .1 m/s^2
        path = pixels[1, meets] + side * np.array([-way[1], way[0]]) + gone[:, None] * way
        apart = np.hypot(*(pixels - path).transpose(2, 0, 1))
        if there[1, meets] and apart[there].min() > ABROAD * DIAMETER:
            nearest = np.argsort(apart[1])[: world.get("taken", 0)]
            return path, np.sort(nearest)
    return None
