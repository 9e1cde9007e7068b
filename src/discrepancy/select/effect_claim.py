"""A claim of an effect: its values, their errors, and the effects that it may be confused with."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from discrepancy.fitting.jacobian import drop_mutual_push
from discrepancy.fitting.model_fit import ModelFit, WhitenedClips
from discrepancy.fitting.parameters import Candidate, find_parameter, parameter_limits
from discrepancy.fitting.shape_scan import MIN_SCANNED_VALUES, can_scan
from discrepancy.policy import current_policy
from discrepancy.select.score_test import CandidateScore, ScoreTests, largest_cosine, prepare_trial
from synthcam.model import Model
from synthcam_shared.arrays import Array


@dataclass(frozen=True)
class EffectClaim:
    """An effect that the search claims."""

    effect: str
    # its strengths by dotted name, and their standard deviations
    values: dict[str, float]
    std: dict[str, float]
    sigma: float  # joint significance of its strengths
    aliases: tuple[str, ...]  # the effects that fit as well, itself first
    # the same of its shape parameters; infinite if the data leave one undetermined
    shapes: dict[str, float] = field(default_factory=dict)
    shape_std: dict[str, float] = field(default_factory=dict)
    # effects, or sums of two, with a similar signature, and the cosine
    alike: tuple[tuple[tuple[str, ...], float], ...] = ()
    limit: dict[str, float] = field(default_factory=dict)  # the detection limits of its strengths
    # the least strengths that distinguish it from the most similar effect, aliases aside
    naming: dict[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, candidate: Candidate, fit: ModelFit, std: Mapping[str, float], sigma: float) -> EffectClaim:
        """Claim a candidate with the values that a fit gives it.

        std: standard deviations by dotted name; infinite if that of a strength is missing. The claim has no aliases or
        limits.
        """
        values, shapes = ({k: fit.model.value(k) for k in names} for names in (candidate.strengths, candidate.shapes))
        own, bent = (
            {k: std.get(k, np.inf) for k in values},
            {k: compute_shape_error(fit, k, std.get(k, 0.0)) for k in shapes},
        )
        return cls(candidate.name, values, own, sigma, (candidate.name,), shapes, bent)

    def judge_by_scatter(self, sigma: float, std: Mapping[str, float]) -> EffectClaim:
        """Replace the standard deviations, which are valid only if nothing else is missing.

        sigma, std: from the scatter of the parameters between collisions. The claim gets the smaller of both sigmas and
        the larger of both standard deviations. A parameter that `std` lacks gets none.
        """
        own, bent = (
            {k: float(np.maximum(error, std.get(k, np.nan))) for k, error in errors.items()}
            for errors in (self.std, self.shape_std)
        )
        return replace(self, std=own, shape_std=bent, sigma=min(self.sigma, sigma))

    def at_limit(self, name: str) -> bool:
        """True if a strength is at an end of its range: the best value may lie beyond, so it has no error."""
        return name in self.values and is_at_limit(name, self.values[name])

    def shape_at_limit(self) -> tuple[str, float] | None:
        """A shape parameter at an end of its range but zero, and its value: balls follow another law. Or None."""
        return next(((n, v) for n, v in self.shapes.items() if v != 0 and is_at_limit(n, v)), None)

    def strength_at_limit(self) -> tuple[str, float] | None:
        """A strength at an end of its range but zero, and its value; or None."""
        return next(((n, v) for n, v in self.values.items() if v != 0 and is_at_limit(n, v)), None)

    def is_in(self, base: Model) -> bool:
        """True if the base model has this effect, with another strength."""
        return any(base.value(k) != 0 for k in self.values)


def is_at_limit(name: str, value: float) -> bool:
    """Tell if a claimed parameter has the least or the greatest value that its effect allows."""
    typical = find_parameter(Model(), name).typical
    return any(abs(value - end) < 1e-6 * max(abs(end), typical) for end in parameter_limits(Model(), name))


def compute_shape_error(fit: ModelFit, shape: str, std: float) -> float:
    """Compute the error of a claim's shape parameter; infinite if it exceeds half of the parameter's size."""
    p = find_parameter(fit.model, shape)
    size = max(abs(fit.model.value(shape)), p.typical) if p.low >= 0 else (p.high - p.low) / 2
    return std if 0 < std < size / 2 else np.inf


def find_similar_pairs(own: Array, ranking: Sequence[CandidateScore]) -> tuple[tuple[tuple[str, ...], float], ...]:
    """Find pairs of effects that a claim may be confused with: their sum, but neither alone, has nearly its signature.

    own: the signature (points, k), from `ScoreTests.signature`. Only effects of one strength are paired. Returns names
    and cosine of the three most similar pairs, the most similar first.
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


def profile_std(evidence: WhitenedClips, reduced: ModelFit, fit: ModelFit, candidate: Candidate) -> dict[str, float]:
    """Compute the errors of a claim's strengths and shape parameters, by profile likelihood.

    They are those of `fit`, or larger if likely values lie further away. If the grid of shape parameters has few
    values, each value may widen them. A parabola as wide as the first-order chi^2 there gives the standard deviation.
    If the effect is so strong that first order fails, those of `fit` stay.

    reduced, fit: the fits without the candidate and with it.
    """
    max_gain = 2.0  # chi^2 by which other shapes may be better; beyond, first order fails
    likely_sigma = 3.0  # less likely values do not tell an interval of one or two sigma
    std = {n: s for n, s in fit.std.items() if n in candidate.strengths + candidate.shapes}
    tries = list(candidate.grid(reduced.model))
    if len(tries) < 2 or (len(tries) >= MIN_SCANNED_VALUES and can_scan(candidate, tries)):
        return std
    found = {s: fit.model.value(s) for s in candidate.shapes}
    plain, here = drop_mutual_push(reduced.model, reduced.launches, evidence.clips)
    if len(found) > 1:  # along a valley that runs between the points of a coarse grid
        near = [found | {s: shapes[s]} for s in found for shapes in tries]
        tries += [shapes for k, shapes in enumerate(near) if shapes not in near[:k]]
    trials = [prepare_trial(evidence, plain, reduced.launches, candidate, shapes, here) for shapes in (*tries, found)]
    tests = ScoreTests(reduced, tuple(trials))
    *others, (_, most, strengths) = tests.estimates()
    middle = dict(zip(candidate.strengths, strengths, strict=True)) | found
    if any(gain - most > max_gain for _, gain, _ in others) or abs(tests.chi2() - most - fit.chi2) > likely_sigma**2:
        return std
    for shapes, gain, strengths in others:
        values = dict(zip(candidate.strengths, strengths, strict=True)) | shapes
        ends = {n: parameter_limits(fit.model, n) for n in candidate.strengths}
        if most - gain > likely_sigma**2 or not all(low <= values[n] <= high for n, (low, high) in ends.items()):
            continue
        for name in std:
            away = abs(values[name] - middle[name])
            std[name] = max(std[name], float(away / np.sqrt(max(most - gain, 1.0))))
    return std
