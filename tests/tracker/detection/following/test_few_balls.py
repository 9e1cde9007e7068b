"""Few balls whose links are sure: the same states as by likelihoods, to the last bit, and where these take over."""

from dataclasses import fields, replace

import numpy as np
import pytest
from tracker_film import CAMERA, collision

from tracker.camera.camera import Camera
from tracker.detection import link
from tracker.detection.following.assignment import link_frame
from tracker.detection.following.few_balls import MAX_FEW_BALLS, follow_apart
from tracker.detection.following.motion_filter import MotionNoise, PredictedBalls
from tracker.detection.glints import Glints
from tracker.detection.link import assign_track_numbers

NOISE = MotionNoise(
    diameter=15.0, reach=12.0, position=0.05, acceleration=0.05, tolerance=0.1, restitution=0.9, false_density=3e-6
)
GAP = 4  # frames from one to the next, at most


def lay_rows(rng, count, frames):
    """Positions (n, 2) of balls on curved ways 60 px apart, their rows by frame in random order."""
    start = np.column_stack([60.0 * np.arange(count), rng.uniform(-20, 20, count)])
    v, a = rng.uniform(-3, 3, 2) + rng.uniform(-0.2, 0.2, (count, 2)), rng.uniform(-0.004, 0.004, (count, 2))
    parts, places = [], []
    for k, t in enumerate(frames):
        order = rng.permutation(count)
        places.append((start + v * t + a * t * t / 2)[order] + 0.03 * rng.standard_normal((count, 2)))
        parts.append(k * count + np.arange(count))
    return np.concatenate(places), parts


def seen_twice(xy, parts, frames):
    """The balls after two frames."""
    live = PredictedBalls.start(np.arange(len(parts[0])), frames[0], xy[parts[0]], NOISE)
    step = frames[1] - frames[0]
    return link_frame(live, xy[parts[1]], step, frames[1], (xy[parts[2]], frames[2] - frames[1]), NOISE).balls


def follow(xy, parts, frames, live):
    return follow_apart(live, frames, parts, xy, 2, GAP, NOISE)


def compare(xy, parts, frames, live):
    """Follow by likelihoods too: the same states and links to the last bit. Returns how many frames were followed."""
    quick, rows = follow(xy, parts, frames, live)
    for k, own in enumerate(rows, 2):
        linked = link_frame(live, xy[parts[k]], frames[k] - frames[k - 1], frames[k], None, NOISE)
        live = linked.balls
        expected = dict(zip(linked.track.tolist(), parts[k].tolist(), strict=True))
        assert own.tolist() == [expected.get(number, -1) for number in live.number.tolist()]
    for column in fields(live):
        assert np.array_equal(getattr(quick, column.name), getattr(live, column.name)), column.name
    return len(rows)


@pytest.mark.parametrize("count", [1, 2, 3, MAX_FEW_BALLS])
def test_states_and_links_are_those_of_the_likelihoods_to_the_last_bit(count):
    rng = np.random.default_rng(count)
    frames = np.cumsum(rng.choice([1, 1, 1, 2, 3], 40)).tolist()
    xy, parts = lay_rows(rng, count, frames)
    assert compare(xy, parts, frames, seen_twice(xy, parts, frames)) == len(frames) - 2


def count_frames_of_lost_balls(count):
    """Compare 20 films in which balls are not found; count the frames followed."""
    rng, frames, followed = np.random.default_rng(count), list(range(40)), 0
    for _ in range(20):
        xy, parts = lay_rows(rng, count, frames)
        live = seen_twice(xy, parts, frames)
        parts = [part[: rng.integers(1, count + 1)] if k > 2 else part for k, part in enumerate(parts)]
        followed += compare(xy, parts, frames, live)
    return followed


@pytest.mark.parametrize("count", [2, 3, MAX_FEW_BALLS])
def test_balls_that_are_not_found_are_followed_as_by_the_likelihoods(count):
    assert count_frames_of_lost_balls(count) > 20 * 4


def test_hidden_hits_and_a_common_fall_are_followed_as_by_the_likelihoods(monkeypatch):
    """As balls seen whole have them, near the bounds of what balls reach."""
    bounds = (-150.0, -80.0, 60.0 * MAX_FEW_BALLS, 80.0)
    falling = replace(NOISE, fall=(0.003, -0.002), hidden_hits=True, bounds=bounds)
    monkeypatch.setitem(globals(), "NOISE", falling)
    assert count_frames_of_lost_balls(3) > 20 * 4
    assert count_frames_in_doubt() > 400 * 2


def test_balls_that_part_are_followed_as_by_the_likelihoods():
    """From about a diameter apart, beside one that was seen once and is out of reach."""
    rng, frames, followed = np.random.default_rng(7), list(range(12)), 0
    for _ in range(100):
        xy, parts = lay_rows(rng, 2, frames)
        apart, way = rng.uniform(12, 24), rng.uniform(-np.pi, np.pi)
        v = rng.uniform(0.5, 6, 2)[:, None] * np.array([[-np.cos(way), np.sin(way)], [1, 0]])
        for k in frames:
            places = np.array([[0.0, 0.0], [apart, 0.0]]) + v * k + 0.03 * rng.standard_normal((2, 2))
            xy[parts[k]] = places[:: rng.choice([-1, 1])]
        live = seen_twice(xy, parts, frames)
        far = PredictedBalls.start(np.array([2]), 1, np.array([[300.0, 300.0]]), NOISE)
        followed += compare(xy, parts, frames, PredictedBalls.join([live, far]))
    assert followed > 100 * 3


