"""Whether the data accept a fit: p-values, values impossible for steel balls, and warnings of both."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np
import pandas as pd
from scipy.stats import chi2, f

from tracker.measurement.derived import NAMES, Values
from tracker.measurement.fitting import Fit

MISFIT = "misfit"
MEASURED = ("ok", MISFIT)  # statuses of a collision that has values
LEVEL = 1e-6  # of a p-value under which a fit is rejected: one clip in a million that the model describes
BEYOND = 3.0  # of its own errors by which a quantity must pass a limit to be questioned
POSSIBLE = {"r": (0.0, 1.0), "C": (0.0, 5 / 7)}  # C of 5/7: surfaces that spring back without loss
CAUSES = (
    "the tracks reject two equal balls that roll, collide and slide: check mass and size of both, spin or sliding of "
    "the striker, scale, exposure, other forces; values are for looking at and have no errors"
)
CHECKS = "impossible for equal balls that roll: check their masses, the scale, spin or sliding of the striker"
SCATTER = "as the tracks' own scatter shows"


def p_value(square: float, dof: float, known: float) -> float:
    """Probability of a chi^2 at least so large; NaN where it is not known.

    known: degrees of freedom from which the errors' size was found (inf: given). They are part of the same residuals:
    the rest of the residuals is held against them, by the ratio of the two mean squares.
    """
    if not dof > 0 or not known > 0:
        return np.nan
    if np.isinf(known):
        return float(chi2.sf(square, dof))
    if known > 0.9 * dof:
        return float(f.sf(square / dof, dof, known))
    return float(f.sf(max(square - known, 0.0) / (dof - known), dof - known, known))


def agreement(tied: Fit, free: Fit, known: float) -> float:
    """Probability of so large a rise of chi^2 from the free fit to the tied one, on the same positions."""
    more, rise = tied.dof - free.dof, max(tied.chi2 - free.chi2, 0.0)
    if not more > 0 or not known > 0:
        return np.nan
    return float(chi2.sf(rise, more) if np.isinf(known) else f.sf(rise / more, more, known))


def questioned(values: Values, stretch: float) -> str:
    """What no two equal rolling balls can show, with | between; stretch: by which the fit's errors are too small."""
    said = []
    for name, (low, high) in POSSIBLE.items():
        value, error = values.value[NAMES.index(name)], BEYOND * stretch * values.std[NAMES.index(name)]
        if value - error > high:
            said.append(f"{name} over {'5/7' if name == 'C' else '1'}")
        elif value + error < low:
            said.append(f"{name} under 0")
    return "|".join(said)


def warnings(estimates: pd.DataFrame) -> Iterator[str]:
    """Lines for whoever reads the estimates: collisions that do not fit, values to question, errors not as claimed."""
    if "flags" not in estimates:  # results of an older version
        return
    rows = estimates[estimates["status"] == MISFIT]
    if len(rows):
        per = (rows["chi2"] / rows["dof"]).to_numpy(float)
        yield f"{len(rows)} misfit (chi^2/dof {np.median(per):.3g}, at most {per.max():.3g}): {CAUSES}"
    flags = Counter(flag for row in estimates["flags"] for flag in row.split("|") if flag)
    for name, count in sorted(flags.items()):
        yield f"{name} ({count} collisions): {CHECKS}"
    ratio = estimates["noise_ratio"].dropna().to_numpy(float)
    if len(ratio):
        yield f"errors: in {len(ratio)} collisions not those claimed but {np.median(ratio):.3g} times these, {SCATTER}"
    rho = estimates.loc[estimates["noise_rho"] > 0, "noise_rho"].to_numpy(float)
    if len(rho):
        yield f"errors: in {len(rho)} collisions correlated by {np.median(rho):.2f} from frame to frame"
