"""The picture of a film that failed: what was found and refused in one frame, each with its reason."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from tracker_discs import SIZE, disc

from tracker.camera.camera import Camera
from tracker.camera.film_in_memory import wrap_frames
from tracker.camera.recordings import Recording
from tracker.detection.glints import Glints
from tracker.detection.link import Tracks
from tracker.measurement.collision.adequacy import NO_SCALE, ONE_BALL
from tracker.report.refusals import REFUSALS, draw_refusals, is_refused_clip

NO_TRACKS = Tracks(*(np.empty(0, int),) * 2, *(np.empty(0),) * 2, np.empty((0, 2, 2)), np.empty(0), np.empty(0, str),
                   np.empty(0), np.empty(0))  # fmt: skip
ABOVE = np.arange(160)[:, None] + np.zeros((1, 200)) < 40
CAMERA = {"size": [200, 160], "fps": 60.0, "scale": 1e-3, "ball_diameter": 18e-3}


def bar(k):
    out = np.zeros(SIZE)
    out[70:76, 20 + 5 * k : 90 + 5 * k] = 1
    return out


def clip(shape, light=200.0, area=None):
    rng = np.random.default_rng(0)
    counts = np.array([80 + (light - 80) * shape(k) + rng.normal(0, 1, SIZE) for k in range(9)])
    pictures = np.clip(counts, 0, 255).astype(np.uint8)
    return Recording(4, Camera.from_dict(CAMERA), wrap_frames(pictures), area=area)


@pytest.mark.parametrize(("film", "reason"), [
    (clip(bar), "not round"),
    (clip(lambda k: disc((40 + 15 * k, 80), 20)), "too large"),
    (clip(lambda k: disc((40 + 15 * k, 80), 5)), "too small"),
    (clip(lambda k: disc((30 + 15 * k, 0), 9)), "cut by the rim"),
    (clip(lambda k: disc((30 + 15 * k, 80), 9), 20.0), "darker than the ground"),
    (clip(lambda k: disc((30 + 15 * k, 80), 9), area=ABOVE), "outside the region"),
])  # fmt: skip
def test_each_refused_thing_has_its_reason(film, reason):
    drawn = draw_refusals(film, NO_TRACKS)
    assert f"{reason})" in str(drawn.note) or f"1 {reason}" in str(drawn.note)
    count = 2 if reason == "not round" else 1  # the bar, and the ground that it uncovers
    assert f"0 balls followed, {count} object{'s' * (count > 1)} refused" in str(drawn.note)
    assert "--ball X,Y@" in str(drawn.note)
    picture = cv2.imdecode(np.frombuffer(drawn.png, np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (640, 800, 3)
    assert (np.abs(picture.astype(int) - (60, 80, 255)).sum(axis=2) < 40).sum() > 50  # a red box


def test_what_was_found_and_not_followed_is_not_refused_for_its_shape():
    """The status of a film without a path counts its detections: the picture of it must not deny them."""
    film = clip(lambda k: disc((30 + 15 * k, 0), 9))
    found = Glints.at(30.0 + 15 * np.arange(9), np.zeros(9), 0.1)
    note = str(draw_refusals(film, NO_TRACKS, replace(found, frame=np.arange(9))).note)
    assert "0 balls followed, 1 object refused (1 found, but its steps are those of no ball)" in note


@pytest.mark.parametrize("followed", [False, True])
def test_darkness_is_no_reason_where_dark_bodies_are_followed(followed):
    """Two dark discs, one of them followed in the first five frames only."""
    film = clip(lambda k: disc((30 + 15 * k, 40), 9) + disc((30 + 15 * k, 120), 9), 20.0)
    places = np.array([(30 + 15 * k, 40) for k in range(5)], dtype=float)
    frames, one, some = np.arange(5), np.zeros(5, int), np.full(5, np.pi * 81)
    cov, blank = np.tile(0.01 * np.eye(2), (5, 1, 1)), np.full(5, "")
    tracks = Tracks(frames, one, *places.T, cov, some, blank, *places.T) if followed else NO_TRACKS
    note = str(draw_refusals(film, tracks).note)
    assert ("darker than the ground" in note) is not followed
    assert ("no sharp outline" in note) is followed


def test_the_colour_option_is_named_in_a_film_in_colour_alone():
    film = clip(bar)
    assert "--colour" not in str(draw_refusals(film, NO_TRACKS).note)
    in_colour = wrap_frames(np.repeat(np.array([film.frames[k] for k in range(9)])[..., None], 3, axis=-1))
    assert "--colour NAME" in str(draw_refusals(replace(film, frames=in_colour), NO_TRACKS).note)


def test_a_film_in_which_nothing_differs_says_so():
    assert "nothing in it differs" in str(draw_refusals(clip(lambda k: np.zeros(SIZE)), NO_TRACKS).note)


@pytest.mark.parametrize(("states", "failed"), [
    (["ok"], False), (["misfit", "no_collision"], False), ([ONE_BALL], False), ([NO_SCALE], False),
    (["no_collision"], True), (["nothing moves"], True),
])  # fmt: skip
def test_a_clip_without_a_measured_collision_fails(states, failed):
    zero, one = np.zeros(1, int), np.ones(1)
    one = Tracks(zero, zero, one, one, np.eye(2)[None], one, np.array([""]), one, one)
    assert is_refused_clip(one, [{"status": state} for state in states]) is failed
    assert is_refused_clip(NO_TRACKS, [{"status": "ok"}])
    measured = any(state in ("ok", "misfit") for state in states)
    assert is_refused_clip(one, [{"status": state} for state in states], in_pieces=True) is not measured
    assert REFUSALS.endswith(".png")
