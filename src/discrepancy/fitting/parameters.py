"""The numbers that a fit may change, by dotted name, and the candidates: what a model may lack."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from discrepancy.fitting.similarity import scale_parameter, scale_to_ball
from synthcam.effect import Effect, Parameter
from synthcam.library import library
from synthcam.model import LAUNCH_SPIN, Model

_UNLIMITED = {"gravity": 1e-4, "sliding_friction": 1e-5, "rolling_drag": 1e-4, "rolling_decel": 1e-5}  # their steps
_LIMITED = {"restitution": (1e-5, 1.0), "spin_transfer": (1e-5, 5 / 7)}
BASE_PARAMETERS = ("restitution", "sliding_friction", "spin_transfer", "rolling_drag", "rolling_decel")
FINE = 0.1  # of a step: for a derivative by a forward difference
SPREAD = 5.0  # shape parameters are tried from so many times under their realistic size to so many times over it
FRACTIONS = (0.25, 0.5, 1.0, 1.5, 2.0)  # the same where zero is allowed
MULTIPLIES = {"friction", "normal_load", "drilling"}  # laws that bend sliding friction: of none they make none


@dataclass(frozen=True)
class Candidate:
    """An effect that a model may lack, or a base parameter that it holds at zero.

    Attributes
    ----------
    name : str
    strengths, shapes : tuple of str
        Dotted names of its strengths and of its shape parameters.
    kind : type of Effect, or None
    held : tuple of float
        Their values where the given model has the effect.
    """

    name: str
    strengths: tuple[str, ...]
    shapes: tuple[str, ...] = ()
    kind: type[Effect] | None = None
    held: tuple[float, ...] = ()

    def remove_from(self, model: Model) -> Model:
        """The model with this candidate's numbers where the model that was given has them."""
        if any(self.held):
            return model.replace(dict(zip((*self.strengths, *self.shapes), self.held, strict=True)))
        if self.kind is None:
            return model.replace(dict.fromkeys(self.strengths, 0.0))
        if any(p.given and model.value(f"{self.name}.{p.name}") != p.default for p in self.kind.parameters()):
            return model.replace(dict.fromkeys(self.strengths, 0.0))
        kept = tuple(e for e in model.effects if e.name() != self.name)
        return dataclasses.replace(model, effects=kept)

    def grid(self, model: Model) -> Iterator[dict[str, float]]:
        """Values of the shape parameters to try; those it has where the effect is in the model already."""
        if not self.shapes or any(model.value(s) != 0 for s in self.strengths):
            return iter([{}])
        tries = [_tries(find_parameter(model, s), 3 if len(self.shapes) > 1 else len(FRACTIONS)) for s in self.shapes]
        return (dict(zip(self.shapes, values, strict=True)) for values in itertools.product(*tries))


def _tries(p: Parameter, count: int) -> list[float]:
    """Values of a shape parameter to try."""
    if p.tries:
        return list(p.tries)
    if p.low > 0:
        ends = max(p.low, p.typical / SPREAD), min(p.high, p.typical * SPREAD)
        return [float(x) for x in np.geomspace(*ends, count)]
    if p.typical == 0:
        return [float(x) for x in np.linspace(p.low, p.high, count)]
    fractions = FRACTIONS if count == len(FRACTIONS) else FRACTIONS[::2]
    return [f * p.typical for f in fractions if f * p.typical <= p.high]


def tried_range(p: Parameter) -> float:
    """The range in which a shape parameter is tried, of its logarithm where it is always positive."""
    tries = _tries(p, len(FRACTIONS))
    return math.log(tries[-1] / tries[0]) if p.low > 0 else tries[-1] - tries[0]


def refine_tried_values(p: Parameter, value: float, closer: int) -> list[float]:
    """Values of a shape parameter to either side of one that was tried.

    Parameters
    ----------
    p : Parameter
    value : float
        That was tried.
    closer : int
        0 for thirds of the way to the next value tried; each more divides the way by three again.

    Returns
    -------
    list of float
        Within the parameter's limits.
    """
    tries = _tries(p, len(FRACTIONS))
    steps = [k / 3 / 3**closer for k in (-2, -1, 1, 2)]
    at = min(int(np.searchsorted(tries, value, side="right")), len(tries) - 1)
    low, high = tries[max(at - 1, 0)], tries[max(at, 1)]
    near = [value * (high / low) ** k for k in steps] if p.low > 0 else [value + (high - low) * k for k in steps]
    return [x for x in near if p.low <= x <= p.high]


