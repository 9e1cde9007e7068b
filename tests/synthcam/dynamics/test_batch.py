"""The batch against `solve`, one collision at a time: positions, exposure means, slide ends."""

import numpy as np
import pytest

from synthcam.dynamics.batch import LAUNCH_COLUMNS, MAX_GROUP, interpolate_hermite, solve_collisions
from synthcam.dynamics.kinematics import contact_velocity, plate_state
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.library import library
from synthcam.model import Model

FPS, EXPOSURE, END = 250.0, 4e-3, 0.4  # the shutter never closes: every kink falls into an exposure
SHAPES = {"hop.bounce": 0.5, "ball_friction.mu": 0.1}


def launches(count, seed=0):
    """(count, 6): slow and fast, head-on and grazing."""
    rng = np.random.default_rng(seed)
    columns = {"x": rng.uniform(-0.02, 0.02, count), "y": rng.uniform(-0.02, 0.02, count)}
    columns |= {"t_c": rng.uniform(0.05, 0.15, count), "v0": rng.uniform(0.05, 0.6, count)}
    columns |= {"heading": rng.uniform(0, 2 * np.pi, count), "b": rng.uniform(-0.95, 0.95, count)}
    return np.column_stack([columns[name] for name in LAUNCH_COLUMNS])


def alone(model, row, striker_is_a=False):
    x, y, t_c, v0, heading, b = row
    bodies = model.bodies("ba" if striker_is_a else "ab")
    return solve(model, Launch.pair(bodies, t_c, v0, b, heading, (x, y)), 0.0, END)


def realistic(kind):
    """Every parameter at its realistic size, forces small enough for a ball to rest."""
    small = 0.3 if "push" in kind.laws else 1.0
    values = {f"{kind.name()}.{p.name}": p.typical * (1.0 if p.fixed else small) for p in kind.parameters()}
    return Model().replace({k: SHAPES.get(k, v) for k, v in values.items()})


def compare(model, rows, striker_is_a, atol, instants=61):
    batch = solve_collisions(model, rows, 0.0, END, striker_is_a)
    times = np.linspace(0, END, instants)
    starts = np.arange(int(END * FPS) - 1) / FPS
    spans = np.stack([starts, starts + EXPOSURE], axis=1)
    states, means = batch.at(times), batch.average_centres(starts, EXPOSURE)
    for k, row in enumerate(rows):
        motion = alone(model, row, striker_is_a[k])
        np.testing.assert_allclose(states[:, k, :, :3], motion.at(times)[..., :3], rtol=0, atol=atol)
        np.testing.assert_allclose(states[:, k, :, 3:6], motion.at(times)[..., 3:6], rtol=0, atol=1e3 * atol)
        theirs = motion.average(spans, lambda s: s[..., :2])
        np.testing.assert_allclose(means[:, k], theirs, rtol=0, atol=atol)
        for ball in (0, 1):
            ends = [e.t for e in motion.events if e.kind == "slide_end" and e.i == ball]
            assert batch.slide_ends[ball * len(rows) + k] == pytest.approx(ends[0] if ends else row[2], abs=10 * atol)


@pytest.mark.parametrize("kind", library().values(), ids=list(library()))
def test_the_batch_is_solve_many_times(kind):
    compare(realistic(kind), launches(6), np.arange(6) % 2 == 1, 1e-12)


def test_the_base_model():
    compare(Model(), launches(40), np.zeros(40, bool), 1e-13)


def test_many_effects_at_once():
    names = ("hop", "ball_friction", "stribeck", "plate_tilt", "air_drag", "mass_mismatch", "diameter_mismatch")
    model = Model()
    for name in names:
        model = model.replace({f"{name}.{p.name}": 0.3 * p.typical for p in library()[name].parameters()})
    compare(model, launches(8, 4), np.arange(8) % 2 == 1, 1e-12)


