"""A short formula for a fitted curve: of some shapes the one that the data like best, simple ones preferred (BIC).

Each shape is fitted to the likelihood of the curve's coefficients, so that the curve's prior has no part in it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize

from discrepancy import policy
from discrepancy.arrays import Array
from discrepancy.free_laws.basis import Axis
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.free_laws.free_law import FreeLaw
from synthcam.free_law import PACE

Terms = list[tuple[str, Array]]  # in words, and drawn on the grid: (n,) of a number, (n, 2) of a vector

GRID, SIDE = 200, 25  # places at which a shape is drawn: on a line, along each side of a map
SEEN = 1e-10  # of the largest information
REFINED = 200  # steps of the search for a shape's own parameters, at most


@dataclass(frozen=True)
class Formula:
    """text: with numbers and units. chi2: over the free curve's. refused: the data tell it from the free curve."""

    text: str
    chi2: float
    parameters: int
    refused: bool


@dataclass(frozen=True)
class Shape:
    """A sum of terms, whose factors are fitted, given shape parameters; those are tried, then fitted too."""

    terms: Callable[..., Terms]
    tries: tuple[Array, ...] = ()


def propose(fitted_law: FittedLaw) -> Formula:
    """The best formula by BIC."""
    law = fitted_law.law
    if law.each_clip:
        mean = sum(fitted_law.fit.model.value(name) for name, _ in law.owners) + float(fitted_law.coefs.mean())
        text = f"{law.title} = {mean:.4g}, and other in each clip, by {fitted_law.prior.size:.2g} rms"
        return Formula(text, 0.0, 2, False)
    drawn = _Drawn(fitted_law)
    found = [drawn.best(shape) for shape in _shapes(law, drawn.x) if drawn.terms(shape, *(t[0] for t in shape.tries))]
    return min(found, key=lambda f: f.chi2 + float(np.log(fitted_law.fit.points)) * f.parameters)


class _Drawn:
    """The curve's coefficients as the data see them, and what a drawn shape would have them be."""

    def __init__(self, fitted_law: FittedLaw) -> None:
        law = self.law = fitted_law.law
        if len(law.axes) == 1:
            places: tuple[Array, ...] = (law.axes[0].grid(GRID),)
        else:
            places = tuple(s.ravel() for s in np.meshgrid(*(a.grid(SIDE) for a in law.axes), indexing="ij"))
        self.x = [_shown(a) * p for a, p in zip(law.axes, places, strict=True)]
        peak, information = fitted_law.likelihood()
        values, axes = np.linalg.eigh(information)
        seen = values > SEEN * values[-1]
        self.weight = (axes[:, seen] * np.sqrt(values[seen])).T
        self.inverse = np.linalg.pinv(law.basis(*places), rcond=1e-6)
        self.target = self.weight @ peak + self.seen(law.known(fitted_law.fit.model, *places))
        self.slight = policy.FORMULA_SLIGHT_SHARE * fitted_law.sigma**2

    def seen(self, column: Array) -> Array:
        return np.asarray(self.weight @ (self.inverse @ column.reshape(len(column), -1)).T.ravel())

    def terms(self, shape: Shape, *extra: float) -> Terms:
        """Those that say anything: of a centred law no constant."""
        return [t for t in shape.terms(*extra) if not self.law.centred or np.ptp(t[1], axis=0).any()]

    def fitted(self, shape: Shape, extra: Array) -> tuple[float, Array]:
        """Fit the factors of a shape's terms: chi^2, and the factors (terms,). extra: the shape's own numbers."""
        matrix = np.stack([self.seen(c) for _, c in self.terms(shape, *extra)], axis=1)
        scale = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
        factors = np.linalg.lstsq(matrix / scale, self.target, rcond=1e-9)[0]
        left = self.target - matrix / scale @ factors
        return float(left @ left), factors / scale

    def best(self, shape: Shape) -> Formula:
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
        words = _written([word for word, _ in self.terms(shape, *extra)], factors, bool(self.law.owners))
        text = f"{self.law.title} = {words}{_units(self.law)}"
        return Formula(
            text, chi2, count, chi2 > dof + max(policy.FORMULA_REFUSED_SIGMA * float(np.sqrt(2 * dof)), self.slight)
        )


def _written(words: list[str], factors: Array, relative: bool) -> str:
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
            factor, word = float(np.hypot(factor, other)), f"{inside} {_signed(phase, 2)}){way}"
        parts.append(f"{_signed(factor, 4 if not word else 3)} {word}".strip())
    text = " ".join(parts).removeprefix("+ ")
    return f"{lead:.4g} ({text})" if relative else text


def _signed(x: float, digits: int) -> str:
    return f"{'-' if x < 0 else '+'} {abs(x):.{digits}g}"


def _over(k: float) -> str:
    return f"{1 / k:.3g}" if k else "inf"


