"""Test each claim of a selection, mainly on held-out collisions, and reject those that fail."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from enum import Enum, auto

import numpy as np
from scipy.special import chdtrc, fdtrc, ndtri

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import HEADING, T_C, V0, B
from discrepancy.fitting.jacobian import differentiate_tracks, linearise
from discrepancy.fitting.model_fit import ModelFit, WhitenedClips, project_out
from discrepancy.fitting.parameters import candidates_by_name, parameter_limits
from discrepancy.fitting.significance import chi2_to_sigma, explains_too_little
from discrepancy.fitting.stretch_starts import fit_launches
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.noise.model import Noise
from discrepancy.policy import current_policy
from discrepancy.select.effect_claim import EffectClaim
from discrepancy.select.free_law_contest import find_replacements
from discrepancy.select.law_fit import fit_unseen_clips, fit_without_law, refit_without_effect, validate_clip_numbers
from discrepancy.select.library_fits import LibraryFits
from discrepancy.select.library_search import Selection, describe_claims, exchange_effect, make_selection
from discrepancy.select.model_cost import compute_cost
from discrepancy.time_left import in_stage
from discrepancy.validate.gap import weigh_clips
from discrepancy.validate.residual_map import find_disagreements, is_unexplained
from synthcam_shared.arrays import Array

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
    AGREES_WITH_ZERO = auto()  # its size agrees with zero by the scatter of the collisions, which exceeds their errors
    SIZE_UNKNOWN = auto()  # its size agrees with zero by its own error, although the fit is worse without it

    @property
    def leaves_nothing_missing(self) -> bool:
        """True if something else explains what the claim explains."""
        return self in (Rejection.REPLACED, Rejection.ABSORBED)


# --- The test on held-out collisions ---


@dataclass(frozen=True)
class HeldOutTest:
    """The support that held-out collisions give to a claim."""

    gap: tuple[float, float]  # chi^2 per point, without the claim and with it; outlier clips count less
    sigma: float  # the significance of the claim in these collisions
    promised: float  # the significance that the claim predicts for them

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
        noise does, sigma decreases by the same factor. Clips that neither model predicts count less (`weigh_clips`).

        without, with_: whitened residuals (2n,) of each clip, by the model without the claim and with it.
        known: sigma of the claim in the fitted clips; inf if these clips are among the fitted ones.
        there: the fit with the claim in these clips, for its derivatives.
        covariance: that of its shared parameters from the fitted clips; held-out clips may depend on directions that
        the fitted clips do not determine.
        """
        weights = np.sqrt(weigh_clips(without, with_))
        points = float(sum(w**2 * len(r) for w, r in zip(weights, without, strict=True)))
        without, with_ = ([w * r for w, r in zip(weights, each, strict=True)] for each in (without, with_))
        gap = sum(float(r @ r) for r in without) / points, sum(float(r @ r) for r in with_) / points
        apart = [p - q for p, q in zip(without, with_, strict=True)]
        size = sum(float(d @ d) for d in apart)
        if not size > 0:
            return cls(gap, 0.0, 0.0)
        asked = sum(float(p @ d) for p, d in zip(without, apart, strict=True)) / size**0.5
        scatter = sum(float(q @ d) ** 2 for q, d in zip(with_, apart, strict=True)) / size
        uncertain = size / max(known, 1.0) ** 2
        if there is not None and covariance is not None:
            own = zip(there.launch_slopes, there.slopes, apart, weights, strict=True)
            pull = np.asarray(sum(w * (project_out(a, s).T @ d) for a, s, d, w in own))
            uncertain = max(uncertain, float(pull @ covariance @ pull) / size)
        noise = max(1 + uncertain, scatter if np.isinf(known) else 0.0) ** 0.5
        return cls(gap, asked / noise, size**0.5 / noise)

    @property
    def is_worse(self) -> bool:
        """True if the claim does not improve the prediction."""
        without, with_ = self.gap
        return with_ >= without


