"""The least error of error bars that any rule can reach for a quantity that depends on an uncertain difference.

python -m benchmarks.tracker.averaging_bound [--rms 0.94 1.0]

A quantity q depends on a parameter d that is zero or not, and that is measured with the error s. A rule gives the mean
m(z) and the variance V(z) of d from z = d/s, as the average over both models does. Then q has the error
(m - d) e + n, e its dependence on d, n its error if d is known. The claimed variance is that of n plus e^2 V.

A rule is judged by three numbers:

- the rms z of q at d = 0, and its largest rms z at any d from 1 to 5 s;
- the mean claimed error at d = 0, over that of a fit that knows that d is 0;
- the largest mean claimed error at any other d, over that of a fit in which d is free.

The script computes these numbers for the rule of `tracker.measurement.collision.departures`. It considers all rules
that claim no larger errors, and have an rms z of --rms at d = 0. It prints the least value that their largest rms z can
have. The problem is convex in 1/(claimed variance) and m/(claimed variance). So its dual gives the bound exactly, but
for the grids of z and d. Values of |z| over 4.89 are misfits and do not count.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from tracker.measurement.collision.departures import find_posterior

Floats = NDArray[np.float64]

# e s over the error of n, and scale of the prior over s: of v0 and the rolling losses, tenths of 200 collisions of
# scenes/benchmark.yaml with noise of 0.01 px, ordered by the first
HITS = np.array(
    [
        *[(0.23, 2.3), (0.53, 10.8), (0.66, 8.0), (0.78, 11.6), (0.91, 17.7)],
        *[(1.04, 20.8), (1.19, 19.2), (1.32, 19.6), (1.65, 14.8), (2.03, 12.7)],
    ]
)
SIZES = np.r_[0.0, np.arange(1.0, 5.01, 0.5)]  # of d, in s
Z = np.arange(-4.875, 4.89, 0.05)


def densities(sizes: Floats) -> Floats:
    """Probabilities (d, z) of the measured values."""
    weights = np.exp(-((Z - sizes[:, None]) ** 2) / 2)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True), dtype=np.float64)


class Bound:
    """The largest rms z that no rule can avoid, by the dual of a convex problem."""

    def __init__(self) -> None:
        plus, minus = densities(SIZES), densities(-SIZES)
        self.even, self.odd = (plus + minus) / 2, (plus - minus) / 2 * SIZES[:, None]
        self.share = HITS[:, 0]

    def widths(self, widened: Floats) -> Floats:
        """Mean errors (d,) from claimed variances (hits, z), over those of fits that know d, or leave it free."""
        of_fit = np.where(SIZES == 0, 1.0, np.sqrt(1 + self.share[:, None] ** 2))  # (hits, d)
        return np.asarray((np.sqrt(widened) @ self.even.T / of_fit).mean(axis=0), dtype=np.float64)

    def dual(self, x: Floats, squares: Floats, widths: Floats) -> tuple[float, Floats]:
        """Value and gradient of the dual at multipliers of both kinds of limits, (2 d,)."""
        n = len(SIZES)
        by_square, by_width = x[:n], x[n:]
        sum0 = by_square @ self.even
        mean = (by_square @ self.odd) / np.maximum(sum0, 1e-300)
        spread = np.maximum((by_square * SIZES**2) @ self.even - mean**2 * sum0, 0.0)
        of_fit = np.where(SIZES == 0, 1.0, np.sqrt(1 + self.share[:, None] ** 2))
        price = (by_width / of_fit) @ self.even  # (hits, z)
        error = sum0 + self.share[:, None] ** 2 * spread
        widened = np.maximum(1.0, (2 * error / np.maximum(price, 1e-300)) ** (2 / 3))
        off = mean**2 * self.even - 2 * mean * self.odd + (SIZES**2)[:, None] * self.even  # (d, z)
        reached = ((self.even + self.share[:, None, None] ** 2 * off) / widened[:, None]).sum(axis=2).mean(axis=0)
        slack = np.r_[reached - squares, self.widths(widened) - widths]
        return float(x @ slack), slack

    def is_excluded(self, squares: Floats, widths: Floats) -> bool:
        """Test whether no rule keeps both kinds of limits: a positive value of the dual proves it."""
        starts = (np.zeros(2 * len(SIZES)), np.r_[3 - abs(SIZES - 2), np.where(SIZES == 0, 3.0, -abs(SIZES - 4))])

        def negative(y: Floats) -> tuple[float, Floats]:  # multipliers of sum 1
            x = np.exp(y - y.max()) / np.exp(y - y.max()).sum()
            value, slack = self.dual(x, squares, widths)
            return -value, -x * (slack - x @ slack)

        return any(minimize(negative, y, jac=True, method="L-BFGS-B").fun < -1e-5 for y in starts)

    def find(self, rms_at_zero: float, widths: Floats, *, accuracy: float = 0.005) -> float:
        """The least possible largest rms z of rules whose mean errors are within `widths` (d,)."""
        low, high = 1.0, 3.0
        while high - low > accuracy:
            middle = (low + high) / 2
            squares = np.where(SIZES == 0, rms_at_zero, middle) ** 2
            low, high = (middle, high) if self.is_excluded(squares, widths) else (low, middle)
        return high


def judge_rule() -> tuple[Floats, Floats]:
    """Rms z (d,) and widths (d,) of the average over both models."""
    squares, widened = [], []
    for share, scale in HITS:
        found = [find_posterior(np.array([z]), np.eye(1), np.array([scale]), [0.5]) for z in Z]
        mean, variance = (np.array([getattr(one, name).item() for one in found]) for name in ("mean", "cov"))
        widened.append(1 + share**2 * variance)
        off = 1 + share**2 * (mean - SIZES[:, None]) ** 2
        squares.append((densities(SIZES) * off / widened[-1]).sum(axis=1))
    return np.sqrt(np.mean(squares, axis=0)), Bound().widths(np.array(widened))


def main() -> None:
    """Print the numbers of the rule, and the bounds."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rms", type=float, nargs="*", help="rms z at equal losses; default: that of the rule, and 1")
    rms, widths = judge_rule()
    print("d over s:", *SIZES)
    print("the average, rms z:", *rms.round(2))
    print("the average, claimed errors:", *widths.round(2))
    limits = np.where(SIZES == 0, widths[0], widths[1:].max())
    for at_zero in parser.parse_args().rms or (float(rms[0]), 1.0):
        print(f"no rule with rms z {at_zero:.2f} at 0 stays below {Bound().find(at_zero, limits):.2f} at every d")


if __name__ == "__main__":
    main()
