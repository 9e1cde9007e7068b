"""Glints smeared along another line than any track tells: each is placed by the blur that its own shape shows."""

from dataclasses import replace

import numpy as np
import pytest
from tracker_film import CAMERA, expose, film_of_lost_balls, spot

from tracker.camera.camera import Camera
from tracker.camera.film_in_memory import wrap_frames
from tracker.camera.recordings import Recording
from tracker.detection.detect import detect, make_view
from tracker.detection.glints import PositionFlag
from tracker.settings import LinkSettings, TrackerSettings

CAM = Camera.from_dict({k: v for k, v in CAMERA.items() if k != "lamp"})  # no lamp: the profile is centred on the glint
FAST = TrackerSettings(link=LinkSettings(max_speed_m_s=4.0))


def place(frames, name="maximum_likelihood", settings=FAST, camera=CAM):
    clip = Recording(0, camera, wrap_frames(frames))
    return detect(clip, make_view(clip, name, settings), name).glints


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


def test_a_long_smear_is_placed_in_a_window_that_holds_it():
    """Linear fits, for crowds. Their windows for glints at rest hold 5 px."""
    frames, places = film_of_lost_balls(np.random.default_rng(5), 60, 10.0)
    found = place(frames, "linear_fit")
    off = found.xy - places[found.frame]
    own = np.hypot(*off.T) < 3
    assert own.sum() >= 58
    z = off[own] / np.sqrt(found.cov[own][:, [0, 1], [0, 1]])
    assert np.median(np.abs(off[own])) < 0.03
    assert np.median(np.abs(z)) < 1.0


@pytest.mark.parametrize("name", ["maximum_likelihood", "linear_fit"])
def test_a_smear_with_several_candidates_is_one_glint(name):
    """Candidates lie at least 12 px apart, and the smears are up to 22 px long."""
    frames, places = film_of_lost_balls(np.random.default_rng(5), 40, 22.0)
    found = place(frames, name, TrackerSettings(), replace(CAM, exposure=4e-3))
    off = np.hypot(*(found.xy - places[found.frame]).T)
    count = np.bincount(found.frame[off < 0.8 * 7.44], minlength=40)
    assert (count <= 1).all()
    assert (count == 1).sum() >= 36
    assert np.median(off) < 0.04


def test_a_smear_that_no_window_holds_is_placed_on_its_line():
    """A window of 3/4 diameter on each side would be larger than the picture, and begin again at its other edge."""
    camera = Camera.from_dict(CAMERA | {"size": [60, 16], "ball_diameter": 40 * 1.6e-4})
    rng, middles = np.random.default_rng(1), 20.0 + 4.0 * (np.arange(12) % 5)
    smears = [spot((16, 60), middle, 8.0, 1.0, (45.0, 0.0), steps=300) for middle in middles]
    found = place(np.array([expose(rng, 0.5 + 6000 * smear) for smear in smears]), "linear_fit", camera=camera)
    assert set(found.frame) == set(range(12))
    assert np.abs(found.y - 8.0).max() < 0.1
