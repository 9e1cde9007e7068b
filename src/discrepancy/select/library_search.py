"""Which effects are missing: added, dropped and exchanged until nothing improves."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from discrepancy.fitting.gauss_newton import linearise, minimise_chi2
from discrepancy.fitting.model_fit import ModelFit
from discrepancy.fitting.parameters import Candidate, candidates_by_name
from discrepancy.fitting.significance import chi2_to_sigma, closes_too_little
from discrepancy.policy import current_policy
from discrepancy.select.effect_claim import EffectClaim, find_similar_pairs, shape_error
from discrepancy.select.fit_store import FitStore
from discrepancy.select.model_cost import cost_of
from discrepancy.select.profile_errors import profile_std
from discrepancy.select.score_test import ScoreTests, largest_cosine
from discrepancy.select.scored import CandidateScore
from synthcam.model import Model

State = tuple[Candidate, ...]

NEAR, LOOSE = 15.0, 0.2  # of chi^2, and of what an effect explains: what the score may be wrong by
RIVALS, SWAPS = 8, 4  # refitted, at most, beside a leader and in the place of a named effect


@dataclass(frozen=True)
class Selection:
    """The effects named, and what they were chosen by.

    Attributes
    ----------
    state : tuple of Candidate
        The effects.
    base, best : Fit
        The fits before any effect and with these.
    ranking : tuple of CandidateScore
        The score tests of all candidates beside the base, most significant first.
    claim : float
        The sigma that a claim needs.
    trials_factors : mapping of str to float
        The trials factor of the shape parameters of each candidate, by its name.
    """

    state: State
    base: ModelFit
    best: ModelFit
    ranking: tuple[CandidateScore, ...]
    claim: float
    trials_factors: Mapping[str, float]

    @property
    def promising(self) -> bool:
        """Whether a score test beside the base is as significant as a claim must be."""
        return any(c.sigma > self.claim for c in self.ranking[:1])

    def paid(self, effect: str, sigma: float) -> float:
        """Sigma of an effect, corrected by the trials factor of its shape parameters."""
        return math.sqrt(max(sigma**2 - 2 * math.log(self.trials_factors.get(effect, 1.0)), 0.0))


@dataclass(frozen=True)
class Stepwise:
    """Steps from one model to the next; base parameters that the base holds at zero are candidates too.

    Attributes
    ----------
    store : FitStore
        Where all fits come from and are kept.
    ranking, claim, trials_factors
        As of `Selection`.
    absorbed : frozenset of str
        Effects that move the tracks only as the base fit's own parameters can. They are never taken for rivals, though
        beside another effect they may seem to be.
    """

    store: FitStore
    ranking: tuple[CandidateScore, ...]
    claim: float
    trials_factors: Mapping[str, float]
    absorbed: frozenset[str]

    @classmethod
    def of(cls, store: FitStore) -> Stepwise:
        """Begin at the store's base, whose score tests say what a claim needs before anything is searched."""
        tests = store.score_tests(())
        ranking, trials_factors = tests.ranking(), tests.trials_factors
        claim = max(tests.claim(), current_policy().min_claim_sigma)
        return cls(store, ranking, claim, trials_factors, frozenset(c.effect for c in ranking if c.absorbed))

    def states(self, state: State = ()) -> Iterator[State]:
        """Yield better and better models until no candidate is significant.

        Each has one effect more than the one before, or other effects. The search ends, too, at the most effects that
        are named, and where a step would lead back to a model that was left.
        """
        while len(state) < current_policy().max_effects:
            winner = self._winner(state, self.store.score_tests(state), self.claim)
            if winner is None:
                return
            more = self._bettered((*state, winner), self.claim)
            if len(more) <= len(state) and self.store.cost_of(more) >= self.store.cost_of(state):  # round in a circle
                return
            state = more
            yield state

    def selection(self, state: State) -> Selection:
        """The outcome that consists of these effects."""
        base = self.store.settled(())
        return Selection(state, base, self.store.exact(state), self.ranking, self.claim, self.trials_factors)

    def from_there(self, found: Selection, effects: Iterable[str], model: Model) -> Selection | None:
        """Search again from other effects, and keep the outcome where it is better.

        Parameters
        ----------
        found : Selection
            The outcome so far.
        effects : iterable of str
            Names of the effects to begin with.
        model : Model
            Their values to begin with.

        Returns
        -------
        Selection or None
            Only where it costs less than `found`; with more effects, less by what excludes a rival.
        """
        try:
            begun = self.begin(effects, model)
        except ValueError:  # alone they have no motion
            return None
        again = self.selection(self.end(begun))
        less = cost_of(found.best, found.base) - cost_of(again.best, found.base)
        return (
            again
            if less > (current_policy().rival_excluded_chi2 if len(again.state) > len(found.state) else 0.0)
            else None
        )

    def end(self, begun: State) -> State:
        """The last of the models that follow from one; that one without what is not claimed where none follows."""
        state = [begun, *self.states(begun)][-1]
        return self._bettered(state, self.claim) if state == begun else state

    def less(self, found: Selection, candidate: Candidate) -> Selection:
        """The outcome without one of its effects, all else fitted again."""
        return self.selection(tuple(s for s in found.state if s != candidate))

    def instead(self, found: Selection, candidate: Candidate, alias: str) -> Selection | None:
        """The outcome with `alias` in the place of one of its effects; None where that model was never fitted."""
        rest = frozenset(found.state) - {candidate}
        for key in list(self.store.fits):
            if len(key) == len(found.state) and key > rest and next(iter(key - rest)).name == alias:
                return self.selection(tuple(next(iter(key - rest)) if s == candidate else s for s in found.state))
        return None

    def begin(self, effects: Iterable[str], model: Model) -> State:
        """Fit these effects, beginning with a model's values, to search on from there. Raises ValueError: no motion."""
        store, base = self.store, self.store.base
        known = candidates_by_name(model, base.model, base.names)
        state = tuple(known[effect] for effect in effects)
        names = (*base.names, *(n for s in state for n in s.strengths + s.shapes))
        begun = base.model.replace({n: model.value(n) for n in names})
        start = linearise(store.evidence, begun, names, base.launches)
        store.offer(frozenset(state), minimise_chi2(store.evidence, start, store.progress))
        return state

    def _bettered(self, state: State, claim: float) -> State:
        """Drop and exchange candidates until nothing is better, or a model comes up again."""
        before: set[frozenset[Candidate]] = set()
        while state:
            before.add(frozenset(state))
            better = self._better(state, self.store.score_tests(state), claim)
            if better is None or frozenset(better) in before:
                break
            state = better
        return state

    def named(self, state: State) -> tuple[EffectClaim, ...]:
        """What is known of each of the effects in a model."""
        return tuple(self._named(state, k, self.store.score_tests(state)) for k in range(len(state)))

    def unidentifiable(self, state: State) -> tuple[str, ...]:
        """Effects that the collisions could not show beside those of a model."""
        return tuple(c.effect for c in self.store.score_tests(state).ranking() if not c.identifiable)

    def _sigma(self, chi2: float, candidate: Candidate) -> float:
        """The sigma of a chi^2 that a candidate explains, corrected by the trials factor of its shape parameters."""
        return chi2_to_sigma(chi2, len(candidate.strengths), self.trials_factors.get(candidate.name, 1.0))

    def _winner(self, state: State, tests: ScoreTests, claim: float) -> Candidate | None:
        """The candidate to add: of the leader and its rivals, all fitted, the simplest that fits as well as the best.

        None where no candidate is significant beyond `claim`, or far more is missing than any explains.
        """
        ranking = tests.leaders(claim)
        if not ranking or ranking[0].sigma <= claim:
            return None
        fit = tests.fit
        rivals = self._contenders(tests, ranking, claim)
        for c in rivals:
            key = frozenset({*state, c.candidate})
            if key not in self.store.fits:
                self.store.extend(key, fit, c)
        keys = sorted((frozenset({*state, c.candidate}) for c in rivals), key=self.store.cost_of)
        for key in keys:
            if self.store.cost_of(key) < self.store.cost_of(keys[0]) + NEAR:
                self.store.settled(tuple(key))
        said = {key: next(iter(key - frozenset(state))) for key in keys}
        claimed = [k for k in keys if self._claimed(fit, self.store.fits[k], said[k], claim)]
        return said[self._simplest(claimed)] if min(keys, key=self.store.cost_of) in claimed else None

    def _claimed(self, fit: ModelFit, more: ModelFit, candidate: Candidate, claim: float) -> bool:
        """Whether the fit with a candidate more is better than that without by what a claim needs."""
        enough = self._sigma(fit.chi2 - more.chi2, candidate) > claim
        return enough and not closes_too_little(
            fit.chi2 / fit.points, more.chi2 / more.points, current_policy().min_closed_share
        )

    def _simplest(self, keys: Collection[frozenset[Candidate]]) -> frozenset[Candidate]:
        """Of models that fit as well as the best: the fewest strengths, then shape parameters, then the best fit."""
        near = min(map(self.store.cost_of, keys)) + current_policy().rival_excluded_chi2

        def order(key: frozenset[Candidate]) -> tuple[int, int, float]:
            effects = [s for s in key if s.kind is not None]
            return sum(len(s.strengths) for s in effects), sum(len(s.shapes) for s in effects), self.store.cost_of(key)

        return min((k for k in keys if self.store.cost_of(k) <= near), key=order)

    def _contenders(self, tests: ScoreTests, ranking: Sequence[CandidateScore], claim: float) -> list[CandidateScore]:
        """The candidates worth fitting: those that may explain as much as the leader, or look like it.

        Their shape parameters are first looked for between those tried; then at most RIVALS are kept.
        """
        evidence, least = self.store.evidence, ranking[0].gain / 2 - NEAR
        chosen = [tests.sharper(evidence, c) if c.gain > least else c for c in ranking if c.gain > 0]
        leader = max(chosen, key=lambda c: c.sigma)
        near = [
            c
            for c in chosen
            if c.gain > (1 - LOOSE) * leader.gain - NEAR
            or largest_cosine(leader.signature, c.signature) > current_policy().alias_cosine
            or (c.candidate.kind is None and c.sigma > claim)
        ]
        return sorted(near, key=lambda c: (c.candidate.kind is not None, -c.gain))[:RIVALS]

    def _better(self, state: State, tests: ScoreTests, claim: float) -> State | None:
        """The model with one named effect dropped, or exchanged for a rival, if that is better."""
        fit = tests.fit
        for k, candidate in enumerate(state):
            rest, rise = state[:k] + state[k + 1 :], tests.chi2(candidate) - fit.chi2
            if self._sigma(rise, candidate) < 2 * claim:
                kept = self.store.settled(rest)
                if self._sigma(kept.chi2 - fit.chi2, candidate) < claim:
                    return rest
            reduced, keys = None, {frozenset(state): candidate}
            for c in self._rivals(tests, candidate):
                key = frozenset({*rest, c.candidate})
                keys[key] = c.candidate
                if key not in self.store.fits:
                    reduced = reduced or self.store.without(fit, candidate)
                    best = tests.sharper(self.store.evidence, c, candidate)
                    self.store.extend(key, reduced, best)
                if self.store.cost_of(key) < self.store.cost_of(state) + NEAR:
                    self.store.settled(tuple(key))
                if self.store.cost_of(key) < self.store.cost_of(state) - current_policy().rival_excluded_chi2:
                    return (*state[:k], c.candidate, *state[k + 1 :])
            simplest = self._simplest(keys)
            if simplest != frozenset(state):
                return (*state[:k], keys[simplest], *state[k + 1 :])
        return None

    def _rivals(self, tests: ScoreTests, candidate: Candidate) -> list[CandidateScore]:
        """At most SWAPS candidates that to first order do nearly as well in the place of a named effect."""
        total = tests.chi2(candidate)
        rise = total - tests.fit.chi2
        near = tests.fit.chi2 + NEAR + LOOSE * rise
        rivals = [c for c in tests.ranking(candidate) if total - c.gain < near and c.effect not in self.absorbed]
        return sorted(rivals, key=lambda c: -c.gain)[:SWAPS]

    def _named(self, state: State, k: int, tests: ScoreTests) -> EffectClaim:
        """What is known of the k-th effect of a model: values, errors, aliases, limits."""
        candidate, fit = state[k], tests.fit
        rest = frozenset(state) - {candidate}
        worse = self.store.settled(tuple(rest)).chi2 - fit.chi2
        others = {
            key - rest: self.store.cost_of(key) for key in self.store.fits if len(key) == len(state) and key > rest
        }
        near = sorted(
            (p, next(iter(s)).name)
            for s, p in others.items()
            if p < self.store.cost_of(state) + current_policy().rival_excluded_chi2
        )
        ranking = tuple(c for c in tests.ranking(candidate) if c.identifiable and c.effect not in self.absorbed)
        if candidate.kind is None:  # an effect can always bend a law to a constant: no rival to the constant itself
            ranking = tuple(c for c in ranking if c.candidate.kind is None)
            near = [(p, n) for p, n in near if n in {c.effect for c in ranking}]
        aliases = (candidate.name, *(n for _, n in near if n != candidate.name))
        own = tests.signature(candidate)
        cosines = sorted(((largest_cosine(own, c.signature), c.effect) for c in ranking), reverse=True)
        told = max((c for c, effect in cosines if effect not in aliases), default=0.0)
        limit = {s: current_policy().detection_limit_sigma * fit.std[s] for s in candidate.strengths}
        std = profile_std(self.store.evidence, self.store.without(fit, candidate), fit, candidate)
        return EffectClaim(
            candidate.name,
            {s: fit.model.value(s) for s in candidate.strengths},
            {s: std[s] for s in candidate.strengths},
            self._sigma(worse, candidate),
            aliases,
            {s: fit.model.value(s) for s in candidate.shapes},
            {s: shape_error(fit, s, std.get(s, 0.0)) for s in candidate.shapes},
            (*(((e,), c) for c, e in cosines if c > current_policy().alias_cosine), *find_similar_pairs(own, ranking)),
            limit,
            {s: x / float(np.sqrt(max(1 - told**2, 1e-12))) for s, x in limit.items()},
        )
