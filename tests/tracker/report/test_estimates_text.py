"""The answer in words and numbers: units, errors in brackets, and a line where nothing was measured."""

import math

import numpy as np
import pandas as pd
import pytest

from synthcam_shared.report.numbers import format_with_error
from tracker.measurement.collision.adequacy import ONE_BALL
from tracker.measurement.collision.derived import QUANTITY_NAMES
from tracker.report.estimates_text import (
    METHODS,
    OF_ONE_BALL,
    describe_contact,
    describe_rolling,
    describe_status,
    explain_dashes,
    format_for_terminal,
    list_quantities,
    order_methods,
)
from tracker.report.quantities import QUANTITIES


def row(status="ok", **values):
    """A row of estimates: all quantities 1 +- .01 by each fit, but for those given."""
    one = {"clip": 0, "collision": 0, "status": status, "chi2": 90.0, "dof": 100, "adequate": 0.75}
    one |= {"frame_first": 0, "frame_last": 99}
    for name in QUANTITY_NAMES:
        for kind in METHODS:
            one |= {f"{name}{kind}": 1.0, f"{name}{kind}_std": 0.01}
    return one | {"flags": ""} | values


@pytest.mark.parametrize(
    ("value", "std", "said"),
    [(0.90274, 0.0012, "0.9027(12)"), (-3.14159, 0.2, "-3.14(20)"), (120.0, 35.0, "120(35)"), (2.5, math.nan, "2.5"),
     (math.nan, 1.0, "–"), (None, None, "–"), (1.0, 0.0, "1")],
)  # fmt: skip
def test_a_value_has_two_digits_of_its_error(value, std, said):
    assert format_with_error(value, std) == said


def test_units_are_those_named():
    shown = {
        line.name: line
        for line in list_quantities(row(tau1=0.0123, tau1_std=1e-4, v0=0.35, v0_std=1e-3, final_angle=np.pi))
    }
    assert (shown["tau1"].values[0], shown["tau1"].quantity.unit) == ("12.30(10)", "ms")
    assert (shown["v0"].values[0], shown["v0"].quantity.unit) == ("35.00(10)", "cm/s")
    assert shown["final_angle"].values[0].startswith("180.0")
    assert list(shown) == list(QUANTITY_NAMES) == list(QUANTITIES)


def test_what_no_fit_has_is_left_out():
    nothing = {f"mu_k{kind}{end}": np.nan for kind in METHODS for end in ("", "_std")}
    assert "mu_k" not in [line.name for line in list_quantities(row(**nothing))]
    assert "mu_k" in [line.name for line in list_quantities(row(**(nothing | {"mu_k_free": 0.2})))]


def test_one_collision_is_printed_whole_and_many_as_medians():
    alone = "\n".join(format_for_terminal(pd.DataFrame([row()])))
    assert "clip 0, collision 0, frames 0 to 99: Two balls collide" in alone
    assert "χ²/dof 0.9, dof 100, p 0.75" in alone
    assert "1.000(10)" in alone
    many = "\n".join(format_for_terminal(pd.DataFrame([row(r=0.8 + 0.01 * k) for k in range(9)])))
    assert "median of 9 hits" in many
    assert "0.84" in many
    assert list(format_for_terminal(pd.DataFrame([row("no_collision")] * 9))) == []


def test_what_is_extrapolated_is_marked_where_it_has_a_value():
    late = row(extrapolated="tau1|energy_fraction", tau1=math.nan)
    lines = {line.split()[0]: line for line in format_for_terminal(pd.DataFrame([late])) if line.strip()}
    assert lines["E/E0"].count("*") == 1
    assert "*" not in lines["τ1"] + lines["p/p0"]
    assert "a ball slides for longer than it is seen" in lines["*"]
    assert "*" not in "".join(format_for_terminal(pd.DataFrame([row(), row(extrapolated="")])))


def test_a_restitution_that_the_law_of_the_force_leaves_open_has_a_reason():
    open_law = row(flags="contact lasts", r=np.nan, r_std=np.nan)
    assert "depends on the law of the force" in " ".join(explain_dashes(open_law))
    assert "law of the force" not in " ".join(explain_dashes(open_law | {"flags": ""}))
    assert "law of the force" not in " ".join(explain_dashes(row(flags="contact lasts")))


