"""Something that no effect of the library is: a law left free explains it better than any of them.

Every free law is held against the base model, the best model of the library, and each of its effects alone, to first
order; the leaders are fitted in full. A second library effect is believed only where it beats the free laws.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass

from discrepancy.fitting.gauss_newton import linearise, minimise_chi2
from discrepancy.fitting.model_fit import ModelFit, WhitenedClips
from discrepancy.fitting.parameters import Candidate
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.free_laws.law_kinds import FreeLaw
from discrepancy.free_laws.library import free_laws_over
from discrepancy.policy import current_policy
from discrepancy.select.law_fit import fit_law, fit_law_with_effect, score_law, whiten_law_columns
from discrepancy.select.library_search import MAX_EXCHANGES, SCORE_ERROR_CHI2, SCORE_ERROR_SHARE
from discrepancy.select.model_cost import cost_of
from discrepancy.select.score_test import CandidateScore, ScoreTests


def fit_each_alone(
    evidence: WhitenedClips, base: ModelFit, best: ModelFit, progress: Callable[[], None] = lambda: None
) -> list[ModelFit]:
    """Fit each effect of the best model alone, where it has several that the base has not."""
    added = best.added_names(base)
    if len(added) < 2:
        return []
    fits = []
    for effect, own in added.items():
        effects = tuple(e for e in best.model.effects if e.name() == effect or e.name() not in added)
        values = {n: best.model.value(n) for n in own}
        model = dataclasses.replace(base.model, effects=effects).replace(values)
        with suppress(ValueError):  # alone it has no motion
            start = linearise(evidence, model, (*base.names, *own), base.launches)
            fits.append(minimise_chi2(evidence, start, progress, rough=True))
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
    asked : (int, CandidateScore or None) or None
        The place in `fitted` of the free law that was last asked what it lacks, and the answer.
    """

    evidence: WhitenedClips
    base: ModelFit
    laws: tuple[FreeLaw, ...]
    progress: Callable[[], None] = lambda: None
    fitted: tuple[FittedLaw, ...] = ()
    rivals: tuple[ModelFit, ...] = ()
    refuted: bool = False
    beaten: int = 0
    asked: tuple[int, CandidateScore | None] | None = None

    @classmethod
    def of(cls, evidence: WhitenedClips, base: ModelFit, progress: Callable[[], None] = lambda: None) -> FreeLawContest:
        """Hold every free law that the clips can show against the base model."""
        laws = free_laws_over(base.model, base.launches, evidence.clips)
        return cls(evidence, base, laws, progress)._considered([base])

    @property
    def ended(self) -> bool:
        """Whether a free law explained more than the library's latest model and than the one before it.

        The library has one more effect to answer with.
        """
        return self.beaten > 1

    def against(self, fit: ModelFit, rivals: Sequence[ModelFit] = ()) -> FreeLawContest:
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
        fits = [*fit_each_alone(self.evidence, self.base, fit, self.progress), fit]
        there = dataclasses.replace(self, rivals=tuple(rivals))._considered(fits)
        best = there._best(fit, 1)
        if best is not None and there._count(fit) == 1:
            there = there._asked(best)
        beaten = best is not None and (there._count(fit) > 1 or there._lacks(best) is None)
        return dataclasses.replace(there, beaten=self.beaten + 1 if beaten else 0)

    def nearly(self, fit: ModelFit) -> FittedLaw | None:
        """The free law that explains nearly as much as the library's best model, or more."""
        best = min(self.fitted, key=lambda f: f.score, default=None)
        return best if best and best.score < self._cost(fit) + current_policy().near_free_law_chi2 else None

    def outcome(self, fit: ModelFit) -> tuple[FittedLaw | None, FreeLawContest]:
        """The free law that explains the clips better than the library's best model, and than chance, if one does.

        With such library effects beside it as it still needs; and the contest with what was fitted for that.
        """
        there, best = self, self._best(fit, 0)
        for _ in range(current_policy().max_effects_beside_free_law if best is not None else 0):
            assert best is not None
            there = there._asked(best)
            beside, known = there._lacks(best), there.fitted[best]
            if beside is None:
                break
            try:
                sigma, trial = fit_law_with_effect(there.evidence, known, beside, there.base, there.progress)
            except ValueError:  # without the free law there is no motion
                break
            if trial.score >= known.score or sigma < current_policy().free_law_sigma:
                break
            best = len(there.fitted)
            there = dataclasses.replace(there, fitted=(*there.fitted, trial))
        return None if best is None else there.fitted[best], there

    def _best(self, fit: ModelFit, fewer: int) -> int | None:
        """The place of the best law, if better, of those beside a model of `fewer` effects less than the latest."""
        cost, most = self._cost(fit), self._count(fit)
        fair = [
            k
            for k, f in enumerate(self.fitted)
            if most - self._count(f.fit) >= fewer
            and self._needed(f)
            and (
                self.refuted or most - self._count(f.fit) > 1 or f.score < cost - current_policy().effect_preferred_chi2
            )
        ]
        best = min(fair, key=lambda k: self.fitted[k].score, default=None)
        return best if best is not None and self.fitted[best].score < cost else None

    def _needed(self, fitted_law: FittedLaw) -> bool:
        """Whether every library effect beside a free law is significant there, and not held by the law as well."""
        return all(
            sigma > current_policy().free_law_sigma for sigma in fitted_law.significances_of_effects(self.base).values()
        )

    def _cost(self, fit: ModelFit) -> float:
        return min(cost_of(f, self.base) for f in (fit, *self.rivals))

    def _count(self, fit: ModelFit) -> int:
        """Effects in a fit that are not in the base."""
        return len(fit.added_names(self.base))

    def _considered(self, fits: Sequence[ModelFit]) -> FreeLawContest:
        """With those free laws fitted that to first order may be the best beside these models, the latest last."""
        seen, fitted = [], list(self.fitted)
        for law in self.laws:
            moves = whiten_law_columns(
                self.evidence, law, self.base.model, self.base.launches
            )  # near enough for all fits
            seen += [(score_law(law, fit, moves), k) for k, fit in enumerate(fits, 1 - len(fits))]
            self.progress()
        leaders = [(test, k) for test, k in seen if test.sigma > current_policy().free_law_sigma]
        leaders.sort(key=lambda pair: pair[0].score(self.base))
        for test, _ in leaders[:3]:  # are fitted in full
            slack = SCORE_ERROR_CHI2 + 0.01 * (cost_of(test.fit, self.base) - test.score(self.base))
            if all(test.score(self.base) < f.score + slack for f in fitted):
                with suppress(ValueError):  # a curve on whose way there is no motion
                    fitted.append(fit_law(self.evidence, test, self.base, self.progress))
        return dataclasses.replace(self, fitted=tuple(fitted), refuted=any(k == 0 for _, k in leaders))

    def _asked(self, place: int) -> FreeLawContest:
        """With the answer which effect of the library is still to be claimed beside a free law."""
        if self.asked is not None and self.asked[0] == place:
            return self
        known = self.fitted[place]
        tests = ScoreTests.of(known.evidence, known.joint_fit, self.progress, about=known.model_without_law)
        ranking = tests.leaders(current_policy().free_law_sigma)
        claimed = ranking and ranking[0].sigma > current_policy().free_law_sigma and ranking[0].sigma > tests.claim()
        return dataclasses.replace(self, asked=(place, ranking[0] if claimed else None))

    def _lacks(self, place: int) -> CandidateScore | None:
        return self.asked[1] if self.asked is not None and self.asked[0] == place else None


