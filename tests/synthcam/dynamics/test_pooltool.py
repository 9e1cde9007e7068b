"""Against pooltool 0.6 (its answers: pooltool_shots.json), of which only what it does right: legs, their ends, impact.

Its spin transfer takes the speed after the impact: so here no spin is passed on. It parts touching balls by 1 um, which
turns an oblique impact's normal a little.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.model import Model

THEIRS = json.loads(Path(__file__).with_name("pooltool_shots.json").read_text(encoding="utf-8"))
MODEL = Model(spin_transfer=0.0, rolling_drag=0.0)
SPACER = 1e-6  # m, of theirs


def test_the_same_balls():
    assert MODEL.ball.mass == pytest.approx(THEIRS["mass"], rel=1e-12)
    assert MODEL.ball.radius == THEIRS["radius"]


@pytest.mark.parametrize("shot", THEIRS["shots"], ids=lambda shot: f"v0={shot['v0']},b={shot['b']}")
def test_a_collision(shot):
    motion = solve(MODEL, Launch(0.0, np.array(shot["start"]), MODEL.bodies("ab")), 0.0, 0.3)
    hit, after = shot["contact"], np.array(shot["contact"]["after"])
    assert motion.first("contact").t == pytest.approx(hit["t"], abs=1e-11)
    turned = 2 * SPACER / THEIRS["radius"] * shot["v0"]  # by the spacer, at most
    np.testing.assert_allclose(motion.first("contact").after[:, 3:6], after[:, 3:6], rtol=0, atol=turned + 1e-12)
    legs = solve(MODEL, Launch(hit["t"], after, MODEL.bodies("ab")), hit["t"], 0.3)  # from their impact on
    for ball, end in enumerate(shot["slide_end"]):
        ours = legs.first("slide_end", ball)
        assert ours.t == pytest.approx(end["t"], abs=1e-11)
        np.testing.assert_allclose(ours.after[0], end["after"], rtol=0, atol=1e-9)
        if shot["b"] == 0:
            assert motion.first("slide_end", ball).t == pytest.approx(end["t"], abs=1e-11)
