"""Fresnel's reflectance of a metal against complex amplitudes, roughness against tilted facets."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from synthcam.camera import reflections
from synthcam.camera.glints import find_glints
from synthcam.camera.pinhole import Lamp, PinholeCamera
from synthcam.camera.surface import IRON_N_K, Surface, fresnel

R = 1.19e-3
LAMP = Lamp(np.array([0.05, 0.0, 0.45]), 0.01)
CAMERA = PinholeCamera.overhead((640, 480), 1.6e-4, 0.5, ball_radius=R, fps=250, exposure=5e-4, psf_sigma_px=1.0)


@given(st.floats(0.1, 5), st.floats(0.01, 5), st.floats(0.01, 1))
def test_fresnel_is_that_of_complex_amplitudes(n, k, cosine):
    index = n + 1j * k
    inside = np.sqrt(1 - (1 - cosine**2) / index**2)
    across = (cosine - index * inside) / (cosine + index * inside)
    along = (index * cosine - inside) / (index * cosine + inside)
    expected = (abs(across) ** 2 + abs(along) ** 2) / 2
    assert fresnel(np.array([cosine]), n, k)[0] == pytest.approx(expected, rel=1e-9)


def test_iron_reflects_half():
    assert Surface(steel=IRON_N_K).head_on == pytest.approx(0.513, abs=1e-3)
    assert Surface().head_on == 0.55
    assert Surface(steel=IRON_N_K).mirror(np.array([1e-6]))[0] == pytest.approx(1, abs=1e-4)


def test_roughness_is_what_tilted_facets_make_of_it():
    """A facet tilted by a moves the image as turning the ball's normal does: on a sphere, by radius times a."""
    centres, radii = np.array([[[0.01, 0, R], [0.01, 2 * R, R]]]), np.full(2, R)
    wanted = np.ones((1, 2), bool)
    sharp = find_glints(CAMERA, LAMP, centres, radii, wanted)
    rough = find_glints(CAMERA, LAMP, centres, radii, wanted, Surface(roughness=0.02))
    np.testing.assert_array_equal(sharp.flux, rough.flux)
    grown = (rough.spread - sharp.spread)[sharp.order == 1]
    np.testing.assert_allclose(grown, (0.02 * R / CAMERA.scale) ** 2, rtol=0.02)
    # Second order: turn the normals of either ball by hand and let Newton find the tilted path.
    eye, chain = CAMERA.centre, np.array([[0, 1]])
    paths = reflections.reflect(LAMP.position, eye, centres[0][chain], radii[chain])
    tilts = reflections.differentiate_by_tilt(LAMP.position, eye, paths, centres[0][chain], radii[chain])
    assert tilts.shape == (1, 3, 4)
    moved = CAMERA.project_with_slope(paths.points[:, -1])[1] @ tilts
    faint = np.flatnonzero((sharp.order == 2) & (sharp.ball == 1))
    np.testing.assert_allclose(
        (rough.spread - sharp.spread)[faint][0], 0.02**2 * (moved[0] ** 2).sum(axis=1), rtol=1e-9
    )


def test_scratches_move_light_into_a_wider_lobe():
    centres, radii, wanted = np.array([[[0, 0, R]]]), np.array([R]), np.ones((1, 1), bool)
    plain = find_glints(CAMERA, LAMP, centres, radii, wanted)
    scratched = find_glints(CAMERA, LAMP, centres, radii, wanted, Surface(scratches=0.3, scratch_slope=0.1))
    np.testing.assert_allclose(scratched.flux, plain.flux * [0.7, 0.3])
    np.testing.assert_array_equal(scratched.spread[0], plain.spread[0])
    assert scratched.spread[1].min() > 0.9 * (0.1 * R / CAMERA.scale) ** 2
