"""The models that a search has fitted, by the suspects in them, and the score tests of all others beside each."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Iterable, Sequence

from discrepancy.fitting.gauss_newton import likeliest, linearised, nudged, settle
from discrepancy.fitting.model_fit import Evidence, Fit
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


class FitStore:
    """A cache of fits: each model is fitted when it is first asked for.

    Parameters
    ----------
    evidence : Evidence
        The clips to fit, and their noise.
    base : Fit
        The fit without any suspect.
    tick : callable
        Told of progress.
    previous : FitStore, optional
        Of the same clips with another noise. Where that is much alike, models are fitted from where they stood there.
    """

    def __init__(
        self, evidence: Evidence, base: Fit, tick: Callable[[], None], previous: FitStore | None = None
    ) -> None:
        self.evidence, self.tick, self.previous = evidence, tick, None
        if previous:
            previous.forget_large()
            if 1 / ALIKE < base.chi2 / previous.base.chi2 < ALIKE:
                self.previous = previous
        self.fits: dict[Key, Fit] = {frozenset(): base}
        self.tests: dict[Key, Contest] = {}  # each holds every suspect's derivatives
        self.large: Key | None = None  # whose tests are forgotten before there are others
        self.done: set[Key] = {frozenset()}  # whose fits are settled to the end
        self.done_before: set[Key] = {frozenset()} if self.previous else set()  # in the previous store
        self.latest: dict[Key, Suspect] = {}  # added with a look at all its shapes

    @property
    def base(self) -> Fit:
        return self.fits[frozenset()]

    def contest(self, state: Sequence[Suspect]) -> Contest:
        """The score tests of all suspects beside those of a model."""
        now, key = self.settled(state), frozenset(state)
        if key not in self.tests:
            self.forget_large()
            tests = self._tested(now, key)
            if tests.numbers + sum(t.numbers for t in self.tests.values()) > KEPT:
                self.large = key
            self.tests[key] = tests
        return self.tests[key]

    def forget_previous(self) -> None:
        """Forget the previous store, once its models are not to be gone on from."""
        self.previous = None

    def forget_large(self) -> None:
        """Forget tests that take much memory."""
        if self.large is not None:
            self.tests.pop(self.large, None)
            self.large = None

    def _tested(self, now: Fit, key: Key) -> Contest:
        known = self.previous.tests.pop(key, None) if self.previous and key in self.done_before else None
        if self.previous and known:
            return known.seen_by(now, self.previous.evidence, self.evidence)
        return Contest.of(self.evidence, now, self.tick)

    def _keep(self, key: Key, fit: Fit) -> None:
        """Keep a fit in place of an earlier one, whose score tests are then those of another."""
        self.fits[key] = fit
        self.tests.pop(key, None)

    def settled(self, state: Sequence[Suspect]) -> Fit:
        """The best fit of a model."""
        key = frozenset(state)
        if not self.known(key):
            self._keep(key, self._reduced(state))
        if key not in self.done:
            now = settle(self.evidence, self.fits[key], self.tick)
            self._keep(key, now if key in self.done_before else self._astray(state, now))
            self.done.add(key)
        return self.fits[key]

    def exact(self, state: Sequence[Suspect]) -> Fit:
        """`settled`, all derivatives with the push between balls, where there is one: errors are read off them."""
        now, key = self.settled(state), frozenset(state)
        if uncoupled(now.model).effects != now.model.effects:
            exact = linearised(self.evidence, now.model, now.names, now.launches, exact=True)
            self.tests[key] = dataclasses.replace(self.contest(state), now=exact)
            self.fits[key] = exact
        return self.fits[key]

    def known(self, key: frozenset[Suspect]) -> bool:
        """Whether a model was fitted before, here or in the previous store."""
        before = self.previous
        if key not in self.fits and before and key in before.fits:
            now = before.fits[key].seen_by(before.evidence, self.evidence)
            self._keep(key, settle(self.evidence, now, self.tick, rough=True))
            if key in before.done:
                self.done_before.add(key)
            if key in before.latest:
                self.latest[key] = before.latest[key]
        return key in self.fits

    def extend(self, key: Key, now: Fit, candidate: Candidate) -> None:
        """Fit a model that has a candidate more than `now`."""
        self._keep(key, grown(self.evidence, now, candidate, self.tick))
        self.latest[key] = candidate.suspect

    def offer(self, key: Key, fit: Fit) -> None:
        """A fit of some model, kept if it is better than the one known."""
        if not self.known(key) or fit.chi2 < self.fits[key].chi2:
            self._keep(key, fit)
            self.done.discard(key)
            self.done_before.discard(key)

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
        return min(now, settle(self.evidence, other, self.tick), key=lambda f: f.chi2)

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
