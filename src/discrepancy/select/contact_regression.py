"""Regressions of quantities of contacts, with the most likely scatter from contact to contact and errors they share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from synthcam_shared.arrays import Array, Flags, Ints

ODD_ERROR = 0.3  # standard error of restitution, friction, recoil and turn of such a contact


@dataclass(frozen=True, eq=False)
class Regression:
    """A regression with the most likely scatter; cost: -2 log likelihood, with the price of odd values."""

    value: Array
    std: Array  # of each value alone, without scatter
    variance: Array  # of each value alone, with the scatter
    shared: Array  # (n, k): the effects of errors that several values share
    design: Array
    scatter: float
    cost: float
    odd: Flags  # (n,): whether a value has a wide error
    odd_price: Array  # (n,): of each value that is odd

    @classmethod
    def of(cls, value: Array, std: Array, shared: Array, design: Array, odd_price: Array) -> Regression:
        """Fit the scatter, and take values (n,) as odd for their prices, one after the other, while that costs less."""
        odd = odd_price < 0
        fit = cls._of(value, std, shared, design, odd, odd_price)
        while (np.isfinite(odd_price) & ~odd).any():
            one = odd.copy()
            one[np.argmax(np.where(odd, -np.inf, fit._leave_out()[0] - odd_price))] = True
            other = cls._of(value, std, shared, design, one, odd_price)
            if other.cost >= fit.cost:
                break
            fit, odd = other, one
        return fit

    @classmethod
    def _of(cls, value: Array, own: Array, shared: Array, design: Array, odd: Flags, odd_price: Array) -> Regression:
        std, price = np.where(odd, np.hypot(own, ODD_ERROR), own), float(odd_price[odd].sum())

        def cost(log_scatter: float) -> float:
            return _cost(value, std**2 + np.exp(2 * log_scatter), shared, design)

        size = float(np.std(value[~odd])) + float(np.median(std[~odd])) if not odd.all() else ODD_ERROR
        best = minimize_scalar(cost, bounds=(np.log(1e-4 * size), np.log(10 * size)), method="bounded")
        none = _cost(value, std**2, shared, design)
        scatter = float(np.exp(best.x)) if best.fun < none - 1e-6 else 0.0
        cost_of_fit = min(float(best.fun), none) + price
        return cls(value, own, std**2 + scatter**2, shared, design, scatter, cost_of_fit, odd, odd_price)

    def predict(self) -> Array:
        """Predict the values (n,) by the law."""
        return np.asarray(self.design @ self.coefficients)

    @property
    def coefficients(self) -> Array:
        """The numbers of the law."""
        white = _whiten(self.variance, self.shared, self.value, self.design)[0]
        return np.asarray(np.linalg.lstsq(white[:, 1:], white[:, 0], rcond=None)[0])

    def compare(self, other: Regression, recordings: Ints) -> float:
        """Sigma of the gain of another fit on values that were left out, as `find_gain_sigma` says."""
        return find_gain_sigma(other._log_densities() - self._log_densities(), recordings)

    def find_log_densities(self, value: Array, std: Array, design: Array) -> Array:
        """Find the log density (n,) of other values, without the constant of normal errors."""
        variance = std**2 + self.scatter**2
        return np.asarray(-((value - design @ self.coefficients) ** 2 / variance + np.log(variance)) / 2)

    def _log_densities(self) -> Array:
        """Log predictive density of each value by all others; errors that they share leave its differences alone."""
        squares, share = self._leave_out()
        price = np.where(self.odd, self.odd_price, 0.0)
        return np.asarray(-0.5 * (squares + np.log(self.variance / share) + price))

    def _leave_out(self) -> tuple[Array, Array]:
        """Squared deviations (n,) of values from their predictions by all others, over the variance; and its share."""
        root = 1 / np.sqrt(self.variance)
        q, _ = np.linalg.qr(self.design * root[:, None])
        share = 1 - np.minimum((q**2).sum(axis=1), 0.999)
        left = self.value * root
        left = left - q @ (q.T @ left)
        return np.asarray(left**2 / share), share


def find_gain_sigma(gain: Array, recordings: Ints) -> float:
    """Find the sigma of a gain (n,) in log density, by its scatter between recordings."""
    each = np.array([gain[recordings == k].sum() for k in np.unique(recordings)])
    scatter = float(np.std(each, ddof=1)) if len(each) > 1 else 0.0
    return float(each.sum()) / (scatter * len(each) ** 0.5) if scatter > 0 else 0.0


def _cost(value: Array, variance: Array, shared: Array, design: Array) -> float:
    white, log_determinant = _whiten(variance, shared, value, design)
    q, _ = np.linalg.qr(white[:, 1:])
    left = white[:, 0] - q @ (q.T @ white[:, 0])
    return float(left @ left + log_determinant)


def _whiten(variance: Array, shared: Array, value: Array, design: Array) -> tuple[Array, float]:
    """Whiten values and design, as columns of one array; and the logarithm of the covariance's determinant."""
    factor = np.linalg.cholesky(np.diag(variance) + shared @ shared.T)
    white = np.linalg.solve(factor, np.column_stack([value, design]))
    return np.asarray(white), float(2 * np.log(np.diag(factor)).sum())
