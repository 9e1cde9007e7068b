"""Checks and mends tracks before a fit: units, exchanged balls, strays, uneven times, and earlier processing."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import T_C
from discrepancy.data.notes import SearchNote, SearchNoteKind
from discrepancy.policy import current_policy
from synthcam_shared.arrays import Array, Ints
from tracker.camera.camera import Camera
from tracker.detection.link import Tracks
from tracker.tables.unit_check import find_common_frames


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


def _pair(tracks: Tracks) -> tuple[Ints, Array, Array]:
    """Frames (k,) in which the two balls seen most often are both seen, and their positions there, px, (k, 2) twice."""
    found = find_common_frames(tracks)
    if found is None:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros((0, 2))
    _, one, two, frame = found
    return frame, one, two


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

    tracks: with their own times, which begin at frame 0.
    balls: rows (n,) of the target and of the striker; other rows are left out.
    t_c and ends (2,): the time of contact and the ends of both slides, s.
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


def detect_processing(clips: Sequence[MeasuredCollision]) -> tuple[SearchNote, ...]:
    """Note each way in which these tracks were processed before the search, as far as the positions show it."""
    notes = []
    if step := _detect_grid(clips):
        notes.append(SearchNote(SearchNoteKind.ROUNDED, values={"step": step}))
    if least := _detect_thinning(clips):
        notes.append(SearchNote(SearchNoteKind.THINNED, values={"least_mm": 1e3 * least}))
    if moved := max((clip.max_shift_frames for clip in clips), default=0.0):
        notes.append(SearchNote(SearchNoteKind.MOVED_TO_EVEN_TIMES, values={"off": moved}))
    return tuple(notes)


def remove_filtered_rows(clip: MeasuredCollision) -> MeasuredCollision:
    """Remove the positions of smoothed tracks that the filter moved: near the contact, a gap, and either end."""
    reach = current_policy().smoothing_reach_frames
    kept = np.abs(clip.frame - clip.launch[T_C] * clip.fps) > reach
    for ball in (0, 1):
        rows = np.flatnonzero(clip.ball == ball)
        for part in np.split(rows, np.flatnonzero(np.diff(clip.frame[rows]) != 1) + 1):
            kept[part[:reach]] = kept[part[len(part) - reach :]] = False
    return clip.select(np.flatnonzero(kept))


def covers_contact(clip: MeasuredCollision) -> bool:
    """True if a smoothed clip, without its filtered positions, shows each ball's path on either side of the contact."""
    early = clip.frame < clip.launch[T_C] * clip.fps
    counts = [np.sum((clip.ball == ball) & (early == before)) for ball in (0, 1) for before in (True, False)]
    return bool(min(counts) >= current_policy().min_frames_before_contact)


def _detect_grid(clips: Sequence[MeasuredCollision], min_values: int = 30, share: float = 0.98) -> float:
    """The step, px, of a grid that holds this share of a clip's coordinates, if not small beside errors; else 0."""
    table_step = 1e-3  # px; a finer grid is only the rounding of the table
    steps = []
    for clip in clips:
        height = np.full((len(clip.xy), 1), clip.camera.radius)
        pixels = clip.camera.project(np.concatenate([clip.xy, height], axis=1))
        errors = float(np.median(clip.claimed_std())) / clip.camera.scale
        for values in pixels.T:
            rows = np.diff(np.unique(np.round(values / table_step)) * table_step)
            if len(rows) < min_values:
                continue
            step = float(rows.min())
            whole = np.abs(rows / step - np.round(rows / step)) < 0.02 + table_step / step
            coarse = step > current_policy().max_grid_step_to_error * errors
            steps.append(step if coarse and np.mean(whole) > share else 0.0)
    return float(np.median(steps)) if steps else 0.0


def _detect_thinning(clips: Sequence[MeasuredCollision], min_values: int = 30, share: float = 0.98) -> float:
    """The least step of moving balls, m, if in this share of the gaps the step would be smaller; else 0."""
    kept, gaps = list[Array](), list[Array]()
    for clip in clips:
        for ball in (0, 1):
            rows = np.flatnonzero(clip.ball == ball)
            frames, step = np.diff(clip.frame[rows]), np.hypot(*np.diff(clip.xy[rows], axis=0).T)
            moves = step > 1e-9  # m; a ball that moves less is at rest
            kept.append(step[moves & (frames == 1)])
            gaps.append((step / frames)[moves & (frames > 1)])
    steps, slow = np.concatenate(kept), np.concatenate(gaps)
    if len(slow) < min_values or len(steps) < min_values:
        return 0.0
    least = float(np.quantile(steps, 1 - share))
    return least if np.mean(slow < least) > share else 0.0
