"""Many bodies between walls: against pooltool, closed forms, conservation laws and another integrator."""

import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from synthcam.dynamics.contacts import calendar
from synthcam.dynamics.contacts.impact import hit_wall
from synthcam.dynamics.contacts.walls import Rim, StraightWall
from synthcam.dynamics.kinematics import contact_velocity, plate_state, rolling_state
from synthcam.dynamics.launch import LaterLaunch, Launch
from synthcam.dynamics.solve import solve
from synthcam.dynamics.supports import Air, DryPlate
from synthcam.dynamics.tabletop import ContactScatter, Table
from synthcam.effects.ball_friction import BallFriction
from synthcam.effects.hop import Hop
from synthcam.effects.plate_tilt import PlateTilt
from synthcam.model import Bodies, Model

THEIRS = json.loads(Path(__file__).with_name("pooltool_break.json").read_text(encoding="utf-8"))
KINDS = {"ball_ball": "contact", "ball_linear_cushion": "wall", "sliding_rolling": "slide_end"}
KINDS |= dict.fromkeys(("rolling_spinning", "rolling_stationary"), "stop")
SPACER_M = 1e-6  # by which pooltool parts balls that touch
R, M, G = 1.19e-3, 5.5e-5, 9.81
FREE = Model(restitution=1.0, spin_transfer=0.0)


def bodies(count, inertia=0.4, mass=M):
    full = np.ones(count)
    return Bodies(R * full, mass * full, 0 * full, inertia * full)


def box(width, height, **law):
    corners = [(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)]
    return tuple(StraightWall(start=a, end=b, **law) for a, b in itertools.pairwise([*corners, corners[0]]))


def tray(count, seed=0, speed=0.3, share=0.3):
    """Balls that roll about, at a share of the area: states and the side of the tray."""
    rng, side = np.random.default_rng(seed), math.sqrt(count * math.pi * R * R / share)
    columns = math.ceil(math.sqrt(count))
    cells = np.stack(np.divmod(np.arange(count), columns), axis=1)
    places = (cells + 0.5) * side / columns + rng.uniform(-1, 1, (count, 2)) * (side / columns / 2 - R) * 0.98
    return rolling_state(places, rng.normal(0, speed / math.sqrt(2), (count, 2)), 0.0, R), side


def list_times(events):
    """Times of events by their kind, their balls, and how often these had such an event before."""
    times = {}
    for kind, balls, t in events:
        times.setdefault((kind, balls), []).append(t)
    return {(*key, number): t for key, own in times.items() for number, t in enumerate(own)}


def break_balls(shift):
    """Times of all events of the break, until the balls rest. shift (balls, 2): of their places, m."""
    radius, rise = THEIRS["radius"], THEIRS["height"] / THEIRS["radius"] - 1
    early = radius * (1 - math.sqrt(1 - rise * rise))  # its balls turn back with the centre a radius from the cushion
    (width, height), law = THEIRS["size"], {"restitution": THEIRS["e_c"], "friction": THEIRS["f_c"]}
    corners = [(a, b) for a, b in ((early, early), (width - early, early))]
    corners += [(width - early, height - early), (early, height - early)]
    ring = itertools.pairwise([*corners, corners[0]])
    walls = tuple(StraightWall(start=a, end=b, height=THEIRS["height"], **law) for a, b in ring)
    states = np.array(THEIRS["start"])
    states[:, :2] += shift
    states[:, 2] = radius
    full = np.ones(len(states))
    balls = Bodies(radius * full, THEIRS["mass"] * full, 0 * full, 0.4 * full)
    model = Model(
        restitution=THEIRS["e_b"],
        sliding_friction=THEIRS["u_s"],
        spin_transfer=0.0,
        rolling_drag=0.0,
        rolling_decel=THEIRS["u_r"] * G,
    )
    events = solve(model, Launch(0.0, states, balls), 0.0, 30.0, table=Table(walls)).events
    return list_times((e.kind, frozenset((e.i, e.j) if e.kind == "contact" else (e.i,)), e.t) for e in events)


