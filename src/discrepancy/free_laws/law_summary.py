"""What a free law found, for people and files: its curve with its band, in physical units, and a short formula."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from discrepancy.arrays import Array
from discrepancy.free_laws.credible_band import NormalMixture
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.free_laws.formula import Formula, propose_formula
from discrepancy.free_laws.law_kinds import FreeLaw

PLACES, SIDE = 41, 25  # at which a curve is given; along each side of a map
BANDS = {"band68": 1.0, "band": 1.96}  # standard deviations of a normal


@dataclass(frozen=True)
class LawSummary:
    """A free law for people and files.

    Attributes
    ----------
    law : FreeLaw
    description : str
        The law in words.
    x : tuple of (n,) arrays
        Places, an array for each axis.
    curve : (n, parts) array
    bands : dict of str to (n, parts, 2) array
        Low and high, by name.
    formula : str
    refused : bool
        Whether the data want more than the formula.
    sigma : float
    covariance : (n, n) array or None
        Of the curve where it is smooth and of one part; None otherwise.
    formula_parts : Formula
        The formula's shape, and its numbers by name.
    """

    law: FreeLaw
    description: str
    x: tuple[Array, ...]
    curve: Array
    bands: dict[str, Array]
    formula: str
    formula_rejected: bool
    sigma: float
    covariance: Array | None = None
    formula_parts: Formula | None = None

    @classmethod
    def of(cls, fitted_law: FittedLaw) -> LawSummary:
        law = fitted_law.law
        if len(law.axes) == 1:
            x: tuple[Array, ...] = (law.axes[0].grid(PLACES),)
        else:
            x = tuple(side.ravel() for side in np.meshgrid(*(a.grid(SIDE) for a in law.axes), indexing="ij"))
        mixture, formula = NormalMixture.of(fitted_law, *x), propose_formula(fitted_law)
        covariance = fitted_law.curve(*x)[1][0] if len(law.axes) == law.parts == 1 else None
        if law.is_per_clip:
            x = (np.array([float(c.clip) for c in fitted_law.evidence.clips]),)
        bands = {
            k: np.stack([mixture.quantile(-times), mixture.quantile(times)], axis=-1) for k, times in BANDS.items()
        }
        description, curve = describe_law(law), mixture.quantile(0.0)
        return cls(
            law, description, x, curve, bands, formula.text, formula.is_rejected, fitted_law.sigma, covariance, formula
        )

    def document(self) -> dict[str, Any]:
        """Its part in discrepancy.json. Of a curve x is a list of numbers, of a map a list of pairs; of a force or a
        warp the curve is a list of pairs. A band holds [low, high], of each number of the curve.
        """
        one = self.law.parts == 1
        return {
            "slot": self.law.name,
            "law": self.description,
            "symbol": self.law.title,
            "unit": self.law.unit,
            "axes": [{"name": a.name, "unit": a.unit} for a in self.law.axes],
            "x": (self.x[0] if len(self.x) == 1 else np.stack(self.x, axis=-1)).tolist(),
            "curve": (self.curve[:, 0] if one else self.curve).tolist(),
            **{name: (band[:, 0] if one else band).tolist() for name, band in self.bands.items()},
            "formula": self.formula,
            "formula_suffices": not self.formula_rejected,
            "sigma": self.sigma,
            "formula_parts": self._describe_parts(),
            "covariance": None if self.covariance is None else self.covariance.tolist(),
        }

    def _describe_parts(self) -> dict[str, Any] | None:
        if self.formula_parts is None or not self.formula_parts.factors:
            return None
        return {
            "shape": self.formula_parts.shape,
            "factors": self.formula_parts.factors,
            "numbers": self.formula_parts.numbers,
        }


def describe_law(law: FreeLaw) -> str:
    """ "mu that depends on the slip speed" """
    if len(law.axes) == 2:
        return f"{law.title} that depends on the {'velocity' if law.axes[0].unit == 'm/s' else 'place'}"
    if law.is_per_clip:
        return f"{law.title} that is another from clip to clip"
    return f"{law.title} that depends on the {law.axes[0].name}"