def judge_predictions(held_out: HeldOutTest, leave_one_out: HeldOutTest) -> Rejection | None:
    """Judge a claim by its predictions: the reason to reject it, or None if they support it.

    The held-out clips are a quarter of all. They show a claim at the detection limit with some 2.5 sigma, and one in
    ten true claims makes their gap a little larger. So they reject a claim only if their sigma falls short of the
    promise by more than their noise. In addition, all clips, each left out once, must support it beyond chance.
    """
    policy = current_policy()
    if held_out.is_worse and held_out.sigma < held_out.promised - policy.max_shortfall_sigma:
        return Rejection.HELD_OUT_WORSE
    if leave_one_out.is_worse:
        return Rejection.LEFT_OUT_WORSE
    if leave_one_out.sigma < policy.leave_one_out_sigma:
        return Rejection.LEFT_OUT_NOT_SIGNIFICANT

    def both_close_less_than(share: float) -> bool:
        return all(explains_too_little(*test.gap, share) for test in (held_out, leave_one_out))

    weak = leave_one_out.sigma < policy.beside_free_law_sigma
    if weak and both_close_less_than(policy.min_closed_share_of_weak_claim):
        return Rejection.SCATTERS
    return Rejection.EXPLAINS_LITTLE if both_close_less_than(policy.min_closed_share) else None


def leave_one_out_residuals(fit: ModelFit, precision: Array | None = None) -> list[Array]:
    """Test a claim's fit by predicting each clip from all others; return the whitened residuals: `leave_each_out`."""
    return leave_each_out(fit, precision)[0]


def leave_each_out(fit: ModelFit, precision: Array | None = None) -> tuple[list[Array], Array, Array]:
    """Leave each clip out of a fit in turn, to first order: its whitened residuals, and how the parameters change.

    The clip's own launch is fitted to it. Parameters at a limit stay there; their changes are NaN. The update is that
    of leave-one-out regression (Cook & Weisberg, Residuals and Influence in Regression, 1982).

    precision (J, J): the prior precision of the last J parameters, which are a free law's coefficients. Returns the
    residuals of each clip, the changes (clips, S), and the covariance (S, S) of the parameters by noise.
    """

    def is_free(name: str) -> bool:  # a name with a space is a coefficient of a free law, which has no limits
        return " " in name or fit.model.value(name) not in parameter_limits(fit.model, name)

    free = np.array([is_free(name) for name in fit.names], dtype=bool)
    own = fit.linearisation.launch_bases
    slopes = [s[:, free] - q @ (q.T @ s[:, free]) for q, s in zip(own, fit.slopes, strict=True)]
    left = [r - q @ (q.T @ r) for q, r in zip(own, fit.residuals, strict=True)]
    changes, by_noise = np.full((len(left), len(free)), np.nan), np.full((len(free), len(free)), np.nan)
    if not free.any():
        return left, changes, by_noise
    prior = np.zeros((len(free), len(free)))
    if precision is not None:
        prior[-len(precision) :, -len(precision) :] = precision
    information = np.array([s.T @ s for s in slopes])
    whole = information.sum(axis=0) + prior[np.ix_(free, free)]
    scale = np.sqrt(np.where(np.diag(whole) > 0, np.diag(whole), 1.0))

    def invert(matrix: Array) -> Array:
        units = np.outer(scale, scale)
        return np.asarray(np.linalg.pinv(matrix / units, rcond=1e-10, hermitian=True) / units)

    by_noise[np.ix_(free, free)] = invert(whole)
    out = []
    for k, (s, r, own_information) in enumerate(zip(slopes, left, information, strict=True)):
        changes[k, free] = -invert(whole - own_information) @ (s.T @ r)
        out.append(r - s @ changes[k, free])
    return out, changes, by_noise