def test_a_break_is_pooltools_until_all_balls_rest():
    """pooltool moves balls that touch apart, to 1 um. Collisions amplify that, to 60 ms for the last ball to stop.

    So its times may differ from ours as ours do if the balls start half a micrometre from their places, which shows how
    much this break amplifies.
    """
    listed = ((t, KINDS.get(kind), ids if kind == "ball_ball" else ids[:1]) for t, kind, ids in THEIRS["events"])
    theirs = list_times((kind, frozenset(map(int, ids)), t) for t, kind, ids in listed if kind)
    ours, rng = break_balls(0.0), np.random.default_rng(0)
    assert len(ours) == 85
    assert ours.keys() == theirs.keys()
    apart = []
    for _ in range(12):
        angle = rng.uniform(0, 2 * np.pi, len(THEIRS["start"]))
        shifted = break_balls(SPACER_M / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=1))
        apart.append([shifted[event] - t for event, t in ours.items()])
    rms = np.sqrt(np.mean(np.square(apart), axis=0))
    off = np.array([theirs[event] - t for event, t in ours.items()])
    assert (np.abs(off) / rms).max() < 4
    assert np.sqrt(np.mean((off / rms) ** 2)) < 1.5
    assert abs(off[0]) < 1e-14  # before any hit


@pytest.mark.parametrize("hit", THEIRS["cushion"])
def test_a_cushion_is_hans_as_pooltool_has_it(hit):
    radius = THEIRS["radius"]
    wall = StraightWall(0.85, hit["friction"], 0.0, THEIRS["height"], start=(0.1, -1.0), end=(0.1, 1.0))
    before = np.array(hit["before"])
    ours = hit_wall(Model(), wall, tuple(before.tolist()), (radius, THEIRS["mass"], 0.4))
    np.testing.assert_allclose(ours.after, hit["after"], rtol=1e-12, atol=1e-10)


@pytest.mark.parametrize("hit", THEIRS["mathavan"])
def test_a_cushion_is_mathavans_as_pooltool_has_it(hit):
    """pooltool takes steps of first order: with ten times as many, its difference is a tenth."""
    radius = THEIRS["radius"]
    wall = StraightWall(
        0.85, hit["friction"], 0.0, THEIRS["height"], "mathavan", start=(radius, -1.0), end=(radius, 1.0)
    )
    ours = hit_wall(Model(sliding_friction=THEIRS["u_s"]), wall, tuple(hit["before"]), (radius, THEIRS["mass"], 0.4))
    scale = np.array([1, 1, radius, radius, radius])
    coarse, fine = (np.abs(np.array(ours.after)[[3, 4, 6, 7, 8]] - after) * scale for after in hit["after"])
    assert fine.max() < 1e-4
    assert fine.max() == pytest.approx(coarse.max() / 10, rel=0.05)
    level = math.sqrt(1 - wall.rise(radius) ** 2)
    assert ours.impulse_n * level == pytest.approx(THEIRS["mass"] * (hit["before"][3] - ours.after[3]), rel=0.15)
    assert abs(ours.impulse_t) <= hit["friction"] * ours.impulse_n * (1 + 1e-9)


@given(
    st.floats(0, 1), st.floats(0, 1), st.floats(-1, 1), st.sampled_from([0.4, 2 / 3, 0.5]), st.integers(0, 2**32 - 1)
)
def test_a_wall_takes_what_its_law_says(restitution, friction, beta, inertia, seed):
    rng = np.random.default_rng(seed)
    state = np.array([0, R, R, *rng.uniform(-1, 1, 2), 0, *rng.uniform(-300, 300, 3)])
    state[4] = -abs(state[4]) - 0.01
    wall = StraightWall(restitution, friction, beta, start=(-1.0, 0.0), end=(1.0, 0.0))
    loose = Model(effects=(Hop(share=1.0),))  # the plate holds nothing back
    hit = hit_wall(loose, wall, tuple(state.tolist()), (R, M, inertia))
    after, n = np.array(hit.after), np.array([0.0, 1.0, 0.0])
    assert after[4] == pytest.approx(-restitution * state[4], rel=1e-12)

    def surface(s):
        velocity = s[3:6] + np.cross(s[6:9], -R * n)
        return velocity - (velocity @ n) * n

    impulse, (was, now) = (after - state)[3:6] - (after - state)[4] * n, (surface(s) for s in (state, after))
    largest = friction * (after - state)[4]
    sticks = (1 + beta) * np.linalg.norm(was) / (1 + 1 / inertia) < largest
    assert np.linalg.norm(impulse) <= largest * (1 + 1e-9) + 1e-15  # velocities of 1 m/s are rounded
    if sticks:
        np.testing.assert_allclose(now, -beta * was, rtol=0, atol=1e-12)
    # angular momentum about the point of contact
    for spin in (state, after):
        spin[2] = 0
    about = [inertia * R * R * s[6:9] + np.cross(R * n, s[3:6]) for s in (state, after)]
    np.testing.assert_allclose(about[0], about[1], rtol=0, atol=1e-12)
    energies = [(s[3:6] ** 2).sum() + inertia * R * R * (s[6:9] ** 2).sum() for s in (state, after)]
    assert energies[1] <= energies[0] * (1 + 1e-12)


