"""A rolling shutter against as many global ones as there are rows; flicker against many short exposures."""

from dataclasses import replace

import numpy as np
import pytest

from synthcam.camera.lamp import Flicker, Lamp
from synthcam.camera.pinhole import PinholeCamera
from synthcam.camera.render import MirrorRenderer
from synthcam.scene import ground_truth
from synthcam.scene.scene import check_scene

R = 1.19e-3
LAMP = Lamp(np.array([0.05, 0.0, 0.45]), 0.01)


def overhead(**changes):
    settings = {"size": (120, 80), "scale": 1e-4, "height": 0.5, "ball_radius": R}
    return PinholeCamera.overhead(**settings | {"fps": 250, "exposure": 1e-3, "psf_sigma_px": 1.0} | changes)


def collision(times):
    x, z = 0.6 * (times - 1.2e-3), 0 * times + R
    struck = np.stack([np.maximum(x, 0) * 0.8, np.maximum(x, 0) * 0.2, z], -1)
    striker = np.stack([np.minimum(x, 0.2 * x) - 2 * R, 0.4 * np.minimum(x, 0) - 0.1 * np.maximum(x, 0), z], -1)
    return np.stack([struck, striker], axis=1)


@pytest.mark.parametrize("line", [pytest.param(1e-6, marks=pytest.mark.gate), 2e-5])
@pytest.mark.parametrize("depth", [0.0, 0.3])
def test_each_row_is_exposed_in_its_own_time(line, depth):
    lamp = replace(LAMP, flicker=Flicker(depth, 120.0, 1.0))
    (picture,) = MirrorRenderer(overhead(line_time=line), lamp, [R, R], 0.1).frames(collision, [[0, 1e-3]], [1.2e-3])
    starts = np.arange(80) * line
    rows = list(MirrorRenderer(overhead(), lamp, [R, R], 0.1).frames(collision, np.c_[starts, starts + 1e-3], [1.2e-3]))
    expected = np.stack([row.image[k] for k, row in enumerate(rows)])
    assert np.abs(picture.image - expected).max() < 3e-4
    assert np.abs(picture.plate - np.stack([row.plate[k] for k, row in enumerate(rows)])).max() < 1e-6
    assert np.abs(rows[0].image - expected).max() > 3e-3  # a global shutter sees something else
    outside = picture.image != picture.plate
    for box in picture.boxes:
        outside[box] = False
    assert not outside.any()


def test_a_rolling_shutter_on_an_empty_plate():
    film = MirrorRenderer(overhead(line_time=1e-5), LAMP, [R], 0.1)
    (picture,) = film.frames(lambda t: np.tile([[[1.0, 0, R]]], (len(t), 1, 1)), [[0, 1e-3]])
    assert picture.boxes == ()
    np.testing.assert_array_equal(picture.image, film.plate)


def test_flicker_over_a_long_exposure():
    film = MirrorRenderer(overhead(), replace(LAMP, flicker=Flicker(0.5, 100.0, 0.3)), [R, R], 0.1)
    (long,) = film.frames(collision, [[0, 4e-3]], [1.2e-3])
    instants = (np.arange(300) + 0.5) / 300 * 4e-3
    mean = np.mean([p.image for p in film.frames(collision, np.c_[instants, instants])], axis=0)
    assert np.abs(long.image - mean).max() < 1e-3
    (steady,) = MirrorRenderer(overhead(), LAMP, [R, R], 0.1).frames(collision, [[0, 4e-3]], [1.2e-3])
    assert np.abs(long.image - steady.image).max() > 0.02


@pytest.mark.parametrize("shutter", ["global", "rolling"])
def test_the_truth_stands_where_the_picture_shows_it(shutter):
    camera = {"shutter": shutter, "line_time": 2e-5, "size": [320, 240]}
    launch = {"kind": "single", "v0": 0.5, "heading": 1.1, "contact": [0, 0]}
    settings = {"name": "r", "camera": camera, "launch": launch, "timing": {"frames": 8, "contact_frame": 4.2}}
    clip = check_scene(settings | {"lamp": {"room": 0.0}}, "r").draw(0, 0)
    view = clip.view
    table = ground_truth.make_true_tracks(clip.launch.bodies, view, clip.lamp, clip.frames)
    drawn, (down, across) = replace(view, camera=replace(view.camera, line_time=0.0)), np.mgrid[:240, :320]
    film = MirrorRenderer(clip.camera, clip.lamp, [clip.model.ball.radius], clip.room)
    pictures = film.frames(lambda t: drawn.at(t)[:, :, :3].transpose(1, 0, 2), drawn.spans(8), drawn.breaks())
    for picture, (_, row) in zip(pictures, table.iterrows(), strict=True):
        light = picture.image - picture.plate
        seen = np.array([(light * across).sum(), (light * down).sum()]) / light.sum()
        np.testing.assert_allclose(seen, [row["glint_x_px"], row["glint_y_px"]], atol=1e-3)
