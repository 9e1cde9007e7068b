"""Which of the estimates of a collision to use, and why."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

from tracker.measurement.collision.adequacy import CROWD, HIDDEN_SLIDE, MISFIT, TOGETHER, list_disproving_values
from tracker.measurement.local.local_estimate import BALANCE, LOCAL_NAMES

TIED, FREE, LOCAL, NONE = "tied", "free", "local", "none"
SUFFIXES = {TIED: "", FREE: "_free", LOCAL: "_local"}  # of the columns of each estimate
COMPARED = ("v0", "b", "r", "s")  # quantities in which estimates are compared


def recommend(row: Mapping[str, Any]) -> dict[str, str]:
    """Recommend an estimate of one row of estimates: its columns `recommended` and `why`.

    The tied fit comes first where the tracks accept it and the local estimate does not contradict it.
    """
    local, doubt = _is_usable(row)
    foreign = json.loads(row["local"]).get("foreign", "")
    if row["status"] == TOGETHER:
        return _because(TIED, "the balls stay together")
    if row["status"] == "ok" and is_known(row, "r") and not foreign:
        other, sigmas = _find_difference(row, "")
        if not other and local and (lacking := _find_unclaimed_error(row)):
            return _because(LOCAL, f"the set shows errors of velocities by which r is known to {lacking:.2g} only")
        if not other:
            agrees = "agrees with the local estimate" if local else f"has no local estimate beside it ({doubt})"
            return _because(TIED, f"the tied fit describes the tracks and {agrees}")
        if local:
            return _because(LOCAL, f"the local estimate contradicts the tied fit by {sigmas:.1f} errors in {other}")
        return _because(NONE, f"the local estimate contradicts the tied fit, and has itself a fault: {doubt}")
    reason = "the tracks reject the tied fit" if row["status"] == MISFIT else "the tied fit does not show r"
    if values := list_disproving_values(row):
        reason = f"the tied fit has an impossible value: {' and '.join(values)}"
    if foreign and row["status"] == "ok":
        reason = foreign
    elif row["status"] == CROWD:
        reason = "of many balls, each contact is measured by itself"
    elif row["status"] not in ("ok", MISFIT):
        reason = f"there is no tied fit ({row['status']})"
    rolls = row.get("motion_local") != "glide"  # as the free fit assumes
    free = rolls and is_known(row, "r_free") and is_known(row, "r_free_std") and not row.get("local_hits", 0)
    if free and local and (sigmas := _find_imbalance(row)):
        reason += f"; momentum changes by {sigmas:.1f} errors of the residuals, so those of the free fit are too small"
        free = False
    if row.get("misfit_local", False) and local:
        times = math.sqrt(row["chi2_local"] / row["dof_local"])
        reason += f"; free motion misses the positions by {times:.1f} of their errors, and the errors count that"
    if free and local and not _find_difference(row, "_free")[0]:
        return _because(FREE, f"{reason}; the free fit agrees with the local estimate")
    if local:
        return _because(LOCAL, reason)
    if row["status"] == "ok" and not foreign:
        return _because(TIED, "the tied fit describes the tracks; nothing shows r")
    return _because(NONE, f"{reason}; no local estimate: {doubt}")


def _because(name: str, why: str) -> dict[str, str]:
    return {"recommended": name, "why": why}


def _is_usable(row: Mapping[str, Any]) -> tuple[bool, str]:
    """Decide whether the local estimate of a row can be used, and give the reason against it."""
    max_mass_ratio, max_imbalance = 50.0, 5.0  # the latter of momentum, in standard errors that a set shows
    if not is_known(row, "r_local"):
        return False, str(json.loads(row["local"]).get("reason", "its errors are too large"))
    if row["status"] == HIDDEN_SLIDE and not json.loads(row["local"]).get("foreign", ""):
        return False, "the balls may have slid while they were in contact"
    r, std = row["r_local"], row["r_local_std"]
    if not -3 * std <= r <= 1 + 3 * std:
        return False, f"its r of {r:.2f} is impossible"
    if not is_known(row, "mass_ratio") or not 1 / max_mass_ratio < row["mass_ratio"] < max_mass_ratio:
        return False, "momentum is not conserved, whatever the masses"
    balances = [name for name in ("balance_n_local", "balance_t_local") if is_known(row, name)]
    if row.get("local_hits", 0) and any(abs(row[name]) > max_imbalance * row[f"{name}_std"] for name in balances):
        return False, "momentum is not conserved within the errors of its set"
    return True, ""


def _find_imbalance(row: Mapping[str, Any]) -> float:
    """Find the change of momentum by a hit, in errors of the residuals and camera.json alone; 0 below 3 of them.

    The free fit claims such errors. It assumes that the motion it sees begins at the hit. A hop breaks this: bounces
    raise the friction of the plate for a frame or two, and few positions show it. Unequal masses look the same.
    """
    max_imbalance = 3.0  # standard errors, as in `_find_difference`
    raw, at = json.loads(row["local"]), [LOCAL_NAMES.index(name) for name in BALANCE]
    if "value" not in raw:
        return 0.0
    sizes = [abs(raw["value"][k] or 0.0) / max(raw["std"][k] or math.inf, 1e-300) for k in at]
    return max(sizes) if max(sizes) > max_imbalance else 0.0


def _find_unclaimed_error(row: Mapping[str, Any]) -> float:
    """The error of r by the errors of velocities that a set shows, if the tied fit claims less; else 0."""
    # of a velocity over that of the hit, and on the errors by residuals; below both, the set may be of simulated tracks
    min_set_error, min_set_factor = 0.004, 2.0
    shows_errors = row.get("local_error_n", 0.0) > min_set_error or row.get("local_factor", 1.0) > min_set_factor
    if not (row.get("local_hits", 0) and shows_errors):
        return 0.0
    by_residuals = json.loads(row["local"])["r_std"] or 0.0
    extra = math.sqrt(max(row["r_local_std"] ** 2 - by_residuals**2, 0.0))
    return extra if extra > row["r_std"] else 0.0


def is_known(row: Mapping[str, Any], column: str) -> bool:
    """Test whether a row of estimates has a finite value in a column."""
    value = row.get(column)
    return value is not None and math.isfinite(value)


def _find_difference(row: Mapping[str, Any], suffix: str) -> tuple[str, float]:
    """Find the quantity in which another estimate differs most from the local one, and by how many standard errors."""
    worst, sigmas = "", 3.0  # smaller differences do not count
    for name in COMPARED:
        columns = (f"{name}{suffix}", f"{name}{suffix}_std", f"{name}_local", f"{name}_local_std")
        if not all(is_known(row, column) for column in columns):
            continue
        one, one_std, two, two_std = (row[column] for column in columns)
        size = abs(one - two) / max(math.hypot(one_std, two_std), 1e-300)
        if size > sigmas:
            worst, sigmas = name, size
    return worst, sigmas


def find_recommended_suffix(row: Mapping[str, Any]) -> str:
    """Give the column suffix of the recommended estimate of a row; of the tied fit where none is recommended."""
    return SUFFIXES.get(str(row.get("recommended", TIED)), "")
