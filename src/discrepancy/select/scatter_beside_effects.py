"""Fits the scatter from stretch to stretch beside the effects that would otherwise pass as scatter.

The scatter is part of the noise, so a search fits it before any effect is known. Beside the base model alone it also
takes what a strong effect does, and then hides that effect. So the scatter is fitted again with each leading effect in
the model. Effect and scatter together are compared with the scatter alone by their marginal likelihoods.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.fitting.gauss_newton import STEP_ERRORS, minimise_chi2
from discrepancy.fitting.jacobian import linearise
from discrepancy.fitting.model_fit import ModelFit, WhitenedClips
from discrepancy.fitting.noise_refit import RestrictedResiduals
from discrepancy.fitting.scatter_tails import TailLikelihood
from discrepancy.fitting.stretch_moves import StretchScatter, find_moves
from discrepancy.fitting.stretch_scatter import add_scatter, fit_scatter
from discrepancy.fitting.stretch_starts import leave_local_minima
from discrepancy.noise.model import Noise
from discrepancy.policy import current_policy
from discrepancy.select.library_fits import LibraryFits
from discrepancy.select.model_cost import compute_cost
from discrepancy.select.score_test import CandidateScore, largest_cosine

MAX_EFFECTS = 2  # that are added to the base model, one after the other
MAX_TRIED = 3  # effects that are fitted at a time
MIN_SHARE = 0.25  # of the excess of chi^2 by noise alone: one that explains less makes sizes 15 % larger at most


@dataclass(frozen=True)
class ScatterBesideModel:
    """A scatter, the fit beside which it is most likely, and how likely both are."""

    scatter: StretchScatter
    fit: ModelFit  # by the noise alone
    cost: float  # -2 log marginal likelihood of the residuals
    price: float  # of the effects of the model (`model_cost.compute_cost`)

    @classmethod
    def of(cls, clips: Sequence[MeasuredCollision], fit: ModelFit, base: ModelFit, noise: Noise) -> ScatterBesideModel:
        """Fit the scatter and a model, each beside the other, from a fit of clips without a scatter."""
        fit_sizes = partial(fit_scatter, noise=noise, max_positions=0)  # their map is of no use here
        known = add_scatter(clips, fit, fit_sizes(clips, fit), noise)
        fit = refit(WhitenedClips.of(known, noise), fit)
        scatter = fit_sizes(known, fit)
        known = add_scatter(known, fit, scatter, noise)
        at = fit.model, fit.names, fit.launches
        there = linearise(WhitenedClips.of(known, noise), *at)
        price = compute_cost(there, base) - there.chi2
        effects = [name for names in fit.added_names(base).values() for name in names]
        cost = compute_residual_cost(known, there.drop(fit.model, effects), scatter, noise)
        return cls(scatter, linearise(WhitenedClips.of(clips, noise), *at), cost, price)


def fit_scatter_beside_effects(
    clips: Sequence[MeasuredCollision], base: ModelFit, noise: Noise
) -> tuple[StretchScatter, ModelFit]:
    """Fit the scatter of stretches beside the base model, or beside effects that explain more than scatter does.

    base: the fit of these clips with `noise`, and without a scatter. Returns the scatter, and the fit beside it.

    Effects are tried where the scatter beside the base model is implausibly large. An effect is added if it is
    significant by its gain in likelihood, and if that gain exceeds its price. If the scatter stays implausible, it is
    real, and no effect is added. The search tests the effects again, and fits the scatter beside those that it selects.
    """
    scatter = fit_scatter(clips, base, noise)
    if not scatter.is_implausible:
        return scatter, base
    best, fit = ScatterBesideModel.of(clips, base, base, noise), base
    for _ in range(MAX_EFFECTS):
        leaders = LeadingEffects.of(clips, fit, noise)
        better = min(leaders.add_each(best, base), key=lambda one: one.cost + one.price, default=None)
        if better is None:
            break
        best, fit = better, better.fit
        if not best.scatter.is_implausible:
            break
    return (scatter, base) if best.scatter.is_implausible or fit is base else (fit_scatter(clips, fit, noise), fit)


@dataclass(frozen=True)
class LeadingEffects:
    """The effects that explain most of what a fit by noise alone leaves, to first order."""

    library: LibraryFits
    scores: Sequence[CandidateScore]
    noise: Noise

    @classmethod
    def of(cls, clips: Sequence[MeasuredCollision], fit: ModelFit, noise: Noise) -> LeadingEffects:
        """Find the effects that explain most of what `fit` leaves."""
        library = LibraryFits(WhitenedClips.of(clips, noise), fit)
        least = MIN_SHARE * (fit.chi2 - fit.points)
        ranking = sorted(library.ranking, key=lambda c: -c.gain)
        known = [c for c in ranking if c.identifiable and c.sigma > library.required_sigma and c.gain > least]
        return cls(library, known[:MAX_TRIED], noise)

    def add_each(self, known: ScatterBesideModel, base: ModelFit) -> Iterator[ScatterBesideModel]:
        """Add each to a model, fit the scatter again, and yield what is significantly more likely at its price.

        By noise alone an effect must explain half as much as the best does. Aliases of one with fewer parameters are
        left out.
        """
        library, tried = self.library, list[CandidateScore]()
        for scored in self.scores:
            library.extend(frozenset({scored.candidate}), library.base, scored)
        most = (library.base.chi2 + min(fit.chi2 for fit in library.fits.values())) / 2
        for scored in sorted(self.scores, key=lambda c: len(c.candidate.strengths + c.candidate.shapes)):
            fit = library.fits[frozenset({scored.candidate})]
            likeness = [largest_cosine(scored.signature, c.signature) for c in tried]
            if fit.chi2 > most or max(likeness, default=0.0) > current_policy().alias_cosine:
                continue
            tried.append(scored)
            with suppress(*STEP_ERRORS):  # the model has no motion for a stretch
                one = ScatterBesideModel.of(library.evidence.clips, fit, base, self.noise)
                gain = known.cost - one.cost
                is_significant = library.convert_to_sigma(gain, scored.candidate) > library.required_sigma
                if is_significant and one.price - known.price < gain:
                    yield one


def compute_residual_cost(
    clips: Sequence[MeasuredCollision], fit: ModelFit, scatter: StretchScatter, noise: Noise
) -> float:
    """Compute -2 log likelihood of what launches and parameters of a fit of these clips cannot absorb.

    The clips have the scatter in their covariance. The residuals count in units of the noise. So fits of other models,
    with other derivatives, can be compared.
    """
    every = range(len(clips))
    if not fit.model.sliding_friction:
        tails = TailLikelihood.of(clips, fit, noise, find_moves(clips, fit.model, fit.launches), every)
        return tails.cost(scatter, tails.find_multiples(scatter)[1])
    left = RestrictedResiduals.of(clips, fit, noise, every)
    nothing = tuple(np.concatenate([c[..., :-1], 0 * c[..., -1:]], axis=-1) for c in left.columns)
    alone = replace(left, clips=[replace(clip, scatter=None) for clip in clips], columns=nothing)
    return left.cost(noise) - alone.cost(noise)


def refit(evidence: WhitenedClips, fit: ModelFit) -> ModelFit:
    """Fit a model, from its known fit, to clips whose covariance is another one."""
    start = linearise(evidence, fit.model, fit.names, fit.launches)
    return leave_local_minima(evidence, minimise_chi2(evidence, start))
