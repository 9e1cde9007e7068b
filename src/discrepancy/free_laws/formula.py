"""Propose a short formula for a fitted curve: the shape with the best Bayesian information criterion (BIC).

Each shape is fitted to the likelihood of the curve's coefficients, so the prior of the curve does not matter.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize

from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.free_laws.law_kinds import FreeLaw
from discrepancy.policy import current_policy
from synthcam.tabulated_law import REFERENCE_SPEED_M_S
from synthcam_shared.arrays import Array


class FormulaTerm(NamedTuple):
    """A term of a sum, without its factor. Only terms of curves have a name, code and a power."""

    text: str  # for people, with its numbers
    column: Array  # its values on the grid, (n,) or (n, 2)
    name: str = ""  # of its factor
    code: str = ""  # Python code with {x} and the shape's numbers
    power: float = 0.0  # of {x}, in the unit of the factor


Terms = list[FormulaTerm]
CONSTANT = "constant"


@dataclass(frozen=True)
class LawShape:
    """A sum of terms with fitted factors."""

    terms: Callable[..., Terms]  # takes the shape's numbers
    tries: tuple[Array, ...] = ()  # starting values of each number
    # names of the numbers, as in the terms' code, each with the power of x in its unit
    numbers: tuple[tuple[str, float], ...] = ()
    name: str = ""  # identifies a shape with numbers in files


def _over(k: float) -> str:
    return f"{1 / k:.3g}" if k else "inf"


def iterate_shapes(law: FreeLaw, x: list[Array]) -> Iterator[LawShape]:
    """Yield the shapes that are tried as a short formula for a law, evaluated at x, an array for each axis."""
    if law.has_speed_term:
        return _iterate_with_speed(_iterate_angular(x[0]) if law.axes[0].kind == "circle" else _iterate_maps(*x))
    if law.axes[0].kind == "circle":
        return _iterate_angular(x[0]) if law.parts == 1 else _iterate_angular_vectors(x[0])
    if len(x) == 1:
        return _iterate_curves(law.axes[0].letter, x[0], [power for _, power in law.owners])
    return _iterate_maps(*x) if law.parts == 1 else _iterate_vector_maps(*x)


def _constant(count: int) -> FormulaTerm:
    return FormulaTerm("", np.ones(count), CONSTANT, "1")


def _sines(word: str, phase: Array, order: int | None = None) -> Terms:
    """A sine and a cosine of a phase: of `order` times an angle, or of a wave without `order`."""
    inside, name = ("{wave_number} * {x}", "") if order is None else (f"{order} * {{x}}" if order > 1 else "{x}", order)
    return [
        FormulaTerm(f"sin({word})", np.sin(phase), f"sine{name}", f"np.sin({inside})"),
        FormulaTerm(f"cos({word})", np.cos(phase), f"cosine{name}", f"np.cos({inside})"),
    ]


def _vector_terms(one: str, other: str, word: str, column: Array) -> Terms:
    """A term along each of two directions, `one` and `other` in words."""
    zero = np.zeros(len(column))
    columns = np.stack([column, zero], 1), np.stack([zero, column], 1)
    return [FormulaTerm(f"{word} {axis}".strip(), each) for axis, each in zip((one, other), columns, strict=True)]


def _iterate_angular(th: Array) -> Iterator[LawShape]:
    one = _constant(len(th))
    for orders in ((), (1,), (2,), (3,), (4,), (1, 2), (1, 2, 3)):
        sines = [t for n in orders for t in _sines(f"{n} th" if n > 1 else "th", n * th, n)]
        yield LawShape(lambda sines=sines: [one, *sines])


def _iterate_with_speed(shapes: Iterator[LawShape]) -> Iterator[LawShape]:
    """Shapes of a rolling loss of two terms: each shape constant, proportional to the speed, or both."""
    words = "", f"v/{REFERENCE_SPEED_M_S:g}"
    for shape, parts in itertools.product(list(shapes), ((0,), (1,), (0, 1))):

        def terms(*extra: float, shape: LawShape = shape, parts: tuple[int, ...] = parts) -> Terms:
            return [
                FormulaTerm(f"{t.text} {words[p]}".strip(), t.column[:, None] * np.eye(2)[p])
                for p in parts
                for t in shape.terms(*extra)
            ]

        yield LawShape(terms, shape.tries)


def _iterate_angular_vectors(th: Array) -> Iterator[LawShape]:
    """Vectors that depend on the heading; t is along the motion and n a quarter turn from it."""
    both = partial(_vector_terms, "t", "n")
    constant = both("", np.ones(len(th)))
    for orders in ((), (1,), (2,), (3,), (1, 2), (1, 2, 3)):
        waves = [t for n in orders for t in _sines(f"{n} th" if n > 1 else "th", n * th)]
        sines = [t for wave in waves for t in both(wave.text, wave.column)]
        yield LawShape(lambda sines=sines: [*constant, *sines])
    one = np.stack([np.cos(th), -np.sin(th)], 1)  # a drag on one component of the velocity alone
    other = np.stack([np.sin(th), np.cos(th)], 1)
    yield LawShape(lambda: [FormulaTerm("cos(th) ex", one * np.cos(th)[:, None])])
    yield LawShape(lambda: [FormulaTerm("sin(th) ey", other * np.sin(th)[:, None])])


def _iterate_curves(v: str, x: Array, owned: list[int]) -> Iterator[LawShape]:
    """Curves over v. owned: the powers of v that the model's own law has already."""
    span, top = float(np.ptp(x)), float(x[-1])
    powers = [
        FormulaTerm(v, x, "linear", "{x}", 1),
        FormulaTerm(f"{v}^2", x**2, "quadratic", "{x}**2", 2),
        FormulaTerm(f"{v}^3", x**3, "cubic", "{x}**3", 3),
    ]
    one = [_constant(len(x)), *powers[: max(owned, default=0)]]
    for count in range(len(one) - 1, 3):
        yield LawShape(lambda count=count: [one[0], *powers[:count]])
    if not owned:
        for power in powers:
            yield LawShape(lambda power=power: [power])
    low = x[0] > 0.03 * top
    exponents = np.array([-2, -1, -0.5, -0.2, 0.2, 0.5, 1.5, 2, 3] if low else [0.3, 0.5, 1.5, 2, 3])
    safe: Array = np.maximum(x, 1e-9)

    def power_term(p: float) -> FormulaTerm:
        return FormulaTerm(f"{v}^{p:.3g}", safe**p, "size", "np.maximum({x}, 1e-9) ** {power}", p)

    yield LawShape(lambda p: [power_term(p)], (exponents,), (("power", 0.0),), "power alone")
    yield LawShape(lambda p: [*one, power_term(p)], (exponents,), (("power", 0.0),), "power")
    if low:
        yield LawShape(
            lambda: [*one, FormulaTerm(f"/ {v}", 1 / x, "size", "1 / np.maximum({x}, 1e-9)", -1)], name="inverse"
        )
    scales = span * np.geomspace(0.05, 1, 8)

    def fall(s: float) -> Terms:
        s = max(s, 1e-3 * span)
        return [*one, FormulaTerm(f"exp(-{v} / {s:.3g})", np.asarray(np.exp(-x / s)), "size", "np.exp(-{x} / {scale})")]

    yield LawShape(fall, (scales,), (("scale", 1.0),), "fall")
    inner = x[0] + span * np.linspace(0.05, 0.95, 37)

    def step(a: float) -> Terms:
        # as code a slope over a hundredth of the range, so that the motion can be integrated
        sharp = f"(1 + np.tanh(({{x}} - {{at}}) / {0.01 * span:.2g})) / 2"
        return [*one, FormulaTerm(f"[{v} > {a:.3g}]", np.where(x > a, 1.0, 0.0), "size", sharp)]

    yield LawShape(step, (inner,), (("at", 1.0),), "step")
    widths = span * np.array([0.03, 0.06, 0.12, 0.25])

    def bump(a: float, s: float) -> Terms:
        word, column = f"exp(-({v} - {a:.3g})^2 / (2 {s:.3g}^2))", np.asarray(np.exp(-(((x - a) / s) ** 2) / 2))
        return [*one, FormulaTerm(word, column, "size", "np.exp(-((({x} - {at}) / {width}) ** 2) / 2)")]

    def rise(a: float, s: float) -> Terms:
        word, column = f"(1 + tanh(({v} - {a:.3g}) / {s:.3g})) / 2", np.asarray((1 + np.tanh((x - a) / s)) / 2)
        return [*one, FormulaTerm(word, column, "size", "(1 + np.tanh(({x} - {at}) / {width})) / 2")]

    yield LawShape(bump, (inner[::2], widths), (("at", 1.0), ("width", 1.0)), "bump")
    yield LawShape(rise, (inner[::2], widths), (("at", 1.0), ("width", 1.0)), "rise")
    waves = 2 * np.pi / span * np.linspace(0.5, 4, 15)
    yield LawShape(lambda k: [*one, *_sines(f"{v} / {_over(k)}", k * x)], (waves,), (("wave_number", -1.0),), "waves")


