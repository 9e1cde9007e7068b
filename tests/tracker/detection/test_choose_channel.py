"""The colour in which a film shows its balls."""

import numpy as np
import pytest
from tracker_discs import CAMERA, SIZE, apart, disc, film

import tracker
from synthcam_shared.errors import InputError
from tracker.camera.camera import Camera
from tracker.camera.film_in_memory import wrap_frames
from tracker.detection import choose
from tracker.detection.choose import choose_channel
from tracker.notes import COLOUR_TO_GREY

GREEN, RED, WHITE = (20.0, 100.0, 30.0), (180.0, 18.0, 27.0), (200.0, 200.0, 200.0)  # green and red of one luma, 68


def cloth(ways, balls):
    """uint8 frames (n, h, w, 3) of coloured discs on green."""
    rng, out = np.random.default_rng(1), []
    for k in range(ways.shape[1]):
        picture = np.broadcast_to(GREEN, (*SIZE, 3)).copy()
        for way, ball in zip(ways, balls, strict=True):
            cover = disc(way[k])[..., None]
            picture = picture * (1 - cover) + np.array(ball) * cover
        out.append(np.clip(np.rint(picture + rng.normal(0, 2.0, picture.shape)), 0, 255))
    return np.array(out).astype(np.uint8)


def test_a_ball_as_grey_as_the_cloth_is_seen_in_its_colour():
    ways = apart(30)
    pictures = cloth(ways, (RED, WHITE))
    result = tracker.track(pictures, CAMERA)
    assert any(note.startswith("channel: red, because ") for note in map(str, result.notes))
    assert not any("grey" in note for note in map(str, result.notes) if not note.startswith("channel"))
    assert result.tracks.groupby("particle").size().tolist() == [30, 30]
    places = ways[:, result.tracks["frame"]]
    miss = np.hypot(*np.moveaxis(places - result.tracks[["x", "y"]].to_numpy(), -1, 0)).min(axis=0)
    assert miss.max() < 0.1
    grey = tracker.track(pictures, CAMERA, channel="grey")
    assert len(grey.tracks) <= 35
    assert not any("channel" in note for note in map(str, grey.notes))
    assert COLOUR_TO_GREY in grey.notes


def test_grey_is_kept_where_it_shows_as_much():
    assert choose_channel(wrap_frames(cloth(apart(30), (WHITE, WHITE))), Camera.from_dict(CAMERA)) == (
        "grey",
        "",
    )
    assert choose_channel(wrap_frames(film(np.random.default_rng(0), apart(9))), Camera.from_dict(CAMERA))[1] == ""


def test_a_plane_that_shows_fewer_balls_than_grey_says_how_to_point_at_the_others(monkeypatch):
    ratings = iter([choose._Rating(30, 0.2), *[choose._Rating(15, 1.0)] * 20])
    monkeypatch.setattr(choose, "_rate_plane", lambda *_: next(ratings))
    note = choose_channel(wrap_frames(cloth(apart(9), (WHITE, WHITE))), Camera.from_dict(CAMERA))[1]
    assert note.endswith("--channel overrides this, and --ball X,Y@FRAME points at a ball that only grey shows")


@pytest.mark.parametrize(("changes", "best"), [(0, "red-blue"), (30, "red-green")])
def test_a_plane_that_shows_more_balls_wins_unless_they_come_and_go(monkeypatch, changes, best):
    """A hand covers most of what changes where all three balls show; of one ball alone a plane shows nothing else."""
    few, more = choose._Rating(15, 1.0), choose._Rating(45, 0.24, changes)
    ratings = iter([choose._Rating(30, 0.23), *[choose._Rating(0, 0.0)] * 3, few, more, few, few])
    monkeypatch.setattr(choose, "_rate_plane", lambda *_: next(ratings))
    assert choose_channel(wrap_frames(cloth(apart(9), (WHITE, WHITE))), Camera.from_dict(CAMERA))[0] == best


def test_many_bodies_among_much_more_that_changes_are_noise(monkeypatch):
    """The ratings of an interlaced film of one small ball: its noise of colour has 143 specks of one size."""
    ratings = iter([choose._Rating(7, 0.01, 4), *[choose._Rating(4, 0.1, 2)] * 6, choose._Rating(143, 0.093, 42)])
    monkeypatch.setattr(choose, "_rate_plane", lambda *_: next(ratings))
    channel, note = choose_channel(wrap_frames(cloth(apart(9), (WHITE, WHITE))), Camera.from_dict(CAMERA))
    assert channel == "grey"
    assert "colour shows 143 round bodies (9 % of what changes), which noise does too" in note
    assert note.endswith("--channel, --colour or --ball X,Y@FRAME say how the balls show")


@pytest.mark.parametrize(("pictures", "name", "said"), [
    (np.zeros((5, 40, 40), np.uint8), "red", "channel: the film is in grey, expected no 'red'"),
    (np.zeros((5, 40, 40, 3), np.uint8), "mauve", "channel: expected one of grey, red, green, blue, .*, not 'mauve'"),
])  # fmt: skip
def test_a_channel_that_is_not_there_is_one_line(pictures, name, said):
    with pytest.raises(InputError, match=said):
        tracker.track(pictures, channel=name)
