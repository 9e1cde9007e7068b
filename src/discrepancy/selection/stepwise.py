"""Which effects are missing: added, dropped and exchanged until nothing improves."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from discrepancy import policy
from discrepancy.data.collisions import Measured
from discrepancy.fitting.gauss_newton import Evidence, Fit, linearised, settle
from discrepancy.fitting.parameters import Suspect, suspects_of
from discrepancy.fitting.significance import sigmas
from discrepancy.noise.model import Noise
from discrepancy.selection.candidate import Candidate
from discrepancy.selection.fit_store import Visited
from discrepancy.selection.model_cost import price
from discrepancy.selection.named import Named, determined, sums
from discrepancy.selection.profile_errors import spread
from discrepancy.selection.score_test import Contest, likeness
from synthcam.model import Model

Array = NDArray[np.float64]

NEAR, LOOSE = 15.0, 0.2  # of chi^2, and of what an effect explains: what the score may be wrong by
RIVALS, SWAPS = 8, 4  # refitted, at most, beside a leader and in the place of a named effect


@dataclass(frozen=True)
class Search:
    """The outcome of a search: the fits before any effect and with all named ones, and the base's ranking.

    claim: the sigma needed.
    """

    base: Fit
    best: Fit
    ranking: tuple[Candidate, ...]
    claim: float
    state: tuple[Suspect, ...]
    hunt: _Hunt = field(repr=False)

    @cached_property
    def named(self) -> tuple[Named, ...]:
        return self.hunt.named(self.state)

    def from_here(self, effects: Iterable[str], model: Model) -> Search | None:
        """The better search, where one that begins with these effects, as a model has them, comes to a better model.

        With more effects it must be better by what excludes a rival, as always.
        """
        try:
            begun = self.hunt.begin(effects, model)
        except ValueError:  # alone they have no motion
            return None
        again = self.hunt.outcome(lambda now, rivals: False, begun)
        less = price(self.best, self.base) - price(again.best, self.base)
        return again if less > (policy.RIVAL_EXCLUDED_BY if len(again.state) > len(self.state) else 0.0) else None

    def less(self, suspect: Suspect) -> Search:
        """Without one of the effects named, all else fitted again."""
        state = tuple(s for s in self.state if s != suspect)
        return Search(self.base, self.hunt.seen.exact(state), self.ranking, self.claim, state, self.hunt)

    def instead(self, suspect: Suspect, alias: str) -> Search | None:
        """With one that fits as well in the place of an effect named; None where it was not fitted."""
        rest = frozenset(self.state) - {suspect}
        for key in list(self.hunt.seen.fits):
            if len(key) == len(self.state) and key > rest and next(iter(key - rest)).name == alias:
                state = tuple(next(iter(key - rest)) if s == suspect else s for s in self.state)
                return Search(self.base, self.hunt.seen.exact(state), self.ranking, self.claim, state, self.hunt)
        return None

    def paid(self, effect: str, sigma: float) -> float:
        """Sigma of an effect, corrected for the looks at its shapes."""
        return math.sqrt(max(sigma**2 - 2 * math.log(self.hunt.looks.get(effect, 1.0)), 0.0))

    @property
    def rivals(self) -> list[Fit]:
        """All models visited with as many effects as are named."""
        return self.hunt.seen.rivals(self.state)

    @cached_property
    def untold(self) -> tuple[str, ...]:
        """Effects that these collisions could not show, however real."""
        return self.hunt.untold(self.state)


def search(
    clips: Sequence[Measured],
    base: Fit,
    noise: Noise,
    tick: Callable[[], None] = lambda: None,
    enough: Callable[[Fit, Sequence[Fit]], bool] = lambda now, rivals: False,
    former: Search | None = None,
) -> Search:
    """Name effects one by one until none scores what chance may; each time drop or exchange what then fits better.

    Base parameters held at zero are suspects too: those that `base` has not fitted. enough: asked of each fit on the
    way and of those of as many suspects, ends the search. former: of the same clips with another noise; models that it
    has fitted are fitted from where they then stood.
    """
    seen = Visited(Evidence.of(clips, noise), base, tick, former.hunt.seen if former else None)
    return _Hunt(seen).outcome(enough)


class _Hunt:
    """The way through the models visited."""

    def __init__(self, seen: Visited) -> None:
        self.seen = seen
        self.looks: dict[str, float] = {}  # at the shapes of each suspect
        self.blind: set[str] = set()  # what the base fit absorbs is no rival; beside another effect it only seems to be

    def outcome(self, enough: Callable[[Fit, Sequence[Fit]], bool], state: tuple[Suspect, ...] = ()) -> Search:
        """state: what to begin with."""
        ranking, claim = self._first
        begun = state
        while len(state) < policy.MOST_EFFECTS_NAMED:
            winner = self._winner(state, self.seen.contest(state), claim)
            if winner is None:
                break
            more = self._bettered((*state, winner), claim)
            if len(more) <= len(state) and self.seen.price(more) >= self.seen.price(state):  # round in a circle
                break
            state = more
            if enough(self.seen.settled(state), self.seen.rivals(state)):
                break
        if state == begun:
            state = self._bettered(state, claim)
        self.seen.former = None  # memory
        return Search(self.seen.settled(()), self.seen.exact(state), ranking, claim, state, self)

    @cached_property
    def _first(self) -> tuple[tuple[Candidate, ...], float]:
        """The base's ranking, and the sigma needed; what is known before any search."""
        contest = self.seen.contest(())
        ranking, self.looks = contest.ranking(), contest.looks
        self.blind = {c.effect for c in ranking if c.absorbed}
        return ranking, max(contest.claim(), policy.LEAST_SIGMA_OF_A_CLAIM)

    def begin(self, effects: Iterable[str], model: Model) -> tuple[Suspect, ...]:
        """A state to search on from: these effects, as a model has them, fitted. Raises ValueError without a motion."""
        base = self.seen.base
        known = suspects_of(model, base.model, base.names)
        state = tuple(known[effect] for effect in effects)
        names = (*base.names, *(n for s in state for n in s.strengths + s.shapes))
        begun = base.model.replace({n: model.value(n) for n in names})
        start = linearised(self.seen.evidence, begun, names, base.launches)
        self.seen.offer(frozenset(state), settle(self.seen.evidence, start, self.seen.tick))
        return state

    def _bettered(self, state: tuple[Suspect, ...], claim: float) -> tuple[Suspect, ...]:
        """A state with suspects dropped and exchanged until nothing is better."""
        before: set[frozenset[Suspect]] = set()
        while state:
            before.add(frozenset(state))
            better = self._better(state, self.seen.contest(state), claim)
            if better is None or frozenset(better) in before:
                break
            state = better
        return state

    def named(self, state: tuple[Suspect, ...]) -> tuple[Named, ...]:
        """What is known of each of the effects in a model."""
        return tuple(self._named(state, k, self.seen.contest(state)) for k in range(len(state)))

    def untold(self, state: tuple[Suspect, ...]) -> tuple[str, ...]:
        """Effects that the collisions could not show beside those of a model."""
        return tuple(c.effect for c in self.seen.contest(state).ranking() if not c.telling)

    def _sigma(self, chi2: float, suspect: Suspect) -> float:
        """Of what a suspect explains, corrected for the looks at its shapes."""
        return sigmas(chi2, len(suspect.strengths), self.looks.get(suspect.name, 1.0))

    def _winner(self, state: tuple[Suspect, ...], contest: Contest, claim: float) -> Suspect | None:
        """What is to be added: the leader, or the rival that fits best with it. None when nothing is claimed."""
        ranking = contest.leaders(claim)
        if not ranking or ranking[0].sigma <= claim:
            return None
        now = contest.now
        rivals = self._contenders(contest, ranking, claim)
        for c in rivals:
            key = frozenset({*state, c.suspect})
            if not self.seen.known(key):
                self.seen.grow(key, now, c)
        keys = sorted((frozenset({*state, c.suspect}) for c in rivals), key=self.seen.price)
        for key in keys:
            if self.seen.price(key) < self.seen.price(keys[0]) + NEAR:
                self.seen.settled(tuple(key))
        said = {key: next(iter(key - frozenset(state))) for key in keys}
        claimed = [k for k in keys if self._sigma(now.chi2 - self.seen.fits[k].chi2, said[k]) > claim]
        return said[self._simplest(claimed)] if min(keys, key=self.seen.price) in claimed else None

    def _simplest(self, keys: Collection[frozenset[Suspect]]) -> frozenset[Suspect]:
        """Of models that fit as well as the best, the one with the fewest strengths, then shapes, then the best fit."""
        near = min(map(self.seen.price, keys)) + policy.RIVAL_EXCLUDED_BY

        def order(key: frozenset[Suspect]) -> tuple[int, int, float]:
            effects = [s for s in key if s.kind is not None]
            return sum(len(s.strengths) for s in effects), sum(len(s.shapes) for s in effects), self.seen.price(key)

        return min((k for k in keys if self.seen.price(k) <= near), key=order)

    def _contenders(self, contest: Contest, ranking: Sequence[Candidate], claim: float) -> list[Candidate]:
        """Those that may fit as well as the leader, or better; their shapes made out more finely."""
        evidence, least = self.seen.evidence, ranking[0].gain / 2 - NEAR
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

    def _better(self, state: tuple[Suspect, ...], contest: Contest, claim: float) -> tuple[Suspect, ...] | None:
        """The model with one named effect dropped, or exchanged for a rival, if that is better."""
        now = contest.now
        for k, suspect in enumerate(state):
            rest, rise = state[:k] + state[k + 1 :], contest.chi2(suspect) - now.chi2
            if self._sigma(rise, suspect) < 2 * claim:
                kept = self.seen.settled(rest)
                if self._sigma(kept.chi2 - now.chi2, suspect) < claim:
                    return rest
            reduced, keys = None, {frozenset(state): suspect}
            for c in self._rivals(contest, suspect):
                key = frozenset({*rest, c.suspect})
                keys[key] = c.suspect
                if not self.seen.known(key):
                    reduced = reduced or self.seen.without(now, suspect)
                    best = contest.sharper(self.seen.evidence, c, suspect)
                    self.seen.grow(key, reduced, best)
                if self.seen.price(key) < self.seen.price(state) + NEAR:
                    self.seen.settled(tuple(key))
                if self.seen.price(key) < self.seen.price(state) - policy.RIVAL_EXCLUDED_BY:
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
        rivals = [c for c in contest.ranking(suspect) if total - c.gain < near and c.effect not in self.blind]
        return sorted(rivals, key=lambda c: -c.gain)[:SWAPS]

    def _named(self, state: tuple[Suspect, ...], k: int, contest: Contest) -> Named:
        suspect, now = state[k], contest.now
        rest = frozenset(state) - {suspect}
        worse = self.seen.settled(tuple(rest)).chi2 - now.chi2
        others = {key - rest: self.seen.price(key) for key in self.seen.fits if len(key) == len(state) and key > rest}
        near = sorted(
            (p, next(iter(s)).name) for s, p in others.items() if p < self.seen.price(state) + policy.RIVAL_EXCLUDED_BY
        )
        ranking = tuple(c for c in contest.ranking(suspect) if c.telling and c.effect not in self.blind)
        if suspect.kind is None:  # an effect can always bend a law to a constant: no rival to the constant itself
            ranking = tuple(c for c in ranking if c.suspect.kind is None)
            near = [(p, n) for p, n in near if n in {c.effect for c in ranking}]
        aliases = (suspect.name, *(n for _, n in near if n != suspect.name))
        own = contest.signature(suspect)
        cosines = sorted(((likeness(own, c.signature), c.effect) for c in ranking), reverse=True)
        told = max((c for c, effect in cosines if effect not in aliases), default=0.0)
        limit = {s: policy.DETECTION_LIMIT_SIGMA * now.std[s] for s in suspect.strengths}
        std = spread(self.seen.evidence, self.seen.without(now, suspect), now, suspect)
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