def _iterate_maps(x: Array, y: Array) -> Iterator[LawShape]:
    one, span = _constant(len(x)), float(np.ptp(x))
    slopes = [FormulaTerm("x", x), FormulaTerm("y", y)]
    for terms in ([], slopes, [*slopes, FormulaTerm("x^2", x**2), FormulaTerm("x y", x * y), FormulaTerm("y^2", y**2)]):
        yield LawShape(lambda terms=terms: [one, *terms])
    waves, turns = 2 * np.pi / span * np.linspace(0.5, 4, 15), np.pi * np.arange(12) / 12
    yield LawShape(lambda k: [one, *_sines(f"x / {_over(k)} mm", k * x)], (waves,))
    yield LawShape(lambda k: [one, *_sines(f"y / {_over(k)} mm", k * y)], (waves,))

    def oblique(k: float, turn: float) -> Terms:
        word = f"(x cos {turn:.3g} + y sin {turn:.3g}) / {_over(k)} mm"
        return [one, *_sines(word, k * (x * np.cos(turn) + y * np.sin(turn)))]

    def streak(turn: float, a: float, s: float) -> Terms:
        across = x * np.cos(turn) + y * np.sin(turn)
        word = f"exp(-(x cos {turn:.3g} + y sin {turn:.3g} - {a:.3g})^2 / (2 {s:.3g}^2))"
        return [one, FormulaTerm(word, np.exp(-(((across - a) / s) ** 2) / 2))]

    def spot(a: float, b: float, s: float) -> Terms:
        word = f"exp(-((x - {a:.3g})^2 + (y - {b:.3g})^2) / (2 {s:.3g}^2))"
        return [one, FormulaTerm(word, np.exp(-((x - a) ** 2 + (y - b) ** 2) / (2 * s**2)))]

    yield LawShape(oblique, (waves, turns))
    places, widths = span * np.linspace(-0.4, 0.4, 9), span * np.array([0.06, 0.12, 0.25])
    yield LawShape(streak, (turns, places, widths))
    yield LawShape(spot, (places + x.mean(), places + y.mean(), widths))


