"""The shapes that are tried as short formulas: sums of terms as text, as values on a grid, and as Python code."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from discrepancy.arrays import Array
from discrepancy.free_laws.law_kinds import FreeLaw
from synthcam.tabulated_law import REFERENCE_SPEED_M_S


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
