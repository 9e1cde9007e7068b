"""Crowds: what the truth itself scores, and how contacts and the temperature of worse tracks are counted."""

from functools import cache

import numpy as np
import pandas as pd
import pytest

from synthcam import Scene
from tracker.benchmark.judging.crowds import count_contacts, judge_crowd, list_true_contacts, summarise_crowds
from tracker.benchmark.judging.tracker_results import TrackerResults
from tracker.benchmark.suite.definition import SuitePart
from tracker.camera.camera import Camera

FPS, FRAMES = 250.0, 60
PART = SuitePart("tray", "tray", "tray", (0,))


class Tray:
    """Twelve balls in a tray, with the events of their simulation."""

    def __init__(self):
        clip = Scene.read("tray", timing={"frames": FRAMES}).draw(seed=1)
        self.table = clip.tracks.assign(xx=4e-4, xy=0.0, yy=4e-4)
        self.hits = clip.solve().events
        self.json = clip.camera_json

    def camera(self, film, clip):
        return Camera.from_dict(self.json)

    def tracks(self, film, clip):
        return self.table

    def events(self, film, clip):
        return self.hits


@cache
def tray():
    return Tray()


@cache
def judge_truth():
    return judge()


def judge(change=lambda table: table):
    """Scores of the true tracks, changed, with the noise of their bound."""
    suite = tray()
    seen = suite.table[suite.table["visible"]].reset_index(drop=True)
    x, y = seen[["x_mean_px", "y_mean_px"]].to_numpy().T + 0.02 * np.random.default_rng(1).standard_normal(
        (2, len(seen))
    )
    table = seen[["frame", "particle"]].assign(x=x, y=y, x_std=0.02, y_std=0.02, cov_xy=0.0)
    return judge_crowd(suite, TrackerResults(lambda film, clip: (change(table), [])), PART)


def test_true_tracks_show_the_identities_contacts_and_temperature():
    found = judge_truth()
    assert (found["hota"], found["idf1"], found["mota"], found["swaps"]) == pytest.approx((1, 1, 1, 0), abs=0.02)
    assert found["ratio"] == pytest.approx(1.0, abs=0.1)
    assert found["contacts"] > 15
    assert found["contacts_found"] > 0.7
    assert found["contacts_false"] < 0.2
    assert found["temperature_error"] < 0.05


def test_an_exchange_of_identities_costs_hota_but_no_contacts_elsewhere():
    """Numbers that all balls exchange in frame 30, where the paths themselves go on."""

    def exchange(table):
        late = table["frame"] >= 30
        return table.assign(particle=np.where(late, (table["particle"] + 5) % 12, table["particle"]))

    before, after = judge_truth(), judge(exchange)
    assert after["hota"] < 0.8 < before["hota"]
    assert after["contacts_found"] < before["contacts_found"]  # those next to the exchange
    assert after["contacts_found"] > 0.3


def test_paths_that_are_a_tenth_too_long_are_a_fifth_too_hot():
    def stretch(table):
        return table.assign(x=160 + 1.1 * (table["x"] - 160), y=120 + 1.1 * (table["y"] - 120))

    assert judge(stretch)["temperature_error"] == pytest.approx(0.21, abs=0.05)


def test_without_three_tracks_there_is_no_temperature_and_no_contact():
    found = judge(lambda table: table[table["particle"] < 2])
    assert np.isnan(found["temperature_error"])
    assert found["contacts_found"] == 0
    assert np.isnan(found["contacts_false"])  # none is shown


def test_a_crowd_that_was_not_run_counts_as_nothing_found():
    run = {"hota": 0.9, "contacts_found": 0.6, "temperature_error": 0.1}
    lost = {"hota": 0.0, "contacts_found": None, "temperature_error": 80.0}
    whole = summarise_crowds({"one": run, "two": lost, "three": run})
    assert (whole["hota"], whole["contacts_found"], whole["temperature_error"]) == pytest.approx((0.6, 0.4, 0.1))
    assert summarise_crowds({"one": run, "two": None, "three": None})["temperature_error"] is None
    assert summarise_crowds({"one": run, "two": None, "three": None})["hota"] == pytest.approx(0.3)
    assert set(summarise_crowds({}).values()) == {None}


def test_contacts_are_counted_by_hand():
    """Six true contacts, one at an end and one weak; tracks show two of the four others, and three that are none."""
    true = pd.DataFrame(
        [
            (1.0, 0, 1, 5.0),
            (10.0, 0, 1, 5.0),
            (20.0, 2, 3, 5.0),
            (30.0, 2, -1, 5.0),
            (40.0, 4, 5, 0.01),
            (50.0, 4, 5, 5.0),
        ],
        columns=["t_s", "one", "other", "kick"],
    )
    shown = pd.DataFrame(
        [
            (1.0, 0, 1),  # at the end
            (11.5, 1, 0),  # found
            (13.0, 0, 1),  # a second one of the same contact
            (20.0, 2, 4),  # with another ball
            (31.9, 2, -1),  # found, at a wall
            (40.5, 5, 4),  # weak
            (53.0, 4, 5),  # too late
        ],
        columns=["t_s", "one", "other"],
    )
    assert count_contacts(true, shown, fps=1.0, frames=60).tolist() == [4, 2, 5, 3]


def test_the_kick_of_a_contact_is_the_change_of_velocity_along_its_normal():
    """A ball at 0.3 m/s gives 0.2 m/s of it to another one; a third one leaves the picture as it meets a wall."""
    rows = [
        {"particle": ball, "frame": k, "t_s": k / FPS, "vx": vx[k >= 2], "vy": 0.05, "visible": visible}
        for ball, vx, visible in ((0, (0.3, 0.1), True), (1, (0.0, 0.2), True), (2, (0.4, -0.4), False))
        for k in range(4)
    ]
    events = pd.DataFrame(
        {
            "t_s": [1.5 / FPS, 1.6 / FPS, 1.7 / FPS],
            "kind": ["contact", "wall", "landing"],
            "i": [0, 2, 0],
            "j": [1, 3, -1],
            "nx": [1.0, -1.0, 0.0],
            "ny": [0.0, 0.0, 0.0],
        }
    )
    found = list_true_contacts(pd.DataFrame(rows), events, Camera.from_dict(tray().json))
    assert found[["one", "other"]].to_numpy().tolist() == [[0, 1], [2, -1]]
    scale = tray().json["scale"]
    assert found["kick"].to_numpy() == pytest.approx([0.2 / FPS / scale, 0.0])
