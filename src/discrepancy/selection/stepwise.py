"""Which effects are missing: added, dropped and exchanged until nothing improves."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from discrepancy import policy
from discrepancy.fitting.gauss_newton import linearised, settle
from discrepancy.fitting.model_fit import Fit
from discrepancy.fitting.parameters import Suspect, suspects_of
from discrepancy.fitting.significance import sigmas
from discrepancy.selection.candidate import Candidate
from discrepancy.selection.fit_store import FitStore
from discrepancy.selection.model_cost import price
from discrepancy.selection.named import Named, determined, sums
from discrepancy.selection.profile_errors import spread
from discrepancy.selection.score_test import Contest, likeness
from synthcam.model import Model

Array = NDArray[np.float64]

State = tuple[Suspect, ...]

NEAR, LOOSE = 15.0, 0.2  # of chi^2, and of what an effect explains: what the score may be wrong by
RIVALS, SWAPS = 8, 4  # refitted, at most, beside a leader and in the place of a named effect


@dataclass(frozen=True)
class Selection:
    """The effects named, and what they were chosen by.

    Attributes
    ----------
    state : tuple of Suspect
        The effects.
    base, best : Fit
        The fits before any effect and with these.
    ranking : tuple of Candidate
        The score tests of all suspects beside the base, most significant first.
    claim : float
        The sigma that a claim needs.
    looks : mapping of str to float
        How many independent looks the shapes of each suspect are, by its name.
    """

    state: State
    base: Fit
    best: Fit
    ranking: tuple[Candidate, ...]
    claim: float
    looks: Mapping[str, float]

    def paid(self, effect: str, sigma: float) -> float:
        """Sigma of an effect, corrected for the looks at its shapes."""
        return math.sqrt(max(sigma**2 - 2 * math.log(self.looks.get(effect, 1.0)), 0.0))


@dataclass(frozen=True)
class Stepwise:
    """Steps from one model to the next; the fits are those of a store.

    Base parameters held at zero are suspects too: those that the base has not fitted. absorbed: what the base fit
    absorbs is no rival; beside another effect it only seems to be.
    """

    store: FitStore
    ranking: tuple[Candidate, ...]
    claim: float
    looks: Mapping[str, float]
    absorbed: frozenset[str]

    @classmethod
    def of(cls, store: FitStore) -> Stepwise:
        """By the score tests beside the base, which tell what a claim needs before any search."""
        contest = store.contest(())
        ranking, looks = contest.ranking(), contest.looks
        claim = max(contest.claim(), policy.LEAST_SIGMA_OF_A_CLAIM)
        return cls(store, ranking, claim, looks, frozenset(c.effect for c in ranking if c.absorbed))

    def states(self, state: State = ()) -> Iterator[State]:
        """From a state to the next, each with one effect more, or others: until none scores what chance may."""
        while len(state) < policy.MOST_EFFECTS_NAMED:
            winner = self._winner(state, self.store.contest(state), self.claim)
            if winner is None:
                return
            more = self._bettered((*state, winner), self.claim)
            if len(more) <= len(state) and self.store.price(more) >= self.store.price(state):  # round in a circle
                return
            state = more
            yield state

    def selection(self, state: State) -> Selection:
        """A state as the outcome."""
        base = self.store.settled(())
        return Selection(state, base, self.store.exact(state), self.ranking, self.claim, self.looks)

    def from_there(self, found: Selection, effects: Iterable[str], model: Model) -> Selection | None:
        """The better selection, where one that begins with these effects, as a model has them, comes to a better model.

        With more effects it must be better by what excludes a rival, as always.
        """
        try:
            begun = self.begin(effects, model)
        except ValueError:  # alone they have no motion
            return None
        again = self.selection(self.end(begun))
        less = price(found.best, found.base) - price(again.best, found.base)
        return again if less > (policy.RIVAL_EXCLUDED_BY if len(again.state) > len(found.state) else 0.0) else None

    def end(self, begun: State) -> State:
        """The last of the states from one; that with what is not claimed dropped, where none follows."""
        state = [begun, *self.states(begun)][-1]
        return self._bettered(state, self.claim) if state == begun else state

    def less(self, found: Selection, suspect: Suspect) -> Selection:
        """Without one of the effects named, all else fitted again."""
        return self.selection(tuple(s for s in found.state if s != suspect))

    def instead(self, found: Selection, suspect: Suspect, alias: str) -> Selection | None:
        """With one that fits as well in the place of an effect named; None where it was not fitted."""
        rest = frozenset(found.state) - {suspect}
        for key in list(self.store.fits):
            if len(key) == len(found.state) and key > rest and next(iter(key - rest)).name == alias:
                return self.selection(tuple(next(iter(key - rest)) if s == suspect else s for s in found.state))
        return None

    def begin(self, effects: Iterable[str], model: Model) -> State:
        """A state to search on from: these effects, as a model has them, fitted. Raises ValueError without a motion."""
        store, base = self.store, self.store.base
        known = suspects_of(model, base.model, base.names)
        state = tuple(known[effect] for effect in effects)
        names = (*base.names, *(n for s in state for n in s.strengths + s.shapes))
        begun = base.model.replace({n: model.value(n) for n in names})
        start = linearised(store.evidence, begun, names, base.launches)
        store.offer(frozenset(state), settle(store.evidence, start, store.tick))
        return state

    def _bettered(self, state: State, claim: float) -> State:
        """A state with suspects dropped and exchanged until nothing is better."""
        before: set[frozenset[Suspect]] = set()
        while state:
            before.add(frozenset(state))
            better = self._better(state, self.store.contest(state), claim)
            if better is None or frozenset(better) in before:
                break
            state = better
        return state

    def named(self, state: State) -> tuple[Named, ...]:
        """What is known of each of the effects in a model."""
        return tuple(self._named(state, k, self.store.contest(state)) for k in range(len(state)))

    def untold(self, state: State) -> tuple[str, ...]:
        """Effects that the collisions could not show beside those of a model."""
        return tuple(c.effect for c in self.store.contest(state).ranking() if not c.telling)

    def _sigma(self, chi2: float, suspect: Suspect) -> float:
        """Of what a suspect explains, corrected for the looks at its shapes."""
        return sigmas(chi2, len(suspect.strengths), self.looks.get(suspect.name, 1.0))

    def _winner(self, state: State, contest: Contest, claim: float) -> Suspect | None:
        """What is to be added: the leader, or the rival that fits best with it. None when nothing is claimed."""
        ranking = contest.leaders(claim)
        if not ranking or ranking[0].sigma <= claim:
            return None
        now = contest.now
        rivals = self._contenders(contest, ranking, claim)
        for c in rivals:
            key = frozenset({*state, c.suspect})
            if not self.store.known(key):
                self.store.extend(key, now, c)
        keys = sorted((frozenset({*state, c.suspect}) for c in rivals), key=self.store.price)
        for key in keys:
            if self.store.price(key) < self.store.price(keys[0]) + NEAR:
                self.store.settled(tuple(key))
        said = {key: next(iter(key - frozenset(state))) for key in keys}
        claimed = [k for k in keys if self._sigma(now.chi2 - self.store.fits[k].chi2, said[k]) > claim]
        return said[self._simplest(claimed)] if min(keys, key=self.store.price) in claimed else None

    def _simplest(self, keys: Collection[frozenset[Suspect]]) -> frozenset[Suspect]:
        """Of models that fit as well as the best, the one with the fewest strengths, then shapes, then the best fit."""
        near = min(map(self.store.price, keys)) + policy.RIVAL_EXCLUDED_BY

        def order(key: frozenset[Suspect]) -> tuple[int, int, float]:
            effects = [s for s in key if s.kind is not None]
            return sum(len(s.strengths) for s in effects), sum(len(s.shapes) for s in effects), self.store.price(key)

        return min((k for k in keys if self.store.price(k) <= near), key=order)

    def _contenders(self, contest: Contest, ranking: Sequence[Candidate], claim: float) -> list[Candidate]:
        """Those that may fit as well as the leader, or better; their shapes made out more finely."""
        evidence, least = self.store.evidence, ranking[0].gain / 2 - NEAR
        chosen = [contest.sharper(evidence, c) if c.gain > least else c for c in ranking if c.gain > 0]
        leader = max(chosen, key=lambda c: c.sigma)
        near = [
            c
            for c in chosen
            if c.gain > (1 - LOOSE) * leader.gain - NEAR
            or likeness(leader.signature, c.signature) > policy.ALIAS_COSINE
            or (c.suspect.kind is None and c.sigma > claim)
        ]
        return sorted(near, key=lambda c: (c.suspect.kind is not None, -c.gain))[:RIVALS]

    def _better(self, state: State, contest: Contest, claim: float) -> State | None:
        """The model with one named effect dropped, or exchanged for a rival, if that is better."""
        now = contest.now
        for k, suspect in enumerate(state):
            rest, rise = state[:k] + state[k + 1 :], contest.chi2(suspect) - now.chi2
            if self._sigma(rise, suspect) < 2 * claim:
                kept = self.store.settled(rest)
                if self._sigma(kept.chi2 - now.chi2, suspect) < claim:
                    return rest
            reduced, keys = None, {frozenset(state): suspect}
            for c in self._rivals(contest, suspect):
                key = frozenset({*rest, c.suspect})
                keys[key] = c.suspect
                if not self.store.known(key):
                    reduced = reduced or self.store.without(now, suspect)
                    best = contest.sharper(self.store.evidence, c, suspect)
                    self.store.extend(key, reduced, best)
                if self.store.price(key) < self.store.price(state) + NEAR:
                    self.store.settled(tuple(key))
                if self.store.price(key) < self.store.price(state) - policy.RIVAL_EXCLUDED_BY:
                    return (*state[:k], c.suspect, *state[k + 1 :])
            simplest = self._simplest(keys)
            if simplest != frozenset(state):
                return (*state[:k], keys[simplest], *state[k + 1 :])
        return None

    def _rivals(self, contest: Contest, suspect: Suspect) -> list[Candidate]:
        """Those that may do as well in the place of a named effect."""
        total = contest.chi2(suspect)
        rise = total - contest.now.chi2
        near = contest.now.chi2 + NEAR + LOOSE * rise
        rivals = [c for c in contest.ranking(suspect) if total - c.gain < near and c.effect not in self.absorbed]
        return sorted(rivals, key=lambda c: -c.gain)[:SWAPS]

    def _named(self, state: State, k: int, contest: Contest) -> Named:
        suspect, now = state[k], contest.now
        rest = frozenset(state) - {suspect}
        worse = self.store.settled(tuple(rest)).chi2 - now.chi2
        others = {key - rest: self.store.price(key) for key in self.store.fits if len(key) == len(state) and key > rest}
        near = sorted(
            (p, next(iter(s)).name) for s, p in others.items() if p < self.store.price(state) + policy.RIVAL_EXCLUDED_BY
        )
        ranking = tuple(c for c in contest.ranking(suspect) if c.telling and c.effect not in self.absorbed)
        if suspect.kind is None:  # an effect can always bend a law to a constant: no rival to the constant itself
            ranking = tuple(c for c in ranking if c.suspect.kind is None)
            near = [(p, n) for p, n in near if n in {c.effect for c in ranking}]
        aliases = (suspect.name, *(n for _, n in near if n != suspect.name))
        own = contest.signature(suspect)
        cosines = sorted(((likeness(own, c.signature), c.effect) for c in ranking), reverse=True)
        told = max((c for c, effect in cosines if effect not in aliases), default=0.0)
        limit = {s: policy.DETECTION_LIMIT_SIGMA * now.std[s] for s in suspect.strengths}
        std = spread(self.store.evidence, self.store.without(now, suspect), now, suspect)
        return Named(
            suspect.name,
            {s: now.model.value(s) for s in suspect.strengths},
            {s: std[s] for s in suspect.strengths},
            self._sigma(worse, suspect),
            aliases,
            {s: now.model.value(s) for s in suspect.shapes},
            {s: determined(now, s, std.get(s, 0.0)) for s in suspect.shapes},
            (*(((e,), c) for c, e in cosines if c > policy.ALIAS_COSINE), *sums(own, ranking)),
            limit,
            {s: x / float(np.sqrt(max(1 - told**2, 1e-12))) for s, x in limit.items()},
        )