def _shown(axis: Axis) -> float:
    """Lengths are written in mm."""
    return 1e3 if axis.unit == "m" else 1.0


def _units(law: FreeLaw) -> str:
    unit = "" if law.unit == "1" else f" {law.unit}"
    paced = ", v in m/s" if law.paced else ""
    if law.axes[0].kind == "circle":
        turned = ", t along it, n a quarter turn on" if law.parts > 1 and not law.paced else ""
        return f"{unit}, th the direction{turned}{paced}"
    if law.axes[0].unit == "1":
        return unit
    where = "mm" if law.axes[0].unit == "m" else law.axes[0].unit
    return f"{unit}, {' and '.join(a.letter or a.name for a in law.axes)} in {where}{paced}"


def _shapes(law: FreeLaw, x: list[Array]) -> Iterator[Shape]:
    if law.paced:
        return _paced(_turns(x[0]) if law.axes[0].kind == "circle" else _maps(*x))
    if law.axes[0].kind == "circle":
        return _turns(x[0]) if law.parts == 1 else _pulls(x[0])
    if len(x) == 1:
        return _curves(law.axes[0].letter, x[0], [power for _, power in law.owners])
    return _maps(*x) if law.parts == 1 else _fields(*x)


def _sines(word: str, phase: Array) -> Terms:
    return [(f"sin({word})", np.sin(phase)), (f"cos({word})", np.cos(phase))]


def _turns(th: Array) -> Iterator[Shape]:
    one = ("", np.ones(len(th)))
    for orders in ((), (1,), (2,), (3,), (4,), (1, 2), (1, 2, 3)):
        sines = [t for n in orders for t in _sines(f"{n} th" if n > 1 else "th", n * th)]
        yield Shape(lambda sines=sines: [one, *sines])


def _paced(shapes: Iterator[Shape]) -> Iterator[Shape]:
    """Of a rolling loss: each shape constant, in proportion to the speed, or both."""
    words = "", f"v/{PACE:g}"
    for shape, parts in itertools.product(list(shapes), ((0,), (1,), (0, 1))):

        def terms(*extra: float, shape: Shape = shape, parts: tuple[int, ...] = parts) -> Terms:
            return [
                (f"{w} {words[p]}".strip(), c[:, None] * np.eye(2)[p]) for p in parts for w, c in shape.terms(*extra)
            ]

        yield Shape(terms, shape.tries)


def _pulls(th: Array) -> Iterator[Shape]:
    """A vector of the heading, in t along the motion and n a quarter turn from it."""
    zero = np.zeros(len(th))

    def both(word: str, column: Array) -> Terms:
        return [(f"{word} t".strip(), np.stack([column, zero], 1)), (f"{word} n".strip(), np.stack([zero, column], 1))]

    constant = both("", zero + 1)
    for orders in ((), (1,), (2,), (3,), (1, 2), (1, 2, 3)):
        sines = [t for n in orders for w, c in _sines(f"{n} th" if n > 1 else "th", n * th) for t in both(w, c)]
        yield Shape(lambda sines=sines: [*constant, *sines])
    one = np.stack([np.cos(th), -np.sin(th)], 1)  # a drag on one component of the velocity alone
    other = np.stack([np.sin(th), np.cos(th)], 1)
    yield Shape(lambda: [("cos(th) ex", one * np.cos(th)[:, None])])
    yield Shape(lambda: [("sin(th) ey", other * np.sin(th)[:, None])])


def _curves(v: str, x: Array, owned: list[int]) -> Iterator[Shape]:
    """owned: the powers that the model's own law has already."""
    span, top, powers = float(np.ptp(x)), float(x[-1]), [(v, x), (f"{v}^2", x**2), (f"{v}^3", x**3)]
    one = [("", np.ones(len(x))), *powers[: max(owned, default=0)]]
    for count in range(len(one) - 1, 3):
        yield Shape(lambda count=count: [one[0], *powers[:count]])
    if not owned:
        for power in powers:
            yield Shape(lambda power=power: [power])
    low = x[0] > 0.03 * top
    exponents = np.array([-2, -1, -0.5, -0.2, 0.2, 0.5, 1.5, 2, 3] if low else [0.3, 0.5, 1.5, 2, 3])
    safe = np.maximum(x, 1e-9)
    yield Shape(lambda p: [(f"{v}^{p:.3g}", safe**p)], (exponents,))
    yield Shape(lambda p: [*one, (f"{v}^{p:.3g}", safe**p)], (exponents,))
    if low:
        yield Shape(lambda: [*one, (f"/ {v}", 1 / x)])
    scales = span * np.geomspace(0.05, 1, 8)
    yield Shape(lambda s: [*one, (f"exp(-{v} / {s:.3g})", np.exp(-x / max(s, 1e-3 * span)))], (scales,))
    inner = x[0] + span * np.linspace(0.05, 0.95, 37)
    yield Shape(lambda a: [*one, (f"[{v} > {a:.3g}]", (x > a) * 1.0)], (inner,))
    widths = span * np.array([0.06, 0.12, 0.25])

    def bump(a: float, s: float) -> Terms:
        return [*one, (f"exp(-({v} - {a:.3g})^2 / (2 {s:.3g}^2))", np.exp(-(((x - a) / s) ** 2) / 2))]

    def rise(a: float, s: float) -> Terms:
        return [*one, (f"(1 + tanh(({v} - {a:.3g}) / {s:.3g})) / 2", (1 + np.tanh((x - a) / s)) / 2)]

    yield Shape(bump, (inner[::2], widths))
    yield Shape(rise, (inner[::2], widths))
    waves = 2 * np.pi / span * np.linspace(0.5, 4, 15)
    yield Shape(lambda k: [*one, *_sines(f"{v} / {_over(k)}", k * x)], (waves,))


