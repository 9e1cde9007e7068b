"""The start of a run."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from synthcam.dynamics.kinematics import contact_velocity
from synthcam.dynamics.launch import Launch
from synthcam.model import Model

R = Model().ball.radius
PAIR, ALONE = Model().bodies("ab"), Model().bodies("b")


@given(st.floats(-0.999999, 0.999999), st.floats(0.01, 1), st.floats(-10, 10))
def test_a_pair_touches_and_one_rolls(b, v0, heading):
    launch = Launch.pair(PAIR, 0.3, v0, b, heading, (0.01, -0.02))
    target, striker = launch.states
    d = np.array([np.cos(heading), np.sin(heading)])
    apart = striker[:2] - target[:2]
    assert launch.time == 0.3
    np.testing.assert_allclose(np.hypot(*apart), 2 * R, rtol=1e-12)
    np.testing.assert_allclose(d[0] * apart[1] - d[1] * apart[0], 2 * R * b, rtol=0, atol=1e-15)
    assert striker[3:5] @ apart < 0
    np.testing.assert_allclose(striker[3:5], v0 * d, rtol=1e-12, atol=1e-15)
    assert not target[3:].any()
    np.testing.assert_allclose(contact_velocity(launch.states, R), 0, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(launch.states[:, 2], R)


def test_one_ball_alone():
    launch = Launch.single(ALONE, 0.1, 0.2, np.pi / 2, (0.01, 0.02))
    assert launch.states.shape == (1, 9)
    np.testing.assert_allclose(launch.states[0, :6], [0.01, 0.02, R, 0, 0.2, 0], rtol=0, atol=1e-16)
    np.testing.assert_allclose(launch.states[0, 6:], [-0.2 / R, 0, 0], rtol=0, atol=1e-12)
