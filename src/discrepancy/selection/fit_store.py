"""Every model that a search has fitted, by the suspects in it, and the contest of all others beside the last."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Iterable, Sequence

from discrepancy.fitting.gauss_newton import Evidence, Fit, likeliest, linearised, nudged, settle
from discrepancy.fitting.parameters import Suspect, parameter_of
from discrepancy.fitting.shape_scan import scannable
from discrepancy.selection.candidate import Candidate
from discrepancy.selection.extend import grown
from discrepancy.selection.model_cost import price
from discrepancy.selection.profile_errors import GAINED
from discrepancy.selection.score_test import Contest
from synthcam.dynamics.solve import uncoupled

Key = frozenset[Suspect]
ALIKE = 1.5  # times chi^2 of the base model: noise that differs by more makes other minima
KEPT = 8_000_000  # numbers in all contests kept beside the last


class Visited:
    """The models fitted. former: those of the same clips with a noise that may be alike; the same go on from there."""

    def __init__(self, evidence: Evidence, base: Fit, tick: Callable[[], None], former: Visited | None = None) -> None:
        self.evidence, self.tick, self.former = evidence, tick, None
        if former:
            former.former = former.last = None  # memory
            if 1 / ALIKE < base.chi2 / former.base.chi2 < ALIKE:
                self.former = former
        self.fits: dict[Key, Fit] = {frozenset(): base}
        self.last: Contest | None = None
        self.contests: dict[Key, Contest] = {}  # small ones; each holds every suspect's derivatives
        self.sure: set[Key] = {frozenset()}  # whose fits are settled to the end
        self.stood: set[Key] = {frozenset()} if self.former else set()  # settled to the end by the former
        self.latest: dict[Key, Suspect] = {}  # added with a look at all its shapes

    @property
    def base(self) -> Fit:
        return self.fits[frozenset()]

    def contest(self, state: Sequence[Suspect]) -> Contest:
        """Of all suspects beside those of a model."""
        now, key = self.settled(state), frozenset(state)
        if self.last is None or self.last.now is not now:
            self.last = None  # before there is another
            self.last = self._contest(now, key)
            if self.last.numbers + sum(c.numbers for c in self.contests.values()) <= KEPT:
                self.contests[key] = self.last
        return self.last

    def _contest(self, now: Fit, key: Key) -> Contest:
        if key in self.contests and self.contests[key].now is now:
            return self.contests[key]
        former = self.former.contests.pop(key, None) if self.former and key in self.stood else None
        if self.former and former and former.now is self.former.fits[key]:
            return former.seen_by(now, self.former.evidence, self.evidence)
        return Contest.of(self.evidence, now, self.tick)

    def settled(self, state: Sequence[Suspect]) -> Fit:
        """The best fit of a model."""
        key = frozenset(state)
        if not self.known(key):
            self.fits[key] = self._reduced(state)
        if key not in self.sure:
            now = settle(self.evidence, self.fits[key], self.tick, fresh=False)
            self.fits[key] = now if key in self.stood else self._astray(state, now)
            self.sure.add(key)
        return self.fits[key]

    def exact(self, state: Sequence[Suspect]) -> Fit:
        """`settled`, all derivatives with the push between balls, where there is one: errors are read off them."""
        now, key = self.settled(state), frozenset(state)
        if uncoupled(now.model).effects != now.model.effects:
            self.last = dataclasses.replace(
                self.contest(state), now=linearised(self.evidence, now.model, now.names, now.launches, exact=True)
            )
            self.fits[key] = self.last.now
            if key in self.contests:
                self.contests[key] = self.last
        return self.fits[key]

    def known(self, key: frozenset[Suspect]) -> bool:
        """Whether a model was fitted before, here or by the former."""
        if key not in self.fits and self.former and key in self.former.fits:
            now, sure = self.former.fits[key].seen_by(self.former.evidence, self.evidence), key in self.former.sure
            self.fits[key] = settle(self.evidence, now, self.tick, fresh=sure, rough=True)
            if sure:
                self.stood.add(key)
            if key in self.former.latest:
                self.latest[key] = self.former.latest[key]
        return key in self.fits

    def grow(self, key: Key, now: Fit, candidate: Candidate) -> None:
        """Fit a model that has a candidate more than `now`."""
        self.fits[key], self.latest[key] = grown(self.evidence, now, candidate, self.tick), candidate.suspect

    def offer(self, key: Key, fit: Fit) -> None:
        """A fit of some model, kept if it is better than the one known."""
        if not self.known(key) or fit.chi2 < self.fits[key].chi2:
            self.fits[key] = fit
            self.sure.discard(key)
            self.stood.discard(key)

    def _astray(self, state: Iterable[Suspect], now: Fit) -> Fit:
        """The fit, or one from other shapes where that is better: far from the truth chi^2 may be flat in them."""
        for suspect in state:
            tries = list(suspect.grid(suspect.without(now.model)))
            if len(tries) < 2:
                continue
            if not scannable(suspect, tries):  # a strong effect's shapes show only at that strength
                best = likeliest(self.evidence, now, tries)
                look = nudged(self.evidence, now, now.model.replace(best)) if best else None
                now = self._or_better(now, look) if look else now
            if suspect == self.latest.get(frozenset(state)):
                continue
            reduced = self.without(now, suspect)
            contest = Contest.of(self.evidence, reduced, self.tick, [suspect])
            candidate = contest.sharper(self.evidence, contest.ranking()[0])
            if contest.chi2() - candidate.gain < now.chi2 - GAINED:
                now = self._or_better(now, grown(self.evidence, reduced, candidate, self.tick))
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
            now = self.without(now, suspect)
        return now

    def without(self, now: Fit, suspect: Suspect) -> Fit:
        """A fit less a suspect, all else as it was; where that has no motion, nearer to the base."""
        reduced = now.reduced(suspect.without(now.model), suspect.strengths + suspect.shapes)
        try:
            return dataclasses.replace(reduced, residuals=self.evidence.left(reduced.model, reduced.launches))
        except ValueError:  # two effects held the ball at rest together: begin without either
            base = self.base
            gone = [n for n in reduced.names if n not in base.names and not parameter_of(reduced.model, n).fixed]
            model = reduced.model.replace({n: base.model.value(n) for n in base.names} | dict.fromkeys(gone, 0.0))
            return linearised(self.evidence, model, reduced.names, base.launches)

    def price(self, state: Iterable[Suspect]) -> float:
        """chi^2 with what strengths and shapes cost."""
        return price(self.fits[frozenset(state)], self.base)

    def rivals(self, state: Collection[Suspect]) -> list[Fit]:
        """All models visited with as many suspects."""
        return [f for key, f in self.fits.items() if len(key) == len(state)]