def test_a_rejected_fit_is_not_shown_beside_a_recommended_estimate():
    bare = {f"{name}_std": np.nan for name in QUANTITY_NAMES}
    rejected = row("misfit", recommended="local", why="the tracks reject the tied fit", **bare)
    assert list(order_methods(rejected)) == ["_local", "_free", "_paper"]
    assert len(list_quantities(rejected)[0].values) == 3
    assert "not shown, because the tracks reject it" in " ".join(explain_dashes(rejected))
    assert "" in order_methods(rejected | {"recommended": "none"})
    assert "" in order_methods(rejected | {"r_std": 0.1})


def test_a_misfit_for_an_impossible_value_names_it_and_not_the_tracks():
    bare = {f"{name}_std": np.nan for name in QUANTITY_NAMES}
    disproved = row("misfit", flags="balls overlap|r over 1", model_rejected=False, **bare)
    assert describe_status(disproved).endswith("slide, but only with r over 1, and no two balls can have that")
    assert "no error: r over 1 is impossible" in explain_dashes(disproved)
    shown = disproved | {"recommended": "local", "why": "the tied fit has an impossible value: r over 1"}
    assert "not shown, because r over 1 is impossible" in " ".join(explain_dashes(shown))
    assert "Their tracks reject the model" in describe_status(disproved | {"model_rejected": True})


def test_what_was_not_measured_is_said():
    assert describe_status(row("no balls")) == "Not measured: no balls"
    said = "\n".join(format_for_terminal(pd.DataFrame([row("misfit", r_std=np.nan)])))
    assert "Their tracks reject" in said
    alone = "\n".join(format_for_terminal(pd.DataFrame([row(ONE_BALL, frame_last=-1)])))
    assert alone.startswith("clip 0: One ball is followed, and its track is written. There is no collision to measure")
    speed = {"v0": 0.5, "v0_std": 0.01, "drag": 0.2, "decel": 0.1, "cov": '{"rolling_loss": [[0.2, 0.0317]]}'}
    rolling = "\n".join(format_for_terminal(pd.DataFrame([row("no_collision", **speed)])))
    assert "No two balls touch. One ball moves by itself." in rolling
    assert "50.0(10)" in rolling
    assert "speed of the ball where it is first seen" in rolling
    assert "The rolling loss at that speed is 20.0(32) cm/s²." in rolling
    refused = speed | {"drag": np.nan, "decel": np.nan}
    assert describe_rolling(row("no_collision", **refused)) == "The rolling loss at that speed is 20.0(32) cm/s²"
    sliding = speed | {"cov": '{"rolling_loss": [[2.27, 0.02]]}'}
    assert describe_rolling(row("no_collision", **sliding)) == (
        "It loses 227.0(20) cm/s², more than balls that roll: if it slides on a level plate, μk is 0.2314(20)"
    )
    for unknown in ("[[null,null]]", "[[0.2,null]]", "[[0.2,0.3]]"):
        assert describe_rolling(row("no_collision", **speed | {"cov": f'{{"rolling_loss":{unknown}}}'})) == ""
    nothing = row("no_collision", **{f"{name}{end}": np.nan for name in OF_ONE_BALL for end in ("", "_std")})
    assert describe_status(nothing) == "No two balls touch"
    assert "rolling loss" in rolling
    assert "restitution" not in rolling


def test_a_rejected_fit_claims_no_duration_beside_the_one_by_the_bend_of_the_paths():
    row = {"status": "misfit", "flags": "contact lasts", "contact_first": 119.0, "contact_last": 122.0}
    row |= {"contact_duration_s": 0.0073, "contact_duration_s_std": 0.0001}
    row |= {"contact_duration_local": 0.0236, "contact_duration_local_std": 0.0016}
    text = describe_contact(row)
    assert text.startswith("By the bend of their paths the bodies push each other for 23.6(16) ms")
    assert "The fit that the tracks reject takes 7.3 ms; the fits leave out frames 119 to 122" in text
    assert "The contact lasts 7.30(10) ms" in describe_contact(row | {"status": "ok"})
