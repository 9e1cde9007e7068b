"""Compare free laws with the library's models, to find a law that no effect of the library describes.

A score test, to first order, adds every free law to the base model, to the best model of the library, and to each of
its effects alone. The best laws are then fitted in full. A second library effect must beat the free laws.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass

from discrepancy.fitting.gauss_newton import minimise_chi2
from discrepancy.fitting.linearise import linearise
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
    """Fit each effect of the best model alone, if that model has several beside the base."""
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
    """Free laws in competition with the library's models, as the search proceeds from one model to the next.

    A known effect is preferred to a free law. A free law competes with a model of the library only in these cases:

    - the model leaves a free law significant;
    - the model needs two effects more than the free law does;
    - the model costs more by `SearchPolicy.effect_preferred_chi2`.

    Attributes
    ----------
    evidence : WhitenedClips
    base : ModelFit
    laws : tuple of FreeLaw
    progress : callable
        Called now and then.
    fitted : tuple of FittedLaw
        The free laws that were fitted in full.
    rivals : tuple of ModelFit
        Other models of the library with as many effects as the latest. They may be less simple but fit better.
    refuted : bool
        True if the library's latest model leaves a free law significant.
    beaten : int
        The number of the library's latest models in a row that a free law beside a smaller model has beaten.
    asked : (int, CandidateScore or None) or None
        The index in `fitted` of the law last tested for a missing effect, and that effect.
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
        """Compare every free law that the clips can show with the base model."""
        laws = free_laws_over(base.model, base.launches, evidence.clips)
        return cls(evidence, base, laws, progress)._considered([base])

    @property
    def ended(self) -> bool:
        """True if a free law explained more than each of the library's last two models.

        The library thus has one more effect to catch up with the law.
        """
        return self.beaten > 1

    def against(self, fit: ModelFit, rivals: Sequence[ModelFit] = ()) -> FreeLawContest:
        """Compare the free laws with the library's next model.

        A free law may imitate two effects of the library. So a law without effects beside it beats a model of one
        effect only if no effect is significant beside the law.

        Parameters
        ----------
        fit : ModelFit
            The library's next model.
        rivals : sequence of ModelFit
            The library's other models with as many effects.

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
        """Find the free law that explains the clips better than the library's best model, and than chance.

        Returns the law with the library effects that it needs beside it, or None, and the contest with all new fits.
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
        """Index of the best law that beats `fit`, among those with at least `fewer` effects less beside them."""
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
        """Tell if every library effect beside a free law is significant there, and not absorbed by the law."""
        return all(
            sigma > current_policy().free_law_sigma for sigma in fitted_law.significances_of_effects(self.base).values()
        )

    def _cost(self, fit: ModelFit) -> float:
        return min(cost_of(f, self.base) for f in (fit, *self.rivals))

    def _count(self, fit: ModelFit) -> int:
        """Effects in a fit that are not in the base."""
        return len(fit.added_names(self.base))

    def _considered(self, fits: Sequence[ModelFit]) -> FreeLawContest:
        """Fit the free laws that may be the best, to first order, beside these models; the latest model is last."""
        seen, fitted = [], list(self.fitted)
        for law in self.laws:
            moves = whiten_law_columns(
                self.evidence, law, self.base.model, self.base.launches
            )  # near enough for all fits
            seen += [(score_law(law, fit, moves), k) for k, fit in enumerate(fits, 1 - len(fits))]
            self.progress()
        leaders = [(test, k) for test, k in seen if test.sigma > current_policy().free_law_sigma]
        leaders.sort(key=lambda pair: pair[0].score(self.base))
        for test, _ in leaders[:3]:  # only these are fitted in full
            slack = SCORE_ERROR_CHI2 + 0.01 * (cost_of(test.fit, self.base) - test.score(self.base))
            if all(test.score(self.base) < f.score + slack for f in fitted):
                with suppress(ValueError):  # on the way to this curve the model has no motion
                    fitted.append(fit_law(self.evidence, test, self.base, self.progress))
        return dataclasses.replace(self, fitted=tuple(fitted), refuted=any(k == 0 for _, k in leaders))

    def _asked(self, place: int) -> FreeLawContest:
        """Find the effect of the library that is still significant beside a fitted free law, and keep it in `asked`."""
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
    """Fit other effects beside a free law, each instead of one effect that is there.

    Parameters
    ----------
    evidence : WhitenedClips
    less : FittedLaw
        The free law without that effect.
    named : Candidate
        The effect to replace.
    absorbed : collection of str
        Effects that do not count as rivals.
    base : ModelFit
        The base fit, from which the cost of effects is counted.
    progress : callable
        Called now and then.

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
    identifiable = [c for c in ranking.values() if c.identifiable and c.effect not in absorbed and c.gain > least / 2]
    rivals = [c for c in (tests.sharper(less.evidence, c) for c in identifiable) if c.gain > least]
    fitted = []
    for rival in sorted(rivals, key=lambda c: -c.gain)[:MAX_EXCHANGES]:
        try:
            fitted.append((rival.effect, fit_law_with_effect(evidence, less, rival, base, progress)[1]))
        except ValueError:  # no motion
            continue
    return sorted(fitted, key=lambda pair: pair[1].score)
