"""Fits of models to many billiard hits: numbers of each hit, numbers that all share, and scatters from hit to hit.

All numbers of all hits are fitted at once by Gauss-Newton steps; those of a hit are eliminated for the step of the
shared ones. Random effects count as data of value zero whose errors are their scatter, so chi^2 of a hit is that of its
positions with the scatter in their covariance. A scatter is the mean square of its effects plus their variances.

Some hits fit badly with any model. So a hit with chi^2 per degree of freedom of q > 1 has the weight 1/q for the
shared numbers, as if its errors were larger.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.real.hit_models import (
    NUMBERS,
    OF_SLIDE,
    OWN,
    POSITION,
    RANDOM,
    ROLLS_S,
    VELOCITY,
    Common,
    HitLaws,
    HitPositions,
    predict,
)
from synthcam_shared.arrays import Array, Flags, Ints

NOISE_M = 3e-4
END_PRIOR_S = (-0.2, 0.5)  # of the end of the striker's slide: mean and error
ANY_ANGLE_ERROR = 1.8  # rad, of any direction
PRIOR_ERRORS = {"slide_end": END_PRIOR_S[1], "acceleration_angle": ANY_ANGLE_ERROR} | dict.fromkeys(RANDOM, 1.0)
LARGEST_STEPS = {"t_c": 0.01, "x": 0.01, "y": 0.01, "normal": 0.3, "vx": 0.5, "vy": 0.5}  # s, m, rad, m/s
LARGEST_STEPS |= {"slide_end": 0.1, "acceleration_angle": 0.5} | dict.fromkeys(RANDOM, 2.0)
STARTING_ENDS_S = (-0.35, -0.2, -0.08, 0.03, 0.15)
FREE_NUMBERS = {"kick": 1.0, "slip": 1.0, "distance": 0.01}  # of hits without a law of the impact: errors all but free
SHARED_PRIORS = {"cloth": (0.2, 0.1), "loss": (0.04, 0.04), "drag": (0.01, 0.02), "hop": (0.0, 1.0)}  # mean, error


@dataclass(frozen=True)
class HitModel:
    """A model of hits: its laws, and the shared numbers and scatters that are fitted; `free`: no law of the impact."""

    laws: HitLaws
    shared: tuple[str, ...]
    scatters: tuple[str, ...] = ()
    free: bool = False

    @property
    def active(self) -> Ints:
        """The numbers of a hit that are fitted, as indices of NUMBERS."""
        named = set(OWN) - (set(OF_SLIDE) if self.laws.striker == "rolls" else set())
        named |= set(self.scatters) | (set(FREE_NUMBERS) if self.free else set())
        return np.flatnonzero([name in named for name in NUMBERS])

    @property
    def lost(self) -> int:
        """The degrees of freedom that the numbers of a hit take."""
        slides = self.laws.striker != "rolls"
        return len(OWN) - len(OF_SLIDE) + slides + (sum(name in FREE_NUMBERS for name in RANDOM) if self.free else 0)


@dataclass(frozen=True)
class HitFit:
    """A fit of n hits. cost: chi^2 (n,); log_volume: half the log determinant (n,) of the numbers' information."""

    model: HitModel
    common: Common
    own: Array
    cost: Array
    dof: Array
    log_volume: Array

    @property
    def ratio(self) -> Array:
        """Chi^2 per degree of freedom (n,)."""
        return self.cost / self.dof

    def log_densities(self, errors: Array) -> Array:
        """Log density (n,) of the positions of each hit, whose errors (n, m) all have one unknown factor."""
        log_errors = np.log(np.where(np.isfinite(errors), errors, 1.0)).sum(axis=1)
        return np.asarray(-log_errors - self.log_volume - self.dof / 2 * np.log(self.ratio))


@dataclass(frozen=True)
class _Linearised:
    """The residuals of hits near their numbers, whitened."""

    residual: Array  # (n, m)
    slope: Array  # (n, m, p)
    information: Array  # (n, p, p)
    descent: Array  # (n, p) half of the rate at which chi^2 falls with each number


