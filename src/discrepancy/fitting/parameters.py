"""The parameters that a fit may change, by dotted name: limits, steps, tried values; and the candidate effects."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from synthcam.effect import Effect, Parameter
from synthcam.library import library
from synthcam.model import LAUNCH_SPIN, Ball, Model

_LIMITED = {"restitution": (1e-5, 1.0), "spin_transfer": (1e-5, 5 / 7)}
BASE_PARAMETERS = ("restitution", "sliding_friction", "spin_transfer", "rolling_drag", "rolling_decel")


@dataclass(frozen=True)
class Candidate:
    """An effect that a model may lack, or a base parameter that is zero in it."""

    name: str
    strengths: tuple[str, ...]  # dotted names of its strength parameters
    shapes: tuple[str, ...] = ()  # and of its shape parameters
    kind: type[Effect] | None = None  # None for a base parameter
    held: tuple[float, ...] = ()  # values of strengths and shapes where the given model has the effect

    def remove_from(self, model: Model) -> Model:
        """The model without the candidate: its parameters at the values of the given model, or zero."""
        if any(self.held):
            return model.replace(dict(zip((*self.strengths, *self.shapes), self.held, strict=True)))
        own = self.kind.parameters() if self.kind else ()
        if self.kind is None or any(p.given and model.value(f"{self.name}.{p.name}") != p.default for p in own):
            return model.replace(dict.fromkeys(self.strengths, 0.0))
        kept = tuple(e for e in model.effects if e.name() != self.name)
        return dataclasses.replace(model, effects=kept)

    def grid(self, model: Model) -> Iterator[dict[str, float]]:
        """Values of the shape parameters to try; none other than the model's where it has the effect already."""
        if not self.shapes or any(model.value(s) != 0 for s in self.strengths):
            return iter([{}])
        tries = [_tries(find_parameter(model, s), 3 if len(self.shapes) > 1 else 5) for s in self.shapes]
        return (dict(zip(self.shapes, values, strict=True)) for values in itertools.product(*tries))


def _tries(p: Parameter, count: int) -> list[float]:
    """Values of a shape parameter to try: 3 or 5, up to five times the realistic size, or fractions of it from zero."""
    if p.tries:
        return list(p.tries)
    if p.low > 0:
        ends = max(p.low, p.typical / 5.0), min(p.high, p.typical * 5.0)
        return [float(x) for x in np.geomspace(*ends, count)]
    if p.typical == 0:
        return [float(x) for x in np.linspace(p.low, p.high, count)]
    fractions = (0.25, 0.5, 1.0, 1.5, 2.0) if count == 5 else (0.25, 1.0, 2.0)
    return [f * p.typical for f in fractions if f * p.typical <= p.high]


def find_tried_range(p: Parameter) -> float:
    """The range in which a shape parameter of a candidate is tried; of its logarithm if it is always positive."""
    tries = _tries(p, 5)
    return math.log(tries[-1] / tries[0]) if p.low > 0 else tries[-1] - tries[0]


def refine_tried_values(p: Parameter, value: float, closer: int) -> list[float]:
    """Values of a candidate's shape parameter on either side of a tried one, within the parameter's limits.

    closer: 0 for thirds of the distance to the next tried value; each further step divides the distance by three again.
    """
    tries = _tries(p, 5)
    steps = [k / 3 / 3**closer for k in (-2, -1, 1, 2)]
    at = min(int(np.searchsorted(tries, value, side="right")), len(tries) - 1)
    low, high = tries[max(at - 1, 0)], tries[max(at, 1)]
    near = [value * (high / low) ** k for k in steps] if p.low > 0 else [value + (high - low) * k for k in steps]
    return [x for x in near if p.low <= x <= p.high]


def list_candidates(model: Model, fitted: Sequence[str]) -> tuple[Candidate, ...]:
    """List the effects and the zero base parameters that a model may lack.

    Effects on sliding friction are left out where the model has none. Parameters that are fitted already are
    left out.
    """
    multiply_friction = {"friction", "normal_load", "drilling"}
    found = [Candidate(n, (n,)) for n in BASE_PARAMETERS if n not in fitted and model.value(n) == 0]
    for kind in library().values():
        strengths = tuple(s for s in strength_names(kind) if s not in fitted)
        if strengths and not (model.sliding_friction == 0 and set(kind.laws) <= multiply_friction):
            every = (f"{kind.name()}.{p.name}" for p in kind.parameters() if p.fixed and not p.given)
            shapes = tuple(s for s in every if s not in fitted)
            there = any(model.value(s) for s in strengths)
            held = tuple(model.value(s) for s in (*strengths, *shapes)) if there else ()
            found.append(Candidate(kind.name(), strengths, shapes, kind, held))
    return tuple(found)


