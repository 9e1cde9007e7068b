"""Test each claim of a selection, mainly on held-out collisions, and reject those that fail."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum, auto

import numpy as np

from discrepancy.arrays import Array
from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import HEADING, T_C, V0, B
from discrepancy.fitting.gauss_newton import fit_model
from discrepancy.fitting.jacobian import differentiate
from discrepancy.fitting.linearise import linearise
from discrepancy.fitting.model_fit import ModelFit, WhitenedClips, project_out
from discrepancy.fitting.parameters import Candidate, candidates_by_name, parameter_limits
from discrepancy.fitting.significance import chi2_to_sigma, closes_too_little
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.noise.model import Noise
from discrepancy.policy import current_policy
from discrepancy.select.effect_claim import EffectClaim
from discrepancy.select.free_law_contest import find_replacements
from discrepancy.select.law_fit import compare_scatter, fit_unseen_clips, fit_without_law, refit_without_effect
from discrepancy.select.library_search import LibrarySearch, Selection
from discrepancy.select.model_cost import cost_of
from discrepancy.validate.residual_map import find_disagreements, is_unexplained

Residuals = Sequence[Array]  # whitened, of each clip


class Rejection(Enum):
    """The reason why a claim is rejected. `discrepancy.wording` describes it."""

    NOT_SIGNIFICANT = auto()  # beside everything else in the final model
    REPLACED = auto()  # another effect fits as well and passes, or fits better
    ABSORBED = auto()  # everything else explains as much without it
    HELD_OUT_WORSE = auto()  # held-out collisions are predicted worse with it, and support less than it promised
    LEFT_OUT_WORSE = auto()  # collisions, each left out once, are predicted worse with it
    LEFT_OUT_NOT_SIGNIFICANT = auto()  # collisions, each left out once, do not support it beyond chance
    SCATTERS = auto()  # much more is missing, and the strength scatters from collision to collision
    EXPLAINS_LITTLE = auto()  # much more is missing than it explains
    SHAPE_AT_LIMIT = auto()  # a shape parameter is at the end of its range
    VARIES = auto()  # its strength changes between collisions

    @property
    def leaves_nothing_missing(self) -> bool:
        """True if something else explains what the claim explains."""
        return self in (Rejection.REPLACED, Rejection.ABSORBED)


# --- The test on held-out collisions ---


@dataclass(frozen=True)
class HeldOutTest:
    """The support that held-out collisions give to a claim.

    Attributes
    ----------
    gap : (float, float)
        chi^2 per point, without the claim and with it.
    sigma : float
        The significance of the claim in these collisions.
    promised : float
        The significance that the claim predicts for them.
    """

    gap: tuple[float, float]
    sigma: float
    promised: float

    @classmethod
    def of(
        cls,
        without: Residuals,
        with_: Residuals,
        known: float,
        there: ModelFit | None = None,
        covariance: Array | None = None,
    ) -> HeldOutTest:
        """Compare the residuals of clips without a claim and with it.

        Let r be the whitened residuals without the claim, and d the whitened difference of the two predictions. The
        clips support the claim with r d / |d| sigma; the claim promised |d|. Noise changes that number by about one;
        the uncertainty of the claim changes it by |d| over its sigma. If the clips scatter about the claim more than
        noise does, sigma decreases by the same factor.

        Parameters
        ----------
        without, with_ : sequence of (2n,) arrays
            Whitened residuals of each clip, by the model without the claim and with it.
        known : float
            Sigma of the claim in the fitted clips; inf if these clips are among the fitted ones.
        there : ModelFit, optional
            The fit with the claim in these clips, for its derivatives.
        covariance : array, optional
            Covariance of its shared parameters from the fitted clips. Held-out clips may depend on directions that the
            fitted clips do not determine.

        Returns
        -------
        HeldOutTest
        """
        apart = [p - q for p, q in zip(without, with_, strict=True)]
        size = sum(float(d @ d) for d in apart)
        gap = tuple(sum(float(r @ r) for r in every) / sum(map(len, every)) for every in (without, with_))
        if not size > 0:
            return cls((gap[0], gap[1]), 0.0, 0.0)
        asked = sum(float(p @ d) for p, d in zip(without, apart, strict=True)) / size**0.5
        scatter = sum(float(q @ d) ** 2 for q, d in zip(with_, apart, strict=True)) / size
        uncertain = size / max(known, 1.0) ** 2
        if there is not None and covariance is not None:
            own = zip(there.launch_slopes, there.slopes, apart, strict=True)
            pull = np.asarray(sum(project_out(a, s).T @ d for a, s, d in own))
            uncertain = max(uncertain, float(pull @ covariance @ pull) / size)
        noise = max(1 + uncertain, scatter if np.isinf(known) else 0.0) ** 0.5
        return cls((gap[0], gap[1]), asked / noise, size**0.5 / noise)

    @property
    def is_worse(self) -> bool:
        """True if the claim does not improve the prediction."""
        return self.gap[1] >= self.gap[0]

    def closes_less_than(self, share: float) -> bool:
        """Tell if the model with the claim fits the clips poorly and closes less than this share of the excess."""
        return closes_too_little(*self.gap, share)


def judge_predictions(held_out: HeldOutTest, leave_one_out: HeldOutTest) -> Rejection | None:
    """Judge a claim by its predictions: the reason to reject it, or None if they support it.

    The held-out clips are a quarter of all. They show a claim at the detection limit with some 2.5 sigma, and one in
    ten true claims makes their gap a little larger. So they reject a claim only if their sigma falls short of the
    promise by more than their noise. In addition, all clips, each left out once, must support it beyond chance.

    Parameters
    ----------
    held_out, leave_one_out : HeldOutTest
        The test on the held-out clips, and on all clips with each left out in turn.

    Returns
    -------
    Rejection or None
    """
    policy = current_policy()
    if held_out.is_worse and held_out.sigma < held_out.promised - policy.max_shortfall_sigma:
        return Rejection.HELD_OUT_WORSE
    if leave_one_out.is_worse:
        return Rejection.LEFT_OUT_WORSE
    if leave_one_out.sigma < policy.leave_one_out_sigma:
        return Rejection.LEFT_OUT_NOT_SIGNIFICANT

    def both_close_less_than(share: float) -> bool:
        return held_out.closes_less_than(share) and leave_one_out.closes_less_than(share)

    weak = leave_one_out.sigma < policy.beside_free_law_sigma
    if weak and both_close_less_than(policy.min_closed_share_of_weak_claim):
        return Rejection.SCATTERS
    return Rejection.EXPLAINS_LITTLE if both_close_less_than(policy.min_closed_share) else None


def leave_one_out_residuals(fit: ModelFit, precision: Array | None = None) -> list[Array]:
    """Predict each clip by the shared parameters of all other clips, to first order; return the whitened residuals.

    The clip's own launch is fitted to it. Parameters at a limit stay there. The update is that of leave-one-out
    regression (Cook & Weisberg, Residuals and Influence in Regression, 1982).

    Parameters
    ----------
    fit : ModelFit
        The fit of all clips.
    precision : (J, J) array, optional
        Prior precision of the last J parameters, which are a free law's coefficients.

    Returns
    -------
    list of (2n,) array
    """
    free = np.array([not _is_at_limit(fit, name) for name in fit.names], dtype=bool)
    own = fit.linearisation.launch_bases
    slopes = [s[:, free] - q @ (q.T @ s[:, free]) for q, s in zip(own, fit.slopes, strict=True)]
    left = [r - q @ (q.T @ r) for q, r in zip(own, fit.residuals, strict=True)]
    if not free.any():
        return left
    prior = np.zeros((len(free), len(free)))
    if precision is not None:
        prior[-len(precision) :, -len(precision) :] = precision
    information = np.array([s.T @ s for s in slopes])
    whole = information.sum(axis=0) + prior[np.ix_(free, free)]
    scale = np.sqrt(np.where(np.diag(whole) > 0, np.diag(whole), 1.0))
    out = []
    for s, r, own_information in zip(slopes, left, information, strict=True):
        inverse = np.linalg.pinv((whole - own_information) / np.outer(scale, scale), rcond=1e-10, hermitian=True)
        out.append(r + s @ (inverse @ (s.T @ r / scale) / scale))
    return out


def _is_at_limit(fit: ModelFit, name: str) -> bool:
    if " " in name:  # a coefficient of a free law has no limits
        return False
    return fit.model.value(name) in parameter_limits(fit.model, name)


def leave_one_out_with_law(fitted_law: FittedLaw) -> list[Array]:
    """`leave_one_out_residuals` of a fit that holds a free law, with the law's prior."""
    return leave_one_out_residuals(fitted_law.joint_fit, fitted_law.prior.precision)


