"""Write pooltool_break.json: a nine-ball break and hits on a cushion by pooltool 0.6.0. test_tabletop.py reads it.

See pooltool_shots.py for how to install it. simplepbr, which draws, may be a module that has a
class `Pipeline` alone.
"""

import json
import math
from pathlib import Path

import attrs
import numpy as np
import pooltool as pt
from pooltool.physics.resolve.ball_ball.friction import AverageBallBallFriction
from pooltool.physics.resolve.ball_ball.frictional_inelastic import FrictionalInelastic
from pooltool.physics.resolve.ball_cushion.han_2005 import Han2005Circular, Han2005Linear, han2005
from pooltool.physics.resolve.ball_cushion.mathavan_2010.model import solve
from pooltool.physics.resolve.resolver import default_resolver

R, MASS, GRAVITY = 0.03075, 0.21, 9.81
NUMBERS = {"u_s": 0.2, "u_b": 1e-12, "e_b": 0.95, "u_r": 0.01, "e_c": 0.85, "f_c": 0.2, "u_sp_proportionality": 1e-12}
GAP, SPEED, ASIDE = 1e-3, 6.0, 4e-3  # between racked balls, m; of the cue ball, m/s; how far it is off the middle, m


def system() -> pt.System:
    """Nine balls in a diamond, and one that rolls at them."""
    places = [(0.0, 0.0)]
    for row, count in enumerate((1, 2, 3, 2, 1)):
        across = (np.arange(count) - (count - 1) / 2) * (2 * R + GAP)
        places += [(x, 1.2 + row * math.sqrt(3) / 2 * (2 * R + GAP)) for x in across]
    balls = {}
    for k, (x, y) in enumerate(places):
        ball = balls[str(k)] = pt.Ball(str(k), params=pt.BallParams(m=MASS, R=R, g=GRAVITY, **NUMBERS))
        ball.state.rvw[0] = [0.71 + x + ASIDE * (k == 0), 0.7 + y, R]
    balls["0"].state.rvw[1:] = [[0, SPEED, 0], [-SPEED / R, 0, 0]]
    balls["0"].state.s = 3  # rolling
    table = pt.Table.from_table_specs(pt.objects.BilliardTableSpecs())
    return pt.System(cue=pt.Cue(cue_ball_id="0"), table=table, balls=balls)


def engine() -> pt.physics.PhysicsEngine:
    laws = {
        "ball_ball": FrictionalInelastic(friction=AverageBallBallFriction()),
        "ball_linear_cushion": Han2005Linear(),
        "ball_circular_cushion": Han2005Circular(),
    }
    return pt.physics.PhysicsEngine(resolver=attrs.evolve(default_resolver(), **laws))


def hit(rng: np.random.Generator, height: float) -> dict:
    """A ball that hits a cushion to its right, with any spin."""
    before = np.array([[0, 0, R], [rng.uniform(0.2, 5), rng.uniform(-5, 5), 0], rng.uniform(-100, 100, 3)])
    friction = float(rng.choice([0.05, 0.2, 0.6]))
    after = han2005(before.copy(), np.array([1.0, 0, 0]), R, MASS, height, 0.85, friction)
    return {"before": before.ravel().tolist(), "friction": friction, "after": after.ravel().tolist()}


def press(rng: np.random.Generator, height: float) -> dict:
    """The same by the equations of Mathavan et al., in 10,000 and 100,000 steps: velocity and spin after each."""
    vx, vy, *spin = rng.uniform(0.2, 5), rng.uniform(-5, 5), *rng.uniform(-100, 100, 3)
    friction = float(rng.choice([0.05, 0.2, 0.6]))
    turned = (-vy, vx, -spin[1], spin[0], spin[2])  # its cushion is at +y
    after = []
    for steps in (10_000, 100_000):
        a, b, wa, wb, wz = solve(MASS, R, height, 0.85, NUMBERS["u_s"], friction, *turned, steps, 1e-9)
        after.append([b, -a, wb, -wa, wz])
    return {"before": [0, 0, R, vx, vy, 0, *spin], "friction": friction, "after": after}


if __name__ == "__main__":
    specs = pt.objects.BilliardTableSpecs()
    events = [event for event in pt.simulate(system(), engine=engine()).events if str(event.event_type) != "none"]
    rng = np.random.default_rng(1)
    written = {
        "pooltool": pt.__version__,
        "radius": R,
        "mass": MASS,
        "gravity": GRAVITY,
        **NUMBERS,
        "size": [specs.w, specs.l],
        "height": specs.cushion_height,
        "start": [ball.state.rvw.ravel().tolist() for ball in system().balls.values()],
        "events": [[e.time, str(e.event_type), list(e.ids)] for e in events],
        "cushion": [hit(rng, specs.cushion_height) for _ in range(20)],
        "mathavan": [press(rng, specs.cushion_height) for _ in range(10)],
    }
    Path(__file__).with_suffix(".json").write_text(json.dumps(written) + "\n", encoding="utf-8")
