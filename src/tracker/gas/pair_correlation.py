"""Pair correlation of balls in a rectangle, with the exact correction for its edges.

Let independent points fill a rectangle a x b evenly. Up to the shorter side, their pair distances r have a known
density:

    2 pi r (a b - 2 (a + b) r / pi + r^2 / pi) / (a b)^2

This is the set covariance of a rectangle, averaged over directions (Torquato, Random Heterogeneous Materials, 2002).
The pair correlation is the ratio of the observed number of pairs to this.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from synthcam_shared.arrays import Array


def pair_correlation(
    positions: list[Array],
    size: tuple[float, float],
    reach: float,
    bins: int = 60,
    least: float = 0.0,
    *,
    time_blocks: int = 20,
) -> pd.DataFrame:
    """Measure the pair correlation of many snapshots; the result has columns r (m), g, g_std.

    The error is the scatter of `time_blocks` blocks of consecutive snapshots.

    positions: (n, 2) m of each snapshot.
    size: sides of the rectangle that the centres fill, m.
    reach, least: m, largest and least distance.
    """
    edges = np.linspace(least, min(reach, *size), bins + 1)
    near = (cKDTree(xy).query_pairs(edges[-1], output_type="ndarray") for xy in positions)
    apart = [np.hypot(*(xy[rows[:, 0]] - xy[rows[:, 1]]).T) for xy, rows in zip(positions, near, strict=True)]
    found = np.array([np.histogram(each, edges)[0] for each in apart], dtype=np.float64).reshape(-1, bins)
    pairs = np.array([len(xy) * (len(xy) - 1) / 2 for xy in positions])
    a, b = size
    within = (np.pi * edges**2 * a * b - 4 * (a + b) * edges**3 / 3 + edges**4 / 2) / (a * b) ** 2  # share of all pairs
    expected = np.diff(within) * pairs[:, None]
    blocks = [rows for rows in np.array_split(np.arange(len(positions)), time_blocks) if pairs[rows].sum() > 0]
    middle = (edges[1:] + edges[:-1]) / 2
    if not blocks:
        return pd.DataFrame({"r": middle, "g": np.nan, "g_std": np.nan})
    ratio = np.array([found[rows].sum(axis=0) / expected[rows].sum(axis=0) for rows in blocks])
    scatter = ratio.std(axis=0, ddof=1) / np.sqrt(len(blocks)) if len(blocks) > 1 else np.full(bins, np.nan)
    return pd.DataFrame({"r": middle, "g": found.sum(axis=0) / expected.sum(axis=0), "g_std": scatter})