# --- The test that a strength is the same in all collisions ---


@dataclass(frozen=True)
class StrengthVariation:
    """The quantity that the strengths of an effect change with most, and the sigma, corrected for all trials."""

    against: str
    sigma: float

    def rejects(self, own: float) -> bool:
        """Tell if the variation is too large for a claim of `own` sigma."""
        return self.sigma > max(current_policy().unexplained_sigma, current_policy().max_strength_variation * own)


def find_variation(evidence: WhitenedClips, fit: ModelFit, strengths: Sequence[str]) -> StrengthVariation:
    """Find the quantity that the strengths of an effect change with most. A varying effect resembles another law.

    If the strength changes with position, clip or time, the residuals contain its signature times that change, to first
    order. This is a score test of each such change.

    Parameters
    ----------
    evidence : WhitenedClips
    fit : ModelFit
        The fit of the whole model to these clips.
    strengths : sequence of str
        Dotted names of the strengths of the effect.

    Returns
    -------
    StrengthVariation
    """
    min_information = 1e-8  # of the columns' own size: with less, the fit absorbs the direction
    features = [_features(*each) for each in zip(evidence.clips, range(len(fit.launches)), fit.launches, strict=True)]
    own = [differentiate(fit.model, fit.launches, evidence.clips, name) for name in strengths]
    moves = [np.stack(each, axis=-1)[..., None] for each in zip(*own, strict=True)]  # (n, 2, strengths, 1)
    best = StrengthVariation("", 0.0)
    for against in features[0]:
        columns = [
            (m * f[against][:, None, None]).reshape(*m.shape[:2], -1) for m, f in zip(moves, features, strict=True)
        ]
        white = evidence.whiten(columns)
        information, pull = fit.information(white)
        values, axes = np.linalg.eigh(information)
        seen = values > min_information * sum(float((c**2).sum()) for c in white)
        if not seen.any():
            continue  # it is the same in all clips, or the fit absorbs it
        chi2 = float(((axes[:, seen].T @ pull) ** 2 / values[seen]).sum())
        found = StrengthVariation(against, chi2_to_sigma(chi2, int(seen.sum()), len(features[0])))
        best = max(best, found, key=lambda c: c.sigma)
    return best


