"""One ball rolling by itself: its speed and the rolling loss a = -(drag v + decel)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from synthcam_shared.arrays import Array
from tracker.camera.camera import Camera
from tracker.measurement.camera_errors import camera_errors, differentiate_by_camera, effects_to_json, linear_response
from tracker.measurement.collision.collision_model import SHORTEST_EXPOSURE, roll_freely
from tracker.measurement.collision.least_squares import BROAD_PRIORS, covariance, find_best_minimum
from tracker.measurement.positions import BallTrack

PARAMETERS = ("x", "y", "heading", "v0", "drag", "decel")


@dataclass(frozen=True)
class LoneBallFit:
    """Fit of one rolling ball: PARAMETERS at the first frame it is seen in, covariance (6, 6), chi^2."""

    track: BallTrack
    parameters: Array
    cov: Array
    chi2: float
    dof: int

    def rolls_freely(self, sigma: float) -> bool:
        """True if chi^2 is that of a straight, slowing way, within so many of its standard deviations."""
        return bool(self.chi2 <= self.dof + sigma * np.sqrt(2 * self.dof))

    @property
    def loss(self) -> tuple[float, float]:
        """The rolling loss when the ball is first seen and its standard error, m/s^2.

        It may be well known where drag and decel, its two parts, are not.
        """
        _, _, _, v0, drag, decel = self.parameters.tolist()
        slope = np.array([drag, v0, 1.0])
        return drag * v0 + decel, float(np.sqrt(slope @ self.cov[-3:, -3:] @ slope))

    @property
    def moves(self) -> bool:
        """True if the ball surely moves, by 5 sigma of its speed, and not only its positions scatter."""
        return bool(self.parameters[3] > 5.0 * np.sqrt(self.cov[3, 3]))


class _Rolling:
    """Residuals of a straight, slowing way, averaged over each exposure."""

    def __init__(self, track: BallTrack) -> None:
        self.whiten, self.position = track.whiten, track.position
        self.exposure = max(track.exposure, SHORTEST_EXPOSURE)
        start = track.start - track.start[0]
        self.edges = np.concatenate([start, start + self.exposure])
        self.prior = [BROAD_PRIORS.get(name, (0.0, np.inf)) for name in PARAMETERS]

    def _model(self, x: Array) -> tuple[Array, Array]:
        d = np.array([np.cos(x[2]), np.sin(x[2])])
        across = np.array([-d[1], d[0]])
        roll = roll_freely(float(x[3]), float(x[4]), float(x[5]), self.edges)
        n = len(self.position)

        def mean(area: Array) -> Array:
            return (area[n:] - area[:n]) / self.exposure

        position = x[:2] + mean(roll.area)[:, None] * d
        slope = np.zeros((n, 2, 6))
        slope[:, 0, 0] = slope[:, 1, 1] = 1.0
        slope[:, :, 2] = mean(roll.area)[:, None] * across
        for i, part in ((3, roll.area_speed), (4, roll.area_drag), (5, roll.area_decel)):
            slope[:, :, i] = mean(part)[:, None] * d
        return position, slope

    def residual(self, x: Array) -> Array:
        off = self.whiten(self._model(x)[0] - self.position)
        return np.concatenate([off, [(v - c) / w for v, (c, w) in zip(x, self.prior, strict=True)]])

    def slope(self, x: Array) -> Array:
        rows = self.whiten(np.moveaxis(self._model(x)[1], -1, 0)).T
        return np.concatenate([rows, np.diag([1 / w for _, w in self.prior])])


def fit_lone_ball(track: BallTrack) -> LoneBallFit | None:
    """Fit the rolling of one ball by itself, that meets no other; None with fewer than four positions."""
    if len(track) < 4:
        return None
    span = track.start[-1] - track.start[0]
    step = (track.position[-1] - track.position[0]) / span
    begin = np.array([*track.position[0], np.arctan2(step[1], step[0]), np.hypot(*step), 0.0, 0.0])
    problem = _Rolling(track)
    best, _ = find_best_minimum(problem, [begin])
    off = problem.residual(best)[: 2 * len(track)]
    cov, chi2, dof = covariance(problem.slope(best)), float(off @ off), 2 * len(track) - 6
    return LoneBallFit(track, best, cov, chi2, dof)


def add_camera_errors_to_lone_ball(alone: LoneBallFit, camera: Camera) -> tuple[LoneBallFit, dict[str, Any]]:
    """Give the fit of one ball by itself the errors of the camera file; with `camera_errors.shared_block`."""
    errors, track, x = camera_errors(camera), alone.track, alone.parameters
    if not errors:
        return alone, {}
    moved = differentiate_by_camera(
        errors, lambda error, by: _Rolling(error.move_track(track, by, camera.fps)).residual(x)
    )
    problem = _Rolling(track)
    shift, _, explained = linear_response(problem.residual(x), problem.slope(x), alone.cov, moved)
    wider = replace(alone, cov=alone.cov + shift @ shift.T, chi2=alone.chi2 - explained)
    return wider, effects_to_json(camera, {"rolling": shift[-3:]})
