"""The free stretches to which a warp is fitted: a ball between two contacts slides, then rolls.

A stretch has a free start. Its acceleration is constant while it slides; then it loses speed evenly, along its own
direction. `FreeStretch` holds the residuals of this motion and what its own parameters can absorb.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from synthcam_shared.arrays import Array, Ints
from tracker.measurement.positions import BallTrack
from tracker.measurement.stretch_cuts import CUTTER, measure_path_noise


@dataclass(frozen=True)
class StretchRules:
    """Which stretches are fitted, and how."""

    min_positions: int = 10  # of a stretch
    max_seconds: float = 1.5  # longer ones are cut: spin, cloth and drag bend a path that lasts
    max_chi2: float = 30.0  # per degree of freedom; a stretch with more has a contact that was not seen
    slide_gain: float = 9.0  # reduction of chi^2 for which a stretch slides first
    slide_ends: int = 6  # ends of the slide that are tried in a stretch
    loss_scatter: float = 0.2  # least scatter of the deceleration of rolling, relative
    slide_scatter: float = 0.04  # least scatter of the acceleration of sliding, relative
    min_of_prior: int = 5  # stretches that show an acceleration


RULES = StretchRules()


@dataclass(frozen=True)
class FrictionPrior:
    """Losses and accelerations that stretches of one set have in common, each with its scatter, m/s^2."""

    loss: float
    loss_std: float
    slide: float
    slide_std: float

    @staticmethod
    def of(stretches: Sequence[FreeStretch]) -> FrictionPrior:
        """Estimate them by medians over stretches; the scatter is at least a share of the value.

        A slide counts by the chi^2 that it explains: noise and a warp make weak ones.
        """
        losses = np.array([one.loss for one in stretches if np.isfinite(one.loss)])
        sliding = [(one.slide, one.gain) for one in stretches if np.isfinite(one.slide)]
        slides, gains = np.array(sliding).reshape(-1, 2).T
        loss, loss_std = _median_and_scatter(losses, np.ones(len(losses)), RULES.loss_scatter)
        return FrictionPrior(loss, loss_std, *_median_and_scatter(slides, gains, RULES.slide_scatter))


def _median_and_scatter(values: Array, weights: Array, least: float) -> tuple[float, float]:
    """Weighted median, and weighted median distance from it as a standard deviation."""
    if len(values) < RULES.min_of_prior:
        return 0.0, float("inf")

    def median(of: Array) -> float:
        order = np.argsort(of)
        return float(of[order][np.searchsorted(weights[order].cumsum(), weights.sum() / 2)])

    middle = median(values)
    return middle, max(1.4826 * median(np.abs(values - middle)), least * abs(middle), 1e-12)


@dataclass(frozen=True, eq=False)
class FreeStretch:
    """n positions of one ball, and the residuals of its free motion.

    residual: position minus motion, x of all positions before y, then the distances from a prior, in standard errors.
    """

    time: Array  # (n,), s
    position: Array  # (n, 2), m
    std: Array  # (n,), m
    end: float  # until when the ball slides, s from the first position
    loss: float  # acceleration of rolling, m/s^2; NaN where there is none
    slide: float  # acceleration of sliding, the same
    gain: float  # chi^2 that the slide explains
    residual: Array  # (2n + e,)
    absorbed: Array  # (2n + e, p), orthonormal columns of what the motion can absorb

    @property
    def dof(self) -> int:
        """Degrees of freedom of the residuals."""
        return int(self.absorbed.shape[0] - self.absorbed.shape[1])

    @property
    def chi2(self) -> float:
        """Sum of squared residuals."""
        return float(self.residual @ self.residual)

    def project(self, columns: Array) -> Array:
        """Subtract from columns (2n, k), in standard errors, what the free motion absorbs: (2n + e, k)."""
        whole = np.concatenate([columns, np.zeros((len(self.residual) - len(columns), columns.shape[1]))])
        return np.asarray(whole - self.absorbed @ (self.absorbed.T @ whole))

    def fit_again(self, shift: Array, prior: FrictionPrior | None = None) -> FreeStretch:
        """Fit the motion again, to positions that are shifted by (n, 2) m; the residuals stay those without the shift.

        To first order in the shift, such residuals do not depend on the shift but for what the motion can absorb.
        """
        fitted = fit_stretch(self.time, self.position + shift, self.std, prior)
        moved = fitted.project((shift / self.std[:, None]).T.reshape(-1, 1))[:, 0]
        return replace(fitted, position=self.position, residual=fitted.residual - moved)


def find_free_stretches(balls: Sequence[BallTrack], diameter: float) -> list[FreeStretch]:
    """Find and fit the free stretches of the balls of one recording; diameter: m, or NaN if unknown."""
    noise, out = measure_path_noise((ball.frame, ball.position) for ball in balls), []
    for ball in balls:
        if len(ball) < RULES.min_positions or not np.isfinite(noise):
            continue
        changes = CUTTER.measure_kinks(ball.time, ball.position, noise)
        contacts = np.append(CUTTER.find_touches(ball, balls, diameter), CUTTER.find_kinks(ball.time, changes))
        for rows in CUTTER.cut(ball.time, ball.frame, contacts, float(np.median(np.diff(ball.time)))):
            pieces = max(int(np.ceil((ball.time[rows[-1]] - ball.time[rows[0]]) / RULES.max_seconds)), 1)
            for part in np.array_split(rows, pieces):
                if len(part) >= RULES.min_positions and CUTTER.moves(ball.time[part], ball.position[part], noise):
                    out += _fit_parts(ball, part, changes, noise)
    return out


def _fit_parts(ball: BallTrack, rows: Ints, changes: Array, noise: float) -> list[FreeStretch]:
    """Fit the motion of these rows; if it does not describe them, cut them where the velocity changes most."""
    if len(rows) < RULES.min_positions:
        return []
    found = fit_stretch(ball.time[rows], ball.position[rows], np.full(len(rows), noise))
    if found.chi2 < RULES.max_chi2 * found.dof or len(rows) < 2 * RULES.min_positions:
        return [found]
    inner = slice(CUTTER.kink_positions, len(rows) - CUTTER.kink_positions)
    middle = CUTTER.kink_positions + int(np.argmax(changes[rows][inner]))
    parts = rows[: middle - 1], rows[middle + 1 :]
    return [one for part in parts for one in _fit_parts(ball, part, changes, noise)]


def fit_stretch(time: Array, position: Array, std: Array, prior: FrictionPrior | None = None) -> FreeStretch:
    """Fit a free stretch by a motion that rolls all along, or slides first if that is much better."""
    duration = float(time[-1] - time[0])
    rolling = _fit(time, position, std, 0.0, prior)
    tried = [duration * (k + 1) / RULES.slide_ends for k in range(RULES.slide_ends)]
    first = min(tried, key=lambda end: _fit(time, position, std, end, steps=1).chi2)
    sliding = _fit(time, position, std, first, prior)
    gain = rolling.chi2 - sliding.chi2
    return replace(sliding, gain=gain) if gain > RULES.slide_gain else rolling


def _fit(
    time: Array, position: Array, std: Array, end: float, prior: FrictionPrior | None = None, steps: int = 6
) -> FreeStretch:
    """Fit the motion that slides until about `end`, s, and then rolls; with one step, exactly until then."""
    n, since = len(time), time - time[0]
    weight, target, loss = np.tile(1 / std, 2)[:, None], position.T.ravel(), 0.0
    acceleration: Array = np.zeros(2)
    along, slides = _unit((since - since.mean()) @ position), end > 0
    for step in range(steps):
        late = np.maximum(since - end, 0.0)
        rolls, turns = bool(late[-1] > 0), bool(late[-1] > 0) and slides and step > 0
        shapes = [np.ones(n), since]
        if slides:
            shapes.append(np.where(late > 0, end * (since - end / 2), since**2 / 2))
        columns = [np.outer(axis, shape).ravel() for shape in shapes for axis in np.eye(2)]
        if turns:  # another end of the slide
            columns.append(np.outer(acceleration + loss * along, late).ravel())
        if rolls:
            columns.append(-np.outer(along, late**2 / 2).ravel())
        rows, aims = np.column_stack(columns) * weight, target * weight[:, 0]
        if prior is not None:  # it draws the loss, and the acceleration along its own direction, to usual values
            if rolls:
                pull = np.zeros((1, rows.shape[1]))
                pull[0, -1] = 1 / prior.loss_std
                rows, aims = np.concatenate([rows, pull]), np.append(aims, prior.loss / prior.loss_std)
            if slides and step > 0:
                pull = np.zeros((1, rows.shape[1]))
                pull[0, 4:6] = _unit(acceleration) / prior.slide_std
                rows, aims = np.concatenate([rows, pull]), np.append(aims, prior.slide / prior.slide_std)
        solution = np.linalg.lstsq(rows, aims, rcond=None)[0]
        loss = float(solution[-1]) if rolls else 0.0
        if slides:
            acceleration = np.asarray(solution[4:6], dtype=np.float64)
        if turns and step < steps - 1:
            end = float(np.clip(end + solution[6], 0.3 * end, since[-1]))
        before, along = along, _unit(solution[2:4] + acceleration * end)  # in which it rolls on
        if turns and abs(solution[6]) < 1e-4 * since[-1] and np.abs(along - before).max() < 1e-6:
            break
    return FreeStretch(
        time=time,
        position=position,
        std=std,
        end=end,
        loss=loss if rolls else float("nan"),
        slide=float(np.hypot(*acceleration)) if slides else float("nan"),
        gain=0.0,
        residual=np.asarray(aims - rows @ solution),
        absorbed=np.linalg.qr(rows)[0],
    )


def _unit(vector: Array) -> Array:
    return np.asarray(vector / max(float(np.hypot(*vector)), 1e-300))