def list_candidates(model: Model, fitted: Sequence[str]) -> tuple[Candidate, ...]:
    """What a model may lack: base parameters that it holds at zero, and the library's effects.

    Effects that could change nothing, as of friction where there is none, are left out.

    Parameters
    ----------
    model : Model
    fitted : sequence of str
        Dotted names of parameters that are fitted already, and so are no candidates.

    Returns
    -------
    tuple of Candidate
    """
    found = [Candidate(n, (n,)) for n in BASE_PARAMETERS if n not in fitted and model.value(n) == 0]
    for kind in library().values():
        strengths = tuple(s for s in strength_names(kind) if s not in fitted)
        if strengths and not (model.sliding_friction == 0 and set(kind.laws) <= MULTIPLIES):
            every = (f"{kind.name()}.{p.name}" for p in kind.parameters() if p.fixed and not p.given)
            shapes = tuple(s for s in every if s not in fitted)
            there = any(model.value(s) for s in strengths)
            held = tuple(model.value(s) for s in (*strengths, *shapes)) if there else ()
            found.append(Candidate(kind.name(), strengths, shapes, kind, held))
    return tuple(found)


def candidates_by_name(found: Model, given: Model, fitted: Sequence[str]) -> dict[str, Candidate]:
    """By name, the candidates of a given model, and those that it has with the base parameters of another.

    The other is what was found: effects of friction are candidates only where the model has any.
    """
    extended = given.replace({n: found.value(n) for n in BASE_PARAMETERS})
    return {s.name: s for model in (extended, given) for s in list_candidates(model, fitted)}


def strength_names(effect: type[Effect]) -> tuple[str, ...]:
    return tuple(f"{effect.name()}.{p.name}" for p in effect.strengths())


def names_to_fit(model: Model) -> tuple[str, ...]:
    """What a fit of this model changes beside the launches: base parameters that are not zero, those it calls free."""
    named = (n for n in model.free if n != LAUNCH_SPIN)
    return tuple(dict.fromkeys([*(n for n in BASE_PARAMETERS if model.value(n) != 0), *named]))


_UNITS = {"rolling_drag": "1/s", "rolling_decel": "m/s^2"}  # the other base parameters are pure numbers


def find_parameter(model: Model, name: str) -> Parameter:
    """A parameter of the base model by its name, or of an effect as "effect.parameter", with unit, size and limits."""
    effect, dot, own = name.rpartition(".")
    if not dot:
        high = _LIMITED[name][1] if name in _LIMITED else math.inf
        unit = _UNITS.get(name, "1")
        typical = scale_to_ball(getattr(Model(), name), unit, model.ball.diameter)
        return Parameter(name, unit, typical, 0.0, high, fixed=False, default=0.0)
    kind = next((type(e) for e in model.effects if e.name() == effect), None) or library()[effect]
    return scale_parameter(kind, own, model.ball.diameter)


def difference_step(model: Model, name: str) -> float:
    """The step of a parameter, in its unit, for derivatives by finite differences."""
    if "." not in name:
        return _LIMITED[name][0] if name in _LIMITED else _UNLIMITED[name]
    p = find_parameter(model, name)
    apart = min((b - a for a, b in itertools.pairwise(p.tries)), default=0.0)  # a law may jump between them
    return 1e-2 * (apart or p.typical or min(p.high - p.low, 1.0) / 10)


def parameter_limits(model: Model, name: str) -> tuple[float, float]:
    """The least and the greatest value that a parameter may have."""
    p = find_parameter(model, name)
    return p.low, p.high


def replace_within_limits(model: Model, values: Mapping[str, float]) -> Model:
    """The model with these values by dotted name, each moved to its limit where rounding led past it."""
    ends = {name: parameter_limits(model, name) for name in values}
    return model.replace({name: min(max(v, ends[name][0]), ends[name][1]) for name, v in values.items()})
