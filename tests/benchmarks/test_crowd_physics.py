"""The scores of films over seeds, and the truth of balls that leave the picture."""

import numpy as np
import pytest

import synthcam
from benchmarks.tracker.crowd_physics import QUANTITIES, read_true_loss, summarise
from benchmarks.tracker.gas import read_true_curves


def row(value, std, truth):
    return {"value": value, "std": std, "truth": truth}


def test_scores_are_those_of_the_films_that_give_a_value():
    films = [{"r": [row(0.91, 0.01, 0.9)]}, {"r": [row(0.87, 0.01, 0.9)]}, {}]
    found = summarise(films)
    assert set(found) == set(QUANTITIES)
    assert found["mu_k"] == {"films": 0}
    assert found["r"] == pytest.approx(
        {"films": 2, "ratio": 0.89 / 0.9, "error": 0.01 / 0.9, "mean": -1, "rms": np.sqrt(5), "cover95": 0.5}
    )


def test_true_curves_are_those_of_the_balls_in_view():
    clip = synthcam.Scene.read("crowd", timing={"frames": 100}).draw(seed=1)
    curves = read_true_curves(clip)[0]
    tracks = clip.tracks
    assert not tracks.visible.all()
    seen = tracks[tracks.visible]
    last = seen[seen.frame == 99]
    assert curves["temperature"].iloc[-1] == pytest.approx(last[["vx", "vy"]].var(ddof=1).mean())
    assert curves["energy"].iloc[-1] == pytest.approx((last[["vx", "vy"]] ** 2).to_numpy().sum() / 2)
    energy = (tracks.vx**2 + tracks.vy**2).to_numpy() / 2
    left = tracks.assign(energy=energy)[~tracks.visible].groupby("particle").first()["energy"]
    lost = curves[["lost_in_contacts", "lost_at_walls", "lost_to_plate"]].iloc[-1].sum()
    # a ball that left took the energy of its last frame in view, which is nearly that of the next
    assert curves["energy"].iloc[0] - curves["energy"].iloc[-1] - left.sum() == pytest.approx(lost, rel=0.02)


def test_the_loss_of_discs_on_air_is_that_of_their_support():
    assert read_true_loss(synthcam.Scene.read("pucks").draw(seed=1)) == (0.05, 0.02)
    assert read_true_loss(synthcam.Scene.read("crowd").draw(seed=1)) == (0.135, 0.0103)
