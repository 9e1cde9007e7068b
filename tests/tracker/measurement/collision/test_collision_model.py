"""The tracker's motion model against the paper's equations, an ODE with a contact force law, and quadrature."""

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from tracker_forces import R, spring_collision, tied

from tracker.measurement.collision.collision_model import (
    AFTER,
    FREE,
    TIED,
    compute_stopping_time,
    compute_unit_vectors,
    mean_positions,
    roll_freely,
    tied_to_free,
    tied_to_free_jacobian,
)


def part(free, name):
    return free[..., FREE.index(name)]


@pytest.mark.parametrize(("v0", "r", "mu", "c"), [(0.2, 0.903, 0.232, 0.347), (0.55, 0.76, 0.13, 0.11)])
def test_head_on_finals_and_slide_times_are_the_papers(v0, r, mu, c):
    free = tied_to_free(tied(heading=0.0, beta=0.0, v0=v0, r=r, log_mu=np.log(mu), C=c))
    assert part(free, "f1x") == pytest.approx(v0 / 7 * (2.5 * (1 + r) - 2 * c), rel=1e-12)
    assert part(free, "f2x") == pytest.approx(v0 / 7 * (2 + 2.5 * (1 - r) - 2 * c), rel=1e-12)
    for sign, name in ((1, "log_tau1"), (-1, "log_tau2")):
        tau = ((1 + r) / 2 + sign * c) * v0 / (3.5 * mu * 9.81)
        assert np.exp(part(free, name)) == pytest.approx(tau, rel=1e-12)


MOVING = {"wx": 0.11, "wy": -0.06}
SLIDING = {"ux": 0.13, "uy": -0.08, "side": 0.09}  # a draw shot, askew, with side


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"beta": -0.9, "C": 0.12, "r": 0.78, "heading": 4.0},
        {"beta": 1e-9},
        MOVING | {"beta": 0.6},
        {"side": -0.2, "beta": 0.4},
        SLIDING,
        SLIDING | MOVING | {"beta": -0.7},
    ],
)
def test_path_agrees_with_integrated_forces(changes):
    theta = tied(**changes)
    when = np.linspace(0.0, 0.4, 41)
    truth = spring_collision(theta, when)
    for ball in (1, 2):
        mine, _ = mean_positions(tied_to_free(theta), ball, when, 0.0, 2 * R)
        np.testing.assert_allclose(mine, truth[ball], atol=2e-9)


def test_exposure_mean_is_the_integral_of_the_instants():
    theta = tied(t_c=0.0802)  # the contact falls into an exposure, and so does a slide's end
    free = tied_to_free(theta)
    ends = [theta[0] + np.exp(part(free, name)) for name in ("log_tau1", "log_tau2")]
    start = np.array([0.0, 0.08, *(e - 2e-4 for e in ends), 0.3])

    def instant(t, ball, axis):
        return mean_positions(free, ball, np.array([t]), 0.0, 2 * R)[0][0, axis]

    for ball in (1, 2):
        mean, _ = mean_positions(free, ball, start, 5e-4, 2 * R)
        for k, begin in enumerate(start):
            for axis in (0, 1):
                kinks = [t for t in (theta[0], *ends) if begin < t < begin + 5e-4] or None
                area, _ = quad(instant, begin, begin + 5e-4, args=(ball, axis), points=kinks, epsabs=1e-16)
                assert mean[k, axis] == pytest.approx(area / 5e-4, abs=1e-9)


@pytest.mark.parametrize("spin", [{}, SLIDING])
@pytest.mark.parametrize("decel", [0.0103, 0.4])  # at .4 the balls come to rest within view
def test_derivatives_are_those_of_the_path(decel, spin):
    free = tied_to_free(tied(decel=decel, **MOVING, **spin))
    start = np.arange(0, 0.8, 0.0041)
    for ball in (1, 2):
        _, slope = mean_positions(free, ball, start, 5e-4, 2 * R)
        for j in range(len(FREE)):
            if not spin and FREE[j] in ("ax", "ay"):
                continue  # without any pull the striker rolls
            h = 1e-5 * max(abs(free[j]), 0.1)
            step = h * np.eye(len(FREE))[j]
            high, low = (mean_positions(free + s * step, ball, start, 5e-4, 2 * R)[0] for s in (1, -1))
            np.testing.assert_allclose(slope[:, :, j], (high - low) / (2 * h), rtol=1e-6, atol=1e-7, err_msg=FREE[j])


@pytest.mark.parametrize("spin", [{}, SLIDING])
def test_tied_derivative_is_that_of_the_release(spin):
    theta = tied(**MOVING, **spin)
    for j, column in enumerate(tied_to_free_jacobian(theta).T):
        if not spin and TIED[j] in ("ux", "uy"):
            continue  # friction has no direction where nothing slips
        step = 1e-6 * np.eye(len(TIED))[j]
        np.testing.assert_allclose(column, (tied_to_free(theta + step) - tied_to_free(theta - step)) / 2e-6, atol=1e-8)


@pytest.mark.parametrize(("drag", "decel"), [(0.135, 0.0103), (0.0, 0.02), (30.0, 0.05), (-0.2, 0.3), (4.0, 0.0)])
def test_rolling_solves_its_equation(drag, decel):
    times = np.array([-0.05, 0.0, 0.1, 1.0, 40.0])
    roll = roll_freely(0.3, drag, decel, times)
    stop = compute_stopping_time(0.3, drag, decel)

    def rate(_, state):
        return [state[1], -(drag * state[1] + decel)]

    for t, way in zip(times, roll.distance, strict=True):
        span = min(t, stop)
        state = solve_ivp(rate, (0, span), [0, 0.3], rtol=1e-11, atol=1e-14).y[:, -1] if span else [0, 0.3]
        assert way == pytest.approx(state[0], rel=1e-8)
        if t > stop:
            assert state[1] == pytest.approx(0, abs=1e-9)


def test_conserved_combination_and_momentum():
    rng = np.random.default_rng(3)
    for _ in range(50):
        w = rng.uniform(-0.2, 0.2, 2) * rng.integers(0, 2)
        theta = tied(beta=rng.uniform(-1.3, 1.3), heading=rng.uniform(0, 7), C=rng.uniform(0, 0.4), wx=w[0], wy=w[1])
        free = tied_to_free(theta)
        v0, (d, n, _) = theta[5], compute_unit_vectors(theta[3], theta[4])
        v1, v2 = free[8:10], free[13:15]
        np.testing.assert_allclose(v1 + v2, v0 * d + 2 * w, rtol=1e-12, atol=1e-13)
        assert (v1 - v2) @ n == pytest.approx(theta[8] * v0 * (d @ n), rel=1e-12)
        # spin along t: both lose C times their sum, of a resting target w1 = -C w0 and w2 = (1 - C) w0
        before = {1: w @ n, 2: (w + v0 * d) @ n}
        for ball in (1, 2):
            v, f = free[AFTER[ball] : AFTER[ball] + 2], free[AFTER[ball] + 2 : AFTER[ball] + 4]
            left = before[ball] - theta[10] * (before[1] + before[2])
            assert (7 * f - 5 * v) @ n / 2 == pytest.approx(left, rel=1e-11)