@dataclass(frozen=True)
class _Problem:
    """The residuals of hits by one model, and their derivatives."""

    hits: HitPositions
    model: HitModel
    observed: Array  # (n, m) m
    weight: Array  # (n, m) 1/m, 0 where there is no coordinate
    active: Ints  # (p,) the numbers that are fitted, as indices of NUMBERS
    precision: Array  # (p,) of what is known of them
    largest_step: Array  # (p,)

    @classmethod
    def of(cls, hits: HitPositions, errors: Array, model: HitModel) -> _Problem:
        """State the problem; errors (n, m): standard errors of coordinates, m."""
        names = [NUMBERS[number] for number in model.active]
        return cls(
            hits=hits,
            model=model,
            observed=np.nan_to_num(hits.coordinates),
            weight=np.where(np.isfinite(hits.since) | (hits.since == -np.inf), 1 / errors, 0.0),
            active=model.active,
            precision=np.array([PRIOR_ERRORS.get(name, np.inf) for name in names]) ** -2.0,
            largest_step=np.array([LARGEST_STEPS[name] for name in names]),
        )

    def select(self, rows: Ints) -> _Problem:
        """State the same problem for hits that are selected by their indices, which may repeat."""
        return replace(self, hits=self.hits.select(rows), observed=self.observed[rows], weight=self.weight[rows])

    def move(self, own: Array, steps: Array) -> Array:
        """Change the numbers (n, q) of hits by steps (n, p) of the active ones, which are limited."""
        out = own.copy()
        out[:, self.active] += np.clip(steps, -self.largest_step, self.largest_step)
        return out

    def find_residuals(self, own: Array, common: Common) -> Array:
        found = np.nan_to_num(predict(self.hits, own, common, self.model.laws))
        return (self.observed - found) * self.weight

    def find_offsets(self, own: Array) -> Array:
        """How far the numbers (n, p) of hits are off what is known of them."""
        off = np.where(self.active >= len(OWN), own[:, self.active], 0.0)
        end = own[:, self.active] - END_PRIOR_S[0]
        return np.where((self.active == OWN.index("slide_end")) & (end > ROLLS_S / 2), end, off)

    def find_cost(self, own: Array, common: Common) -> Array:
        off = self.find_offsets(own)
        return np.asarray(np.sum(self.find_residuals(own, common) ** 2, axis=1) + off**2 @ self.precision)

    def linearise(self, own: Array, common: Common) -> _Linearised:
        """Linearise the residuals about the numbers (n, q) of hits."""
        residual = self.find_residuals(own, common)
        slope = self.differentiate(own, common, residual)
        information = slope.swapaxes(1, 2) @ slope + np.diag(self.precision)
        descent = _project(slope, residual) - self.precision * self.find_offsets(own)
        return _Linearised(residual, slope, information, descent)

    def differentiate(self, own: Array, common: Common, residual: Array) -> Array:
        """Derivatives (n, m, p) of the predictions, whitened."""
        out = np.empty((*residual.shape, len(self.active)))
        for k, number in enumerate(self.active):
            step = 1e-6 if number < len(OWN) else 1e-4
            moved = own.copy()
            moved[:, number] += step
            out[:, :, k] = (residual - self.find_residuals(moved, common)) / step
        return out

    def differentiate_shared(self, own: Array, common: Common, residual: Array) -> Array:
        """Derivatives (n, m, s) by the shared numbers of the model, whitened."""
        out = np.empty((*residual.shape, len(self.model.shared)))
        for k, name in enumerate(self.model.shared):
            moved = replace(common, numbers=common.numbers | {name: common.numbers[name] + 1e-6})
            out[:, :, k] = (residual - self.find_residuals(own, moved)) / 1e-6
        return out


def count_freedom(hits: HitPositions, model: HitModel) -> Array:
    """Degrees of freedom (n,) of each hit."""
    return np.asarray((~np.isnan(hits.since)).sum(axis=1) - model.lost)