def test_a_billiard_in_a_circle():
    """Chords of equal length at equal angles, for a ball that loses nothing."""
    model, rim = Model(rolling_drag=0.0, rolling_decel=0.0, sliding_friction=1e-12), Rim(radius=0.05 + R)
    start = plate_state(np.array([0.01, -0.02]), np.array([0.3, 0.05]), np.zeros(2), 0.0, R)[None]
    motion = solve(model, Launch(0.0, start, bodies(1)), 0.0, 5.0, False, Table((rim,)))
    hits = [e for e in motion.events if e.kind == "wall"]
    places, times = np.array([e.before[0, :2] for e in hits]), np.array([e.t for e in hits])
    assert len(hits) > 10
    np.testing.assert_allclose(np.hypot(*places.T), 0.05, rtol=1e-12)
    speed, offset = math.hypot(0.3, 0.05), (0.01 * 0.05 + 0.02 * 0.3) / math.hypot(0.3, 0.05)
    np.testing.assert_allclose(np.diff(times), 2 * math.sqrt(0.05**2 - offset**2) / speed, rtol=1e-9)


def test_the_end_of_a_wall_is_a_point():
    wall = StraightWall(start=(0.0, 0.0), end=(0.0, 1.0))
    states = rolling_state(np.array([[-0.05, -R / 2]]), np.array([[0.3, 0.0]]), 0.0, R)
    model = Model(rolling_drag=0.0, rolling_decel=0.0)
    hit = solve(model, Launch(0.0, states, bodies(1)), 0.0, 0.3, table=Table((wall,))).first("wall")
    assert hit.t == pytest.approx((0.05 - R * math.sqrt(0.75)) / 0.3, rel=1e-12)
    np.testing.assert_allclose(hit.n, [-math.sqrt(0.75), -0.5], rtol=1e-9)


@pytest.mark.parametrize("count", [2, 5])
def test_newtons_cradle(count):
    """Equal balls in touch pass on the velocity; the rest stay at rest."""
    places = np.stack([2 * R * np.arange(count), np.zeros(count)], axis=1)
    states = rolling_state(places, np.zeros((count, 2)), 0.0, R)
    states[0] = rolling_state(np.array([-0.02, 0.0]), np.array([0.3, 0.0]), 0.0, R)
    states[1:, :2] -= [2 * R, 0.0]
    motion = solve(FREE, Launch(0.0, states, bodies(count)), 0.0, 0.0595, False, Table(contact_duration=1e-6))
    hits = [e for e in motion.events if e.kind == "contact"][: count - 1]
    assert [e.t for e in hits] == pytest.approx([hits[0].t] * (count - 1), abs=1e-14)
    speeds = {ball: e.after[row, 3] for e in hits for row, ball in enumerate((e.i, e.j))}
    came = hits[0].before[:, 3].max()
    assert speeds == pytest.approx({k: came * (k == count - 1) for k in range(count)}, abs=1e-12)


def momentum(states, mass):
    return (states[:, 3:5] * mass[:, None]).sum(axis=0)


def test_each_contact_conserves_momentum_and_its_angular_momentum():
    """Balls, shells and discs of different masses and sizes, with friction between them and a hop."""
    states, side = tray(40, seed=2)
    rng = np.random.default_rng(3)
    mixed = Bodies(
        R * rng.uniform(0.7, 1, 40), M * rng.uniform(0.5, 2, 40), np.zeros(40), rng.choice([0.4, 2 / 3, 0.5], 40)
    )
    states[:, 2] = mixed.radius
    states[:, 6:8] = np.stack([-states[:, 4], states[:, 3]], axis=1) / mixed.radius[:, None]
    model = Model(restitution=0.9, effects=(BallFriction(mu=0.1), Hop(share=1.0)))
    motion = solve(model, Launch(0.0, states, mixed), 0.0, 0.2, False, Table(box(side, side), (), 1e-5))
    hits = [e for e in motion.events if e.kind == "contact"]
    assert len(hits) > 100
    for e in hits:
        own = mixed[[e.i, e.j]]
        before, after = e.before, e.after
        size = own.mass.sum() * 0.3
        np.testing.assert_allclose(momentum(before, own.mass), momentum(after, own.mass), rtol=0, atol=1e-12 * size)
        spin = [
            (own.mass * (s[:, 0] * s[:, 4] - s[:, 1] * s[:, 3])).sum()
            + (own.inertia * own.mass * own.radius**2 * s[:, 8]).sum()
            for s in (before, after)
        ]
        assert spin[0] == pytest.approx(spin[1], abs=1e-12 * size * side)


