"""What the balls and the plate are made of, to light."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Chrome steel in green light by Schlick's law. The lamp's images of order 2, 3, 4 between balls in contact then
# carry 5.3, .9, .2 % of the primary.
STEEL = 0.55
IRON = (2.95, 2.93)  # n and k at 549 nm: Johnson & Christy 1974, Phys. Rev. B 9, 5056


@dataclass(frozen=True)
class Surface:
    """Balls and plate.

    steel: n and k of the balls' metal (IRON: 51 % head-on), or None for Schlick's law with 55 % head-on.
    roughness: rms slope of the balls' surface, each way. scratches: share of the light that goes into a wider
    lobe, of rms slope scratch_slope. Both broaden a glint by a Gaussian; what it carries stays the same.
    plate_gloss: reflectance of the plate as a mirror, head-on. plate_roughness: rms slope of that mirror.
    plate_texture: rms of the plate's relative brightness, with grains of plate_grain m.
    plate_shadow: whether the balls take light from the plate.
    """

    steel: tuple[float, float] | None = None
    roughness: float = 0.0
    scratches: float = 0.0
    scratch_slope: float = 0.1
    plate_gloss: float = 0.0
    plate_roughness: float = 0.2
    plate_texture: float = 0.0
    plate_grain: float = 3e-4
    plate_shadow: bool = False

    def mirror(self, cosines: Array) -> Array:
        """Reflectance of a ball at an angle of incidence, for unpolarised light."""
        if self.steel is None:  # Schlick 1994, Comput. Graph. Forum 13
            return np.asarray(STEEL + (1 - STEEL) * np.clip(1 - cosines, 0, 1) ** 5)
        return fresnel(cosines, *self.steel)

    @property
    def head_on(self) -> float:
        """Reflectance of a ball at normal incidence."""
        return float(self.mirror(np.ones(1))[0])


def fresnel(cosines: Array, n: float, k: float) -> Array:
    """Mean of Fresnel's two reflectances of a metal in air (Born & Wolf, Principles of Optics, 14.2)."""
    c = np.clip(cosines, 0, 1)
    sine = 1 - c * c
    t = n * n - k * k - sine
    both = np.sqrt(t * t + 4 * n * n * k * k)
    a = np.sqrt((both + t) / 2)
    senkrecht = (both + c * c - 2 * a * c) / (both + c * c + 2 * a * c)
    ratio = (both * c * c + sine * sine - 2 * a * c * sine) / (both * c * c + sine * sine + 2 * a * c * sine)
    return np.asarray(senkrecht * (1 + ratio) / 2)