def guess_numbers(hits: HitPositions) -> Array:
    """Guess numbers (n, s, p) of each hit: one start whose striker rolls, and one for each end of its slide."""
    count = len(hits.contact)
    own = np.zeros((count, 1 + len(STARTING_ENDS_S), len(NUMBERS)))
    slide_end, angle = OWN.index("slide_end"), OWN.index("acceleration_angle")
    own[:, 0, slide_end] = -0.6
    for k in range(count):
        t, xy = hits.striker_time[k], hits.striker[k]
        rows = np.isfinite(t) & (t < -0.01)
        later = np.isfinite(hits.struck_time[k])
        push = np.mean(hits.struck[k, later][:3], axis=0) - hits.rest[k]
        guess = own[k]
        guess[:, OWN.index("normal")] = np.arctan2(push[1], push[0])
        guess[:, POSITION] = hits.rest[k]
        for s, end in enumerate((None, *STARTING_ENDS_S)):
            slides = np.maximum(end - t[rows], 0.0) if end is not None else np.zeros(rows.sum())
            columns = [np.ones(rows.sum()), t[rows], *([slides**2 / 2] if slides.any() else [])]
            found = np.linalg.lstsq(np.column_stack(columns), xy[rows], rcond=None)[0]
            guess[s, VELOCITY] = found[1]
            if end is not None:
                guess[s, slide_end] = end
                if len(found) == 3:
                    guess[s, angle] = np.arctan2(found[2, 1], found[2, 0])
                    guess[s, VELOCITY] -= found[2] * max(end, 0.0)
    return own


def descend(problem: _Problem, own: Array, common: Common, steps: int) -> Array:
    """Take damped Gauss-Newton steps of the numbers (n, p) of each hit."""
    damp = np.full(len(own), 1e-3)
    cost = problem.find_cost(own, common)
    for _ in range(steps):
        at = problem.linearise(own, common)
        for _ in range(3):
            diagonal = damp[:, None] * np.einsum("npp->np", at.information) + 1e-9
            damped = at.information + diagonal[..., None] * np.eye(len(problem.active))
            tried = problem.move(own, np.linalg.solve(damped, at.descent[..., None])[..., 0])
            new = problem.find_cost(tried, common)
            better = new < cost
            own, cost = np.where(better[:, None], tried, own), np.where(better, new, cost)
            damp = np.where(better, damp / 10, damp * 10)
            if better.all():
                break
        damp = np.clip(damp, 1e-9, 1e4)
    return own


def _project(slope: Array, residual: Array) -> Array:
    """The products (n, p) of derivatives (n, m, p) and residuals (n, m)."""
    return np.asarray((residual[:, None] @ slope)[:, 0])


def start_hits(problem: _Problem, common: Common, starts: Array, steps: int = 12) -> Array:
    """Descend from each of the starts (n, s, p) of a hit, and take the lowest (n, p)."""
    count, many, _ = starts.shape
    tried = starts.reshape(count * many, -1).copy()
    rows = np.repeat(np.arange(count), many)
    wide = problem.select(rows)
    found = descend(wide, tried, common, steps)
    costs = wide.find_cost(found, common).reshape(count, many)
    return np.asarray(found.reshape(count, many, -1)[np.arange(count), np.argmin(costs, axis=1)])


def fit_model(
    hits: HitPositions,
    errors: Array,
    model: HitModel,
    common: Common,
    starts: Array,
    counted: Flags,
    *,
    turns: int = 15,
) -> HitFit:
    """Fit a model: numbers of all hits (n,), and shared numbers and scatters of those that are counted.

    errors (n, m): standard errors of coordinates, m. starts: numbers (n, s, p).
    """
    problem = _Problem.of(hits, errors, model)
    dof = count_freedom(hits, model)
    if model.free:
        common = replace(common, scatters=common.scatters | FREE_NUMBERS)
    own = start_hits(problem, common, starts)
    for turn in range(turns):
        own = descend(problem, own, common, 2)
        changed, common, own = _improve_common(problem, own, common, counted, dof)
        if changed < 0.05 and turn > 1:
            break
    own = descend(problem, own, common, 6)
    information = problem.linearise(own, common).information
    volume = np.linalg.slogdet(information)[1] / 2 - np.log(problem.precision[problem.precision > 0]).sum() / 2
    return HitFit(model, common, own, problem.find_cost(own, common), dof, volume)


