"""The ball profile: the image of the room around a glint, as it fades from where the ball mirrors the zenith."""

from dataclasses import dataclass

import numpy as np

from synthcam_shared.arrays import Array

POWERS = (2, 3, 4)  # of 1 - q in the profile: at q = 1 it ends without a kink


@dataclass(frozen=True, eq=False)
class BallProfile:
    """The profile of one clip's balls, a polynomial in 1 - q with q = (distance from the middle / ``end``)^2."""

    end: float  # radius beyond which the ball mirrors no room, px
    coefficients: Array  # (3,): counts, of the powers of 1 - q

    def basis(self, middle: Array, half: int) -> Array:
        """The profile's terms (n, 3, s, s) on windows of s = 2 half + 1 pixels; middle (n, 2) px from the central."""
        left = self._left(middle, half)[0]
        out = np.empty((len(left), len(POWERS), *left.shape[1:]))
        np.multiply(left, left, out=out[:, 0])  # the powers are 2, 3 and 4
        for k in range(1, len(POWERS)):
            np.multiply(out[:, k - 1], left, out=out[:, k])
        return out

    def height(self, middle: Array, blur: Array, half: int) -> tuple[Array, Array, Array]:
        """The profile's brightness (n, s, s) on windows of s = 2 half + 1 pixels, and its derivatives by x and y.

        The brightness is in counts above what is beyond the profile. `middle` (n, 2) is that of the profile halfway
        through the exposure, px from the central pixel. `blur` (n, 2) is its displacement during the exposure, px.
        """
        if not blur.any():
            return self._height(middle, half)
        node = 0.5 / np.sqrt(3.0)  # of the blur, on either side of its middle: Gauss-Legendre with two nodes
        both = self._height(np.concatenate([middle + node * blur, middle - node * blur]), half)
        height, by_x, by_y = ((part[: len(middle)] + part[len(middle) :]) / 2.0 for part in both)
        return height, by_x, by_y

    def _height(self, middle: Array, half: int) -> tuple[Array, Array, Array]:
        left, across, down = self._left(middle, half)
        c2, c3, c4 = self.coefficients.tolist()
        height = c4 * left
        fall = height * (8.0 / self.end)
        for out, one, two in ((height, c3, c2), (fall, 6.0 * c3 / self.end, 4.0 * c2 / self.end)):
            out += one
            out *= left
            out += two
            out *= left
        height *= left
        return height, fall * across, fall * down

    def _left(self, middle: Array, half: int) -> tuple[Array, Array, Array]:
        """1 - q (n, s, s), at least 0, and the offsets over ``end`` (n, 1, s), (n, s, 1)."""
        away = (np.arange(-half, half + 1.0) - middle[..., None]) / self.end
        across, down = away[:, 0, None, :], away[:, 1, :, None]
        return np.maximum((1.0 - down**2) - across**2, 0.0), across, down