def find_replacements(
    evidence: WhitenedClips,
    less: FittedLaw,
    named: Candidate,
    absorbed: Collection[str],
    base: ModelFit,
    progress: Callable[[], None],
) -> list[tuple[str, FittedLaw]]:
    """Fit other effects beside a free law in the place of one of those beside it.

    Parameters
    ----------
    evidence : Evidence
    less : FittedLaw
        The free law without that effect.
    named : Candidate
        The effect.
    absorbed : collection of str
        Effects that are no rivals.
    base : Fit
        What the cost of effects is counted from.
    progress : callable
        Told of progress.

    Returns
    -------
    list of (str, FittedLaw)
        The effects that to first order explain nearly as much, fitted in full, the best first.
    """
    tests = ScoreTests.of(less.evidence, less.joint_fit, progress, about=less.model_without_law)
    ranking = {c.effect: c for c in tests.ranking()}
    if named.name not in ranking:
        return []
    least = (1 - SCORE_ERROR_SHARE) * tests.sharper(less.evidence, ranking.pop(named.name)).gain - SCORE_ERROR_CHI2
    told = [c for c in ranking.values() if c.identifiable and c.effect not in absorbed and c.gain > least / 2]
    rivals = [c for c in (tests.sharper(less.evidence, c) for c in told) if c.gain > least]
    fitted = []
    for rival in sorted(rivals, key=lambda c: -c.gain)[:MAX_EXCHANGES]:
        try:
            fitted.append((rival.effect, fit_law_with_effect(evidence, less, rival, base, progress)[1]))
        except ValueError:  # no motion
            continue
    return sorted(fitted, key=lambda pair: pair[1].score)
