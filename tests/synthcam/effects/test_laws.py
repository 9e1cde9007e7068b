"""Each law of motion that an effect may bend, typed out again and integrated by scipy, against the motions solved."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from synthcam.dynamics.batch import solve_collisions
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.effects.drilling_spin import DrillingSpin
from synthcam.model import Model

G, MU = 9.81, 0.232
R, M = 1.19e-3, 7800 * np.pi / 6 * 2.38e-3**3
LAUNCH = {"time": 0.0, "v0": 0.4, "b": 0.35, "heading": 2.0, "contact": (0.002, -0.003)}
ROLLED = 1e-7  # m/s: slower than this a slide by hand has ended
SPINS = 0.1  # of c in the friction mu u/(u + c) of a ball that drills: from this slip on a slide ends as without a spin


@dataclass(frozen=True)
class Laws:
    """The laws of one ball: x, v, u vectors (2,); s = |u|; the first argument is the ball's number, 0 or 1."""

    push: Any = lambda k, x, v, other: np.zeros(2)
    mu: Any = lambda s, hat, wz: MU
    load: Any = lambda x, v: G
    loss: Any = lambda k, x, v: 0.135 * np.hypot(*v) + 0.0103
    twist: Any = lambda s, wz: 0.0
    fades: float = 0.0  # c over |wz|


def air(k, x, v, other):
    """Schiller & Naumann's sphere in air of 20 C."""
    speed = np.hypot(*v)
    re = 2 * R * speed / 1.516e-5
    drag = 24 / re * (1 + 0.15 * re**0.687)
    return -0.5 * 1.204 * drag * np.pi * R**2 * speed * v / M


ALONG, WAVES = np.array([np.cos(np.pi / 6), np.sin(np.pi / 6)]), 2 * np.pi / 0.012


def wavy(k, x, v, other):
    """-g h' with h = A sin(2 pi s/L) along 30 degrees, A = 3 um, L = 12 mm."""
    return -G * 3e-6 * WAVES * np.cos(WAVES * (x @ ALONG)) * ALONG


def heaved(x, v):
    """g + v_s^2 h'' of the same."""
    return G - (v @ ALONG) ** 2 * 3e-6 * WAVES**2 * np.sin(WAVES * (x @ ALONG))


def magnet(k, x, v, other):
    """3 mu0 m^2/(2 pi r^4) towards the other: -.02 m/s^2 when they touch, so they repel."""
    r = np.hypot(*(other - x))
    return -0.02 * (2 * R / r) ** 4 * (other - x) / r


def lopsided(k, x, v):
    """Ball a, the target, 2 um off: (5/7) (g + v^2/R) (2 um/R) sin(s/R) helps it on."""
    s = x @ v / np.hypot(*v)
    ripple = 5 / 7 * (G + v @ v / R) / R * 2e-6 * np.sin(s / R) if k == 0 else 0.0
    return 0.135 * np.hypot(*v) + 0.0103 - ripple


def grain(s, hat, wz):
    """e = .15 along 20 degrees."""
    return MU * (1 + 0.15 * np.cos(2 * (np.arctan2(hat[1], hat[0]) - np.radians(20))))


drill = DrillingSpin(a=2e-5)  # whose laws test_drilling_spin.py holds against integrals over the contact


def drilled(s, wz):
    return drill.drilling(0.0, wz, s, drill.friction(MU, s, wz), G, R)


FADES = 8 / (3 * np.pi) * 2e-5
e20 = 2 * np.radians(20)
CASES = {
    "plate_tilt": ({"x": -0.9e-3, "y": 0.5e-3}, Laws(push=lambda *_: G * np.sin([-0.9e-3, 0.5e-3]))),
    "adhesion": ({"pull": 0.7}, Laws(load=lambda x, v: 1.7 * G)),
    "viscous_friction": ({"k": 0.8}, Laws(mu=lambda s, hat, wz: MU * (1 + 0.8 * s))),
    "stribeck": ({"rise": 0.3, "slip": 0.08}, Laws(mu=lambda s, hat, wz: MU * (1 + 0.3 * np.exp(-s / 0.08)))),
    "friction_anisotropy": ({"c": 0.15 * np.cos(e20), "s": 0.15 * np.sin(e20)}, Laws(mu=grain)),
    "drilling_spin": ({"a": 2e-5}, Laws(mu=lambda s, hat, wz: drill.friction(MU, s, wz), twist=drilled, fades=FADES)),
    "air_drag": ({"share": 1.0}, Laws(push=air)),
    "plate_waviness": ({"a": 0.0, "b": 3e-6, "wavelength": 0.012, "angle": np.pi / 6}, Laws(push=wavy, load=heaved)),
    "eccentric_mass": ({"c": 0.0, "d": 2e-6}, Laws(loss=lopsided)),
    "rolling_quadratic": ({"K": 0.3}, Laws(loss=lambda k, x, v: 0.135 * np.hypot(*v) + 0.0103 + 0.3 * v @ v)),
    "magnetic_attraction": ({"pull": -0.02}, Laws(push=magnet)),
}
each = pytest.mark.parametrize("name", CASES)


def slip_of(y):
    return np.array([y[2] - R * y[5], y[3] + R * y[4]])


