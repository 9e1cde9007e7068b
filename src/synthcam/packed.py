"""The true places of a mask, packed to the left: each row's work is done together with the others', and no other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class Packed:
    """Of a mask (k, m): rows, columns of its true places, their place (p,) in the packed array. any: is there one?"""

    def __init__(self, mask: NDArray[np.bool_]) -> None:
        self.rows, self.columns = np.nonzero(mask)
        counts = np.bincount(self.rows, minlength=len(mask))
        self.places = np.arange(len(self.rows)) - (np.cumsum(counts) - counts)[self.rows]
        self.any = len(self.rows) > 0
        self._index = np.zeros((len(mask), counts.max(initial=0)), dtype=np.intp)
        self._index[self.rows, self.places] = self.columns

    def gather(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Of values (k, m) the packed ones, (k, most in a row); rows with fewer are filled up with any."""
        return np.take_along_axis(values, self._index, axis=1)
