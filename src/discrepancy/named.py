"""An effect as it is named: its numbers, and what it may be confused with."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from discrepancy.candidate import Candidate
from discrepancy.fit import Fit
from discrepancy.parameter import parameter_of
from discrepancy.rank import likeness

Array = NDArray[np.float64]
ALIAS = 0.9  # of the cosine between two signatures: beyond it the data hardly part them
PAIRS = 0.98  # the same for the span of two others


@dataclass(frozen=True)
class Named:
    """An effect added to the model.

    values, std: of its strengths, by dotted name. shapes, shape_std: likewise; infinite where the data leave a shape
    undetermined. sigma: of what it explains. aliases: what fits as well, itself first. alike: what has nearly its
    signature, one effect or the sum of two, with the cosine. limit: the detection limits of its strengths; naming: the
    strengths from which it is told from the likest that it can be told from.
    """

    effect: str
    values: dict[str, float]
    std: dict[str, float]
    sigma: float
    aliases: tuple[str, ...]
    shapes: dict[str, float] = field(default_factory=dict)
    shape_std: dict[str, float] = field(default_factory=dict)
    alike: tuple[tuple[tuple[str, ...], float], ...] = ()
    limit: dict[str, float] = field(default_factory=dict)
    naming: dict[str, float] = field(default_factory=dict)


def determined(now: Fit, shape: str, std: float) -> float:
    """A fitted shape's standard deviation; infinite where it says nothing."""
    p = parameter_of(now.model, shape)
    size = max(abs(now.model.value(shape)), p.scale) if p.low >= 0 else (p.high - p.low) / 2
    return std if 0 < std < size / 2 else np.inf


def sums(own: Array, ranking: Sequence[Candidate]) -> tuple[tuple[tuple[str, ...], float], ...]:
    """Pairs of effects that together have nearly the signature, where neither has it alone."""
    alone = [c for c in ranking if c.signature.shape[1] == 1 and 0 < likeness(own, c.signature) <= ALIAS]
    found = []
    for one, other in itertools.combinations(alone, 2):
        cosine = likeness(own, np.concatenate([one.signature, other.signature], axis=1))
        if cosine > PAIRS:
            found.append(((one.effect, other.effect), cosine))
    return tuple(sorted(found, key=lambda f: -f[1])[:3])
