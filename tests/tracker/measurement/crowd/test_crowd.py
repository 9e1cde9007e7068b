"""Contacts of many balls against the events of the simulation, and what each contact and all of them say."""

import functools
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import synthcam
import tracker
from tracker.measurement.crowd import track_contacts
from tracker.measurement.crowd.contact_table import (
    DERIVED,
    derive_with_errors,
    summarise_contacts,
    tabulate_contacts,
)
from tracker.measurement.crowd.crowd_rows import _estimate_in_steps, estimate_contacts
from tracker.measurement.crowd.track_contacts import find_track_contacts
from tracker.measurement.local.descents import run_alone
from tracker.measurement.local.local_estimate import LOCAL_NAMES, LocalEstimate
from tracker.measurement.messages import list_messages
from tracker.measurement.positions import BallTrack, to_ball_tracks
from tracker.settings import FitSettings
from tracker.tables.read import to_pixels
from tracker.tables.table import TrackTable

NOISE_PX = 0.05
MARGIN_S = 0.012  # at either end of a film, where paths are too short


@functools.cache
def measured(scene, seed):
    """A clip of true positions with noise, and its result."""
    short = {"timing": {"frames": 120}} if scene == "tray" else {}
    clip = synthcam.Scene.read(scene, **short).draw(seed=seed)
    return clip, tracker.measure(add_noise(clip, NOISE_PX, seed), clip.camera_json)


def add_noise(clip, noise, seed=1):
    """The true positions of a clip with noise, px."""
    rng = np.random.default_rng(seed)
    x, y = (clip.tracks[f"{axis}_mean_px"] + noise * rng.standard_normal(len(clip.tracks)) for axis in "xy")
    return clip.tracks[["frame", "particle"]].assign(x=x, y=y, x_std=noise, y_std=noise, cov_xy=0.0)


def pair_up(clip, contacts):
    """True events and rows of contacts of the same balls at about the same time, and the number of such events."""
    events = clip.solve().events
    events = events[events.kind.isin(["contact", "wall"])]
    events = events[events.t_s.between(MARGIN_S, clip.frames / clip.camera_json["fps"] - MARGIN_S)]
    pairs, left = [], contacts.to_dict("records")
    for event in events.itertuples():
        own = {event.i, event.j if event.kind == "contact" else -1}
        near = [c for c in left if {c["particle1"], c["particle2"]} == own and abs(c["t_s"] - event.t_s) < 0.008]
        if near:
            best = min(near, key=lambda c: abs(c["t_s"] - event.t_s))
            left.remove(best)
            pairs.append((event, best))
    inside = contacts.t_s.between(MARGIN_S, clip.frames / clip.camera_json["fps"] - MARGIN_S)
    return pairs, len(events), int(inside.sum())


@pytest.mark.parametrize(
    ("scene", "seeds", "recall"), [pytest.param("crowd", (1, 3), 0.95, marks=pytest.mark.gate), ("tray", (1,), 0.75)]
)
def test_contacts_are_those_of_the_simulation(scene, seeds, recall):
    late = list[tuple[float, float]]()
    for seed in seeds:
        clip, result = measured(scene, seed)
        pairs, there, found = pair_up(clip, result.contacts)
        assert len(pairs) >= recall * there
        assert len(pairs) >= 0.9 * found  # precision
        late += [(row["t_s"] - event.t_s, row["t_s_std"]) for event, row in pairs]
        for event, row in pairs:
            if row["kind"] == "ball":
                direction = 1 if row["particle1"] == event.i else -1
                assert direction * (row["nx"] * event.nx + row["ny"] * event.ny) > 0.9 or event.impulse_n < 2e-6
    errors, std = np.array(late).T
    assert np.median(np.abs(errors)) < 0.0003
    z = errors / std
    assert abs(np.median(z)) < 0.6  # without the slides after contacts all times are too early
    assert 0.3 < np.median(np.abs(z)) < 1
    assert np.mean(np.abs(z) < 3) > 0.9  # a wall within a frame of a contact may be missed