def rate(laws, k, y, other, rolling, spins):
    """d/dt of x, y, vx, vy, wx, wy, wz of ball k."""
    x, v, push = y[:2], y[2:4], laws.push(k, y[:2], y[2:4], other)
    if rolling:
        a = 5 / 7 * push - laws.loss(k, x, v) * v / np.hypot(*v)
        return [*v, *a, -a[1] / R, a[0] / R, 0.0]
    u = slip_of(y)
    s = np.hypot(*u)
    f = -laws.mu(s, u / s, y[6] * spins) * laws.load(x, v) * u / s
    return [*v, *(f + push), 2.5 / R * f[1], -2.5 / R * f[0], laws.twist(s, y[6] * spins)]


def by_hand(laws, starts, times):
    """States (2, m, 7) at times from 0 on, and when each ball's slip fell under ROLLED."""
    y, t, rolling, ends = np.concatenate(starts), 0.0, [False, False], [np.nan, np.nan]
    late = [SPINS * laws.fades * abs(start[6]) for start in starts]
    out = np.empty((2, len(times), 7))
    while t < times[-1]:

        def right(_, y, rolling=tuple(rolling), late=tuple(late)):
            pair = y.reshape(2, 7)
            return np.concatenate([rate(laws, k, pair[k], pair[1 - k, :2], rolling[k], late[k] > 0) for k in (0, 1)])

        events = []
        for k in [k for k in (0, 1) if not rolling[k]]:
            event = lambda _, y, k=k: np.hypot(*slip_of(y.reshape(2, 7)[k])) - max(late[k], ROLLED)  # noqa: E731
            event.terminal = True
            events.append(event)
        how = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-14, "dense_output": True}
        run = solve_ivp(right, (t, times[-1]), y, events=events or None, **how)
        inside = (times >= t) & (times <= run.t[-1])
        if inside.any():
            out[:, inside] = run.sol(times[inside]).reshape(2, 7, -1).transpose(0, 2, 1)
        y, t = run.y[:, -1].copy(), run.t[-1]
        for k, ball in enumerate(y.reshape(2, 7)):
            if late[k] and np.hypot(*slip_of(ball)) < 1.0001 * late[k]:
                late[k] = 0.0
            if not rolling[k] and np.hypot(*slip_of(ball)) < 1.01 * ROLLED:
                rolling[k], ends[k] = True, t
                ball[2:4] -= 2 / 7 * slip_of(ball)
                ball[4:6] = [-ball[3] / R, ball[2] / R]
    return out, ends


def with_effect(name):
    values, _ = CASES[name]
    return Model().replace({f"{name}.{key}": value for key, value in values.items()})


@each
def test_a_law_against_scipy(name):
    model, laws = with_effect(name), CASES[name][1]
    motion = solve(model, Launch.pair(model.bodies("ab"), **LAUNCH), 0.0, 0.4)
    times = np.linspace(0, 0.4, 81)
    starts = [s[[0, 1, 3, 4, 6, 7, 8]] for s in motion.first("contact").after]
    theirs, ends = by_hand(laws, starts, times)
    ours = motion.at(times)
    np.testing.assert_allclose(ours[..., :2], theirs[..., :2], rtol=0, atol=3e-10)
    np.testing.assert_allclose(ours[..., 3:5], theirs[..., 2:4], rtol=0, atol=1e-8)
    np.testing.assert_allclose(ours[..., 8], theirs[..., 6], rtol=1e-6)
    np.testing.assert_allclose([motion.first("slide_end", ball).t for ball in (0, 1)], ends, rtol=0, atol=1e-7)
    base = solve(Model(), Launch.pair(model.bodies("ab"), **LAUNCH), 0.0, 0.4).at(times)
    assert np.abs(base - ours)[..., :2].max() > 1e-6  # the law matters here


@each
def test_as_its_strength_goes_to_zero_the_closed_form_is_left(name):
    values, _ = CASES[name]
    launch, times = Launch.pair(Model().bodies("ab"), **LAUNCH), np.linspace(0, 0.4, 81)
    base = solve(Model(), launch, 0.0, 0.4)
    shapes = {"slip", "wavelength", "angle"}
    for small in (1e-6, 1e-9):
        faint = {f"{name}.{k}": v if k in shapes else v * small for k, v in values.items()}
        near = solve(Model().replace(faint), launch, 0.0, 0.4)
        off = 0.1 * small + 1e-9 * 1e-2
        np.testing.assert_allclose(near.at(times)[..., :2], base.at(times)[..., :2], rtol=0, atol=off)
        for ball in (0, 1):
            ends = [m.first("slide_end", ball).t for m in (near, base)]
            assert ends[0] == pytest.approx(ends[1], abs=small + 1e-9)


def test_the_striker_may_be_ball_a():
    """Then the offset rides on ball 2, before the collision too: the batch and the motion agree on whose it is."""
    model = with_effect("eccentric_mass")
    launch = replace(Launch.pair(model.bodies("ba"), **LAUNCH | {"time": 0.1}))
    motion = solve(model, launch, 0.0, 0.4)
    assert type(motion.legs[1][0]).__name__ == "NumericLeg"
    row = np.array([[*LAUNCH["contact"], 0.1, LAUNCH["v0"], LAUNCH["heading"], LAUNCH["b"]]])
    times = np.linspace(0, 0.4, 81)
    np.testing.assert_allclose(
        solve_collisions(model, row, 0.0, 0.4, [True]).at(times)[:, 0, :, :2],
        motion.at(times)[..., :2],
        rtol=0,
        atol=1e-12,
    )
