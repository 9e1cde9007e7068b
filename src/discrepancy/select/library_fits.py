"""Models of the library, each fitted when it is first asked for, with the score tests beside it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import suppress

import numpy as np

from discrepancy.fitting.gauss_newton import choose_most_likely, minimise_chi2, take_one_step
from discrepancy.fitting.jacobian import differentiate_all, linearise, zero_unidentifiable_shapes
from discrepancy.fitting.model_fit import ModelFit, WhitenedClips
from discrepancy.fitting.parameters import Candidate, acts_on_picture, find_parameter, parameter_limits
from discrepancy.fitting.predict import predict_tracks
from discrepancy.fitting.shape_scan import can_scan
from discrepancy.fitting.significance import chi2_to_sigma
from discrepancy.fitting.stretch_starts import leave_local_minima
from discrepancy.policy import current_policy
from discrepancy.select.model_cost import compute_cost
from discrepancy.select.score_test import CandidateScore, ScoreTests
from discrepancy.time_left import in_stage
from synthcam.model import without_mutual_push

State = tuple[Candidate, ...]
Key = frozenset[Candidate]

MIN_USEFUL_CHI2 = 2.0  # less is not worth another fit
SCORE_ERROR_CHI2 = 15.0  # a score test is only of first order: its chi^2 may be wrong by so much


class LibraryFits:
    """The fits of library models to some clips. A model is the set of candidates that it adds to the base.

    Base parameters that the base holds at zero are candidates too.
    """

    def __init__(self, evidence: WhitenedClips, base: ModelFit) -> None:
        self.evidence = evidence
        self.fits: dict[Key, ModelFit] = {frozenset(): base}  # all models that were fitted, by the candidates in them
        self.tests: dict[Key, ScoreTests] = {}  # each holds the derivatives of every candidate
        self.large: Key | None = None  # the model whose tests take much memory: dropped before others are made
        self.done: set[Key] = {frozenset()}  # models whose fits have converged
        self.latest: dict[Key, Candidate] = {}  # the candidate that was added after a scan of its shape parameters
        tests = self.score_tests(())
        self.ranking = tests.ranking()  # all candidates beside the base, most significant first
        self.trials_factors = tests.trials_factors  # of the shape parameters of each candidate, by its name
        # the sigma that a claim needs, set before anything is searched
        self.required_sigma = max(tests.claim(), current_policy().min_claim_sigma)
        # effects that move the tracks only as the base fit's own parameters can. They do not count as rivals, even if
        # they seem to be rivals beside another effect.
        self.absorbed = frozenset(c.effect for c in self.ranking if c.absorbed)

    @property
    def base(self) -> ModelFit:
        """The fit without any candidate."""
        return self.fits[frozenset()]

    @in_stage("search")
    def score_tests(self, state: Sequence[Candidate], max_numbers: int = 8_000_000) -> ScoreTests:
        """The score tests of all candidates beside a model. At most `max_numbers` stay in memory beside the last."""
        fit, key = self.fit(state), frozenset(state)
        if key not in self.tests:
            if self.large is not None:
                self.tests.pop(self.large, None)
                self.large = None
            tests = ScoreTests.of(self.evidence, fit)
            if tests.numbers + sum(t.numbers for t in self.tests.values()) > max_numbers:
                self.large = key
            self.tests[key] = tests
        return self.tests[key]

    def _keep(self, key: Key, fit: ModelFit) -> None:
        """Keep a fit instead of an earlier one, and forget the score tests of the earlier one."""
        self.fits[key] = fit
        self.tests.pop(key, None)

    @in_stage("search")
    def fit(self, state: Iterable[Candidate]) -> ModelFit:
        """The best fit of a model."""
        ordered = _in_order(state) if isinstance(state, frozenset) else tuple(state)
        key = frozenset(ordered)
        if key not in self.fits:
            self._keep(key, self._start_from_larger(key))
        if key not in self.done:
            fit = leave_local_minima(self.evidence, self._descend(ordered))
            self._keep(key, self._escape_local_minimum(ordered, fit))
            self.done.add(key)
        return self.fits[key]

    def fit_exactly(self, state: Sequence[Candidate]) -> ModelFit:
        """Fit as `fit` does, with derivatives that include a force between the balls: errors need them exact."""
        fit, key = self.fit(state), frozenset(state)
        if without_mutual_push(fit.model).effects != fit.model.effects:
            exact = linearise(self.evidence, fit.model, fit.names, fit.launches, exact=True)
            self.tests[key] = dataclasses.replace(self.score_tests(state), fit=exact)
            self.fits[key] = exact
        return self.fits[key]

    @in_stage("search")
    def extend(self, key: Key, fit: ModelFit, scored: CandidateScore, slack: float = 30.0) -> None:
        """Fit and keep the model of `key`, which is the model of `fit` with the scored candidate added.

        The fit is compared with the best model of as many candidates. It ends early if it cannot come within `slack` of
        that model in chi^2, or within SCORE_ERROR_CHI2 in cost. The cost of its freedom is that at the start of each
        descent.
        """
        rivals = self.rivals(key)
        useful_chi2 = min((f.chi2 for f in rivals), default=math.inf) + slack
        useful_cost = min((compute_cost(f, self.base) for f in rivals), default=math.inf) + SCORE_ERROR_CHI2

        def find_useful_chi2(start: ModelFit) -> float:
            return min(useful_chi2, useful_cost - (compute_cost(start, self.base) - start.chi2))

        self._keep(key, fit_with_candidate(self.evidence, fit, scored, useful_chi2=find_useful_chi2))
        self.done.discard(key)
        self.latest[key] = scored.candidate

    def needs_fit(self, key: Key, part: ModelFit) -> bool:
        """Tell if a model was never fitted, or fits worse than `part`, the fit of a model that it contains."""
        return key not in self.fits or self.fits[key].chi2 > part.chi2 + MIN_USEFUL_CHI2

    def improve_part(self, state: State, candidate: Candidate) -> None:
        """Fit the model without one candidate again, if the fit of `state` shows that its fit is not the best.

        That fit stopped at a local minimum if chi^2 is lower where `state` ends, less the candidate. Else the candidate
        would seem to explain the difference.
        """
        key, fit = frozenset(state) - {candidate}, self.fit(state)
        if key in self.fits and (reduced := self.remove(fit, candidate)).chi2 < self.fits[key].chi2 - MIN_USEFUL_CHI2:
            self.offer(key, reduced)
            self.fit(_in_order(key))

    def offer(self, key: Key, fit: ModelFit) -> None:
        """Keep a fit of the model of `key` if it is better than a known one; `fit` lets it converge later."""
        known = self.fits.get(key)
        if known is None or fit.chi2 < known.chi2:
            self._keep(key, fit)
            self.done.discard(key)

    def _descend(self, state: State) -> ModelFit:
        """Minimise chi^2 of a model from its known fit; if a model that it contains fits better, from that one as well.

        The known fit may begin where launches and other effects compensate for a strong effect that was removed. From
        there it can end at a local minimum.
        """
        key = frozenset(state)
        found = minimise_chi2(self.evidence, self.fits[key])
        part = min((k for k in self.fits if k < key), key=lambda k: (self.fits[k].chi2, len(k)), default=key)
        if part == key or found.chi2 <= self.fits[part].chi2 + MIN_USEFUL_CHI2:
            return found
        added = [candidate for candidate in state if candidate not in part]
        model = self.fits[part].model.replace(
            {name: found.model.value(name) for candidate in added for name in candidate.shapes}
            | {name: self.fits[part].model.value(name) for candidate in added for name in candidate.strengths}
        )
        with suppress(ValueError):  # the model has no motion there
            start = linearise(self.evidence, model, found.names, self.fits[part].launches)
            return min(found, minimise_chi2(self.evidence, start), key=lambda fit: fit.chi2)
        return found

    def _escape_local_minimum(self, state: State, fit: ModelFit) -> ModelFit:
        """Return the fit, or a better one from other shape parameters: chi^2 may have several minima."""
        for candidate in state:
            tries = list(candidate.grid(candidate.remove_from(fit.model)))
            if len(tries) < 2:
                continue
            if not can_scan(candidate, tries):  # a strong effect's shape parameters show only at that strength
                best = choose_most_likely(self.evidence, fit, tries)
                other = take_one_step(self.evidence, fit, fit.model.replace(best)) if best else None
                fit = self._take_better(fit, other) if other else fit
            if candidate == self.latest.get(frozenset(state)):
                continue
            reduced = self.remove(fit, candidate)
            tests = ScoreTests.of(self.evidence, reduced, [candidate])
            scored = tests.sharper(self.evidence, tests.ranking()[0])
            if tests.chi2() - scored.gain < fit.chi2 - MIN_USEFUL_CHI2:
                fit = self._take_better(fit, fit_with_candidate(self.evidence, reduced, scored))
        return fit

    def _take_better(self, fit: ModelFit, other: ModelFit) -> ModelFit:
        """Return the better of the two fits, after the other has converged."""
        if other.chi2 >= fit.chi2:
            return fit
        return min(fit, minimise_chi2(self.evidence, other), key=lambda f: f.chi2)

    def _start_from_larger(self, key: Key) -> ModelFit:
        """Start a model from the smallest fitted model that contains it, less the effects that it does not have."""
        larger = min((k for k in self.fits if k > key), key=len)
        fit = self.fits[larger]
        for candidate in _in_order(larger - key):
            fit = self.remove(fit, candidate)
        return fit

    def remove(self, fit: ModelFit, candidate: Candidate) -> ModelFit:
        """Remove a candidate from a fit; all other parameters and the launches stay. Nothing is fitted again.

        If that model has no motion from these launches, the base fit gives its parameters and launches.
        """
        reduced = fit.drop(candidate.remove_from(fit.model), candidate.strengths + candidate.shapes)
        try:
            residuals = self.evidence.whitened_residuals(reduced.model, reduced.launches)
            return dataclasses.replace(reduced, residuals=residuals)
        except ValueError:  # two effects held the ball at rest together: begin without either
            base = self.base
            gone = [n for n in reduced.names if n not in base.names and not find_parameter(reduced.model, n).fixed]
            model = reduced.model.replace({n: base.model.value(n) for n in base.names} | dict.fromkeys(gone, 0.0))
            return linearise(self.evidence, model, reduced.names, base.launches)

    def cost_of(self, state: Iterable[Candidate]) -> float:
        """The chi^2 of a fitted model plus the cost of its strengths and shapes (`model_cost.compute_cost`)."""
        return compute_cost(self.fits[frozenset(state)], self.base)

    def rivals(self, state: Collection[Candidate]) -> list[ModelFit]:
        """The fits of all models that have as many candidates as this one."""
        return [f for key, f in self.fits.items() if len(key) == len(state)]

    def convert_to_sigma(self, chi2: float, candidate: Candidate) -> float:
        """The sigma of a chi^2 that a candidate explains, corrected by its trials factor."""
        return chi2_to_sigma(chi2, len(candidate.strengths), self.trials_factors.get(candidate.name, 1.0))

    def correct_for_trials(self, effect: str, sigma: float) -> float:
        """Sigma of an effect, corrected by the trials factor of its shape parameters."""
        return math.sqrt(max(sigma**2 - 2 * math.log(self.trials_factors.get(effect, 1.0)), 0.0))


def _in_order(candidates: Iterable[Candidate]) -> State:
    """Candidates by name: the order of a set differs between runs, and the last digits of a fit with it."""
    return tuple(sorted(candidates, key=lambda c: c.name))


def fit_with_candidate(
    evidence: WhitenedClips,
    fit: ModelFit,
    scored: CandidateScore,
    min_share: float = 0.5,
    useful_chi2: Callable[[ModelFit], float] = lambda start: math.inf,
) -> ModelFit:
    """Fit a model of the library with one candidate more: its strengths, then its shape parameters, with all others.

    The descent starts where the score test leads. If that gains less than `min_share` of what the test promised, the
    fit starts from realistic sizes as well. For a base parameter held at zero it starts from realistic sizes only.
    The result is the best of those descents, roughly converged; `fit` itself if none can start. useful_chi2: of a
    descent, from its start; see `minimise_chi2`.
    """

    def descend(start: ModelFit) -> ModelFit:
        return minimise_chi2(evidence, start, rough=True, useful_chi2=useful_chi2(start))

    tries = [] if scored.candidate.kind is None else [_descend_from_score(evidence, fit, scored, descend)]
    if not tries or tries[0].chi2 > fit.chi2 - min_share * scored.gain:
        tries += [descend(start) for start in _realistic_starts(evidence, fit, scored)]
    return min(tries, key=lambda f: f.chi2, default=fit)


def _descend_from_score(
    evidence: WhitenedClips, fit: ModelFit, scored: CandidateScore, descend: Callable[[ModelFit], ModelFit]
) -> ModelFit:
    candidate, model = scored.candidate, fit.model.replace(scored.shapes)
    strong = descend(fit.extend(model, scored.strengths, scored.columns))
    if not candidate.shapes or all(strong.model.value(s) == 0 for s in scored.strengths):
        return strong
    here = predict_tracks(strong.model, strong.launches, evidence.clips)
    slopes = differentiate_all(strong.model, strong.launches, evidence.clips, candidate.shapes, here)
    columns = evidence.whiten([np.stack([s[k] for s in slopes], axis=-1) for k in range(len(here))])
    columns = zero_unidentifiable_shapes(strong.model, candidate.shapes, columns)
    return descend(strong.extend(strong.model, candidate.shapes, columns))


def _realistic_starts(
    evidence: WhitenedClips,
    fit: ModelFit,
    scored: CandidateScore,
    shares: Sequence[float] = (0.1, 0.3, 1.0),
    count: int = 2,
) -> list[ModelFit]:
    """The best starts at shares of a realistic strength, where tracks are not linear and no score test leads."""
    candidate = scored.candidate
    if len(candidate.strengths) > 1:
        return []
    name = candidate.strengths[0]
    size, (low, high) = find_parameter(fit.model, name).typical, parameter_limits(fit.model, name)
    begun: list[ModelFit] = []
    grid, policy = list(candidate.grid(fit.model)), current_policy()
    in_proportion = candidate.kind is not None and acts_on_picture(candidate.kind)
    max_shapes = policy.max_linear_shapes_tried if in_proportion else policy.max_shapes_tried
    if len(grid) > max_shapes:
        estimates = ScoreTests.of(evidence, fit, only=[candidate]).estimates()
        grid = [shapes for shapes, _, _ in sorted(estimates, key=lambda trial: -trial[1])[:max_shapes]]
    for shapes in grid:
        for value in (sign * share * size for share in shares for sign in (1, -1)):
            if low <= value <= high:
                start = take_one_step(evidence, fit, fit.model.replace({**shapes, name: value}))
                begun += [start] if start else []
    best = sorted(begun, key=lambda f: f.chi2)[:count]
    names = (*fit.names, name, *candidate.shapes)
    return [linearise(evidence, f.model, names, f.launches) for f in best]
