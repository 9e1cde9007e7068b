"""Causes put into tracks of others: a cause has to reach the measurement."""

import json
from dataclasses import replace

import numpy as np
import pytest
from discrepancy_clips import blank

from benchmarks.search import real_causes
from discrepancy.data.launch import MEETS_NOTHING
from discrepancy.fitting.predict import predict_tracks
from synthcam.model import Model


@pytest.mark.parametrize(
    ("speed", "slip", "loss"),
    [(0.5, (0.0, 0.0), 0.0), (0.5, (0.4, 0.0), 0.0), (0.5, (-0.2, 0.3), 0.0), (0.06, (0.0, 0.0), 0.1)],
)
def test_an_acceleration_moves_a_ball_as_a_tilted_plate_does(speed, slip, loss):
    """The balls slide, some across their way, and roll in the end; a slow one is turned, and its loss with it."""
    launch = np.array([0.0, 0.0, 0.0, speed, 0.3, MEETS_NOTHING, *slip, 0.0])
    clip = blank(0, launch, np.zeros(2))
    clip = replace(clip.select(np.flatnonzero(clip.ball == 1)), launch=launch)
    level = Model().replace({"sliding_friction": 0.05, "rolling_drag": 0.0, "rolling_decel": loss})
    push, heading = 0.2, 1.9
    tilt = np.arcsin(push / level.gravity * np.array([np.cos(heading), np.sin(heading)]))
    tilted = level.replace({"plate_tilt.x": tilt[0], "plate_tilt.y": tilt[1]})
    (straight,), (bent,) = (predict_tracks(model, launch[None], [clip]) for model in (level, tilted))
    moved = real_causes.accelerate(replace(clip, xy=straight), push, heading, level).xy - straight
    scale = np.abs(bent - straight).max()
    assert moved == pytest.approx(bent - straight, abs=0.005 * scale)


@pytest.mark.parametrize("drag", [0.0, 1.0])
def test_an_acceleration_on_air_meets_the_loss(drag):
    """With v' = -drag v and a push, the path differs by the closed form, whatever the velocity is."""
    launch = np.array([0.0, 0.0, 0.0, 0.5, 0.3, MEETS_NOTHING, 0.0, 0.0, 0.0])
    clip = blank(0, launch, np.zeros(2))
    clip = replace(clip.select(np.flatnonzero(clip.ball == 1)), launch=launch)
    air = Model().replace({"sliding_friction": 0.0, "rolling_drag": drag, "rolling_decel": 0.0})
    (straight,) = predict_tracks(air, launch[None], [clip])
    moved = real_causes.accelerate(replace(clip, xy=straight), 0.2, 1.9, air).xy - straight
    since = clip.frame / clip.fps
    late = since > 0
    path = (since / drag - (1 - np.exp(-drag * since)) / drag**2) if drag else since**2 / 2
    expected = 0.2 * path[:, None] * [np.cos(1.9), np.sin(1.9)]
    assert late.sum() > 10
    assert moved[late] == pytest.approx(expected[late], abs=1e-3 * np.abs(expected).max())


def test_every_second_clip_of_a_set_has_the_other_times():
    """The sets of a laboratory take every second recording, whose numbers are all even or all odd."""
    clips = [blank(number, np.array([0.0, 0.0, 0.1, 0.5, 0.0, 0.0]), np.zeros(2)) for number in (0, 2, 4, 6)]
    given = real_causes.CausedSet.of("3cushiontool-0", clips).clips
    slowed = [real_causes.slow_half(clip, 0.1).fps / clip.fps for clip in given]
    assert slowed == pytest.approx([1, 1 / 1.1, 1, 1 / 1.1])


def test_a_set_lies_in_the_middle_of_its_picture():
    """About the origin of a table in metres a distortion would lengthen all positions, and bend none."""
    clips = [blank(number, np.array([0.0, 0.0, 0.1, 0.5, 0.0, 0.0]), np.zeros(2)) for number in (0, 1)]
    rng = np.random.default_rng(1)
    clips = [replace(clip, xy=rng.uniform((2.0, 3.0), (2.2, 3.1), clip.xy.shape)) for clip in clips]
    given = real_causes.CausedSet.of("3cushiontool-0", clips).clips
    every = np.concatenate([clip.xy for clip in given])
    assert (every.min(axis=0) + every.max(axis=0)) / 2 == pytest.approx(real_causes.find_centre(clips[0]), abs=1e-12)
    for before, after in zip(clips, given, strict=True):
        assert np.ptp(after.xy - before.xy, axis=0) == pytest.approx(0, abs=1e-12)
        assert after.launch[:2] - before.launch[:2] == pytest.approx(after.xy[0] - before.xy[0])
        assert (after.launch[2:] == before.launch[2:]).all()