def _improve_common(
    problem: _Problem, own: Array, common: Common, counted: Flags, dof: Array
) -> tuple[float, Common, Array]:
    """Take one step of the shared numbers and scatters; also the largest change of one, over its error, and own."""
    model, rows = problem.model, np.flatnonzero(counted)
    at = problem.linearise(own, common)
    by_shared = problem.differentiate_shared(own, common, at.residual)
    diagonal = np.einsum("npp->np", at.information)
    cross = at.slope.swapaxes(1, 2) @ by_shared
    cov = np.linalg.inv(at.information + 1e-9 * diagonal[..., None] * np.eye(len(problem.active)))
    weight = 1 / np.maximum(1.0, problem.find_cost(own, common) / dof)
    gain = cov @ cross
    matrix = by_shared.swapaxes(1, 2) @ by_shared - cross.swapaxes(1, 2) @ gain
    right = _project(by_shared, at.residual) - _project(gain, at.descent)
    total = np.tensordot(weight[rows], matrix[rows], 1)
    aim = weight[rows] @ right[rows]
    for k, name in enumerate(model.shared):
        if name in SHARED_PRIORS:
            mean, error = SHARED_PRIORS[name]
            total[k, k] += error**-2
            aim[k] += (mean - common.numbers[name]) / error**2
    step = np.linalg.solve(total, aim)
    changed = float(np.max(np.abs(step) * np.sqrt(np.diag(total)), initial=0.0))
    numbers = common.numbers | {n: common.numbers[n] + float(x) for n, x in zip(model.shared, step, strict=True)}
    moved = problem.move(own, -(gain @ step))
    scatters = dict(common.scatters)
    for name in model.scatters:
        parts = np.flatnonzero([NUMBERS[k] == name for k in problem.active])
        squares = (own[:, problem.active[parts]] ** 2 + np.einsum("npp->np", cov)[:, parts]).mean(axis=1)
        factor = float(np.sqrt(np.average(squares[rows], weights=weight[rows])))
        scatters[name] = max(common.scatters[name] * factor**1.7, 1e-5)  # the power makes it converge faster
        changed = max(changed, 10 * abs(float(np.log(factor))))
        moved[:, problem.active[parts]] *= common.scatters[name] / scatters[name]
    return changed, Common(numbers, scatters), moved


def measure_near_noise(hits: HitPositions, fit: HitFit, errors: Array, near: Flags, counted: Flags) -> float:
    """Measure the noise of coordinates beside the contact, m, by the residuals of a fit without a law of the impact.

    errors: with which it was fitted. near (n, m): the coordinates beside the contact.
    """
    problem = _Problem.of(hits, errors, fit.model)
    at = problem.linearise(fit.own, fit.common)
    lever = np.sum(at.slope @ np.linalg.inv(at.information) * at.slope, axis=2)
    weight = (counted / np.maximum(1.0, fit.ratio))[:, None] * (near & (problem.weight > 0))
    square = np.sum(weight * (at.residual * np.nan_to_num(errors)) ** 2) / np.sum(weight * (1 - lever))
    return float(np.sqrt(square))


def make_errors(hits: HitPositions, near: Flags | None = None, near_m: float = NOISE_M) -> Array:
    """Standard errors of coordinates (n, m), m: NOISE_M, and near_m where `near`; nan where there is none."""
    out = np.where(np.isnan(hits.since), np.nan, NOISE_M)
    return out if near is None else np.where(near & ~np.isnan(out), near_m, out)


def roll_throughout(starts: Array) -> Array:
    """The same starts of strikers that roll throughout."""
    out = starts[:, :1].copy()
    out[:, :, OWN.index("slide_end")] = ROLLS_S
    return out