def _features(clip: MeasuredCollision, number: int, launch: Array) -> dict[str, Array]:
    """Quantities that a strength may change with: numbers (n, f) for each position of a clip, of order one."""
    since = np.maximum(clip.frame / clip.fps - launch[T_C], 0) / 0.1  # in units of 0.1 s
    b, is_a = float(launch[B]), (clip.ball == int(clip.striker == "a")).astype(float)

    def constant(*values: float) -> Array:
        return np.broadcast_to(np.array(values), (len(clip.frame), len(values)))

    return {
        "order of the clips": constant(float(number)),
        "heading": constant(float(np.cos(launch[HEADING])), float(np.sin(launch[HEADING]))),
        "speed": constant(float(launch[V0])),
        "obliqueness of the hit": constant(abs(b)),
        "side of the hit": constant(b),
        "ball that strikes": constant(float(clip.striker == "a")),
        "ball": is_a[:, None],
        "position": np.asarray(clip.xy),
        "time since the hit": np.stack([since, since**2], axis=1),
    }


# --- Validation: which claims pass ---


@dataclass(frozen=True)
class ClaimTest:
    """A claim with its tests.

    Attributes
    ----------
    name : str
    sigma : float
        Significance beside everything else, in the fitted clips.
    held_out, leave_one_out : HeldOutTest
        The tests on the held-out clips, and on all clips with each left out in turn.
    rejection : Rejection or None
    is_free_law : bool
        False for an effect of the library.
    shape_at_limit : (str, float) or None
        A shape parameter at the end of its range, and its value.
    variation : StrengthVariation or None
        The change of the strength, if that rejects the claim.
    """

    name: str
    sigma: float
    held_out: HeldOutTest
    leave_one_out: HeldOutTest
    rejection: Rejection | None = None
    is_free_law: bool = False
    shape_at_limit: tuple[str, float] | None = None
    variation: StrengthVariation | None = None

    def document(self) -> dict[str, float]:
        """The numbers of the tests, for discrepancy.json."""
        return {
            "without": self.held_out.gap[0],
            "with": self.held_out.gap[1],
            "sigma": self.held_out.sigma,
            "promised": self.held_out.promised,
            "turns_without": self.leave_one_out.gap[0],
            "turns_with": self.leave_one_out.gap[1],
            "turns_sigma": self.leave_one_out.sigma,
        }


