"""Fit a free law: in full, with library effects beside it, without it, and to held-out clips."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import is_possible_launch
from discrepancy.fitting.gauss_newton import STEP_ERRORS, fit_model, minimise_chi2, solve_step
from discrepancy.fitting.jacobian import linearise
from discrepancy.fitting.model_fit import ModelFit, WhitenedClips
from discrepancy.fitting.parameters import Candidate, replace_within_limits
from discrepancy.free_laws.credible_band import gain_of_steps
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.free_laws.law_kinds import FreeLaw
from discrepancy.free_laws.marginal_likelihood import CurveEvidence, compute_significance, maximise_evidence
from discrepancy.free_laws.ranges import over_clips
from discrepancy.noise.model import Noise
from discrepancy.select.model_cost import compute_cost, law_choice_cost
from discrepancy.select.score_test import CandidateScore
from synthcam.model import Model
from synthcam_shared.arrays import Array

CONVERGED_CHI2 = 0.05  # a fit has converged if a further step would gain less


@dataclass(frozen=True)
class LawScore:
    """The score test of a free law beside a fit, to first order."""

    law: FreeLaw
    fit: ModelFit
    sigma: float
    information: Array
    pull: Array

    @cached_property
    def weight(self) -> CurveEvidence:  # slow, so only few laws need it
        return maximise_evidence(self.law, self.information, self.pull)

    def score(self, base: ModelFit) -> float:
        """The cost of the model with the law, in chi^2."""
        return compute_cost(self.fit, base) + law_choice_cost() - self.weight.gain


def whiten_law_columns(evidence: WhitenedClips, law: FreeLaw, model: Model, launches: Array) -> tuple[Array, ...]:
    """Whiten the derivatives of each clip by the coefficients of the law to be fitted, (2n, J)."""
    return evidence.whiten(law.derivatives(model, launches, evidence.clips))


def score_law(evidence: WhitenedClips, law: FreeLaw, fit: ModelFit, moves: Sequence[Array] | None = None) -> LawScore:
    """Score a law beside a fit; moves: its whitened derivatives, by default at the fit."""
    information, pull = fit.information(moves or whiten_law_columns(evidence, law, fit.model, fit.launches))
    return LawScore(law, fit, compute_significance(law, information, pull), information, pull)


def fit_law(evidence: WhitenedClips, test: LawScore, base: ModelFit, begun: FittedLaw | None = None) -> FittedLaw:
    """Fit a free law together with everything in another fit. The marginal likelihood chooses the prior of the law.

    test: the law, and the fit without it. base: the fit from which the cost of effects beside the law is counted.
    begun: an earlier fit of the same law to continue from, with everything to fit beside it. Raises ValueError if the
    model has no motion with a law on the way.
    """
    law = test.law
    if begun is None:
        plain, fit, here, coefs = test.fit.model, test.fit, evidence, np.zeros(law.size)
    else:
        plain, fit, here, coefs = begun.model_without_law, begun.fit, begun.evidence, begun.coefs
    moves = whiten_law_columns(here, law, fit.model, fit.launches)
    for _ in range(30):
        information, pull = fit.information(moves)
        weight = maximise_evidence(law, information, pull + information @ coefs)
        precision, step = weight.prior.precision, weight.coefs - coefs
        moved = None
        if step @ (information + precision) @ step > CONVERGED_CHI2:
            before = fit.chi2 + coefs @ precision @ coefs
            # of a step, the longest first; where the derivatives of another point lead up, new ones lead further
            for share in (1.0, 0.5, 0.25, 0.1, 0.02) if fit.is_linearised_here else (1.0,):
                moved = _moved(evidence, law, plain, fit, moves, coefs, share * step)
                if moved and moved[1].chi2 + (coefs + share * step) @ precision @ (coefs + share * step) < before:
                    coefs = coefs + share * step
                    here, fit, plain = moved
                    break
                moved = None
        if moved is None:
            if fit.is_linearised_here:
                break
            fit = linearise(here, fit.model, fit.names, fit.launches)
            moves = whiten_law_columns(evidence, law, law.add_to(plain, coefs), fit.launches)
    freedom = np.linalg.slogdet(np.eye(law.size) + information / np.diag(weight.prior.precision)[:, None])
    paid = law_choice_cost() + weight.prior.cost + float(coefs @ weight.prior.precision @ coefs + freedom[1])
    smooth = FittedLaw(law, coefs, weight.prior, fit, plain, here, moves, test.sigma, compute_cost(fit, base) + paid)
    return dataclasses.replace(smooth, score=smooth.score - gain_of_steps(smooth))


def _moved(
    evidence: WhitenedClips,
    law: FreeLaw,
    plain: Model,
    fit: ModelFit,
    moves: Sequence[Array],
    coefs: Array,
    step: Array,
) -> tuple[WhitenedClips, ModelFit, Model] | None:
    """Step the coefficients, and all other parameters by the step that fits best to first order.

    Returns the clips, the fit there, and its model without the law; None if that model has no motion. If no effect can
    hold the law, its displacements are subtracted from the clips.
    """
    shared, own = solve_step(fit.subtract(moves, step), 0.0, *fit.step_bounds())
    launches = fit.launches + own
    if not is_possible_launch(launches):
        return None
    try:
        plain = replace_within_limits(plain, dict(zip(fit.names, (fit.values() + shared).tolist(), strict=True)))
        model = law.add_to(plain, coefs + step)
        clips = law.subtract_from(evidence.clips, plain, launches, coefs + step)
        here = dataclasses.replace(evidence, clips=tuple(clips))
        residuals = here.whitened_residuals(model, launches)
    except STEP_ERRORS:
        return None
    return here, dataclasses.replace(fit, model=model, launches=launches, residuals=residuals), plain


def fit_law_with_effect(
    evidence: WhitenedClips, known: FittedLaw, effect: CandidateScore, base: ModelFit
) -> tuple[float, FittedLaw]:
    """Fit a free law again with one library effect more. Raises ValueError if there is no motion without the law.

    Returns the significance of the law beside the effect, and the fit.
    """
    model = known.model_without_law.replace(effect.shapes | dict.fromkeys(effect.strengths, 0.0))
    start = linearise(evidence, model, (*known.fit.names, *effect.strengths), known.fit.launches)
    test = score_law(evidence, known.law, minimise_chi2(evidence, start))
    fitted, names = fit_law(evidence, test, base), (*start.names, *effect.shapes)
    for _ in range(10 if effect.shapes else 0):  # law and shapes in turn: without the law shapes may diverge
        before, here, one = fitted.score, fitted.evidence, fitted.fit
        whole = minimise_chi2(here, linearise(here, one.model, names, one.launches))
        values = dict(zip(whole.names, whole.values().tolist(), strict=True))
        plain = replace_within_limits(fitted.model_without_law, values)
        begun = dataclasses.replace(fitted, fit=whole, model_without_law=plain)
        fitted = fit_law(evidence, test, base, begun)
        if fitted.score > before - CONVERGED_CHI2:
            break
    information, pull = fitted.fit.information(fitted.slopes)
    return compute_significance(fitted.law, information, pull + information @ fitted.coefs), fitted


def refit_without_effect(evidence: WhitenedClips, fitted_law: FittedLaw, gone: Candidate, base: ModelFit) -> FittedLaw:
    """Fit a free law again without the effect `gone` beside it. Raises ValueError if there is no motion."""
    names = tuple(n for n in fitted_law.fit.names if n not in gone.strengths + gone.shapes)
    start = linearise(evidence, gone.remove_from(fitted_law.model_without_law), names, fitted_law.fit.launches)
    test = score_law(evidence, fitted_law.law, minimise_chi2(evidence, start))
    return fit_law(evidence, test, base)


def fit_without_law(evidence: WhitenedClips, fitted_law: FittedLaw) -> ModelFit:
    """Fit everything beside a fitted law, without the law. Raises ValueError if there is no motion."""
    start = linearise(evidence, fitted_law.model_without_law, fitted_law.fit.names, fitted_law.fit.launches)
    return minimise_chi2(evidence, start)


def validate_clip_numbers(
    fitted_law: FittedLaw, clips: Sequence[MeasuredCollision], without: ModelFit, noise: Noise
) -> tuple[float, float, float]:
    """Test a law of one number for each clip on held-out clips.

    The held-out clips have numbers of their own, so the law predicts only the scatter of these numbers. `without` is
    the fit of the held-out clips without the law.

    Returns the gain in 2 log marginal likelihood by numbers of the size that was fitted. It also returns the mean and
    the standard deviation that this gain has if the numbers are of that size.
    """
    evidence = WhitenedClips.of(clips, noise)
    law = dataclasses.replace(fitted_law.law, axes=over_clips(len(clips)))
    fit = linearise(evidence, without.model, (), without.launches)
    information, pull = fit.information(whiten_law_columns(evidence, law, fit.model, fit.launches))
    size = fitted_law.prior.size * np.sqrt(law.prior_variances(fitted_law.prior.length))
    values, axes = np.linalg.eigh(size[:, None] * information * size)
    values, pulls = np.maximum(values, 0.0), axes.T @ (size * pull)
    gain = float((pulls**2 / (1 + values) - np.log1p(values)).sum())
    return gain, float((values - np.log1p(values)).sum()), float(np.sqrt(2 * (values**2).sum()))


def fit_unseen_clips(
    fitted_law: FittedLaw, clips: Sequence[MeasuredCollision], before: ModelFit, noise: Noise
) -> ModelFit:
    """Fit the launches of held-out clips, with the free law fixed.

    If the law is a number for each clip, the numbers of these clips are fitted too. before: the fit of these clips
    without the law. The fit's model holds the law. If no effect can hold it, its displacements are subtracted from the
    clips.
    """
    plain = fitted_law.model_without_law
    if fitted_law.law.is_per_clip:
        evidence = WhitenedClips.of(clips, noise)
        there = minimise_chi2(evidence, linearise(evidence, plain, (), before.launches))
        law = dataclasses.replace(fitted_law.law, axes=over_clips(len(clips)))
        return fit_law(evidence, score_law(evidence, law, there), there).fit
    left = fitted_law.law.subtract_from(clips, plain, before.launches, fitted_law.coefs)
    return fit_model(left, fitted_law.fit.model, (), noise, before.launches)
