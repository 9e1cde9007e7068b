"""The instants at which balls meet and stop, in closed form: grazes, slopes, and a ball at rest that is hit again."""

import numpy as np
import pytest

from synthcam.dynamics.kinematics import rolling_state
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.effects.plate_tilt import PlateTilt
from synthcam.model import Model

R, G = Model().ball.radius, 9.81
exact = pytest.approx


def rolling(x, y, vx):
    return rolling_state(np.array([x, y], float), np.array([vx, 0.0]), 0.0, R)


def launched(model, *states):
    return solve(model, Launch(0.0, np.stack(states), model.bodies("abb"[: len(states)])), 0.0, 40.0)


def to_rest(model, v0):
    """Compute where and when a ball hit head-on at v0 rests again: (length, time). Rolling loss is constant."""
    v, mu = (1 + model.restitution) / 2 * v0, model.sliding_friction * G
    slip = v + model.spin_transfer * v0  # the striker's contact turns it backwards
    slide = slip / (3.5 * mu)
    rolls = v - mu * slide
    length = v * slide - mu * slide**2 / 2 + rolls**2 / (2 * model.rolling_decel)
    return length, slide + rolls / model.rolling_decel


@pytest.mark.parametrize("v0", [0.1, 0.3])
@pytest.mark.parametrize("speed", [0.02, 0.06])
def test_a_ball_that_has_stopped_is_hit_again(v0, speed):
    """From the other side, by a ball that has been on its way all the while."""
    model = Model(rolling_drag=0, rolling_decel=0.02)
    decel = model.rolling_decel
    near = 0.01
    first = (v0 - np.sqrt(v0**2 - 2 * decel * near)) / decel
    hit_at = v0 - decel * first
    length, lasts = to_rest(model, hit_at)
    late = first + lasts + 0.05
    met = speed + decel * late  # how fast the third ball is sent
    away = met * late - decel * late**2 / 2
    motion = launched(model, rolling(0, 0, 0), rolling(-2 * R - near, 0, v0), rolling(length + 2 * R + away, 0, -met))
    stop = next(e for e in motion.events if e.kind == "stop" and e.i == 0)
    contacts = [e for e in motion.events if e.kind == "contact"]
    assert contacts[0].t == exact(first, rel=1e-13)
    assert stop.t == exact(first + lasts, rel=1e-13)
    assert stop.after[0, 0] == exact(length, rel=1e-13)
    assert (contacts[1].i, contacts[1].j) == (0, 2)
    assert contacts[1].t == exact(late, rel=1e-12)
    assert contacts[1].before[1, 3] == exact(-speed, rel=1e-12)
    assert contacts[1].after[0, 3] == exact(-(1 + model.restitution) / 2 * speed, rel=1e-12)
    back, took = to_rest(model, speed)
    again = next(e for e in motion.events if e.kind == "stop" and e.i == 0 and e.t > late)
    assert again.t == exact(late + took, rel=1e-12)
    assert again.after[0, 0] == exact(length - back, rel=1e-12)


@pytest.mark.parametrize(("v", "tilt"), [(0.05, 1e-3), (0.3, 1e-3), (0.3, -1e-3), (0.06, -1e-3)])
def test_a_contact_on_a_slope(v, tilt):
    """A uniformly accelerated roll, led numerically."""
    model, way = Model(rolling_drag=0, effects=(PlateTilt(x=tilt),)), 0.02
    hit = launched(model, rolling(0, 0, 0), rolling(-way - 2 * R, 0, v)).first("contact")
    a = 5 / 7 * G * np.sin(tilt) - model.rolling_decel
    speed = np.sqrt(v * v + 2 * a * way)
    assert hit.t == exact(2 * way / (v + speed), rel=1e-13)
    assert hit.before[1, 3] == exact(speed, rel=1e-12)


@pytest.mark.parametrize("effects", [(), (PlateTilt(x=1e-3),)], ids=["level", "slope"])
@pytest.mark.parametrize("drag", [0.0, 0.135])
@pytest.mark.parametrize("side", [1, -1])
def test_grazes_to_the_eleventh_digit(side, drag, effects):
    model = Model(rolling_drag=drag, effects=effects)
    for miss, hits in ((-1e-11, True), (1e-11, False)):
        motion = launched(model, rolling(0, 0, 0), rolling(-0.02, side * 2 * R * (1 + miss), 0.3))
        assert (motion.first("contact") is not None) == hits