@pytest.mark.parametrize("scenes", [("tray",), pytest.param(("crowd", "tray"), marks=pytest.mark.gate)])
def test_each_contact_gives_r_and_all_give_the_mean(scenes):
    z = []
    for scene in scenes:
        clip, result = measured(scene, 1)
        table, truth = result.contacts, clip.model
        assert (result.estimates["status"] == "crowd").all()
        assert set(table["collision"][table["kind"] == "ball"]) == set(result.estimates["collision"])
        z += ((table.r - truth.restitution) / table.r_std)[table.r_std < 0.2].tolist()
        means = summarise_contacts(table, result.rows)
        for name, true in (("r", truth.restitution), ("mu_k", truth.sliding_friction)):
            if name in means:
                mean = means[name]
                assert abs(mean.coefficients[0] - true) < 2.5 * mean.std[0] < 0.15
                assert mean.shared_std[0] > 0.1 * mean.std[0]  # the way in which slides are modelled
    assert len(z) > 5 * len(scenes)
    assert 0.5 < np.sqrt(np.mean(np.square(z))) < 1.5


def test_pucks_glide_by_their_tracks_where_the_camera_file_does_not_say_so():
    """Taken for balls, their mean r is 0.06 too large, and each hit has a friction of a plate."""
    clip = synthcam.Scene.read("pucks").draw(seed=4)
    camera = {key: value for key, value in clip.camera_json.items() if key not in ("body", "support")}
    result = tracker.measure(add_noise(clip, NOISE_PX), camera)
    mean = summarise_contacts(result.contacts, result.rows)["r"]
    assert abs(mean.coefficients[0] - clip.model.restitution) < 3 * mean.std[0] < 0.02
    assert result.contacts["mu_k"].isna().all()
    assert any("bodies glide" in str(note) and "support: air" in str(note) for note in list_messages(result.estimates))
    gas = tracker.observe_gas(result)
    assert abs(gas.values["rolling_loss"] - 0.02 - 0.05 * gas.values["rolling_speed"]) < 0.002
    assert any("support: air" in note for note in gas.notes)
    balls = measured("tray", 1)[1]
    assert not balls.estimates["flags"].str.contains("glide").any()


def test_balls_that_always_slide_from_contact_to_contact_do_not_glide():
    """A dense tray at 4,000 frames a second: its contacts follow one another before slides end."""
    half = 0.0145
    corners = [[-half, -half], [half, -half], [half, half], [-half, half]]
    walls = [
        {"start": a, "end": b, "restitution": 0.8, "friction": 0.2}
        for a, b in zip(corners, corners[1:] + corners[:1], strict=True)
    ]
    clip = synthcam.Scene.read(
        "dense",
        groups=[{"count": 100, "arrangement": "lattice", "size": [0.0264, 0.0264], "rms_speed": 0.08}],
        walls=walls,
        timing={"frames": 60, "fps": 4000, "exposure": 1e-5},
        camera={"size": [300, 300], "scale": 1e-4},
    ).draw(seed=3)
    result = tracker.measure(add_noise(clip, NOISE_PX, 3), clip.camera_json)
    assert np.isfinite(result.estimates["r_local"]).sum() >= 5
    assert not result.estimates["flags"].str.contains("glide").any()


@pytest.mark.gate
def test_impulses_kicks_and_friction_are_those_of_the_simulation():
    clip, _ = measured("crowd", 1)
    ball = clip.model.ball
    mass = ball.density * np.pi * ball.diameter**3 / 6
    films = (measured("crowd", seed) for seed in (1, 3))  # one film has four contacts with a known mu_bb
    pairs = [pair for clip, result in films for pair in pair_up(clip, result.contacts)[0]]
    truths = {
        "impulse": lambda event: event.impulse_n / mass,
        "kick": lambda event: event.impulse_n / mass,
        "mu_bb": lambda event: abs(event.impulse_t) / event.impulse_n,
    }
    for name, truth in truths.items():
        off = [
            (row[name] - truth(event)) / row[f"{name}_std"]
            for event, row in pairs
            if row["kind"] == "ball" and np.isfinite(row[name])
        ]
        assert len(off) > 4
        assert 0.3 < np.sqrt(np.mean(np.square(off))) < 1.7, name