def test_collisions_of_a_batch_may_differ_in_the_base_model():
    """Each moves as in a batch of its own model: without losses, with a drag too small for the closed forms, again."""
    rows = np.concatenate([launches(4), launches(6, 2) * [1, 1, 1, 1, 1, 0.01]])
    base = {
        "restitution": [0.9, 1.0, 0.5, 0.9, *[0.36] * 6],
        "sliding_friction": np.linspace(0.1, 0.4, 10),
        "spin_transfer": np.linspace(0.0, 0.5, 10),
        "rolling_drag": [0.0, 0.1, 1e-4, 0.135, *[0.135] * 6],
        "rolling_decel": [0.0, 0.01, 0.02, 0.5, *[0.0103] * 6],
    }
    base = {name: np.array(values) for name, values in base.items()}
    batch = solve_collisions(Model(), rows, 0.0, END, ends=np.full(10, END), base=base)
    times, starts = np.linspace(0, END, 61), np.arange(int(END * FPS) - 1) / FPS
    again = 0
    for k in range(10):
        model = Model().replace({name: values[k] for name, values in base.items()})
        one = solve_collisions(model, rows[[k]], 0.0, END, ends=np.full(1, END))
        np.testing.assert_allclose(batch.at(times)[:, k], one.at(times)[:, 0], rtol=1e-13, atol=1e-15)
        means = batch.average_centres(starts, EXPOSURE)[:, k], one.average_centres(starts, EXPOSURE)[:, 0]
        np.testing.assert_allclose(*means, rtol=1e-13, atol=1e-16)
        again += len([e for e in alone(model, rows[k]).events if e.kind == "contact"]) > 1
    assert again > 0


def test_balls_that_meet_again():
    """With little restitution the striker catches up; that clip goes to `solve`."""
    model, rows = Model(restitution=0.36), launches(6, 2)
    rows[:, 5] *= 0.01
    again = [len([e for e in alone(model, row).events if e.kind == "contact"]) for row in rows]
    assert max(again) > 1
    compare(model, rows, np.zeros(6, bool), 1e-12)


def test_a_ball_that_stops_and_rolls_back():
    """Uphill, out of a trough, on a slope steeper than friction holds."""
    model = Model().replace({"plate_waviness.a": -5e-5, "plate_waviness.wavelength": 0.01})
    rows = np.array([[0.0, 0.0, 0.05, 0.06, 0.0, 0.0], [0.0, 0.0, 0.05, 0.06, 0.0, -0.5]])
    rows[:, 0] = -model.ball.radius * np.sqrt(1 - rows[:, 5] ** 2)  # the target rests in the trough
    starts = [[e.i for e in alone(model, row).events if e.kind == "start"] for row in rows]
    assert starts[0]
    compare(model, rows, np.zeros(2, bool), 1e-11)


def test_instants_of_each_balls_own():
    rows = launches(4)
    batch = solve_collisions(Model(), rows, 0.0, END)
    own = np.random.default_rng(1).uniform(0, END, (8, 5))
    states = batch.at(own)
    for k in range(4):
        for ball in (0, 1):
            whole = batch.at(own[ball * 4 + k])[ball, k]
            np.testing.assert_array_equal(states[ball, k], whole)


def test_groups_led_together_change_nothing():
    model = Model().replace({"plate_waviness.a": 6e-7, "drilling_spin.a": 2e-5, "eccentric_mass.c": 1e-6})
    rows = launches(MAX_GROUP)
    some = np.arange(0, MAX_GROUP, 57)
    whole, part = solve_collisions(model, rows, 0.0, END), solve_collisions(model, rows[some], 0.0, END)
    starts = np.arange(95) / FPS
    np.testing.assert_allclose(
        whole.average_centres(starts, 3e-4)[:, some], part.average_centres(starts, 3e-4), rtol=0, atol=1e-14
    )
    balls = np.concatenate([some, some + MAX_GROUP])
    assert whole.breaks.shape == (2 * MAX_GROUP, part.breaks.shape[1])
    np.testing.assert_allclose(np.sort(whole.breaks[balls]), np.sort(part.breaks), rtol=0, atol=1e-13)


def test_a_large_batch_has_the_centres_of_small_ones():
    model, starts = Model().replace({"mass_mismatch.excess": 0.1}), np.arange(95) / FPS
    rows, is_a = launches(MAX_GROUP + 50), np.arange(MAX_GROUP + 50) % 3 == 0
    some = slice(MAX_GROUP - 20, MAX_GROUP + 20)
    whole = solve_collisions(model, rows, 0.0, END, is_a).average_centres(starts, EXPOSURE)
    part = solve_collisions(model, rows[some], 0.0, END, is_a[some]).average_centres(starts, EXPOSURE)
    np.testing.assert_array_equal(whole[:, some], part)


