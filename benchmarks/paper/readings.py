"""The paper's own analysis of tracked collisions: differences of positions, line of centres, the end of a slide.

Everything here takes positions on the plate and nothing else, many collisions at once. The tracker followed them in
films. In the wide scan over models they are solved, with noise. Definitions: docs/format.md and the paper.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]

# Two frames whose difference is the velocity "immediately" after the hit, counted from the frame k of least separation;
# "first": the first two frames in which the balls have parted, which lie 2 to 6 ms after the hit on average 4.
WINDOWS: dict[str, tuple[int, int] | None] = {"4 ms": None, "6 ms": (1, 2), "8 ms": (1, 3)}
BEFORE = (-3, -1)
LONGEST = 44  # frames after k in which a slide may end: 176 ms
FEWEST = 6  # frames of rolling, at least, behind the corner
STEP = 0.25  # of a frame: how finely corners are tried


@dataclass(frozen=True)
class Films:
    """Positions (2, n, frames, 2), m, means over exposures, NaN where not seen; ball 0: target, ball 1: striker."""

    position: Floats
    fps: float
    diameter: float

    def __len__(self) -> int:
        return int(self.position.shape[1])

    def rounded(self, pixel: float) -> Films:
        """As one reads them who takes the brightest pixel for the place; pixel: its size, m."""
        return Films(np.round(self.position / pixel) * pixel, self.fps, self.diameter)


def least_separation(films: Films) -> Ints:
    """Frame k (n,) in which the balls are nearest each other."""
    apart = np.hypot(*np.moveaxis(films.position[0] - films.position[1], -1, 0))
    return np.asarray(np.nanargmin(np.where(np.isfinite(apart), apart, np.inf), axis=1))


def at(films: Films, frame: Ints) -> Floats:
    """Positions (2, n, 2) in frame (n,) of each collision; NaN beyond the film."""
    last = films.position.shape[2] - 1
    inside = (frame >= 0) & (frame <= last)
    there = films.position[:, np.arange(len(films)), np.clip(frame, 0, last)]
    return np.asarray(np.where(inside[None, :, None], there, np.nan))


def velocity(films: Films, first: Ints, second: Ints) -> Floats:
    """(2, n, 2) m/s from two frames of each collision."""
    step = (second - first)[None, :, None]
    return np.asarray((at(films, second) - at(films, first)) * films.fps / step)


def contact(films: Films, k: Ints, before: Floats) -> Floats:
    """Instant of contact (n,) in frames: where the way before the hit comes to touch."""
    start, step = at(films, k - 1), before / films.fps
    gap, closing = start[0] - start[1], step[0] - step[1]
    a, half, c = _dot(closing, closing), _dot(gap, closing), _dot(gap, gap) - films.diameter**2
    root = np.sqrt(np.clip(half**2 - a * c, 0, None))
    return np.asarray(k - 1 + (-half - root) / a)


@dataclass(frozen=True)
class Corners:
    """The ends of the slides: instant (2, n) in frames after k, velocity there (2, n, 2) m/s, by a broken line."""

    instant: Floats
    velocity: Floats


def corners(films: Films, k: Ints) -> Corners:
    """The corner of each ball's velocity after the hit: a line that falls or rises, then one that is nearly level.

    The eye with a ruler: broken lines, the same corner for both components, by least squares over all its positions.
    """
    speed, time = _after(films, k)  # (m, length, 2), (length,)
    weight = np.isfinite(speed).all(axis=2).astype(float)
    value = np.where(weight[..., None] > 0, speed, 0.0)
    places = np.arange(time[1] + STEP, time[0] + LONGEST, STEP)
    late, early = time - places[:, None], places[:, None] - time
    design = np.stack([np.ones_like(late), np.clip(late, 0, None), np.clip(early, 0, None)], axis=-1)
    count = int(design.shape[1])
    pairs = np.einsum("tli,tlj->tijl", design, design).reshape(-1, count)
    square = (pairs @ weight.T).reshape(len(places), 3, 3, -1).transpose(3, 0, 1, 2)
    flat = design.transpose(0, 2, 1).reshape(-1, count)
    pull = np.stack([(flat @ value[..., a].T).reshape(len(places), 3, -1) for a in (0, 1)], axis=-1).transpose(
        2, 0, 1, 3
    )
    best = np.linalg.solve(square + 1e-12 * np.eye(3), pull)
    left = (value**2).sum(axis=(1, 2))[:, None] - (best * pull).sum(axis=(2, 3))
    seen_late = weight @ (late > 0).T
    left = np.where(seen_late >= FEWEST, left, np.inf)
    row, mine = np.argmin(left, axis=1), np.arange(len(left))
    known = np.isfinite(left[mine, row])
    instant = np.where(known, places[row], np.nan)
    reached = np.where(known[:, None], best[mine, row, 0], np.nan)
    return Corners(instant.reshape(2, -1), reached.reshape(2, -1, 2))


def _after(films: Films, k: Ints) -> tuple[Floats, Floats]:
    """Velocities (2n, length, 2) between neighbouring frames from k + 1 on, and their times after k, in frames."""
    length = LONGEST + 2 * FEWEST
    frames = k[:, None] + 1 + np.arange(length + 1)
    last = films.position.shape[2] - 1
    rows = np.arange(len(films))[:, None]
    there = films.position[:, rows, np.clip(frames, 0, last)]
    there = np.where((frames <= last)[None, ..., None], there, np.nan)
    speed = np.diff(there, axis=2) * films.fps
    return speed.reshape(-1, length, 2), np.arange(1.5, 1.5 + length)


def read(films: Films) -> pd.DataFrame:
    """The quantities that the paper reads from each collision, a row each.

    v0, b; direction x, y of the striker; k, contact (frames); v1f, v2f, tau1, tau2 (by the corner, tau from frame k),
    energy, momentum, final_angle; and for each of WINDOWS, with " WINDOW" behind the name: r; C_target, C_striker,
    C_both from the spins that the later rolling implies; dn_target, dn_striker: change of the spin along the line of
    centres, over v0/R; kept: the momentum of both along the striker's first direction, over its own; angle between the
    velocities.
    """
    k = least_separation(films)
    before = velocity(films, k + BEFORE[0], k + BEFORE[1])
    before[0] = 0.0  # a resting target: its differences are noise
    touch = contact(films, k, before)
    here = at(films, k)
    normal = _unit(here[0] - here[1])
    v0 = np.hypot(*before[1].T)
    direction = before[1] / v0[:, None]
    across = np.column_stack([-normal[:, 1], normal[:, 0]])
    ends = corners(films, k)
    v = ends.velocity
    total = v.sum(axis=0)
    table = {
        "v0": v0,
        "b": normal[:, 0] * direction[:, 1] - normal[:, 1] * direction[:, 0],
        "direction_x": direction[:, 0],
        "direction_y": direction[:, 1],
        "k": k,
        "contact": touch,
        "v1f": np.hypot(*v[0].T),
        "v2f": np.hypot(*v[1].T),
        "tau1": ends.instant[0] / films.fps,
        "tau2": ends.instant[1] / films.fps,
        "energy": (v**2).sum(axis=(0, 2)) / v0**2,
        "momentum": _dot(total, direction) / v0,
        "final_angle": _angle(v[0], v[1]),
    }
    closing = _dot(direction, normal) * v0
    for name, window in WINDOWS.items():
        first = np.ceil(touch).astype(int) if window is None else k + window[0]
        second = first + 1 if window is None else k + window[1]
        after = velocity(films, first, second)
        # R w x z just after the impact: later friction cannot change (5 v + 2 R w x z)/7
        rolled = (7 * v - 5 * after) / 2
        along, beside = (rolled * normal).sum(axis=2), (rolled * across).sum(axis=2)
        was = -_dot(direction, across) * v0
        table |= {
            f"r {name}": _dot(after[0] - after[1], normal) / closing,
            f"C_target {name}": -along[0] / closing,
            f"C_striker {name}": 1 - along[1] / closing,
            f"C_both {name}": (1 - along.sum(axis=0) / closing) / 2,
            f"dn_target {name}": -beside[0] / v0,
            f"dn_striker {name}": (-beside[1] - was) / v0,
            f"kept {name}": _dot(after.sum(axis=0), direction) / v0,
            f"angle {name}": _angle(after[0], after[1]),
        }
    return pd.DataFrame(table)


def _angle(one: Floats, two: Floats) -> Floats:
    return np.asarray(np.arctan2(np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]), _dot(one, two)))


def _unit(a: Floats) -> Floats:
    return np.asarray(a / np.hypot(*a.T)[:, None])


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray((a * b).sum(axis=-1))
