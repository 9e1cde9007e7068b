"""Warnings from how tracks lie in a film."""

import cv2
import numpy as np
import pytest
from tracker_discs import film

import tracker
from tracker.camera.film_in_memory import wrap_frames
from tracker.camera.recordings import make_recording
from tracker.detection.candidates import estimate_empty_plate
from tracker.detection.diagnose import (
    LooseEnds,
    count_loose_ends,
    describe_other_specks,
    measure_camera_motion,
    warn_of_exchanges,
    warn_of_moving_camera,
)
from tracker.detection.link import Tracks
from tracker.recording import track_clip

SIZE, LAST = (400, 300), 99


def tracks(*ways):
    """Make tracks, each of (first frame, last frame, from, to)."""
    rows = [np.linspace((a, *start), (b, *end), b - a + 1) for a, b, start, end in ways]
    frame, x, y = np.concatenate(rows).T
    particle = np.repeat(np.arange(len(rows)), [len(r) for r in rows])
    n, nothing = len(frame), np.full(len(frame), np.nan)
    cov = np.tile(np.eye(2), (n, 1, 1))
    return Tracks(frame.astype(int), particle, x, y, cov, np.ones(n), np.full(n, ""), nothing, nothing)


BALLS = [(0, LAST, (5, 150), (200, 150)), (0, 60, (210, 160), (395, 40)), (20, LAST, (200, 295), (250, 100))]
GLITTER = [(10 * k, 10 * k + 6, (100 + 20 * k, 120), (105 + 20 * k, 130)) for k in range(1, 8)]
SPECKS = [(10 * k, 10 * k + 6, (9 + k % 3, 120), (10, 121)) for k in range(1, 8)]


@pytest.mark.parametrize(
    ("ways", "spans", "ends"),
    [
        (BALLS, [(0, LAST)], ""),
        (GLITTER, [(0, LAST)], "14 of the 14 ends"),
        (SPECKS, [(0, LAST)], "14 of the 14 ends"),  # at the rim, but they stay there
        (BALLS + GLITTER, [(0, LAST)], "14 of the 20 ends"),
        (BALLS + GLITTER[:2], [(0, LAST)], "1 track begins where another ended"),  # as a lost ball leaves
        (GLITTER, [(10 * k, 10 * k + 6) for k in range(1, 8)], ""),  # a take each
    ],
)
def test_ends_of_tracks_amid_the_picture_are_counted(ways, spans, ends):
    said = count_loose_ends(tracks(*ways), SIZE, spans).warn()
    assert "".join(said)[: len(ends) or None] == ends


