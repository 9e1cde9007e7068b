"""Realistic sizes of an effect's parameters for balls of another diameter than the library was written for.

Motions with the same dimensionless numbers are similar where lengths go as the ball and times as their square root
(W. Froude's law: gravity is the same). A library of beads then serves billiard balls.
"""

from __future__ import annotations

import dataclasses

from synthcam.effect import Effect, Parameter
from synthcam.model import Ball

_POWERS = {"m": 1.0, "s": 0.5, "rad": 0.0, "px": 0.0, "1": 0.0}  # of the ball's size
_OF_CAMERA = {"camera", "clock", "exposure", "measure"}  # laws that do not know the ball


def size_exponent(unit: str) -> float:
    """The power of the ball's size with which a quantity grows, by its unit, as "m/s^2".

    Parameters
    ----------
    unit : str
        Of m, s, rad and px; "1" for a pure number.

    Returns
    -------
    float

    Examples
    --------
    >>> power_of("m/s"), power_of("m/s^2"), power_of("1/m")
    (0.5, 0.0, -1.0)
    """
    total = 0.0
    for sign, part in zip((1, -1), unit.split("/"), strict=False):
        for factor in part.split():
            base, _, power = factor.partition("^")
            total += sign * _POWERS[base] * float(power or 1)
    return total


def scale_to_ball(value: float, unit: str, diameter: float) -> float:
    """A size that is realistic for the paper's balls, as it would be for balls of that diameter, m."""
    larger: float = (diameter / Ball().diameter) ** size_exponent(unit)
    return value * larger


def scale_parameter(kind: type[Effect], name: str, diameter: float) -> Parameter:
    """A parameter of an effect, with the sizes that are realistic for balls of that diameter, m, within its limits."""
    p = next(p for p in kind.parameters() if p.name == name)
    if diameter == Ball().diameter or _OF_CAMERA & set(kind.laws):
        return p
    typical, *tries = (min(max(scale_to_ball(x, p.unit, diameter), p.low), p.high) for x in (p.typical, *p.tries))
    return dataclasses.replace(p, typical=typical, tries=tuple(dict.fromkeys(tries)))