@dataclass(frozen=True)
class Jackknife:
    """The covariance (S, S) of the shared parameters, by their changes as each clip is left out in turn.

    It follows from the scatter of the clips, whatever the noise model says. It is the jackknife of MacKinnon & White,
    J. Econometrics 29 (1985) 305, with clips instead of points. A cause that changes all clips in the same way does not
    enter. by_noise: the covariance (S, S) that the noise model gives. A parameter at a limit has the covariance NaN.
    """

    names: tuple[str, ...]
    clips: int
    covariance: Array
    by_noise: Array

    @classmethod
    def of(cls, fit: ModelFit, precision: Array | None = None) -> Jackknife:
        """Leave each clip out of a fit in turn; precision: that of `leave_each_out`."""
        _, changes, by_noise = leave_each_out(fit, precision)
        off = changes - changes.mean(axis=0)
        return cls(tuple(fit.names), len(changes), (len(changes) - 1) / len(changes) * off.T @ off, by_noise)

    @property
    def std(self) -> dict[str, float]:
        """The standard deviation of each parameter."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    def distance_from_zero(self, strengths: Mapping[str, float], *, least_p: float = 0.05) -> float:
        """The sigma by which the strengths of an effect, by name, differ jointly from zero by the scatter of the clips.

        It is inf if no strength has an error, or if noise explains the scatter. Few clips determine their own scatter
        badly, so sigma follows from Hotelling's T^2. With one strength this is Student's t with one degree of freedom
        less than there are clips. Cameron & Miller, J. Human Resources 50 (2015) 317, recommend it for errors by the
        scatter of few groups.

        If noise explains the scatter, such a test would lose half of all true claims of 6 sigma in five clips. The
        scatter therefore counts only if noise makes it so large with a probability below `least_p`. The ratio of T^2 by
        noise to that by scatter has a chi^2 distribution (Mardia, Kent & Bibby, Multivariate Analysis (1979), 3.4.7).
        """
        rows, t2, t2_by_noise = self._square_distances(strengths)
        if not rows or rows >= self.clips:
            return math.inf
        freedom = self.clips - rows
        if t2 > 0 and chdtrc(freedom, (self.clips - 1) * t2_by_noise / t2) > least_p:
            return math.inf
        p = float(fdtrc(rows, freedom, t2 * freedom / (rows * (self.clips - 1))))
        return -float(ndtri(p / 2)) if p > 0 else math.inf

    def distance_from_zero_by_noise(self, strengths: Mapping[str, float]) -> float:
        """The sigma by which the strengths of an effect, by name, differ jointly from zero by the noise alone.

        It is inf if no strength has an error. It may be far less than the sigma of the claim, which follows from the
        rise of chi^2 without the effect: the effect may let one launch become extreme, and only that lowers chi^2.
        """
        rows, _, t2_by_noise = self._square_distances(strengths)
        return chi2_to_sigma(t2_by_noise, rows) if rows else math.inf

    def _square_distances(self, strengths: Mapping[str, float]) -> tuple[int, float, float]:
        """How many of the strengths have an error; their joint squared distance from zero by scatter and by noise."""
        rows = [k for k, name in enumerate(self.names) if name in strengths and self.covariance[k, k] > 0]
        own = np.ix_(rows, rows)
        size = np.sqrt(np.diag(self.covariance)[rows])  # strengths may have different units
        values = np.array([strengths[self.names[k]] for k in rows]) / size
        by_scatter, by_noise = (
            float(values @ np.linalg.pinv(matrix[own] / np.outer(size, size), hermitian=True) @ values)
            for matrix in (self.covariance, self.by_noise)
        )
        return len(rows), by_scatter, by_noise


def leave_one_out_with_law(fitted_law: FittedLaw) -> list[Array]:
    """Test a fit with a free law as `leave_one_out_residuals` does, with the law's prior."""
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


def find_strength_variation(evidence: WhitenedClips, fit: ModelFit, strengths: Sequence[str]) -> StrengthVariation:
    """Test if a claim is constant: find the quantity that its strengths change with most.

    If the strength changes with position, clip or time, the residuals contain its signature times that change, to first
    order. This is a score test of each such change. `fit` is that of the whole model to these clips.
    """
    min_information = 1e-8  # of the columns' own size: with less, the fit absorbs the direction
    features = [_features(*each) for each in zip(evidence.clips, range(len(fit.launches)), fit.launches, strict=True)]
    own = [differentiate_tracks(fit.model, fit.launches, evidence.clips, name) for name in strengths]
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
    """A claim with its tests."""

    name: str
    sigma: float  # significance beside everything else, in the fitted clips
    # the tests on the held-out clips, and on all clips with each left out in turn
    held_out: HeldOutTest
    leave_one_out: HeldOutTest
    rejection: Rejection | None = None
    is_free_law: bool = False  # false for an effect of the library
    # A shape parameter at the end of its range, or such a strength of a weaker effect of stretches; and its value.
    shape_at_limit: tuple[str, float] | None = None
    variation: StrengthVariation | None = None  # the change of the strength, if that rejects the claim
    from_zero: float = math.inf  # sigma of its size, by the scatter of the clips; inf where noise gives the error

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
    """A selection without the rejected claims; the claims of its effects; and the tests of all claims."""

    selection: Selection
    claims: tuple[EffectClaim, ...] = ()
    accepted: tuple[ClaimTest, ...] = ()
    rejected: tuple[ClaimTest, ...] = ()

    def claims_by_scatter(self, is_cut: bool) -> tuple[EffectClaim, ...]:
        """The claims where errors from noise are too small: of free stretches (is_cut), or if more is missing.

        Errors of free stretches follow from their scatter. In whole collisions the missing physics may change all clips
        in the same way, so no error is given.
        """
        law, std = self.selection.free_law, dict[str, float]()
        if is_cut and self.claims:
            std = Jackknife.of(self.selection.joint_fit, law.prior.precision if law else None).std
        sigma = {test.name: test.leave_one_out.sigma for test in self.accepted}
        return tuple(claim.judge_by_scatter(sigma.get(claim.effect, claim.sigma), std) for claim in self.claims)


