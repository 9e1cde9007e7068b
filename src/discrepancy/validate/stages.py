"""Stages of motion of each ball of a clip, and its directions in them: what residuals are looked at by."""

from __future__ import annotations

import numpy as np

from discrepancy.arrays import Array, Ints
from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import HEADING, T_C

BEFORE, SLIDING, ROLLING = range(3)
UNIT = 0.05  # s, of time
STILL = 1e-5  # m: a ball that moves less has no direction of its own


def stages(clip: MeasuredCollision) -> tuple[Ints, Array]:
    """Stage and time, in UNITs from where the stage begins (before: to the contact), of each row: (n,) and (n,).

    Exposures that hold an event count to the sliding.
    """
    opens = clip.frame / clip.fps
    closes, end, t_c = opens + clip.exposure, clip.slide_ends[clip.ball], clip.launch[T_C]
    stage = np.where(closes <= t_c, BEFORE, np.where(opens >= end, ROLLING, SLIDING))
    middle = (opens + closes) / 2
    time = np.where(stage == BEFORE, t_c - middle, np.where(stage == SLIDING, middle - t_c, middle - end))
    return stage, np.maximum(time, 0) / UNIT


def directions(clip: MeasuredCollision, stage: Ints, path: Array) -> Array:
    """Unit vectors along and across each ball's motion in each stage, (n, 2, 2); at rest along the heading."""
    heading = clip.launch[HEADING]
    along = np.tile([np.cos(heading), np.sin(heading)], (len(path), 1))
    for s in (BEFORE, SLIDING, ROLLING):
        for b in range(2):
            rows = np.flatnonzero((stage == s) & (clip.ball == b))
            if len(rows) < 2:
                continue
            way = path[rows[-1]] - path[rows[0]]
            if np.hypot(*way) > STILL:
                along[rows] = way / np.hypot(*way)
    return np.stack([along, np.stack([-along[:, 1], along[:, 0]], axis=1)], axis=1)
