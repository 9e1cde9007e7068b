"""Limits of each strength: which size of an effect an experiment could detect and name, from the effects' signatures.

The signature of an effect is its change of the whitened tracks, less all that shared parameters and launches absorb.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import brentq

from discrepancy.fitting.parameters import Candidate, find_parameter, list_candidates
from discrepancy.fitting.significance import chi2_to_sigma
from discrepancy.planning.experiment import PlannedExperiment
from discrepancy.policy import current_policy
from discrepancy.select.score_test import CandidateTrial, RealisticSizes, ScoreTests, detectable_axes
from synthcam.effect import Parameter
from synthcam.model import Model
from synthcam_shared.arrays import Array


@dataclass(frozen=True)
class Rival:
    """An effect with a similar signature: the cosine between the two, and the shapes at which it is largest."""

    effect: str
    cosine: float
    shapes: dict[str, float]


@dataclass(frozen=True)
class StrengthLimits:
    """The limits of one strength in an experiment.

    limit: the strength that half of such experiments detect at more than `SearchPolicy.detection_limit_sigma`; infinite
    where the fit absorbs it.
    naming_limit: the strength at which half of them distinguish it from its most similar rival as well.
    shows: whether the limit is small enough for a search to consider, and is a size that the effect allows.
    best, worst: the smallest and largest limit over all shapes that a search tries.
    scatter: the smallest and largest limit over several draws of the experiment.
    """

    effect: str
    strength: str  # dotted: "plate_tilt.x"
    unit: str
    typical: float  # a realistic size
    shapes: dict[str, float]  # the effect's shape parameters, by dotted name, for which the limits hold
    limit: float
    naming_limit: float
    shows: bool
    rivals: tuple[Rival, ...]  # the most similar first
    best: float
    worst: float
    scatter: tuple[float, float]

    @property
    def indistinguishable(self) -> tuple[str, ...]:
        """Effects that such an experiment could not distinguish from it, whatever their shapes."""
        return tuple(r.effect for r in self.rivals if r.cosine > current_policy().alias_cosine)


@dataclass(frozen=True)
class Signatures:
    """The signatures of effects in an experiment, as `find` scores them."""

    model: Model
    trials: tuple[CandidateTrial, ...]  # every candidate with each value tried of its shape parameters
    gram: Array  # (K, K): products of all trials' columns, less all that shared parameters and launches absorb
    trials_factors: Mapping[str, float]  # by the candidate's name

    @classmethod
    def of(cls, experiment: PlannedExperiment, only: Sequence[str] = ()) -> Signatures:
        """Compute signatures of all candidates, or of those in `only`. Raises ValueError if the model has no motion."""
        every = list_candidates(experiment.model, experiment.names)
        chosen = [c for c in every if not only or c.name in only]
        fit = experiment.fit()
        tests = ScoreTests.of(experiment.evidence, fit, only=chosen)
        columns = [np.concatenate(c, axis=1) for c in zip(*(t.columns for t in tests.trials), strict=True)]
        return cls(experiment.model, tests.trials, fit.information(columns)[0], tests.trials_factors)

    @cached_property
    def _spans(self) -> list[slice]:
        ends = np.cumsum([t.columns[0].shape[1] for t in self.trials]).tolist()
        return [slice(a, b) for a, b in zip([0, *ends[:-1]], ends, strict=True)]

    @cached_property
    def _axes(self) -> list[Array]:
        """For each trial the (k, m) array that makes an orthonormal basis of its signature."""
        lengths = [np.sqrt(sum((c**2).sum(axis=0) for c in t.columns)) for t in self.trials]
        return [detectable_axes(self.gram[s, s], length) for s, length in zip(self._spans, lengths, strict=True)]

    @cached_property
    def _sizes(self) -> dict[Candidate, RealisticSizes]:
        return {c: RealisticSizes.of(c, self.model) for c in dict.fromkeys(t.candidate for t in self.trials)}

    def _limit(self, trial: int, strength: int) -> float:
        """The limit of one strength of a trial, alone."""
        axes, span = self._axes[trial], self._spans[trial]
        shown = float(((axes.T @ self.gram[span, span.start + strength]) ** 2).sum()) if axes.size else 0.0
        if shown <= 0:
            return math.inf
        factor = self.trials_factors.get(self.trials[trial].candidate.name, 1.0)
        return math.sqrt(chi2_to_detect(axes.shape[1], factor) / shown)

    def limits(self) -> tuple[StrengthLimits, ...]:
        """Compute the limits of every strength of every candidate, in the candidates' order."""
        known = {  # the smallest limit over strengths and shapes, in realistic sizes
            c: min(self._limit(k, i) / float(size) for k in self._numbers(c) for i, size in enumerate(own.sizes))
            for c, own in self._sizes.items()
        }
        rivals = [k for k, t in enumerate(self.trials) if self._shows(t.candidate, known[t.candidate])]
        return tuple(self._row(c, k, rivals) for c in self._sizes for k in range(len(c.strengths)))

    def _numbers(self, candidate: Candidate) -> list[int]:
        return [k for k, t in enumerate(self.trials) if t.candidate == candidate]

    def _shows(self, candidate: Candidate, least: float) -> bool:
        return bool(least <= min(current_policy().max_detection_limit, self._sizes[candidate].allowed))

    def _row(self, candidate: Candidate, strength: int, others: Sequence[int]) -> StrengthLimits:
        numbers, name = self._numbers(candidate), candidate.strengths[strength]
        at = min(numbers, key=lambda k: _distance_from_typical(self.model, self.trials[k].shapes))
        limit, every = self._limit(at, strength), [self._limit(k, strength) for k in numbers]
        p, seen = find_parameter(self.model, name), [x for x in every if math.isfinite(x)]
        rivals = self._rivals(at, strength, others) if math.isfinite(limit) else ()
        return StrengthLimits(
            effect=candidate.name,
            strength=name,
            unit=p.unit,
            typical=p.typical or 1.0,
            shapes=self.trials[at].shapes,
            limit=limit,
            naming_limit=_naming_limit(limit, rivals),
            shows=self._shows(candidate, limit / (p.typical or 1.0)),
            rivals=rivals,
            best=min(seen, default=math.inf),
            worst=max(seen, default=math.inf),
            scatter=(limit, limit),
        )

    def _rivals(self, trial: int, strength: int, others: Sequence[int]) -> tuple[Rival, ...]:
        """The cosine with each other candidate, at the shapes at which it is largest."""
        candidate, column = self.trials[trial].candidate, self._spans[trial].start + strength
        own, best = self.gram[column, column], dict[str, Rival]()
        side = self._sizes[candidate].side
        for k in others:
            other, span = self.trials[k].candidate, self._spans[k]
            pull = self.gram[span, column]
            same_sign = side * self._sizes[other].side * pull[0] >= 0  # false if neither can have the other's sign
            if other == candidate or not same_sign:
                continue
            share = float(((self._axes[k].T @ pull) ** 2).sum()) / own
            cosine = math.sqrt(min(share, 1.0))
            if cosine > best.get(other.name, Rival("", -1.0, {})).cosine:
                best[other.name] = Rival(other.name, cosine, self.trials[k].shapes)
        return tuple(sorted(best.values(), key=lambda r: -r.cosine))


