"""Something that no effect of the library is: a law left free explains it better than any of them.

Every free law is held against the base model, the best model of the library, and each of its effects alone, to first
order; the leaders are fitted in full. A second library effect is believed only where it beats the free laws.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from discrepancy import policy
from discrepancy.arrays import Array
from discrepancy.data.collisions import Measured
from discrepancy.data.launch import possible
from discrepancy.fitting.gauss_newton import FAILED, fit_model, linearised, settle, solve
from discrepancy.fitting.model_fit import Evidence, Fit
from discrepancy.fitting.parameters import Candidate, within
from discrepancy.free_laws.credible_band import stepped
from discrepancy.free_laws.evidence import Weight, significance, weigh
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.free_laws.free_law import FreeLaw
from discrepancy.free_laws.library import free_laws
from discrepancy.free_laws.ranges import over_clips
from discrepancy.noise.model import Noise
from discrepancy.selection.model_cost import cost_of, law_chosen
from discrepancy.selection.score_test import ScoreTests
from discrepancy.selection.scored import Scored
from synthcam.model import Model

LEADERS = 3  # fitted in full
NEAR, LOOSE = 15.0, 0.01  # of chi^2, and of what a free law explains: what the first order may be wrong by
ROUNDS = 30
SETTLED = 0.05  # of chi^2: what a further step would gain
SHORTER = (1.0, 0.5, 0.25, 0.1, 0.02)  # shares of a step that are tried


@dataclass(frozen=True)
class LawTest:
    """A free law held against a fit, to first order."""

    law: FreeLaw
    fit: Fit
    sigma: float
    information: Array
    pull: Array

    @cached_property
    def weight(self) -> Weight:  # asked of few laws: it takes the longest
        return weigh(self.law, self.information, self.pull)

    def score(self, base: Fit) -> float:
        """What the model with the law would cost, in chi^2."""
        return cost_of(self.fit, base) + law_chosen() - self.weight.gain


def _moves(evidence: Evidence, law: FreeLaw, model: Model, launches: Array) -> tuple[Array, ...]:
    """Whitened derivatives by the coefficients, (2n, J) of each clip."""
    return evidence.white(law.columns(model, launches, evidence.clips))


def _tested(law: FreeLaw, fit: Fit, moves: Sequence[Array]) -> LawTest:
    information, pull = fit.information(moves)
    return LawTest(law, fit, significance(law, information, pull), information, pull)


def fill(evidence: Evidence, test: LawTest, base: Fit, progress: Callable[[], None] = lambda: None) -> FittedLaw:
    """Fit a free law together with everything that another fit has, the law's prior chosen by the evidence.

    Parameters
    ----------
    evidence : Evidence
    test : LawTest
        The law, and the fit without it.
    base : Fit
        What the cost of effects beside the law is counted from.
    progress : callable
        Told of progress.

    Returns
    -------
    FittedLaw

    Raises
    ------
    ValueError
        Where a law on the way has no motion.
    """
    law, plain, fit = test.law, test.fit.model, test.fit
    moves = _moves(evidence, law, plain, fit.launches)
    coefs, here = np.zeros(law.size), evidence
    for _ in range(ROUNDS):
        progress()
        information, pull = fit.information(moves)
        weight = weigh(law, information, pull + information @ coefs)
        precision, step = weight.prior.precision, weight.coefs - coefs
        moved = None
        if step @ (information + precision) @ step > SETTLED:
            before = fit.chi2 + coefs @ precision @ coefs
            for share in SHORTER:
                moved = _moved(evidence, law, plain, fit, moves, coefs, share * step)
                if moved and moved[1].chi2 + (coefs + share * step) @ precision @ (coefs + share * step) < before:
                    coefs = coefs + share * step
                    here, fit, plain = moved
                    break
                moved = None
        if moved is None:
            if fit.local:
                break
            fit = linearised(here, fit.model, fit.names, fit.launches)
            moves = _moves(evidence, law, law.bent(plain, coefs), fit.launches)
    freedom = np.linalg.slogdet(np.eye(law.size) + information / np.diag(weight.prior.precision)[:, None])
    paid = law_chosen() + weight.prior.cost + float(coefs @ weight.prior.precision @ coefs + freedom[1])
    smooth = FittedLaw(law, coefs, weight.prior, fit, plain, here, moves, test.sigma, cost_of(fit, base) + paid)
    return dataclasses.replace(smooth, score=smooth.score - stepped(smooth))


def _moved(
    evidence: Evidence, law: FreeLaw, plain: Model, fit: Fit, moves: Sequence[Array], coefs: Array, step: Array
) -> tuple[Evidence, Fit, Model] | None:
    """Take a step of the coefficients, and with it the step of all else that fits best to first order.

    Returns the clips (less what the law moves, where no effect can hold it), the fit there, and its model without the
    law; None where that has no motion.
    """
    shared, own = solve(fit.explained_by(moves, step), 0.0, *fit.room())
    launches = fit.launches + own
    if not possible(launches):
        return None
    try:
        plain = within(plain, dict(zip(fit.names, (fit.values() + shared).tolist(), strict=True)))
        model = law.bent(plain, coefs + step)
        here = dataclasses.replace(evidence, clips=tuple(law.undone(evidence.clips, plain, launches, coefs + step)))
        residuals = here.left(model, launches)
    except FAILED:
        return None
    return here, dataclasses.replace(fit, model=model, launches=launches, residuals=residuals), plain


def alone(evidence: Evidence, base: Fit, best: Fit, progress: Callable[[], None] = lambda: None) -> list[Fit]:
    """Fit each effect of the best model alone, where it has several that the base has not."""
    added = best.added(base)
    if len(added) < 2:
        return []
    fits = []
    for effect, own in added.items():
        effects = tuple(e for e in best.model.effects if e.name() == effect or e.name() not in added)
        values = {n: best.model.value(n) for n in own}
        model = dataclasses.replace(base.model, effects=effects).replace(values)
        with suppress(ValueError):  # alone it has no motion
            start = linearised(evidence, model, (*base.names, *own), base.launches)
            fits.append(settle(evidence, start, progress, rough=True))
    return fits


@dataclass(frozen=True)
class FreeLawContest:
    """Free laws held against the library's models as the search goes from one to the next.

    A named effect is preferred to a free law in its place: against a model of the library a free law counts only where
    that model leaves one significant, or needs two effects more than the free law does, or is worse by what an effect
    is preferred by.

    Attributes
    ----------
    evidence : Evidence
    base : Fit
    laws : tuple of FreeLaw
    progress : callable
        Told of progress.
    fitted : tuple of FittedLaw
        Those that were fitted in full.
    rivals : tuple of Fit
        Other models of the library with as many effects as the latest, which may be less simple but fit better.
    refuted : bool
        Whether the library's latest model leaves a free law significant.
    beaten : int
        How many of the library's models in a row a free law beside a smaller model has explained more than.
    asked : (int, Scored or None) or None
        The place in `fitted` of the free law that was last asked what it lacks, and the answer.
    """

    evidence: Evidence
    base: Fit
    laws: tuple[FreeLaw, ...]
    progress: Callable[[], None] = lambda: None
    fitted: tuple[FittedLaw, ...] = ()
    rivals: tuple[Fit, ...] = ()
    refuted: bool = False
    beaten: int = 0
    asked: tuple[int, Scored | None] | None = None

    @classmethod
    def of(cls, evidence: Evidence, base: Fit, progress: Callable[[], None] = lambda: None) -> FreeLawContest:
        """Hold every free law that the clips can show against the base model."""
        laws = free_laws(base.model, base.launches, evidence.clips)
        return cls(evidence, base, laws, progress)._considered([base])

    @property
    def ended(self) -> bool:
        """Whether a free law explained more than the library's latest model and than the one before it.

        The library has one more effect to answer with.
        """
        return self.beaten > 1

    def against(self, fit: Fit, rivals: Sequence[Fit] = ()) -> FreeLawContest:
        """Hold the free laws against the library's next model.

        A free law may bend so that it imitates two effects of the library. So one that stands alone beats a model of
        one effect only if it leaves no significant effect beside itself.

        Parameters
        ----------
        fit : Fit
            The library's next model.
        rivals : sequence of Fit
            Its other models with as many effects.

        Returns
        -------
        FreeLawContest
        """
        fits = [*alone(self.evidence, self.base, fit, self.progress), fit]
        there = dataclasses.replace(self, rivals=tuple(rivals))._considered(fits)
        best = there._best(fit, 1)
        if best is not None and there._count(fit) == 1:
            there = there._asked(best)
        beaten = best is not None and (there._count(fit) > 1 or there._lacks(best) is None)
        return dataclasses.replace(there, beaten=self.beaten + 1 if beaten else 0)

    def nearly(self, fit: Fit) -> FittedLaw | None:
        """The free law that explains nearly as much as the library's best model, or more."""
        best = min(self.fitted, key=lambda f: f.score, default=None)
        return best if best and best.score < self._cost(fit) + policy.FREE_LAW_NEAR else None

    def outcome(self, fit: Fit) -> tuple[FittedLaw | None, FreeLawContest]:
        """The free law that explains the clips better than the library's best model, and than chance, if one does.

        With such library effects beside it as it still needs; and the contest with what was fitted for that.
        """
        there, best = self, self._best(fit, 0)
        for _ in range(policy.MOST_EFFECTS_BESIDE_FREE_LAW if best is not None else 0):
            assert best is not None
            there = there._asked(best)
            beside, known = there._lacks(best), there.fitted[best]
            if beside is None:
                break
            try:
                sigma, trial = there._beside(known, beside)
            except ValueError:  # without the free law there is no motion
                break
            if trial.score >= known.score or sigma < policy.FREE_LAW_SIGMA:
                break
            best = len(there.fitted)
            there = dataclasses.replace(there, fitted=(*there.fitted, trial))
        return None if best is None else there.fitted[best], there

    def _beside(self, known: FittedLaw, effect: Scored) -> tuple[float, FittedLaw]:
        """A free law fitted again with an effect of the library beside it, and its sigma there."""
        model = known.plain.replace(effect.shapes | dict.fromkeys(effect.strengths, 0.0))
        start = dataclasses.replace(known.fit, model=model)
        for names in filter(None, (effect.strengths, tuple(effect.shapes))):  # shapes mean nothing before
            whole = linearised(self.evidence, start.model, (*start.names, *names), start.launches)
            start = settle(self.evidence, whole, self.progress)
        test = _tested(known.law, start, _moves(self.evidence, known.law, start.model, start.launches))
        return test.sigma, fill(self.evidence, test, self.base, self.progress)

    def _best(self, fit: Fit, fewer: int) -> int | None:
        """The place of the best law, if better, of those beside a model of `fewer` effects less than the latest."""
        cost, most = self._cost(fit), self._count(fit)
        fair = [
            k
            for k, f in enumerate(self.fitted)
            if most - self._count(f.fit) >= fewer
            and self._needed(f)
            and (self.refuted or most - self._count(f.fit) > 1 or f.score < cost - policy.EFFECT_PREFERRED_BY)
        ]
        best = min(fair, key=lambda k: self.fitted[k].score, default=None)
        return best if best is not None and self.fitted[best].score < cost else None

    def _needed(self, fitted_law: FittedLaw) -> bool:
        """Whether every library effect beside a free law is significant there, and not held by the law as well."""
        return all(sigma > policy.FREE_LAW_SIGMA for sigma in fitted_law.beside(self.base).values())

    def _cost(self, fit: Fit) -> float:
        return min(cost_of(f, self.base) for f in (fit, *self.rivals))

    def _count(self, fit: Fit) -> int:
        """Effects in a fit that are not in the base."""
        return len(fit.added(self.base))

    def _considered(self, fits: Sequence[Fit]) -> FreeLawContest:
        """With those free laws fitted that to first order may be the best beside these models, the latest last."""
        seen, fitted = [], list(self.fitted)
        for law in self.laws:
            moves = _moves(self.evidence, law, self.base.model, self.base.launches)  # near enough for all fits
            seen += [(_tested(law, fit, moves), k) for k, fit in enumerate(fits, 1 - len(fits))]
            self.progress()
        leaders = [(test, k) for test, k in seen if test.sigma > policy.FREE_LAW_SIGMA]
        leaders.sort(key=lambda pair: pair[0].score(self.base))
        for test, _ in leaders[:LEADERS]:
            slack = NEAR + LOOSE * (cost_of(test.fit, self.base) - test.score(self.base))
            if all(test.score(self.base) < f.score + slack for f in fitted):
                with suppress(ValueError):  # a curve on whose way there is no motion
                    fitted.append(fill(self.evidence, test, self.base, self.progress))
        return dataclasses.replace(self, fitted=tuple(fitted), refuted=any(k == 0 for _, k in leaders))

    def _asked(self, place: int) -> FreeLawContest:
        """With the answer which effect of the library is still to be claimed beside a free law."""
        if self.asked is not None and self.asked[0] == place:
            return self
        known = self.fitted[place]
        tests = ScoreTests.of(known.evidence, known.whole, self.progress, about=known.plain)
        ranking = tests.leaders(policy.FREE_LAW_SIGMA)
        claimed = ranking and ranking[0].sigma > policy.FREE_LAW_SIGMA and ranking[0].sigma > tests.claim()
        return dataclasses.replace(self, asked=(place, ranking[0] if claimed else None))

    def _lacks(self, place: int) -> Scored | None:
        return self.asked[1] if self.asked is not None and self.asked[0] == place else None


