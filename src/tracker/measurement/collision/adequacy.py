"""Goodness of fit: p-values, and values that no two balls can have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Any

import numpy as np
from scipy.special import chdtrc, fdtrc

from tracker.measurement.collision.derived import QUANTITY_NAMES, DerivedValues
from tracker.measurement.noise.position_noise import ScatterRatio
from tracker.settings import FitSettings

MISFIT = "misfit"
TOGETHER = "stay_together"
USUAL_BIAS = 0.025  # of the momentum along n over the normal speed: four velocities with errors of 1.25 %
CROWD = "crowd"
GLIDE, ROLL = "glide", "slide and roll"  # in the column motion_local
HIDDEN_SLIDE = (
    "the contact lasts as long as the balls may slide: it hides how they part; check the unit of positions, scale, fps"
)
SHORT_SLIDE = "the balls move straight after the hit: they slide without friction, or roll at once"
TOO_FEW = "too few frames outside the contact"
NO_SCALE = "no scale: lengths need a camera file, which tracker calibrate makes"
NO_DIAMETER = "no ball_diameter in the camera file: a collision is measured by where balls of that diameter touch"
NOTHING_ROLLS = "no collision in view, and no ball rolls freely"
ONE_BALL = "one ball: no collision to measure; its speed needs a camera file, which tracker calibrate makes"
MEASURED = ("ok", MISFIT)  # statuses of a collision that has values


class Flag(StrEnum):
    """Something unusual about a collision, as the column `flags` of estimates.parquet spells it."""

    R_UNDER_0 = "r under 0"
    R_OVER_1 = "r over 1"
    C_UNDER_0 = "C under 0"
    C_OVER_5_7 = "C over 5/7"
    MU_K_UNDER_0 = "mu_k under 0"
    MU_K_OVER_1_5 = "mu_k over 1.5"
    V0_UNDER_0 = "v0 under 0"
    V0_OVER_20 = "v0 over 20 m/s"
    OVERLAP = "balls overlap"
    NO_TOUCH = "balls do not touch"
    STRIKER_SLIDES = "striker slides"
    STRIKER_SPINS = "striker spins"
    ROLLS_LATE = "rolls late"
    LASTS = "contact lasts"
    LASTS_OR_SMALLER = "contact lasts or balls are smaller"
    TOGETHER = "stay together"
    STRAIGHT = "no slide seen"
    TOUCH_AGAIN = "touch again"
    ENCODED = "encoded with loss"
    LOSSES_DIFFER = "rolling losses differ"
    FRICTION_CHANGES = "friction changes with speed"
    GLIDES = "bodies glide"

    @property
    def is_impossible(self) -> bool:
        """True if no two balls can collide so, whatever their material: such a collision is a misfit."""
        return self in (Flag.R_UNDER_0, Flag.R_OVER_1, Flag.C_UNDER_0, Flag.C_OVER_5_7)


VALUE_RANGES = {  # least and largest value of a quantity, with the flags of those beyond
    "r": (0.0, Flag.R_UNDER_0, 1.0, Flag.R_OVER_1),
    "C": (0.0, Flag.C_UNDER_0, 5 / 7, Flag.C_OVER_5_7),  # 5/7: surfaces that spring back without loss
    "mu_k": (0.0, Flag.MU_K_UNDER_0, 1.5, Flag.MU_K_OVER_1_5),
    "v0": (0.0, Flag.V0_UNDER_0, 20.0, Flag.V0_OVER_20),  # m/s
}


def list_disproving_values(row: Mapping[str, Any]) -> list[str]:
    """List the impossible values for which alone a collision is a misfit; none where its tracks reject the model."""
    if row["status"] != MISFIT or row.get("model_rejected", True):
        return []
    flags = str(row.get("flags", "")).split("|")
    return [flag for flag in Flag if flag.is_impossible and flag in flags]


def compute_p_value(square: float, dof: float, noise_dof: float) -> float:
    """Compute the p-value of a fit: the probability of a chi^2, `square`, at least so large; NaN without dof.

    noise_dof: degrees of freedom from which the errors' size was found; inf where it was given. If they are a part of
    the same residuals, an F test compares the rest with that part.
    """
    if not dof > 0 or not noise_dof > 0:
        return np.nan
    if np.isinf(noise_dof):
        return float(chdtrc(dof, square))
    if noise_dof > 0.9 * dof:
        return float(fdtrc(dof, noise_dof, square / dof))
    return float(fdtrc(dof - noise_dof, noise_dof, max(square - noise_dof, 0.0) / (dof - noise_dof)))


def compute_p_value_of_free_fits(rows: list[dict[str, Any]], size: ScatterRatio, ratio: float = 1.0) -> float:
    """Compute the p-value of all free fits together; NaN without any.

    ratio: factor on the variance of the errors with which the fits were made.
    """
    fits = [(row["chi2_free"], row["dof_free"]) for row in rows if row["dof_free"] > 0]
    square, dof = np.sum(fits, axis=0) if fits else (np.nan, 0)
    return compute_p_value(float(square) / ratio, float(dof), size.dof)


def compute_p_of_rise(rise: float, more: int, noise_dof: float) -> float:
    """Compute the p-value of the rise of chi^2 from the free fit of positions to the tied one.

    more: degrees of freedom of the tied fit beyond those of the free one; NaN where it has no more. noise_dof: as in
    `compute_p_value`.
    """
    rise = max(rise, 0.0)
    if not more > 0 or not noise_dof > 0:
        return np.nan
    return float(chdtrc(more, rise) if np.isinf(noise_dof) else fdtrc(more, noise_dof, rise / more))


def find_impossible_values(values: DerivedValues, stretch: float, errors: float) -> list[Flag]:
    """Find the quantities that two equal rolling balls cannot have, in the order of VALUE_RANGES.

    A value must lie outside its range by `errors` standard errors times `stretch`, the factor by which the fit's
    standard errors are too small.
    """
    flags = list[Flag]()
    for name, (low, low_flag, high, high_flag) in VALUE_RANGES.items():
        index = QUANTITY_NAMES.index(name)
        value, margin = values.value[index], errors * stretch * values.std[index]
        if value - margin > high:
            flags.append(high_flag)
        elif value + margin < low:
            flags.append(low_flag)
    return flags


def flag_contact_distance(distance: float, std: float, settings: FitSettings) -> list[Flag]:
    """Flag an impossible value: balls that touch at another distance than one diameter; both in diameters.

    A deviation is flagged where it exceeds `contact_distance_tolerance` by `impossible_sigma` standard errors.
    """
    if abs(distance - 1) - settings.impossible_sigma * std < settings.contact_distance_tolerance:
        return []
    return [Flag.OVERLAP if distance < 1 else Flag.NO_TOUCH]


def describe_failure(error: Exception) -> str:
    """Describe, as the status of a collision, that the arithmetic of its fit failed, and how."""
    return f"the fit failed: {(str(error).splitlines() or [type(error).__name__])[0][:80]}"


def is_seen_to_glide(rows: Sequence[Mapping[str, Any]]) -> bool:
    """Decide whether the tracks of a crowd show that its bodies glide, which the camera file does not say."""
    return any(Flag.GLIDES in str(row.get("flags", "")).split("|") for row in rows)


def find_gliding_hits(
    rows: Sequence[Mapping[str, Any]], *, min_hits: int = 3, min_share: float = 0.25
) -> list[Mapping[str, Any]]:
    """Find the hits of a set that only bodies that glide describe; none if these are too few to decide for all.

    A hit alone takes a short curved path for a slide. Bodies that roll fit the motions of gliding ones as well, but
    are taken for these only where something else disturbs them: in 6 of 82 real hits of billiard balls, beside 25 of 56
    of pucks and 8 of 15 of discs on air, by which `min_share` was chosen.
    """
    single = [row for row in rows if row.get("motion_local") and row.get("status") != CROWD]
    gliding = [row for row in single if row["motion_local"] == GLIDE]
    return gliding if len(gliding) >= min_hits and len(gliding) > min_share * len(single) else []