def test_the_friction_of_the_film_makes_slides_known_at_low_noise():
    """Contacts of balls that rolled: the usual friction makes kicks wrong by 3 %."""
    clip = synthcam.Scene.read("crowd", timing={"frames": 60}).draw(seed=1)
    read = to_pixels(TrackTable(add_noise(clip, 0.005)), "truth", clip.camera_json)
    table = tabulate_contacts(read.clips[0][0], read.camera, [])
    mass = clip.model.ball.density * np.pi * clip.model.ball.diameter**3 / 6
    pairs, there, _ = pair_up(clip, table)
    balls = [(event, row) for event, row in pairs if row["kind"] == "ball"]
    kicks = np.array(
        [(row["kick"] / (event.impulse_n / mass) - 1, row["kick_std"] / row["kick"]) for event, row in balls]
    )
    late = np.array([(row["t_s"] - event.t_s, row["t_s_std"]) for event, row in balls])
    assert len(pairs) >= 0.85 * there
    assert np.median(np.abs(kicks[:, 0])) < 0.012
    assert np.median(np.abs(late[:, 0])) < 6e-5
    for off, std in (kicks.T, late.T):
        assert np.mean(np.abs(off) < 2 * std) > 0.8
        z = np.clip(off / std, -3, 3)  # a wall within a frame may be missed
        assert 0.6 < np.sqrt(np.mean(z**2)) < 1.4


def test_the_contacts_with_the_longest_slides_give_the_friction_of_the_film():
    clip = synthcam.Scene.read("crowd", timing={"frames": 24}).draw(seed=3)
    read = to_pixels(TrackTable(add_noise(clip, 0.02)), "truth", clip.camera_json)
    balls = to_ball_tracks(read.clips[0][0], read.camera)
    found = find_track_contacts(balls, read.camera.ball_diameter)
    estimates = estimate_contacts(
        found, balls, read.camera, FitSettings(), min_frictions=1, most_frictions=2, max_friction_error=0.5
    )
    measured = [estimate for _, estimate in estimates if isinstance(estimate, LocalEstimate)]
    own = [estimate for estimate in measured if "mu_k" not in estimate.unseen]
    assert 1 <= len(own) <= 2 < len(measured)
    kicks = [contact.kick for contact in found if len(contact.balls) == 2]
    asked = [k for k, (_, each) in enumerate(estimates) if any(each is one for one in own)]
    assert min(kicks[k] for k in asked) > np.median(kicks)
    friction, r = (LOCAL_NAMES.index(name) for name in ("mu_k", "r"))
    common = {estimate.shared["friction"][0] for estimate in measured}
    assert common == {np.median([estimate.value[friction] for estimate in own])}
    z = [(estimate.value[r] - clip.model.restitution) / estimate.std[r] for estimate in measured]
    assert np.median(np.abs(z)) < 2


@pytest.mark.gate
def test_rounding_changes_no_estimate_of_a_contact():
    """Positions 1e-14 larger once made errors 12 % larger: equal costs, and directions of friction far off."""
    clip = synthcam.Scene.read("crowd", timing={"frames": 24}).draw(seed=1)
    read = to_pixels(TrackTable(add_noise(clip, NOISE_PX)), "truth", clip.camera_json)
    balls = to_ball_tracks(read.clips[0][0], read.camera)
    found = find_track_contacts(balls, read.camera.ball_diameter)
    larger = [replace(ball, position=ball.position * (1 + 1e-14)) for ball in balls]
    one, other = (
        estimate_contacts(found, positions, read.camera, FitSettings(), at_once=at_once)
        for positions, at_once in ((balls, 100), (larger, 1))
    )
    measured = [(a, b) for (_, a), (_, b) in zip(one, other, strict=True) if isinstance(a, LocalEstimate)]
    assert len(measured) > 2
    for a, b in measured:
        off, std = np.abs(b.value - a.value), a.std
        assert (off[std > 0] < 1e-7 * std[std > 0]).all()
        assert b.std == pytest.approx(std, rel=1e-7)


