"""A gas against closed forms: parabolas, a Maxwellian, equal speeds, random points, and energies that add up."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import synthcam
from synthcam_shared.errors import InputError
from tracker.gas.contact_groups import HIDING_FRAMES, count_hidden_rows, group_contacts
from tracker.gas.contact_losses import expect_losses, measure_contact_losses, predict_losses
from tracker.gas.energy import SINKS, measure_losses
from tracker.gas.free_paths import FreePath
from tracker.gas.gas import GasCamera, contact_pair_correlation, contact_rate, mean_free_path, measure_gas
from tracker.gas.pair_correlation import pair_correlation
from tracker.gas.temperature import HALVES, measure_temperatures
from tracker.gas.velocities import HalfVelocities, find_slide_end, fit_velocities
from tracker.measurement.crowd.contact_table import tabulate_contacts
from tracker.measurement.positions import BallTrack, to_ball_tracks
from tracker.tables.read import to_pixels
from tracker.tables.table import TrackTable

FPS = 250.0


def make_contacts(*rows):
    """The table of contacts of (t_s, particle1, particle2, energy_lost, energy_lost_std) each."""
    names = ["t_s", "particle1", "particle2", "energy_lost", "energy_lost_std"]
    table = pd.DataFrame(list(rows), columns=names).astype({"particle1": int, "particle2": int})
    return table.astype(dict.fromkeys((names[0], *names[3:]), float)).assign(misfit=False)


NO_CONTACTS = make_contacts()


def make_ball(particle, position, noise, frame=None):
    frame = np.arange(len(position)) if frame is None else frame
    cov = np.broadcast_to(np.eye(2) * noise**2, (len(position), 2, 2))
    return BallTrack(particle=particle, frame=frame, start=frame / FPS, position=position, cov=cov, exposure=0.0)


def make_gas(velocities, frames, noise, seed=0):
    """Balls that move at constant velocities, far apart."""
    rng, t = np.random.default_rng(seed), np.arange(frames) / FPS
    return [
        make_ball(k, rng.uniform(-1, 1, 2) + t[:, None] * v + rng.normal(0, noise, (frames, 2)), noise)
        for k, v in enumerate(velocities)
    ]


@pytest.mark.parametrize(("rows", "slide_end"), [(30, np.nan), (6, np.nan), (30, 0.0505)])
def test_velocities_of_accelerated_paths_are_exact(rows, slide_end):
    t = np.arange(rows) / FPS
    bend = np.where(t > slide_end, (t - slide_end) ** 2, 0.0)
    path = np.outer(t, [0.2, -0.1]) - np.outer(t**2, [0.7, 0.2]) + np.outer(bend, [0.6, 0.1])
    at = np.array([-0.004, 0.01, 0.056, t[-1]])
    found = fit_velocities(t, path, at, 10, slide_end)
    expected = np.array([0.2, -0.1]) - np.outer(2 * at, [0.7, 0.2])
    expected += np.outer(np.where(at > slide_end, 2 * (at - slide_end), 0.0), [0.6, 0.1])
    np.testing.assert_allclose(found.even, expected, atol=1e-9)
    np.testing.assert_allclose(found.odd, expected, atol=1e-9)
    if np.isfinite(slide_end):
        assert find_slide_end(t, path, 1e-9) == pytest.approx(slide_end, abs=1 / FPS)
    else:
        assert np.isnan(find_slide_end(t, path, 1e-9))


@pytest.mark.parametrize("rows", [5, 9])
def test_square_of_velocity_has_no_noise(rows):
    rng, noise, speed = np.random.default_rng(3), 0.01, 3.0
    t, trials = np.arange(rows) / FPS, 3000
    found = []
    for _ in range(trials):
        path = np.outer(t, [speed, 0.0]) + rng.normal(0, noise, (rows, 2))
        square, variance = fit_velocities(t, path, t[rows // 2 : rows // 2 + 1], 10).square(noise)
        found.append((square[0], variance[0]))
    squares, variances = np.array(found).T
    error = squares.std() / np.sqrt(trials)
    assert abs(squares.mean() - speed**2) < 4 * error  # the square of a noisy velocity fails by far
    assert squares.std() == pytest.approx(np.sqrt(variances.mean()), rel=0.1)


@pytest.mark.parametrize(("kind", "a2"), [("maxwellian", 0.0), ("equal speeds", -0.5)])
def test_temperature_and_shape(kind, a2):
    rng, n, temperature, noise = np.random.default_rng(5), 400, 0.02, 1e-3
    velocities = rng.normal(0, np.sqrt(temperature), (n, 2))
    if kind == "equal speeds":
        velocities *= np.sqrt(2 * temperature) / np.linalg.norm(velocities, axis=1, keepdims=True)
    balls = make_gas(velocities + np.array([0.3, 0.0]), 12, noise)
    gas = measure_gas(balls, NO_CONTACTS, GasCamera(0.002, FPS))
    true = velocities.var(axis=0, ddof=1).sum() / 2
    z = (gas.time["temperature"] - true) / gas.time["temperature_std"]
    assert np.abs(z).max() < 4
    assert abs(true - temperature) < 4 * gas.time["temperature_sampling"].iloc[0] + 1e-12
    assert abs(gas.values["sonine_a2"] - a2) < 4 * gas.values["sonine_a2_std"]
    assert gas.values["sonine_a2_std"] < 0.15
    assert gas.time["drift_x"].iloc[0] == pytest.approx(0.3 + velocities[:, 0].mean(), abs=0.03)
    assert gas.values["noise_ratio"] == pytest.approx(1, abs=0.1)
    share = (gas.time["temperature_std"] / gas.time["temperature"]).mean() / 2  # contacts go as the root
    assert gas.values["contacts_theory_std"] == pytest.approx(share * gas.values["contacts_theory"], rel=0.1)
    if kind == "maxwellian":
        table = gas.velocities
        z = (table["density"] - np.exp(-(table["c"] ** 2) / 2) / np.sqrt(2 * np.pi)) / table["density_std"]
        assert np.abs(z[table["density"] > 0.02]).max() < 4


def test_pair_correlation_of_random_points_is_one_up_to_the_edge():
    rng, size = np.random.default_rng(8), (3.0, 1.0)
    table = pair_correlation([rng.uniform(0, size, (60, 2)) for _ in range(400)], size, 1.0, bins=20)
    z = (table["g"] - 1) / table["g_std"]
    assert np.abs(z).max() < 4
    assert table["g_std"].iloc[1:].max() < 0.05  # without the correction g would be .6 at the end


def test_kinetic_theory():
    """Rates of hard discs: Gass (1971), J. Chem. Phys. 54, 1898; Alder and Wainwright's free path at low density."""
    n, d, temperature = 1.0, 0.01, 0.5
    dilute = 2 * n * d * np.sqrt(np.pi * temperature)
    assert contact_rate(temperature, n, d) == pytest.approx(dilute, rel=1e-3)
    mean_speed = np.sqrt(np.pi * temperature / 2)
    assert mean_free_path(n, d) == pytest.approx(mean_speed / contact_rate(temperature, n, d))
    assert contact_pair_correlation(0.5) == pytest.approx((1 - 7 / 32) / 0.25)


