"""Hostile worlds: what is done to tracks is what is said, and the judge keeps to its rules."""

import json

import numpy as np
import pytest
from blind_boxes import line, truth_of

from benchmarks.search.sealed import boxes, evidence, worlds
from benchmarks.search.sealed.judge import judge
from benchmarks.search.sealed.worlds import WORLDS

RNG = np.random.default_rng(2)


def table(name, **numbers):
    world = {"name": name} | WORLDS[name](RNG) | numbers
    truth = truth_of({}, clips=3, world=json.loads(json.dumps(world)))
    clips = boxes.clips_of(truth)
    rng = np.random.default_rng(1)
    return truth, [evidence._tracks(truth, clip, boxes.camera_of(truth), rng) for clip in clips]


@pytest.mark.parametrize("name", WORLDS)
def test_every_world_has_tracks_of_both_balls(name):
    for rows in table(name)[1]:
        assert {0, 1} <= set(rows["particle"])
        assert np.isfinite(rows[["x", "y"]].to_numpy()).all()


def test_rounded_places_lie_on_the_grid():
    for rows in table("quantised", step=0.25)[1]:
        np.testing.assert_array_equal(rows["x"] * 4 % 1, 0)


def test_a_third_ball_passes_and_touches_neither():
    for rows in table("third_passes", passes=1.0)[1]:
        third = rows[rows["particle"] == 2]
        for ball in (0, 1):
            both = third.merge(rows[rows["particle"] == ball], on="frame")
            assert np.hypot(both["x_x"] - both["x_y"], both["y_x"] - both["y_y"]).min() > worlds.DIAMETER


def test_a_ball_that_is_taken_for_another_jumps():
    for rows in table("third_taken", passes=1.0, taken=4)[1]:
        jumps = [np.hypot(*np.diff(rows.loc[rows["particle"] == b, ["x", "y"]].to_numpy(), axis=0).T) for b in (0, 1)]
        assert jumps[0].max() < 0.6 / 250 / 1.6e-4 + 1
        assert jumps[1].max() > 1.1 * worlds.DIAMETER


def test_uneven_times_are_those_of_the_places():
    """A ball that rolls before the hit is where its speed takes it at the times that are told."""
    truth, tables = table("uneven", by=0.4, share=1.0)
    for clip, rows in zip(boxes.clips_of(truth), tables, strict=True):
        striker = rows[(rows["particle"] == 1) & (rows["t_s"] < clip.launch.time - 0.005)]
        assert np.ptp(striker["t_s"] * 250 - striker["frame"]) > 0.3
        fits = [np.polyfit(t, striker["x"], 2, full=True)[1][0] for t in (striker["t_s"], striker["frame"])]
        assert fits[0] < fits[1] / 5


def test_strikers_slide_as_their_launch_says():
    truth = truth_of({}, clips=3, world={"name": "strikers_slide", "slip": 0.3, "side": 0.3})
    assert [len(boxes.launch_of(clip)) for clip in boxes.clips_of(truth)] == [9, 9, 9]
    assert len(boxes.launch_of(boxes.clips_of(truth_of({}))[0])) == 6


def judged(world, effects, named, verdict, **more):
    entry = line(effects, named, verdict=verdict, kind="hostile", world={"name": world} | more)
    return judge(entry | {"answer": entry["answer"] | {"gap": {}}})


def test_the_judge_of_hostile_worlds():
    assert judged("smoothed", [], [], "none").right
    assert judged("smoothed", [], [], "inadequate").right
    assert judged("smoothed", [], [], "outside_library").false
    assert judged("gaps", [], ["plate_tilt"], "named").false == ("plate_tilt",)
    assert judged("gaps", ["plate_tilt"], ["plate_tilt"], "named").right
    assert not judged("gaps", ["plate_tilt"], [], "inadequate").right
    assert not judged("gaps", ["plate_tilt"], [], "inadequate").false
    assert judged("friction_of_clip", ["friction_of_clip"], [], "outside_library").right
    assert not judged("friction_of_clip", ["friction_of_clip"], [], "none").right
    both = ["plate_tilt", "friction_of_clip"]
    assert judged("friction_of_clip", both, ["plate_tilt"], "outside_library").right
    assert not judged("friction_of_clip", both, [], "outside_library").right
    assert judged("two_laws", ["plate_tilt", "dent"], [], "outside_library").right
    assert judged("quantised", ["plate_tilt"], ["plate_tilt", "pixel_locking"], "named", step=1.0).right
    assert judged("quantised", [], ["pixel_locking"], "named", step=0.5).false
