"""Optical surfaces of mirror balls and of the black plate."""

from dataclasses import dataclass

import numpy as np

from synthcam_shared.arrays import Array

# Reflectance of chrome steel in green light at normal incidence, for Schlick's law. The lamp's images of order 2, 3, 4
# between balls in contact then carry 5.3, .9, .2 % of the primary.
STEEL_REFLECTANCE = 0.55
IRON_N_K = (2.95, 2.93)  # at 549 nm: Johnson & Christy 1974, Phys. Rev. B 9, 5056


@dataclass(frozen=True)
class Surface:
    """Surfaces of balls and plate. Roughness broadens a glint by a Gaussian; its flux stays the same."""

    # n and k of the balls' metal (IRON_N_K: 51 % head-on); None: Schlick's law
    steel: tuple[float, float] | None = None
    roughness: float = 0.0  # rms slope of the balls' surface along each axis
    scratches: float = 0.0  # share of the light in a wider lobe
    scratch_slope: float = 0.1  # rms, of that lobe
    plate_gloss: float = 0.0  # reflectance of the plate as a mirror at normal incidence
    plate_roughness: float = 0.2  # rms slope of that mirror
    plate_texture: float = 0.0  # rms of the plate's relative brightness
    plate_grain: float = 3e-4  # size of its grains, m
    plate_shadow: bool = False  # whether the balls cast shadows on the plate

    def mirror(self, cosines: Array) -> Array:
        """Reflectance of a ball at an angle of incidence, for unpolarised light."""
        if self.steel is None:  # Schlick 1994, Comput. Graph. Forum 13
            return np.asarray(STEEL_REFLECTANCE + (1 - STEEL_REFLECTANCE) * np.clip(1 - cosines, 0, 1) ** 5)
        return fresnel(cosines, *self.steel)

    @property
    def head_on(self) -> float:
        """Reflectance of a ball at normal incidence."""
        return float(self.mirror(np.ones(1))[0])


STEEL_ON_BLACK = Surface()  # smooth balls on a dull, even plate


def fresnel(cosines: Array, n: float, k: float) -> Array:
    """Compute the reflectance of a metal surface for unpolarised light (Born & Wolf, Principles of Optics, 14.2)."""
    c = np.clip(cosines, 0, 1)
    sine = 1 - c * c
    t = n * n - k * k - sine
    both = np.sqrt(t * t + 4 * n * n * k * k)
    a = np.sqrt((both + t) / 2)
    perpendicular = (both + c * c - 2 * a * c) / (both + c * c + 2 * a * c)
    ratio = (both * c * c + sine * sine - 2 * a * c * sine) / (both * c * c + sine * sine + 2 * a * c * sine)
    return np.asarray(perpendicular * (1 + ratio) / 2)
