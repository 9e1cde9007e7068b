"""Ten balls between walls: the books of momentum and energy, and a code of stiff springs in small steps beside them."""

import itertools
import math

import numpy as np
import pytest

from synthcam.dynamics.contacts.lasting import ContactSpring
from synthcam.dynamics.contacts.walls import StraightWall
from synthcam.dynamics.kinematics import rolling_state
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.dynamics.supports import Air, DryPlate
from synthcam.dynamics.tabletop import ContactScatter, Table
from synthcam.effects.ball_friction import BallFriction
from synthcam.effects.hop import Hop
from synthcam.model import Bodies, Model

R, M, G, K = 1.19e-3, 5.5e-5, 9.81, 0.4
FRICTION, DRAG, DECEL = 0.232, 0.135, 0.0103  # of the model
TEN = Bodies(np.full(10, R), np.full(10, M), np.zeros(10), np.full(10, K))
NODES, WEIGHTS = np.polynomial.legendre.leggauss(12)


def start(seed, wall_friction, speed=0.4, side=0.025):
    """Ten balls that roll about in a square: their states and its walls."""
    rng = np.random.default_rng(seed)
    cells = np.stack(np.divmod(np.arange(10), 4), axis=1)
    free = side / 4 / 2 - R
    places = (cells + 0.5) * side / 4 + rng.uniform(-0.95, 0.95, (10, 2)) * free
    corners = [(0.0, 0.0), (side, 0.0), (side, side), (0.0, side)]
    ring = itertools.pairwise([*corners, corners[0]])
    walls = tuple(StraightWall(0.8, wall_friction, start=a, end=b) for a, b in ring)
    return rolling_state(places, rng.normal(0, speed / math.sqrt(2), (10, 2)), 0.0, R), walls


def energy(states):
    """Compute the energy of states (..., 9), over the mass."""
    return ((states[..., 3:6] ** 2).sum(axis=-1) + K * R * R * (states[..., 6:9] ** 2).sum(axis=-1)) / 2


def turning(states):
    """Angular momentum about the vertical through the origin, over the mass."""
    return states[..., 0] * states[..., 4] - states[..., 1] * states[..., 3] + K * R * R * states[..., 8]


def plate(leg):
    """Compute impulse, angular impulse and work of the plate in a leg, over the mass, by quadrature of its force."""
    times = (leg.t0 + leg.t1) / 2 + (leg.t1 - leg.t0) / 2 * NODES
    states, weights = leg.at(times), WEIGHTS * (leg.t1 - leg.t0) / 2
    x, v = states[:, :2], states[:, 3:5]
    if leg.motion == "slide":
        u = v + R * np.stack([-states[:, 7], states[:, 6]], axis=1)
        force = -FRICTION * G * u / np.linalg.norm(u, axis=1)[:, None]
        work = (force * u).sum(axis=1)
    elif leg.motion == "roll":
        speed = np.linalg.norm(v, axis=1)
        force = -(DRAG + DECEL / speed)[:, None] * v
        work = (1 + K) * (force * v).sum(axis=1)  # of all motion, with the spin that keeps rolling
    else:
        return np.zeros(4)
    torque = x[:, 0] * force[:, 1] - x[:, 1] * force[:, 0]
    return weights @ np.column_stack([force, torque, work])


def test_the_books_of_ten_balls_close():
    """Momentum and its moment by the impulses of the events; what contacts and walls take is never negative."""
    states, walls = start(1, 0.15, speed=1.0)
    model = Model(effects=(BallFriction(mu=0.15),))
    end = 0.25
    motion = solve(model, Launch(0.0, states, TEN), 0.0, end, False, Table(walls, (), 1e-7))
    books = np.zeros((10, 4))  # momentum, angular momentum, energy of each ball
    kinds = set()
    for ball, legs in enumerate(motion.legs):
        books[ball] += sum(plate(leg) for leg in legs)
    for e in motion.events:
        kinds.add(e.kind)
        pair = [e.i, e.j] if e.kind == "contact" else [e.i]
        if e.kind in ("contact", "wall"):
            n = np.array(e.n)
            impulse = (e.impulse_n * n + e.impulse_t * np.array([-n[1], n[0]])) / M
            point = e.before[0, :2] - R * n
            for ball, sign in zip(pair, (1, -1), strict=False):
                books[ball, :2] += sign * impulse
                books[ball, 2] += sign * (point[0] * impulse[1] - point[1] * impulse[0])
        changes = energy(e.after) - energy(e.before)
        assert changes.sum() <= 1e-16
        books[pair, 3] += changes
    assert kinds >= {"contact", "wall", "slide_end"}
    assert sum(e.kind == "contact" for e in motion.events) > 30
    last = motion.at(end)[:, 0]
    for found, exact, size in (
        (books[:, :2], last[:, 3:5] - states[:, 3:5], 1.0),
        (books[:, 2], turning(last) - turning(states), 0.025),
        (books[:, 3], energy(last) - energy(states), 1.0),
    ):
        np.testing.assert_allclose(found, exact, rtol=0, atol=1e-12 * size)