def test_the_calendar_misses_no_contact(monkeypatch):
    """In cells a ball looks ahead by little; every event is that of a search over all pairs. One ball is large."""
    states, side = tray(30, seed=4)
    states[29], own = np.eye(9)[2] * 5 * R, bodies(30)
    states[29, :2], own.radius[29] = side + 4 * R, 5 * R
    launch, table = Launch(0.0, states, own), Table(box(side + 0.02, side + 0.02), (), 1e-5)
    found = []
    for most in (3, 100):
        monkeypatch.setattr(calendar, "WITHOUT_CELLS", most)
        found.append(solve(Model(), launch, 0.0, 0.15, False, table).events)
    assert len(found[0]) == len(found[1]) > 150
    for one, two in zip(*found, strict=True):
        assert (one.kind, one.i, one.j) == (two.kind, two.i, two.j)
        assert one.t == pytest.approx(two.t, abs=1e-9)


def test_no_ball_enters_another_or_a_wall():
    states, side = tray(30, seed=5)
    motion = solve(Model(), Launch(0.0, states, bodies(30)), 0.0, 0.3, False, Table(box(side, side), (), 1e-5))
    places = motion.at(np.linspace(0, 0.3, 500))[..., :2]
    gaps = np.linalg.norm(places[:, None] - places[None], axis=-1) + 1e3 * np.eye(30)[..., None]
    assert gaps.min() > 2 * R * (1 - 1e-9)
    assert places.min() > R * (1 - 1e-9)
    assert places.max() < side - R * (1 - 1e-9)


def test_unlike_bodies_that_stick_end_with_surfaces_at_rest():
    """A solid ball hits a heavier shell; nothing holds them down."""
    own = Bodies(np.array([R, R]), np.array([M, 2.5 * M]), np.zeros(2), np.array([2 / 3, 2 / 5]))
    states = np.array([[0, 0, R, 0, 0, 0, 0, 0, 0.0], [-0.01, R, R, 0.3, 0.0, 0, 20.0, 300.0, -50.0]])
    model = Model(restitution=0.9, effects=(BallFriction(mu=1.0, beta=0.0), Hop(share=1.0)))
    hit = solve(model, Launch(0.0, states, own), 0.0, 0.05).first("contact")
    n = (hit.before[0] - hit.before[1])[:3] / (2 * R)
    pressed = hit.after[:, 5] < 0
    assert not pressed.all()
    after = hit.after[1, 3:6] - hit.after[0, 3:6]
    surfaces = after - (after @ n) * n + np.cross(R * hit.after[:, 6:9].sum(axis=0), n)
    np.testing.assert_allclose(surfaces, 0, rtol=0, atol=1e-12)


@pytest.mark.parametrize("inertia", [2 / 5, 2 / 3, 1 / 2])
def test_a_ball_slides_by_its_inertia(inertia):
    """It starts without spin, slides for v/((1 + 1/k) mu g) and rolls on at v/(1 + k)."""
    states = np.array([[0, 0, R, 0.3, 0, 0, 0, 0, 0.0]])
    end = solve(Model(), Launch(0.0, states, bodies(1, inertia)), 0.0, 0.2).first("slide_end")
    assert end.t == pytest.approx(0.3 / ((1 + 1 / inertia) * 0.232 * G), rel=1e-12)
    assert end.after[0, 3] == pytest.approx(0.3 / (1 + inertia), rel=1e-12)


