"""The noise model of a pixel's count (EMVA 1288), and the count at which it clips."""

import math
from dataclasses import dataclass

import numpy as np

from synthcam_shared.arrays import Array


@dataclass(frozen=True)
class SensorSpec:
    """Noise of one pixel: shot noise, read-out noise, rounding, fixed patterns, and that of an encoder.

    Counts of the file are light to the power of 1/gamma. The tracker makes them linear, in 16 bits; all other fields
    are those of linear counts.
    """

    bits: int = 8  # of the converter
    gain: float = 20.0  # e-/count
    read_noise: float = 20.0  # e-
    dark: float = 0.0  # e-/s
    prnu: float = 0.0  # relative
    dsnu: float = 0.0  # e-
    full_well: float = math.inf  # e-
    black_level: float = 0.0  # counts
    codec_noise: float = 0.0  # error of an encoder with loss, counts, in the blocks that contain something
    gamma: float = 1.0

    def variance(self, mean: Array) -> Array:
        """Variance, counts^2, of a pixel whose mean is ``mean`` counts (any shape)."""
        signal = np.maximum(mean - self.black_level, 0.0)
        floor = (self.read_noise**2 + self.dsnu**2) / self.gain**2 + 1.0 / 12.0 + self.codec_noise**2
        return np.asarray(floor + signal * (1.0 / self.gain + self.prnu**2 * signal))

    def fixed_pattern_variance(self, mean: Array) -> Array:
        """The part of ``variance`` that is the same in every frame of a ball at rest."""
        signal = np.maximum(mean - self.black_level, 0.0)
        # an encoder copies what rests, but moves what creeps in steps: half of its variance is fixed
        return (self.dsnu / self.gain) ** 2 + (self.prnu * signal) ** 2 + 0.5 * self.codec_noise**2

    def variance_slope(self, mean: Array) -> Array:
        """d variance / d mean, counts."""
        signal = np.maximum(mean - self.black_level, 0.0)
        return 1.0 / self.gain + 2.0 * self.prnu**2 * signal

    @property
    def ceiling(self) -> float:
        """Count from which on a pixel is censored.

        It is the converter's last count. If the well fills first, it is four read-out deviations below the full well.
        Read-out noise spreads a full well, and a limit below that spread is exact.
        """
        top = 2.0**self.bits - 1.0
        well = self.black_level + (self.full_well - 4.0 * self.read_noise) / self.gain
        return math.floor(well) if self.black_level + self.full_well / self.gain < top else top
