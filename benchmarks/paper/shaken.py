"""The error of positions that gives the paper's scatter of r."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from benchmarks.paper.readings import read
from benchmarks.paper.results import WINDOW, Floats, Results, noisy

DRAWS = 20


def scatter_of(results: Results, error: float) -> float:
    """Scatter of r over the 28 collisions with that error of positions, m: the median over draws."""
    films = results.filmed("histogram").films
    return float(np.median([read(noisy(films, error, seed))[f"r {WINDOW}"].std() for seed in range(DRAWS)]))


_known: dict[tuple[str, float], tuple[float, Floats]] = {}


def add_error_for_scatter(results: Results, scatter: float) -> tuple[float, Floats]:
    """The error, m, with which r scatters so, and one such histogram."""
    key = f"{results.output}", scatter
    if key not in _known:
        error = float(brentq(lambda e: scatter_of(results, e) - scatter, 1e-6, 3e-4, xtol=5e-7))
        films = results.filmed("histogram").films
        draws = [read(noisy(films, error, seed))[f"r {WINDOW}"].to_numpy() for seed in range(DRAWS)]
        typical = min(draws, key=lambda r: abs(r.std(ddof=1) - scatter))
        _known[key] = error, typical
    return _known[key]


def share_with_trend(results: Results, error: float, level: float = 2.0) -> float:
    """Share of draws in which r against v0 slopes by more than so many of its own errors."""
    films, v0 = results.filmed("histogram").films, results.read("histogram")["v0"].to_numpy()
    seen = 0
    for seed in range(10 * DRAWS):
        r = read(noisy(films, error, 1000 + seed))[f"r {WINDOW}"].to_numpy()
        good = np.isfinite(r)
        (slope, _), cov = np.polyfit(v0[good], r[good], 1, cov=True)
        seen += slope > level * float(np.sqrt(cov[0, 0]))
    return seen / (10 * DRAWS)
