"""What is wrong with tracks before anything is measured: units that are not pixels, balls that exchange their names."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from discrepancy.arrays import Array
from discrepancy.policy import current_policy
from tracker.camera.camera import Camera
from tracker.detection.link import Tracks

UNITS = {"m": 1.0, "cm": 1e2, "mm": 1e3, "um": 1e6}


def detect_wrong_units(clips: Iterable[tuple[Tracks, Camera]]) -> str | None:
    """Why these places cannot be px, or None. Two balls that touch are a diameter apart."""
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
    if (
        current_policy().min_distance_diameters * touching < least < current_policy().max_distance_diameters * touching
        and np.median(far) < current_policy().max_picture_sizes
    ):
        return None
    said = f"the balls come as near as {least:.3g}; expected px, and {touching:.3g} of them, a diameter"
    for unit, factor in UNITS.items():
        if abs(np.log(max(least, 1e-300) / (factor * diameter))) < current_policy().max_unit_mismatch:
            return f"the places look like {unit}: {said}"
    return said


def find_exchange(tracks: Tracks, camera: Camera) -> int | None:
    """The frame in which the two balls of a clip exchange their numbers, or None.

    From the frame before it both together move less, by more than a radius, with their numbers exchanged back.
    """
    frame, one, two = _pair(tracks)
    stay = np.hypot(*np.diff(one, axis=0).T) + np.hypot(*np.diff(two, axis=0).T)
    swap = np.hypot(*(one[1:] - two[:-1]).T) + np.hypot(*(two[1:] - one[:-1]).T)
    wrong = (np.diff(frame) <= current_policy().max_exchange_frames) & (swap + camera.diameter_px / 2 < stay)
    return int(frame[1:][wrong][0]) if wrong.any() else None


def _pair(tracks: Tracks) -> tuple[NDArray[np.int64], Array, Array]:
    """Frames in which the two balls seen most are both seen, (k,), and where they are, px: (k, 2) and (k, 2)."""
    particles, counts = np.unique(tracks.particle, return_counts=True)
    chosen = particles[np.argsort(-counts, kind="stable")[:2]]
    if len(chosen) < 2:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros((0, 2))
    first, second = (np.flatnonzero(tracks.particle == p) for p in chosen)
    frame, one, two = np.intersect1d(tracks.frame[first], tracks.frame[second], return_indices=True)
    return frame, tracks.xy[first[one]], tracks.xy[second[two]]
