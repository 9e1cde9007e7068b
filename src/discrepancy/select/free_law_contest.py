"""Compare free laws with the library's models, to find a law that no effect of the library describes.

A score test adds every free law, to first order, to several models. They are the base model, the best model of the
library, and each of its effects alone. The best laws are then fitted in full. A second library effect must beat the
free laws.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass

from discrepancy.fitting.gauss_newton import minimise_chi2
from discrepancy.fitting.jacobian import linearise
from discrepancy.fitting.model_fit import ModelFit, WhitenedClips
from discrepancy.fitting.parameters import Candidate
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.free_laws.library import free_laws_over
from discrepancy.policy import current_policy
from discrepancy.select.law_fit import fit_law, fit_law_with_effect, score_law, whiten_law_columns
from discrepancy.select.library_fits import SCORE_ERROR_CHI2, LibraryFits, State
from discrepancy.select.library_search import (
    MAX_EXCHANGES,
    SCORE_ERROR_SHARE,
    Selection,
    iterate_models,
    make_selection,
    search_from,
    search_from_other_effects,
)
from discrepancy.select.model_cost import compute_cost
from discrepancy.select.score_test import CandidateScore, ScoreTests


def select_effects_and_law(library: LibraryFits) -> Selection:
    """Select effects of the library, and a free law if one explains more.

    Each larger model of the library competes with the free laws. The library's search ends when a free law beats two of
    its models in a row. So the library may add one more effect to catch up with the law. Where its last model is poor,
    the search begins again from other effects (`search_from_other_effects`), unless a free law leaves only noise.
    """
    laws = FreeLawFits(library.evidence, library.base)
    state: State = ()
    opponent, beaten = laws.challenge(library.base), 0
    for state in iterate_models(library):
        opponent = laws.challenge(library.fit(state), library.rivals(state))
        beaten = beaten + 1 if is_beaten_by_law(opponent, laws) else 0
        if beaten > 1:
            break
    begun_elsewhere = state if explains_all(laws, opponent) else search_from_other_effects(library, state)
    if begun_elsewhere != state:
        state = begun_elsewhere
        opponent = laws.challenge(library.fit(state), library.rivals(state))
    selection = make_selection(library, state)
    opponent = dataclasses.replace(opponent, fit=selection.best)
    free_law = find_winning_law(laws, opponent)
    beside = free_law.significances_of_effects(library.base) if free_law else {}
    again = search_from(library, selection, beside, free_law.model_without_law) if free_law and beside else None
    if again:  # effects beside the free law gave a better start
        selection, opponent = again, laws.challenge(again.best, library.rivals(again.state))
        free_law = find_winning_law(laws, opponent)
    near_law = None if free_law else find_near_law(laws, opponent)
    return dataclasses.replace(selection, free_law=free_law, near_law=near_law)


@dataclass(frozen=True)
class Opponent:
    """A model of the library that the free laws compete with."""

    fit: ModelFit
    # Other models of the library with as many effects. They may be less simple but fit better.
    rivals: tuple[ModelFit, ...]
    is_refuted: bool  # true if the model leaves a free law significant


class FreeLawFits:
    """The free laws over some clips, with those that were fitted in full beside models of the library (`fitted`)."""

    def __init__(self, evidence: WhitenedClips, base: ModelFit) -> None:
        self.evidence, self.base = evidence, base
        self.laws = free_laws_over(base.model, base.launches, evidence.clips)
        self.fitted: list[FittedLaw] = []
        self._missing: dict[int, CandidateScore | None] = {}  # by the identity of the fitted law

    def challenge(self, fit: ModelFit, rivals: Sequence[ModelFit] = ()) -> Opponent:
        """Fit the free laws that may be the best, to first order, beside a model and beside each of its effects."""
        fits, seen = [*fit_each_alone(self.evidence, self.base, fit), fit], []
        for law in self.laws:  # derivatives at the base are near enough for all fits
            moves = whiten_law_columns(self.evidence, law, self.base.model, self.base.launches)
            seen += [score_law(self.evidence, law, each, moves) for each in fits]
        leaders = [test for test in seen if test.sigma > current_policy().free_law_sigma]
        leaders.sort(key=lambda test: test.score(self.base))
        for test in leaders[:3]:  # only these are fitted in full
            slack = SCORE_ERROR_CHI2 + 0.01 * (compute_cost(test.fit, self.base) - test.score(self.base))
            if all(test.score(self.base) < f.score + slack for f in self.fitted):
                with suppress(ValueError):  # on the way to this curve the model has no motion
                    self.fitted.append(fit_law(self.evidence, test, self.base))
        return Opponent(fit, tuple(rivals), any(test.fit is fit for test in leaders))

    def find_missing_effect(self, law: FittedLaw) -> CandidateScore | None:
        """Find the effect of the library that is still significant beside a fitted free law."""
        if id(law) not in self._missing:
            tests = ScoreTests.of(law.evidence, law.joint_fit, about=law.model_without_law)
            ranking, least = tests.leaders(current_policy().free_law_sigma), current_policy().free_law_sigma
            claimed = ranking and ranking[0].sigma > least and ranking[0].sigma > tests.claim()
            self._missing[id(law)] = ranking[0] if claimed else None
        return self._missing[id(law)]

    def count_effects(self, fit: ModelFit) -> int:
        """Effects in a fit that are not in the base."""
        return len(fit.added_names(self.base))

    def cost_of(self, opponent: Opponent) -> float:
        """The cost, in chi^2, of a model of the library or of its cheapest rival."""
        return min(compute_cost(fit, self.base) for fit in (opponent.fit, *opponent.rivals))


def fit_each_alone(evidence: WhitenedClips, base: ModelFit, best: ModelFit) -> list[ModelFit]:
    """Prepare the contest with free laws: fit each effect of the best library model alone, if it has several."""
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
            fits.append(minimise_chi2(evidence, start, rough=True))
    return fits


def find_better_law(laws: FreeLawFits, opponent: Opponent, fewer: int = 0) -> FittedLaw | None:
    """Find the best law that beats a model of the library, among those with at least `fewer` effects less beside them.

    A known effect is preferred to a free law. A free law wins only in these cases:

    - the model leaves a free law significant;
    - the model needs two effects more than the free law does;
    - the model costs more by `SearchPolicy.effect_preferred_chi2`.

    Every library effect beside the law must be significant there, and not absorbed by the law.
    """
    cost, effects, policy = laws.cost_of(opponent), laws.count_effects(opponent.fit), current_policy()

    def wins(law: FittedLaw) -> bool:
        less = effects - laws.count_effects(law.fit)
        handicap = 0.0 if opponent.is_refuted or less > 1 else policy.effect_preferred_chi2
        sigmas = law.significances_of_effects(laws.base).values()
        return less >= fewer and law.score < cost - handicap and all(s > policy.free_law_sigma for s in sigmas)

    return min(filter(wins, laws.fitted), key=lambda law: law.score, default=None)


def is_beaten_by_law(opponent: Opponent, laws: FreeLawFits) -> bool:
    """Tell if a free law with fewer effects beside it explains more than a model of the library.

    A free law may imitate two effects of the library. So a law without effects beside it beats a model of one effect
    only if no effect is significant beside the law.
    """
    best = find_better_law(laws, opponent, fewer=1)
    return best is not None and (laws.count_effects(opponent.fit) > 1 or laws.find_missing_effect(best) is None)


def explains_all(laws: FreeLawFits, opponent: Opponent) -> bool:
    """Tell if a free law beats a model of the library, and leaves only noise (`SearchPolicy.noise_chi2_per_point`)."""
    best = find_better_law(laws, opponent)
    if best is None or best.fit.chi2 / best.fit.points > current_policy().noise_chi2_per_point:
        return False
    return laws.find_missing_effect(best) is None


def find_winning_law(laws: FreeLawFits, opponent: Opponent) -> FittedLaw | None:
    """Find the law that beats the library's best model, with the library effects that it needs beside it."""
    best = find_better_law(laws, opponent)
    for _ in range(current_policy().max_effects_beside_free_law):
        beside = laws.find_missing_effect(best) if best else None
        if best is None or beside is None:
            break
        try:
            sigma, more = fit_law_with_effect(laws.evidence, best, beside, laws.base)
        except ValueError:  # without the free law there is no motion
            break
        if more.score >= best.score or sigma < current_policy().free_law_sigma:
            break
        laws.fitted.append(more)
        best = more
    return best