@pytest.mark.gate
def test_a_ball_that_still_slides_from_a_contact_before_makes_no_recoil_too_certain():
    """Four positions of a slide look like a roll, whose velocity is known five times as well."""
    diameter, z = 0.00238, []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        sine = rng.uniform(-0.5, 0.5)
        way = np.array([np.sqrt(1 - sine**2), sine])
        second = way * (diameter + 0.0097) + np.array([-way[1], way[0]]) * rng.uniform(-0.6, 0.6) * diameter
        launches = [
            {"position": [-0.012, 0.0], "velocity": [0.5, 0.0]},
            {"position": [0.0, sine * diameter]},
            {"position": (second + np.array([0.0, sine * diameter])).tolist()},
        ]
        clip = synthcam.Scene.build("chain", launches=launches, timing={"frames": 40}).draw()
        read = to_pixels(TrackTable(add_noise(clip, 0.01, seed)), "truth", clip.camera_json)
        balls = to_ball_tracks(read.clips[0][0], read.camera)
        found = find_track_contacts(balls, read.camera.ball_diameter)
        assert [contact.balls for contact in found] == [(0, 1), (1, 2)]
        estimate = estimate_contacts(found, balls, read.camera, FitSettings())[1][1]
        assert isinstance(estimate, LocalEstimate)
        ratio = LOCAL_NAMES.index("mass_ratio")
        z.append((estimate.value[ratio] - 1) / estimate.std[ratio])
    assert np.sqrt(np.mean(np.square(z))) < 1.8


def test_a_ball_that_chases_another_shows_equal_masses_and_r():
    """The surfaces of both drag one another, so that the chasing ball then slides backwards, against its kick."""
    off = []
    for seed, sine in enumerate((-0.3, 0.1, 0.4)):
        launches = [
            {"position": [0.0, 0.0], "velocity": [0.12, 0.0]},
            {"position": [-0.0066, sine * 0.00238], "velocity": [0.19, 0.0]},
        ]
        clip = synthcam.Scene.build("chase", launches=launches, timing={"frames": 40}).draw()
        read = to_pixels(TrackTable(add_noise(clip, 0.02, seed)), "truth", clip.camera_json)
        balls = to_ball_tracks(read.clips[0][0], read.camera)
        found = find_track_contacts(balls, read.camera.ball_diameter)
        _, estimate = estimate_contacts(found, balls, read.camera, FitSettings())[0]
        assert isinstance(estimate, LocalEstimate)
        for name, truth in (("mass_ratio", 1.0), ("r", clip.model.restitution)):
            k = LOCAL_NAMES.index(name)
            off.append((estimate.value[k] - truth, estimate.std[k]))
    errors, std = np.array(off).T
    assert np.mean(np.abs(errors)) < 0.1
    assert np.sqrt(np.mean((errors / std) ** 2)) < 1.5
    assert std.max() < 0.12