def _iterate_vector_maps(x: Array, y: Array) -> Iterator[LawShape]:
    both, span = partial(_vector_terms, "ex", "ey"), float(np.ptp(x))
    constant, linear = both("", np.ones(len(x))), [*both("x", x), *both("y", y)]
    yield LawShape(lambda: constant)
    yield LawShape(lambda: [*constant, *linear])
    r2 = (x - x.mean()) ** 2 + (y - y.mean()) ** 2
    barrel = FormulaTerm("r^2 (x ex + y ey)", np.stack([(x - x.mean()) * r2, (y - y.mean()) * r2], 1))
    yield LawShape(lambda: [*constant, *linear, barrel])

    places, widths = span * np.linspace(-0.4, 0.4, 9), span * np.array([0.04, 0.08, 0.16, 0.3])

    def hill(a: float, b: float, s: float) -> Terms:
        dx, dy = x - x.mean() - a, y - y.mean() - b
        word = f"exp(-r^2 / (2 {s:.3g}^2)) r, r from ({a + x.mean():.3g}, {b + y.mean():.3g})"
        return [FormulaTerm(word, np.stack([dx, dy], 1) * np.exp(-(dx**2 + dy**2) / (2 * s**2))[:, None])]

    yield LawShape(hill, (places, places, widths))

    def wave(k: float, turn: float) -> Terms:
        word = f"(x cos {turn:.3g} + y sin {turn:.3g}) / {_over(k)}"
        sines = _sines(word, k * (x * np.cos(turn) + y * np.sin(turn)))
        return [t for axis in (0, 1) for sine in sines for t in both(sine.text, sine.column)[axis : axis + 1]]

    yield LawShape(wave, (2 * np.pi / span * np.linspace(0.5, 3, 11), np.pi * np.arange(12) / 12))


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