def _maps(x: Array, y: Array) -> Iterator[Shape]:
    one, span = ("", np.ones(len(x))), float(np.ptp(x))
    slopes = [("x", x), ("y", y)]
    for terms in ([], slopes, [*slopes, ("x^2", x**2), ("x y", x * y), ("y^2", y**2)]):
        yield Shape(lambda terms=terms: [one, *terms])
    waves, turns = 2 * np.pi / span * np.linspace(0.5, 4, 15), np.pi * np.arange(12) / 12
    yield Shape(lambda k: [one, *_sines(f"x / {_over(k)} mm", k * x)], (waves,))
    yield Shape(lambda k: [one, *_sines(f"y / {_over(k)} mm", k * y)], (waves,))

    def oblique(k: float, turn: float) -> Terms:
        word = f"(x cos {turn:.3g} + y sin {turn:.3g}) / {_over(k)} mm"
        return [one, *_sines(word, k * (x * np.cos(turn) + y * np.sin(turn)))]

    def streak(turn: float, a: float, s: float) -> Terms:
        across = x * np.cos(turn) + y * np.sin(turn)
        word = f"exp(-(x cos {turn:.3g} + y sin {turn:.3g} - {a:.3g})^2 / (2 {s:.3g}^2))"
        return [one, (word, np.exp(-(((across - a) / s) ** 2) / 2))]

    def spot(a: float, b: float, s: float) -> Terms:
        word = f"exp(-((x - {a:.3g})^2 + (y - {b:.3g})^2) / (2 {s:.3g}^2))"
        return [one, (word, np.exp(-((x - a) ** 2 + (y - b) ** 2) / (2 * s**2)))]

    yield Shape(oblique, (waves, turns))
    places, widths = span * np.linspace(-0.4, 0.4, 9), span * np.array([0.06, 0.12, 0.25])
    yield Shape(streak, (turns, places, widths))
    yield Shape(spot, (places + x.mean(), places + y.mean(), widths))


def _fields(x: Array, y: Array) -> Iterator[Shape]:
    zero, span = np.zeros(len(x)), float(np.ptp(x))

    def both(word: str, column: Array) -> Terms:
        return [
            (f"{word} ex".strip(), np.stack([column, zero], 1)),
            (f"{word} ey".strip(), np.stack([zero, column], 1)),
        ]

    constant, linear = both("", zero + 1), [*both("x", x), *both("y", y)]
    yield Shape(lambda: constant)
    yield Shape(lambda: [*constant, *linear])
    r2 = (x - x.mean()) ** 2 + (y - y.mean()) ** 2
    barrel = ("r^2 (x ex + y ey)", np.stack([(x - x.mean()) * r2, (y - y.mean()) * r2], 1))
    yield Shape(lambda: [*constant, *linear, barrel])

    places, widths = span * np.linspace(-0.4, 0.4, 9), span * np.array([0.04, 0.08, 0.16, 0.3])

    def hill(a: float, b: float, s: float) -> Terms:
        dx, dy = x - x.mean() - a, y - y.mean() - b
        word = f"exp(-r^2 / (2 {s:.3g}^2)) r, r from ({a + x.mean():.3g}, {b + y.mean():.3g})"
        return [(word, np.stack([dx, dy], 1) * np.exp(-(dx**2 + dy**2) / (2 * s**2))[:, None])]

    yield Shape(hill, (places, places, widths))

    def wave(k: float, turn: float) -> Terms:
        word = f"(x cos {turn:.3g} + y sin {turn:.3g}) / {_over(k)}"
        sines = _sines(word, k * (x * np.cos(turn) + y * np.sin(turn)))
        return [t for axis in (0, 1) for w, c in sines for t in both(w, c)[axis : axis + 1]]

    yield Shape(wave, (2 * np.pi / span * np.linspace(0.5, 3, 11), np.pi * np.arange(12) / 12))