def candidates_by_name(found: Model, given: Model, fitted: Sequence[str]) -> dict[str, Candidate]:
    """The candidates by name, for a given model, and for it with the fitted base parameters of another.

    Effects on friction are candidates only where the model has friction, which a fit may have added.
    """
    extended = given.replace({n: found.value(n) for n in BASE_PARAMETERS})
    return {s.name: s for model in (extended, given) for s in list_candidates(model, fitted)}


def strength_names(effect: type[Effect]) -> tuple[str, ...]:
    return tuple(f"{effect.name()}.{p.name}" for p in effect.strengths())


def list_names_to_fit(model: Model) -> tuple[str, ...]:
    """The shared parameters of a fit: base parameters that are not zero, and those in the model's `free`."""
    named = (n for n in model.free if n != LAUNCH_SPIN)
    return tuple(dict.fromkeys([*(n for n in BASE_PARAMETERS if model.value(n) != 0), *named]))


def find_parameter(model: Model, name: str) -> Parameter:
    """A parameter with unit, size and limits: of the base model by its name, of an effect as "effect.parameter"."""
    effect, dot, own = name.rpartition(".")
    units = {"rolling_drag": "1/s", "rolling_decel": "m/s^2"}  # the other base parameters are pure numbers
    if not dot:
        high = _LIMITED[name][1] if name in _LIMITED else math.inf
        unit = units.get(name, "1")
        typical = scale_to_ball(getattr(Model(), name), unit, model.ball.diameter)
        return Parameter(name, unit, typical, 0.0, high, fixed=False, default=0.0)
    kind = next((type(e) for e in model.effects if e.name() == effect), None) or library()[effect]
    return scale_parameter(kind, own, model.ball.diameter)


def is_known_parameter(name: str) -> bool:
    """True for a base parameter, and for a parameter of an effect that the library has."""
    return "." not in name or name.partition(".")[0] in library()


def difference_step(model: Model, name: str) -> float:
    """The step of a parameter for central differences, in its unit."""
    steps = {"gravity": 1e-4, "sliding_friction": 1e-5, "rolling_drag": 1e-4, "rolling_decel": 1e-5}  # their steps
    if "." not in name:
        return _LIMITED[name][0] if name in _LIMITED else steps[name]
    p = find_parameter(model, name)
    apart = min((b - a for a, b in itertools.pairwise(p.tries)), default=0.0)  # a law may jump between them
    return 1e-2 * (apart or p.typical or min(p.high - p.low, 1.0) / 10)


def parameter_limits(model: Model, name: str) -> tuple[float, float]:
    """The least and the greatest value that a parameter may have."""
    p = find_parameter(model, name)
    return p.low, p.high


def replace_within_limits(model: Model, values: Mapping[str, float]) -> Model:
    """Give parameters of a model these values by dotted name, each clipped to the parameter's limits."""
    ends = {name: parameter_limits(model, name) for name in values}
    return model.replace({name: min(max(v, ends[name][0]), ends[name][1]) for name, v in values.items()})


def find_size_exponent(unit: str) -> float:
    """The exponent with which a quantity of this unit scales with the ball's diameter: 0.5 for "m/s", -1 for "1/m"."""
    exponents, total = {"m": 1.0, "s": 0.5, "rad": 0.0, "px": 0.0, "1": 0.0}, 0.0
    for sign, part in zip((1, -1), unit.split("/"), strict=False):
        for factor in part.split():
            base, _, power = factor.partition("^")
            total += sign * exponents[base] * float(power or 1)
    return total


def scale_to_ball(value: float, unit: str, diameter: float) -> float:
    """Scale a size that is realistic for the paper's balls to balls of that diameter, m: an effect serves all balls.

    Lengths scale as the ball's diameter, and times as its square root, because gravity is the same (Froude scaling).
    """
    larger: float = (diameter / Ball().diameter) ** find_size_exponent(unit)
    return value * larger


def acts_on_picture(kind: type[Effect]) -> bool:
    """Whether an effect changes what the camera shows, or when, and not the motion."""
    return bool({"camera", "clock", "exposure", "measure"} & set(kind.laws))


def scale_parameter(kind: type[Effect], name: str, diameter: float) -> Parameter:
    """Scale an effect's parameter to balls of that diameter, m, within its limits; laws of the camera do not scale."""
    p = next(p for p in kind.parameters() if p.name == name)
    if diameter == Ball().diameter or acts_on_picture(kind):
        return p
    typical, *tries = (min(max(scale_to_ball(x, p.unit, diameter), p.low), p.high) for x in (p.typical, *p.tries))
    return dataclasses.replace(p, typical=typical, tries=tuple(dict.fromkeys(tries)))
