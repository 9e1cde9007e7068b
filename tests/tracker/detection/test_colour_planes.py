"""Balls among shadows, hands and cues: the planes of a film in colour, and the choice of one."""

import numpy as np
import pytest
from tracker_colours import FRAMES, GREEN, ORANGE, SKIN, WOOD, cluster, cue, draw, hand, smeared_ring
from tracker_discs import CAMERA, apart, recorded

import tracker
from synthcam_shared.errors import InputError
from tracker.camera.camera import Camera
from tracker.camera.camera_keys import PLANES
from tracker.camera.colour_planes import read_plane
from tracker.camera.film_in_memory import wrap_frames
from tracker.detection.detect import detect, make_view


def count(result, ways, gate=1.5):
    """Balls found and false positions of a result."""
    found = false = 0
    for k in range(ways.shape[1]):
        seen = result.found.xy[result.found.frame == k]
        away = np.hypot(*(seen[:, None] - ways[:, k][None]).transpose(2, 0, 1))
        hits = int((away.min(axis=0, initial=99) < gate).sum())
        found, false = found + hits, false + len(seen) - hits
    return found, false


@pytest.mark.parametrize(("name", "expected"), [
    ("red-green", 128 + 127 * (235 - 150) / (415 + 3 * 0.15 * 255)),
    ("red-blue", 128 + 127 * (235 - 30) / (415 + 3 * 0.15 * 255)),
    ("green-blue", 128 + 127 * (150 - 30) / (415 + 3 * 0.15 * 255)),
    ("red", 235), ("blue", 30), ("#eb961e", 200), ("#1c7d62", 0),
])  # fmt: skip
def test_a_plane_has_the_counts_of_its_formula(name, expected):
    cloth = np.full((8, 8, 3), GREEN).astype(np.uint8)
    plane = read_plane(name, lambda: [cloth] * 3, 255.0)(np.full((1, 1, 3), ORANGE).astype(np.uint8))
    assert plane.dtype == np.uint8
    assert abs(float(plane[0, 0]) - expected) < 0.51


@pytest.mark.parametrize("name", [*PLANES, "#eb961e"])
def test_a_shadow_hardly_shows_beside_a_ball(name):
    """The distance saturates, and knows of no shadow in this sample: it may take two fifths of the ball's counts."""
    cloth, ball = (np.full((8, 8, 3), colour).astype(np.uint8) for colour in (GREEN, ORANGE))
    read = read_plane(name, lambda: [cloth] * 3, 255.0)
    ground, dark, seen = (float(read(p).mean()) for p in (cloth, (cloth * 0.6).astype(np.uint8), ball))
    assert abs(dark - ground) < (0.4 if name == "colour" else 0.125) * abs(seen - ground)
    deep = read_plane(name, lambda: [cloth * np.uint16(257)] * 3, 65535.0)(ball * np.uint16(257))
    assert abs(float(deep.mean()) - seen) < 1


@pytest.mark.parametrize(("ball", "people"), [
    *(pytest.param(ORANGE, people, marks=pytest.mark.gate) for people in ((), ((hand, SKIN),), ((cue, WOOD),))),
    ((190.0, 40.0, 60.0), ((hand, SKIN), (cue, WOOD))),
])  # fmt: skip
def test_shadows_hands_and_cues_are_no_balls(ball, people):
    ways = apart(FRAMES)[:1] + np.array([25.0, -5.0])
    result = tracker.track(draw(ways, [ball], people=people), CAMERA)
    assert count(result, ways) == (FRAMES, 0)
    assert any(str(note).startswith("channel: ") for note in result.notes)


@pytest.mark.parametrize(("name", "seen"), [("plate", True), ("colour", False), ("red-blue", True)])
def test_a_ball_that_always_rests_shows_in_the_plane_of_the_plate(name, seen):
    """Beside the cloth, in light that falls off to a fifth; "colour" takes it for the cloth."""
    rng, ways = np.random.default_rng(0), np.repeat(apart(1)[:1], 9, axis=1)
    light = np.linspace(0.2, 1.0, 200)[None, :, None]
    films = draw(ways, [ORANGE], shadow=False) * light + rng.normal(0, 1.0, (9, 160, 200, 3))
    films = np.clip(np.rint(films), 0, 255).astype(np.uint8)
    plane = read_plane(name, lambda: list(films), 255.0)(films[4]).astype(float)
    x, y = np.rint(ways[0, 0]).astype(int)
    ball, cloth = plane[y - 4 : y + 5, x - 4 : x + 5], np.delete(plane, slice(y - 15, y + 16), axis=0)
    assert (np.median(ball) - np.median(cloth) > 40) == seen


