"""A short formula for a fitted curve: of some shapes the one that the data like best, simple ones preferred (BIC).

Each shape is fitted to the likelihood of the curve's coefficients, so that the curve's prior has no part in it.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.optimize import minimize

from discrepancy.arrays import Array
from discrepancy.free_laws.axis import Axis
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.free_laws.law_kinds import FreeLaw
from discrepancy.free_laws.shapes import LawShape, Terms, iterate_shapes
from discrepancy.policy import current_policy

GRID, SIDE = 200, 25  # places at which a shape is drawn: on a line, along each side of a map
SEEN = 1e-10  # of the largest information
REFINED = 200  # steps of the search for a shape's own parameters, at most


@dataclass(frozen=True)
class Formula:
    """text: with numbers and units. chi2: over the free curve's. refused: the data tell it from the free curve.

    factors, numbers: by name, of the terms and of the shape, whose name is `shape`; none where it has no code.
    """

    text: str
    chi2: float
    parameters: int
    is_rejected: bool
    factors: dict[str, float] = field(default_factory=dict)
    numbers: dict[str, float] = field(default_factory=dict)
    shape: str = ""


def propose_formula(fitted_law: FittedLaw) -> Formula:
    """The best formula by BIC."""
    law = fitted_law.law
    if law.is_per_clip:
        mean = sum(fitted_law.fit.model.value(name) for name, _ in law.owners) + float(fitted_law.coefs.mean())
        text = f"{law.title} = {mean:.4g}, and other in each clip, by {fitted_law.prior.size:.2g} rms"
        return Formula(text, 0.0, 2, False)
    drawn = _ShapeFitter(fitted_law)
    found = [
        drawn.fit_shape(shape)
        for shape in iterate_shapes(law, drawn.x)
        if drawn.terms(shape, *(t[0] for t in shape.tries))
    ]
    return min(found, key=lambda f: f.chi2 + float(np.log(fitted_law.fit.points)) * f.parameters)


class _ShapeFitter:
    """The curve's coefficients as the data see them, and what a drawn shape would have them be."""

    def __init__(self, fitted_law: FittedLaw) -> None:
        law = self.law = fitted_law.law
        if len(law.axes) == 1:
            places: tuple[Array, ...] = (law.axes[0].grid(GRID),)
        else:
            places = tuple(s.ravel() for s in np.meshgrid(*(a.grid(SIDE) for a in law.axes), indexing="ij"))
        self.x = [_display_scale(a) * p for a, p in zip(law.axes, places, strict=True)]
        peak, information = fitted_law.likelihood_of_curve()
        values, axes = np.linalg.eigh(information)
        seen = values > SEEN * values[-1]
        self.weight = (axes[:, seen] * np.sqrt(values[seen])).T
        self.inverse = np.linalg.pinv(law.basis(*places), rcond=1e-6)
        self.target = self.weight @ peak + self.project(law.value_in_model(fitted_law.fit.model, *places))
        self.slight = current_policy().formula_tolerated_share * fitted_law.sigma**2

    def project(self, column: Array) -> Array:
        return np.asarray(self.weight @ (self.inverse @ column.reshape(len(column), -1)).T.ravel())

    def terms(self, shape: LawShape, *extra: float) -> Terms:
        """Those that say anything: of a centred law no constant."""
        return [t for t in shape.terms(*extra) if not self.law.centred or np.ptp(t.column, axis=0).any()]

    def fitted(self, shape: LawShape, extra: Array) -> tuple[float, Array]:
        """Fit the factors of a shape's terms: chi^2, and the factors (terms,). extra: the shape's own numbers."""
        columns = [t.column for t in self.terms(shape, *extra)]
        matrix = np.stack([self.project(c) for c in columns], axis=1)
        scale = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
        factors = np.linalg.lstsq(matrix / scale, self.target, rcond=1e-9)[0]
        left = self.target - matrix / scale @ factors
        return float(left @ left), factors / scale

    def fit_shape(self, shape: LawShape) -> Formula:
        extra = np.zeros(0)
        if shape.tries:
            extra = np.array(min(itertools.product(*shape.tries), key=lambda t: self.fitted(shape, np.array(t))[0]))
            scale = np.array([np.ptp(t) / max(len(t) - 1, 1) for t in shape.tries])
            simplex = np.concatenate([np.zeros((1, len(extra))), 0.5 * np.eye(len(extra))])
            start, ends = extra, np.array([(min(t), max(t)) for t in shape.tries]).T

            def cost(z: Array) -> float:
                return self.fitted(shape, np.clip(start + z * scale, *ends))[0]

            options: Any = {"maxiter": REFINED, "initial_simplex": simplex}
            refined = minimize(cost, np.zeros(len(extra)), method="Nelder-Mead", options=options)
            extra = np.clip(start + refined.x * scale, *ends)
        chi2, factors = self.fitted(shape, extra)
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
    """The sum; a sine and a cosine of the same as one sine. relative: a (1 + ...)."""
    lead = float(factors[0])
    if not relative or words[0] or len(words) == 1:
        relative, lead = False, 1.0
    parts, rest = [], list(zip(words, (factors / lead).tolist(), strict=True))
    while rest:
        word, factor = rest.pop(0)
        if word.startswith("sin(") and rest and rest[0][0] == "cos(" + word[4:]:
            other = rest.pop(0)[1]
            phase = float(np.arctan2(other, factor))
            inside, _, way = word.rpartition(")")
            factor, word = float(np.hypot(factor, other)), f"{inside} {_format_signed(phase, 2)}){way}"
        parts.append(f"{_format_signed(factor, 4 if not word else 3)} {word}".strip())
    text = " ".join(parts).removeprefix("+ ")
    return f"{lead:.4g} ({text})" if relative else text


def _format_signed(x: float, digits: int) -> str:
    return f"{'-' if x < 0 else '+'} {abs(x):.{digits}g}"


def _display_scale(axis: Axis) -> float:
    """Lengths are written in mm."""
    return 1e3 if axis.unit == "m" else 1.0


def _describe_units(law: FreeLaw) -> str:
    unit = "" if law.unit == "1" else f" {law.unit}"
    paced = ", v in m/s" if law.paced else ""
    if law.axes[0].kind == "circle":
        turned = ", t along it, n a quarter turn on" if law.parts > 1 and not law.paced else ""
        return f"{unit}, th the direction{turned}{paced}"
    if law.axes[0].unit == "1":
        return unit
    where = "mm" if law.axes[0].unit == "m" else law.axes[0].unit
    return f"{unit}, {' and '.join(a.letter or a.name for a in law.axes)} in {where}{paced}"
