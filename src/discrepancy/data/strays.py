"""Short parts of a track that are another ball's, for which a tracker took it: the ball jumps away and back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from discrepancy.arrays import Array, Ints
from discrepancy.policy import current_policy
from tracker.camera.camera import Camera
from tracker.detection.link import Tracks

BESIDE = 4  # places to either side that say where the ball should be


def remove_strays(tracks: Tracks, camera: Camera) -> tuple[Tracks, list[int]]:
    """Take out places to which a ball jumps and from which it jumps back onto its straight way.

    Parameters
    ----------
    tracks : Tracks
    camera : Camera

    Returns
    -------
    tracks : Tracks
        Without these places.
    frames : list of int
        In which they were.
    """
    if not camera.metric:
        return tracks, []
    gone = np.zeros(len(tracks.frame), dtype=bool)
    for particle in np.unique(tracks.particle):
        rows = np.flatnonzero(tracks.particle == particle)
        gone[rows[_find_strays(tracks.frame[rows], tracks.xy[rows], camera.diameter_px)]] = True
    if not gone.any():
        return tracks, []
    arrays = "frame particle x y cov flux flags glint_x glint_y fixed time".split()
    return replace(tracks, **{name: getattr(tracks, name)[~gone] for name in arrays}), np.unique(
        tracks.frame[gone]
    ).tolist()


def _find_strays(frame: Ints, xy: Array, diameter: float) -> Ints:
    """Rows of one track, in order of frames."""
    steps = np.diff(xy, axis=0)
    jumps = np.flatnonzero(np.hypot(*steps.T) > current_policy().stray_jump_diameters * diameter) + 1
    out = list[int]()
    for first in jumps.tolist():
        for last in jumps[(jumps > first) & (jumps - first <= current_policy().max_stray_positions)].tolist():
            if _is_stray(frame, xy, first, last, diameter):
                out += range(first, last)
                break
    return np.array(sorted(set(out)), dtype=np.int64)


def _is_stray(frame: Ints, xy: Array, first: int, last: int, diameter: float) -> bool:
    """Is the way straight without rows first to last - 1, and are these all off it?"""
    beside = np.r_[max(first - BESIDE, 0) : first, last : min(last + BESIDE, len(frame))]
    if first < BESIDE // 2 or len(frame) - last < BESIDE // 2:
        return False
    middle = frame[first]
    line = np.polynomial.polynomial.polyfit(frame[beside] - middle, xy[beside], 1)
    rows = np.arange(first, last)

    def off(some: Ints) -> Array:
        there = line[0] + (frame[some] - middle)[:, None] * line[1]
        return np.asarray(np.hypot(*(xy[some] - there).T))

    return bool(
        off(beside).max() < current_policy().max_straightness_diameters * diameter
        and off(rows).min() > current_policy().stray_jump_diameters * diameter
    )