def test_a_black_ball_differs_from_the_deepest_shadow_in_the_plane_of_the_plate():
    """Both have a fifth of the light of the cloth. In shares of colours an offset of black makes them alike."""
    rng, black = np.random.default_rng(0), 8.0
    light = np.tile(np.linspace(0.5, 1.0, 200), (160, 1))
    light[100:130, 40:90] = 0.15  # a shadow
    picture = black + light[..., None] * np.array(GREEN)
    picture[40:60, 40:60] = black + 12.0
    sample = [np.clip(np.rint(picture + rng.normal(0, 1.0, picture.shape)), 0, 255).astype(np.uint8) for _ in range(5)]
    plane = read_plane("plate", lambda: sample, 255.0)(sample[0]).astype(float)
    assert np.median(plane[42:58, 42:58]) > 150
    assert np.median(plane[103:127, 43:87]) < 50


def test_balls_of_two_colours_are_whole_discs():
    ways = np.stack([apart(FRAMES)[0] + [10.0, -10.0], apart(FRAMES)[1] + [10.0, -15.0]])
    pictures = draw(ways, [((20.0, 120.0, 60.0), (225.0, 200.0, 150.0)), ((30.0, 60.0, 110.0), (225.0, 200.0, 150.0))],
                    (205.0, 210.0, 200.0), shadow=False)  # fmt: skip
    result = tracker.track(pictures, CAMERA)
    assert count(result, ways, 2.0)[1] == 0
    assert count(result, ways, 2.0)[0] >= 2 * FRAMES - 2
    assert any(str(note).startswith("channel: colour, ") for note in result.notes)


@pytest.mark.parametrize(("bend", "colours", "ground"), [
    (0.9, ((190.0, 40.0, 60.0), (30.0, 60.0, 110.0), (20.0, 120.0, 60.0)), (205.0, 210.0, 200.0)),
    (1.57, (ORANGE, ORANGE, (190.0, 40.0, 60.0)), GREEN),
])  # fmt: skip
def test_balls_that_touch_all_the_time_are_each_found(bend, colours, ground):
    """In a bent chain. Differences of two colours show two of the first three only, and no plane a ball alone."""
    ways = cluster(3, bend, 16)
    assert count(tracker.track(draw(ways, colours, ground, shadow=False), CAMERA), ways) == (3 * 16, 0)


@pytest.mark.parametrize("gap", [0.0, 1.0, 2.0])
def test_balls_whose_colours_an_encoder_has_smeared_into_each_other(gap):
    """Of 48; at gaps of 0 and 1 px, single fits find 36 and 42."""
    ways, pictures = smeared_ring(gap)
    camera = Camera.from_dict({"size": [360, 200], "fps": 60.0, "scale": 1e-3, "ball_diameter": 0.029})
    clip = recorded(pictures, camera).select_channel("colour")
    found = detect(clip, make_view(clip, "discs"), "discs").glints
    away = ways[:, found.frame] - found.xy
    nearest = np.hypot(away[..., 0], away[..., 1]).argmin(axis=0)
    assert sorted(zip(found.frame.tolist(), nearest.tolist(), strict=True)) == [
        (k, n) for k in range(12) for n in range(4)
    ]
    assert np.sqrt((away[nearest, np.arange(len(found))] ** 2).mean()) < 0.4  # px


def test_a_wrong_channel_is_one_line():
    with pytest.raises(InputError, match=r"expected one of grey, red, green, blue, dark, red-green, .*or #rrggbb"):
        wrap_frames(np.zeros((3, 20, 20, 3), np.uint8)).select_channel("#12345")
    with pytest.raises(InputError, match="the film is in grey, expected no 'red-blue'"):
        wrap_frames(np.zeros((3, 20, 20), np.uint8)).select_channel("red-blue")
