"""Checks of tracks before a fit: wrong units, exchanged balls, and positions of another ball."""

import dataclasses

import numpy as np
import pytest
from discrepancy_clips import CAMERA, collisions

from discrepancy.data.track_checks import detect_wrong_units, find_exchange, remove_strays
from synthcam.model import Model
from tracker.detection.link import Tracks

DIAMETER = CAMERA.diameter_px
CLIPS = collisions(Model(), 6, 5)


def tracks_of(particle, frame, xy):
    """Tracks of balls at positions xy (n, 2), px."""
    unseen, cov = np.full(len(xy), np.nan), np.tile(1e-4 * np.eye(2), (len(xy), 1, 1))
    return Tracks(frame, particle, *xy.T.copy(), cov, unseen, np.full(len(xy), ""), unseen, unseen)


def tracks(one, two):
    """Make the tracks of two balls at positions (n, 2), px."""
    return tracks_of(np.repeat([0, 1], len(one)), np.tile(np.arange(len(one)), 2), np.concatenate([one, two]))


def tracks_of_clip(clip):
    height = np.full((len(clip.xy), 1), CAMERA.radius)
    return tracks_of(clip.ball, clip.frame, CAMERA.project(np.concatenate([clip.xy, height], axis=1)))


def head_on(step, frames=40):
    """A ball that rests and one that comes by `step` diameters a frame, meets it and stops: the first goes on."""
    k = np.arange(frames)[:, None] - frames / 2 + 0.3
    way = DIAMETER * step * k * [1.0, 0.0] + [300.0, 200.0]
    rest = np.broadcast_to([300.0, 200.0], way.shape)
    target = np.add(np.where(k < 0, rest, way), [DIAMETER, 0])
    return target, np.where(k < 0, way, rest)


@pytest.mark.parametrize("step", [0.05, 0.5, 1.0, 1.5])
def test_a_collision_is_no_exchange(step):
    assert find_exchange(tracks(*head_on(step)), CAMERA) is None


@pytest.mark.parametrize("frame", [1, 15, 20, 30, 39])
@pytest.mark.parametrize("step", [0.05, 0.5, 1.0])
def test_an_exchange_is_found_where_it_is(frame, step):
    one, two = head_on(step)
    late = np.arange(len(one))[:, None] >= frame
    assert find_exchange(tracks(np.where(late, two, one), np.where(late, one, two)), CAMERA) == frame


def test_one_ball_alone_is_no_exchange():
    one, _ = head_on(0.5)
    alone = tracks(one, one)
    first = alone.particle == 0
    fields = {k: v[first] for k, v in vars(alone).items()}
    assert find_exchange(Tracks(**fields), CAMERA) is None
    assert detect_wrong_units([(Tracks(**fields), CAMERA)]) is None


@pytest.mark.parametrize(("unit", "metre"), [("m", 1), ("cm", 1e2), ("mm", 1e3), ("um", 1e6)])
def test_units_are_told_from_balls_that_touch(unit, metre):
    one, two = head_on(0.3)
    factor = CAMERA.scale * metre
    said = detect_wrong_units([(tracks(factor * one, factor * two), CAMERA)] * 3)
    assert said.startswith(f"the positions look like {unit}: the balls come as near as")
    assert detect_wrong_units([(tracks(one, two), CAMERA)] * 3) is None


def test_balls_within_each_other_are_of_no_known_unit():
    one, two = head_on(0.3)
    said = detect_wrong_units([(tracks(0.4 * one, 0.4 * two), CAMERA)])
    assert said == "the balls come as near as 6.49; expected px, and 14.9 of them, a diameter"


@pytest.mark.parametrize(("lost", "told"), [(0, True), (2, True), (4, False), (6, False)])
def test_an_exchange_is_told_where_both_balls_are_seen_again_within_three_frames(lost, told):
    one, two = head_on(0.5)
    late = np.arange(len(one))[:, None] >= 30
    whole = tracks(np.where(late, two, one), np.where(late, one, two))
    seen = ~((whole.frame >= 30 - lost) & (whole.frame < 30))
    clip = Tracks(**{k: v[seen] for k, v in vars(whole).items()})
    assert find_exchange(clip, CAMERA) == (30 if told else None)


@pytest.mark.parametrize(("nearest", "pixels"), [(0.7, False), (0.9, True), (22.0, True), (44.0, False)])
def test_balls_of_which_the_nearest_places_are_no_diameter_apart_are_doubted(nearest, pixels):
    """In diameters: nearer than .8, as no balls are, or never nearer than 30."""
    along = np.linspace(0, 1, 40)[:, None] * [0.0, 100.0]
    beside = along + np.array([nearest * DIAMETER, 0])
    assert (detect_wrong_units([(tracks(along, beside), CAMERA)] * 3) is None) is pixels


@pytest.mark.parametrize(("share", "pixels"), [(1.4, True), (2.8, False)])
def test_tracks_beyond_twice_the_picture_are_doubted(share, pixels):
    one, two = head_on(0.3)
    off = np.array([share * max(CAMERA.size) - max(one.max(), two.max()), 0])
    assert (detect_wrong_units([(tracks(one + off, two + off), CAMERA)] * 3) is None) is pixels


@pytest.mark.parametrize(("factor", "unit"), [(1.22, True), (0.82, True), (1.55, False), (0.65, False)])
def test_a_unit_is_told_where_the_nearest_places_are_a_diameter_apart_within_a_third(factor, unit):
    """In cm; a diameter is .238."""
    one, two = (100 * CAMERA.scale * factor * places for places in head_on(0.3))
    said = detect_wrong_units([(tracks(one, two), CAMERA)])
    assert said.startswith("the positions look like cm: ") is unit


def test_a_hit_is_no_stray():
    for clip in CLIPS:
        tracks = tracks_of_clip(clip)
        assert remove_strays(tracks, CAMERA)[0] is tracks


def test_a_gap_is_no_stray():
    for clip in CLIPS:
        tracks = tracks_of_clip(clip.select(np.flatnonzero(clip.frame % 7 != 3)))
        assert remove_strays(tracks, CAMERA)[1] == []


@pytest.mark.parametrize("count", [1, 3, 8])
@pytest.mark.parametrize("far", [1.2, 2.5])
def test_another_ball_is_taken_out_and_no_more(count, far):
    for clip in CLIPS:
        tracks, first = tracks_of_clip(clip), int(clip.launch[2] * clip.fps) + 12
        taken = (tracks.particle == 1) & (tracks.frame >= first) & (tracks.frame < first + count)
        moved = dataclasses.replace(tracks, x=tracks.x + far * CAMERA.diameter_px * taken)
        left, frames = remove_strays(moved, CAMERA)
        assert frames == list(range(first, first + count))
        np.testing.assert_array_equal(left.xy, tracks.xy[~taken])


def test_a_ball_that_is_changed_for_good_is_left():
    tracks = tracks_of_clip(CLIPS[0])
    late = (tracks.particle == 1) & (tracks.frame >= 50)
    moved = dataclasses.replace(tracks, x=tracks.x + 3 * CAMERA.diameter_px * late)
    assert remove_strays(moved, CAMERA)[1] == []
