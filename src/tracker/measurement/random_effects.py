"""Random-effects means and regressions of measured values with unequal errors.

Each value is the mean, or the regression line, plus a deviation of its own with standard deviation tau (the scatter),
plus its error. Errors that several values share do not average out; they enter as effects per standard error.

- Scatter: Paule and Mandel (1982), J. Res. Natl. Bur. Stand. 87, 377: the generalised Q equals its degrees of freedom.
- Its interval: the Q profile of Viechtbauer (2007), Stat. Med. 26, 37.
- Error of the coefficients: Hartung and Knapp (2001), Stat. Med. 20, 3875, and Sidik and Jonkman (2002), Stat. Med. 21,
  3153, with Student's t. Their factor is at least one, as Roever, Knapp and Friede (2015), BMC Med. Res. Methodol. 15,
  99 recommend.
- I^2: the share of the scatter in the variance of a typical value, as in Higgins and Thompson (2002), Stat. Med. 21,
  1539. The Birge ratio is sqrt(Q/dof) without scatter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import chdtrc, chdtri, ndtri, stdtr, stdtrit

from synthcam_shared.arrays import Array


@dataclass(frozen=True, eq=False)
class RandomEffects:
    """A random-effects mean (p = 1) or regression (p > 1) of n values.

    Attributes
    ----------
    coefficients, std, low, high : (p,) array
        Of the columns of the design: values, standard errors, and intervals of 95 %.
    shared_std : (p,) array
        The part of `std` that comes from errors that several values share.
    p_value : (p,) array
        Probability of a coefficient at least as far from zero, if it is zero.
    scatter, scatter_low, scatter_high : float
        tau with its interval of 95 %; NaN where n = p.
    prediction : float
        Half width of the interval of 95 % in which the true value of one more case lies, about the mean; NaN of a
        regression, or with fewer than three values.
    q, dof, q_value : float, int, float
        Generalised Q without scatter, its degrees of freedom n - p, and the probability of a larger one.
    i2, birge : float
        Share of the scatter in the variance of a typical value, and sqrt(q/dof); NaN where n = p.
    factor : float
        Hartung and Knapp's factor of the squared errors, before it is limited to at least one.
    weights : (n,) array
        Share of each value in the fit of the mean; they add up to one.
    """

    coefficients: Array
    std: Array
    low: Array
    high: Array
    shared_std: Array
    p_value: Array
    scatter: float
    scatter_low: float
    scatter_high: float
    prediction: float
    q: float
    dof: int
    q_value: float
    i2: float
    birge: float
    factor: float
    weights: Array


class GeneralisedQ:
    """Weighted least squares at any variance of the scatter."""

    def __init__(self, value: Array, variance: Array, shared: Array, design: Array) -> None:
        self.value, self.variance, self.shared, self.design = value, variance, shared, design

    def weigh(self, tau2: float, left: Array, right: Array) -> Array:
        """left' V^-1 right, with the covariance V of the values: own errors, scatter and shared errors."""
        w = 1 / (self.variance + tau2)
        inner = np.eye(self.shared.shape[1]) + (self.shared.T * w) @ self.shared
        pull = np.linalg.solve(inner, (self.shared.T * w) @ right)
        return np.asarray((left.T * w) @ right - (left.T * w) @ self.shared @ pull)

    def fit(self, tau2: float) -> tuple[Array, Array, float]:
        """Coefficients, their covariance, and Q."""
        cov = np.asarray(np.linalg.inv(self.weigh(tau2, self.design, self.design)), dtype=np.float64)
        coefficients = cov @ self.weigh(tau2, self.design, self.value)
        off = self.value - self.design @ coefficients
        return coefficients, cov, float(self.weigh(tau2, off, off))

    def find_weights(self, tau2: float) -> Array:
        """The share of each value in the first coefficient."""
        pull = self.weigh(tau2, self.design, np.eye(len(self.value)))
        return np.asarray((self.fit(tau2)[1] @ pull)[0])

    def find_variance(self, target: float) -> float:
        """The variance of the scatter at which Q is `target`; 0 where even without scatter Q is not larger."""
        if len(self.value) <= self.design.shape[1] or not self.fit(0.0)[2] > target:
            return 0.0
        high = float(np.var(self.value)) + float(self.variance.min())
        while self.fit(high)[2] > target:
            high *= 4
        return float(brentq(lambda tau2: self.fit(tau2)[2] - target, 0.0, high, xtol=1e-12 * high))