@dataclass(frozen=True)
class HeldOutClips:
    """Clips that had no part in the selection, their noise, and the fit of the base model to them."""

    clips: Sequence[MeasuredCollision]
    noise: Noise
    before: ModelFit
    known: dict[int, tuple[ModelFit, ModelFit | None]] = field(default_factory=dict, repr=False, compare=False)

    def fit(self, fit: ModelFit) -> ModelFit | None:
        """Fit the launches by a model of the library; None if it has no motion for them.

        `known` keeps the results by the identity of the fit, because each claim is compared with the same fit of all.
        """
        if id(fit) not in self.known:
            found = None
            with suppress(ValueError):
                found = fit_launches(self.clips, fit.model, self.noise, self.before.launches)
            self.known[id(fit)] = fit, found
        return self.known[id(fit)][1]

    def fit_with_law(self, free_law: FittedLaw) -> ModelFit | None:
        """Do as `fit` does, by a model with a free law."""
        with suppress(ValueError):
            return fit_unseen_clips(free_law, self.clips, self.before, self.noise)
        return None


Predictions = tuple[HeldOutTest, HeldOutTest]  # on held-out clips, and on fitted clips with each left out in turn
Tested = tuple[list[ClaimTest], dict[str, Selection], tuple[EffectClaim, ...]]  # tests, selection without each, claims


@in_stage("gap")
def validate(selection: Selection, library: LibraryFits, held_out: HeldOutClips) -> ValidatedSelection:
    """Validate claims: reject the weakest first, until all that remain pass every test.

    After each rejection everything else is fitted and tested again. In three cases an effect needs more sigma, since it
    may be part of an unknown law:

    - it is claimed beside a free law;
    - a free law was rejected;
    - the model leaves something unexplained.

    library: all models that the search fitted.
    """
    rejected, replaced = list[ClaimTest](), set[str]()
    while True:
        law, level = selection.free_law, library.required_sigma
        is_unsure = law or any(test.is_free_law for test in rejected)
        if selection.state and not is_unsure:
            left = find_disagreements(library.evidence.clips, selection.best, held_out.noise)
            is_unsure = is_unexplained(left, current_policy())
        level = max(level, current_policy().beside_free_law_sigma) if is_unsure else level
        if law:
            tests, without, claims = _test_beside_law(selection, library, held_out, level)
        else:
            tests, without, claims = _test_effects(selection, library, held_out, level, replaced)
        failed = [test for test in tests if test.rejection]
        if not failed:
            passed = {test.name for test in tests}  # a claim that failed beside another may pass without it
            still = tuple(test for test in rejected if test.name not in passed)
            return ValidatedSelection(selection, claims, tuple(tests), still)
        worst = min(failed, key=lambda t: (t.rejection is not Rejection.ABSORBED, t.leave_one_out.sigma))
        if worst.rejection and not worst.rejection.leaves_nothing_missing:
            rejected.append(worst)
        if worst.rejection is Rejection.REPLACED:
            replaced.add(worst.name)
        selection = without[worst.name]


def judge_claim(
    claim: EffectClaim,
    predictions: Predictions,
    level: float,
    from_zero: float = math.inf,
    absorbed: bool = False,
    least_from_zero: float = 0.0,
) -> Rejection | None:
    """Judge a claim that needs `level` sigma.

    from_zero: sigma by which its strengths differ from zero by their scatter between clips; inf where the errors follow
    from noise. absorbed: everything else explains as much without it. least_from_zero: what from_zero must reach, if
    that is more than `SearchPolicy.leave_one_out_sigma`.
    """
    if not claim.sigma > level:
        return Rejection.NOT_SIGNIFICANT
    if absorbed:
        return Rejection.ABSORBED
    if rejection := judge_predictions(*predictions):
        return rejection
    if claim.shape_at_limit():
        return Rejection.SHAPE_AT_LIMIT
    least = max(current_policy().leave_one_out_sigma, least_from_zero)
    return Rejection.AGREES_WITH_ZERO if from_zero < least else None