@pytest.mark.parametrize("inertia", [2 / 3, 1 / 2])
def test_a_shell_on_a_leaning_plate_is_integrated_as_its_equations_say(inertia):
    push, model = (
        np.array([G * math.sin(0.01), 0.0]),
        Model(rolling_drag=0.0, rolling_decel=0.0, effects=(PlateTilt(x=0.01, y=0.0),)),
    )
    states = plate_state(np.zeros((1, 2)), np.array([[0.2, 0.1]]), np.array([[0.1, -0.2]]), 0.0, R, np.full(1, inertia))
    motion = solve(model, Launch(0.0, states, bodies(1, inertia)), 0.0, 0.3)
    end = motion.first("slide_end").t

    def slide(t, y):
        u = np.array([y[2] - R * y[5], y[3] + R * y[4]])
        a = -0.232 * G * u / np.hypot(*u)
        return [*y[2:4], *(a + push), *(np.array([a[1], -a[0]]) / inertia / R)]

    first = states[0, [0, 1, 3, 4, 6, 7]]
    exact = solve_ivp(slide, (0, 0.9 * end), first, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    ours = motion.at(0.9 * end)[0, 0, [0, 1, 3, 4, 6, 7]]
    np.testing.assert_allclose(ours, exact, rtol=1e-8, atol=1e-10)
    one, two = motion.at([end + 0.01, 0.3])[0, :, 3:5]
    np.testing.assert_allclose((two - one) / (0.29 - end), push / (1 + inertia), rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize("air", [Air(0.2, 0.1, 0.5, 2.0), Air(0.2, 1e-5, -3.0), Air(0.0, 0.3, 1.0), Air(0.3, 0.2)])
def test_a_puck_on_air(air):
    states = np.array([[0.1, 0.2, R, 0.4, -0.3, 0, 0, 0, 7.0]])
    motion = solve(Model(), Launch(0.0, states, bodies(1, 0.5)), 0.0, 1.2, table=Table((), (air,)))

    def law(t, y):
        v = y[2:4]
        loss = -(air.decel / np.hypot(*v) + air.drag) * v
        return [*v, *(loss + air.curl * np.array([-v[1], v[0]])), -air.spin_drag * y[4]]

    exact = solve_ivp(law, (0, 1.2), states[0, [0, 1, 3, 4, 8]], method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    np.testing.assert_allclose(motion.at(1.2)[0, 0, [0, 1, 3, 4, 8]], exact, rtol=1e-9, atol=1e-11)
    assert motion.motion(0.5).tolist() == [["glide"]]


def test_a_puck_stops_and_its_spin_dies_out():
    states = np.array([[0, 0, R, 0.1, 0, 0, 0, 0, 5.0]])
    motion = solve(Model(), Launch(0.0, states, bodies(1, 0.5)), 0.0, 2.0, table=Table((), (Air(0.2, spin_drag=0.5),)))
    stop = motion.first("stop")
    assert (stop.t, stop.after[0, 0]) == pytest.approx((0.5, 0.1**2 / 0.4), rel=1e-12)
    assert motion.at(2.0)[0, 0, 8] == pytest.approx(5 * math.exp(-1), rel=1e-12)


def friction_by_quadrature(speed, turn):
    """Force and torque of a disc of radius 1 with the velocities under it averaged, over those of pure sliding."""
    nodes, weights = np.polynomial.legendre.leggauss(120)
    r, angle = (nodes + 1) / 2, 2 * np.pi * (np.arange(240) + 0.5) / 240
    r, angle = r[:, None], angle[None]
    ux, uy = speed - turn * r * np.sin(angle), turn * r * np.cos(angle)
    size, area = np.hypot(ux, uy), (weights[:, None] / 2 * r) / 120
    return (ux / size * area).sum(), ((r * np.cos(angle) * uy - r * np.sin(angle) * ux) / size * area).sum()


@pytest.mark.parametrize(("speed", "spin"), [(1.0, 10.0), (0.3, 600.0), (0.5, 0.0), (0.0, 100.0), (1.0, -0.5)])
def test_a_disc_on_a_dry_plate(speed, spin):
    """Against the equations in time with friction by quadrature; they end together, at the published ratio."""
    states = np.array([[0, 0, R, 0.6 * speed, 0.8 * speed, 0, 0, 0, spin]])
    table = Table((), (DryPlate(2.0),))
    motion = solve(Model(), Launch(0.0, states, bodies(1, 0.5)), 0.0, 1.0, table=table)
    stop = motion.first("stop").t

    def law(t, y):
        force, torque = friction_by_quadrature(y[1], y[2])
        return [y[1], -2.0 * force, -4.0 * torque]

    first = [0.0, speed, R * abs(spin)]
    exact = solve_ivp(law, (0, 0.9 * stop), first, method="DOP853", rtol=1e-7, atol=1e-10).y[:, -1]
    ours = motion.at(0.9 * stop)[0, 0]
    np.testing.assert_allclose([math.hypot(*ours[:2]), math.hypot(*ours[3:5])], exact[:2], rtol=2e-5, atol=1e-9)
    assert R * ours[8] == pytest.approx(math.copysign(exact[2], spin), rel=2e-5, abs=1e-9)
    if speed and spin:
        late = motion.at(stop * (1 - 1e-9))[0, 0]
        assert math.hypot(*late[3:5]) / (R * abs(late[8])) == pytest.approx(0.653, abs=0.02)
    assert motion.motion(0.99).tolist() == [["rest"]]


def test_discs_on_air_swap_spin_by_friction():
    """Two equal discs without rotation, an oblique hit that sticks: each gets what the impulse at the rim gives."""
    model = Model(restitution=0.8, effects=(BallFriction(mu=1.0, beta=0.0),))
    air, b = Air(), 0.5  # without rotation they stick, as J/P is 0.11
    states = np.zeros((2, 9))
    states[:, 2], states[1, 3] = R, 0.3
    states[1, :2] = [-0.02, 2 * R * b]
    hit = solve(model, Launch(0.0, states, bodies(2, 0.5)), 0.0, 0.2, table=Table((), (air, air))).first("contact")
    across = 0.3 * b
    for row in (0, 1):
        # J/m = u/(2 (1 + 1/k)) = u/6, and R dw = J/(k m) = u/3
        assert abs(R * hit.after[row, 8]) == pytest.approx(across / 3, rel=1e-9)
    assert np.all(hit.after[:, 6:8] == 0)
    np.testing.assert_allclose(contact_velocity(hit.after, R), hit.after[:, 3:5])


def test_contacts_differ_by_chance_as_told():
    """The draws are in the events, have the widths asked for, and are what each impact shows."""
    states, side = tray(60, seed=6)
    scatter = ContactScatter(restitution=0.02, friction=0.2, normal=0.05, seed=(3, 1))
    launch, table = Launch(0.0, states, bodies(60)), Table(box(side, side), (), 1e-9, scatter)
    motion = solve(Model(), launch, 0.0, 0.4, False, table)
    hits = [e for e in motion.events if e.kind == "contact"]
    drawn = np.array([list(e.drawn.values()) for e in hits])
    assert len(hits) > 300
    allowed = 4 / math.sqrt(2 * len(hits))
    np.testing.assert_allclose(drawn.std(axis=0) / [0.02, 0.2, 0.05], 1, atol=allowed)
    np.testing.assert_allclose(drawn.mean(axis=0), [0, 1, 0], atol=0.2 * 4 / math.sqrt(len(hits)))
    for e in hits:
        (x, y, *_), shift, _, turn = e.before[0] - e.before[1], *e.drawn.values()
        centres = np.array([x, y]) / math.hypot(x, y)
        n = np.array(e.n)
        assert math.atan2(centres[0] * n[1] - centres[1] * n[0], centres @ n) == pytest.approx(turn, abs=1e-9)
        before, after = (np.diff(s[:, 3:5], axis=0)[0] for s in (e.before, e.after))
        assert -(after @ n) / (before @ n) == pytest.approx(min(0.903 + shift, 1), rel=1e-9)
    again = solve(Model(), launch, 0.0, 0.4, False, table)
    assert [e.t for e in again.events] == [e.t for e in motion.events]


def test_friction_between_balls_falls_with_speed():
    slow, fast = (
        BallFriction(mu=0.01, rise=0.108, fall=0.92).spin_transfer(0.0, w, 1e-3 * w, 0.4) * 0.4 * 1e3
        for w in (0.1, 3.0)
    )
    assert (slow, fast) == pytest.approx((0.01 + 0.108 * math.exp(-0.1 / 0.92), 0.01 + 0.108 * math.exp(-3 / 0.92)))


@pytest.mark.parametrize("restitution", [0.05, 0.065, 0.08, 0.12])
def test_three_balls_in_a_row_collapse_below_the_known_restitution(restitution):
    """They collide without end if r < 7 - 4 sqrt(3) = 0.0718 (McNamara & Young, Phys. Fluids A 4 (1992) 496).

    Without friction of the plate, from starts in which the middle ball is hit nearly from both sides at once. An
    endless sequence reaches intervals under the contact duration within 20 impacts, a finite one does not.
    """
    smooth = {"sliding_friction": 1e-13, "spin_transfer": 0.0, "rolling_drag": 0.0, "rolling_decel": 0.0}
    model = Model(restitution=restitution, **smooth)
    endless = []
    for more in (1.005, 1.01, 1.02):
        places = np.array([[0.0, 0], [2 * R + 1e-3, 0], [4 * R + 1e-3 * (1 + more), 0]])
        states = rolling_state(places, np.array([[1.0, 0], [0, 0], [-1.0, 0]]), 0.0, R)
        motion = solve(model, Launch(0.0, states, bodies(3)), 0.0, 0.01, False, Table(contact_duration=1e-9))
        times = np.array([e.t for e in motion.events if e.kind == "contact"])
        endless.append(bool(np.any(np.diff(times) < 1e-9)))
    assert any(endless) == (restitution < 7 - 4 * math.sqrt(3))


@pytest.mark.parametrize("share", [0.0, 1e-6, 1e-3, 0.1])
def test_momentum_that_the_plate_takes_prevents_a_collapse(share):
    """Three balls that move as a whole: each contact takes a share of the common velocity of two of them.

    The contacts are counted in one dimension: a contact of two changes their mean velocity V to (1 - share) V.
    """
    smooth = {"sliding_friction": 1e-13, "spin_transfer": 0.0, "rolling_drag": 0.0, "rolling_decel": 0.0}
    places = np.array([[0.0, 0], [2 * R + 1e-3, 0], [4 * R + 2.01e-3, 0]])
    velocities = np.array([3.5, 3.0, 2.5])
    states = rolling_state(places, np.stack([velocities, 0 * velocities], axis=1), 0.0, R)
    launch, table = Launch(0.0, states, bodies(3)), Table(plate_share=share)

    def run():
        motion = solve(Model(restitution=0.03, **smooth), launch, 0.0, 0.2, False, table)
        return [e for e in motion.events if e.kind == "contact"]

    if share == 0:
        with pytest.raises(ValueError, match="stay in contact"):
            run()
        return
    hits = run()
    x, v, t, count = places[:, 0] - 2 * R * np.arange(3), velocities.copy(), 0.0, 0
    while np.any(np.diff(v) < 0):
        times = np.where(np.diff(v) < 0, np.diff(x) / np.maximum(-np.diff(v), 1e-300), np.inf)
        k = int(times.argmin())
        x, t, count = x + v * times[k], t + times[k], count + 1
        mean, apart = (1 - share) * v[k : k + 2].mean(), 0.03 * (v[k] - v[k + 1])
        x[k : k + 2], v[k : k + 2] = x[k : k + 2].mean(), [mean - apart / 2, mean + apart / 2]
    assert len(hits) == count
    assert hits[-1].t == pytest.approx(t, rel=1e-9)


@settings(max_examples=5)
@given(st.floats(0.05, 0.25))
def test_an_endless_sequence_ends_with_a_contact_duration(restitution):
    """Three balls in a row that lose much collide ever faster (McNamara & Young, Phys. Fluids A 4 (1992) 496)."""
    places = np.array([[0.0, 0], [2 * R + 1e-4, 0], [4 * R + 2e-4, 0]])
    states = rolling_state(places, np.array([[0.3, 0], [0, 0], [-0.3, 0]]), 0.0, R)
    launch = Launch(0.0, states, bodies(3))
    model = Model(restitution=restitution, spin_transfer=0.0)
    motion = solve(model, launch, 0.0, 0.2, table=Table(contact_duration=1e-5))
    hits = [e for e in motion.events if e.kind == "contact"]
    assert 2 < len(hits) < 10_000
    last, elastic = dict.fromkeys(range(3), -1.0), 0
    for e in hits:
        np.testing.assert_allclose(e.before[:, 3].sum(), e.after[:, 3].sum(), rtol=0, atol=1e-12)
        if any(e.t - last[k] < 1e-5 for k in (e.i, e.j)):
            elastic += 1
            assert np.diff(e.after[:, 3]) / np.diff(e.before[:, 3]) <= -1 + 1e-9
        last[e.i] = last[e.j] = e.t
    assert elastic
    assert not np.any(np.isnan(motion.at(0.2)))


def test_a_striker_starts_late_flies_then_slides_rolls_and_hits():
    """A cue's jump at 0.1 s: the flight lasts 2 u/g, and the ball that it hits was at rest until then."""
    states = np.zeros((2, 9))
    states[:, 2], states[1, 0] = R, 0.06
    later = (LaterLaunch(0, 0.1, (0.4, 0.0, 0.2, 0.0, 0.0, 0.0)),)
    motion = solve(Model(), Launch(0.0, states, bodies(2), later), 0.0, 0.5)
    kinds = [e.kind for e in motion.events]
    assert kinds[:4] == ["launch", "land", "slide_end", "contact"]
    times = [e.t for e in motion.events]
    assert times[0] == 0.1
    assert times[1] - times[0] == pytest.approx(0.4 / G, rel=1e-12)
    assert motion.motion([0.05, 0.12, 0.145, times[3] - 1e-4])[0].tolist() == ["rest", "fly", "slide", "roll"]
    np.testing.assert_array_equal(motion.at(0.1 - 1e-9)[0, 0, 3:], 0)
    np.testing.assert_allclose(motion.at(0.12)[0, 0, :3], [0.008, 0, R + 0.2 * 0.02 - G / 2 * 4e-4], rtol=1e-12)
    # what it has on the plate: friction mu (u + 0) at the landing, then the slide, end in rolling at 5/7 of the speed
    assert motion.events[2].after[0, 3] == pytest.approx(0.4 * 5 / 7, rel=1e-12)


@pytest.mark.parametrize(("air", "obstacle"), [(None, False), (Air(0.2, spin_drag=0.3), False), (None, True)])
def test_a_hand_pushes_a_body_until_a_time_or_a_hit(air, obstacle):
    a, until, other = np.array([0.5, -0.2]), 0.25, 0.01 if obstacle else 0.5
    states = np.zeros((2, 9))
    states[:, 2], states[1, :2] = R, other * np.array([0.5, -0.2]) / np.hypot(0.5, 0.2)
    later = (LaterLaunch(0, 0.05, (0.0,) * 6, until, tuple(a.tolist())),)
    inertia = 0.5 if air else 0.4
    launch, table = Launch(0.0, states, bodies(2, inertia), later), Table((), (air, air) if air else ())
    motion = solve(Model(restitution=0.5, spin_transfer=0.0), launch, 0.0, 0.4, table=table)
    release = motion.first("release")
    assert motion.motion(0.1)[0, 0] == "push"
    pushed = release.t - 0.05
    if obstacle:
        assert pushed == pytest.approx(math.sqrt(2 * (other - 2 * R) / np.hypot(*a)), rel=1e-9)
        assert motion.first("contact").t == release.t
    else:
        assert release.t == until
        np.testing.assert_allclose(release.after[0, :2], a * pushed**2 / 2, rtol=1e-12)
        np.testing.assert_allclose(release.after[0, 3:5], a * pushed, rtol=1e-12)
        np.testing.assert_allclose(release.after[0, 6:8], 0 if air else [-a[1] * pushed / R, a[0] * pushed / R])
        assert motion.motion(until + 1e-6)[0, 0] == ("glide" if air else "roll")
    assert motion.first("slide_end", 0) is None or obstacle


def test_balls_hit_at_distances_that_differ_by_chance():
    """The distance at each contact is that of its draw, or less where the balls were nearer when they turned back."""
    states, side = tray(30, seed=8)
    table = Table(box(side, side), (), 1e-9, ContactScatter(distance=0.01, seed=(5, 2)))
    motion = solve(Model(), Launch(0.0, states, bodies(30)), 0.0, 0.3, False, table)
    hits = [e for e in motion.events if e.kind == "contact"]
    apart = np.array([np.linalg.norm((e.before[0] - e.before[1])[:3]) for e in hits]) - 2 * R
    np.testing.assert_allclose([e.drawn["distance_shift"] for e in hits], apart, rtol=0, atol=1e-15)
    first = [k for k, e in enumerate(hits) if (e.i, e.j) not in {(h.i, h.j) for h in hits[:k]}]
    shares = apart[first] / (2 * R)
    assert len(first) > 60
    # faster balls meet more often at large distances than at small ones: a bias of the order of the width squared
    assert shares.mean() == pytest.approx(0, abs=4 * 0.01 / math.sqrt(len(first)))
    assert shares.std() == pytest.approx(0.01, rel=4 / math.sqrt(2 * len(first)))
    again = solve(Model(), Launch(0.0, states, bodies(30)), 0.0, 0.15, False, table)
    assert [e.t for e in again.events] == [e.t for e in motion.events if e.t <= 0.15]


def test_air_is_drawn_for_each_stretch():
    """The loss and the turn of each stretch are those that its event has; they are even between their limits."""
    states, side = tray(6, seed=9)
    air = Air(drag=0.1, decel_range=(0.05, 0.3), curl_range=(-1.0, 1.0))
    model = Model(restitution=0.9, spin_transfer=0.0)
    table = Table(box(side, side, restitution=0.9), (air,) * 6, 1e-9, ContactScatter(seed=(1,)))
    motion = solve(model, Launch(0.0, states, bodies(6, 0.5)), 0.0, 0.3, False, table)
    stretches = [e for e in motion.events if e.kind == "stretch"]
    assert len(stretches) > 40
    for event in stretches[:20]:
        t, h = event.t, 1e-5
        if any(e.t < t + 2 * h and e.t > t and event.i in (e.i, e.j) for e in motion.events):
            continue
        v = motion.at([t, t + h])[event.i, :, 3:5]
        mean, a = v.mean(axis=0), np.diff(v, axis=0)[0] / h
        loss, turn = -(a @ mean) / np.hypot(*mean) - 0.1 * np.hypot(*mean), mean[0] * a[1] - mean[1] * a[0]
        assert loss == pytest.approx(event.drawn["decel"], abs=1e-5)
        assert turn / (mean @ mean) == pytest.approx(event.drawn["curl"], abs=1e-4)
    drawn = np.array([[e.drawn["decel"], e.drawn["curl"]] for e in stretches])
    assert drawn.min(axis=0)[0] > 0.05
    assert drawn.max(axis=0)[0] < 0.3
    allowed = 4 / math.sqrt(12 * len(drawn))
    np.testing.assert_allclose((drawn.mean(axis=0) - [0.175, 0]) / [0.25, 2], 0, atol=allowed)
