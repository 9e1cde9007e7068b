"""Point spread function of the optics: a Gaussian, the disc of defocus, and Airy's rings.

Defocus and diffraction are products with their transfer functions in the frequency domain. The Gaussian and the pixel
come first, in closed form, sampled so finely that no frequency folds back.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import j1

from synthcam_shared.arrays import Array, Float32


@dataclass(frozen=True)
class Psf:
    """Widths of the three parts, px."""

    sigma: float  # of the Gaussian
    defocus: float = 0.0  # radius of the disc
    airy: float = 0.0  # wavelength x f-number / pixel pitch

    @property
    def is_gaussian(self) -> bool:
        """True without defocus and diffraction."""
        return not (self.defocus or self.airy)

    @property
    def margin(self) -> int:
        """Pixels over which a point spreads; 2.5 % of Airy's light lie further out, and are folded back."""
        return int(np.ceil(4.5 * self.sigma + self.defocus + 8 * self.airy))

    @property
    def steps(self) -> int:
        """Samples per pixel, such that the Gaussian is below 1 % at their highest frequency."""
        return 1 if self.is_gaussian else int(np.ceil(1 / self.sigma))

    def transfer(self, frequency: Array) -> Array:
        """Transfer function of defocus and diffraction at radial frequencies, cycles per pixel.

        Goodman, Introduction to Fourier Optics, ch. 6.
        """
        out = np.ones_like(frequency)
        if self.defocus:
            x = np.maximum(2 * np.pi * self.defocus * frequency, 1e-9)
            out *= 2 * j1(x) / x
        if self.airy:
            s = np.clip(frequency * self.airy, 0, 1)
            out *= 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))
        return out

    def spread(self, patches: Float32) -> Float32:
        """Blur patches (n, w steps, w steps), and sample them at the pixels (n, w, w)."""
        if self.is_gaussian:
            return patches
        from scipy import fft  # here alone: slow to load

        side = patches.shape[-1]
        rows, columns = fft.fftfreq(side, 1 / self.steps), fft.rfftfreq(side, 1 / self.steps)
        transfer = self.transfer(np.hypot(rows[:, None], columns)).astype(np.float32)
        spectrum = fft.rfft2(patches)
        spectrum *= transfer
        blurred = fft.irfft2(spectrum, s=(side, side))
        return np.ascontiguousarray(blurred[:, :: self.steps, :: self.steps])