def _test_effects(
    selection: Selection,
    library: LibraryFits,
    held_out: HeldOutClips,
    level: float,
    replaced: Collection[str] = (),
) -> Tested:
    """Test each effect of a selection without a free law.

    level: the sigma that an effect needs. replaced: effects that do not come back in the place of their alias. Two
    effects that fail the same test would else replace one another without end.

    A weaker effect of free stretches, beside a stronger one, is the best of all candidates in what the stronger one
    leaves. So its size must differ from zero by the level that is corrected for them, also by the scatter of the
    stretches. If it does not, no alias takes its place: that would be one more choice from the same evidence. A
    strength at an end of its range has no error, so it is not claimed either. Neither is a size that its own error does
    not distinguish from zero: such an effect lets one launch become extreme, and only that lowers chi^2.
    """
    tests, without, claims = [], dict[str, Selection](), describe_claims(library, selection.state)
    is_cut = any(clip.is_stretch for clip in library.evidence.clips)
    by_scatter, strongest = level > library.required_sigma or is_cut, max((c.sigma for c in claims), default=0.0)
    jackknife = Jackknife.of(selection.best) if by_scatter and selection.state else None

    for candidate, claim in zip(selection.state, claims, strict=True):
        less = make_selection(library, tuple(s for s in selection.state if s != candidate))
        without[candidate.name] = less
        predictions = compare_models(claim.sigma, less.best, selection.best, held_out)
        from_zero = jackknife.distance_from_zero(claim.values) if jackknife else math.inf
        is_weaker = is_cut and claim.sigma < strongest
        least, at_limit = library.required_sigma if is_weaker else 0.0, claim.shape_at_limit()
        rejection, variation = judge_claim(claim, predictions, level, from_zero, least_from_zero=least), None
        if is_weaker and not rejection and (at_limit := claim.strength_at_limit()):
            rejection = Rejection.SHAPE_AT_LIMIT
        elif is_weaker and not rejection and _is_unknown(jackknife, claim):
            rejection = Rejection.SIZE_UNKNOWN
        elif rejection and rejection is not Rejection.NOT_SIGNIFICANT:
            is_scattered = is_weaker and rejection is Rejection.AGREES_WITH_ZERO
            for alias in claim.aliases[1:] if not is_scattered else ():
                other = None if alias in replaced else exchange_effect(library, selection, candidate, alias)
                if other and not judge_predictions(*compare_models(claim.sigma, less.best, other.best, held_out)):
                    without[candidate.name], rejection = other, Rejection.REPLACED
                    break
        elif not rejection:
            found = find_strength_variation(library.evidence, selection.best, candidate.strengths)
            if found.rejects(claim.sigma):
                rejection, variation = Rejection.VARIES, found
        test = ClaimTest(candidate.name, claim.sigma, *predictions, rejection, from_zero=from_zero)
        tests.append(replace(test, shape_at_limit=at_limit, variation=variation))
    return tests, without, claims


def _is_unknown(jackknife: Jackknife | None, claim: EffectClaim) -> bool:
    """Tell if the size of a claim agrees with zero by its own error."""
    return jackknife is not None and (
        jackknife.distance_from_zero_by_noise(claim.values) < current_policy().leave_one_out_sigma
    )


