"""What a slot found, for people and files: the law's curve with its band, in physical units, and a short formula."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from discrepancy.free_laws.credible_band import Mixture
from discrepancy.free_laws.fitted_law import Filled
from discrepancy.free_laws.formula import propose
from discrepancy.free_laws.slots import Slot

Array = NDArray[np.float64]

PLACES, SIDE = 41, 25  # at which a curve is given; along each side of a map
BANDS = {"band68": 1.0, "band": 1.96}  # standard deviations of a normal


@dataclass(frozen=True)
class Answer:
    """law: in words. x: an array (n,) for each axis. curve: (n, parts). bands: by name, low and high, (n, parts, 2).

    refused: the data want more than the formula.
    """

    slot: Slot
    law: str
    x: tuple[Array, ...]
    curve: Array
    bands: dict[str, Array]
    formula: str
    refused: bool
    sigma: float

    @classmethod
    def of(cls, filled: Filled) -> Answer:
        slot = filled.slot
        if len(slot.axes) == 1:
            x: tuple[Array, ...] = (slot.axes[0].grid(PLACES),)
        else:
            x = tuple(side.ravel() for side in np.meshgrid(*(a.grid(SIDE) for a in slot.axes), indexing="ij"))
        law, formula = Mixture.of(filled, *x), propose(filled)
        if slot.axes[0].kind == "set":
            x = (np.array([float(c.clip) for c in filled.evidence.clips]),)
        bands = {k: np.stack([law.quantile(-times), law.quantile(times)], axis=-1) for k, times in BANDS.items()}
        return cls(slot, words(slot), x, law.quantile(0.0), bands, formula.text, formula.refused, filled.sigma)

    def document(self) -> dict[str, Any]:
        """Its part in discrepancy.json. Of a curve x is a list of numbers, of a map a list of pairs; of a force or a
        warp the curve is a list of pairs. A band holds [low, high], of each number of the curve.
        """
        one = self.slot.parts == 1
        return {
            "slot": self.slot.name,
            "law": self.law,
            "symbol": self.slot.symbol,
            "unit": self.slot.unit,
            "axes": [{"name": a.name, "unit": a.unit} for a in self.slot.axes],
            "x": (self.x[0] if len(self.x) == 1 else np.stack(self.x, axis=-1)).tolist(),
            "curve": (self.curve[:, 0] if one else self.curve).tolist(),
            **{name: (band[:, 0] if one else band).tolist() for name, band in self.bands.items()},
            "formula": self.formula,
            "formula_suffices": not self.refused,
            "sigma": self.sigma,
        }


def words(slot: Slot) -> str:
    """ "mu that depends on the slip speed" """
    if len(slot.axes) == 2:
        return f"{slot.symbol} that depends on the place"
    if slot.axes[0].kind == "set":
        return f"{slot.symbol} that is another from clip to clip"
    return f"{slot.symbol} that depends on the {slot.axes[0].name}"