def test_no_exposure_is_an_instant():
    batch = solve_collisions(Model(), launches(5), 0.0, END)
    starts = np.arange(90) / FPS
    np.testing.assert_allclose(batch.average_centres(starts, 0.0), batch.at(starts)[..., :2], rtol=0, atol=1e-16)


def test_what_has_no_solution_says_so():
    with pytest.raises(ValueError, match="cannot rest"):
        solve_collisions(Model().replace({"plate_tilt.x": 2e-3}), launches(3), 0.0, END)
    downhill = Model().replace({"plate_waviness.a": -5e-5, "plate_waviness.wavelength": 0.1})
    with pytest.raises(ValueError, match="come from rest"):
        solve_collisions(downhill, np.array([[-1.19e-3, 0.0, 2.9, 0.01, 0.0, 0.0]]), 0.0, 3.0)


SPUN = np.array(
    [
        [0.01, -0.02, 0.10, 0.4, 0.7, 0.3, 0.15, -0.1, 0.2],
        [0.0, 0.01, 0.12, 0.5, -0.7, -0.3, -0.25, 0.1, 0.0],
        [0.0, 0.0, 0.12, 0.5, 2.7, 0.2, 0.0, 0.0, 0.3],
    ]
)  # columns LAUNCH_COLUMNS and SPIN_COLUMNS
PAIRED = ("magnetic_attraction",)  # of balls that push each other only rolling ones have a past


@pytest.mark.parametrize("kind", [k for n, k in library().items() if n not in PAIRED], ids=lambda k: k.name())
def test_strikers_that_slide_or_spin_come_to_their_hit(kind):
    """The motion before the contact, found backwards in time, leads forwards from the state at 0 to the same hit."""
    model, times = realistic(kind), np.linspace(0.0, END, 31)
    batch = solve_collisions(model, SPUN, 0.0, END)
    for k, (x, y, t_c, v0, heading, b, *spin) in enumerate(SPUN):
        launch = Launch.pair(model.bodies("ab"), t_c, v0, b, heading, (x, y), spin)
        back = solve(model, launch, 0.0, END)
        on = solve(model, Launch(0.0, back.at(np.zeros(1))[:, 0], launch.bodies), 0.0, END)
        hit = on.first("contact")
        assert hit.t == pytest.approx(t_c, abs=1e-9)
        assert np.abs(hit.before - launch.states).max() < 1e-6
        assert np.abs(on.at(times)[..., :2] - back.at(times)[..., :2]).max() < 1e-9
        assert np.abs(batch.at(times)[:, k, :, :2] - back.at(times)[..., :2]).max() < 1e-12


def test_a_sliding_approach_is_a_parabola_along_its_slip():
    """Back by t: the place v t and mu g t^2 / 2 along the slip away, the slip longer by 7/2 mu g t."""
    model, t = Model(), 0.05
    slowing = model.sliding_friction * model.gravity
    for row in SPUN[:2]:
        x, y, t_c, v0, heading, b, *spin = row
        bodies = model.bodies("ab")
        before = Launch.pair(bodies, t_c, v0, b, heading, (x, y), spin).states[1]
        u = contact_velocity(before, bodies.radius[1])
        assert np.hypot(*u) == pytest.approx(np.hypot(*spin[:2]))
        there = solve_collisions(model, row[None], 0.0, END).at(np.array([t_c - t]))[1, 0, 0]
        hat = u / np.hypot(*u)
        assert there[:2] == pytest.approx(before[:2] - before[3:5] * t - slowing * hat * t**2 / 2, abs=1e-12)
        assert contact_velocity(there, bodies.radius[1]) == pytest.approx(u + 3.5 * slowing * hat * t, abs=1e-12)
        assert there[8] == pytest.approx(spin[2] / bodies.radius[1])


