"""Propose a short formula for a fitted curve: the shape with the best Bayesian information criterion (BIC).

Each shape is fitted to the likelihood of the curve's coefficients, so the prior of the curve does not matter.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.optimize import minimize

from discrepancy.arrays import Array
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.free_laws.law_kinds import FreeLaw
from discrepancy.free_laws.shapes import LawShape, Terms, iterate_shapes
from discrepancy.policy import current_policy


@dataclass(frozen=True)
class Formula:
    """A short formula for a free law."""

    text: str  # with numbers and units
    chi2: float  # by how much it exceeds that of the free curve
    parameters: int  # fitted numbers
    is_rejected: bool  # whether the data reject it against the free curve
    # of the terms by name; empty if the shape has no code, as are the numbers
    factors: dict[str, float] = field(default_factory=dict)
    numbers: dict[str, float] = field(default_factory=dict)
    shape: str = ""  # its name


def propose_formula(fitted_law: FittedLaw) -> Formula:
    """Fit every shape and return the formula with the best BIC."""
    law = fitted_law.law
    if law.is_per_clip:
        mean = sum(fitted_law.fit.model.value(name) for name, _ in law.owners) + float(fitted_law.coefs.mean())
        text = f"{law.title} = {mean:.4g}, and differs from clip to clip by {fitted_law.prior.size:.2g} rms"
        return Formula(text, 0.0, 2, False)
    fitter = _ShapeFitter(fitted_law)
    shapes = iterate_shapes(law, fitter.x)
    found = [fitter.fit_shape(s) for s in shapes if fitter.terms(s, *(t[0] for t in s.tries))]
    return min(found, key=lambda f: f.chi2 + float(np.log(fitted_law.fit.points)) * f.parameters)


class _ShapeFitter:
    """Fits shapes, evaluated on a grid, to the likelihood of a curve's coefficients."""

    def __init__(self, fitted_law: FittedLaw) -> None:
        law = self.law = fitted_law.law
        points = law.grid(200, side=25)
        self.x = [(1e3 if a.unit == "m" else 1.0) * p for a, p in zip(law.axes, points, strict=True)]  # lengths in mm
        peak, information = fitted_law.likelihood_of_curve()
        values, axes = np.linalg.eigh(information)
        informative = values > 1e-10 * values[-1]  # below that it is rounding error
        self.weight = (axes[:, informative] * np.sqrt(values[informative])).T
        self.inverse = np.linalg.pinv(law.basis(*points), rcond=1e-6)
        self.target = self.weight @ peak + self.project(law.value_in_model(fitted_law.fit.model, *points))
        self.slight = current_policy().formula_tolerated_share * fitted_law.sigma**2

    def project(self, column: Array) -> Array:
        """Whitened coefficients of a function on the grid, (n,) or (n, 2)."""
        return np.asarray(self.weight @ (self.inverse @ column.reshape(len(column), -1)).T.ravel())

    def terms(self, shape: LawShape, *extra: float) -> Terms:
        """The terms of a shape; for a centred law without constants."""
        return [t for t in shape.terms(*extra) if not self.law.centred or np.ptp(t.column, axis=0).any()]

    def fit_factors(self, shape: LawShape, extra: Array) -> tuple[float, Array]:
        """Fit the factors (terms,) of a shape with the numbers `extra`; return chi^2 and the factors."""
        columns = [t.column for t in self.terms(shape, *extra)]
        matrix = np.stack([self.project(c) for c in columns], axis=1)
        scale = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
        factors = np.linalg.lstsq(matrix / scale, self.target, rcond=1e-9)[0]
        residuals = self.target - matrix / scale @ factors
        return float(residuals @ residuals), factors / scale

    def fit_shape(self, shape: LawShape) -> Formula:
        """Fit a shape: its numbers by a grid and Nelder-Mead, its factors by linear least squares."""
        extra = np.zeros(0)
        if shape.tries:
            every = map(np.array, itertools.product(*shape.tries))
            extra = min(every, key=lambda t: self.fit_factors(shape, t)[0])
            scale = np.array([np.ptp(t) / max(len(t) - 1, 1) for t in shape.tries])
            simplex = np.concatenate([np.zeros((1, len(extra))), 0.5 * np.eye(len(extra))])
            start, ends = extra, np.array([(min(t), max(t)) for t in shape.tries]).T

            def cost(z: Array) -> float:
                return self.fit_factors(shape, np.clip(start + z * scale, *ends))[0]

            options: Any = {"maxiter": 200, "initial_simplex": simplex}
            refined = minimize(cost, np.zeros(len(extra)), method="Nelder-Mead", options=options)
            extra = np.clip(start + refined.x * scale, *ends)
        chi2, factors = self.fit_factors(shape, extra)
        count = len(factors) + len(extra)
        dof = max(len(self.target) - count, 1)
        terms = self.terms(shape, *extra)
        words = _write_sum([t.text for t in terms], factors, bool(self.law.owners))
        text = f"{self.law.title} = {words}{_describe_units(self.law)}"
        refused = chi2 > dof + max(current_policy().formula_rejected_sigma * float(np.sqrt(2 * dof)), self.slight)
        if not all(t.code for t in terms) or len(extra) > len(shape.numbers):
            return Formula(text, chi2, count, refused)
        named = dict(zip([t.name for t in terms], factors.tolist(), strict=True))
        numbers = dict(zip([name for name, _ in shape.numbers], extra.tolist(), strict=True))
        return Formula(text, chi2, count, refused, named, numbers, shape.name)


def _write_sum(words: list[str], factors: Array, relative: bool) -> str:
    """Write a sum of terms. A sine and a cosine of one argument become one sine. relative: as a (1 + ...)."""
    lead = float(factors[0])
    if not relative or words[0] or len(words) == 1:
        relative, lead = False, 1.0
    parts, rest = [], list(zip(words, (factors / lead).tolist(), strict=True))
    while rest:
        word, factor = rest.pop(0)
        if word.startswith("sin(") and rest and rest[0][0] == "cos(" + word[4:]:
            other = rest.pop(0)[1]
            phase = float(np.arctan2(other, factor))
            inside, _, end = word.rpartition(")")
            factor, word = float(np.hypot(factor, other)), f"{inside} {_format_signed(phase, 2)}){end}"
        parts.append(f"{_format_signed(factor, 4 if not word else 3)} {word}".strip())
    text = " ".join(parts).removeprefix("+ ")
    return f"{lead:.4g} ({text})" if relative else text


def _format_signed(x: float, digits: int) -> str:
    return f"{'-' if x < 0 else '+'} {abs(x):.{digits}g}"


def _describe_units(law: FreeLaw) -> str:
    unit = "" if law.unit == "1" else f" {law.unit}"
    speed_unit = ", v in m/s" if law.has_speed_term else ""
    if law.axes[0].kind == "circle":
        turned = ", t along it, n a quarter turn on" if law.parts > 1 and not law.has_speed_term else ""
        return f"{unit}, th the direction{turned}{speed_unit}"
    if law.axes[0].unit == "1":
        return unit
    where = "mm" if law.axes[0].unit == "m" else law.axes[0].unit
    return f"{unit}, {' and '.join(a.letter or a.name for a in law.axes)} in {where}{speed_unit}"
