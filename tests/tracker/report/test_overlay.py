"""Tracks drawn on a film: where the balls are, in every frame, in a file that another program plays."""

import cv2
import numpy as np
import pytest

from tracker.camera.camera import Camera
from tracker.camera.film_in_memory import wrap_frames
from tracker.detection.link import Tracks
from tracker.report.overlay import Overlay, choose_frames, encode_mp4

SHAPE = (81, 121)
PLACES = np.array([[30.0 + 2 * k, 40.0] for k in range(12)])


def overlay(dtype=np.uint8, shape=SHAPE, places=PLACES):
    film = np.full((len(places), *shape), 8, dtype)
    known = {"scale": 1e-3, "size": [shape[1], shape[0]], "fps": 100.0, "ball_diameter": 10e-3}
    n = len(places)
    nothing, cov = np.zeros(n), np.tile(np.eye(2), (n, 1, 1))
    names = np.array([""] * n)
    tracks = Tracks(np.arange(n), np.zeros(n, int), *places.T, cov, nothing, names, *places.T)
    frames = wrap_frames(film)
    return Overlay(frames, tracks, Camera.from_dict(known), 0, n - 1, ((0.05, "after the contact"),))


def coloured(picture):
    """Tell for each pixel whether it is coloured."""
    return np.ptp(picture.astype(int), axis=2) > 60


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_each_ball_has_its_outline_and_a_cross_at_its_place(dtype):
    for k, picture in enumerate(overlay(dtype)):
        assert picture.shape == (162, 242, 3)
        x, y = 2 * PLACES[k] + 0.5
        marked = coloured(picture)
        assert marked[round(y), round(x)]
        for dx, dy in ((-10, 0), (10, 0), (0, 10), (7, 7)):  # the outline; the number stands above it
            assert marked[round(y + dy) - 1 : round(y + dy) + 2, round(x + dx) - 1 : round(x + dx) + 2].any()
        assert not marked[round(y) + 15 :].any()
        red = picture[round(y), round(x)].astype(int)
        assert np.argmax(red) == np.argmax(Overlay.colours[0])


def test_a_film_plays_elsewhere_with_every_frame(tmp_path):
    path = tmp_path / "film.mp4"
    path.write_bytes(encode_mp4(overlay()))
    film, seen = cv2.VideoCapture(str(path)), []
    while True:
        ok, picture = film.read()
        if not ok:
            break
        seen.append(picture[..., ::-1])
    assert len(seen) == len(PLACES)
    for k, picture in enumerate(seen):
        x, y = (2 * PLACES[k] + 0.5).astype(int)
        assert coloured(picture)[y - 2 : y + 3, x - 2 : x + 3].any()
    assert encode_mp4(overlay()) == path.read_bytes()


def test_a_wide_picture_is_made_smaller():
    (first, *_) = overlay(shape=(301, 2560), places=np.array([[2000.0, 150.0]] * 3))
    assert first.shape == (150, 1280, 3)
    assert coloured(first)[75, 1000]


def test_of_a_long_film_the_contact_is_shown():
    assert choose_frames(100, [50], 200) == (0, 99)
    assert choose_frames(5000, [3000], 400) == (2900, 3299)
    assert choose_frames(5000, [4999], 400) == (4600, 4999)
    assert choose_frames(5000, [], 400) == (0, 399)


@pytest.mark.parametrize(("dtype", "shape"), [(np.uint8, (40, 50)), (np.uint16, (7, 9))])
def test_black_is_the_lowest_percent_of_the_counts_and_white_the_greatest(dtype, shape):
    rng = np.random.default_rng(4)
    pictures = rng.integers(3, 200, (6, *shape)).astype(dtype)
    overlay = Overlay(wrap_frames(pictures), None, None, 0, 5)
    assert overlay._grey_range() == pytest.approx((np.percentile(pictures, 1), pictures.max()))