def test_a_free_ball_that_stops_on_a_slope_rolls_back():
    """As `solve` has it; a ball that met nothing stayed where it stopped. The target, which nobody sees, rests."""
    model = Model(rolling_decel=0.005, effects=(library()["plate_tilt"](x=-3e-3),))
    launches = np.array([[0.0, 0.0, 0.1, 0.02, 0.0, 2.0], [0.01, 0.0, 0.0, 0.03, 1.0, 2.0]])
    times = np.linspace(0.0, 4.0, 41)
    batch = solve_collisions(model, launches, 0.0, 4.0).at(times)
    for row, (x, y, t_c, v0, heading, _) in enumerate(launches):
        alone = solve(model, Launch.single(model.bodies(("a",)), t_c, v0, heading, (x, y)), t_c, 4.0)
        late = times > t_c
        assert batch[1, row, late, :2] == pytest.approx(alone.at(times[late])[0][:, :2], abs=1e-9)
        assert batch[0, row, :, :2] == pytest.approx(np.tile([x, y], (len(times), 1)), abs=1e-12)
        assert not batch[0, row, :, 3:].any()
        assert batch[1, row, -1, 0] < -0.03


def test_a_striker_that_meets_nothing_moves_as_if_alone():
    """From the time of its launch on, and straight on before it."""
    launches = np.array([[0.01, 0.02, 0.1, 0.4, 0.3, 2.0, 0.1, -0.05, 0.0], [0.0, 0.0, 0.05, 0.3, 2.0, 2.0, 0, 0, 0]])
    model, times = Model(), np.linspace(0.0, 0.3, 31)
    free = solve_collisions(model, launches, 0.0, 0.3).at(times)[1]
    for row, (x, y, t_c, v0, heading, _, *spin) in zip(free, launches, strict=True):
        ahead = np.array([np.cos(heading), np.sin(heading)])
        early = times <= t_c
        straight = np.array([x, y]) + v0 * (times[early, None] - t_c) * ahead
        assert row[early, :2] == pytest.approx(straight, abs=1e-12)
        bodies = model.bodies(("a",))
        q = v0 * ahead - 2 / 7 * (spin[0] * ahead + spin[1] * np.array([-ahead[1], ahead[0]]))
        state = plate_state(
            np.array([[x, y]]), q[None], (v0 * ahead - q)[None] * 3.5, np.zeros(1), bodies.radius, bodies.inertia
        )
        alone = solve(model, Launch(t_c, state, bodies), 0.0, 0.3)
        late = times[~early]
        assert row[~early, :2] == pytest.approx(alone.at(late)[0][:, :2], abs=1e-9)


def parabola(times, kink=0.3):
    """Two balls that turn at `kink`: (2, m, 4); just after the kink where a time falls on it."""
    late = np.maximum(times - kink, 0)
    x = 1 + 2 * times - times**2 - 3 * late + 2 * late**2
    v = 2 - 2 * times + np.where(times >= kink, -3 + 4 * late, 0)
    return np.stack([x, -2 * x, v, -2 * v], axis=-1) * np.array([1.0, 10.0])[:, None, None]


def test_places_between_knots():
    knots = np.array([[0.3, 0.5, 0.5, 0.9]])
    ends = parabola(np.concatenate([knots, knots]))[:1]
    shares = np.linspace(0, 1, 5)
    places = interpolate_hermite(ends, np.diff(knots), shares)
    times = knots[:, :-1, None] + shares * np.diff(knots)[..., None]
    np.testing.assert_allclose(places[0], parabola(np.tile(times.reshape(1, -1), (2, 1)))[0, :, :2].reshape(3, 5, 2))


@pytest.mark.parametrize("effects", [{}, {"plate_tilt.x": 3e-4}, {"hop.bounce": 0.0}])
def test_a_free_ball_is_followed_until_its_own_end(effects):
    """Until then it moves as one that is followed longer; a pair that meets is followed to the common end."""
    model, rows = Model().replace(effects), launches(6, 3)
    rows[:5, 5] = 2.0  # meets nothing
    ends = np.linspace(0.2, 0.35, 6)
    times = np.linspace(rows[:, 2], [*ends[:5], END], 20, axis=1)
    both = (solve_collisions(model, rows, 0.0, END, ends=own).at(np.tile(times, (2, 1))) for own in (ends, None))
    short, whole = both
    assert np.allclose(short, whole, rtol=0, atol=1e-12)
    solved = solve_collisions(model, rows, 0.0, END, ends=ends)
    assert max(s.ends[s.who % 6 == 0].max(initial=0.0) for s in solved.segments) == pytest.approx(ends[0])
    later = solved.at(np.linspace(0.3, END, 3))
    assert np.isnan(later[:, 0]).all()  # after its end
    assert not np.isnan(later[:, 5]).any()
