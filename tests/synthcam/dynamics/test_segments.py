"""Each kind of leg: its mean places against a fine sum over its own states, its states against the laws of motion."""

import dataclasses

import numpy as np
import pytest
from everything import BENT, R
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from synthcam.dynamics.forces import BallStates
from synthcam.dynamics.integrated_motion import average_by_quadrature
from synthcam.dynamics.kinematics import contact_velocity, rolling_state
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.propagate import propagate
from synthcam.dynamics.segments import (
    FlightSegment,
    IntegratedSegment,
    PackedRows,
    RestSegment,
    RollSegment,
    SlideSegment,
    TrajectorySegment,
    split_segment,
)
from synthcam.dynamics.solve import solve
from synthcam.model import Model

BODIES = Model().bodies("bb")
START = np.array([0.1, 0.3])
SLIPPING = np.array(
    [[0.001, -0.002, R, 0.25, 0.1, 0.0, 120, -60, 40], [0.003, 0.004, R, -0.1, 0.3, 0, -20, 90, -70]], dtype=float
)
SPEEDS = np.array([[0.2, -0.1], [-0.05, 0.4]])
ROLLING = rolling_state(np.array([[0.001, 0.002], [-0.003, 0]]), SPEEDS, np.array([7.0, 0]), np.full(2, R))
WHO = np.array([0, 1])


def legs():
    gone = SLIPPING.copy()
    gone[:, 5] = 0.1
    slowing = np.full(2, 0.232 * 9.81)
    lasts = np.hypot(*contact_velocity(SLIPPING, R).T) / 3.5 / slowing
    radius, end = BODIES.radius, START + 0.02
    yield RestSegment(WHO, START, end, ROLLING * [1, 1, 1, 0, 0, 0, 0, 0, 1])
    yield SlideSegment(WHO, START, START + lasts, SLIPPING, radius, slowing, np.full(len(WHO), 0.4))
    yield RollSegment(WHO, START, START + 1, START + 0.2, ROLLING, radius, 0.135, 0.0103)
    yield RollSegment(WHO, START, START + 1, START + 0.2, ROLLING, radius, 1e-5, 0.0103)
    yield RollSegment(WHO, START, START + 1, START, ROLLING, radius, 3.0, 0.0)
    yield FlightSegment(WHO, START, end, gone, 9.81)
    slow = ROLLING * np.array([1, 1, 1, 1e-7, 1e-7, 1, 1e-7, 1e-7, 1])
    for model, states in ((BENT, gone), (BENT, SLIPPING), (BENT, ROLLING), (Model(), ROLLING), (Model(), slow)):
        for units, way in propagate(BallStates.without_drilling(model, BODIES, states), np.full(2, 0.3)):
            yield from IntegratedSegment.of(WHO[units], way.motion.shift(START[units]), 1e3)


def test_the_parts_of_a_segment_have_its_balls():
    for leg in legs():
        parts = split_segment(leg, 1)
        assert len(parts) == (1 if isinstance(leg, IntegratedSegment) else len(leg.who))
        for method, *more in (("states",), ("average_centres", 1e-3)):
            times = np.linspace(leg.begins + 1e-3, leg.ends - 1e-3, 5, axis=1)
            theirs = [getattr(part, method)(times[part.who], *more) for part in parts]
            axis = 0 if method == "states" else 1
            np.testing.assert_array_equal(np.concatenate(theirs, axis=axis), getattr(leg, method)(times, *more))


def turns(leg):
    return isinstance(leg, IntegratedSegment) and leg.motion.power == 3


@pytest.mark.parametrize("leg", list(legs()), ids=lambda leg: type(leg).__name__)
@pytest.mark.parametrize("whole", [True, False])
@pytest.mark.parametrize("part", [1e-4, 0.03])
def test_means_are_those_of_the_states(leg, whole, part):
    lasts = leg.ends - leg.begins
    shares = np.linspace(0.5 * part, 1 - 0.5 * part, 5)
    middle = leg.begins[:, None] + shares * lasts[:, None]
    wide = part * float(lasts.min()) if whole else part * np.repeat(lasts[:, None], 5, axis=1)
    nodes, weights = np.polynomial.legendre.leggauss(20)
    times = middle[..., None] + nodes * (np.asarray(wide) / 2 + 0 * middle)[..., None]
    x = leg.states(times.reshape(len(lasts), -1))[..., :2].reshape(len(lasts), 5, 20, 2)
    atol = 5e-12 if turns(leg) else 2e-13  # the slip's direction turns without end at its end
    np.testing.assert_allclose(
        leg.average_centres(middle, wide), np.einsum("kmni,n->ikm", x, weights / 2), rtol=0, atol=atol
    )


@pytest.mark.parametrize("leg", list(legs()), ids=lambda leg: type(leg).__name__)
def test_no_width_is_an_instant(leg):
    times = leg.begins[:, None] + np.array([0.1, 0.5, 0.9]) * (leg.ends - leg.begins)[:, None]
    at = np.moveaxis(leg.states(times)[..., :2], -1, 0)
    np.testing.assert_allclose(leg.average_centres(times, 0.0), at, rtol=0, atol=1e-14)
    np.testing.assert_allclose(leg.average_centres(times, 0 * times), at, rtol=0, atol=1e-14)


def test_one_ball_of_a_run_with_its_kinks():
    model = Model()
    motion = solve(model, Launch.pair(model.bodies("ab"), 0.1, 0.4, 0.3, 1.0, (0, 0)), 0.0, 0.3)
    leg = TrajectorySegment(
        np.array([4]), np.zeros(1), np.full(1, 0.3), dataclasses.replace(motion, legs=motion.legs[1:])
    )
    times = np.linspace(0.002, 0.298, 2000)[None]
    x = leg.states(times)[0, :, :2]
    np.testing.assert_array_equal(x, motion.at(times[0])[1, :, :2])
    fine = np.linspace(-0.5, 0.5, 4001) * 0.004 + 0.1  # across the impact
    direct = motion.at(fine)[1, :, :2]
    mean = ((direct[1:] + direct[:-1]) / 2).mean(axis=0)
    np.testing.assert_allclose(leg.average_centres(np.array([[0.1]]), 0.004)[:, 0, 0], mean, rtol=0, atol=1e-10)


def test_gauss_is_exact_for_polynomials():
    middle, wide = np.array([[0.3, -0.2]]), np.array([[0.5, 2.0]])
    found = average_by_quadrature(lambda t: np.stack([t**7, t**6]), middle, wide)
    a, b = middle - wide / 2, middle + wide / 2
    np.testing.assert_allclose(found, [(b**8 - a**8) / 8 / wide, (b**7 - a**7) / 7 / wide], rtol=1e-13)


@given(arrays(bool, st.tuples(st.integers(1, 6), st.integers(1, 9))))
def test_each_row_of_a_packed_mask_keeps_its_own_in_order(mask):
    values = np.arange(mask.size, dtype=float).reshape(mask.shape)
    some = PackedRows(mask)
    packed = some.gather(values)
    assert packed.shape == (len(mask), mask.sum(axis=1).max())
    assert some.any == mask.any()
    for row, own, kept, taken in zip(values, mask, packed, some.inside, strict=True):
        np.testing.assert_array_equal(kept[: own.sum()], row[own])
        np.testing.assert_array_equal(kept[own.sum() :], 0.0)
        np.testing.assert_array_equal(taken, np.arange(len(taken)) < own.sum())
