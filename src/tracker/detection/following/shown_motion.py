"""Measures how balls move in a film from steps that nobody can mistake, before they are linked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from synthcam_shared.arrays import Array, Ints
from tracker.camera.frames import pick_spread
from tracker.detection.glints import Glints


@dataclass(frozen=True)
class ShownMotion:
    """What the steps of a film show of the motion of its balls, in px and frames."""

    position_error: float  # px, along an axis
    acceleration: float = 0.0  # typical one along an axis, px per frame^2, beyond that of all
    fall: tuple[float, float] = (0.0, 0.0)  # acceleration that all balls have
    step: float = 0.0  # which 19 of 20 steps beyond doubt do not exceed, px per frame
    usual_share: float = 0.0  # share of steps beyond doubt


def measure_motion(glints: Glints, claimed_error: float) -> ShownMotion:
    """Measure the typical change of a velocity from frame to frame, and the error of positions.

    Shaken, driven or magnetic bodies turn between hits, and bodies fall in a film from the side. An encoder moves
    positions by more than their errors, and steps are uneven in a film that was converted to another frame rate. The
    changes are those of steps which nobody can mistake: both are to the nearest detection, and the next one is much
    farther.
    """
    least_steps, clear_sigma, clear_excess = 10, 5.0, 1.5
    turns, steps = _find_turns(glints)
    step, share = _find_usual_step(steps)
    if len(turns) < least_steps:
        return ShownMotion(claimed_error, step=step, usual_share=share)
    fall = np.median(turns[:, 0], axis=0)
    scatter = max(_measure_spread(turns[:, 0] - fall), claimed_error)
    if np.hypot(*fall) < clear_sigma * 1.25 * scatter / np.sqrt(len(turns)):
        fall = np.zeros(2)
    turns -= fall
    spread, error = _measure_spread(turns[:, 0]), claimed_error
    pairs = turns[np.isfinite(turns).all(axis=(1, 2))].sum(axis=1)
    if len(pairs) >= least_steps:
        # An error e and an acceleration a make 6 e^2 + a^2 of the variance of one change, and 4 e^2 + 2 a^2 of that of
        # two in succession, because the next change takes an error back.
        square = (2 * spread**2 - _measure_spread(pairs) ** 2) / 8
        # else it is a small difference of large numbers, or the claim is right
        if 6 * square > 0.5 * spread**2 and square > (clear_excess * claimed_error) ** 2:
            error = float(np.sqrt(square))
    acceleration = float(np.sqrt(max(spread**2 - 6 * error**2, 0.0)))
    return ShownMotion(error, acceleration, (float(fall[0]), float(fall[1])), step, share)


def _find_usual_step(steps: Array) -> tuple[float, float]:
    """The step and the share of steps of `ShownMotion`, by lengths (n,), px per frame, NaN in doubt.

    Two thirds of all steps or more must be beyond doubt. Otherwise fast balls are in doubt, and the others are slower
    than usual.
    """
    least_steps, least_share, most_share, quantile = 30, 2 / 3, 0.9, 0.95
    clear = steps[np.isfinite(steps)]
    if len(clear) < max(least_steps, least_share * len(steps)):
        return 0.0, 0.0
    return float(np.quantile(clear, quantile)), min(len(clear) / len(steps), most_share)


def _measure_spread(values: Array) -> float:
    """The standard deviation along an axis of vectors (n, 2), from their median length."""
    return float(np.median(np.hypot(*values.T)) / np.sqrt(2 * np.log(2)))


def _find_turns(glints: Glints) -> tuple[Array, Array]:
    """Changes of velocity (n, 2, 2), px per frame^2, each and the next one, NaN where the next is not clear.

    The second value has the lengths of the steps of many bodies, px per frame, NaN where they are not clear.
    """
    least_frames, most_frames, enough_positions = 8, 40, 4000  # many bodies in few frames show as much
    least_bodies, steady_share = 3, 0.5  # two bodies may be exchanged; change of a lone one's velocity over the sum
    order = np.argsort(glints.frame, kind="stable")
    seen, starts, bodies = np.unique(glints.frame[order], return_index=True, return_counts=True)
    ends, xy = starts + bodies, glints.xy
    wanted = min(max(least_frames, enough_positions * len(seen) // max(len(glints), 1)), most_frames)
    turns, lone, change, total = [np.empty((0, 2, 2))], list[Array](), list[float](), list[float]()
    lengths = [np.empty(0)]
    for k in pick_spread(range(len(seen) - 2), wanted) if len(seen) > 2 else []:
        counts = bodies[k : k + 3].tolist()
        if min(counts) < least_bodies and max(counts) > 1:
            continue
        places = [xy[order[start:end]] for start, end in zip(starts[k : k + 4], ends[k : k + 4], strict=True)]
        times = np.diff(seen[k : k + 4])
        steps = _chain_steps(places, times)
        if min(counts) >= least_bodies:
            turns.append(_measure_turns(steps, times))
            lengths.append(np.hypot(*steps[0].T))
        else:
            lone.append(_measure_turns(steps, times))
            change.append(float(np.hypot(*(steps[1] - steps[0])[0])))
            total.append(float(np.hypot(*(steps[1] + steps[0])[0])))
    if lone and np.median(change) < steady_share * np.median(total):  # specks that come and go are alone too
        turns += lone
    return np.concatenate(turns), np.concatenate(lengths)


def _chain_steps(places: Sequence[Array], times: Ints) -> list[Array]:
    """Velocities (n, 2), px per frame, of the bodies of the first frame from each to the next; NaN in doubt."""
    chain, steps = np.arange(len(places[0])), list[Array]()
    for one, other, time in zip(places, places[1:], times, strict=False):
        there = np.where(chain >= 0, _find_clear_steps(one, other)[chain], -1)
        steps.append(np.where((there >= 0)[:, None], other[there] - one[chain], np.nan) / time)
        chain = there
    return steps


def _measure_turns(steps: Sequence[Array], times: Ints) -> Array:
    """Changes (n, 2, 2) of these velocities, and the next ones where frames are evenly spaced, px per frame^2."""
    turn = 2 * (steps[1] - steps[0]) / (times[0] + times[1])
    following = np.full_like(turn, np.nan)
    if len(steps) > 2 and len(set(times.tolist())) == 1:
        following = (steps[2] - steps[1]) / times[0]
    both = np.stack([turn, following], axis=1)
    return np.asarray(both[np.isfinite(turn[:, 0])])


def _find_clear_steps(start: Array, end: Array) -> Ints:
    """The detection (n,) of the next frame to which each leads beyond doubt, or -1."""
    clear_share = 0.3  # of the distance to the second nearest detection, which such a step has at most
    if len(start) == len(end) == 1:
        return np.zeros(1, dtype=np.int64)
    away, to = (np.asarray(values) for values in cKDTree(end).query(start, k=2))
    back = np.asarray(cKDTree(start).query(end)[1])
    clear = (back[np.minimum(to[:, 0], len(end) - 1)] == np.arange(len(start))) & (
        away[:, 0] < clear_share * away[:, 1]
    )
    return np.where(clear, to[:, 0], -1)
