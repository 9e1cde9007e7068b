"""The detector that a film asks for."""

import numpy as np
import pytest
from tracker_discs import CAMERA, apart, collision, film, plate
from tracker_film import CAMERA as STEEL
from tracker_film import expose, spot

import tracker
from tracker.camera.camera import Camera
from tracker.camera.film_in_memory import wrap_frames
from tracker.detection.candidates import estimate_pixel_noise
from tracker.detection.choose import choose_detector

BARE = Camera.unknown((200, 160), 8)


@pytest.mark.parametrize("camera", [BARE, Camera.from_dict(CAMERA)])
@pytest.mark.parametrize(("ball", "level"), [(210.0, 70.0), (25.0, 150.0)])
def test_bright_and_dark_bodies_are_discs(camera, ball, level):
    rng = np.random.default_rng(0)
    pictures = film(rng, collision(30, 12), ball, ground=plate(rng, level))
    name, why = choose_detector(wrap_frames(pictures), camera)
    assert name == "discs"
    assert "bodies of 19 px" in why


@pytest.mark.parametrize("ball", [210.0, 25.0])
def test_bodies_that_cover_a_tenth_of_the_picture_are_not_taken_for_noise(ball):
    """Twelve discs move by more than their size between the frames of the sample, so every fifth pixel changes."""
    rng, frames = np.random.default_rng(6), []
    middles = np.array([(25 + 50 * i, 27 + 53 * k) for i in range(4) for k in range(3)])
    phases = rng.uniform(0, 2 * np.pi, len(middles))
    for k in range(40):
        angle = phases + 0.9 * k
        centres = middles + 14 * np.column_stack([np.cos(angle), np.sin(angle)])
        picture = np.full((160, 200), 110.0)
        for x, y in centres:
            away = np.hypot(*np.ogrid[-y : 160 - y, -x : 200 - x])
            picture += (ball - 110) * np.clip(10.5 - away, 0, 1)
        frames.append(np.clip(np.rint(picture + 2 * rng.standard_normal(picture.shape)), 0, 255).astype(np.uint8))
    sample = [frames[k] for k in range(0, 40, 5)]
    assert estimate_pixel_noise(sample) == pytest.approx(2.0, rel=0.1)
    name, why = choose_detector(wrap_frames(np.array(frames)), BARE)
    assert name == "discs"
    assert "bodies of 20 px" in why


@pytest.mark.parametrize("camera", [BARE, Camera.from_dict(STEEL)])
@pytest.mark.parametrize("peak", [30.0, 200.0, 3000.0])
@pytest.mark.parametrize("body", [0.0, 0.1])
def test_steel_balls_are_glints(camera, peak, body):
    """Dim or clipped, with the room mirrored in the ball too."""
    rng, frames = np.random.default_rng(1), []
    for k in range(30):
        x = 20.3 + 5 * k
        ball = body * min(peak, 250) * (np.hypot(*np.ogrid[-80:80, -x : 200 - x]) < 7.4)
        frames.append(expose(rng, 8 + peak * spot((160, 200), x, 80.0, 1.2) * 2 * np.pi * 1.44 + ball))
    assert choose_detector(wrap_frames(np.array(frames)), camera) == ("maximum_likelihood", "")


def test_a_film_of_powder_is_left_to_linear_fits():
    """Maximum likelihood fits each of the specks: 300 frames of powder took minutes."""
    rng = np.random.default_rng(4)
    frames = rng.integers(6, 12, (12, 160, 200), dtype=np.uint8)
    for frame in frames:
        for x, y in rng.integers(4, 150, (90, 2)):
            frame[y : y + 2, x : x + 2] = 200
    name, why = choose_detector(wrap_frames(frames), BARE)
    assert name == "linear_fit"
    assert "bright specks, too many for maximum_likelihood" in why
    few = rng.integers(6, 12, (12, 160, 200), dtype=np.uint8)
    few[:, 40:42, 40:100:6] = 200
    assert choose_detector(wrap_frames(few), BARE) == ("maximum_likelihood", "")


def test_glints_no_brighter_than_the_plate_leave_the_discs():
    """Steel on an overexposed plate: of its glint nothing stands out, its outline does."""
    rng = np.random.default_rng(3)
    ways = collision(30, 12)
    pictures = film(rng, ways, 20.0, ground=plate(rng, 270.0, 0.0)).astype(float)
    for picture, *places in zip(pictures, *ways, strict=True):
        for x, y in places:
            picture += 700 * spot(picture.shape, x, y, 1.2) * 2 * np.pi * 1.44
    frames = wrap_frames(np.clip(pictures, 0, 255).astype(np.uint8))
    assert choose_detector(frames, Camera.from_dict(CAMERA))[0] == "discs"


def test_the_choice_is_said_and_can_be_forced():
    pictures = film(np.random.default_rng(2), apart(30))
    result = tracker.track(pictures, CAMERA)
    assert [note for note in map(str, result.notes) if note.startswith("detector: discs")]
    assert len(np.unique(result.found.particle)) == 2
    known = {key: STEEL[key] for key in ("psf", "sensor")}  # else they are estimated first
    forced = tracker.track(pictures[:3], CAMERA | known, detector="maximum_likelihood")
    assert not [note for note in map(str, forced.notes) if note.startswith("detector")]