def book_events(motion, bodies):
    """Check the books of each instant: what all bodies gain is what walls and the plate give; return the kinds."""
    jumps, kinds = {}, {e.kind for e in motion.events}
    for k, legs in enumerate(motion.legs):
        for early, late in itertools.pairwise(legs):
            assert early.t1 == late.t0
            states = early.at(np.array([early.t1]))[0], late.at(np.array([late.t0]))[0]
            jumps.setdefault(late.t0, []).append((k, *states))
    turnings = bodies.inertia * bodies.mass * bodies.radius**2
    own = dict(enumerate(zip(bodies.mass, turnings, bodies.radius, strict=True)))

    def count(k, s):
        """Momentum, angular momentum about the vertical, and energy."""
        mass, turning, _ = own[k]
        orbit = s[0] * s[4] - s[1] * s[3]
        energy = (mass * (s[3:6] ** 2).sum() + turning * (s[6:9] ** 2).sum()) / 2
        return np.array([mass * s[3], mass * s[4], mass * orbit + turning * s[8], energy])

    size = sum(np.abs(count(k, legs[0].at(np.array([0.0]))[0])) for k, legs in enumerate(motion.legs))
    for t, rows in jumps.items():
        gained = sum(count(k, after) - count(k, before) for k, before, after in rows)
        given, lost = np.zeros(3), 0.0
        events = [e for e in motion.events if e.t == t]
        landed = {e.i for e in events if e.kind == "land"}
        for e in events:
            if e.kind == "wall":
                n = np.array(e.n)
                impulse = e.impulse_n * n + e.impulse_t * np.array([-n[1], n[0]])
                point = e.before[0, :2] - own[e.i][2] * n
            elif e.kind == "land":
                impulse, point = own[e.i][0] * (e.after - e.before)[0, 3:5], e.before[0, :2]
            else:
                impulse, point = np.zeros(2), np.zeros(2)
            given += [*impulse, point[0] * impulse[1] - point[1] * impulse[0]]
            if e.before is None or (e.kind == "slide_end" and e.i in landed):  # which has the same states
                continue
            for row, k in enumerate((e.i, e.j)[: len(e.before)]):
                lost += count(k, e.before[row])[3] - count(k, e.after[row])[3]
        np.testing.assert_allclose(gained[:3], given, rtol=0, atol=1e-12 * size[[0, 1, 2]].max())
        assert gained[3] <= 1e-12 * size[3]
        if "together" not in kinds:  # other bodies of a group are not in its events
            assert gained[3] == pytest.approx(-lost, abs=1e-12 * size[3])
        moved = {k for k, before, after in rows if np.abs(before - after).max() > 1e-12 * max(1, np.abs(after).max())}
        assert "together" in kinds or moved <= {k for e in events for k in (e.i, e.j)}
    return kinds


BALLS_AND_DISCS = (None,) * 6 + (Air(0.1, 0.2, 0.5, 0.3, (0.05, 0.2)),) * 4
TAPE = (5e-7, 0.0, 2e-6, 0.0, 1e-5) * 2


@pytest.mark.parametrize(
    ("supports", "sticks", "end", "expected"),
    [
        (BALLS_AND_DISCS, (), 0.15, {"contact", "wall", "slide_end", "land", "stretch"}),
        ((Air(0.1, 0.2, 0.5, 0.3),) * 10, TAPE, 0.03, {"contact", "wall", "together", "apart"}),
        ((DryPlate(1.0),) * 10, TAPE, 0.01, {"contact", "wall", "together"}),
    ],
    ids=["balls and discs", "tape on air", "tape on a dry plate"],
)
def test_the_books_of_each_event_close(supports, sticks, end, expected):
    """Balls, shells and discs of different masses, with friction everywhere and a hop; discs with tape."""
    states, walls = start(7, 0.15, speed=1.0)
    rng = np.random.default_rng(7)
    flat = np.array([support is not None for support in supports])
    bodies = Bodies(R * np.ones(10), M * rng.uniform(0.5, 2, 10), np.zeros(10), np.where(flat, 0.5, 0.4))
    bodies.inertia[:2] = 0.5 if flat[0] else 2 / 3
    states[flat, 6:8], states[:, 8] = 0.0, rng.normal(0, 30, 10)
    model = Model(restitution=0.8, effects=(BallFriction(mu=0.15), Hop(share=1.0)))
    table = Table(walls, supports, 1e-7, ContactScatter(seed=(1,)), sticks)
    motion = solve(model, Launch(0.0, states, bodies), 0.0, end, False, table)
    assert book_events(motion, bodies) >= expected
    assert not motion.at(motion.t1)[flat, 0, 5:8].any()  # discs lie flat


