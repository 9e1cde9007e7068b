"""Summarise a fitted free law: its curve with bands and a short formula; and put it into the model as a table."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from discrepancy.fitting.gauss_newton import minimise_chi2
from discrepancy.fitting.jacobian import linearise
from discrepancy.fitting.model_fit import ModelFit
from discrepancy.free_laws.credible_band import NormalMixture
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.free_laws.formula import Formula, propose_formula
from discrepancy.free_laws.law_kinds import FreeLaw
from synthcam.model import BASE_PARAMETERS, Model, build_model, list_model_settings
from synthcam.tabulated_law import TabulatedLaw, kind_of
from synthcam_shared.arrays import Array


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


def tabulate_and_refit(fitted_law: FittedLaw) -> ModelFit | None:
    """Put a free law into the model as a table, and fit all other parameters again.

    The table is the smooth curve or the curve that may have a step, whichever leaves the smaller chi^2. Returns None if
    no model can hold such a law, or if no motion exists with it.
    """
    law, found = fitted_law.law, []
    try:
        kind_of(law.name)
    except KeyError:
        return None
    x = law.grid(73 if law.axes[0].kind == "circle" else 81, side=25)  # 73: every five degrees
    for curve in (fitted_law.curve(*x)[0], NormalMixture.of(fitted_law, *x).quantile(0.0)):
        with suppress(ValueError):
            model = _with_table(fitted_law.model_without_law, law.name, x, curve)
            start = linearise(fitted_law.evidence, model, fitted_law.fit.names, fitted_law.fit.launches)
            found.append(minimise_chi2(fitted_law.evidence, start))
    best = min(found, key=lambda fit: fit.chi2, default=None)
    if best is None:
        return None
    return replace(best, model=build_model(list_model_settings(best.model), best.model.free))  # as a file has it


def _with_table(plain: Model, name: str, x: tuple[Array, ...], curve: Array) -> Model:
    """The model with the law as a table, which replaces an earlier one of that name. Raises ValueError."""
    kind, _ = kind_of(name)
    y = np.clip(curve, kind.low, kind.high)
    points = x[0] if len(x) == 1 else np.stack(x, axis=-1)
    base = {parameter: plain.value(parameter) for parameter in BASE_PARAMETERS}
    table = TabulatedLaw.of(name, _round(points), _round(y[:, 0] if kind.parts == 1 else y), base)
    others = tuple(e for e in plain.effects if not (isinstance(e, TabulatedLaw) and e.law == name))
    return replace(plain, effects=(*others, table))


def _round(values: Array) -> Array:
    """Round to nine digits, so that a file stays readable."""
    return np.asarray(np.vectorize(lambda v: float(f"{v:.9g}"))(values))