def test_energies_add_up_and_go_where_they_went():
    """Two balls slide, roll, hit, slide and roll again; a third bounces at a wall."""
    t = np.arange(120) / FPS
    contact, slide = 0.2002, 0.06

    def travel(v, decel, since):
        return v * since - decel * since**2 / 2

    def path(v_in, v_out, decel):
        after = np.maximum(t - contact, 0)
        short, long = np.minimum(after, slide), np.maximum(after - slide, 0)
        end = v_out - decel * slide
        return np.where(
            t < contact, travel(v_in, 0.05, t), travel(v_in, 0.05, contact) + travel(v_out, decel, short) + end * long
        )

    rng, noise = np.random.default_rng(1), 1e-7
    x = [path(0.4, 0.05, -1.0), path(0.0, 0.34, 1.5), path(-0.3, 0.24, 0.4)]
    balls = [
        make_ball(k, np.column_stack([one, np.full(len(t), k * 0.1)]) + rng.normal(0, noise, (len(t), 2)), noise)
        for k, one in enumerate(x)
    ]
    nan = float("nan")
    gas = measure_gas(balls, make_contacts((contact, 0, 1, nan, nan), (contact, 2, -1, nan, nan)), GasCamera(0.01, FPS))
    last = gas.time.iloc[-1]
    total = gas.time["energy"].iloc[0] - last["energy"]
    assert sum(last[column] for column in SINKS.values()) == pytest.approx(total, abs=1e-9)
    v0, v2 = 0.4 - 0.05 * contact, -0.3 - 0.05 * contact
    struck = -0.05 * contact  # ball 1 starts at rest and is accelerated too in this drawing
    in_contact = (v0**2 + struck**2 - 0.05**2 - 0.34**2) / 2
    assert last["lost_in_contacts"] == pytest.approx(in_contact, abs=5 * last["lost_in_contacts_std"])
    assert last["lost_in_contacts_std"] < 0.02 * in_contact
    assert last["lost_at_walls"] == pytest.approx((v2**2 - 0.24**2) / 2, abs=5 * last["lost_at_walls_std"])
    assert last["lost_unresolved"] == 0
    plate = last["lost_to_plate"]
    given = measure_gas(
        balls, make_contacts((contact, 0, 1, 0.01, 0.001), (contact, 2, -1, nan, nan)), GasCamera(0.01, FPS)
    )
    last = given.time.iloc[-1]
    assert (last["lost_in_contacts"], last["lost_in_contacts_std"]) == pytest.approx((0.01, 0.001))
    assert last["lost_to_plate"] == pytest.approx(plate + in_contact - 0.01, abs=1e-4)