def refilled(
    evidence: Evidence, fitted_law: FittedLaw, gone: Candidate, base: Fit, progress: Callable[[], None]
) -> FittedLaw:
    """Fit a free law again without the effect `gone` beside it. Raises ValueError where that has no motion."""
    names = tuple(n for n in fitted_law.fit.names if n not in gone.strengths + gone.shapes)
    start = linearised(evidence, gone.without(fitted_law.plain), names, fitted_law.fit.launches)
    fit = settle(evidence, start, progress)
    return fill(
        evidence,
        _tested(fitted_law.law, fit, _moves(evidence, fitted_law.law, fit.model, fit.launches)),
        base,
        progress,
    )


def emptied(evidence: Evidence, fitted_law: FittedLaw, progress: Callable[[], None]) -> Fit:
    """Fit all else that a fitted law has beside it, without the law. Raises ValueError where that has no motion."""
    return settle(
        evidence, linearised(evidence, fitted_law.plain, fitted_law.fit.names, fitted_law.fit.launches), progress
    )


def scatter(fitted_law: FittedLaw, clips: Sequence[Measured], without: Fit, noise: Noise) -> tuple[float, float, float]:
    """Whether a law that gives each clip a number of its own holds in clips that it was not fitted to.

    Those clips have numbers of their own; what the law foretells is only how much these scatter. `without` is the fit
    of these clips without the law.

    Returns
    -------
    gain : float
        By how much the marginal likelihood with numbers of that size exceeds that without, in chi^2.
    expected, std : float
        The mean of this gain and its standard deviation, were the numbers of that size.
    """
    evidence = Evidence.of(clips, noise)
    law = dataclasses.replace(fitted_law.law, axes=over_clips(len(clips)))
    fit = linearised(evidence, without.model, (), without.launches)
    information, pull = fit.information(_moves(evidence, law, fit.model, fit.launches))
    size = fitted_law.prior.size * np.sqrt(law.spread(fitted_law.prior.length))
    values, axes = np.linalg.eigh(size[:, None] * information * size)
    values, pulls = np.maximum(values, 0.0), axes.T @ (size * pull)
    gain = float((pulls**2 / (1 + values) - np.log1p(values)).sum())
    return gain, float((values - np.log1p(values)).sum()), float(np.sqrt(2 * (values**2).sum()))


def unseen(fitted_law: FittedLaw, clips: Sequence[Measured], before: Fit, noise: Noise) -> Fit:
    """Fit the launches of clips that a free law was not fitted to, with the law as it was found.

    Parameters
    ----------
    fitted_law : FittedLaw
        Where it is a number for each clip, these clips' own numbers are fitted too.
    clips : sequence of Measured
    before : Fit
        Of these clips, without the law.
    noise : Noise

    Returns
    -------
    Fit
        Its model holds the law; where no effect can hold it, what the law moves is taken out of the clips instead.
    """
    plain = fitted_law.plain
    if fitted_law.law.each_clip:
        evidence = Evidence.of(clips, noise)
        there = settle(evidence, linearised(evidence, plain, (), before.launches))
        law = dataclasses.replace(fitted_law.law, axes=over_clips(len(clips)))
        test = _tested(law, there, _moves(evidence, law, plain, there.launches))
        return fill(evidence, test, there).fit
    left = fitted_law.law.undone(clips, plain, before.launches, fitted_law.coefs)
    return fit_model(left, fitted_law.fit.model, (), noise, before.launches)