def _test_beside_law(selection: Selection, library: LibraryFits, held_out: HeldOutClips, level: float) -> Tested:
    """Test a free law and each effect beside it."""
    free_law, tests, without, claims = selection.free_law, [], dict[str, Selection](), []
    assert free_law is not None
    whole, base, evidence = free_law.joint_fit, selection.base, library.evidence
    with_, residuals = held_out.fit_with_law(free_law), leave_one_out_with_law(free_law)
    jackknife = Jackknife.of(whole, free_law.prior.precision)
    known = candidates_by_name(free_law.model_without_law, base.model, base.names)
    for effect, sigma in free_law.significances_of_effects(base).items():
        claim = EffectClaim.of(known[effect], whole, whole.std, library.correct_for_trials(effect, sigma))
        claims.append(claim)
        try:
            less = refit_without_effect(evidence, free_law, known[effect], base)
        except ValueError:  # the clips have no motion without it
            continue
        without[effect] = replace(selection, free_law=less)
        fits, left_out = (held_out.fit_with_law(less), with_), (leave_one_out_with_law(less), residuals)
        predictions = compare_predictions(claim.sigma, fits, left_out, held_out)
        from_zero = jackknife.distance_from_zero(claim.values)
        rejection = judge_claim(claim, predictions, level, from_zero, absorbed=less.score <= free_law.score)
        if not rejection:
            others = find_replacements(evidence, less, known[effect], library.absorbed, base)
            excluded = current_policy().rival_excluded_chi2
            rivals = [(name, other) for name, other in others if other.score < free_law.score + excluded]
            claims[-1] = replace(claim, aliases=(effect, *(name for name, _ in rivals)))
            if rivals and rivals[0][1].score < free_law.score - excluded:
                without[effect], rejection = replace(selection, free_law=rivals[0][1]), Rejection.REPLACED
        test = ClaimTest(effect, claim.sigma, *predictions, rejection, shape_at_limit=claim.shape_at_limit())
        tests.append(replace(test, from_zero=from_zero))
    without[free_law.law.name] = replace(selection, free_law=None)
    predictions = _predict_with_law(selection.base, free_law, library, held_out, (with_, residuals))
    rejection = judge_predictions(*predictions)
    tests.append(ClaimTest(free_law.law.name, free_law.sigma, *predictions, rejection, is_free_law=True))
    return tests, without, tuple(claims)


def _predict_with_law(
    base: ModelFit,
    free_law: FittedLaw,
    library: LibraryFits,
    held_out: HeldOutClips,
    with_law: tuple[ModelFit | None, Residuals],
) -> Predictions:
    """Test a free law itself; a law of one number for each clip promises only how much these numbers scatter."""
    own, (with_, residuals) = free_law.sigma, with_law
    try:
        empty = fit_without_law(library.evidence, free_law)
    except ValueError:  # no motion without the free law
        return compare_predictions(own, (None, with_), (residuals, residuals), held_out)
    without = held_out.fit(empty)
    if without is None or not free_law.law.is_per_clip:
        return compare_predictions(own, (without, with_), (leave_one_out_residuals(empty), residuals), held_out)
    gain, promised, std = validate_clip_numbers(free_law, held_out.clips, without, held_out.noise)
    before, std = without.chi2 / without.points, max(std, 1e-9)
    unseen = HeldOutTest((before, before - gain / without.points), gain / std, promised / std)
    gain += compute_cost(empty, base) - free_law.score  # in the clips fitted
    return unseen, HeldOutTest((before, before - gain / without.points), own, own)


def compare_models(own: float, without: ModelFit, with_: ModelFit, held_out: HeldOutClips) -> Predictions:
    """Compare the predictions of held-out clips by two models of the library; own: sigma of the claim."""
    fits = held_out.fit(without), held_out.fit(with_)
    residuals = leave_one_out_residuals(without), leave_one_out_residuals(with_)
    return compare_predictions(own, fits, residuals, held_out, with_)


def compare_predictions(
    own: float,
    fits: tuple[ModelFit | None, ModelFit | None],
    residuals: tuple[Residuals, Residuals],
    held_out: HeldOutClips,
    fit: ModelFit | None = None,
) -> Predictions:
    """Test a claim on held-out clips and on all clips. A model without motion for held-out clips fails both.

    own: sigma of the claim.
    fits: those of the held-out clips, without and with the claim.
    residuals: leave-one-out residuals of the fitted clips, without and with the claim.
    fit: that of the fitted clips with the claim, for its covariance.
    """
    without, with_ = fits
    if with_ is None:
        nothing = HeldOutTest((held_out.before.chi2 / held_out.before.points, math.inf), -math.inf, own)
        return nothing, nothing
    if without is None:
        nothing = HeldOutTest((math.inf, with_.chi2 / with_.points), own, own)
        return nothing, nothing
    parts = without.residuals, with_.residuals
    every = [[*fitted, *unseen] for fitted, unseen in zip(residuals, parts, strict=True)]
    there = covariance = None
    if fit:
        evidence = WhitenedClips.of(held_out.clips, held_out.noise)
        there, covariance = linearise(evidence, fit.model, fit.names, with_.launches), fit.covariance
    return HeldOutTest.of(*parts, own, there, covariance), HeldOutTest.of(every[0], every[1], np.inf)