def test_the_error_of_a_sets_own_acceleration_is_that_along_the_cause():
    model = Model().replace({"sliding_friction": 0.2})
    cause = next(one for one in real_causes.list_causes(model) if one.name == "acceleration to 110 deg")
    bare = {"own": {"plate_tilt": [1e-3, 0.0]}, "information": {"plate_tilt": [[4e6, 0.0], [0.0, 1e6]]}}
    claim = {"effect": "plate_tilt", "aliases": [], "values": {"plate_tilt.x": -3e-3, "plate_tilt.y": 1e-2}}
    claim["std"] = {"plate_tilt.x": 2e-4, "plate_tilt.y": 2e-4}
    line = real_causes.judge({"claims": [claim], "law": None, "strength": 0.1}, cause, bare)
    along = np.cos(cause.heading), np.sin(cause.heading)
    assert line["own_std"] == pytest.approx(9.81 * np.hypot(5e-4 * along[0], 1e-3 * along[1]))
    assert line["size"] == pytest.approx(9.81 * (-3e-3 * along[0] + 1e-2 * along[1]))
    assert line["z"] == pytest.approx((line["size"] - 9.81e-3 * along[0] - 0.1) / (9.81 * 2e-4))


@pytest.mark.parametrize(("information", "strengths"), [(1e6, [0.175, 0.35]), (4e4, [0.56]), (1e3, [0.03, 0.06])])
def test_strengths_are_limits_or_the_largest_that_the_effect_may_have(information, strengths):
    """A plate tilts by 0.1 rad at most, which on air is 5/7 of 0.1 g or 0.7 m/s^2; 0.8 of it are put in."""
    model = Model().replace({"sliding_friction": 0.0})
    bare = real_causes.CausedSet("TIF083A-0", [], model)
    line = {"information": {"plate_tilt": (information * np.eye(2)).tolist()}, "loss": {"rolling_drag": 0.1}}
    found = list(real_causes.put_causes(bare, line, ("acceleration to 20 ",)))
    assert [one.strength for one in found] == pytest.approx(strengths, rel=0.01)
    if information > 1e3:
        limit = 5 * 5 / 7 * model.gravity / np.sqrt(information)
        assert [one.times for one in found] == pytest.approx([one.strength / limit for one in found])


def test_the_tables_count_what_is_named_and_what_is_false():
    bare = {"set": "3cushiontool-0", "cause": "none", "times": 0.0, "shown": False, "named": False, "false": []}
    bare |= {"strength": 0.0, "verdict": "none", "commit": "abc"}
    tilt = bare | {"cause": "acceleration to 20 deg", "shown": True, "times": 5.0, "strength": 0.2, "std": 0.04}
    tilt |= {"verdict": "named", "named": True, "z": -0.5}
    strong = tilt | {"times": 7.3, "strength": 0.29, "z": 1.5, "false": ["hop"]}
    lens = bare | {"cause": "lens +1", "shown": True, "times": 5.0, "strength": 0.2}
    cut = lens | {"times": 10.0, "strength": 0.4, "cut_short": True, "verdict": "inadequate"}
    locked = lens | {"set": "TIF083A-1", "false": ["pixel_locking"]}
    table = real_causes.render_tables([locked, cut, strong, bare, lens, tilt])
    assert (
        "| billiards 1 | acceleration to 20° | named (0.90, 0.5) | named (1.21, 1.5, 7.3 times), false: hop |" in table
    )
    assert "| billiards 1 | pincushion distortion | nothing named (`none`) | cut short |" in table
    assert "| discs 2 | pincushion distortion | false: pixel_locking |  |" in table
    assert "| billiards, accelerations | 2 | 1 | 2 | 2 | 2 | 1.1 | 1 | 2 |" in table  # sqrt((.5^2 + 1.5^2) / 2)
    assert "| billiards, distortions | 2 | 0 | 2 | 0 |" in table
    assert "| all | 6 | 2 | 5 | 2 | 2 | 1.1 | 1 | 2 |" in table
    assert table.endswith("commits: abc")
    assert table.index("| billiards 1 | none") < table.index("| billiards 1 | acc") < table.index("| billiards 1 | pin")


def test_the_distance_of_a_size_counts_the_error_of_own_that_it_does_not_share():
    """Hausman: simulated means of n numbers, and of the first m, differ by the root of the difference of variances."""
    generator, few, many = np.random.default_rng(5), 4, 100
    noise = generator.standard_normal((20_000, many))
    size, own = noise.mean(axis=1), noise[:, :few].mean(axis=1)
    line = {"std": many**-0.5, "own_std": few**-0.5}
    distances = [real_causes.measure_distance(line | {"z": z}) for z in (size - own) / line["std"]]
    assert np.std(distances) == pytest.approx(1, abs=0.03)
    assert real_causes.measure_distance({"std": 0.1, "own_std": 0.11, "z": 2.0}) == 2.0
    assert real_causes.measure_distance({"std": 0.1, "z": 2.0}) == 2.0
    assert real_causes.measure_distance({"std": 0.1}) is None


def test_a_set_that_was_searched_again_counts_once(tmp_path):
    cut = {"set": "TIF083A-0", "cause": "lens +1", "times": 5.0, "strength": 0.2, "cut_short": True}
    lines = [cut, cut | {"cause": "lens -1"}, cut | {"cut_short": False}]
    (tmp_path / "out.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    found = real_causes.read_lines(tmp_path / "out.jsonl")
    assert [(line["cause"], line["cut_short"]) for line in found] == [("lens +1", False), ("lens -1", True)]
