"""Orientations, against the path of a rolling ball and scipy's integration of the quaternion's equation."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import synthcam
from synthcam.dynamics.orientation import OrientationHistory

R = 1.19e-3
FIRST = np.array([[0, 0, 0, 1.0], [0.1, -0.5, 0.3, 0.8]])


def motion(**launch):
    scene = synthcam.Scene.read("painter_behringer", launch={"v0": 0.3, "b": 0.4, "heading": 0.7} | launch)
    return scene.draw().view.motion


def test_a_rolling_ball_turns_by_its_path_over_its_radius():
    solved = motion()
    turning, times = OrientationHistory(solved, FIRST), np.array([0.0, 0.013, 0.05])
    path = np.linalg.norm(solved.at(times)[1, :, :2] - solved.at([0.0])[1, 0, :2], axis=1)
    axis = np.array([-np.sin(0.7), np.cos(0.7), 0])
    expected = Rotation.from_rotvec(path[:, None] / R * axis) * Rotation.from_quat(FIRST[1])
    assert (turning.at(1, times) * expected.inv()).magnitude().max() < 1e-9
    assert (turning.at(0, times) * Rotation.from_quat(FIRST[0]).inv()).magnitude().max() == 0


@pytest.mark.parametrize("ball", [0, 1])
def test_through_the_collision_and_the_slides(ball):
    solved = motion()
    turning = OrientationHistory(solved, FIRST)
    turn = FIRST[ball] / np.linalg.norm(FIRST[ball])
    cuts = [solved.t0, *sorted(e.t for e in solved.events if ball in (e.i, e.j)), solved.t1]
    for start, end in pairwise(cuts):

        def rate(t, q, start=start, end=end):
            inside = min(max(t, start), np.nextafter(end, start))
            w = solved.at([inside])[ball, 0, 6:9]
            return 0.5 * np.array([*(q[3] * w + np.cross(w, q[:3])), -w @ q[:3]])

        middle = (start + end) / 2
        found = solve_ivp(rate, (start, end), turn, rtol=1e-9, atol=1e-11, t_eval=[middle, end])
        at_middle = Rotation.from_quat(found.y[:, 0])
        assert (turning.at(ball, np.array([middle]))[0] * at_middle.inv()).magnitude() < 1e-4
        turn = found.y[:, 1] / np.linalg.norm(found.y[:, 1])


def test_one_ball_moves_as_among_all():
    solved = motion()
    times = np.linspace(solved.t0, solved.t1, 50)
    for ball in (0, 1):
        np.testing.assert_array_equal(solved.at_one(ball, times), solved.at(times)[ball])
    with pytest.raises(ValueError, match="outside the trajectory"):
        solved.at_one(0, times + 1)
