"""The models that a search has fitted, by the candidates in them, and the score tests of all others beside each."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Iterable, Sequence

from discrepancy.fitting.gauss_newton import choose_most_likely, linearise, minimise_chi2, take_one_step
from discrepancy.fitting.model_fit import ModelFit, WhitenedClips
from discrepancy.fitting.parameters import Candidate, find_parameter
from discrepancy.fitting.shape_scan import can_scan
from discrepancy.select.extend import fit_with_candidate
from discrepancy.select.model_cost import cost_of
from discrepancy.select.profile_errors import GAINED
from discrepancy.select.score_test import ScoreTests
from discrepancy.select.scored import CandidateScore
from synthcam.dynamics.solve import without_mutual_push

Key = frozenset[Candidate]
KEPT = 8_000_000  # numbers in all contests kept beside the last


class FitStore:
    """A cache of fits: each model is fitted when it is first asked for.

    Parameters
    ----------
    evidence : Evidence
        The clips to fit, and their noise.
    base : Fit
        The fit without any candidate.
    progress : callable
        Told of progress.
    """

    def __init__(self, evidence: WhitenedClips, base: ModelFit, progress: Callable[[], None]) -> None:
        self.evidence, self.progress = evidence, progress
        self.fits: dict[Key, ModelFit] = {frozenset(): base}
        self.tests: dict[Key, ScoreTests] = {}  # each holds every candidate's derivatives
        self.large: Key | None = None  # whose tests are forgotten before there are others
        self.done: set[Key] = {frozenset()}  # whose fits are settled to the end
        self.latest: dict[Key, Candidate] = {}  # added after a scan of all its shape parameters

    @property
    def base(self) -> ModelFit:
        return self.fits[frozenset()]

    def score_tests(self, state: Sequence[Candidate]) -> ScoreTests:
        """The score tests of all candidates beside those of a model."""
        fit, key = self.settled(state), frozenset(state)
        if key not in self.tests:
            self.forget_large()
            tests = ScoreTests.of(self.evidence, fit, self.progress)
            if tests.numbers + sum(t.numbers for t in self.tests.values()) > KEPT:
                self.large = key
            self.tests[key] = tests
        return self.tests[key]

    def forget_large(self) -> None:
        """Forget tests that take much memory."""
        if self.large is not None:
            self.tests.pop(self.large, None)
            self.large = None

    def _keep(self, key: Key, fit: ModelFit) -> None:
        """Keep a fit in place of an earlier one, whose score tests are then those of another."""
        self.fits[key] = fit
        self.tests.pop(key, None)

    def settled(self, state: Sequence[Candidate]) -> ModelFit:
        """The best fit of a model."""
        key = frozenset(state)
        if key not in self.fits:
            self._keep(key, self._reduced(state))
        if key not in self.done:
            self._keep(key, self._astray(state, minimise_chi2(self.evidence, self.fits[key], self.progress)))
            self.done.add(key)
        return self.fits[key]

    def exact(self, state: Sequence[Candidate]) -> ModelFit:
        """`settled`, with derivatives that count the push between balls where there is one: errors need them exact."""
        fit, key = self.settled(state), frozenset(state)
        if without_mutual_push(fit.model).effects != fit.model.effects:
            exact = linearise(self.evidence, fit.model, fit.names, fit.launches, exact=True)
            self.tests[key] = dataclasses.replace(self.score_tests(state), fit=exact)
            self.fits[key] = exact
        return self.fits[key]

    def extend(self, key: Key, fit: ModelFit, scored: CandidateScore) -> None:
        """Fit and keep the model of `key`: that of `fit` with the scored candidate added."""
        self._keep(key, fit_with_candidate(self.evidence, fit, scored, self.progress))
        self.latest[key] = scored.candidate

    def offer(self, key: Key, fit: ModelFit) -> None:
        """Keep a fit of the model of `key` where none is known or it is better; it is to be settled when asked for."""
        known = self.fits.get(key)
        if known is None or fit.chi2 < known.chi2:
            self._keep(key, fit)
            self.done.discard(key)

    def _astray(self, state: Iterable[Candidate], fit: ModelFit) -> ModelFit:
        """The fit, or a better one from other shape parameters: away from the truth chi^2 may have other minima."""
        for candidate in state:
            tries = list(candidate.grid(candidate.remove_from(fit.model)))
            if len(tries) < 2:
                continue
            if not can_scan(candidate, tries):  # a strong effect's shape parameters show only at that strength
                best = choose_most_likely(self.evidence, fit, tries)
                other = take_one_step(self.evidence, fit, fit.model.replace(best)) if best else None
                fit = self._or_better(fit, other) if other else fit
            if candidate == self.latest.get(frozenset(state)):
                continue
            reduced = self.without(fit, candidate)
            tests = ScoreTests.of(self.evidence, reduced, self.progress, [candidate])
            scored = tests.sharper(self.evidence, tests.ranking()[0])
            if tests.chi2() - scored.gain < fit.chi2 - GAINED:
                fit = self._or_better(fit, fit_with_candidate(self.evidence, reduced, scored, self.progress))
        return fit

    def _or_better(self, fit: ModelFit, other: ModelFit) -> ModelFit:
        """The other fit, settled, where it is better."""
        if other.chi2 >= fit.chi2:
            return fit
        return min(fit, minimise_chi2(self.evidence, other, self.progress), key=lambda f: f.chi2)

    def _reduced(self, state: Sequence[Candidate]) -> ModelFit:
        """A start for a model: the smallest fitted model that contains it, less what it does not have."""
        larger = min((k for k in self.fits if k > frozenset(state)), key=len)
        fit = self.fits[larger]
        for candidate in larger - frozenset(state):
            fit = self.without(fit, candidate)
        return fit

    def without(self, fit: ModelFit, candidate: Candidate) -> ModelFit:
        """Take a candidate out of a fit, all other parameters and the launches as they were; nothing is fitted again.

        Where that model has no motion from these launches, the base's parameters and launches take their place.
        """
        reduced = fit.drop(candidate.remove_from(fit.model), candidate.strengths + candidate.shapes)
        try:
            return dataclasses.replace(
                reduced, residuals=self.evidence.whitened_residuals(reduced.model, reduced.launches)
            )
        except ValueError:  # two effects held the ball at rest together: begin without either
            base = self.base
            gone = [n for n in reduced.names if n not in base.names and not find_parameter(reduced.model, n).fixed]
            model = reduced.model.replace({n: base.model.value(n) for n in base.names} | dict.fromkeys(gone, 0.0))
            return linearise(self.evidence, model, reduced.names, base.launches)

    def cost_of(self, state: Iterable[Candidate]) -> float:
        """chi^2 of a fitted model plus the cost of its strengths and shape parameters; see `model_cost.cost_of`."""
        return cost_of(self.fits[frozenset(state)], self.base)

    def rivals(self, state: Collection[Candidate]) -> list[ModelFit]:
        """The fits of all models that have as many candidates as this one."""
        return [f for key, f in self.fits.items() if len(key) == len(state)]
