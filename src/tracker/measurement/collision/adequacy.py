"""Whether the data accept a fit: p-values, values impossible for steel balls, and warnings of both."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import chdtrc, fdtrc

from tracker.measurement.collision.derived import QUANTITY_NAMES, DerivedValues
from tracker.measurement.collision.least_squares import CollisionFit
from tracker.measurement.noise.position_noise import ScatterRatio

MISFIT = "misfit"
MEASURED = ("ok", MISFIT)  # statuses of a collision that has values
LEVEL = 1e-6  # of a p-value under which a fit is rejected: one clip in a million that the model describes
BEYOND = 3.0  # of its own errors by which a quantity must pass a limit to be questioned
POSSIBLE = {  # least and most, with the flags; C of 5/7: surfaces that spring back without loss
    "r": ((0.0, "r under 0"), (1.0, "r over 1")),
    "C": ((0.0, "C under 0"), (5 / 7, "C over 5/7")),
    "mu_k": ((0.0, "mu_k under 0"), (1.5, "mu_k over 1.5")),
    "v0": ((0.0, "v0 under 0"), (20.0, "v0 over 20 m/s")),
}
APART = 0.03  # of a diameter, by which balls may seem to touch at another distance than that
CAUSES = (
    "the tracks reject two equal balls that roll, collide and slide: check mass and size of both, spin or sliding of "
    "the striker, scale, exposure, other forces; values are for looking at and have no errors"
)
CHECKS = "impossible for equal balls that roll: check their masses, the scale, spin or sliding of the striker"
OVERLAP, NO_TOUCH = "balls overlap", "balls do not touch"
ALSO = {  # flags, and what to check of them
    "mu_k over 1.5": "more friction than any plate has: check fps, scale, and whether the balls hit anything else",
    "v0 over 20 m/s": "faster than balls are rolled: check fps and scale",
    OVERLAP: "their tracks come nearer than a diameter: check scale, ball_diameter and fps",
    "striker slides": "it is fitted as sliding up to the contact, with a spin of its own (u2ix, u2iy, side2i)",
    "striker spins": "a spin about the vertical is fitted (side2i); what else adds to the rub of the hit looks alike",
    "rolls late": "the first positions of the striker are left out, where it does not roll",
    NO_TOUCH: "they change direction more than a diameter apart: check scale, ball_diameter, fps; or they are smoothed",
}


def p_value(square: float, dof: float, known: float) -> float:
    """The probability of a chi^2 at least so large.

    Where the errors' size was found from a part of the same residuals, the rest is held against that part, by the ratio
    of the two mean squares.

    Parameters
    ----------
    square : float
        chi^2.
    dof : float
        Its degrees of freedom.
    noise_dof : float
        Degrees of freedom from which the errors' size was found; inf where it was given.

    Returns
    -------
    float
        NaN without degrees of freedom.
    """
    if not dof > 0 or not known > 0:
        return np.nan
    if np.isinf(known):
        return float(chdtrc(dof, square))
    if known > 0.9 * dof:
        return float(fdtrc(dof, known, square / dof))
    return float(fdtrc(dof - known, known, max(square - known, 0.0) / (dof - known)))


def p_free(rows: list[dict[str, Any]], size: ScatterRatio, ratio: float = 1.0) -> float:
    """p-value of all free fits together, were the errors' variance `ratio` times what they went by; NaN without any."""
    fits = [(row["chi2_free"], row["dof_free"]) for row in rows if row["dof_free"] > 0]
    square, dof = np.sum(fits, axis=0) if fits else (np.nan, 0)
    return p_value(float(square) / ratio, float(dof), size.dof)


def agreement(tied: CollisionFit, free: CollisionFit, known: float) -> float:
    """The probability of so large a rise of chi^2 from the free fit to the tied one; `known` as of `p_value`.

    NaN where the tied fit has no more degrees of freedom than the free one. Both are of the same positions.
    """
    more, rise = tied.dof - free.dof, max(tied.chi2 - free.chi2, 0.0)
    if not more > 0 or not known > 0:
        return np.nan
    return float(chdtrc(more, rise) if np.isinf(known) else fdtrc(more, known, rise / more))


def impossible_values(values: DerivedValues, stretch: float) -> str:
    """Flags of the quantities that are impossible for two equal rolling balls, joined by "|".

    A quantity is questioned where it is beyond a limit of POSSIBLE by BEYOND of its standard errors times `stretch`, by
    which the fit's errors are too small.
    """
    said = []
    for name, ((low, under), (high, over)) in POSSIBLE.items():
        value, error = (
            values.value[QUANTITY_NAMES.index(name)],
            BEYOND * stretch * values.std[QUANTITY_NAMES.index(name)],
        )
        if value - error > high:
            said.append(over)
        elif value + error < low:
            said.append(under)
    return "|".join(said)


def contact_distance_flag(distance: float, std: float) -> str:
    """The flag of balls that touch at `distance` diameters with standard error `std`; '' where that may be one."""
    if abs(distance - 1) - BEYOND * std < APART:
        return ""
    return OVERLAP if distance < 1 else NO_TOUCH


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
        yield f"{name} ({_collisions(count)}): {ALSO.get(name, CHECKS)}"
    ratio = estimates["noise_ratio"].dropna().to_numpy(float)
    if len(ratio):
        size = f"{np.median(ratio):.3g} times their claimed errors"
        yield f"{_collisions(len(ratio))}: positions scatter about smooth motion by {size}; the fits use the scatter"
    rho = estimates.loc[estimates["noise_rho"] > 0, "noise_rho"].to_numpy(float)
    if len(rho):
        size = f"correlated by {np.median(rho):.2f} from frame to frame"
        yield f"{_collisions(len(rho))}: the errors of positions are {size}; the fits count that"


def _collisions(count: int) -> str:
    return f"{count} collision{'s' * (count != 1)}"