def test_balls_that_both_slide_from_earlier_contacts_show_equal_masses_and_r():
    """Two balls are hit within 30 ms before they meet. Their slips just before follow from those contacts."""
    off = []
    for seed, sine in enumerate((-0.3, 0.0, 0.3)):
        launches = [
            {"position": [-0.0052, -0.0028], "velocity": [0.35, 0.35]},
            {"position": [0.0, 0.0]},
            {"position": [0.0106, sine * 0.00238]},
            {"position": [0.0158, sine * 0.00238 - 0.0028], "velocity": [-0.35, 0.35]},
        ]
        clip = synthcam.Scene.build("chain", launches=launches, timing={"frames": 40, "fps": 500}).draw()
        read = to_pixels(TrackTable(add_noise(clip, 0.02, seed)), "truth", clip.camera_json)
        balls = to_ball_tracks(read.clips[0][0], read.camera)
        found = find_track_contacts(balls, read.camera.ball_diameter)
        assert found[2].balls == (1, 2)
        _, estimate = estimate_contacts(found, balls, read.camera, FitSettings())[2]
        assert isinstance(estimate, LocalEstimate), estimate
        for name, truth in (("mass_ratio", 1.0), ("r", clip.model.restitution)):
            k = LOCAL_NAMES.index(name)
            off.append((estimate.value[k] - truth, estimate.std[k]))
    errors, std = np.array(off).T
    assert np.sqrt(np.mean((errors / std) ** 2)) < 1.5
    assert std.max() < 0.02


def test_a_slide_before_a_contact_ends_as_the_contact_before_says():
    """Five positions of ball 19 fit two slides alike. Without its slip, mu_k was .11 for .23, and r .54 for .90."""
    clip = synthcam.Scene.read("crowd").draw(seed=10)
    table = add_noise(clip, NOISE_PX, 10)
    read = to_pixels(TrackTable(table[table["frame"].between(20, 56)]), "truth", clip.camera_json)
    balls = {ball.particle: ball for ball in to_ball_tracks(read.clips[0][0], read.camera)}
    found = find_track_contacts(list(balls.values()), read.camera.ball_diameter)
    [contact] = [c for c in found if c.balls == (7, 19)]
    _, estimate = run_alone(_estimate_in_steps(contact, found, balls, read.camera, FitSettings()))
    for name, truth in (("mu_k", clip.model.sliding_friction), ("r", clip.model.restitution)):
        k = LOCAL_NAMES.index(name)
        assert abs(estimate.value[k] - truth) < 3 * estimate.std[k] < 0.3, name


def test_a_ball_that_spins_about_the_vertical_speeds_another_up_sideways():
    """The contact gives energy of translation. No film shows such a spin, and no share of a speed is known before."""
    launches = [
        {"position": [0.0, 0.0]},
        {"position": [-0.0066, 0.0003], "velocity": [0.3, 0.0], "spin": 600.0},
        *({"position": [0.005 * k, 0.01], "velocity": [0.01, 0.0]} for k in range(4)),
    ]
    clip = synthcam.Scene.build("spin", launches=launches, timing={"frames": 50}).draw()
    [event] = clip.solve().events.query("kind == 'contact'").itertuples()
    before, after = (clip.solve().at([event.t_s + dt])[["vx", "vy"]].to_numpy() for dt in (-1e-9, 0))
    lost = ((before**2).sum() - (after**2).sum()) / 2
    result = tracker.measure(add_noise(clip, 0.1), clip.camera_json)
    [row] = result.contacts.itertuples()
    assert np.isnan(result.estimates["s_local"]).all()  # its error is too large for a column
    assert abs(row.energy_lost - lost) < 3 * row.energy_lost_std
    assert row.energy_lost + 3 * row.energy_lost_std < 0


def test_a_head_on_contact_costs_what_its_restitution_takes():
    """The share of the tangential speed that they keep is unknown there, and hardly matters."""
    launches = [
        {"position": [0.0, 0.0]},
        {"position": [-0.0066, 0.0], "velocity": [0.3, 0.0]},
        *({"position": [0.005 * k, 0.01], "velocity": [0.01, 0.0]} for k in range(4)),
    ]
    clip = synthcam.Scene.build("head-on", launches=launches, timing={"frames": 50}).draw()
    [event] = clip.solve().events.query("kind == 'contact'").itertuples()
    before, after = ((clip.solve().at([event.t_s + dt])[["vx", "vy"]].to_numpy() ** 2).sum() for dt in (-1e-9, 0))
    [row] = tracker.measure(add_noise(clip, 0.1), clip.camera_json).contacts.itertuples()
    assert abs(row.energy_lost - (before - after) / 2) < 3 * row.energy_lost_std
    assert row.energy_lost_std < 0.2 * (before - after) / 2


