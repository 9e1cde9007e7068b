"""Against pooltool (PyPI pooltool-billiards), of which only what it does right: legs, their ends, the normal impulse.

Its spin transfer takes the speed after the impact: so here no spin is passed on. It parts touching balls by 1 um, which
turns an oblique impact's normal a little.
"""

import importlib.util

import numpy as np
import pytest

from synthcam.dynamics import solve
from synthcam.launch import Launch
from synthcam.model import Model

if importlib.util.find_spec("pooltool") is None:
    pytest.skip("pooltool is not installed: pip install pooltool-billiards", allow_module_level=True)

import attrs
import pooltool as pt
from pooltool.physics.resolve.ball_ball.friction import AverageBallBallFriction
from pooltool.physics.resolve.ball_ball.frictional_inelastic import FrictionalInelastic
from pooltool.physics.resolve.resolver import default_resolver

MODEL = Model(spin_transfer=0.0, rolling_drag=0.0)
R = MODEL.ball.radius
SPACER = 1e-6  # m, of theirs


def shot(v0, b):
    numbers = {"m": MODEL.ball.mass, "R": R, "u_s": MODEL.sliding_friction, "u_b": 1e-12, "e_b": MODEL.restitution}
    numbers |= {"u_r": MODEL.rolling_decel / MODEL.gravity, "g": MODEL.gravity}
    balls = {name: pt.Ball(name, params=pt.BallParams(**numbers)) for name in "ab"}
    balls["a"].state.rvw[0] = [0.5, 0.5, R]
    balls["b"].state.rvw[0] = [0.47, 0.5 + 2 * R * b, R]
    balls["b"].state.rvw[1:] = [[v0, 0, 0], [0, v0 / R, 0]]
    balls["b"].state.s = 3  # rolling
    return pt.System(cue=pt.Cue(cue_ball_id="b"), table=pt.Table.default(), balls=balls)


@pytest.mark.parametrize(("v0", "b"), [(0.3, 0.2), (0.1, 0.0), (0.5, -0.7)])
def test_a_collision(v0, b):
    impact = FrictionalInelastic(friction=AverageBallBallFriction())
    engine = pt.physics.PhysicsEngine(resolver=attrs.evolve(default_resolver(), ball_ball=impact))
    out = pt.simulate(shot(v0, b), engine=engine, t_final=0.3)
    theirs = {(str(e.event_type), e.ids): e for e in out.events}
    states = np.stack([s.rvw.ravel() for s in (shot(v0, b).balls[k].state for k in "ab")])
    motion = solve(MODEL, Launch(0.0, states, MODEL.bodies("ab")), 0.0, 0.3)
    hit = next(e for (kind, _), e in theirs.items() if kind == "ball_ball")
    assert motion.first("contact").t == pytest.approx(hit.time, abs=1e-11)
    after = np.stack([next(a for a in hit.agents if a.id == k).final.state.rvw.ravel() for k in "ab"])
    turned = 2 * SPACER / R * v0  # by the spacer, at most
    np.testing.assert_allclose(motion.first("contact").after[:, 3:6], after[:, 3:6], rtol=0, atol=turned + 1e-12)
    legs = solve(MODEL, Launch(hit.time, after, MODEL.bodies("ab")), hit.time, 0.3)  # from their impact on
    for ball, name in enumerate("ab"):
        ours = legs.first("slide_end", ball)
        end = theirs["sliding_rolling", (name,)]
        assert ours.t == pytest.approx(end.time, abs=1e-11)
        final = next(a for a in end.agents if a.id == name).final.state.rvw
        np.testing.assert_allclose(ours.after[0], final.ravel(), rtol=0, atol=1e-9)
        if b == 0:
            assert motion.first("slide_end", ball).t == pytest.approx(end.time, abs=1e-11)
