"""Contacts of many balls against the events of the simulation, and what each contact and all of them say."""

import functools

import numpy as np
import pytest

import synthcam
import tracker
from tracker.measurement.crowd.contact_table import summarise_contacts

NOISE_PX = 0.05
MARGIN_S = 0.012  # at either end of a film, where paths are too short


@functools.cache
def measured(scene, seed):
    """A clip of true positions with noise, and its result."""
    short = {"timing": {"frames": 120}} if scene == "tray" else {}
    clip, rng = synthcam.Scene.read(scene, **short).draw(seed=seed), np.random.default_rng(seed)
    x, y = (clip.tracks[f"{axis}_mean_px"] + NOISE_PX * rng.standard_normal(len(clip.tracks)) for axis in "xy")
    table = clip.tracks[["frame", "particle"]].assign(x=x, y=y, x_std=NOISE_PX, y_std=NOISE_PX, cov_xy=0.0)
    return clip, tracker.measure(table, clip.camera_json)


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
    ("scene", "seed", "recall"), [pytest.param("crowd", 1, 0.95, marks=pytest.mark.gate), ("tray", 1, 0.75)]
)
def test_contacts_are_those_of_the_simulation(scene, seed, recall):
    clip, result = measured(scene, seed)
    pairs, there, found = pair_up(clip, result.contacts)
    assert len(pairs) >= recall * there
    assert len(pairs) >= 0.9 * found  # precision
    late = np.array([(row["t_s"] - event.t_s, row["t_s_std"]) for event, row in pairs])
    assert np.median(np.abs(late[:, 0])) < 0.0004  # a tenth of a frame
    assert np.median(np.abs(late[:, 0] / late[:, 1])) < 2
    for event, row in pairs:
        if row["kind"] == "ball":
            direction = 1 if row["particle1"] == event.i else -1
            assert direction * (row["nx"] * event.nx + row["ny"] * event.ny) > 0.9 or event.impulse_n < 2e-6


@pytest.mark.gate
def test_each_contact_gives_r_and_all_give_the_mean():
    z = []
    for scene in ("crowd", "tray"):
        clip, result = measured(scene, 1)
        table, truth = result.contacts, clip.model
        assert (result.estimates["status"] == "crowd").all()
        z += ((table.r - truth.restitution) / table.r_std)[table.r_std < 0.2].tolist()
        mean = summarise_contacts(table)["r"]
        assert abs(mean.coefficients[0] - truth.restitution) < 3 * mean.std[0] < 0.15
    assert len(z) > 10
    assert 0.2 < np.sqrt(np.mean(np.square(z))) < 1.6


@pytest.mark.gate
def test_impulses_are_those_of_the_simulation():
    clip, result = measured("crowd", 1)
    ball = clip.model.ball
    mass = ball.density * np.pi * ball.diameter**3 / 6
    pairs, *_ = pair_up(clip, result.contacts)
    off = [
        (row["impulse"] - event.impulse_n / mass) / row["impulse_std"]
        for event, row in pairs
        if row["kind"] == "ball" and np.isfinite(row["impulse"])
    ]
    assert len(off) > 5
    assert np.sqrt(np.mean(np.square(off))) < 2


def test_two_balls_have_no_table_of_contacts():
    _, result = measured("oblique", 1)
    assert result.contacts.empty