def count_frames_in_doubt():
    """Compare 400 films, detections off the way by some errors, and false ones near a ball in place of a lost one."""
    rng, frames, followed = np.random.default_rng(11), list(range(12)), 0
    for _ in range(400):
        xy, parts = lay_rows(rng, 2, frames)
        live = seen_twice(xy, parts, frames)
        later = np.concatenate(parts[3:])
        xy[later] += rng.exponential(0.25) * rng.standard_normal((len(later), 2))
        for part in parts[3:]:
            if rng.random() < 0.3:
                xy[part[0]] = xy[part[1]] + rng.exponential(1.5) * rng.standard_normal(2)
        followed += compare(xy, parts, frames, live)
    return followed


def test_what_is_followed_in_doubt_is_what_the_likelihoods_say():
    assert count_frames_in_doubt() > 400 * 2


def test_they_stop_where_a_frame_is_not_plain():
    rng, frames = np.random.default_rng(5), list(range(30))
    xy, parts = lay_rows(rng, 2, frames)
    live = seen_twice(xy, parts, frames)

    def count(xy=xy, parts=parts, frames=frames, live=live):
        return len(follow(xy, parts, frames, live)[1])

    assert count() == 28
    one_lost = [part[np.argsort(xy[part, 0])][: 1 + (k < 12)] for k, part in enumerate(parts)]
    assert count(parts=one_lost) == 10 + GAP, "a ball is lost for long"
    assert count(parts=[np.append(part, 0) if k == 9 else part for k, part in enumerate(parts)]) == 7, "a false one"
    for gap, followed in ((GAP, 28), (GAP + 1, 19)):
        later = [k + (gap - 1) * (k > 20) for k in frames]
        assert count(*lay_rows(np.random.default_rng(5), 2, later), later) == followed, "20 frames before the gap"
    kicked = xy.copy()
    kicked[parts[15]] += [0.0, 4.0]
    assert count(xy=kicked) == 13, "off its way"
    closer = xy.copy()
    closer[parts[18], 0] = np.linspace(0, 16, 2)
    assert count(xy=closer) == 16, "a jump"
    wide = replace(live, cov=live.cov + np.array([1e6, 0.0, 0.0]))
    shared = xy.copy()
    shared[parts[2][1]] = shared[parts[2][0]] + [300.0, 0.0]
    assert len(follow(xy, parts, frames, wide)[1]) > 0
    assert follow(shared, parts, frames, wide)[1] == [], "one detection is the nearest of both"
    new = PredictedBalls.start(live.number, 1, live.xy, NOISE)
    assert follow(xy, parts, frames, new) == (new, [])


def test_they_stop_before_balls_may_meet():
    frames = list(range(40))
    ways = np.stack([np.column_stack([3.0 * np.arange(40), np.zeros(40)]), np.tile([90.0, 0.0], (40, 1))], axis=1)
    xy, parts = ways.reshape(-1, 2), list(np.arange(80).reshape(40, 2))
    _, rows = follow(xy, parts, frames, seen_twice(xy, parts, frames))
    last = 1 + len(rows)
    apart = ways[:, 1, 0] - ways[:, 0, 0]
    reach = (1 + 3 * NOISE.distance) * NOISE.diameter
    assert apart[last] < reach + 3.1, "the next step may bring them within a diameter"
    assert apart[last - 1] > reach + 2.9, "the step before could not"


def film_hit(rng):
    """Glints of two balls that hit, one of them lost in two frames."""
    ways = collision(40, contact=rng.uniform(12, 20), speed=rng.uniform(2, 12), offset=rng.uniform(-0.9, 0.9))
    frame, ball = np.nonzero(np.isfinite(ways[..., 0]))
    kept = ~(((frame == 7) & (ball == 0)) | ((frame == 25) & (ball == 1)))
    frame, ball = frame[kept], ball[kept]
    x, y = (ways[frame, ball] + 0.02 * rng.standard_normal((len(frame), 2))).T
    found = Glints.at(x, y, 0.01, 1200.0)
    found.frame[:] = frame
    return found


def test_tracks_of_collisions_are_the_same_without_them(monkeypatch):
    rng, taken, camera = np.random.default_rng(8), [], Camera.from_dict(CAMERA)
    films = [film_hit(rng) for _ in range(12)]

    def count(*given):
        taken.append(len(follow_apart(*given)[1]))
        return follow_apart(*given)

    monkeypatch.setattr(link, "follow_apart", count)
    quick = [assign_track_numbers(film, camera) for film in films]
    assert sum(taken) > 12 * 20, "most frames are plain"
    monkeypatch.setattr(link, "follow_apart", lambda balls, *_: (balls, []))
    for numbers, film in zip(quick, films, strict=True):
        assert set(numbers.tolist()) == {0, 1}
        assert np.array_equal(numbers, assign_track_numbers(film, camera))
