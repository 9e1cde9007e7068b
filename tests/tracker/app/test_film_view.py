"""Pictures of a film for the page against the counts that were written."""

import cv2
import numpy as np
import pytest
import tifffile

from synthcam_shared.errors import InputError
from tracker.app import film_view
from tracker.app.film_view import COLOUR, FilmView, PictureLook
from tracker.camera.film_options import FilmOptions
from tracker.camera.recordings import open_source


def view_of(tmp_path, frames, **kwargs):
    tifffile.imwrite(tmp_path / "film.tif", frames, **kwargs)
    return FilmView(open_source(tmp_path / "film.tif"), 0)


def decoded(view, k, **look):
    return cv2.imdecode(np.frombuffer(view.draw(k, PictureLook(**look), "png"), np.uint8), cv2.IMREAD_UNCHANGED)


def test_a_picture_has_the_counts_of_the_film(tmp_path):
    counts = np.random.default_rng(0).integers(0, 256, (3, 20, 30), np.uint8)
    view = view_of(tmp_path, counts, imagej=True)
    np.testing.assert_array_equal(decoded(view, 1), counts[1])
    np.testing.assert_array_equal(decoded(view, 2, box=(25, -3, 9, 8)), counts[2, :8, 25:])
    halves = counts[0].reshape(10, 2, 15, 2).mean(axis=(1, 3))
    assert np.abs(decoded(view, 0, reduce=2) - halves).max() <= 0.5
    stretched = np.clip(np.rint(255 * (counts[0] / 255.0 - 0.2) / 0.4), 0, 255)
    assert np.abs(decoded(view, 0, low=0.2, high=0.6) - stretched).max() <= 1


def test_deep_films_are_shown_up_to_their_largest_count(tmp_path):
    counts = np.full((2, 20, 30), 1000, np.uint16)
    counts[:, 5, 5] = 4000
    view = view_of(tmp_path, counts, imagej=True)
    assert view.white == 4000
    assert decoded(view, 0)[5, 5] == 255
    assert decoded(view, 0)[0, 0] == round(255 / 4)
    low, high = view.levels
    assert low <= 0.25 <= high


def test_channels_of_a_film_in_colour(tmp_path):
    colours = np.random.default_rng(1).integers(0, 256, (3, 20, 30, 3), np.uint8)
    view = view_of(tmp_path, colours, photometric="rgb")
    assert view.channels[:5] == (COLOUR, "grey", "red", "green", "blue")
    np.testing.assert_array_equal(decoded(view, 1, channel="green"), colours[1, ..., 1])
    np.testing.assert_array_equal(decoded(view, 1, channel=COLOUR)[..., ::-1], colours[1])


def test_memory_is_bounded(tmp_path, monkeypatch):
    monkeypatch.setattr(film_view, "MAX_KEPT_BYTES", 3 * 600)
    counts = np.arange(9, dtype=np.uint8)[:, None, None] * np.ones((1, 20, 30), np.uint8)
    view = view_of(tmp_path, counts, imagej=True)
    for k in (0, 4, 8, 3, 8, 0):
        assert view.read(k).max() == k
        assert len(view._kept) <= 3


def test_going_back_decodes_several_frames_at_once(tmp_path, monkeypatch):
    counts = np.arange(40, dtype=np.uint8)[:, None, None] * np.ones((1, 20, 30), np.uint8)
    view, asked = view_of(tmp_path, counts, imagej=True), []
    decode = view._decode
    monkeypatch.setattr(view, "_decode", lambda k, channel: asked.append(k) or decode(k, channel))
    for k in (30, 29, 28, 5, 4):
        assert view.read(k).max() == k
    assert asked == [30, *range(17, 30), 5, *range(5)]


def test_frames_apart_are_those_of_the_film(tmp_path):
    counts = np.random.default_rng(2).integers(0, 256, (5, 20, 30), np.uint8)
    view = view_of(tmp_path, counts, imagej=True)
    view.read(2)
    apart = view.open_recording(None, FilmOptions(), apart=True).frames
    np.testing.assert_array_equal(np.array(apart), counts)
    assert apart[2] is view.read(2)


def test_a_pass_over_a_closed_film_ends_in_all_channels(tmp_path):
    view = view_of(tmp_path, np.zeros((3, 20, 30, 3), np.uint8), photometric="rgb")
    grey = view.open_recording(None, FilmOptions(), apart=True).frames
    for frames in (grey, grey.select_channel("red")):
        assert frames[1].shape == (20, 30)
        view.close()
        with pytest.raises(InputError, match="closed"):
            frames[2]
        view._closed = False


@pytest.mark.parametrize(
    ("k", "look", "message"),
    [
        (3, {}, "expected 0 to 2"),
        (-1, {}, "expected 0 to 2"),
        (0, {"channel": "red"}, "expected one of grey"),
        (0, {"low": 0.5, "high": 0.5}, "low < high"),
        (0, {"low": float("nan")}, "low < high"),
        (0, {"reduce": 0}, "expected 1 to"),
    ],
)
def test_what_cannot_be_shown_is_refused(tmp_path, k, look, message):
    view = view_of(tmp_path, np.zeros((3, 20, 30), np.uint8), imagej=True)
    with pytest.raises(InputError, match=message):
        view.draw(k, PictureLook(**look), "jpg")