def fit_random_effects(
    value: Array, std: Array, shared: Array | None = None, design: Array | None = None
) -> RandomEffects:
    """Fit a random-effects mean, or a regression on the columns of a design, with intervals of 95 %.

    value, std (n,): values and their own standard errors, above zero, without those that they share.
    shared (n, k): change of each value by one standard error of each shared error.
    design (n, p): columns of the regression, of rank p <= n; default: a column of ones.
    """
    n = len(value)
    design = np.ones((n, 1)) if design is None else design
    alone = np.zeros((n, 0))
    problem = GeneralisedQ(value, std**2, alone if shared is None else shared, design)
    own = GeneralisedQ(value, std**2, alone, design)
    dof, tail, q = n - design.shape[1], (1 - 0.95) / 2, problem.fit(0.0)[2]
    variance = problem.find_variance(dof)
    coefficients, whole, left = problem.fit(variance)
    factor = left / dof if dof else 1.0
    by_values = np.diag(own.fit(variance)[1])
    systematic = np.maximum(np.diag(whole) - by_values, 0.0)
    statistical = by_values * max(factor, 1.0)
    normal = -float(ndtri(tail))
    student = -float(stdtrit(dof, tail)) if dof else normal
    half, error = np.sqrt(student**2 * statistical + normal**2 * systematic), np.sqrt(statistical + systematic)
    bounds = [float(np.sqrt(problem.find_variance(chdtri(dof, p)))) if dof else np.nan for p in (tail, 1 - tail)]
    w = (std.min() / std) ** 2
    trace = w.sum() - np.trace(np.linalg.solve((design.T * w) @ design, (design.T * w**2) @ design))
    typical = float(dof * std.min() ** 2 / trace) if dof else np.nan  # variance of an error
    predicts = design.shape[1] == 1 and dof > 1
    return RandomEffects(
        coefficients=coefficients,
        std=error,
        low=coefficients - half,
        high=coefficients + half,
        shared_std=np.sqrt(systematic),
        p_value=np.asarray(2 * stdtr(dof, -np.abs(coefficients) / error) if dof else np.full(len(error), np.nan)),
        scatter=float(np.sqrt(variance)) if dof else np.nan,
        scatter_low=bounds[0],
        scatter_high=bounds[1],
        prediction=-float(stdtrit(dof - 1, tail) * np.hypot(variance**0.5, error[0])) if predicts else np.nan,
        q=q,
        dof=dof,
        q_value=float(chdtrc(dof, q)) if dof else np.nan,
        i2=variance / (variance + typical),
        birge=float(np.sqrt(q / dof)) if dof else np.nan,
        factor=factor,
        weights=problem.find_weights(variance),
    )


def fit_means_without_each(value: Array, std: Array, shared: Array) -> tuple[Array, Array, Array]:
    """Compute the mean, its variance and that of the scatter, (n,) each, without each of n >= 3 values in turn."""
    n = len(value)
    found = np.empty((n, 3))
    for k, rows in enumerate(~np.eye(n, dtype=bool)):
        rest = GeneralisedQ(value[rows], std[rows] ** 2, shared[rows], np.ones((n - 1, 1)))
        variance = rest.find_variance(n - 2)
        mean, cov, _ = rest.fit(variance)
        found[k] = mean[0], cov[0, 0], variance
    return found[:, 0], found[:, 1], found[:, 2]