@dataclass(frozen=True)
class ValidatedSelection:
    """A selection without the claims that were rejected.

    Attributes
    ----------
    selection : Selection
        The accepted part.
    claims : tuple of EffectClaim
        Its effects, with their numbers.
    accepted, rejected : tuple of ClaimTest
    """

    selection: Selection
    claims: tuple[EffectClaim, ...] = ()
    accepted: tuple[ClaimTest, ...] = ()
    rejected: tuple[ClaimTest, ...] = ()

    def claims_without_errors(self) -> tuple[EffectClaim, ...]:
        """The claims without errors, which are valid only if nothing more is missing."""
        sigma = {test.name: test.leave_one_out.sigma for test in self.accepted}
        return tuple(claim.without_errors(sigma.get(claim.effect, claim.sigma)) for claim in self.claims)


Tested = tuple[list[ClaimTest], dict[str, Selection], tuple[EffectClaim, ...]]


def validate(
    selection: Selection,
    library: LibrarySearch,
    held_out: Sequence[MeasuredCollision],
    before: ModelFit,
    noise: Noise,
    progress: Callable[[], None],
) -> ValidatedSelection:
    """Reject claims, the weakest first, until all that remain pass every test.

    After each rejection everything else is fitted and tested again. In three cases an effect needs more sigma, since it
    may be part of an unknown law:

    - it is claimed beside a free law;
    - a free law was rejected;
    - the model leaves something unexplained.

    Parameters
    ----------
    selection : Selection
        The effects and the free law that the search selected.
    library : LibrarySearch
        The search, with all models that it fitted.
    held_out : sequence of MeasuredCollision
        Clips that had no part in the selection.
    before : ModelFit
        The fit of the base model to the held-out clips.
    noise : Noise
    progress : callable
        Called now and then.

    Returns
    -------
    ValidatedSelection
    """
    return Validation(library, library.evidence, held_out, before, noise, progress).run(selection)