PIECES = [(a, a + 12, (20 + 3 * a, 100), (56 + 3 * a, 100)) for a in (0, 22, 44, 66)]
SCATTERED = [(10 * k, 10 * k + 6, (200 * (k % 2) + 50, 150 * (k // 2 % 2) + 60), (203 * (k % 2) + 50, 150 * (k // 2 % 2)
              + 62)) for k in range(1, 8)]  # fmt: skip


@pytest.mark.parametrize(("ways", "said"), [(PIECES, "3 tracks begin where another ended"), (SCATTERED, "reflections")])
def test_pieces_of_one_ball_are_no_reflections(ways, said):
    """A hand hides a ball for ten frames, longer than the tracker links over."""
    (warning,) = count_loose_ends(tracks(*ways), SIZE, [(0, LAST)]).warn()
    assert said in warning
    assert ("max_gap_frames" in warning) == (ways is PIECES)


def test_a_film_of_specks_names_the_detector_of_bodies():
    (warning,) = count_loose_ends(tracks(*GLITTER), SIZE, [(0, LAST)]).warn(LooseEnds.HINT_AT_BODIES)
    assert "--detector discs follows bodies" in warning
    assert "--detector" not in count_loose_ends(tracks(*GLITTER), SIZE, [(0, LAST)]).warn()[0]


def test_specks_in_a_lossy_video_may_be_what_its_codec_left():
    ends = count_loose_ends(tracks(*GLITTER), SIZE, [(0, LAST)])
    assert "compression" in ends.warn(lossy=True)[0]
    assert "compression" not in ends.warn()[0]
    assert count_loose_ends(tracks(BALLS[0]), SIZE, [(0, LAST)]).warn(lossy=True) == ()


@pytest.mark.parametrize(("amplitude", "said"), [(2, "nothing moves: nothing differs"), (30, "the light changes")])
def test_blocks_of_a_codec_are_no_change_of_the_light(amplitude, said):
    """A film of a table at rest: blocks of 8 x 8 px flicker by two counts."""
    rng = np.random.default_rng(0)
    ground = 100 + 40 * cv2.GaussianBlur(rng.normal(0, 1, (64, 80)), (0, 0), 3) * 6
    flicker = rng.integers(-amplitude, amplitude + 1, (30, 8, 10)) * (rng.random((30, 8, 10)) < 0.3)
    film = np.clip(np.rint(ground + np.kron(flicker, np.ones((8, 8)))), 0, 255).astype(np.uint8)
    assert tracker.track(film, detector="maximum_likelihood").rows[0]["status"].startswith(said)


def test_nothing_is_said_of_nothing():
    none = Tracks(*(values[:0] for values in vars(tracks(BALLS[0])).values()))
    assert count_loose_ends(none, SIZE, [(0, LAST)]).warn() == ()


def walk(step, turn=0.0):
    """Pictures of a textured ground by a camera that moves, px and degrees a picture, before which a body crosses."""
    rng, size = np.random.default_rng(2), (240, 320)
    ground = cv2.GaussianBlur(rng.normal(0, 1, (480, 640)), (0, 0), 6.0)
    ground = 120 + 30 * ground / ground.std()
    pictures = []
    for k in range(6):
        change = cv2.getRotationMatrix2D((320, 240), turn * k, 1.0) - [[0, 0, 160 + step * k], [0, 0, 120]]
        picture = cv2.warpAffine(ground, change, size[::-1])
        cv2.circle(picture, (40 + 45 * k, 120), 30, 120, -1)
        pictures.append(picture)
    return pictures


@pytest.mark.parametrize(("step", "turn", "moved"), [(0, 0, 0), (4, 0, 20), (0, 1.5, 21), (25, 0, 125)])
def test_the_motion_of_a_camera_is_measured_past_a_body_that_crosses(step, turn, moved):
    """A turn by 7.5 degrees moves the corners of the middle four fifths, 160 px from the middle, by 21 px."""
    assert measure_camera_motion(walk(step, turn)) == pytest.approx(moved, rel=0.05, abs=0.5)
    assert bool(warn_of_moving_camera(walk(step, turn))) == bool(moved)


def test_a_body_on_a_bare_ground_is_no_moving_camera():
    pictures = [cv2.circle(np.full((240, 320), 90, np.uint8), (40 + 20 * k, 120), 30, 200, -1) for k in range(6)]
    assert measure_camera_motion(pictures) == 0


def speckled(bright, dark, dark_sigma=1.2):
    """Twelve frames of specks that drift on grey ground: Gaussians of 1.2 px, the dark ones as wide as it is said."""
    rng = np.random.default_rng(3)
    start, way = rng.uniform(15, 185, (bright + dark, 2)), rng.uniform(-3, 3, (bright + dark, 2))
    y, x = np.mgrid[:200, :200]
    film = []
    for k in range(12):
        picture = 120 + 2 * rng.standard_normal((200, 200))
        for n, (column, row) in enumerate(start + k * way):
            size, height = (1.2, 90) if n < bright else (dark_sigma, -90)
            picture += height * np.exp(-((x - column) ** 2 + (y - row) ** 2) / (2 * size**2))
        film.append(np.clip(np.rint(picture), 0, 255).astype(np.uint8))
    return film


@pytest.mark.parametrize(
    ("bright", "dark", "dark_sigma", "channel", "said"),
    [
        (15, 30, 1.2, "grey", "specks: bright ones are followed, and some"),
        (15, 30, 1.2, "dark", "specks: dark ones are followed, and some"),
        (15, 5, 1.2, "grey", ""),
        (5, 20, 3.0, "grey", ""),  # the dark sides of balls with a glint
        (15, 30, 1.2, "red-green", ""),
    ],
)
def test_a_film_of_bright_and_dark_specks_names_those_left_out(bright, dark, dark_sigma, channel, said):
    film = speckled(bright, dark, dark_sigma)
    assert "".join(describe_other_specks(film, estimate_empty_plate(film), channel))[: len(said) or None] == said


@pytest.mark.parametrize(("channel", "count"), [("grey", 8), ("dark", 16)])
def test_dark_specks_are_followed_in_the_channel_dark(channel, count):
    """White less grey makes the dark ones bright, also of a film in grey."""
    result = tracker.track(np.array(speckled(8, 16)), channel=channel, detector="linear_fit")
    lengths = result.tracks.groupby("particle").size()
    assert 0.8 * count <= (lengths >= 8).sum() <= 1.1 * count


def test_a_ball_that_is_found_but_jumps_about_is_not_called_unseen():
    """As in a film whose time stamps are wrong: its steps predict nothing."""
    rng = np.random.default_rng(3)
    jumps = rng.uniform([30, 30], [170, 130], (30, 2))
    clip = make_recording(0, wrap_frames(film(rng, jumps[None], radius=24.0)), None)
    tracked = track_clip(clip, "discs")
    assert len(tracked.tracks) == 0
    assert (
        tracked.reason
        == "no path: 30 frames show what may be a ball, but its steps from frame to frame are those of no ball"
    )


def test_balls_that_may_have_exchanged_numbers_are_named():
    frame, particle = np.array([4, 5, 9, 5, 9]), np.array([0, 0, 0, 3, 3])
    zero, words = np.zeros(5), np.array(["", "shaded|exchange", "", "exchange", ""])
    tracks = Tracks(frame, particle, zero, zero, np.tile(np.eye(2), (5, 1, 1)), zero, words, zero, zero)
    (warning,) = warn_of_exchanges(tracks)
    assert warning.startswith("balls may have exchanged their numbers in 1 frame, ")
    assert ": 0 and 3 in frame 5 (exchange in column flags of tracks)" in warning
    assert warn_of_exchanges(tracks.take([0, 2])) == ()
    (alone,) = warn_of_exchanges(tracks.take([0, 1, 2]))
    assert alone.startswith("a ball may have left the picture and another one entered under its number, ")
    assert ": 0 in frame 5 (exchange in column flags of tracks)" in alone
    assert alone.endswith("cut the track by --edits")