def test_contacts_of_one_ball_that_hide_one_another_in_turn_are_all_found():
    """Ball 29 hits 18, then 5, then 10 and 9 within a frame; one of them was lost in every other turn."""
    clip = synthcam.Scene.read("crowd").draw(seed=8)
    table = add_noise(clip, NOISE_PX, 8)
    read = to_pixels(TrackTable(table[table["frame"] < 50]), "truth", clip.camera_json)
    balls = to_ball_tracks(read.clips[0][0], read.camera)
    found = [set(c.balls) for c in find_track_contacts(balls, read.camera.ball_diameter) if c.time < 0.045]
    for other in (18, 5, 10, 9):
        assert {29, other} in found, other
    assert {5} not in found


@pytest.mark.parametrize(
    ("before", "after", "braked"), [(0.012, -0.0096, 0.0), (0.012, 0.0024, 0.0), (0.05, -0.05, 2.0)]
)
def test_only_a_bounce_turns_a_slow_ball_back_at_once(before, after, braked):
    """0.8 of 12 mm/s back at a wall; a loss of speed without a turn; a ball with backspin that friction turns back.

    The change of the first two is less than friction makes within three frames. A fast ball shows the noise.
    """
    fps, noise, at, rng = 250.0, 5e-6, 0.1003, np.random.default_rng(2)
    t, frame = np.arange(60) / fps, np.arange(60)
    since, lasts = np.maximum(t - at, 0), (before - after) / braked if braked else 0.0
    slid = np.clip(t - at + lasts / 2, 0, lasts) if braked else since
    bent = np.minimum(t, at) * before + since * after
    if braked:  # the same velocity before and after, and a deceleration between
        bent = before * t - braked * slid**2 / 2 - (before - after) * np.maximum(t - at - lasts / 2, 0)
    balls = [
        BallTrack(
            particle=k,
            frame=frame,
            start=t,
            position=np.column_stack([x, 0.1 * k + 0 * t]) + noise * rng.standard_normal((60, 2)),
            cov=np.broadcast_to(np.eye(2) * noise**2, (60, 2, 2)),
            exposure=0.0,
        )
        for k, x in enumerate([bent, 0.2 * t])
    ]
    found = find_track_contacts(balls, 0.002, glides=True)
    if after < 0 and not braked:
        [bounce] = found
        assert bounce.balls == (0,)
        assert abs(bounce.time - at) < 3 * bounce.time_std < 0.003
        assert abs(bounce.kick - (before - after)) < 3 * bounce.kick_std
    else:
        assert not found


def test_two_hits_of_the_same_balls_within_three_frames_are_both_found():
    """Balls 37 and 74 hit at frames 8.6 and 11.5."""
    clip = synthcam.Scene.read("cooling", timing={"frames": 20}).draw(seed=4)
    events = clip.solve().events
    own = (events["kind"] == "contact") & events["i"].isin([37, 74]) & events["j"].isin([37, 74])
    read = to_pixels(TrackTable(add_noise(clip, NOISE_PX, 4)), "truth", clip.camera_json)
    balls = to_ball_tracks(read.clips[0][0], read.camera)
    found = find_track_contacts(balls, read.camera.ball_diameter)
    times = sorted(c.time for c in found if set(c.balls) == {37, 74})
    true = events["t_s"][own & (events["t_s"] < 19 / 250)].to_numpy()
    assert len(true) == 2
    np.testing.assert_allclose(times, true, atol=1e-3)


