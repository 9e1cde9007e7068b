"""Summarise a fitted free law: its curve with credible bands, in physical units, and a short formula."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from discrepancy.arrays import Array
from discrepancy.free_laws.credible_band import NormalMixture
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.free_laws.formula import Formula, propose_formula
from discrepancy.free_laws.law_kinds import FreeLaw


@dataclass(frozen=True)
class LawSummary:
    """A fitted free law as a curve or map, for pages and files."""

    law: FreeLaw
    description: str  # as "mu that depends on the slip speed"
    x: tuple[Array, ...]  # (n,) for each axis
    curve: Array  # (n, parts)
    bands: dict[str, Array]  # (n, parts, 2), lower and upper ends, by name: "band68" and "band" (95 %)
    formula: str
    formula_rejected: bool  # whether the data reject it against the free curve
    sigma: float  # significance of the law
    covariance: Array | None = None  # (n, n) of a smooth curve of one part
    formula_parts: Formula | None = None  # the formula's shape, and its numbers by name

    @classmethod
    def of(cls, fitted_law: FittedLaw) -> LawSummary:
        law = fitted_law.law
        x = law.grid(41, side=25)
        mixture, formula = NormalMixture.of(fitted_law, *x), propose_formula(fitted_law)
        covariance = fitted_law.curve(*x)[1][0] if len(law.axes) == law.parts == 1 else None
        if law.is_per_clip:
            x = (np.array([float(c.clip) for c in fitted_law.evidence.clips]),)
        widths = {"band68": 1.0, "band": 1.96}  # standard deviations of a normal distribution
        return cls(
            law=law,
            description=describe_law(law),
            x=x,
            curve=mixture.quantile(0.0),
            bands={k: np.stack([mixture.quantile(-s), mixture.quantile(s)], axis=-1) for k, s in widths.items()},
            formula=formula.text,
            formula_rejected=formula.is_rejected,
            sigma=fitted_law.sigma,
            covariance=covariance,
            formula_parts=formula,
        )

    def document(self) -> dict[str, Any]:
        """The entry of discrepancy.json.

        x is a list of numbers for a curve and of pairs for a map. The curve is a list of numbers, or of pairs for a law
        of two parts. A band holds [low, high] for each number of the curve.
        """
        one, parts = self.law.parts == 1, self.formula_parts
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
            "formula_parts": None
            if parts is None or not parts.factors
            else {"shape": parts.shape, "factors": parts.factors, "numbers": parts.numbers},
            "covariance": None if self.covariance is None else self.covariance.tolist(),
        }


def describe_law(law: FreeLaw) -> str:
    """Summarise a free law in a few words, as "mu that depends on the slip speed"."""
    if len(law.axes) == 2:
        return f"{law.title} that depends on the {'velocity' if law.axes[0].unit == 'm/s' else 'position'}"
    if law.is_per_clip:
        return f"{law.title} that differs from clip to clip"
    return f"{law.title} that depends on the {law.axes[0].name}"
