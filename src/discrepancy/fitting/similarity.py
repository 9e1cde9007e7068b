"""Scales the realistic sizes of an effect's parameters to balls of another diameter.

Motions with the same dimensionless numbers are similar. Lengths scale as the ball's diameter, and times as its square
root, because gravity is the same (Froude scaling). So a library for beads also serves billiard balls.
"""

from __future__ import annotations

import dataclasses

from synthcam.effect import Effect, Parameter
from synthcam.model import Ball


def find_size_exponent(unit: str) -> float:
    """The exponent with which a quantity scales with the ball's diameter: 0.5 for "m/s", -1 for "1/m".

    unit: a product of powers of m, s, rad and px, as "m/s^2"; "1" for a pure number.
    """
    exponents, total = {"m": 1.0, "s": 0.5, "rad": 0.0, "px": 0.0, "1": 0.0}, 0.0
    for sign, part in zip((1, -1), unit.split("/"), strict=False):
        for factor in part.split():
            base, _, power = factor.partition("^")
            total += sign * exponents[base] * float(power or 1)
    return total


def scale_to_ball(value: float, unit: str, diameter: float) -> float:
    """Scale a size that is realistic for the paper's balls to balls of that diameter, m."""
    larger: float = (diameter / Ball().diameter) ** find_size_exponent(unit)
    return value * larger


def scale_parameter(kind: type[Effect], name: str, diameter: float) -> Parameter:
    """Scale an effect's parameter to balls of that diameter, m, within its limits; laws of the camera do not scale."""
    p = next(p for p in kind.parameters() if p.name == name)
    if diameter == Ball().diameter or {"camera", "clock", "exposure", "measure"} & set(kind.laws):
        return p
    typical, *tries = (min(max(scale_to_ball(x, p.unit, diameter), p.low), p.high) for x in (p.typical, *p.tries))
    return dataclasses.replace(p, typical=typical, tries=tuple(dict.fromkeys(tries)))
