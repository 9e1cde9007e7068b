"""Balls of one frame against the paths that were drawn."""

import numpy as np
import pytest
import tracker_discs
import tracker_film

from tracker.app import frame_detector
from tracker.app.frame_detector import list_balls, prepare_detector
from tracker.camera.camera import Camera
from tracker.camera.film_in_memory import wrap_frames
from tracker.camera.film_options import FilmOptions
from tracker.camera.recordings import make_recording


def farthest(found, places):
    """The largest distance of a ball from its true place, px; each place has one ball."""
    assert len(found) == len(places)
    return max(np.hypot(found.x - x, found.y - y).min() for x, y in places)


@pytest.fixture(scope="module")
def glints():
    paths = tracker_film.collision(24, contact=10.4, speed=2.5)
    return paths, tracker_film.film(np.random.default_rng(0), paths)


@pytest.fixture(scope="module")
def discs():
    ways = tracker_discs.collision(40)
    return ways.swapaxes(0, 1), tracker_discs.film(np.random.default_rng(0), ways)


def prepared(pictures, camera, **options):
    return prepare_detector(make_recording(0, wrap_frames(pictures), camera, options=FilmOptions(**options)), None)


def test_glints_of_a_frame_whatever_came_before(glints):
    paths, pictures = glints
    detector = prepared(pictures, None)
    assert (detector.name, detector.point) == ("maximum_likelihood", "glint")
    for k in (23, 0, 12, 13, 0):
        assert farthest(detector.detect(k), paths[k]) < 0.1
    listed = list_balls(detector.detect(0))
    assert 0.003 < listed[0]["x_std"] < 0.05
    assert all(ball["flags"] == [] for ball in listed)


@pytest.mark.parametrize("most", [400, 15])
def test_discs_of_a_frame_of_a_short_film_and_of_a_long_one(discs, most, monkeypatch):
    monkeypatch.setattr(frame_detector, "MAX_SURVEYED_FRAMES", most)
    places, pictures = discs
    detector = prepared(pictures, None)
    assert (detector.name, detector.point) == ("discs", "centre")
    assert abs(detector.radius_px - tracker_discs.R) < 0.3
    for k in (39, 0, 8):
        assert farthest(detector.detect(k), places[k]) < 0.3


def test_each_take_of_a_long_film_has_its_own_background(discs, monkeypatch):
    monkeypatch.setattr(frame_detector, "MAX_SURVEYED_FRAMES", 40)
    places, pictures = discs
    rng = np.random.default_rng(5)
    other = tracker_discs.film(rng, tracker_discs.collision(40), ground=tracker_discs.plate(rng, 90, 250))
    detector = prepared(np.concatenate([pictures, other]), None)
    assert len(detector.view.takes.spans) == 2
    for k in (30, 33, 75):
        assert farthest(detector.detect(k), places[k % 40]) < 0.03  # 0.1 by the background of the other take


def test_nothing_is_found_outside_the_region(glints):
    paths, pictures = glints
    left, right = sorted(paths[0, :, 0])
    start = round(left) + 3  # nearer than a diameter, so that its glint is not blanked
    found = prepared(pictures, Camera.of(tracker_film.CAMERA), region=f"{start},0,199,159").detect(0)
    assert found.x.round().tolist() == [round(right)]
