"""The numbers by which a model is compared with the paper, from readings of its collisions."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.paper import kondic
from benchmarks.paper.published import OBSERVED, SLOW
from benchmarks.paper.readings import WINDOWS

Floats = NDArray[np.float64]
BALLS = {"both": "C_both", "target": "C_target"}  # whose spins give C: the paper does not say
WAYS = tuple((window, balls) for window in WINDOWS for balls in BALLS)  # in which the paper may be read
FINAL = ["v1f", "v2f", "tau1", "tau2"]


def observed(read: Mapping[str, pd.DataFrame], way: tuple[str, str]) -> dict[str, float]:
    """By name, as OBSERVED and SLOW have it; read: readings of the series histogram, speeds, spins and slow."""
    window, balls = way
    speeds, spins, hits = read["speeds"], read["spins"], read["histogram"]
    fitted = kondic.fit(speeds["v0"].to_numpy(), speeds[FINAL].to_numpy())
    r = hits[f"r {window}"]
    known = r.notna()
    return {
        "r, fit": fitted.laws.r,
        "C, fit": fitted.laws.C,
        "mu_k, fit": fitted.laws.mu,
        "scatter of r": fitted.scatter[0],
        "scatter of C": fitted.scatter[1],
        "r, differences": float(r.mean()),
        "slope of r": float(np.polyfit(hits["v0"][known], r[known], 1)[0]),
        "C, spins": float(spins[f"{BALLS[balls]} {window}"].mean()),
        "dn": float(spins[[f"dn_target {window}", f"dn_striker {window}"]].to_numpy().mean()),
        "energy": float(speeds["energy"].mean()),
        "momentum": float(speeds["momentum"].mean()),
        SLOW.name: float(read["slow"]["tau1"].iloc[0]),
    }


def pulls(values: Mapping[str, float]) -> Floats:
    """(value - published)/error of each of OBSERVED."""
    return np.array([(values[o.name] - o.value) / o.error for o in OBSERVED])


def chi2(values: Mapping[str, float]) -> float:
    """Of all in OBSERVED."""
    return float((pulls(values) ** 2).sum())
