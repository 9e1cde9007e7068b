"""Fits of the motion outside a contact that lasts, and the quantities that follow.

Two results follow from the fitted paths alone, without a law of the force. The duration is the time for which the
centres are nearer than one diameter D. The ratio of radial speeds compares how fast they leave and enter D. A force
that springs back gives back what a constant push costs, so that this ratio is the restitution. Plate friction, which
acts from the first touch on, is such a push. So is the centrifugal acceleration in an oblique hit, the other way. A
force that loses energy gives back a part of it; see `force_laws`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from synthcam_shared.arrays import Array
from tracker.measurement.collision.collision_model import AFTER, compute_unit_vectors
from tracker.measurement.collision.derived import (
    QUANTITY_NAMES,
    DerivedValues,
    derive_from_free,
    derive_from_tied,
    dot,
)
from tracker.measurement.collision.force_laws import solve_restitutions
from tracker.measurement.collision.lasting_motion import LastingResiduals, rewind_slides, time_before_crossing
from tracker.measurement.collision.least_squares import (
    FINE_TOLERANCE,
    BallPair,
    CollisionFit,
    covariance,
    find_best_minimum,
)
from tracker.measurement.positions import BallTrack


@dataclass(frozen=True)
class LastingFit:
    """One motion fitted to the frames outside a contact."""

    problem: LastingResiduals
    x: Array  # (p,), as in `LastingResiduals`
    cov: Array  # (p, p)
    chi2: float
    dof: int
    converged: bool

    @staticmethod
    def to(
        pair: BallPair,
        kind: str,
        starts: list[Array],
        friction: float | None = None,
        tolerance: float = FINE_TOLERANCE,
    ) -> LastingFit:
        """Fit a motion from starts (p,); tolerance: as for `find_best_minimum`."""
        problem = LastingResiduals(pair, kind, friction)
        best, converged = find_best_minimum(problem, starts, tolerance)
        residual, rows = problem(best)
        n = 2 * len(pair)
        chi2 = float(residual[:n] @ residual[:n])
        return LastingFit(problem, best, covariance(rows), chi2, n - len(best) + problem.laws_of_force, converged)

    @property
    def diameter(self) -> float:
        """The balls' diameter, m."""
        return self.problem.pair.diameter

    @property
    def free(self) -> Array:
        """(22,) parameters."""
        return self.to_free(self.x)

    @property
    def tied(self) -> tuple[Array, Array]:
        """Parameters (16,) of a tied motion, and their covariance."""
        n = len(self.problem.index)
        return self.problem.whole(self.x[:n]), self.problem.whole_cov(self.cov[:n, :n])

    def to_free(self, x: Array) -> Array:
        """The free parameters (..., 22) of x (..., p)."""
        return np.asarray(self.problem.to_free(x), dtype=np.float64)

    def slopes(self, function) -> Array:  # type: ignore[no-untyped-def]
        """Derivatives (m, p) of a function of x (..., p)."""
        size = 0.01 * np.sqrt(np.diag(self.cov))
        moved = function(self.x + np.diag(size)) - function(self.x - np.diag(size))
        return np.asarray((moved / (2 * size[:, None])).T, dtype=np.float64)

    def times(self, x: Array) -> Array:
        """(..., 2) of x (..., p): seconds from the first touch to t_c, and from t_c to the end."""
        return np.stack(self._passage(x)[:2], -1)

    def _passage(self, x: Array) -> tuple[Array, Array, Array, Array]:
        """Return times from the first touch to t_c and on to the end, s, and radial speeds at both; x: (..., p)."""
        free = self.to_free(x)
        d, n, t = (np.asarray(a, dtype=np.float64) for a in compute_unit_vectors(free[..., 3], free[..., 4]))
        v0, distance = free[..., 5], x[..., -1]
        before = np.asarray(time_before_crossing(free[..., 4], v0, distance, self.diameter), dtype=np.float64)
        coming = n * distance[..., None] + d * (v0 * before)[..., None]
        closing = v0 * dot(d, coming) / self.diameter
        start, least = n * distance[..., None] + t * x[..., -2, None], 0.02 * closing
        parting = dot(free[..., 8:10] - free[..., 13:15], n)
        after = (self.diameter - distance) / np.maximum(parting, least)
        longest = np.abs(self.diameter - distance) / least
        for _ in range(4):  # Newton's steps to the time at which they are a diameter apart
            apart, speed = _part(free, start, after)
            size = np.hypot(apart[..., 0], apart[..., 1])
            slope = np.maximum(dot(apart, speed) / size, least)
            after = np.clip(after - (size - self.diameter) / slope, -longest, longest)
        apart, speed = _part(free, start, after)
        return before, after, closing, dot(apart, speed) / np.hypot(apart[..., 0], apart[..., 1])

    def at_touch(self, x: Array) -> Array:
        """The free parameters (..., 22) of x (..., p), the slides beginning at the first touch."""
        free = self.to_free(x)
        return free if self.problem.kind == "straight" else rewind_slides(free, self.times(x)[..., 0])

    def restitution(self, x: Array) -> Array:
        """(..., 2): the restitution, as the mean by five laws of the force, and their standard deviation."""
        free = self.to_free(x)
        before, after, closing, parting = self._passage(x)
        n = np.asarray(compute_unit_vectors(free[..., 3], free[..., 4])[1], dtype=np.float64)
        at_crossing = dot(free[..., 8:10] - free[..., 13:15], n)
        late = free if self.problem.kind == "straight" else rewind_slides(free, -after)
        lost = (at_crossing - dot(late[..., 8:10] - late[..., 13:15], n)) / closing
        offset = np.clip(x[..., -1] * np.sin(free[..., 4]) / self.diameter, -0.95, 0.95)
        lasts = np.maximum(before + after, 0.0)
        pressed = lost * lasts / np.maximum(after, 1e-3 * lasts + 1e-9)
        every = (parting / closing, pressed, offset / np.sqrt(1 - offset**2), closing * lasts / self.diameter)
        r = solve_restitutions(*(np.ravel(each) for each in every)).reshape(*np.shape(lasts), 5)
        return np.stack([r.mean(axis=-1), r.std(axis=-1)], -1)

    @cached_property
    def values(self) -> DerivedValues:
        """The quantities that it determines."""
        if self.problem.kind == "tied":
            found = derive_from_tied(*self.tied, self.diameter, self.problem.pair.spin)
        else:
            slope = self.slopes(self.at_touch)
            with np.errstate(invalid="ignore", divide="ignore"):  # without a slide there is no friction
                found = derive_from_free(self.at_touch(self.x), slope @ self.cov @ slope.T, self.diameter)
        return self._with_restitution(found)

    def _with_restitution(self, found: DerivedValues) -> DerivedValues:
        """The quantities with r, its error by the law of the force, and with b in diameters."""
        value, cov = found.value.copy(), found.cov.copy()
        b, r = QUANTITY_NAMES.index("b"), QUANTITY_NAMES.index("r")
        distance = float(self.x[-1]) / self.diameter
        value[b], cov[b], cov[:, b] = value[b] * distance, cov[b] * distance, cov[:, b] * distance
        cov[b, b] += (value[b] * float(np.sqrt(self.cov[-1, -1])) / self.diameter) ** 2
        size = 0.01 * np.sqrt(np.diag(self.cov))
        moves = np.concatenate([0 * size[None], np.diag(size), -np.diag(size)])  # at once: the integration is slow
        found_r = self.restitution(self.x + moves)
        high, low = np.split(found_r[1:, 0], 2)
        by = (high - low) / (2 * size)
        value[r], error = found_r[0]
        cov[r, r] = float(by @ self.cov @ by) + error**2
        if self.problem.kind == "tied":  # laws that push late delay slides more, and keep more of the speed
            cov[r, r] += 2 * error * abs(by @ self.cov[:, -4])
        return replace(found, value=value, cov=cov)

    def predict_left_out(self, rows: BallTrack, ball: int) -> tuple[Array, Array]:
        """Positions (n, 2) that were left out, less those of an instantaneous contact, and derivatives (n, 2, p)."""
        position, slope = self.problem.predict(self.x, np.full(len(rows), ball), rows.start)
        return rows.position - position, slope


def _part(free: Array, start: Array, time: Array) -> tuple[Array, Array]:
    """Separation (..., 2) and its rate, `time` (...) s after the paths cross at the separation `start` (..., 2)."""
    apart, speed = start, np.zeros_like(start)
    for sign, at in zip((1, -1), AFTER.values(), strict=True):
        v, f, tau = free[..., at : at + 2], free[..., at + 2 : at + 4], np.exp(free[..., at + 4])
        slid = np.minimum(time, tau)[..., None]
        bend = (f - v) / tau[..., None]
        apart = apart + sign * (v * slid + bend * slid**2 / 2 + f * (time[..., None] - slid))
        speed = speed + sign * (v + bend * slid)
    return apart, speed


def as_free_fit(fit: LastingFit) -> CollisionFit:
    """A free fit as those of instantaneous contacts at the distance where the paths cross."""
    slope = fit.slopes(fit.to_free)
    pair = replace(fit.problem.pair, diameter=float(fit.x[-1]))
    return CollisionFit(fit.free, slope @ fit.cov @ slope.T, fit.chi2, fit.dof, pair, 0, fit.converged)
