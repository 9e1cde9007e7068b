"""Discs with tape: one rigid body from a hit on, until another hit parts them."""

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from synthcam.dynamics.contacts.walls import StraightWall
from synthcam.dynamics.kinematics import stop_time
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.dynamics.supports import Air, DryPlate
from synthcam.dynamics.tabletop import Table
from synthcam.effects.ball_friction import BallFriction
from synthcam.model import Bodies, Model

R, M = 0.03, 0.02
STILL_AIR = Air()
SMOOTH = Model(restitution=0.8, spin_transfer=0.0)


def discs(count, mass=None):
    full = np.ones(count)
    return Bodies(R * full, M * full if mass is None else np.array(mass), 0 * full, 0.5 * full)


def start(*rows):
    """States of discs at x, y with vx, vy and a spin."""
    states = np.zeros((len(rows), 9))
    states[:, [0, 1, 3, 4, 8]] = rows
    return states


def run(states, sticks, end, model=SMOOTH, air=STILL_AIR, mass=None, walls=()):
    bodies = discs(len(states), mass)
    table = Table(walls, (air,) * len(states), sticks=sticks)
    return solve(model, Launch(0.0, states, bodies), 0.0, end, table=table), bodies


def conserved(states, bodies):
    """Momentum, and angular momentum about the origin."""
    spin = bodies.inertia * bodies.mass * bodies.radius**2 * states[:, 8]
    orbit = states[:, 0] * states[:, 4] - states[:, 1] * states[:, 3]
    return [*(bodies.mass[:, None] * states[:, 3:5]).sum(axis=0), float((spin + bodies.mass * orbit).sum())]


def test_two_discs_stick_and_whirl():
    """Equal discs, hit off the middle: the spin is v b/(3 R), as 3 m R^2 is the moment of inertia of both."""
    b = 0.4
    motion, bodies = run(start([0, 0, 0, 0, 0], [-0.2, 2 * R * b, 0.5, 0, 0]), (1.0, 0.0), 2.0)
    assert [e.kind for e in motion.events] == ["contact", "together"]
    hit = motion.first("contact").t
    first = conserved(motion.at(0.0)[:, 0], bodies)
    for t in np.linspace(hit, 2.0, 9):
        states = motion.at(t)[:, 0]
        np.testing.assert_allclose(conserved(states, bodies), first, rtol=0, atol=1e-12 * 0.01)
        assert math.dist(states[0, :2], states[1, :2]) == pytest.approx(2 * R, rel=1e-9)
        np.testing.assert_allclose(states[:, 8], -0.5 * b / (3 * R), rtol=1e-9)
    turned = [math.atan2(*(motion.at(t)[0, 0, [1, 0]] - motion.at(t)[1, 0, [1, 0]])) for t in (hit, hit + 0.3)]
    assert turned[1] - turned[0] == pytest.approx(-0.3 * 0.5 * b / (3 * R), rel=1e-9)
    moment, before, after = motion.events[0], *(motion.events[0].before, motion.events[0].after)
    impulse = M * (after[0, 3:5] - before[0, 3:5])
    t = np.array([-moment.n[1], moment.n[0]])
    np.testing.assert_allclose([moment.impulse_n, moment.impulse_t], [impulse @ moment.n, impulse @ t], rtol=1e-12)
    assert motion.motion(1.0).tolist() == [["glide"], ["glide"]]


