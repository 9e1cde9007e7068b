"""Write pooltool_shots.json: what pooltool 0.6.0, another program, makes of a few shots. test_pooltool.py reads it.

pooltool and what it needs take 800 MB, so its answers are kept, not itself. To make them again, in an environment of
their own: pip install --no-deps pooltool-billiards==0.6.0 and, as they come, what it asks for (of panda3d any version).
"""

import json
import math
from pathlib import Path

import attrs
import pooltool as pt
from pooltool.physics.resolve.ball_ball.friction import AverageBallBallFriction
from pooltool.physics.resolve.ball_ball.frictional_inelastic import FrictionalInelastic
from pooltool.physics.resolve.resolver import default_resolver

R, DENSITY, GRAVITY = 1.19e-3, 7800, 9.81  # the paper's balls, SI
MASS = DENSITY * math.pi * (2 * R) ** 3 / 6
RESTITUTION, SLIDING, ROLLING = 0.903, 0.232, 0.0103 / GRAVITY
SHOTS = [(0.3, 0.2), (0.1, 0.0), (0.5, -0.7), (0.25, 0.55)]  # v0 in m/s, b


def shot(v0: float, b: float) -> pt.System:
    """A rolling striker, b's centre 3 cm behind the target's; its spin transfer is none."""
    numbers = {"m": MASS, "R": R, "u_s": SLIDING, "u_b": 1e-12, "e_b": RESTITUTION, "u_r": ROLLING, "g": GRAVITY}
    balls = {name: pt.Ball(name, params=pt.BallParams(**numbers)) for name in "ab"}
    balls["a"].state.rvw[0] = [0.5, 0.5, R]
    balls["b"].state.rvw[0] = [0.47, 0.5 + 2 * R * b, R]
    balls["b"].state.rvw[1:] = [[v0, 0, 0], [0, v0 / R, 0]]
    balls["b"].state.s = 3  # rolling
    return pt.System(cue=pt.Cue(cue_ball_id="b"), table=pt.Table.default(), balls=balls)


def seen(v0: float, b: float) -> dict:
    """States (9) before and after the contact, its time, and each ball's state and time when its slide ended."""
    impact = FrictionalInelastic(friction=AverageBallBallFriction())
    engine = pt.physics.PhysicsEngine(resolver=attrs.evolve(default_resolver(), ball_ball=impact))
    events = {(str(e.event_type), e.ids): e for e in pt.simulate(shot(v0, b), engine=engine, t_final=0.3).events}

    def state(agents, ball):
        return next(a for a in agents if a.id == ball).final.state.rvw.ravel().tolist()

    hit = next(e for (kind, _), e in events.items() if kind == "ball_ball")
    ends = {ball: events["sliding_rolling", (ball,)] for ball in "ab"}
    return {
        "v0": v0,
        "b": b,
        "start": [ball.state.rvw.ravel().tolist() for ball in shot(v0, b).balls.values()],
        "contact": {"t": hit.time, "after": [state(hit.agents, ball) for ball in "ab"]},
        "slide_end": [{"t": end.time, "after": state(end.agents, ball)} for ball, end in ends.items()],
    }


if __name__ == "__main__":
    given = {"mass": MASS, "radius": R, "gravity": GRAVITY, "restitution": RESTITUTION, "sliding_friction": SLIDING}
    written = {"pooltool": pt.__version__, **given, "shots": [seen(*values) for values in SHOTS]}
    Path(__file__).with_suffix(".json").write_text(json.dumps(written, indent=None) + "\n", encoding="utf-8")
