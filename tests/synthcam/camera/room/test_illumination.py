"""Light on balls and plate against a path tracer (benchmarks.camera.room_reference) that shares no line with it."""

import numpy as np
import pytest

from benchmarks.camera.room_reference import CASES, R, errors
from synthcam.camera.lamp import Lamp
from synthcam.camera.room.finish import BallFinish, SurfaceFinish
from synthcam.camera.room.illumination import Illumination

LAMP = Lamp(np.array([0.2, 0.1, 0.5]), 0.03)
ALONE, PAIR = 0.02, 0.055  # of the plate's light, rms over a region


@pytest.mark.parametrize("case", CASES)
def test_light_is_that_of_paths(case):
    most = ALONE if CASES[case][0] is None else PAIR
    for region, found in errors(case, 1500).items():
        assert found["rms"] < most + found["tracer"], region


def shade(ambient, colours=((0.8,),), plate=(0.5,), lamp=LAMP):
    return Illumination(
        lamp,
        SurfaceFinish(tuple(BallFinish(c, c) for c in colours), plate, ambient=ambient),
        np.full(len(colours), R),
        None,
    )


def test_the_open_plate_at_the_origin_is_one():
    for ambient in (0.0, 0.3, 1.0):
        assert shade(ambient).bare(np.zeros((1, 3)))[0] == pytest.approx(1)
    far = np.array([[0.2, 0.1, 0.0], [-0.2, -0.1, 0]])
    lit = shade(0.0).bare(far)
    way = LAMP.position - far
    np.testing.assert_allclose(
        lit[0] / lit[1], (np.linalg.norm(way, axis=1) ** -4)[0] / (np.linalg.norm(way, axis=1) ** -4)[1], rtol=0.01
    )


def test_black_balls_throw_nothing_and_white_ones_do():
    centres, points = np.array([[0.0, 0.0, R]]), np.array([[1.3 * R, 0.0, 0.0]])
    dark, white = (shade(0.5, ((c,),)).on_plate(points, centres)[0, 0] for c in (0.0, 0.9))
    assert dark < white - 0.01
    assert dark < 1


def test_a_red_ball_reddens_the_plate():
    look = shade(0.5, ((0.8, 0.05, 0.05),), (0.7, 0.7, 0.7))
    r, g, b = look.on_plate(np.array([[1.2 * R, 0.0, 0.0]]), np.array([[0.0, 0.0, R]]))[0]
    assert r > g + 0.01
    assert g == pytest.approx(b)


def test_wide_lamps_are_cut_and_keep_their_light():
    wide = Lamp(np.array([0.0, 0.0, 0.5]), 0.25)
    found = shade(0.0, lamp=wide)
    assert len(found.cells) > 4
    assert found.bare(np.zeros((1, 3)))[0] == pytest.approx(1)
