"""Glints smeared along another line than any track tells: each is placed by the blur that its own shape shows."""

import numpy as np
import pytest
from tracker_film import CAMERA, disc, expose, spot

from tracker.camera.camera import Camera
from tracker.camera.film_in_memory import wrap_frames
from tracker.camera.recordings import Recording
from tracker.detection.detect import detect, make_view
from tracker.detection.glints import PositionFlag
from tracker.settings import LinkSettings, TrackerSettings

CAM = Camera.from_dict({k: v for k, v in CAMERA.items() if k != "lamp"})  # no lamp: the profile is centred on the glint
FAST = TrackerSettings(link=LinkSettings(max_speed_m_s=4.0))


def film_of_lost_balls(rng, count, longest, bend=None):
    """Frames with one ball each, far from the one before, smeared in any direction; and the mean positions (n, 2).

    bend: angle by which it turns in the middle of the exposure.
    """
    frames, places = [], []
    for _ in range(count):
        x, y = rng.uniform([30, 30], [170, 130])
        length, angle = rng.uniform(3.0, longest), rng.uniform(0, 2 * np.pi)
        ways = [length * np.array([np.cos(a), np.sin(a)]) for a in (angle, angle + (bend or 0.0))]
        picture = np.full((160, 200), 0.5) + 4 * disc((160, 200), x, y, 7.44)
        if bend is None:
            picture += 1600 * spot(picture.shape, x, y, 1.0, ways[0])
            places.append((x, y))
        else:
            halves = [np.array([x, y]) + side * way / 4 for side, way in zip((-1, 1), ways, strict=True)]
            for (column, row), way in zip(halves, ways, strict=True):
                picture += 800 * spot(picture.shape, column, row, 1.0, way / 2)
            places.append(np.mean(halves, axis=0))
        frames.append(expose(rng, picture))
    return np.array(frames), np.array(places)


def place(frames):
    clip = Recording(0, CAM, wrap_frames(frames))
    return detect(clip, make_view(clip, settings=FAST)).glints


@pytest.mark.parametrize("longest", [5.0, 10.0])
def test_a_lost_ball_is_placed_as_well_as_its_error_says(longest):
    frames, places = film_of_lost_balls(np.random.default_rng(3), 60, longest)
    found = place(frames)
    off = found.xy - places[found.frame]
    own = np.hypot(*off.T) < 4
    assert own.sum() >= 57
    z = (np.linalg.inv(np.linalg.cholesky(found.cov)) @ off[..., None])[own, :, 0]
    assert 0.7 < np.mean(z**2) < 1.4  # 114 numbers: 0.87 to 1.13 is one deviation
    assert np.max(np.abs(z)) < 5
    assert np.mean(found.flags[own] & PositionFlag.MISFIT > 0) < 0.1
    assert np.median(np.sqrt(found.cov[own, 0, 0])) < 0.05  # px; their errors are not wide because they are misfits


def test_a_ball_that_is_hit_during_the_exposure_is_at_its_mean_position():
    frames, places = film_of_lost_balls(np.random.default_rng(4), 60, 5.0, bend=0.8)
    found = place(frames)
    off = np.hypot(*(found.xy - places[found.frame]).T)
    assert np.median(off[off < 4]) < 0.03
    assert np.sqrt(np.mean(off[off < 4] ** 2)) < 0.06