@dataclass(frozen=True)
class Validation:
    """The data of all tests of claims: the fitted clips, the held-out clips, and the fits of both."""

    library: LibrarySearch
    evidence: WhitenedClips
    held_out: Sequence[MeasuredCollision]
    before: ModelFit
    noise: Noise
    progress: Callable[[], None]

    def run(self, selection: Selection) -> ValidatedSelection:
        """See `validate`."""
        rejected: list[ClaimTest] = []
        while True:
            beside = (
                selection.free_law is not None
                or any(test.is_free_law for test in rejected)
                or self._leaves_something(selection)
            )
            level = current_policy().beside_free_law_sigma if beside else selection.required_sigma
            tests, without, claims = self._test_claims(selection, level)
            failed = [test for test in tests if test.rejection]
            if not failed:
                passed = {test.name for test in tests}  # a claim that failed beside another may pass without it
                still = tuple(test for test in rejected if test.name not in passed)
                return ValidatedSelection(selection, claims, tuple(tests), still)
            worst = min(failed, key=lambda t: (t.rejection is not Rejection.ABSORBED, t.leave_one_out.sigma))
            if worst.rejection and not worst.rejection.leaves_nothing_missing:
                rejected.append(worst)
            selection = without[worst.name]

    def _leaves_something(self, selection: Selection) -> bool:
        """Tell if the search selected effects and the residuals still hold a significant disagreement."""
        return bool(selection.state) and is_unexplained(
            find_disagreements(self.evidence.clips, selection.best, self.noise)
        )

    def _test_claims(self, selection: Selection, level: float) -> Tested:
        """Test each claim. Returns the tests, the selection without each claim, and the claims of effects.

        level: the sigma that an effect needs.
        """
        if selection.free_law is not None:
            return self._test_beside_law(selection, selection.free_law, level)
        tests, without, every = [], dict[str, Selection](), self.library.claims(selection.state)
        for candidate, claim in zip(selection.state, every, strict=True):
            less = self.library.drop(selection, candidate)
            without[candidate.name] = less
            predictions = self._compare_models(claim.sigma, less.best, selection.best)
            at_limit = claim.shape_at_limit()
            if not claim.sigma > max(level, selection.required_sigma):
                rejection: Rejection | None = Rejection.NOT_SIGNIFICANT
            else:
                rejection = judge_predictions(*predictions) or (Rejection.SHAPE_AT_LIMIT if at_limit else None)
                for alias in claim.aliases[1:] if rejection else ():
                    other = self.library.exchange(selection, candidate, alias)
                    if other and not judge_predictions(*self._compare_models(claim.sigma, less.best, other.best)):
                        without[candidate.name], rejection = other, Rejection.REPLACED
                        break
            variation = None
            if rejection is None:
                variation = find_variation(self.evidence, selection.best, candidate.strengths)
                rejection = Rejection.VARIES if variation.rejects(claim.sigma) else None
            test = ClaimTest(candidate.name, claim.sigma, *predictions, rejection)
            tests.append(replace(test, shape_at_limit=at_limit, variation=variation if rejection else None))
        return tests, without, every

    def _test_beside_law(self, selection: Selection, free_law: FittedLaw, level: float) -> Tested:
        """Do as `_test_claims` does, for a selection with a free law."""
        tests, without, claims = [], dict[str, Selection](), []
        whole, base = free_law.joint_fit, selection.base
        with_, residuals = self._fit_held_out_with_law(free_law), leave_one_out_with_law(free_law)
        known = candidates_by_name(free_law.model_without_law, base.model, base.names)
        for effect, sigma in free_law.significances_of_effects(base).items():
            own = selection.correct_for_trials(effect, sigma)
            claim = EffectClaim.of(known[effect], whole, whole.std, own)
            claims.append(claim)
            try:
                less = refit_without_effect(self.evidence, free_law, known[effect], base, self.progress)
            except ValueError:  # the clips have no motion without it
                continue
            without[effect] = replace(selection, free_law=less)
            fits = self._fit_held_out_with_law(less), with_
            predictions = self._predict(own, fits, (leave_one_out_with_law(less), residuals))
            at_limit = claim.shape_at_limit()
            if not own > max(level, selection.required_sigma):
                rejection: Rejection | None = Rejection.NOT_SIGNIFICANT
            elif less.score <= free_law.score:
                rejection = Rejection.ABSORBED
            else:
                rejection = judge_predictions(*predictions) or (Rejection.SHAPE_AT_LIMIT if at_limit else None)
            others = [] if rejection else self._find_rivals(less, known[effect], free_law.score, base)
            claims[-1] = replace(claim, aliases=(effect, *(name for name, _ in others)))
            if others and others[0][1].score < free_law.score - current_policy().rival_excluded_chi2:
                without[effect], rejection = replace(selection, free_law=others[0][1]), Rejection.REPLACED
            tests.append(ClaimTest(effect, own, *predictions, rejection, shape_at_limit=at_limit))
        without[free_law.law.name] = replace(selection, free_law=None)
        return [*tests, self._test_law(selection, free_law, with_, residuals)], without, tuple(claims)

    def _find_rivals(
        self, less: FittedLaw, named: Candidate, score: float, base: ModelFit
    ) -> list[tuple[str, FittedLaw]]:
        """Find effects that replace `named` beside a free law and fit as well, best first. score: that with `named`."""
        others = find_replacements(self.evidence, less, named, self.library.absorbed, base, self.progress)
        return [(name, other) for name, other in others if other.score < score + current_policy().rival_excluded_chi2]

    def _compare_models(self, own: float, without: ModelFit, with_: ModelFit) -> tuple[HeldOutTest, HeldOutTest]:
        """Compare the predictions of two models of the library."""
        fits = self._fit_held_out(without), self._fit_held_out(with_)
        return self._predict(own, fits, (leave_one_out_residuals(without), leave_one_out_residuals(with_)), with_)

    def _test_law(
        self, selection: Selection, free_law: FittedLaw, with_: ModelFit | None, residuals: Residuals
    ) -> ClaimTest:
        """Test the free law itself. A law of one number for each clip promises only how much these numbers scatter."""
        name, own = free_law.law.name, free_law.sigma
        try:
            empty = fit_without_law(self.evidence, free_law, self.progress)
        except ValueError:  # no motion without the free law
            predictions = self._predict(own, (None, with_), (residuals, residuals))
            return ClaimTest(name, own, *predictions, judge_predictions(*predictions), is_free_law=True)
        without = self._fit_held_out(empty)
        if without is None or not free_law.law.is_per_clip:
            predictions = self._predict(own, (without, with_), (leave_one_out_residuals(empty), residuals))
            return ClaimTest(name, own, *predictions, judge_predictions(*predictions), is_free_law=True)
        gain, promised, std = compare_scatter(free_law, self.held_out, without, self.noise)
        before, std = without.chi2 / without.points, max(std, 1e-9)
        held_out = HeldOutTest((before, before - gain / without.points), gain / std, promised / std)
        gain += cost_of(empty, selection.base) - free_law.score  # in the clips fitted
        every = HeldOutTest((before, before - gain / without.points), own, own)
        return ClaimTest(name, own, held_out, every, judge_predictions(held_out, every), is_free_law=True)

    def _predict(
        self,
        own: float,
        fits: tuple[ModelFit | None, ModelFit | None],
        residuals: tuple[Residuals, Residuals],
        fit: ModelFit | None = None,
    ) -> tuple[HeldOutTest, HeldOutTest]:
        """Make the tests on held-out clips and on all clips. A model without motion for held-out clips fails both.

        Parameters
        ----------
        own : float
            Sigma of the claim.
        fits : (ModelFit or None, ModelFit or None)
            Fits of the held-out clips, without and with the claim.
        residuals : (sequence, sequence)
            Leave-one-out residuals of the fitted clips, without and with the claim.
        fit : ModelFit, optional
            The fit of the fitted clips with the claim, for its covariance.
        """
        without, with_ = fits
        if with_ is None:
            nothing = HeldOutTest((self.before.chi2 / self.before.points, math.inf), -math.inf, own)
            return nothing, nothing
        if without is None:
            nothing = HeldOutTest((math.inf, with_.chi2 / with_.points), own, own)
            return nothing, nothing
        parts = without.residuals, with_.residuals
        every = [[*fitted, *unseen] for fitted, unseen in zip(residuals, parts, strict=True)]
        there = covariance = None
        if fit:
            held_out = WhitenedClips.of(self.held_out, self.noise)
            there, covariance = linearise(held_out, fit.model, fit.names, with_.launches), fit.covariance
        return HeldOutTest.of(*parts, own, there, covariance), HeldOutTest.of(every[0], every[1], np.inf)

    def _fit_held_out(self, fit: ModelFit) -> ModelFit | None:
        """Fit the launches of the held-out clips by a model of the library; None if it has no motion for them."""
        try:
            return fit_model(self.held_out, fit.model, (), self.noise, self.before.launches, self.progress)
        except ValueError:
            return None

    def _fit_held_out_with_law(self, free_law: FittedLaw) -> ModelFit | None:
        try:
            return fit_unseen_clips(free_law, self.held_out, self.before, self.noise)
        except ValueError:
            return None