def make_path(ball, frames, velocity, start=-1, end=-1):
    """A free path with one velocity and no noise; start, end: rows of the contacts."""
    every = np.tile(np.asarray(velocity, dtype=float), (len(frames) + 2, 1))
    tiny = np.full(len(every), 1e6)
    halves, frame = HalfVelocities(every, every, tiny, tiny, 0 * tiny), np.array(frames)
    time, unsure = frame / FPS, np.zeros(len(every))
    return FreePath(ball, frame, time, start, end, time[0] - 1e-3, time[-1] + 1e-3, halves, unsure)


def make_kicks(contacts, kick):
    """A table of contacts (particle1, particle2, x, y) that push ball 1 along -x."""
    rows = [(0.04, *contact[:2], np.nan, np.nan) for contact in contacts]
    place = np.array(contacts, dtype=float)[:, 2:]
    kick = np.asarray(kick, dtype=float)
    return make_contacts(*rows).assign(kick=kick, kick_std=0.01 * kick, nx=-1.0, ny=0.0, x=place[:, 0], y=place[:, 1])


@pytest.mark.parametrize("kept", [5 / 7, 0.9, 1.0])
def test_kicks_give_the_losses_of_contacts_whose_slides_hide_them(kept):
    """400 balls meet one at rest with r = 0.9: what their velocities by the impulses lose, in all."""
    rng, r = np.random.default_rng(1), 0.9
    before = np.zeros((400, 2, 2))
    before[:, 0] = np.column_stack([rng.uniform(0.1, 0.4, 400), rng.uniform(-0.4, 0.4, 400)])
    after, kick = before.copy(), (1 + r) / 2 * before[:, 0, 0]
    push = np.column_stack([kick, (1 - kept) / 2 * before[:, 0, 1]])
    after[:, 0] -= push
    after[:, 1] += push
    true = ((before**2 - after**2) / 2).sum()
    paths = [make_path(2 * k + i, [0], v, end=k) for k, pair in enumerate(before) for i, v in enumerate(pair)]
    table = make_kicks([(2 * k, 2 * k + 1, 0, 0) for k in range(400)], kick * (1 + rng.normal(0, 0.01, 400)))
    lost, variance, common = predict_losses(table, paths, 1e-9)
    std = np.sqrt(variance.sum() + (common.sum(axis=0) ** 2).sum())
    assert abs(lost.sum() - true) < 1.5 * std
    assert std < 0.1 * (before**2).sum() / 2
    shown = table.assign(v_n=before[:, 0, 0], v_t=np.abs(before[:, 0, 1]), r=r, mu_bb_std=1e-3)
    shown["mu_bb"] = (1 - kept) * shown["v_t"] / ((1 + r) * shown["v_n"])
    lost, variance, common = predict_losses(shown, paths, 1e-9)
    std = np.sqrt(variance.sum() + (common.sum(axis=0) ** 2).sum())
    assert abs(lost.sum() - true) < 1.5 * std
    assert std < 0.02 * (before**2).sum() / 2


