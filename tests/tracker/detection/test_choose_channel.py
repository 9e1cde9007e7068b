"""The colour in which a film shows its balls."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from tracker_discs import CAMERA, SIZE, apart, disc, film, lit_film

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


def clutter(rng, count, ball):
    """uint8 frames of a ball on green, a grey bar that moves, and blots of the cloth's luma in red, new in each."""
    pictures = cloth(apart(count)[:1], (ball,)).astype(float)
    for k, picture in enumerate(pictures):
        picture[:, 120 + 2 * k : 150 + 2 * k] += 70
        blot = gaussian_filter(rng.standard_normal(SIZE), 2.5)
        picture += np.clip(blot / blot.std() - 0.8, 0, 1)[..., None] * (np.array(RED) - GREEN)
    return np.clip(np.rint(pictures), 0, 255).astype(np.uint8)


def test_specks_that_come_and_go_among_other_noise_are_no_balls():
    """Noise of colour has many round blots of one size, none of them twice; a grey ball shows in grey."""
    channel, note = choose_channel(
        wrap_frames(clutter(np.random.default_rng(3), 15, (100.0, 100.0, 100.0))), Camera.unknown((200, 160), 8)
    )
    assert channel == "grey"
    assert "of what changes), which noise does too" in note
    assert note.endswith("--channel, --colour or --ball X,Y@FRAME say how the balls show")


def test_balls_beside_a_sleeve_that_covers_much_more_are_no_noise():
    """Three balls as grey as the cloth move, and so does a red sleeve, which is many times as large in every plane."""
    ways = np.stack([apart(15)[0], apart(15)[1], apart(15)[1] + [60.0, -30.0]])
    pictures = cloth(ways, (RED, RED, RED))
    for k, picture in enumerate(pictures):
        picture[:, 100 + 4 * k : 140 + 4 * k] = (240, 10, 10)
    channel, note = choose_channel(wrap_frames(pictures), Camera.unknown((200, 160), 8))
    assert channel != "grey"
    assert "it shows 4" in note  # 45 in 15 pictures, but where the arm covers one


@pytest.mark.parametrize(("pictures", "name", "said"), [
    (np.zeros((5, 40, 40), np.uint8), "red", "channel: the film is in grey, expected no 'red'"),
    (np.zeros((5, 40, 40, 3), np.uint8), "mauve", "channel: expected one of grey, red, green, blue, .*, not 'mauve'"),
])  # fmt: skip
def test_a_channel_that_is_not_there_is_one_line(pictures, name, said):
    with pytest.raises(InputError, match=said):
        tracker.track(pictures, channel=name)


def striped(ways, radius=18.0, light=200.0, dark=15.0, ground=80.0, noise=1.5):
    """uint8 frames (n, h, w) in grey of discs with a dark stripe that turn."""
    rng, rows, columns, out = np.random.default_rng(2), *np.indices(SIZE), []
    for k in range(ways.shape[1]):
        picture = np.full(SIZE, ground)
        for number, way in enumerate(ways):
            angle = 0.15 * k + number
            across = (columns - way[k, 0]) * np.cos(angle) + (rows - way[k, 1]) * np.sin(angle)
            own = gaussian_filter(np.where(np.abs(across) < radius / 2, dark, light), 0.7)
            cover = disc(way[k], radius)
            picture = picture * (1 - cover) + own * cover
        out.append(np.clip(np.rint(picture + rng.normal(0, noise, SIZE)), 0, 255))
    return np.array(out).astype(np.uint8)


def test_discs_with_a_stripe_are_seen_in_their_contrast():
    ways = apart(40)
    pictures = striped(ways)
    camera = CAMERA | {"ball_diameter": 0.036}
    result = tracker.track(pictures, camera)
    assert any(note.startswith("channel: contrast, because ") for note in map(str, result.notes))
    assert result.tracks.groupby("particle").size().tolist() == [40, 40]
    places = ways[:, result.tracks["frame"]]
    miss = np.hypot(*np.moveaxis(places - result.tracks[["x", "y"]].to_numpy(), -1, 0)).min(axis=0)
    assert np.sqrt((miss**2).mean()) < 0.3  # px
    grey = tracker.track(pictures, camera, channel="grey")
    assert len(grey.tracks) < 40


def test_bright_discs_with_dark_shadows_stay_in_grey():
    pictures = wrap_frames(lit_film(np.random.default_rng(0), apart(30)))
    assert choose_channel(pictures, Camera.from_dict(CAMERA)) == ("grey", "")
