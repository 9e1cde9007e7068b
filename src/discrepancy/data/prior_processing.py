"""What somebody has done to tracks: places rounded to a grid, left out where balls are slow, or at uneven times."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from discrepancy.arrays import Array
from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import T_C
from discrepancy.policy import current_policy

FEWEST = 30  # different numbers, to see a grid, and gaps, to see a rule in them
OFF = 0.02  # of a step: so far a number may lie beside the grid
MOST = 0.98  # of the numbers, or of the steps, that must follow the rule
REST = 1e-9  # m: what moves less between two frames rests
SLIGHT = 1e-3  # px: a finer grid is rounding of the table


def detect_processing(clips: Sequence[MeasuredCollision]) -> tuple[str, ...]:
    """A line for each thing that was done to the tracks of these clips, as far as they show it."""
    said = []
    if step := _detect_grid(clips):
        said.append(
            f"places are rounded to {step:.3g} px: their errors are not random, but hang on the place; give all digits"
        )
    if least := _detect_thinning(clips):
        said.append(
            f"places less than {1e3 * least:.3g} mm from the one before are left out: slow balls are hardly seen"
        )
    if moved := max((clip.max_shift_frames for clip in clips), default=0.0):
        said.append(
            f"frames are at uneven times, up to {moved:.2g} frames beside an even rate: places are moved along their "
            "paths to even times, and those at the contact are left out"
        )
    return tuple(said)


SMOOTHED = (
    "places have been smoothed by a filter, which moves them near hits, gaps and ends by more than their noise; give "
    "them as they were measured"
)

NOTHING_LEFT = "too few places of a ball before or after the contact are left without those that a filter moves"


def remove_filtered_rows(clip: MeasuredCollision) -> MeasuredCollision:
    """A clip without the places that a filter moves: near the contact, a gap, or where a ball is seen first or last."""
    reach = current_policy().smoothing_reach_frames
    kept = np.abs(clip.frame - clip.launch[T_C] * clip.fps) > reach
    for ball in (0, 1):
        rows = np.flatnonzero(clip.ball == ball)
        for part in np.split(rows, np.flatnonzero(np.diff(clip.frame[rows]) != 1) + 1):
            kept[part[:reach]] = kept[part[len(part) - reach :]] = False
    return clip.select(np.flatnonzero(kept))


def covers_contact(clip: MeasuredCollision) -> bool:
    """Whether each ball has places enough on either side of the contact to tell its way there."""
    early = clip.frame < clip.launch[T_C] * clip.fps
    counts = [np.sum((clip.ball == ball) & (early == before)) for ball in (0, 1) for before in (True, False)]
    return bool(min(counts) >= current_policy().min_frames_before_contact)


def _detect_grid(clips: Sequence[MeasuredCollision]) -> float:
    """The step of a grid, px, that all coordinates lie on and that is not small beside their errors; or 0."""
    steps = []
    for clip in clips:
        height = np.full((len(clip.xy), 1), clip.camera.radius)
        pixels = clip.camera.project(np.concatenate([clip.xy, height], axis=1))
        errors = float(np.median(clip.claimed_std())) / clip.camera.scale
        for values in pixels.T:
            rows = np.diff(np.unique(np.round(values / SLIGHT)) * SLIGHT)
            if len(rows) < FEWEST:
                continue
            step = float(rows.min())
            whole = np.abs(rows / step - np.round(rows / step)) < OFF + SLIGHT / step
            steps.append(
                step if np.mean(whole) > MOST and step > current_policy().max_grid_step_to_error * errors else 0.0
            )
    return float(np.median(steps)) if steps else 0.0


def _detect_thinning(clips: Sequence[MeasuredCollision]) -> float:
    """The least step of moving balls, m, where frames are missing just when it would be less; or 0."""
    kept, gaps = list[Array](), list[Array]()
    for clip in clips:
        for ball in (0, 1):
            rows = np.flatnonzero(clip.ball == ball)
            frames, step = np.diff(clip.frame[rows]), np.hypot(*np.diff(clip.xy[rows], axis=0).T)
            moves = step > REST
            kept.append(step[moves & (frames == 1)])
            gaps.append((step / frames)[moves & (frames > 1)])
    steps, slow = np.concatenate(kept), np.concatenate(gaps)
    if len(slow) < FEWEST or len(steps) < FEWEST:
        return 0.0
    least = float(np.quantile(steps, 1 - MOST))
    return least if np.mean(slow < least) > MOST else 0.0
