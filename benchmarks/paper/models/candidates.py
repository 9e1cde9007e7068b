"""Effects that the paper's model may lack, each at several sizes, alone and with the hop; found in the library."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from synthcam.effect import LAWS
from synthcam.library import library

NOT_MOTION = {"camera", "clock", "exposure", "measure"}
SIZES = (1.0, 3.0, 10.0)  # in units of the typical value, both signs where there are two
SHARES = (0.5, 1.0)
SHAPES = {
    "hop": ({"bounce": 0.0}, {"bounce": 0.2}, {"bounce": 0.4}, {"bounce": 0.6}, {"bounce": 0.8}),
    "stribeck": ({"slip": 0.03}, {"slip": 0.1}, {"slip": 0.3}),
    "ball_friction": tuple({"mu": mu} for mu in (0.1, 0.13, 0.146, 0.16, 0.2, 0.3)),
    "plate_waviness": ({"wavelength": 0.006}, {"wavelength": 0.02}, {"wavelength": 0.06}),
}  # those of others: as the effect's file has them


@dataclass(frozen=True)
class Candidate:
    """A model: name, its effects' values by dotted name, and how many numbers were chosen beside r, C and mu."""

    name: str
    values: tuple[tuple[str, float], ...] = ()
    extra: int = 0

    def __add__(self, other: Candidate) -> Candidate:
        return Candidate(f"{self.name} + {other.name}", (*self.values, *other.values), self.extra + other.extra)

    def words(self) -> str:
        """The effects' values for people."""
        return ", ".join(f"{name} = {value:.3g}" for name, value in self.values) or "nothing added"


BASE = Candidate("base")


def physical() -> list[str]:
    """Effects that bend the motion."""
    return sorted(n for n, e in library().items() if any(law in LAWS and law not in NOT_MOTION for law in e.laws))


def sizes_of(effect: str) -> Iterator[Candidate]:
    """One effect at all its sizes and shapes."""
    shapes = SHAPES.get(effect, ({},))
    for p in library()[effect].parameters():
        if p.fixed:
            continue
        wanted = SHARES if p.name == "share" else [sign * s * p.typical for s in SIZES for sign in (1, -1)]
        values = np.unique(np.round(np.clip(wanted, p.low, p.high), 12))
        for value in values[values != 0]:
            for shape in shapes:
                fixed = tuple((f"{effect}.{name}", float(x)) for name, x in shape.items())
                yield Candidate(effect, ((f"{effect}.{p.name}", float(value)), *fixed), 1 + len(fixed))