def test_balls_without_a_velocity_leave_energies_and_their_errors_known():
    """One ball hits a wall after its first position, another is seen in a single frame; three others move on."""
    noise, speed = 1e-7, 0.2
    balls = make_gas([[0.1, 0.0], [0.0, speed], [-0.1, 0.1]], 30, noise)
    x = np.append(0.0, -speed * np.arange(29) / FPS)
    balls.append(make_ball(3, np.column_stack([x, np.full(30, 3.0)]), noise))
    balls.append(make_ball(4, np.array([[5.0, 5.0]]), noise))
    nan = float("nan")
    gas = measure_gas(balls, make_contacts((0.5 / FPS, 3, -1, nan, nan)), GasCamera(0.01, FPS, on_air=True))
    energies = gas.time[["energy", "energy_std", *(f"{c}{end}" for c in SINKS.values() for end in ("", "_std"))]]
    assert np.isfinite(energies.to_numpy()).all()
    of_others = (0.1**2 + speed**2 + 0.1**2 + 0.1**2) / 2
    assert gas.time["energy"].iloc[-1] == pytest.approx(of_others + speed**2 / 2, rel=1e-3)
    assert gas.time["energy_std"].iloc[-1] < 1e-3 * of_others


def test_kicks_give_the_losses_at_walls_but_not_inside_the_hull():
    """A wall with r = 0.5 along x takes 3/8 of the square of a velocity across it."""
    paths = [make_path(k, range(10), (0.4, 0.1), end=k) for k in range(5)]
    tray = [(k, -1, 0.1 * (k % 2), 0.1 * (k // 2)) for k in range(4)]
    for inside, last in ((True, 0.05), (False, 0.1), (False, np.nan)):
        table = make_kicks([*tray, (4, -1, last, last)], np.full(5, 0.6))
        lost = measure_contact_losses(table, paths, 1e-9)[0]
        np.testing.assert_allclose(lost, [3 / 8 * 0.16] * 4 + [np.nan if inside else 3 / 8 * 0.16], rtol=1e-6)
    line = make_kicks([(k, -1, 0.1 * k, 0.2 * k) for k in range(5)], np.full(5, 0.6))
    assert np.isfinite(measure_contact_losses(line, paths, 1e-9)[0]).all()
    known = [make_path(4, range(10), (0.4, 0), end=4), make_path(4, range(11, 20), (0.2, 0), start=4)]
    losses = measure_losses(known, make_kicks([*tray, (4, -1, 0.05, 0.05)], np.full(5, 0.2)), np.arange(20), 1e-9)
    assert losses[["lost_at_walls", "lost_unresolved"]].iloc[-1].tolist() == pytest.approx([0, 0.06])


@pytest.mark.parametrize("between", [1.5, 2.5])
def test_a_wall_next_to_another_contact_is_unresolved(between):
    """Also that of ball 4, which loses more than its kick of 0.2 m/s can take."""
    paths = [make_path(k, range(10), (0.4, 0), end=k) for k in range(5)]
    paths += [make_path(4, range(11, 20), (0.1, 0), start=4)]
    corners = [(k, -1, 0.1 * (k % 2), 0.1 * (k // 2)) for k in range(4)]
    table = make_kicks([*corners, (4, -1, 0.1, 0.0), (0, 1, 0.05, 0.0)], [0.6, 0.6, 0.6, 0.6, 0.2, 0.1])
    table.loc[5, "t_s"] += between / FPS
    lost = measure_contact_losses(table, paths, 1e-9, 1 / FPS)[0]
    mixed = between < 2
    assert np.isnan(lost[:5]).tolist() == [mixed, mixed, False, False, True]


@pytest.mark.parametrize("other", [1, -1])
def test_energy_that_is_not_resolved_counts_in_the_errors(other):
    """A ball loses 0.06 m^2/s^2 at a ball without a path, or at a wall without any kick."""
    paths = [make_path(0, range(10), (0.4, 0), end=0), make_path(0, range(11, 20), (0.2, 0), start=0)]
    table = make_contacts((0.04, 0, other, np.nan, np.nan))
    paths[1].velocities.even[-2] = np.nan  # a slide hides the velocity after the contact
    last = measure_losses(paths, table, np.arange(20), 1e-9, 1 / FPS).iloc[-1]
    assert last["lost_unresolved"] == pytest.approx(0.06)
    own, not_own = ("in_contacts", "at_walls") if other > 0 else ("at_walls", "in_contacts")
    assert last[f"lost_{own}_std"] == pytest.approx(0.06, rel=1e-3)
    assert last[f"lost_{not_own}_std"] == 0
    assert last["lost_to_plate_std"] == pytest.approx(0.03, rel=0.01)


def make_chain(hidden):
    """Ten pairs that show their losses, and one ball that hits two others between two frames, with no path between.

    hidden: whether the second of these was not found, so that the ball has a lone kink inside the hull of all contacts.
    """
    table, paths, nan = [], [], float("nan")
    for k in range(10):
        table.append((0.04, 2 * k, 2 * k + 1, nan, nan))
        for ball, before, after in ((2 * k, 0.4, 0.02), (2 * k + 1, 0.0, 0.36)):
            paths += [make_path(ball, range(10), (before, 0), end=k)]
            paths += [make_path(ball, range(11, 20), (after, 0), start=k)]
    table += [(0.0401, 20, -1 if hidden else 21, nan, nan)] + [(0.0411, 20, 22, nan, nan)] * (not hidden)
    paths += [make_path(20, range(10), (0.4, 0), end=10)]
    paths += [make_path(20, range(11, 20), (0.03, 0), start=10 if hidden else 11)]
    if not hidden:
        wrong = replace(make_path(20, [10], (9, 9), start=10, end=11), usable=False)
        others = [make_path(21, range(10), (0, 0), end=10), make_path(21, range(11, 20), (0.2, 0), start=10)]
        paths += [
            wrong,
            *others,
            make_path(22, range(10), (0, 0), end=11),
            make_path(22, range(11, 20), (0.3, 0), start=11),
        ]
    x = np.where(np.arange(len(table)) < 10, np.arange(len(table)) % 4, 1.5) * 0.1
    y = np.where(np.arange(len(table)) < 10, np.arange(len(table)) // 4, 1.0) * 0.1
    kicks = {"kick": 0.38, "kick_std": 1e-3, "nx": -1.0, "ny": 0.0}
    return make_contacts(*table).assign(**kicks, x=x, y=y), paths


def test_contacts_without_a_path_between_them_are_balanced_together():
    """The ball gives 0.2 and 0.3 m/s to two others; the positions between both hits show nothing."""
    table, paths = make_chain(hidden=False)
    last = measure_losses(paths, table, np.arange(20), 1e-9, 1 / FPS).iloc[-1]
    of_pairs, of_chain = 10 * (0.4**2 - 0.02**2 - 0.36**2) / 2, (0.4**2 - 0.03**2 - 0.2**2 - 0.3**2) / 2
    assert last["lost_in_contacts"] == pytest.approx(of_pairs + of_chain, rel=1e-6)
    assert last["lost_in_contacts_std"] == pytest.approx(np.hypot(2.0 * 0.002 * 9, 0.3 * of_chain), rel=0.3)
    assert last[["lost_to_plate", "lost_unresolved"]].tolist() == pytest.approx([0, 0], abs=1e-9)


def test_a_hit_of_a_ball_that_was_not_found_takes_what_its_kick_lets_expect():
    """Its ball loses much more, which the other one has. The plate's loss holds it, until that one hits something."""
    table, paths = make_chain(hidden=True)
    last = measure_losses(paths, table, np.arange(20), 1e-9, 1 / FPS).iloc[-1]
    each = (0.4**2 - 0.02**2 - 0.36**2) / 2
    assert last["lost_in_contacts"] == pytest.approx(10.75 * each, rel=1e-3)
    assert 0.7 * each < last["lost_in_contacts_std"] < each
    assert last["lost_to_plate"] == pytest.approx((0.4**2 - 0.03**2) / 2 - 0.75 * each, rel=1e-3)


@pytest.mark.parametrize("at", ["start", "end"])
def test_a_hit_beside_the_first_or_last_frame_counts_in_the_errors(at):
    """One of five balls turns back half a frame after the first one, or before the last. No table has that contact."""
    noise, frames = 1e-6, 40
    velocities = np.array([[0.1, 0.0], [0.0, 0.2], [-0.1, 0.1], [0.1, 0.1], [0.4, 0.0]])
    balls = make_gas(velocities, frames, noise)
    position, row = balls[4].position.copy(), 0 if at == "start" else frames - 1
    position[row, 0] += (1.0 if at == "start" else -1.0) * 0.5 * 0.7 / FPS  # the velocity there is -0.3 m/s
    balls[4] = make_ball(4, position, noise)
    time = measure_gas(balls, NO_CONTACTS, GasCamera(0.002, FPS)).time
    off = (0.4**2 - 0.3**2) / 2
    assert 0.5 * off < time["energy_std"].iloc[row] < 5 * off
    assert time["energy_std"].iloc[frames // 2] < 1e-3 * off


@pytest.mark.parametrize(("bounces_at", "error_frames"), [(19.95, 0.2), (20.05, 0.01)])
def test_it_is_not_sure_on_which_side_of_a_frame_a_contact_is(bounces_at, error_frames):
    """The table puts a bounce 0.05 frames after a frame; it may have come before, if its time is known worse."""
    t, noise, bounce = np.arange(40) / FPS, 1e-6, bounces_at / FPS
    balls = make_gas(np.array([[0.1, 0.0], [0.0, 0.2], [-0.1, 0.1]]), 40, noise)
    x = np.where(t < bounce, 0.4 * (t - bounce), -0.2 * (t - bounce))
    balls.append(make_ball(3, np.column_stack([x, np.full(40, 3.0)]), noise))
    contacts = make_contacts((20.05 / FPS, 3, -1, np.nan, np.nan)).assign(t_s_std=error_frames / FPS)
    time = measure_gas(balls, contacts, GasCamera(0.01, FPS, on_air=True)).time
    std = time["energy_std"].iloc[20]
    if error_frames > 0.1:
        assert 0.4 < (0.4**2 - 0.2**2) / 2 / std < 2
    else:
        assert std < 0.003


def test_two_balls_that_exchange_their_velocities_beside_a_frame_leave_its_energy_known():
    """Either velocity may be off by 0.4 m/s in frame 20, but not the sum of their energies."""
    t, noise, hit = np.arange(40) / FPS, 1e-6, 19.95 / FPS
    balls = make_gas(np.array([[0.1, 0.0], [0.0, 0.2], [-0.1, 0.1]]), 40, noise)
    for particle, before in ((3, 0.4), (4, 0.0)):
        x = np.where(t < hit, before * (t - hit), (0.4 - before) * (t - hit)) + 0.01 * (particle - 3)
        balls.append(make_ball(particle, np.column_stack([x, np.full(40, 3.0)]), noise))
    contacts = make_contacts((20.05 / FPS, 3, 4, np.nan, np.nan)).assign(t_s_std=0.2 / FPS)
    time = measure_gas(balls, contacts, GasCamera(0.01, FPS, on_air=True)).time.iloc[20]
    assert time["energy_std"] < 0.02 * 0.4**2 / 2
    velocities = np.array([[0.1, 0.0], [0.0, 0.2], [-0.1, 0.1], [0.4, 0.0], [0.0, 0.0]])
    assert time["temperature"] == pytest.approx(velocities.var(axis=0, ddof=1).mean(), rel=0.01)
    assert time["temperature_std"] < 0.02 * time["temperature"]


def test_slides_share_the_error_of_the_friction_and_no_other():
    """A hundred balls at 0.1 m/s in all directions: what each errs by of its own averages out."""
    angle = 2 * np.pi * np.arange(100) / 100
    velocities = 0.1 * np.column_stack([np.cos(angle), np.sin(angle)])
    columns = dict(zip(HALVES, [*velocities.T, *velocities.T], strict=True))
    columns |= {"gain_even": 0.0, "gain_odd": 0.0, "gain_common": 0.0, "unknown": 0, "frame": 0}
    own = pd.DataFrame(columns).assign(unsure=0.01, friction_x=0.0, friction_y=0.0, smoothed=0.0)
    relative = 2 * 0.1 * 0.01 * np.sqrt(0.5 * 100) / (100 * 0.1**2)  # half of the squares is along the velocity
    found = measure_temperatures(own, 0.0).iloc[0]
    assert found["temperature_std"] / found["temperature"] == pytest.approx(relative)
    along = own.assign(unsure=0.0, friction_x=0.1 * velocities[:, 0], friction_y=0.1 * velocities[:, 1])
    found = measure_temperatures(along, 0.0).iloc[0]
    assert found["temperature_std"] / found["temperature"] == pytest.approx(0.2)
    lines = measure_temperatures(own.assign(unsure=0.0, smoothed=0.01), 0.0).iloc[0]
    assert lines["temperature_std"] / lines["temperature"] == pytest.approx(0.2)
    across = own.assign(unsure=0.0, friction_x=0.1 * velocities[:, 1], friction_y=-0.1 * velocities[:, 0])
    assert measure_temperatures(across, 0.0).iloc[0]["temperature_std"] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.gate
def test_sinks_of_a_tray_have_the_errors_that_they_claim():
    """Four films of 100 balls against the simulation; without the rules for walls their z is 11 or so."""
    z, of_contacts = [], []
    for seed in range(1, 5):
        clip, rng = synthcam.Scene.read("cooling", timing={"frames": 120}).draw(seed=seed), np.random.default_rng(seed)
        x, y = (clip.tracks[f"{axis}_mean_px"] + 0.05 * rng.standard_normal(len(clip.tracks)) for axis in "xy")
        table = clip.tracks[["frame", "particle"]].assign(x=x, y=y, x_std=0.05, y_std=0.05, cov_xy=0.0)
        read = to_pixels(TrackTable(table), "truth", clip.camera_json)
        balls, camera = to_ball_tracks(read.clips[0][0], read.camera), read.camera
        contacts = tabulate_contacts(read.clips[0][0], camera, [])
        last = measure_gas(balls, contacts, GasCamera(camera.ball_diameter, camera.fps)).time.iloc[-1]
        motion = clip.solve()
        events = motion.events[motion.events.t_s < last["t_s"]]
        for kind, name in (("contact", "in_contacts"), ("wall", "at_walls")):
            at = events.t_s[events.kind == kind].to_numpy()
            before, after = (
                (motion.at(when)[["vx", "vy"]].to_numpy() ** 2).sum() / 2 for when in (np.maximum(at - 1e-9, 0), at)
            )  # of all balls, of which only those that hit change
            z.append((last[f"lost_{name}"] - (before - after)) / last[f"lost_{name}_std"])
            of_contacts += [(last[f"lost_{name}"], last[f"lost_{name}_std"], before - after)] * (kind == "contact")
    rms = np.sqrt((np.reshape(z, (-1, 2)) ** 2).mean(axis=0))
    assert (rms < 1.5).all()
    assert (rms > 0.2).all()
    measured, std, true = np.sum(of_contacts, axis=0)
    assert measured / true == pytest.approx(1, abs=0.1)  # 0.7 or so without the balance of energies
    assert std < 0.25 * true


@pytest.mark.parametrize("partner", [False, True])
def test_energy_that_goes_to_a_ball_without_a_path_is_unresolved(partner):
    """A ball stops at an equal one, and gives it all its energy; partner: whether a path shows that."""
    table = make_contacts((0.04, 0, 1, 0.0, 1e-6))
    paths = [make_path(0, range(10), (0.4, 0), end=0), make_path(0, range(11, 20), (0, 0), start=0)]
    paths += [make_path(1, range(10), (0, 0), end=0)]
    paths += [make_path(1, range(11, 20), (0.4, 0), start=0)] if partner else []
    last = measure_losses(paths, table, np.arange(20), 1e-9).iloc[-1]
    assert last["lost_to_plate"] == pytest.approx(0, abs=1e-9)
    assert last["lost_unresolved"] == pytest.approx(0 if partner else 0.08)


def test_two_balls_are_no_gas():
    with pytest.raises(InputError, match="3 balls"):
        measure_gas(make_gas(np.ones((2, 2)), 20, 1e-6), NO_CONTACTS, GasCamera(0.002, FPS))


@pytest.mark.parametrize("frames", [3, 7])
def test_short_films_have_a_temperature_too(frames):
    """No window is long enough for halves: the noise is then what the tracks claim."""
    velocities = np.random.default_rng(4).normal(0, 0.15, (20, 2))
    gas = measure_gas(make_gas(velocities, frames, 1e-6), NO_CONTACTS, GasCamera(0.002, FPS))
    z = (gas.time["temperature"] - velocities.var(axis=0, ddof=1).mean()) / gas.time["temperature_std"]
    assert len(z) == frames
    assert np.abs(z).max() < 4
    assert gas.values["position_noise"] == pytest.approx(1e-6)


def test_balls_without_a_velocity_count_and_have_their_way():
    """One of four balls bounces between each two frames; the others fly straight."""
    balls = make_gas(np.array([[0.2, 0.0], [0.0, 0.3], [-0.1, 0.1], [0.1, 0.2]]), 30, 1e-6)
    nan = float("nan")
    bounces = make_contacts(*((k / FPS + 0.5 / FPS, 0, -1, nan, nan) for k in range(29)))
    plain, bounced = (
        measure_gas(balls, rows, GasCamera(0.002, FPS), area=(-2, -2, 2, 2)) for rows in (NO_CONTACTS, bounces)
    )
    assert bounced.values["area_fraction"] == pytest.approx(plain.values["area_fraction"])
    assert bounced.time["temperature"].iloc[15] == pytest.approx(plain.time["temperature"].iloc[15], rel=1e-3)
    assert bounced.time["temperature_std"].iloc[15] > 10 * plain.time["temperature_std"].iloc[15]


def test_a_large_loss_that_was_mistaken_does_not_change_what_others_usually_take():
    """Walls with r = 0.8 and friction 0.2 take what impulses say; the fastest one seems to take thrice that."""
    rng, r, friction = np.random.default_rng(2), 0.8, 0.2
    along, across = rng.uniform(0.02, 0.3, 60), rng.uniform(0.1, 0.4, 60)
    across = np.maximum(across, 2 * friction * (1 + r) * along)  # surfaces slide up to the end
    along[0], across[0] = 1.0, 1.0
    pushed = (1 + r) * along
    true = ((1 - r**2) * along**2 + across**2 - (across - friction * pushed) ** 2) / 2
    taken = np.where(np.arange(60) == 0, 3 * true, true)
    table = make_kicks([(k, -1, 0, 0) for k in range(60)], np.hypot(pushed, friction * pushed))
    expected, std = expect_losses(table, taken, np.full(60, 1e-12), across, np.ones(60, dtype=bool))
    np.testing.assert_allclose(expected, true, rtol=1e-3)
    assert (std[1:] < 0.01 * true[1:]).all()


@pytest.mark.parametrize("shown", [0.0, 0.6])
def test_contacts_that_hide_next_to_others_are_as_many_as_a_steady_rate_makes(shown):
    """One ball meets 4,000 walls at random times, one in 33 frames. Of two within 1.5 frames a share shows both."""
    rng, rate = np.random.default_rng(3), 0.03
    frame = np.cumsum(rng.exponential(1 / rate, 4000))
    far = np.append(True, np.diff(frame) > HIDING_FRAMES)
    kept = far | (rng.random(4000) < shown)
    between = np.floor(frame) - np.floor(np.append(0.0, frame[:-1]))  # frames since the hit before
    frame = frame[kept]
    table = make_kicks([(0, -1, 0, 0) for _ in frame], np.full(len(frame), 0.1)).assign(t_s=frame / FPS)
    hidden = 4000 - len(frame)
    groups = group_contacts(table, [], 1e-9, 1 / FPS)
    assert groups.hiding[groups.label].sum() == pytest.approx(hidden, rel=0.15 if shown == 0 else 0.4)
    rows = count_hidden_rows(table, np.arange(int(frame[-1]) + 9), 1 / FPS)
    assert rows.sum() == pytest.approx(between[~kept].sum(), rel=0.15 if shown == 0 else 0.4)
    assert not group_contacts(table.drop(columns="kick"), [], 1e-9, 1 / FPS).hiding.any()  # all may be given


@pytest.mark.parametrize("seen", [True, False])
def test_usual_losses_of_many_contacts_may_all_be_wrong_in_one_direction(seen):
    """40 contacts get the loss of 400 others, as their own is far off (seen) or unknown: each to its whole size.

    Together they have the errors of 40 independent ones, and 0.3 of their sum.
    """
    paths = []
    for k in range(440):
        for ball, before, after in ((2 * k, 0.4, 0.02), (2 * k + 1, 0.0, 0.38 if k < 400 else 0.1)):
            paths.append(make_path(ball, range(10), (before, 0), end=k))
            if seen or k < 400 or ball == 2 * k:
                paths.append(make_path(ball, range(11, 20), (after, 0), start=k))
    table = make_kicks([(2 * k, 2 * k + 1, 0.01 * k, 0) for k in range(440)], np.full(440, 0.38))
    last = measure_losses(paths, table, np.arange(20), 1e-9, 1 / FPS).iloc[-1]
    usual = (0.4**2 - 0.02**2 - 0.38**2) / 2
    assert last["lost_in_contacts"] == pytest.approx(440 * usual, rel=1e-6)
    assert last["lost_in_contacts_std"] == pytest.approx(usual * np.hypot(0.3 * 40, np.sqrt(40)), rel=0.01)


def test_balls_without_a_velocity_may_be_hotter_than_the_others():
    """The temperature of 400 balls, where 100 others are unknown: these may be 0.3 hotter, beside their sampling."""
    velocities = 0.1 * np.random.default_rng(1).standard_normal((400, 2))
    columns = dict(zip(HALVES, [*velocities.T, *velocities.T], strict=True))
    table = pd.DataFrame(columns).assign(frame=0, gain_even=0.0, gain_odd=0.0, gain_common=0.0, unsure=0.0, unknown=100)
    table = table.assign(friction_x=0.0, friction_y=0.0, smoothed=0.0)
    found = measure_temperatures(table, 0.0).iloc[0]
    all_hotter, sampling = 0.3 * 100 / 500, np.sqrt(100) / 500  # v^2/2 scatters by its mean
    assert found["temperature_std"] / found["temperature"] == pytest.approx(np.hypot(all_hotter, sampling), rel=0.02)
