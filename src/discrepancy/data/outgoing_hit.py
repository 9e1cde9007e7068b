"""A first guess of a collision whose tracks start at the hit: back from how the balls leave it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from discrepancy.arrays import Array
from discrepancy.data.launch import pad_spins
from discrepancy.policy import current_policy
from tracker.camera.camera import Camera
from tracker.detection.link import Tracks

UNSURE = 2  # frames at first, that may be before the hit, or hold it
STEP = 0.1  # frames, by which the instant is looked for where they touch


@dataclass(frozen=True)
class HitGuess:
    """A first guess of a hit. Times count from frame 0.

    Attributes
    ----------
    names : (int, int)
        The particles of the ball that was struck and of the striker.
    t_c, v0, b : float
        s, m/s, and the impact parameter over the diameter.
    slide_ends : (2,) array
        When the struck ball and the striker stop sliding, s.
    launch : (9,) array, optional
        Of a striker that rolls, columns as in `discrepancy.data.launch`; where it is known without its approach.
    """

    names: tuple[int, int]
    t_c: float
    v0: float
    b: float
    slide_ends: Array
    launch: Array | None = None


def guess_hit_from_outgoing(tracks: Tracks, camera: Camera, since: float = -math.inf) -> HitGuess | None:
    """The hit from which two balls part, one of which rested before; None where they do not part as from a hit.

    since: when it is thought to have been, s; what is seen before has no part.

    Momentum kept, the striker's velocity is the sum of both; the ball that leaves nearer to the line of centres rested.
    """
    xy, _ = camera.unproject(tracks.xy)
    paths, later = {}, tracks.frame / camera.fps > since
    for name in np.unique(tracks.particle).tolist():
        rows = np.flatnonzero((tracks.particle == name) & later)[UNSURE:]
        if (
            len(rows) >= current_policy().min_frames_after_hit
            and np.hypot(*(xy[rows[-1]] - xy[rows[0]])) > camera.radius
        ):
            paths[int(name)] = _fit_slide(tracks.frame[rows] / camera.fps + camera.exposure / 2, xy[rows])
    if len(paths) != 2:
        return None
    names, ((first, one, _), (second, two, _)) = [*paths], paths.values()
    late, reach = max(first, second), current_policy().max_unseen_frames_after_hit / camera.fps
    if abs(first - second) > reach:
        return None

    def apart(t: float) -> float:
        return float(np.hypot(*(_at(one, t - first) - _at(two, t - second)))) - 2 * camera.radius

    before = np.arange(late, late - reach, -STEP / camera.fps)
    touching = next((k for k, t in enumerate(before.tolist()) if apart(t) < 0), 0)
    if not touching:
        return None
    t_c = float(brentq(apart, before[touching], before[touching - 1]))
    at = np.array([_at(one, t_c - first), _at(two, t_c - second)])
    moved = np.array([_velocity(one, t_c - first), _velocity(two, t_c - second)])
    line = (at[1] - at[0]) / np.hypot(*(at[1] - at[0]))
    across = np.abs(moved @ [-line[1], line[0]]) / np.hypot(*moved.T)
    struck = int(across[1] < across[0])
    normal = line if struck else -line
    both = moved.sum(axis=0)
    v0 = float(np.hypot(*both))
    ahead = both / v0
    order = names[struck], names[1 - struck]
    heading, b = float(np.arctan2(ahead[1], ahead[0])), float(-normal @ [-ahead[1], ahead[0]])
    ends = np.array([paths[name][2] for name in order])
    launch = pad_spins(np.array([[*at.mean(axis=0), t_c, v0, heading, b]]))[0]
    return HitGuess(order, t_c, v0, b, ends, launch)


def _fit_slide(times: Array, xy: Array) -> tuple[float, Array, float]:
    """How a ball slides: the first instant, the parabola from there on, (3, 2) highest power first, and its end.

    Where it begins to roll it changes to another parabola, of the same velocity there.
    """
    since, best = times - times[0], (np.inf, np.zeros((4, 2)), 0.0)
    for end in since[2:-3]:
        shapes = np.stack([np.ones_like(since), since, since**2, np.maximum(since - end, 0) ** 2], axis=-1)
        parts = np.linalg.lstsq(shapes, xy, rcond=None)[0]
        best = min(best, (float(((xy - shapes @ parts) ** 2).sum()), parts, float(end)), key=lambda fit: fit[0])
    return float(times[0]), best[1][2::-1], float(times[0] + best[2])


def _at(path: Array, t: float) -> Array:
    return np.asarray(path[0] * t * t + path[1] * t + path[2])


def _velocity(path: Array, t: float) -> Array:
    return np.asarray(2 * path[0] * t + path[1])
