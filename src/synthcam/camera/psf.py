"""What the optics spread a point into beyond a Gaussian: the disc of defocus, and Airy's rings.

Both are products in the frequency domain with known transfer functions. The Gaussian and the pixel come first, in
closed form, sampled finely enough to hold no frequency that could fold back.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.special import j1

Array = NDArray[np.float64]
WINGS = 8  # times wavelength x f-number; 2.5 % of Airy's light lie further out, and are folded back


@dataclass(frozen=True)
class Psf:
    """sigma: of the Gaussian, px. defocus: radius of the disc, px. airy: wavelength x f-number / pitch, px."""

    sigma: float
    defocus: float = 0.0
    airy: float = 0.0

    @property
    def is_gaussian(self) -> bool:
        """True when the Gaussian is all."""
        return not (self.defocus or self.airy)

    @property
    def margin(self) -> int:
        """Pixels to which a point spreads."""
        return int(np.ceil(4.5 * self.sigma + self.defocus + WINGS * self.airy))

    @property
    def steps(self) -> int:
        """Samples a pixel at which a Gaussian of sigma is below 1 % at the highest frequency they hold."""
        return 1 if self.is_gaussian else int(np.ceil(1 / self.sigma))

    def transfer(self, frequency: Array) -> Array:
        """Transfer function of defocus and diffraction at radial frequencies, cycles a pixel (Goodman, ch. 6)."""
        out = np.ones_like(frequency)
        if self.defocus:
            x = np.maximum(2 * np.pi * self.defocus * frequency, 1e-9)
            out *= 2 * j1(x) / x
        if self.airy:
            s = np.clip(frequency * self.airy, 0, 1)
            out *= 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))
        return out

    def spread(self, patches: NDArray[np.float32]) -> NDArray[np.float32]:
        """Patches (n, w steps, w steps), blurred and brought to pixels (n, w, w)."""
        side = patches.shape[-1]
        rows, columns = fft.fftfreq(side, 1 / self.steps), fft.rfftfreq(side, 1 / self.steps)
        transfer = self.transfer(np.hypot(rows[:, None], columns)).astype(np.float32)
        spectrum = fft.rfft2(patches)
        spectrum *= transfer
        blurred = fft.irfft2(spectrum, s=(side, side))
        return np.ascontiguousarray(blurred[:, :: self.steps, :: self.steps])