def _naming_limit(limit: float, rivals: Sequence[Rival]) -> float:
    """The limit over the sine between the signature and the most similar rival's; infinite if they coincide."""
    apart = 1 - rivals[0].cosine ** 2 if rivals else 1.0
    return limit / math.sqrt(apart) if apart > 1e-9 else math.inf


def chi2_to_detect(dof: int, trials_factor: float) -> float:
    """The chi^2 of an effect that half of all experiments detect at the significance of a detection limit.

    The median of a non-central chi^2 is nearly its non-centrality plus dof - 1: Sankaran, Biometrika 46 (1959) 235.
    """
    wanted = current_policy().detection_limit_sigma

    def short(chi2: float) -> float:
        return chi2_to_sigma(chi2 + dof - 1, dof, trials_factor) - wanted

    most = (wanted**2 + 2 * math.log(max(trials_factor, 1.0))) * (1 + dof)
    return float(brentq(short, 1e-6, most + 10 * dof))


def _distance_from_typical(model: Model, shapes: Mapping[str, float]) -> float:
    """The distance of shape parameters from their realistic sizes, to choose the nearest of those tried."""

    def distance(p: Parameter, x: float) -> float:
        return abs(math.log(x / p.typical)) if p.low > 0 else abs(x - p.typical) / (abs(p.typical) or 1.0)

    return sum(distance(find_parameter(model, name), value) for name, value in shapes.items())


def count_draws(clips: int) -> int:
    """Count the draws of so many collisions that give stable medians of limits: 150 collisions, at most five draws.

    The limits of 30 collisions scatter by a fifth from one draw to the next.
    """
    return min(5, math.ceil(150 / clips))


def median_limits(draws: Sequence[tuple[StrengthLimits, ...]]) -> tuple[StrengthLimits, ...]:
    """The median over draws of one scene of each strength's limits, and of its cosine with each other effect."""
    return tuple(_median(rows) for rows in zip(*draws, strict=True))


def _median(rows: Sequence[StrengthLimits]) -> StrengthLimits:
    cosines: dict[str, list[Rival]] = {}
    for row in rows:
        for rival in row.rivals:
            cosines.setdefault(rival.effect, []).append(rival)
    rivals = [
        dataclasses.replace(found[0], cosine=float(np.median([r.cosine for r in found])))
        for found in cosines.values()
        if 2 * len(found) > len(rows)
    ]
    rivals.sort(key=lambda r: -r.cosine)
    limit, best, worst = (float(np.median([getattr(r, key) for r in rows])) for key in ("limit", "best", "worst"))
    return dataclasses.replace(
        rows[0],
        limit=limit,
        naming_limit=_naming_limit(limit, rivals),
        shows=2 * sum(r.shows for r in rows) > len(rows),
        rivals=tuple(rivals),
        best=best,
        worst=worst,
        scatter=(min(r.limit for r in rows), max(r.limit for r in rows)),
    )
