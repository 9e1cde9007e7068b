"""Takes, frames given twice, hands and captions: what other people's films hold beside the balls."""

import cv2
import numpy as np
import pytest
from tracker_discs import CAMERA, R, apart, collision, film, plate

import tracker
from tracker.camera.film_in_memory import wrap_frames
from tracker.detection.background.takes import FilmTakes, find_takes

pytestmark = pytest.mark.usefixtures("unfitted", "not_local")


def tracked(pictures):
    return tracker.track(pictures, CAMERA, detector="discs")


def test_takes_are_found_and_followed_apart():
    rng = np.random.default_rng(0)
    first = film(rng, collision(20, 9))
    second = film(rng, collision(20, 9), ground=plate(rng, 110.0))
    black = rng.integers(0, 2, (5, *first.shape[1:])).astype(np.uint8)
    joined = np.concatenate([first, black, second])
    assert find_takes(wrap_frames(joined)).spans == ((0, 19), (25, 44))
    result = tracked(joined)
    assert result.tracks.groupby("particle").frame.agg(["min", "max", "size"]).to_numpy().tolist() == [
        [0, 19, 20], [0, 19, 20], [25, 44, 20], [25, 44, 20],
    ]  # fmt: skip
    assert "the film has 2 takes, each tracked on its own: frames 0 to 19, 25 to 44" in map(str, result.notes)
    assert [row["collision"] for row in result.rows] == [0, 1]


def test_a_take_among_balls_only_is_none():
    assert find_takes(wrap_frames(film(np.random.default_rng(1), collision(30, 12)))).spans == ((0, 29),)


@pytest.mark.parametrize("copies", [2, 3])
def test_frames_given_twice_are_left_out(copies):
    """As of a film at 30 frames a second stored at 60; the codec's noise is in the copies."""
    rng = np.random.default_rng(2)
    once = film(rng, apart(20), noise=2.0)
    stored = np.repeat(once, copies, axis=0)
    stored[rng.random(stored.shape) < 0.01] += 1
    result = tracked(stored)
    assert np.unique(result.tracks.frame).tolist() == list(range(0, copies * 20, copies))
    assert any(
        note.startswith(f"{20 * (copies - 1)} frames nearly repeat the previous one") for note in map(str, result.notes)
    )


def test_exact_and_near_copies_have_notes_of_their_own_words():
    """Both counts are of one film: the reader drops exact copies, the detector near ones."""
    rng = np.random.default_rng(2)
    stored = np.repeat(film(rng, apart(20), noise=2.0), 2, axis=0)
    stored[21:31:2, 0, 0] += 1
    notes = [note for note in map(str, tracked(stored).notes) if "repeat the previous one" in note]
    assert [note.split(" the previous")[0] for note in notes] == ["15 frames repeat", "5 frames nearly repeat"]


def test_one_frame_and_one_object_are_named_in_the_singular():
    (note,) = FilmTakes(((0, 9),), (0,), frozenset({4}), 1.0).describe()
    assert note.startswith("frame 4 nearly repeats the previous one, ")
    pictures = film(np.random.default_rng(5), collision())
    cv2.line(pictures[7], (20, 20), (120, 30), 250, 6)
    notes = "\n".join(map(str, tracked(pictures).notes))
    assert "one object in frame 7 is not a ball and is left out" in notes


def test_noise_and_rest_are_no_copies():
    ways = collision(30, 12)
    ways[:, :] = ways[:, :1]
    assert not find_takes(wrap_frames(film(np.random.default_rng(3), ways))).repeated


def test_hand_cue_and_caption_are_refused():
    rng, ways = np.random.default_rng(4), collision()
    pictures = film(rng, ways)
    for k, frame in enumerate(pictures):
        cv2.putText(frame, "Take 3", (5, 150), cv2.FONT_HERSHEY_SIMPLEX, 0.6, 255, 2)
        if k < 20:  # a hand that draws back, and a cue
            cv2.ellipse(frame, (170 + k, 120), (34, 17), 30, 0, 360, 190, -1)
            for finger in range(3):
                cv2.line(frame, (150 + k, 112 + 9 * finger), (118 + k, 105 + 11 * finger), 190, 7)
            cv2.line(frame, (0, 15), (60 - 2 * k, 25), 220, 5)
    result = tracked(pictures)
    assert result.tracks.groupby("particle").size().tolist() == [60, 60]
    near = [np.hypot(*(ways[:, q.frame] - [q.x, q.y]).T).min() for q in result.tracks.itertuples()]
    assert max(near) < 0.5
    assert any("objects in 20 frames are not balls" in note for note in map(str, result.notes))


@pytest.mark.parametrize(("change", "reason"), [
    ("moves", "no still background: the camera"), ("light", "no still background: the light changes"),
    ("small", "too small"), ("nothing", "nothing moves"),
])  # fmt: skip
def test_the_reason_where_nothing_can_be_followed(change, reason):
    rng, ground = np.random.default_rng(5), plate(np.random.default_rng(6), 90.0)
    frames = np.repeat(ground[None], 30, axis=0)
    if change == "moves":
        frames = np.array([np.roll(ground, 3 * k, axis=1) for k in range(30)])
    if change == "light":
        frames = frames * (1 + 0.4 * np.sin(0.7 * np.arange(30)))[:, None, None]
    if change == "small":
        for k in range(30):
            frames[k, 80:83, 20 + 5 * k : 23 + 5 * k] += 100
    frames = np.clip(np.rint(frames + rng.normal(0, 1.0, frames.shape)), 0, 255).astype(np.uint8)
    assert tracked(frames).rows[0]["status"].startswith(reason)


def test_two_sizes_of_balls():
    rng, ways = np.random.default_rng(7), collision()
    small = film(rng, ways[1:] * 0 + np.linspace([20, 20], [60, 140], 60), radius=0.6 * R)
    large = film(rng, ways[:1] * 0 + np.linspace([150, 140], [130, 60], 60), ground=plate(np.random.default_rng(0)))
    ground = plate(np.random.default_rng(0))
    both = np.clip(large + (small - np.median(small, axis=0)).clip(0), 0, 255).astype(np.uint8)
    assert ground.shape == both.shape[1:]
    result = tracker.track(both, detector="discs")
    found = result.tracks.groupby("particle").flux.median().pipe(np.sqrt) / np.sqrt(np.pi)
    assert sorted(found) == pytest.approx([0.6 * R, R], rel=0.05)


def test_a_crowd_of_touching_balls_has_a_note():
    """A heap that moves shows as one large object; no ball of it is found."""
    rng, small = np.random.default_rng(7), R / 2
    way = np.stack([np.linspace(60, 75, 12), np.full(12, 40.0)], axis=1)
    heap = np.array([way + np.array([column, row]) * 1.8 * small for row in range(4) for column in range(4)])
    pictures = film(rng, heap, radius=small)
    notes = list(map(str, tracker.track(pictures, CAMERA | {"ball_diameter": 2e-3 * small}, detector="discs").notes))
    assert [note for note in notes if note.startswith("crowd: what is left out covers")]


def test_more_objects_than_are_looked_at_have_a_note_with_the_setting():
    ways = np.concatenate([apart(12), apart(12) + np.array([0.0, 25.0])])
    settings = {"detection": {"max_objects_per_frame": 3}}
    result = tracker.track(film(np.random.default_rng(8), ways), CAMERA, detector="discs", settings=settings)
    assert [note for note in map(str, result.notes) if "12 frames show more than 3 objects" in note]
