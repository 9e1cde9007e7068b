"""The rolling loss of a film: how balls slow down on their free paths, after the slides that contacts begin."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from synthcam_shared.arrays import Array
from tracker.gas.free_paths import FreePath
from tracker.measurement.positions import BallTrack
from tracker.measurement.random_effects import fit_random_effects

MIN_POSITIONS = 10  # of the rolling part of a path
MIN_PATHS = 5  # of a film that shows its rolling loss
MIN_PATHS_OF_DRAG = 8  # and how it grows with the speed; fewer would let one fast path decide
MAX_SIGMA = 3.0  # by which residuals, and an acceleration across the path, may exceed the noise
MIN_SIGMA_OF_SPEED = 10.0  # of a path: below, its direction is not known
MIN_SPEED_OVER_CHANGE = 0.75  # mean speed of a path over the change of its speed; 0.5: the ball stops at its end
MAX_SCATTER = 0.3  # of the loss from path to path, over it; balls that still slide, or are hit unseen, have more
NAMES = ("rolling_speed", "rolling_loss", "rolling_drag", "rolling_loss_std", "rolling_drag_std")


class _Slowing(NamedTuple):
    """The rolling part of one path: mean speed, m/s, deceleration along it and its error, m/s^2, and duration, s."""

    speed: float
    loss: float
    std: float
    duration: float


def measure_rolling_loss(balls: Sequence[BallTrack], paths: Sequence[FreePath], noise: float) -> dict[str, float]:
    """Measure the deceleration of balls that roll, or glide on air, by a random-effects regression over free paths.

    rolling_loss: m/s^2, at rolling_speed (m/s), where the paths show it best. rolling_drag: how it grows with the
    speed, 1/s. Both have NAME_std. A film has NaN with too few paths, or with paths that disagree. Paths that are so
    slow that the ball may rest at their end do not count.

    paths: of these balls, with the instants from which they roll. noise: of a coordinate, m.
    """
    tracks, found = {ball.particle: ball for ball in balls}, list[_Slowing]()
    for path in paths:
        ball = tracks[path.ball]
        rows = np.searchsorted(ball.frame, path.frame)
        rolls = (path.time >= path.rolls_from) & (path.time <= path.rolls_until)
        if np.count_nonzero(rolls) >= MIN_POSITIONS:
            slowing = _fit_slowing(path.time[rolls], ball.position[rows[rolls]], noise)
            found += [slowing] if slowing else []
    speed, loss, std, duration = np.array(found).reshape(-1, 4).T
    moves = np.ones(len(found), dtype=bool)
    for _ in range(3):  # each with the loss of the paths that move in the last
        paths_left = np.count_nonzero(moves)
        if paths_left < MIN_PATHS:
            return dict.fromkeys(NAMES, float("nan"))
        middle = float(np.average(speed[moves], weights=1 / std[moves] ** 2))
        terms = 2 if paths_left >= MIN_PATHS_OF_DRAG else 1
        design = np.column_stack([np.ones(len(loss)), speed - middle])[:, :terms]
        fit = fit_random_effects(loss[moves], std[moves], design=design[moves])
        moves = speed > MIN_SPEED_OVER_CHANGE * design @ fit.coefficients * duration
    if fit.scatter > MAX_SCATTER * abs(fit.coefficients[0]):
        return dict.fromkeys(NAMES, float("nan"))
    value, error = (np.append(each, np.full(2 - terms, np.nan)) for each in (fit.coefficients, fit.std))
    return dict(zip(NAMES, map(float, (middle, *value, *error)), strict=True))


def _fit_slowing(time: Array, position: Array, noise: float) -> _Slowing | None:
    """Fit a cubic to a path; None if it rests, or shows something else than slowing by its residuals or a bend.

    The cubic term is odd about the middle, so that the error of the deceleration there is that of a parabola.
    """
    duration, middle = float(time[-1] - time[0]), (time[0] + time[-1]) / 2
    design = (time - middle)[:, None] ** np.arange(4)
    inverse = np.linalg.inv(design.T @ design)
    _, velocity, half, _ = coefficients = inverse @ design.T @ position
    chi2, dof = float(((position - design @ coefficients) ** 2).sum()) / noise**2, 2 * len(time) - 8
    speed, std = float(np.hypot(*velocity)), 2 * noise * float(np.sqrt(inverse[2, 2]))
    if not speed > MIN_SIGMA_OF_SPEED * noise * np.sqrt(inverse[1, 1]):
        return None
    along, across = velocity @ half * 2 / speed, (velocity[0] * half[1] - velocity[1] * half[0]) * 2 / speed
    if chi2 > dof + MAX_SIGMA * np.sqrt(2 * dof) or abs(across) > MAX_SIGMA * std:
        return None
    return _Slowing(speed, -float(along), std, duration)
