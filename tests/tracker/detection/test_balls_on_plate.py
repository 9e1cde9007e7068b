"""Balls on a plate of one colour: counted alone, in a rack, beside a rail and beside a hand; tracked from a rack."""

import json

import numpy as np
import pandas as pd
import pytest
import tifffile
from tracker_colours import GREEN, draw, hand
from tracker_discs import CAMERA, R, apart, film

import tracker
from tracker import pipeline
from tracker.calibration.calibrate import calibrate, keys_from_options
from tracker.camera.colour_planes import PLATE, read_plane
from tracker.detection.balls_on_plate import count_balls_on_plate

COLOURS = (
    (235.0, 235.0, 225.0), (225.0, 170.0, 30.0), ((30.0, 50.0, 160.0), (230.0, 230.0, 215.0)), (30.0, 50.0, 160.0),
    (190.0, 40.0, 60.0), (25.0, 25.0, 25.0),
)  # fmt: skip
FRAMES = 30


def break_of_five(frames=FRAMES, hit=12):
    """Places (6, frames, 2) of a striker and of a group of five that touch, two of which a hit drives away."""
    time = np.arange(frames)
    late = np.maximum(time - hit, 0)[:, None]
    group = np.array([100.4, 80.3]) + 2 * R * np.array([[0, 0], [0.87, 0.5], [0.87, -0.5], [1.74, 0.0], [1.74, 1.0]])
    ways = np.repeat(group[:, None], frames, axis=1)
    ways[2] += late * [1.0, -2.2]
    ways[4] += late * [1.6, 1.2]
    striker = group[0] - [2 * R, 0] + np.minimum(time - hit, 0)[:, None] * [5.0, 0] - 0.6 * late * [1.0, 0.4]
    return np.concatenate([striker[None], ways])


def rail(k):
    """A wooden rail along the lower side, which never moves."""
    cover = np.zeros((160, 200))
    cover[148:] = 1.0
    return cover


def read(pictures):
    make = read_plane(PLATE, lambda: pictures[::3], 255.0)
    return [make(picture) for picture in pictures[::2]]


@pytest.mark.parametrize("people", [(), ((rail, (120.0, 70.0, 30.0)),)])
def test_balls_of_a_rack_are_counted_in_each_picture(people):
    found = count_balls_on_plate(read(draw(break_of_five(), COLOURS, shadow=False, people=people)), 2 * R)
    assert set(found.counts) == {6}
    assert found.are_all


def test_balls_beside_a_hand_are_not_all():
    pictures = draw(break_of_five(), COLOURS, people=((hand, (205.0, 155.0, 130.0)),))
    assert not count_balls_on_plate(read(pictures), 2 * R).are_all


def test_one_ball_alone_does_not_ask_for_the_plane():
    found = count_balls_on_plate(read(draw(break_of_five()[:1], COLOURS[:1], shadow=False)), 2 * R)
    assert set(found.counts) == {1}
    assert not found.are_all


def test_no_ball_counts_where_none_moves():
    """What rests in all pictures counts for nothing."""
    ways = np.repeat(break_of_five()[:, :1], 9, axis=1)
    assert count_balls_on_plate(read(draw(ways, COLOURS, shadow=False)), 2 * R).total == 0


def test_all_balls_of_a_rack_have_one_track_from_first_to_last_frame():
    """Three of them never move, and one of these is black. Differences of two colours show none of the three."""
    ways = break_of_five()
    result = tracker.track(draw(ways, COLOURS, GREEN), CAMERA)
    assert any(str(note).startswith("channel: plate, ") for note in result.notes)
    assert result.tracks.groupby("particle").size().tolist() == [FRAMES] * 6
    at = result.tracks[["x", "y"]].to_numpy()
    away = np.hypot(*np.moveaxis(ways[:, result.tracks["frame"]] - at, -1, 0))
    assert away.min(axis=0).max() < 1.5  # px
    nearest = result.tracks.assign(ball=away.argmin(axis=0)).groupby("particle")["ball"].nunique()
    assert (nearest == 1).all()


def test_the_bright_side_of_balls_does_not_shift_them():
    """The plane enlarges the side that differs more from the plate by more."""
    lit = tuple(
        (tuple(0.25 * level for level in colour), colour) for colour in COLOURS[:2] + COLOURS[3:5] + COLOURS[:2]
    )
    ways = break_of_five(24)
    result = tracker.track(draw(ways, lit, GREEN, shadow=False), CAMERA, channel=PLATE)
    off = result.tracks[["x", "y"]].to_numpy() - ways[:, result.tracks["frame"]]
    nearest = off[np.hypot(*np.moveaxis(off, -1, 0)).argmin(axis=0), np.arange(off.shape[1])]
    assert abs(nearest[:, 0].mean()) < 0.2  # px


@pytest.mark.usefixtures("undrawn")
def test_each_clip_in_colour_chooses_its_plane_after_a_first_clip_in_grey(tmp_path):
    ways = break_of_five()
    clips = [film(np.random.default_rng(0), apart(FRAMES)), draw(ways, COLOURS, GREEN)]
    for number, pictures in enumerate(clips):
        folder = tmp_path / f"set/clips/{number:06d}"
        folder.mkdir(parents=True)
        tifffile.imwrite(folder / "frames.tif", pictures)
        (folder / "camera.json").write_text(json.dumps(CAMERA))
    outcome = pipeline.run(tmp_path / "set", tmp_path / "out", None, 1)
    balls = [
        pd.read_parquet(tmp_path / f"out/clips/{number:06d}/tracks.parquet")["particle"].nunique() for number in (0, 1)
    ]
    assert balls == [2, 6]
    (said,) = (note for note in outcome.notes if "plate" in str(note))
    assert said.clip == 1
    assert "channel" not in json.loads((tmp_path / "out/run.json").read_text())


def test_a_region_keeps_the_planes_that_do_not_depend_on_the_whole_picture():
    """A floor of another colour covers most of the picture, so that the plane would be that of the floor."""
    ways, floor = break_of_five(), 120  # px, to each side
    pictures = draw(ways, COLOURS, GREEN, shadow=False)
    around = np.random.default_rng(0).normal([150, 100, 60], 2, (FRAMES, 160 + 2 * floor, 200 + 2 * floor, 3))
    around[:, floor:-floor, floor:-floor] = pictures
    camera = {**CAMERA, "size": [200 + 2 * floor, 160 + 2 * floor]}
    region = f"{floor},{floor},{floor + 199},{floor + 159}"
    result = tracker.track(around.astype(np.uint8), camera, region=region)
    assert not any(str(note).startswith("channel: plate, ") for note in result.notes)
    assert max(result.tracks.groupby("particle").size()) == FRAMES


@pytest.mark.filterwarnings("error")
def test_a_plate_without_balls_has_no_contrast():
    """Neither the survey nor the search divides by it."""
    cloth = draw(break_of_five()[:0], (), GREEN, shadow=False)
    assert len(tracker.track(cloth, CAMERA, channel=PLATE, detector="discs").tracks) == 0


def test_the_outlines_of_the_plane_give_the_scale_within_its_error(tmp_path):
    """The plane enlarges balls by a pixel or two. Without a correction the scale is off by 14 %."""
    tifffile.imwrite(tmp_path / "film.tif", draw(break_of_five(40), COLOURS, GREEN, shadow=False))
    found = calibrate(tmp_path / "film.tif", keys_from_options(CAMERA["ball_diameter"], CAMERA["fps"]))
    scale, std = found.ways["outline"]
    assert abs(scale - CAMERA["scale"]) < 2 * std < 0.15 * CAMERA["scale"]
