"""Coverage of the means, scatters and slopes of combined sets: few collisions, unequal errors, known truth.

    python -m benchmarks.tracker.combined_sets [--sets 600] [--seed 0] [-o out/combined_sets]

Each set has n collisions. The errors are log-normal, by a factor of 2.2, about one; the true values scatter by tau.
The table gives shares of sets:

- "68", "95": whose interval contains the true mean, as `tracker combine` makes it: Paule and Mandel's scatter, and the
  factor of Hartung and Knapp where it is over one;
- "moments 95": the same by DerSimonian and Laird with a normal distribution; "reml 95": by restricted maximum
  likelihood with the same factor;
- "tau 95", "slope 95": whose interval contains the true scatter, and the true slope, zero.

The last columns are mean half widths of the intervals of the mean. The exit status is 1 where a share of 95 % of
`tracker combine` is under 0.90.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.optimize import minimize_scalar
from scipy.stats import t

from benchmarks.harness import save
from tracker.measurement.random_effects import GeneralisedQ, fit_random_effects

Floats = NDArray[np.float64]
SIZES, SCATTERS = (3, 5, 10, 30), (0.0, 0.5, 1.0, 3.0)
LEAST = 0.90


def half_widths(value: Floats, std: Floats) -> tuple[tuple[float, float], tuple[float, float]]:
    """Mean and half width of 95 % by DerSimonian and Laird, and by REML with Hartung and Knapp's limited factor."""
    n, w = len(value), std**-2.0
    problem = GeneralisedQ(value, std**2, np.zeros((n, 0)), np.ones((n, 1)))
    moments = max((problem.fit(0.0)[2] - (n - 1)) / (w.sum() - (w @ w) / w.sum()), 0.0)
    mean, cov, _ = problem.fit(moments)

    def deviance(variance: float) -> float:
        _, cov, q = problem.fit(variance)
        return float(np.log(std**2 + variance).sum() - np.log(cov[0, 0]) + q)

    grid = np.linspace(0, 1, 25) ** 2 * 10 * np.var(value)
    best = int(np.argmin([deviance(v) for v in grid]))
    bounds = (grid[max(best - 1, 0)], grid[min(best + 1, 24)])
    found = minimize_scalar(deviance, bounds=bounds, method="bounded")
    variance = float(found.x) if found.fun < deviance(0.0) else 0.0
    middle, spread, q = problem.fit(variance)
    factor = max(q / (n - 1), 1.0)
    wide = float(t.isf(0.025, n - 1) * np.sqrt(factor * spread[0, 0]))
    return (float(mean[0]), 1.96 * float(cov[0, 0]) ** 0.5), (float(middle[0]), wide)


def judge(n: int, scatter: float, sets: int, rng: np.random.Generator) -> dict[str, float]:
    """Shares of sets of n collisions whose intervals contain the truth."""
    hits = dict.fromkeys(("68", "95", "moments 95", "reml 95", "tau 95", "slope 95", "width", "width reml"), 0.0)
    one_sigma = t.isf(0.15866, n - 1)
    for _ in range(sets):
        std = np.exp(rng.normal(0, 0.8, n))
        speed = rng.uniform(0.1, 1.0, n)
        value = rng.normal(0, np.hypot(std, scatter))
        found = fit_random_effects(value, std)
        mean = abs(found.coefficients[0])
        moments, reml = half_widths(value, std)
        hits["68"] += mean < one_sigma * found.std[0]
        hits["95"] += mean < found.high[0] - found.coefficients[0]
        hits["moments 95"] += abs(moments[0]) < moments[1]
        hits["reml 95"] += abs(reml[0]) < reml[1]
        hits["tau 95"] += found.scatter_low <= scatter <= found.scatter_high
        hits["width"] += found.high[0] - found.coefficients[0]
        hits["width reml"] += reml[1]
        if n > 3:
            line = fit_random_effects(value, std, design=np.column_stack([np.ones(n), speed - speed.mean()]))
            hits["slope 95"] += line.low[1] < 0 < line.high[1]
    return {key: count / sets for key, count in hits.items() if n > 3 or key != "slope 95"}


def main() -> None:
    """Simulate, print the table and save it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", type=int, default=600)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/combined_sets"))
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    rows = [{"n": float(n), "tau": tau} | judge(n, tau, options.sets, rng) for n in SIZES for tau in SCATTERS]
    heads = list(rows[-1])
    table = Table(*heads)
    for row in rows:
        table.add_row(*(f"{row[key]:.3g}" if key in row else "" for key in heads))
    Console(width=140).print(table)
    save(options.output / "combined_sets.json", rows)
    wrong = [row for row in rows for key in ("95", "tau 95", "slope 95") if row.get(key, 1.0) < LEAST]
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