def find_near_law(laws: FreeLawFits, opponent: Opponent) -> FittedLaw | None:
    """Find the free law that explains nearly as much as a model of the library, or more."""
    best = min(laws.fitted, key=lambda law: law.score, default=None)
    return best if best and best.score < laws.cost_of(opponent) + current_policy().near_free_law_chi2 else None


def find_replacements(
    evidence: WhitenedClips, less: FittedLaw, named: Candidate, absorbed: Collection[str], base: ModelFit
) -> list[tuple[str, FittedLaw]]:
    """Challenge a free law: fit other effects beside it, each instead of one effect that is there.

    Returns the effects that to first order explain nearly as much, fitted in full, the best first.

    less: the free law without the effect `named`.
    absorbed: effects that do not count as rivals.
    base: the fit from which the cost of effects is counted.
    """
    tests = ScoreTests.of(less.evidence, less.joint_fit, about=less.model_without_law)
    ranking = {c.effect: c for c in tests.ranking()}
    if named.name not in ranking:
        return []
    least = (1 - SCORE_ERROR_SHARE) * tests.sharper(less.evidence, ranking.pop(named.name)).gain - SCORE_ERROR_CHI2
    identifiable = [c for c in ranking.values() if c.identifiable and c.effect not in absorbed and c.gain > least / 2]
    rivals = [c for c in (tests.sharper(less.evidence, c) for c in identifiable) if c.gain > least]
    fitted = []
    for rival in sorted(rivals, key=lambda c: -c.gain)[:MAX_EXCHANGES]:
        try:
            fitted.append((rival.effect, fit_law_with_effect(evidence, less, rival, base)[1]))
        except ValueError:  # no motion
            continue
    return sorted(fitted, key=lambda pair: pair[1].score)