def test_a_pair_glides_as_one_body_does():
    """Head-on: half the speed, then the loss of the air on the centre of mass; its spin decays."""
    air = Air(0.3, 0.4, 0.5, 0.7)
    motion, _ = run(start([0, 0, 0, 0, 0], [-0.2, 0.03, 0.5, 0, 0]), (1.0, 1.0), 3.0, air=air)
    hit = motion.first("contact")
    before = hit.before[1, 3:5] / 2
    centre = motion.at(hit.t + 0.2)[:, 0].mean(axis=0)
    alone, _ = run(start([0, 0, *before, 0]), (0.0,), 3.0, air=air)
    np.testing.assert_allclose(centre[3:5], alone.at(0.2)[0, 0, 3:5], rtol=1e-9)
    assert centre[8] == pytest.approx(hit.after[0, 8] * math.exp(-0.7 * 0.2), rel=1e-9)
    stop = hit.t + stop_time(float(np.hypot(*before)), 0.4, 0.3)
    one, two = (motion.at(stop + late)[:, 0] for late in (1e-6, 0.4))
    np.testing.assert_allclose(one.mean(axis=0)[:2], two.mean(axis=0)[:2], rtol=0, atol=1e-9)
    assert np.abs(one[:, :2] - two[:, :2]).max() > 1e-3


def test_a_third_disc_pushes_a_pair_or_parts_it():
    """Its impulse on a pair at rest, off the centre of mass, without friction: (1 + r) v/(1/m + 1/M + d^2/I)."""
    rows = [0, 0, 0, 0, 0], [-2 * R - 0.01, 0, 0.02, 0, 0], [0.0, -0.8, 0, 1.0, 0]
    impulse = 1.8 * 1.0 / (1 / M + 1 / (2 * M) + R * R / (3 * M * R * R))
    for strength in (1.01 * impulse, 0.99 * impulse):
        motion, bodies = run(start(*rows), (0.0, strength, 0.0), 1.2, mass=[M, M, M])
        third = next(e for e in motion.events if e.kind == "contact" and 2 in (e.i, e.j))
        first = conserved(motion.at(0.0)[:, 0], bodies)
        np.testing.assert_allclose(conserved(motion.at(1.2)[:, 0], bodies), first, rtol=0, atol=1e-13)
        if strength > impulse:
            assert motion.first("together").t < third.t
            # the pair moves slowly and has a little spin when it is hit: within a part in a hundred
            assert third.impulse_n == pytest.approx(impulse, rel=0.01)
            assert motion.first("apart") is None
        else:
            apart = motion.first("apart")
            assert (apart.t, apart.i, apart.j) == (third.t, 0, 1)
            assert third.impulse_n == pytest.approx(1.8 * M / 2, rel=2e-3)  # as of one disc alone


@pytest.mark.parametrize("mass", [[M, M], [M, 3 * M]])
def test_two_discs_with_tape_slide_on_a_dry_plate(mass):
    """Against Newton's equations in time, with dry friction at many points under each disc; then both rest."""
    slowing, b = 2.0, 0.4
    motion, bodies = run(
        start([0, 0, 0, 0, 0], [-0.2, 2 * R * b, 1.2, 0, 0]), (1.0, 0.0), 2.0, air=DryPlate(slowing), mass=mass
    )
    assert [e.kind for e in motion.events] == ["contact", "together", "stop", "stop"]
    hit, stop = motion.events[1].t, motion.events[2].t
    first, m = motion.at(hit)[:, 0], bodies.mass
    nodes, weights = np.polynomial.legendre.leggauss(32)
    r, angle = (nodes[:, None] + 1) / 2 * R, 2 * np.pi * (np.arange(64) + 0.5) / 64
    under = np.stack([r * np.cos(angle), r * np.sin(angle)]).reshape(2, -1)  # points of a disc
    share = (weights[:, None] * (nodes[:, None] + 1) / 2 / 64 * np.ones(64)).ravel()  # of its mass
    centre = (m[:, None] * first[:, :2]).sum(axis=0) / m.sum()
    points = np.concatenate([under + (s[:2] - centre)[:, None] for s in first], axis=1)
    masses = np.concatenate([one * share for one in m])
    inertia = (masses * (points**2).sum(axis=0)).sum()

    def law(t, y):
        c, s = np.cos(y[2]), np.sin(y[2])
        x, y_ = c * points[0] - s * points[1], s * points[0] + c * points[1]
        u = np.array([y[3] - y[5] * y_, y[4] + y[5] * x])
        force = -slowing * masses * u / np.hypot(*u)
        return [*y[3:], *(force.sum(axis=1) / m.sum()), (x * force[1] - y_ * force[0]).sum() / inertia]

    whole = [*centre, 0.0, *((m[:, None] * first[:, 3:5]).sum(axis=0) / m.sum()), first[0, 8]]
    times = np.array([0.3, 0.9]) * (stop - hit)
    exact = solve_ivp(law, (0, times[-1]), whole, method="RK45", rtol=1e-7, atol=1e-9, t_eval=times).y
    for t, (x, y, turned, vx, vy, spin) in zip(times, exact.T, strict=True):
        now = motion.at(hit + t)[:, 0]
        np.testing.assert_allclose((m[:, None] * now[:, :2]).sum(axis=0) / m.sum(), [x, y], rtol=0, atol=2e-6)
        np.testing.assert_allclose((m[:, None] * now[:, 3:5]).sum(axis=0) / m.sum(), [vx, vy], rtol=0, atol=2e-5)
        np.testing.assert_allclose(now[:, 8], spin, rtol=0, atol=1e-3)
        was, is_ = (math.atan2(*(s[0, [1, 0]] - s[1, [1, 0]])) for s in (first, now))
        assert is_ - was == pytest.approx(turned, abs=1e-4)
    assert math.dist(*motion.at(stop)[:, 0, :2]) == pytest.approx(2 * R, rel=1e-9)
    assert not motion.at(stop + 0.01)[..., 3:].any()
    assert motion.motion(stop + 0.01).tolist() == [["rest"], ["rest"]]


