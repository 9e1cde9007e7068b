"""Which effects are missing: added, dropped and exchanged until nothing improves."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from discrepancy.candidate import Candidate
from discrepancy.claim import FLOOR, sigmas
from discrepancy.elsewhere import GAINED, spread
from discrepancy.fit import Evidence, Fit, derivative, linearised, nudged, settle, telling
from discrepancy.forecast import forecast
from discrepancy.measured import Measured
from discrepancy.named import ALIAS, Named, determined, sums
from discrepancy.noise import Noise
from discrepancy.parameter import Suspect, limits_of, parameter_of, suspects_of
from discrepancy.price import price
from discrepancy.rank import LIMIT, Contest, likeness
from discrepancy.scan import scannable
from synthcam.model import Model

Array = NDArray[np.float64]

MOST = 4  # effects named in one search: more together can imitate what is in nobody's library
PART = 9.5  # of chi^2, all freedom paid for: a rival that is worse by less is not excluded
NEAR, LOOSE = 15.0, 0.2  # of chi^2, and of what an effect explains: what the score may be wrong by
RIVALS, SWAPS = 8, 4  # refitted, at most, beside a leader and in the place of a named effect
KEPT = 0.5  # of the gain that the score promises
STARTS, FAR = (0.1, 0.3, 1.0), 2  # of a realistic size, where the way is too far for the score; that many are followed


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

        With more effects it must be better by PART, as always.
        """
        try:
            begun = self.hunt.begin(effects, model)
        except ValueError:  # alone they have no motion
            return None
        again = self.hunt.outcome(lambda now, rivals: False, begun)
        less = price(self.best, self.base) - price(again.best, self.base)
        return again if less > (PART if len(again.state) > len(self.state) else 0.0) else None

    @property
    def rivals(self) -> list[Fit]:
        """All models visited with as many effects as are named."""
        return self.hunt.rivals(self.state)

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
) -> Search:
    """Name effects one by one until none scores what chance may; each time drop or exchange what then fits better.

    Base parameters held at zero are suspects too: those that `base` has not fitted. enough: asked of each fit on the
    way and of those of as many suspects, ends the search.
    """
    return _Hunt(clips, noise, base, tick).outcome(enough)


def added(evidence: Evidence, now: Fit, candidate: Candidate, tick: Callable[[], None] = lambda: None) -> Fit:
    """The fit with a candidate's strengths, and its shapes once they mean something, fitted too; roughly settled.

    From where the score leads; if that keeps less than it promised, from realistic sizes as well. A base parameter held
    at zero is far from there.
    """
    tries = [] if candidate.suspect.kind is None else [_from_here(evidence, now, candidate, tick)]
    if not tries or tries[0].chi2 > now.chi2 - KEPT * candidate.gain:
        tries += [settle(evidence, start, tick, rough=True) for start in _far(evidence, now, candidate)]
    return min(tries, key=lambda f: f.chi2, default=now)


def _from_here(evidence: Evidence, now: Fit, candidate: Candidate, tick: Callable[[], None]) -> Fit:
    suspect, model = candidate.suspect, now.model.replace(candidate.shapes)
    grown = settle(evidence, now.extended(model, candidate.strengths, candidate.columns), tick, fresh=False, rough=True)
    if not suspect.shapes or all(grown.model.value(s) == 0 for s in candidate.strengths):
        return grown
    here = forecast(grown.model, grown.launches, evidence.clips)
    slopes = [derivative(grown.model, grown.launches, evidence.clips, s, here) for s in suspect.shapes]
    columns = evidence.white([np.stack([s[k] for s in slopes], axis=-1) for k in range(len(here))])
    columns = telling(grown.model, suspect.shapes, columns)
    return settle(evidence, grown.extended(grown.model, suspect.shapes, columns), tick, fresh=False, rough=True)


