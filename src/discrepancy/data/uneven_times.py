"""Moves positions at uneven times along their path to the even times at which the model predicts them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from discrepancy.arrays import Array, Ints
from discrepancy.data.notes import SearchNote, SearchNoteKind
from discrepancy.policy import current_policy
from tracker.camera.camera import Camera
from tracker.detection.link import Tracks


def find_clock_start(tracks: Tracks, camera: Camera) -> float:
    """Find the time at which frame 0 begins by the uneven times of tracks, s: the median over the frames."""
    off = tracks.time * camera.fps - tracks.frame
    return float(np.median(off)) / camera.fps if len(off) and np.all(np.isfinite(off)) else 0.0


def _frame_offsets(tracks: Tracks, camera: Camera) -> Array:
    """How far each position's time is off its frame number, frames, (n,); zeros where the tracks have no times."""
    off = (tracks.time - find_clock_start(tracks, camera)) * camera.fps - tracks.frame
    return off if np.all(np.isfinite(off)) else np.zeros(len(off))


def measure_unevenness(tracks: Tracks, camera: Camera) -> float:
    """Half the range of the times' offsets from an even rate, frames."""
    off = _frame_offsets(tracks, camera)
    return float(np.ptp(off) / 2) if len(off) else 0.0


def move_to_even_times(tracks: Tracks, balls: Sequence[Ints], t_c: float, ends: Array, camera: Camera) -> Tracks:
    """Move each ball's positions to the frames' even times.

    A ball's path is a parabola in time before the contact, while it slides, and while it rolls, since friction is
    constant in each. A parabola is fitted to each piece at the true times. A position then moves by what the parabola
    covers between its own time and the even one. The error of the parabola over part of a frame is small.

    A position is left out if its exposure, or that of the even time, contains the contact. So are those of a piece with
    fewer than 4 positions, which do not determine a speed.

    tracks: with their own times, which begin at frame 0. balls: rows (n,) of the target and of the striker; other rows
    are left out. t_c and ends (2,): the time of contact and the ends of both slides, s.
    """
    even, spans = tracks.frame / camera.fps, _frame_offsets(tracks, camera)
    first, last = even + np.minimum(spans, 0) / camera.fps, even + np.maximum(spans, 0) / camera.fps + camera.exposure
    moved, kept = tracks.xy, np.zeros(len(tracks.frame), dtype=bool)
    for rows, end in zip(balls, ends, strict=True):
        slid = tracks.time[rows] + camera.exposure / 2 > end  # a bend of the speed, not of the path
        before, after = last[rows] <= t_c, first[rows] >= t_c
        for piece in (rows[before], rows[after & ~slid], rows[after & slid]):
            if len(piece) < 4:
                continue
            centre = tracks.time[piece].mean()
            path = np.polynomial.polynomial.polyfit(tracks.time[piece] - centre, moved[piece], 2)
            at_even, at_own = (np.polynomial.polynomial.polyval(t[piece] - centre, path).T for t in (even, tracks.time))
            moved[piece] += at_even - at_own
            kept[piece] = True
    rows = np.flatnonzero(kept)
    some = {name: values[rows] for name, values in vars(tracks).items()}
    return replace(tracks, **some | {"x": moved[rows, 0], "y": moved[rows, 1], "time": even[rows]})


def note_uneven_times(tracks: Tracks, camera: Camera, clip: int) -> SearchNote | None:
    """A note where a clip's positions are too far off an even rate to be moved to even times, else None."""
    if np.abs(_frame_offsets(tracks, camera)).max(initial=0.0) <= current_policy().max_time_shift_frames:
        return None
    values = {"off": measure_unevenness(tracks, camera), "fps": camera.fps}
    return SearchNote(SearchNoteKind.UNEVEN_TIMES, clip, values=values)