@pytest.mark.parametrize("restitution", [0.3, 1.0])
def test_hits_on_groups_conserve_what_they_must(restitution):
    """Four discs with tape and two without, between walls, with friction: no contact adds energy."""
    rng = np.random.default_rng(4)
    rows = [[0.2 * (k % 3) + 0.1, 0.2 * (k // 3) + 0.1, *rng.normal(0, 0.5, 2), rng.normal(0, 5)] for k in range(6)]
    corners = [(0.0, 0.0), (0.62, 0.0), (0.62, 0.42), (0.0, 0.42)]
    sides = itertools.pairwise([*corners, corners[0]])
    walls = tuple(StraightWall(0.9, 0.2, start=a, end=b) for a, b in sides)
    model = Model(restitution=restitution, effects=(BallFriction(mu=0.3),))
    sticks = (0.002, 0.004, 0.01, 0.1, 0.0, 0.0)
    motion, bodies = run(start(*rows), sticks, 6.0, model, walls=walls)
    kinds = {e.kind for e in motion.events}
    assert kinds == {"contact", "together", "apart", "wall"}
    times = sorted({e.t for e in motion.events})
    for a, b in itertools.pairwise(times):
        early, late = (motion.at(t)[:, 0] for t in (a, (a + b) / 2))
        np.testing.assert_allclose(conserved(late, bodies), conserved(early, bodies), rtol=0, atol=1e-12)
    middles = [0.0, *((a + b) / 2 for a, b in itertools.pairwise(times)), 6.0]
    states = [motion.at(t)[:, 0] for t in middles]
    energy = [
        (bodies.mass / 2 * ((s[:, 3:5] ** 2).sum(axis=1) + bodies.inertia * (R * s[:, 8]) ** 2)).sum() for s in states
    ]
    assert np.diff(energy).max() < 1e-14
    at_walls = {e.t for e in motion.events if e.kind == "wall"}
    for k, t in enumerate(times):
        if t not in at_walls:
            now = [conserved(states[k], bodies), conserved(states[k + 1], bodies)]
            np.testing.assert_allclose(*now, rtol=0, atol=1e-12)
    gaps = np.linalg.norm(np.diff(motion.at(np.linspace(0, 6, 300))[..., :2][[0, 4]], axis=0), axis=-1)
    assert gaps.min() > 2 * R * (1 - 1e-9)