def _far(evidence: Evidence, now: Fit, candidate: Candidate) -> list[Fit]:
    """Places to start from with a single strength at realistic sizes: those that fit best when the rest gives way."""
    suspect = candidate.suspect
    if len(suspect.strengths) > 1:
        return []
    name = suspect.strengths[0]
    size, (low, high) = parameter_of(now.model, name).scale, limits_of(now.model, name)
    looks: list[Fit] = []
    for shapes in suspect.grid(now.model):
        for value in (sign * share * size for share in STARTS for sign in (1, -1)):
            if low <= value <= high:
                look = nudged(evidence, now, now.model.replace({**shapes, name: value}))
                looks += [look] if look else []
    best = sorted(looks, key=lambda f: f.chi2)[:FAR]
    names = (*now.names, name, *suspect.shapes)
    return [linearised(evidence, f.model, names, f.launches) for f in best]


class _Hunt:
    """The models visited, by the suspects in them, and the way through them."""

    def __init__(self, clips: Sequence[Measured], noise: Noise, base: Fit, tick: Callable[[], None]) -> None:
        self.evidence, self.tick = Evidence.of(clips, noise), tick
        self.fits: dict[frozenset[Suspect], Fit] = {frozenset(): base}
        self.last: Contest | None = None  # the only one kept: it holds every suspect's derivatives
        self.looks: dict[str, float] = {}  # at the shapes of each suspect
        self.blind: set[str] = set()  # what the base fit absorbs is no rival; beside another effect it only seems to be
        self.sure: set[frozenset[Suspect]] = {frozenset()}  # whose fits are settled to the end
        self.latest: dict[frozenset[Suspect], Suspect] = {}  # added with a look at all its shapes

    def outcome(self, enough: Callable[[Fit, Sequence[Fit]], bool], state: tuple[Suspect, ...] = ()) -> Search:
        """state: what to begin with."""
        ranking, claim = self._first
        begun = state
        while len(state) < MOST:
            winner = self._winner(state, self._contest(state), claim)
            if winner is None:
                break
            grown = self._bettered((*state, winner), claim)
            if len(grown) <= len(state) and self._price(grown) >= self._price(state):  # round in a circle
                break
            state = grown
            if enough(self._settled(state), self.rivals(state)):
                break
        if state == begun:
            state = self._bettered(state, claim)
        return Search(self._settled(()), self._settled(state), ranking, claim, state, self)

    @cached_property
    def _first(self) -> tuple[tuple[Candidate, ...], float]:
        """The base's ranking, and the sigma needed; what is known before any search."""
        contest = self._contest(())
        ranking, self.looks = contest.ranking(), contest.looks
        self.blind = {c.effect for c in ranking if c.absorbed}
        return ranking, max(contest.claim(), FLOOR)

    def begin(self, effects: Iterable[str], model: Model) -> tuple[Suspect, ...]:
        """A state to search on from: these effects, as a model has them, fitted. Raises ValueError without a motion."""
        base = self.fits[frozenset()]
        known = suspects_of(model, base.model, base.names)
        state = tuple(known[effect] for effect in effects)
        names = (*base.names, *(n for s in state for n in s.strengths + s.shapes))
        begun = base.model.replace({n: model.value(n) for n in names})
        start = linearised(self.evidence, begun, names, base.launches)
        key, found = frozenset(state), settle(self.evidence, start, self.tick)
        if key not in self.fits or found.chi2 < self.fits[key].chi2:
            self.fits[key] = found
            self.sure.discard(key)
        return state

    def rivals(self, state: Collection[Suspect]) -> list[Fit]:
        """All models visited with as many suspects."""
        return [f for key, f in self.fits.items() if len(key) == len(state)]

    def _bettered(self, state: tuple[Suspect, ...], claim: float) -> tuple[Suspect, ...]:
        """A state with suspects dropped and exchanged until nothing is better."""
        before: set[frozenset[Suspect]] = set()
        while state:
            before.add(frozenset(state))
            better = self._better(state, self._contest(state), claim)
            if better is None or frozenset(better) in before:
                break
            state = better
        return state

    def named(self, state: tuple[Suspect, ...]) -> tuple[Named, ...]:
        """What is known of each of the effects in a model."""
        return tuple(self._named(state, k, self._contest(state)) for k in range(len(state)))

    def untold(self, state: tuple[Suspect, ...]) -> tuple[str, ...]:
        """Effects that the collisions could not show beside those of a model."""
        return tuple(c.effect for c in self._contest(state).ranking() if not c.telling)

    def _sigma(self, chi2: float, suspect: Suspect) -> float:
        """Of what a suspect explains, corrected for the looks at its shapes."""
        return sigmas(chi2, len(suspect.strengths), self.looks.get(suspect.name, 1.0))

    def _contest(self, state: Sequence[Suspect]) -> Contest:
        now = self._settled(state)
        if self.last is None or self.last.now is not now:
            self.last = None  # before there is another
            self.last = Contest.of(self.evidence, now, self.tick)
        return self.last

    def _settled(self, state: Sequence[Suspect]) -> Fit:
        key = frozenset(state)
        if key not in self.fits:
            self.fits[key] = self._reduced(state)
        if key not in self.sure:
            self.fits[key] = self._astray(state, settle(self.evidence, self.fits[key], self.tick, fresh=False))
            self.sure.add(key)
        return self.fits[key]

    def _astray(self, state: Iterable[Suspect], now: Fit) -> Fit:
        """The fit, or one from other shapes where that is better: far from the truth chi^2 may be flat in them."""
        for suspect in state:
            tries = list(suspect.grid(suspect.without(now.model)))
            if len(tries) < 2:
                continue
            if not scannable(suspect, tries):  # a strong effect's shapes show only at that strength
                looks = [nudged(self.evidence, now, now.model.replace(shapes)) for shapes in tries]
                now = self._or_better(now, min((f for f in looks if f), key=lambda f: f.chi2, default=now))
            if suspect is self.latest.get(frozenset(state)):
                continue
            reduced = self._without(now, suspect)
            contest = Contest.of(self.evidence, reduced, self.tick, [suspect])
            candidate = contest.sharper(self.evidence, contest.ranking()[0])
            if contest.chi2() - candidate.gain < now.chi2 - GAINED:
                now = self._or_better(now, added(self.evidence, reduced, candidate, self.tick))
        return now

    def _or_better(self, now: Fit, other: Fit) -> Fit:
        """The other fit, settled, where it is better."""
        if other.chi2 >= now.chi2:
            return now
        return min(now, settle(self.evidence, other, self.tick, fresh=False), key=lambda f: f.chi2)

    def _reduced(self, state: Sequence[Suspect]) -> Fit:
        """A fit of a part of some model visited."""
        larger = min((k for k in self.fits if k > frozenset(state)), key=len)
        now = self.fits[larger]
        for suspect in larger - frozenset(state):
            now = self._without(now, suspect)
        return now

    def _without(self, now: Fit, suspect: Suspect) -> Fit:
        reduced = now.reduced(suspect.without(now.model), suspect.strengths + suspect.shapes)
        try:
            return dataclasses.replace(reduced, residuals=self.evidence.left(reduced.model, reduced.launches))
        except ValueError:  # two effects held the ball at rest together: begin without either
            base = self.fits[frozenset()]
            gone = [n for n in reduced.names if n not in base.names and not parameter_of(reduced.model, n).fixed]
            model = reduced.model.replace({n: base.model.value(n) for n in base.names} | dict.fromkeys(gone, 0.0))
            return linearised(self.evidence, model, reduced.names, base.launches)

    def _price(self, state: Iterable[Suspect]) -> float:
        """chi^2 with what strengths and shapes cost."""
        return price(self.fits[frozenset(state)], self.fits[frozenset()])

    def _winner(self, state: tuple[Suspect, ...], contest: Contest, claim: float) -> Suspect | None:
        """What is to be added: the leader, or the rival that fits best with it. None when nothing is claimed."""
        ranking = contest.leaders(claim)
        if not ranking or ranking[0].sigma <= claim:
            return None
        now = contest.now
        rivals = self._contenders(contest, ranking, claim)
        for c in rivals:
            key = frozenset({*state, c.suspect})
            if key not in self.fits:
                self.fits[key], self.latest[key] = added(self.evidence, now, c, self.tick), c.suspect
        keys = sorted((frozenset({*state, c.suspect}) for c in rivals), key=self._price)
        for key in keys:
            if self._price(key) < self._price(keys[0]) + NEAR:
                self._settled(tuple(key))
        said = {key: next(iter(key - frozenset(state))) for key in keys}
        claimed = [k for k in keys if self._sigma(now.chi2 - self.fits[k].chi2, said[k]) > claim]
        return said[self._simplest(claimed)] if min(keys, key=self._price) in claimed else None

    def _simplest(self, keys: Collection[frozenset[Suspect]]) -> frozenset[Suspect]:
        """Of models that fit as well as the best, the one with the fewest strengths, then shapes, then the best fit."""
        near = min(map(self._price, keys)) + PART

        def order(key: frozenset[Suspect]) -> tuple[int, int, float]:
            effects = [s for s in key if s.kind is not None]
            return sum(len(s.strengths) for s in effects), sum(len(s.shapes) for s in effects), self._price(key)

        return min((k for k in keys if self._price(k) <= near), key=order)

    def _contenders(self, contest: Contest, ranking: Sequence[Candidate], claim: float) -> list[Candidate]:
        """Those that may fit as well as the leader, or better; their shapes made out more finely."""
        most = ranking[0].gain
        chosen = [contest.sharper(self.evidence, c) if c.gain > most / 2 - NEAR else c for c in ranking if c.gain > 0]
        leader = max(chosen, key=lambda c: c.sigma)
        near = [
            c
            for c in chosen
            if c.gain > (1 - LOOSE) * leader.gain - NEAR
            or likeness(leader.signature, c.signature) > ALIAS
            or (c.suspect.kind is None and c.sigma > claim)
        ]
        return sorted(near, key=lambda c: (c.suspect.kind is not None, -c.gain))[:RIVALS]

    def _better(self, state: tuple[Suspect, ...], contest: Contest, claim: float) -> tuple[Suspect, ...] | None:
        """The model with one named effect dropped, or exchanged for a rival, if that is better."""
        now = contest.now
        for k, suspect in enumerate(state):
            rest, rise = state[:k] + state[k + 1 :], contest.chi2(suspect) - now.chi2
            if self._sigma(rise, suspect) < 2 * claim:
                kept = self._settled(rest)
                if self._sigma(kept.chi2 - now.chi2, suspect) < claim:
                    return rest
            reduced, keys = None, {frozenset(state): suspect}
            for c in self._rivals(contest, suspect):
                key = frozenset({*rest, c.suspect})
                keys[key] = c.suspect
                if key not in self.fits:
                    reduced = reduced or self._without(now, suspect)
                    best = contest.sharper(self.evidence, c, suspect)
                    self.fits[key], self.latest[key] = added(self.evidence, reduced, best, self.tick), c.suspect
                if self._price(key) < self._price(state) + NEAR:
                    self._settled(tuple(key))
                if self._price(key) < self._price(state) - PART:
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
        worse = self._settled(tuple(rest)).chi2 - now.chi2
        others = {key - rest: self._price(key) for key in self.fits if len(key) == len(state) and key > rest}
        near = sorted((p, next(iter(s)).name) for s, p in others.items() if p < self._price(state) + PART)
        ranking = tuple(c for c in contest.ranking(suspect) if c.telling and c.effect not in self.blind)
        if suspect.kind is None:  # an effect can always bend a law to a constant: no rival to the constant itself
            ranking = tuple(c for c in ranking if c.suspect.kind is None)
            near = [(p, n) for p, n in near if n in {c.effect for c in ranking}]
        aliases = (suspect.name, *(n for _, n in near if n != suspect.name))
        own = contest.signature(suspect)
        cosines = sorted(((likeness(own, c.signature), c.effect) for c in ranking), reverse=True)
        told = max((c for c, effect in cosines if effect not in aliases), default=0.0)
        limit = {s: LIMIT * now.std[s] for s in suspect.strengths}
        std = spread(self.evidence, self._without(now, suspect), now, suspect)
        return Named(
            suspect.name,
            {s: now.model.value(s) for s in suspect.strengths},
            {s: std[s] for s in suspect.strengths},
            self._sigma(worse, suspect),
            aliases,
            {s: now.model.value(s) for s in suspect.shapes},
            {s: determined(now, s, std.get(s, 0.0)) for s in suspect.shapes},
            (*(((e,), c) for c, e in cosines if c > ALIAS), *sums(own, ranking)),
            limit,
            {s: x / float(np.sqrt(max(1 - told**2, 1e-12))) for s, x in limit.items()},
        )
