"""The true places of a mask, packed to the left: each row's work is done together with the others', and no other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class PackedRows:
    """Of a mask (k, m): inside (k, most in a row), which places of the packed array are taken; any: is one?"""

    def __init__(self, mask: NDArray[np.bool_]) -> None:
        counts = np.count_nonzero(mask, axis=1)
        self.mask, self.any = mask, bool(counts.any())
        self.inside = np.arange(counts.max(initial=0)) < counts[:, None]

    def gather(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Of values (k, m) the packed ones, (k, most in a row); rows with fewer are filled up with zeros."""
        out = np.zeros(self.inside.shape)
        out[self.inside] = values[self.mask]
        return out
