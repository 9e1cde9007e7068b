"""Defocus and diffraction against the same spot blurred on a fine grid, and against Airy's own formula."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.signal import fftconvolve
from scipy.special import j1

from synthcam.camera.exposure import integrate_spots
from synthcam.camera.psf import Psf

FINE = 24
POSITION = (7.5 / FINE, -4.5 / FINE)  # a sample of the fine grid


def spot(psf, position=POSITION, width=None):
    width = width or 2 * psf.margin + 1
    rows, columns = integrate_spots(
        np.array([position]) + psf.margin, np.full((1, 2), psf.sigma**2), np.zeros((1, 2)), width, psf.steps
    )
    patch = (rows.T @ columns)[None].astype(np.float32)
    return psf.spread(patch)[0]


def brute(psf, kernel, position=POSITION):
    """The same by a grid of 24 samples a pixel: kernel, Gaussian, pixel."""
    width = 2 * psf.margin + 1
    image = np.zeros((width * FINE, width * FINE))
    column, row = ((np.array(position) + psf.margin + 0.5) * FINE - 0.5).round().astype(int)
    image[row, column] = 1
    image = gaussian_filter(fftconvolve(image, kernel, mode="same"), psf.sigma * FINE)
    return image.reshape(width, FINE, width, FINE).sum(axis=(1, 3))


def kernel(radius, shape):
    side = np.arange(-int(radius * FINE), int(radius * FINE) + 1) / FINE
    out = shape(np.hypot(side[:, None], side))
    return out / out.sum()


@pytest.mark.parametrize("sigma", [0.4, 1.0])
def test_defocus_is_a_disc(sigma):
    psf = Psf(sigma, defocus=2.5)
    got, want = spot(psf), brute(psf, kernel(3, lambda r: r < 2.5))
    assert np.abs(got - want).max() < 0.01 * want.max()
    assert got.sum() == pytest.approx(1, abs=1e-4)
    down, across = np.mgrid[: len(got), : len(got)] - psf.margin
    for axis in (across, down):
        assert (got * axis).sum() == pytest.approx((want * axis).sum(), abs=1e-3)
    assert np.abs(brute(psf, kernel(3, lambda r: r < 2.3)) - want).max() > 0.05 * want.max()


def test_diffraction_is_airys():
    psf = Psf(0.5, airy=1.2)

    def airy(r):
        v = np.maximum(np.pi * r / 1.2, 1e-9)
        return (2 * j1(v) / v) ** 2

    got, want = spot(psf), brute(psf, kernel(psf.margin, airy))
    middle = np.s_[psf.margin - 4 : psf.margin + 5]
    want *= 0.975  # of all light, within the margin
    assert np.abs(got - want)[middle, middle].max() < 0.01 * want.max()
    assert got.sum() == pytest.approx(1, abs=1e-4)
    frequency = np.array([0.0, 0.3, 1 / 1.2, 2.0])
    s = 0.36
    between = 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))
    np.testing.assert_allclose(psf.transfer(frequency), [1, between, 0, 0], atol=1e-9)


def test_a_plain_gaussian_is_left_alone():
    assert Psf(1.0).is_gaussian
    assert Psf(1.0).steps == 1
    assert Psf(1.0).margin == 5
    assert not Psf(1.0, defocus=0.1).is_gaussian
    assert Psf(0.3, airy=0.1).steps == 4
