"""Balls drawn in squares, each by a short program, against the same balls drawn whole: every bit is the same."""

import numpy as np
import pytest

from synthcam.camera.pinhole import Lamp, PinholeCamera
from synthcam.camera.render import MirrorRenderer, mirror_renderer
from synthcam.camera.render.canvas import get_canvas
from synthcam.camera.surface import IRON_N_K, Surface

R = 1.19e-3
LAMP = Lamp(np.array([0.05, 0.0, 0.45]), 0.01)
NO_BREAKS = np.zeros(0)


def overhead(**changes):
    settings = {"size": (256, 192), "scale": 1.0e-4, "height": 0.5, "ball_radius": R}
    return PinholeCamera.overhead(**settings | {"fps": 250, "exposure": 5e-4, "psf_sigma_px": 1.0} | changes)


def film(camera, starts, velocities, surface, frames):
    """Pictures of balls that move straight from starts (N, 2), m, at velocities (N, 2), m/s."""
    starts, velocities = np.array(starts, float), np.array(velocities, float)

    def centres(t):
        at = starts + velocities * t[:, None, None]
        return np.concatenate([at, np.full((*at.shape[:2], 1), R)], axis=2)

    opens = np.arange(frames) / camera.fps
    renderer = MirrorRenderer(camera, LAMP, [R] * len(starts), surface=surface)
    spans = np.stack([opens, opens + camera.exposure], axis=1)
    return np.stack([picture.image for picture in renderer.frames(centres, spans, NO_BREAKS)])


@pytest.mark.parametrize(
    ("changes", "starts", "velocities", "surface"),
    [
        pytest.param({}, [(-4e-3, 0), (1e-3, 2e-4)], [(0.1, 0), (0, 0)], Surface(), id="approach to contact"),
        pytest.param({}, [(-6e-3, -4e-3), (6e-3, 4e-3)], [(0.2, 0.1), (-0.3, 0)], Surface(), id="two in a tile"),
        pytest.param(
            {"exposure": 1e-3}, [(-6e-3, 0), (6e-3, 4e-3)], [(0.3, 0), (-0.3, 0)], Surface(), id="three in a tile"
        ),
        pytest.param({"height": 0.02}, [(-5e-3, 2e-3), (0, 4e-3)], [(0.1, 0.1), (0.1, 0)], Surface(), id="near camera"),
        pytest.param(
            {"tilt": (0.9, 0.3)}, [(-1e-3, -3e-3), (0, 3e-3)], [(0, 0.1), (0, 0)], Surface(), id="one behind the other"
        ),
        pytest.param({}, [(-4e-3, 0), (3e-3, 2e-3)], [(0.1, 0), (0, 0)], Surface(steel=IRON_N_K), id="Fresnel's laws"),
        pytest.param({"scale": 4e-5}, [(-3e-3, 0), (3e-3, 1e-3)], [(0.1, 0), (0, 0)], Surface(), id="large balls"),
        pytest.param({}, [(-4e-3, 0)], [(0.4, 0.1)], Surface(), id="one ball"),
    ],
)
def test_squares_draw_the_bits_of_whole_balls(changes, starts, velocities, surface, monkeypatch):
    if not get_canvas().is_software:
        pytest.skip("a graphics card draws whole balls")
    divided, divide = [], mirror_renderer.divide_balls

    def note(*balls):
        divided.append(divide(*balls))
        return divided[-1]

    monkeypatch.setattr(mirror_renderer, "divide_balls", note)
    parted = film(overhead(**changes), starts, velocities, surface, 8)
    monkeypatch.setattr(mirror_renderer, "divide_balls", lambda *balls: None)
    whole = film(overhead(**changes), starts, velocities, surface, 8)
    assert any(divided)  # otherwise the two films are one
    assert np.ptp(whole) > 0.1
    np.testing.assert_array_equal(parted, whole)
