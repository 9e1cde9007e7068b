"""Strikers that do not roll up to the hit: filmed by an integration of the forces, found as what they are."""

import numpy as np
import pandas as pd
import pytest
from tracker_forces import R, spring_collision, tied

from tracker import measure
from tracker.measurement.collision.adequacy import MISFIT

pytestmark = pytest.mark.usefixtures("not_local")

CAMERA = {"fps": 250.0, "scale": 1.6e-4, "size": [800, 800], "ball_diameter": 2 * R, "exposure": 0.0}
NOISE = 0.01  # px
WHEN = np.arange(90) / 250


def tracks(seed, **changes):
    """Tracks of a struck and a striking ball, px with errors."""
    truth, rng = spring_collision(tied(**changes), WHEN), np.random.default_rng(seed)
    parts = []
    for ball in (1, 2):
        x, y = truth[ball].T / CAMERA["scale"] * [[1], [-1]] + 400 + rng.normal(0, NOISE, (2, len(WHEN)))
        errors = {"x_std": NOISE, "y_std": NOISE}
        parts.append(pd.DataFrame({"frame": np.arange(len(WHEN)), "particle": ball, "x": x, "y": y, **errors}))
    return pd.concat(parts)


def z(row, name, true):
    return (row[name] - true) / row[f"{name}_std"]


DRAW = {"ux": 0.13 * np.cos(0.7), "uy": 0.13 * np.sin(0.7), "side": 0.0, "beta": 0.4, "C": 0.1}


SPINS = [DRAW | {"side": 0.08}, {"ux": -0.1, "uy": 0.05, "side": 0.05, "beta": -0.5, "C": 0.2}]


def test_a_striker_that_slides_is_fitted_as_sliding():
    """The z of all together are as large as N(0, 1) makes them, within 4 sampling errors."""
    every = []
    for seed, spin in enumerate(SPINS):
        row = measure(tracks(seed, **spin), CAMERA).rows[0]
        assert row["status"] == "ok"
        assert "striker slides" in row["flags"].split("|")
        true = {"r": 0.903, "mu_k": 0.232, "v0": 0.3, "u2ix": spin["ux"], "u2iy": spin["uy"], "side2i": spin["side"]}
        every += [z(row, name, value) for name, value in true.items()]
    assert np.abs(every).max() < 4
    assert abs(np.sqrt(np.mean(np.square(every))) - 1) < 4 / np.sqrt(2 * len(every))


def test_side_spin_alone_is_found():
    row = measure(tracks(1, side=0.1, beta=0.5), CAMERA).rows[0]
    assert (row["status"], row["flags"]) == ("ok", "striker spins")
    assert abs(z(row, "side2i", 0.1)) < 4
    assert abs(z(row, "r", 0.903)) < 4


def test_a_striker_that_rolls_is_fitted_as_before():
    row = measure(tracks(2), CAMERA).rows[0]
    assert (row["status"], row["flags"]) == ("ok", "")
    assert row["u2ix"] == row["u2iy"] == row["side2i"] == 0
    assert np.isnan(row["side2i_std"])


def test_one_that_rolls_late_is_fitted_from_then_on():
    table = tracks(3)
    early = (table["particle"] == 2) & (table["frame"] < 8)
    table.loc[early, "x"] -= 0.05 * (8 - table["frame"][early]) ** 2  # it slides at first
    row = measure(table, CAMERA).rows[0]
    assert (row["status"], row["flags"]) == ("ok", "rolls late")
    assert abs(z(row, "r", 0.903)) < 4


def test_what_no_spin_explains_stays_a_misfit():
    table = tracks(4)
    late = (table["particle"] == 1) & (table["frame"] > 50)
    table.loc[late, "y"] += 0.002 * (table["frame"][late] - 50) ** 2  # a slope on one side
    row = measure(table, CAMERA).rows[0]
    assert row["status"] == MISFIT
    assert np.isnan(row["r_std"])


def pushed(seed, frames):
    """Tracks in which the striker rests, is pushed for 12 frames, and rolls for the last so many before frame 22."""
    whole, rng = tracks(seed), np.random.default_rng(seed)
    rolls = whole[(whole["particle"] == 2) & (whole["frame"] < 22)]
    x, y = (np.polyfit(rolls["frame"], rolls[name], 2) for name in ("x", "y"))
    first = 22 - frames
    back = np.maximum(np.arange(-30, first) - first, -12)  # frames before the push ends, 12 at most
    way = back + back**2 / 24  # of the speed with which it rolls off: evenly speeded up
    start = pd.DataFrame({"frame": np.arange(-30, first), "particle": 2, "x_std": NOISE, "y_std": NOISE})
    for name, fit in (("x", x), ("y", y)):
        speed = np.polyval(np.polyder(fit), first)
        start[name] = np.polyval(fit, first) + speed * way + rng.normal(0, NOISE, len(way))
    target = whole[whole["particle"] == 1]
    rest = target.iloc[[0] * 30].assign(frame=np.arange(-30, 0))
    rest[["x", "y"]] = target[["x", "y"]].iloc[:20].mean().to_numpy() + rng.normal(0, NOISE, (30, 2))
    table = pd.concat([rest, start, whole[(whole["particle"] == 1) | (whole["frame"] >= first)]])
    return table.assign(frame=table["frame"] + 30)


@pytest.mark.parametrize("frames", [pytest.param(20, marks=pytest.mark.gate), 12])
def test_a_hand_that_pushes_the_striker_is_left_out(frames):
    """It is no noise that lasts from frame to frame, which would leave an error of r that nothing rejects."""
    row = measure(pushed(4, frames), CAMERA).rows[0]
    assert (row["status"], row["flags"], row["noise_rho"]) == ("ok", "rolls late", 0)
    assert abs(z(row, "r", 0.903)) < 4
    assert row["r_std"] < 0.01


def test_a_push_until_just_before_the_hit_is_no_noise():
    """Too few frames are left to see how it ends; what it leaves lasts, as no error of the positions does."""
    row = measure(pushed(8, 8), CAMERA).rows[0]
    assert (row["status"], row["noise"], row["noise_rho"]) == (MISFIT, "given", 0)
    assert np.isnan(row["r_std"])
