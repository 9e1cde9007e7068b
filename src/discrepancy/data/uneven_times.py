"""Places at uneven times, moved along their own path to the even times that a simulation is compared at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from discrepancy.arrays import Array, Ints
from discrepancy.policy import current_policy
from tracker.camera.camera import Camera
from tracker.detection.link import Tracks

FEWEST = 4  # places of a piece, for the parabola that tells its speed
DEGREE = 2  # a ball that slides, and one that rolls, slows down evenly


def find_clock_start(tracks: Tracks, camera: Camera) -> float:
    """What the clock of its times shows where frame 0 would begin, s: in the median of all frames."""
    off = tracks.time * camera.fps - tracks.frame
    return float(np.median(off)) / camera.fps if len(off) and np.all(np.isfinite(off)) else 0.0


def _frame_offsets(tracks: Tracks, camera: Camera) -> Array:
    """By how many frames each place lies beside its number over the rate, (n,); zeros without times of its own."""
    off = (tracks.time - find_clock_start(tracks, camera)) * camera.fps - tracks.frame
    return off if np.all(np.isfinite(off)) else np.zeros(len(off))


def measure_unevenness(tracks: Tracks, camera: Camera) -> float:
    """By how much its times lie beside an even rate, frames."""
    off = _frame_offsets(tracks, camera)
    return float(np.ptp(off) / 2) if len(off) else 0.0


def move_to_even_times(tracks: Tracks, balls: Sequence[Ints], t_c: float, ends: Array, camera: Camera) -> Tracks:
    """Tracks with each ball's places moved to the frames' even times.

    Each ball's path is a parabola in time before the contact, while it slides, and while it rolls; one is fitted to
    each piece at the true times, and a place is moved by what the parabola covers between its time and the even one.
    The parabola's own error is that of a speed over a part of a frame: small beside a place's. Left out are places
    whose exposure, or that of the even time, holds the contact, and those of a piece too short to tell a speed.

    Parameters
    ----------
    tracks : Tracks
        With times of their own, that begin at frame 0.
    balls : sequence of (n,) arrays of int
        Rows of the target, and of the striker.
    t_c : float
        s.
    ends : (2,) array
        When each ball stops sliding, s.
    camera : Camera

    Returns
    -------
    Tracks
        Of these two balls.
    """
    even, spans = tracks.frame / camera.fps, _frame_offsets(tracks, camera)
    first, last = even + np.minimum(spans, 0) / camera.fps, even + np.maximum(spans, 0) / camera.fps + camera.exposure
    moved, kept = tracks.xy, np.zeros(len(tracks.frame), dtype=bool)
    for rows, end in zip(balls, ends, strict=True):
        slid = tracks.time[rows] + camera.exposure / 2 > end  # a bend of the speed, not of the path
        before, after = last[rows] <= t_c, first[rows] >= t_c
        for piece in (rows[before], rows[after & ~slid], rows[after & slid]):
            if len(piece) < FEWEST:
                continue
            centre = tracks.time[piece].mean()
            path = np.polynomial.polynomial.polyfit(tracks.time[piece] - centre, moved[piece], DEGREE)
            at_even, at_own = (np.polynomial.polynomial.polyval(t[piece] - centre, path).T for t in (even, tracks.time))
            moved[piece] += at_even - at_own
            kept[piece] = True
    rows = np.flatnonzero(kept)
    some = {f.name: getattr(tracks, f.name)[rows] for f in fields(tracks)}
    return replace(tracks, **some | {"x": moved[rows, 0], "y": moved[rows, 1], "time": even[rows]})


def explain_too_uneven(tracks: Tracks, camera: Camera) -> str | None:
    """Why the places of a clip cannot be moved to even times, or None."""
    if np.abs(_frame_offsets(tracks, camera)).max(initial=0.0) <= current_policy().max_time_shift_frames:
        return None
    off = measure_unevenness(tracks, camera)
    return f"its times are up to {off:.2g} frames beside an even rate of {camera.fps:g} a second"