def test_errors_of_derived_values_are_those_of_draws():
    """Correlated errors of v0, b, r and s: the energy that is lost has the mean and scatter of draws."""
    value, std = np.array([0.2, -0.3, 0.9, 0.8]), np.array([0.01, 0.03, 0.08, 0.1])
    correlation = np.eye(4)
    correlation[0, 2] = correlation[2, 0] = -0.8  # a larger speed of approach makes r smaller
    cov = correlation * np.outer(std, std)
    draws = np.random.default_rng(1).multivariate_normal(value, cov, 4000)
    along, across = draws[:, 0] * np.sqrt(1 - draws[:, 1] ** 2), draws[:, 0] * draws[:, 1]
    r, s = draws[:, 2], draws[:, 3]
    lost = ((1 - r**2) * along**2 + (1 - s**2) * across**2) / 4
    found = dict(zip(DERIVED, zip(*derive_with_errors(value, cov), strict=True), strict=True))
    true = ((1 - 0.81) * 0.2**2 * 0.91 + (1 - 0.64) * 0.2**2 * 0.09) / 4
    bias = lost.mean() - true
    assert found["energy_lost"][0] == pytest.approx(true - bias, abs=0.1 * abs(bias) + 3 * lost.std() / 4000**0.5)
    for name, drawn in (("energy_lost", lost), ("impulse", (1 + r) * along / 2), ("v_t", across)):
        assert found[name][1] == pytest.approx(drawn.std(), rel=0.05), name
    assert found["v_t"][0] == pytest.approx(0.06, rel=0.01)


@pytest.mark.parametrize("b", [0.3, 0.02, 0.001])
def test_spins_that_drive_balls_apart_count_in_the_energy_also_head_on(b):
    """The tangential speed afterwards is that of the spins: s is 1 to 300, and its error as large."""
    v0, r, after = 0.06, 0.9, 0.018
    value, std = np.array([v0, b, r, after]), np.array([4e-4, 0.01, 0.01, 4e-4])
    by_s = np.eye(4)
    s = after / (v0 * b)
    by_s[3] = -s / v0, -s / b, 0.0, s / after
    found = derive_with_errors(np.append(value[:3], s), by_s @ np.diag(std**2) @ by_s.T)
    draws = np.random.default_rng(1).normal(value, std, (4000, 4))
    lost = ((1 - draws[:, 2] ** 2) * draws[:, 0] ** 2 * (1 - draws[:, 1] ** 2) + (draws[:, 0] * draws[:, 1]) ** 2) / 4
    lost -= draws[:, 3] ** 2 / 4
    energy, error = (each[DERIVED.index("energy_lost")] for each in found)
    true = ((1 - r**2) * v0**2 * (1 - b**2) + (v0 * b) ** 2 - after**2) / 4
    assert abs(energy - true) < 0.1 * error
    assert error == pytest.approx(lost.std(), rel=0.05)


def test_contacts_are_the_same_however_few_are_fitted_at_once(monkeypatch):
    """All at once, a long film of a crowd would need gigabytes."""
    clip, numbers = synthcam.Scene.read("tray", timing={"frames": 30}).draw(seed=1), []
    read = to_pixels(TrackTable(add_noise(clip, NOISE_PX)), "truth", clip.camera_json)
    balls = to_ball_tracks(read.clips[0][0], read.camera)

    def find():
        found = find_track_contacts(balls, read.camera.ball_diameter)
        return pd.DataFrame([(each.one, each.other, each.time, each.time_std) for each in found])

    def gather(candidates, *given, gather=track_contacts.gather_gaps):
        numbers.append(len(candidates))
        return gather(candidates, *given)

    monkeypatch.setattr(track_contacts, "gather_gaps", gather)
    expected, most = find(), max(numbers)
    monkeypatch.setitem(track_contacts._examine.__kwdefaults__, "at_once", 2)
    numbers.clear()
    pd.testing.assert_frame_equal(find(), expected, rtol=1e-9)
    assert len(expected) > 3
    assert max(numbers) <= 2 < most


def test_two_balls_have_no_table_of_contacts():
    _, result = measured("oblique", 1)
    assert result.contacts.empty
