"""The recommended estimate, from the columns of a row."""

import json
import math

import pytest

from tracker.measurement.collision.adequacy import HIDDEN_SLIDE
from tracker.measurement.local.local_estimate import LOCAL_NAMES
from tracker.measurement.local.recommendation import find_recommended_suffix, recommend

KNOWN = {"v0": (0.5, 0.001), "b": (0.1, 0.001), "r": (0.9, 0.01), "s": (math.nan, math.nan)}
# of a set whose balances of momentum show that r is known to .02 only
SET = {"local_hits": 20, "local_error_n": 0.01, "r_local_std": 0.02, "local_json": json.dumps({"r_std": 0.001})}


def make_balances(along, across):
    """The balances along n and t with errors of 0.01 by the residuals, as JSON of a local estimate."""
    value, std = [0.0] * len(LOCAL_NAMES), [0.01] * len(LOCAL_NAMES)
    value[LOCAL_NAMES.index("balance_n")], value[LOCAL_NAMES.index("balance_t")] = along, across
    return json.dumps({"value": value, "std": std})


REASON = '{"reason":"too few positions near the contact"}'


def make_row(status, tied=True, free=True, local=True, local_json="{}", **changes):
    row = {"status": status, "mass_ratio": 1.0, "local": local_json}
    for suffix, known in (("", tied), ("_free", free), ("_local", local)):
        for name, (value, std) in KNOWN.items():
            row[f"{name}{suffix}"] = value if known else math.nan
            row[f"{name}{suffix}_std"] = std if known else math.nan
    return row | changes


@pytest.mark.parametrize(
    ("row", "recommended", "why"),
    [
        (make_row("ok"), "tied", "agrees"),
        (make_row("ok", r=0.7), "local", "contradicts the tied fit by 14.1 errors in r"),
        (make_row("ok", local=False, local_json=REASON), "tied", "too few positions"),
        (make_row("ok", r=0.7, mass_ratio=-2.0), "none", "momentum is not conserved"),
        (make_row("ok", r=math.nan, r_std=math.nan), "free", "does not show r"),
        (make_row("misfit", r_std=math.nan), "free", "the free fit agrees"),
        (make_row("misfit", r_std=math.nan, r_free=0.7), "local", "the tracks reject the tied fit"),
        (make_row("misfit", r_std=math.nan, local_json=make_balances(0.02, -0.02)), "free", "the free fit agrees"),
        (make_row("misfit", r_std=math.nan, local_json=make_balances(-0.05, 0.0)), "local", "momentum changes by 5.0"),
        (make_row("misfit", r_std=math.nan, local_json=make_balances(0.0, 0.04)), "local", "momentum changes by 4.0"),
        (make_row("misfit", free=False), "local", "the tracks reject the tied fit"),
        (
            make_row("misfit", free=False, model_rejected=False, flags="r over 1"),
            "local",
            "an impossible value: r over 1",
        ),
        (make_row("misfit", r_std=math.nan, motion_local="glide"), "local", "the tracks reject the tied fit"),
        (
            make_row("misfit", free=False, misfit_local=True, chi2_local=40.0, dof_local=10.0),
            "local",
            "free motion misses the positions by 2.0 of their errors, and the errors count that",
        ),
        (make_row("misfit", free=False, r_local=1.3), "none", "its r of 1.30 is impossible"),
        (make_row("misfit", free=False, local=False), "none", "its errors are too large"),
        (make_row("too few frames after the contact", False, False, False), "none", "too few frames"),
        (
            make_row("ok", local_json='{"foreign":"the tied fit is that of equal masses"}', free=False),
            "local",
            "equal masses",
        ),
        (make_row(HIDDEN_SLIDE, False, False), "none", "the balls may have slid while they were in contact"),
        (make_row(HIDDEN_SLIDE, False, False, local_json='{"foreign":"discs"}'), "local", "hides how they part"),
        (make_row("ok", **SET), "local", "the set shows errors of velocities"),
        (make_row("ok", **SET | {"local_error_n": 0.001, "local_factor": 1.5}), "tied", "agrees"),
        (make_row("ok", **SET | {"local_error_n": 0.001, "local_factor": 2.5}), "local", "the set shows errors"),
        (make_row("misfit", r_std=math.nan, **SET), "local", "the tracks reject the tied fit"),
        (make_row("stay_together", free=False, local=False), "tied", "stay together"),
    ],
)
def test_an_estimate_is_recommended_with_a_reason(row, recommended, why):
    found = recommend(row)
    assert found["recommended"] == recommended
    assert why in found["why"]
    assert find_recommended_suffix(row | found) == {"tied": "", "none": ""}.get(recommended, f"_{recommended}")