def follow_by_small_steps(states, side, times, contact, friction, wall_friction, restitution):
    """Take steps of second order, with damped linear springs at contacts, and dry friction there and at the plate.

    contact: how long contacts last, s; then steps are a 150th of it. Returns positions and velocities at the times.

    The plate holds back the vertical part of the friction in contacts, which spins balls. Friction keeps the direction
    that the slip has when a contact begins.
    """
    w, g, long, fine = math.pi / contact, -math.log(restitution) / contact, 2e-5, contact / 150
    i, j = np.triu_indices(len(states), 1)
    x, v, spin = states[:, :2].copy(), states[:, 3:5].copy(), R * states[:, 6:9]
    wall_w, wall_g = math.pi / contact, -math.log(0.8) / contact

    directions, touching = {}, set()

    def keep_direction(contact, slip):
        touching.add(contact)
        return directions.setdefault(contact, slip / math.hypot(*slip))

    def forces(x, v, spin):
        """Also the smallest gap, m."""
        force, torque = np.zeros_like(v), np.zeros_like(spin)
        touching.clear()
        apart = x[i] - x[j]
        gaps = np.sqrt((apart**2).sum(axis=1)) - 2 * R
        for number in np.flatnonzero(gaps < 0):
            a, b, d, far = i[number], j[number], apart[number], gaps[number] + 2 * R
            n = np.array([*d / far, 0.0])
            u = np.array([*(v[a] - v[b]), 0.0])
            rate = u @ n
            press = ((w * w + g * g) * (2 * R - far) - 2 * g * rate) / 2
            slip = u - rate * n - np.cross(spin[a] + spin[b], n)  # the surface of a against that of b
            rub = -friction * press * keep_direction((a, b), slip)
            for ball, sign in ((a, 1), (b, -1)):
                force[ball] += sign * (press * n + rub)[:2]
                torque[ball] += np.cross(-n, rub)
        for axis in (0, 1):
            for n, deep in ((1.0, R - x[:, axis]), (-1.0, x[:, axis] - (side - R))):
                for ball in np.flatnonzero(deep > 0):
                    press = (wall_w**2 + wall_g**2) * deep[ball] - 2 * wall_g * n * v[ball, axis]
                    normal = np.zeros(3)
                    normal[axis] = n
                    u = np.array([*v[ball], 0.0]) - np.cross(spin[ball], normal)
                    u -= (u @ normal) * normal
                    rub = -wall_friction * press * keep_direction((ball, axis, n), u)
                    force[ball] += (press * normal + rub)[:2]
                    torque[ball] += np.cross(-normal, rub)
        for contact in set(directions) - touching:
            del directions[contact]
        u = v + np.stack([-spin[:, 1], spin[:, 0]], axis=1)
        rub = -FRICTION * G * u / np.hypot(np.linalg.norm(u, axis=1), 1e-4)[:, None]
        force += rub
        torque[:, 0] += rub[:, 1]
        torque[:, 1] -= rub[:, 0]
        return force, torque / K, min(gaps.min(), x.min() - R, side - R - x.max())

    (a, b, gap), t, found = forces(x, v, spin), 0.0, []
    for until in times:
        while t < until - 1e-12:
            step = min(long, max(fine, 0.5 * gap), until - t)  # at 1 m/s two balls come nearer by less
            v, spin = v + a * step / 2, spin + b * step / 2
            x, t = x + v * step, t + step
            a, b, gap = forces(x, v + a * step / 2, spin + b * step / 2)
            v, spin = v + a * step / 2, spin + b * step / 2
        found.append((x, v))
    return found


def test_stiff_springs_in_small_steps_agree():
    """After 12 hits to 1 % of a radius; a contact takes 2 us there. With balls that only slide on one another."""
    states, walls = start(5, 0.02)
    model = Model(restitution=0.9, rolling_drag=0.0, rolling_decel=0.0, effects=(BallFriction(mu=0.02),))
    ((x, v),) = follow_by_small_steps(states, 0.025, [0.02], 2e-6, 0.02, 0.02, 0.9)
    for spring in (ContactSpring("linear", 2e-6), None):
        motion = solve(model, Launch(0.0, states, TEN), 0.0, 0.02, False, Table(walls, (), 1e-7, spring=spring))
        assert sum(e.kind in ("contact", "wall") for e in motion.events) == 12
        last = motion.at(0.02)[:, 0]
        np.testing.assert_allclose(last[:, :2], x, rtol=0, atol=0.01 * R)
        np.testing.assert_allclose(last[:, 3:5], v, rtol=0, atol=3e-3)
