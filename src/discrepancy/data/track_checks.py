"""Checks of tracks before a fit: wrong units, exchanged balls, and positions that belong to another ball."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from discrepancy.arrays import Array, Ints
from discrepancy.policy import current_policy
from tracker.camera.camera import Camera
from tracker.detection.link import Tracks


def detect_wrong_units(clips: Iterable[tuple[Tracks, Camera]]) -> str | None:
    """Check the unit of a track: why these positions cannot be in px, or None.

    Two balls that touch are one diameter apart. So the least distance over the clips must be near a diameter. No track
    may reach far beyond the picture; the limits are in `SearchPolicy`.
    """
    policy, units = current_policy(), {"m": 1.0, "cm": 1e2, "mm": 1e3, "um": 1e6}
    nearest, far, touching, diameter = [], [], 0.0, 0.0
    for tracks, camera in clips:
        _, one, two = _pair(tracks)
        if len(one) and camera.metric:
            nearest.append(float(np.hypot(*(one - two).T).min()))
            far.append(float(np.abs(tracks.xy).max()) / max(camera.size))
            touching, diameter = camera.diameter_px, camera.ball_diameter
    if not nearest:
        return None
    least = float(np.quantile(nearest, 0.25))
    near = policy.min_distance_diameters * touching < least < policy.max_distance_diameters * touching
    if near and np.median(far) < policy.max_picture_sizes:
        return None
    message = f"the balls come as near as {least:.3g}; expected px, and {touching:.3g} of them, a diameter"
    for unit, factor in units.items():
        if abs(np.log(max(least, 1e-300) / (factor * diameter))) < policy.max_unit_mismatch:
            return f"the positions look like {unit}: {message}"
    return message


def find_exchange(tracks: Tracks, camera: Camera) -> int | None:
    """Check the tracks of a clip for an exchange of the two balls: the frame in which it happens, or None.

    There the balls would move less since the previous frame, by more than a radius, with their numbers exchanged back.
    """
    frame, one, two = _pair(tracks)
    stay = np.hypot(*np.diff(one, axis=0).T) + np.hypot(*np.diff(two, axis=0).T)
    swap = np.hypot(*(one[1:] - two[:-1]).T) + np.hypot(*(two[1:] - one[:-1]).T)
    wrong = (np.diff(frame) <= current_policy().max_exchange_frames) & (swap + camera.diameter_px / 2 < stay)
    return int(frame[1:][wrong][0]) if wrong.any() else None


def _pair(tracks: Tracks) -> tuple[NDArray[np.int64], Array, Array]:
    """Frames (k,) in which the two balls seen most often are both seen, and their positions there, px, (k, 2) twice."""
    particles, counts = np.unique(tracks.particle, return_counts=True)
    chosen = particles[np.argsort(-counts, kind="stable")[:2]]
    if len(chosen) < 2:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros((0, 2))
    first, second = (np.flatnonzero(tracks.particle == p) for p in chosen)
    frame, one, two = np.intersect1d(tracks.frame[first], tracks.frame[second], return_indices=True)
    return frame, tracks.xy[first[one]], tracks.xy[second[two]]


def remove_strays(tracks: Tracks, camera: Camera) -> tuple[Tracks, list[int]]:
    """Remove short runs of positions that belong to another ball: a track jumps there and back onto its straight path.

    A tracker took another ball for this one there. Returns the other positions, and the frames of those removed.
    """
    if not camera.metric:
        return tracks, []
    gone = np.zeros(len(tracks.frame), dtype=bool)
    for particle in np.unique(tracks.particle):
        rows = np.flatnonzero(tracks.particle == particle)
        gone[rows[_find_strays(tracks.frame[rows], tracks.xy[rows], camera.diameter_px)]] = True
    if not gone.any():
        return tracks, []
    kept = replace(tracks, **{name: values[~gone] for name, values in vars(tracks).items()})
    return kept, np.unique(tracks.frame[gone]).tolist()


def _find_strays(frame: Ints, xy: Array, diameter: float) -> Ints:
    """The stray rows of one track, in order of frames."""
    policy = current_policy()
    jumps = np.flatnonzero(np.hypot(*np.diff(xy, axis=0).T) > policy.stray_jump_diameters * diameter) + 1
    out = list[int]()
    for first in jumps.tolist():
        for last in jumps[(jumps > first) & (jumps - first <= policy.max_stray_positions)].tolist():
            if _is_stray(frame, xy, first, last, diameter):
                out += range(first, last)
                break
    return np.array(sorted(set(out)), dtype=np.int64)


def _is_stray(frame: Ints, xy: Array, first: int, last: int, diameter: float) -> bool:
    """True if the path is straight without rows first to last - 1, and all these are off it."""
    beside_count = 4  # positions on either side to which the straight line is fitted
    beside = np.r_[max(first - beside_count, 0) : first, last : min(last + beside_count, len(frame))]
    if first < beside_count // 2 or len(frame) - last < beside_count // 2:
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
