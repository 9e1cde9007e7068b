"""Recognises what was done to tracks before the search: rounding, dropped slow positions, uneven times, smoothing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from discrepancy.arrays import Array
from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import T_C
from discrepancy.data.notes import SearchNote, SearchNoteKind
from discrepancy.policy import current_policy


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
