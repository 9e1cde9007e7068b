"""Tracks in wrong units, and balls that take each other's name."""

import numpy as np
import pytest
from discrepancy_clips import CAMERA

from discrepancy.data.track_checks import detect_wrong_units, find_exchange
from tracker.detection.link import Tracks

DIAMETER = CAMERA.diameter_px


def tracks(one, two):
    """Of two balls with places (n, 2), px."""
    n, xy = len(one), np.concatenate([one, two])
    empty = np.full(2 * n, np.nan)
    return Tracks(
        frame=np.tile(np.arange(n), 2),
        particle=np.repeat([0, 1], n),
        x=xy[:, 0],
        y=xy[:, 1],
        cov=np.tile(1e-4 * np.eye(2), (2 * n, 1, 1)),
        flux=empty,
        flags=np.full(2 * n, ""),
        glint_x=empty,
        glint_y=empty,
    )


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
