"""How far off positions will be: the Cramer-Rao bound of a glint, which the tracker attains, or what a user says."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from discrepancy.arrays import Array
from tracker.camera.camera import Camera
from tracker.detection.likelihood.cramer_rao import glint_shape, localisation_bound, localisation_bound_fixed

WINDOW = 4  # half widths, px, of a glint's window over its own width, to find its peak pixel's share


@dataclass(frozen=True)
class StatedErrors:
    """Errors that are white and alike everywhere. std: each axis, px."""

    std: float

    def covariances(self, camera: Camera, glints: Array, blur: Array) -> tuple[Array, Array]:
        """As of `GlintErrors`."""
        return np.tile(self.std**2 * np.eye(2), (len(glints), 1, 1)), np.zeros((len(glints), 2, 2))

    def brighter(self, times: float) -> None:
        """Nobody knows what more light would do to errors that were only stated."""
        return


@dataclass(frozen=True)
class GlintErrors:
    """Errors of glints, from the light that they send to the sensor.

    Attributes
    ----------
    peak : float
        Counts above black at the peak of a resting ball's glint, before clipping.
    room : float
        What a ball mirrors beside the lamp, over that peak.
    """

    peak: float
    room: float = 0.0

    def covariances(self, camera: Camera, glints: Array, blur: Array) -> tuple[Array, Array]:
        """Covariances of positions.

        Parameters
        ----------
        camera : Camera
        glints : (n, 2) array
            Where the glints are, px.
        blur : (n, 2) array
            How far they move in an exposure, px.

        Returns
        -------
        covariance, fixed : (n, 2, 2) array
            px^2; the second is the part of the first that a ball at rest has in every frame alike.

        References
        ----------
        `tracker.detection.likelihood.cramer_rao.localisation_bound`: position, flux and background free, the sensor's
        noise by EMVA 1288, clipping counted. `make bench-localisation` holds the tracker against it.
        """
        if camera.sigma is None:
            raise ValueError("the bound needs psf.sigma_px")
        half = int(np.ceil(WINDOW * camera.sigma))
        share = float(glint_shape(np.zeros((1, 2)), np.zeros((1, 2)), camera.sigma, half).value.max())
        flux = np.full(len(glints), self.peak / share)
        ground = camera.sensor.black_level + self.room * self.peak
        return localisation_bound(camera, flux, glints, blur, ground), localisation_bound_fixed(camera, flux, glints)

    def brighter(self, times: float) -> GlintErrors:
        """With so many times as much light."""
        return dataclasses.replace(self, peak=times * self.peak)


Errors = StatedErrors | GlintErrors
