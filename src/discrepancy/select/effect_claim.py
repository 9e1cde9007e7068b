"""An effect as it is named: its numbers, and what it may be confused with."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from discrepancy.arrays import Array
from discrepancy.fitting.model_fit import ModelFit
from discrepancy.fitting.parameters import Candidate, find_parameter, parameter_limits
from discrepancy.policy import current_policy
from discrepancy.select.score_test import largest_cosine
from discrepancy.select.scored import CandidateScore
from synthcam.model import Model


@dataclass(frozen=True)
class EffectClaim:
    """An effect added to the model.

    Attributes
    ----------
    effect : str
    values, std : dict of str to float
        Its strengths by dotted name, and their standard deviations.
    sigma : float
        Significance of what it explains.
    aliases : tuple of str
        The effects that fit as well, itself first.
    shapes, shape_std : dict of str to float
        Its shape parameters likewise; infinite where the data leave one undetermined.
    alike : tuple of (tuple of str, float)
        What has nearly its signature, one effect or the sum of two, with the cosine.
    limit : dict of str to float
        The detection limits of its strengths.
    naming : dict of str to float
        The strengths from which it is told from the likest effect that it can be told from.
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

    @classmethod
    def of(cls, candidate: Candidate, fit: ModelFit, std: Mapping[str, float], sigma: float) -> EffectClaim:
        """Name a candidate with the values that a fit gives it.

        Parameters
        ----------
        candidate : Candidate
        fit : Fit
            Of a model that has the candidate.
        std : mapping of str to float
            Standard deviations by dotted name; infinite where one of a strength is missing.
        sigma : float
            Significance of what it explains.

        Returns
        -------
        EffectClaim
            Without aliases or limits.
        """
        values, shapes = ({k: fit.model.value(k) for k in names} for names in (candidate.strengths, candidate.shapes))
        own, bent = {k: std.get(k, np.inf) for k in values}, {k: shape_error(fit, k, std.get(k, 0.0)) for k in shapes}
        return cls(candidate.name, values, own, sigma, (candidate.name,), shapes, bent)

    def unsure(self, sigma: float) -> EffectClaim:
        """The same without standard deviations, which would hold only if nothing else were missing.

        sigma: by how the strength scatters from collision to collision; the lesser sigma is given.
        """
        none = dict.fromkeys(self.std, np.nan), dict.fromkeys(self.shape_std, np.nan)
        return replace(self, std=none[0], shape_std=none[1], sigma=min(self.sigma, sigma))

    def at_limit(self, name: str) -> bool:
        """Whether a strength stands at the end of what its effect allows: it might lie beyond, so it has no error."""
        return name in self.values and is_at_limit(name, self.values[name])

    def at_end_of_range(self) -> str:
        """Why it cannot be this effect: a shape parameter at an end of its range; empty if none is.

        The collisions would have it beyond: what moves the balls has another law. Zero is no such end.
        """
        for name, value in self.shapes.items():
            if value != 0 and is_at_limit(name, value):
                return f"its {name.rpartition('.')[2]} stands at {value:.3g}, the end of its range"
        return ""

    def held(self, base: Model) -> bool:
        """Whether the base model has this effect, with another strength."""
        return any(base.value(k) != 0 for k in self.values)

    def said(self, base: Model) -> str:
        """The effect with its numbers; where the base model holds a strength, that it is another."""
        rivals = f" or {' or '.join(self.aliases[1:])}" if len(self.aliases) > 1 else ""
        shown = {k: format_with_error(v, 0.0 if self.at_limit(k) else self.std[k], 1) for k, v in self.values.items()}
        errors = {k: f"+- {self.std[k]:.1g}" if np.isfinite(self.std[k]) else "without an error" for k in self.values}
        errors |= {k: "at its limit" for k in self.values if self.at_limit(k)}
        shapes = [
            f"{k.rpartition('.')[2]} = {format_with_error(v, self.shape_std[k], 1)} +- {self.shape_std[k]:.1g}"
            if np.isfinite(self.shape_std[k])
            else f"{k.rpartition('.')[2]} undetermined"
            for k, v in self.shapes.items()
        ]
        if self.held(base):
            strengths = [f"{k} is not {base.value(k):.3g} but {v} {errors[k]}" for k, v in shown.items()]
            return f"{', '.join([*strengths, *shapes])} ({self.sigma:.0f} sigma){rivals}"
        strengths = [f"{k.rpartition('.')[2]} = {v} {errors[k]}" for k, v in shown.items()]
        return f"{self.effect}{rivals} ({', '.join([*strengths, *shapes])}; {self.sigma:.0f} sigma)"


def format_with_error(value: float, std: float, digits: int) -> str:
    """A value as text, to the decimal place of the last of `digits` digits of its error; without one, three digits."""
    if not (np.isfinite(std) and std > 0 and value):
        return f"{value:.3g}"
    places = digits - 1 - math.floor(math.log10(float(f"{std:.{digits - 1}e}")))
    figures = max(places + math.floor(math.log10(abs(value))) + 1, 1)
    if abs(value) < 1e-4:
        return f"{value:.{figures - 1}e}"
    return f"{value:.{places}f}" if places > 0 else f"{value:.{figures}g}"


def is_at_limit(name: str, value: float) -> bool:
    """Whether a parameter has the least or the greatest value that its effect allows."""
    typical = find_parameter(Model(), name).typical
    return any(abs(value - end) < 1e-6 * max(abs(end), typical) for end in parameter_limits(Model(), name))


def shape_error(fit: ModelFit, shape: str, std: float) -> float:
    """The standard deviation of a fitted shape parameter; infinite where it exceeds half of the parameter's size."""
    p = find_parameter(fit.model, shape)
    size = max(abs(fit.model.value(shape)), p.typical) if p.low >= 0 else (p.high - p.low) / 2
    return std if 0 < std < size / 2 else np.inf


def find_similar_pairs(own: Array, ranking: Sequence[CandidateScore]) -> tuple[tuple[tuple[str, ...], float], ...]:
    """Find pairs of effects whose sum has nearly a given signature, where neither of them has it alone.

    Parameters
    ----------
    own : (points, k) array
        The signature, as of `ScoreTests.signature`.
    ranking : sequence of CandidateScore
        The effects to pair; those of one strength only are paired.

    Returns
    -------
    tuple of ((str, str), float)
        Names and cosine of the three likest pairs, the likest first.
    """
    alone = [
        c
        for c in ranking
        if c.signature.shape[1] == 1 and 0 < largest_cosine(own, c.signature) <= current_policy().alias_cosine
    ]
    found = []
    for one, other in itertools.combinations(alone, 2):
        cosine = largest_cosine(own, np.concatenate([one.signature, other.signature], axis=1))
        if cosine > current_policy().pair_alias_cosine:
            found.append(((one.effect, other.effect), cosine))
    return tuple(sorted(found, key=lambda f: -f[1])[:3])
