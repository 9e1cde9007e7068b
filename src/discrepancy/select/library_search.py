"""Search the library for missing effects: add, drop and exchange effects until no model is better."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.fitting.gauss_newton import choose_most_likely, minimise_chi2, take_one_step
from discrepancy.fitting.jacobian import differentiate_all
from discrepancy.fitting.linearise import linearise, zero_unidentifiable_shapes
from discrepancy.fitting.model_fit import ModelFit, WhitenedClips
from discrepancy.fitting.parameters import Candidate, candidates_by_name, find_parameter, parameter_limits
from discrepancy.fitting.predict import predict_tracks
from discrepancy.fitting.shape_scan import can_scan
from discrepancy.fitting.significance import chi2_to_sigma, closes_too_little
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.policy import current_policy
from discrepancy.select.effect_claim import EffectClaim, find_similar_pairs, profile_std, shape_error
from discrepancy.select.model_cost import cost_of
from discrepancy.select.score_test import CandidateScore, ScoreTests, largest_cosine
from synthcam.dynamics.solve import without_mutual_push
from synthcam.model import Model

State = tuple[Candidate, ...]
Key = frozenset[Candidate]
SCORE_ERROR_CHI2 = 15.0  # a score test is only of first order: its chi^2 may be wrong by so much,
SCORE_ERROR_SHARE = 0.2  # plus this share of the chi^2 that the effect explains
MAX_EXCHANGES = 4  # rivals of one effect that are fitted instead of it


@dataclass(frozen=True)
class InterruptedSearch:
    """The state of a search when its time, s, was over: the effects that fit best and their chi^2 per point."""

    effects: tuple[str, ...]
    chi2: float
    seconds: float


@dataclass(frozen=True)
class Selection:
    """The effects and the free law that a search selected, with the numbers behind the choice.

    Attributes
    ----------
    state : tuple of Candidate
        The effects of the library.
    base, best : ModelFit
        The fits without any effect and with these.
    ranking : tuple of CandidateScore
        The score tests of all candidates beside the base, most significant first.
    required_sigma : float
        The sigma that a claim needs.
    trials_factors : mapping of str to float
        The trials factor of the shape parameters of each candidate, by its name.
    free_law : FittedLaw or None
        The free law that explains more than the library.
    near_law : FittedLaw or None
        A free law that explains nearly as much as the library's best model.
    interrupted : InterruptedSearch or None
        Set if the time was over; nothing is then selected.
    """

    state: State
    base: ModelFit
    best: ModelFit
    ranking: tuple[CandidateScore, ...]
    required_sigma: float
    trials_factors: Mapping[str, float]
    free_law: FittedLaw | None = None
    near_law: FittedLaw | None = None
    interrupted: InterruptedSearch | None = None

    @property
    def is_empty(self) -> bool:
        """True if the search selected nothing beside the base model."""
        return not (self.state or self.free_law)

    @property
    def joint_fit(self) -> ModelFit:
        """The fit with everything that was selected, a free law's coefficients among its parameters."""
        return self.free_law.joint_fit if self.free_law else self.best

    @property
    def promising(self) -> bool:
        """True if a score test beside the base is as significant as a claim must be."""
        return any(c.sigma > self.required_sigma for c in self.ranking[:1])

    def correct_for_trials(self, effect: str, sigma: float) -> float:
        """Sigma of an effect, corrected by the trials factor of its shape parameters."""
        return math.sqrt(max(sigma**2 - 2 * math.log(self.trials_factors.get(effect, 1.0)), 0.0))

    def explained_clips(self, clips: tuple[MeasuredCollision, ...]) -> tuple[MeasuredCollision, ...]:
        """The clips, less the displacements of a free law that no effect can hold."""
        return self.free_law.evidence.clips if self.free_law else clips


class LibrarySearch:
    """A stepwise search over models of the library, with each model fitted when it is first asked for.

    This is forward selection with exchange. The search adds a significant candidate, then drops or exchanges effects
    while the model improves. Base parameters that the base holds at zero are candidates too. The search compares models
    by `model_cost.cost_of`.

    Parameters
    ----------
    evidence : WhitenedClips
        The clips to fit, whitened by their noise.
    base : ModelFit
        The fit without any candidate.
    progress : callable
        Called now and then.

    Attributes
    ----------
    fits : dict of frozenset of Candidate to ModelFit
        All models that were fitted, by the candidates in them.
    ranking : tuple of CandidateScore
        The score tests of all candidates beside the base.
    required_sigma : float
        The sigma that a claim needs, set before anything is searched.
    trials_factors : mapping of str to float
        As of `Selection`.
    absorbed : frozenset of str
        Effects that move the tracks only as the base fit's own parameters can. They do not count as rivals, even if
        they seem to be rivals beside another effect.
    """

    def __init__(self, evidence: WhitenedClips, base: ModelFit, progress: Callable[[], None]) -> None:
        self.evidence, self.progress = evidence, progress
        self.fits: dict[Key, ModelFit] = {frozenset(): base}
        self.tests: dict[Key, ScoreTests] = {}  # each holds the derivatives of every candidate
        self.large: Key | None = None  # the model whose tests take much memory: dropped before others are made
        self.done: set[Key] = {frozenset()}  # models whose fits have converged
        self.latest: dict[Key, Candidate] = {}  # the candidate that was added after a scan of its shape parameters
        tests = self.score_tests(())
        self.ranking, self.trials_factors = tests.ranking(), tests.trials_factors
        self.required_sigma = max(tests.claim(), current_policy().min_claim_sigma)
        self.absorbed = frozenset(c.effect for c in self.ranking if c.absorbed)

    @property
    def base(self) -> ModelFit:
        """The fit without any candidate."""
        return self.fits[frozenset()]

    def score_tests(self, state: Sequence[Candidate], max_numbers: int = 8_000_000) -> ScoreTests:
        """The score tests of all candidates beside a model. At most `max_numbers` stay in memory beside the last."""
        fit, key = self.fit(state), frozenset(state)
        if key not in self.tests:
            self.forget_large()
            tests = ScoreTests.of(self.evidence, fit, self.progress)
            if tests.numbers + sum(t.numbers for t in self.tests.values()) > max_numbers:
                self.large = key
            self.tests[key] = tests
        return self.tests[key]

    def forget_large(self) -> None:
        """Forget tests that take much memory."""
        if self.large is not None:
            self.tests.pop(self.large, None)
            self.large = None

    def _keep(self, key: Key, fit: ModelFit) -> None:
        """Keep a fit instead of an earlier one, and forget the score tests of the earlier one."""
        self.fits[key] = fit
        self.tests.pop(key, None)

    def fit(self, state: Sequence[Candidate]) -> ModelFit:
        """The best fit of a model."""
        key = frozenset(state)
        if key not in self.fits:
            self._keep(key, self._start_from_larger(state))
        if key not in self.done:
            fit = minimise_chi2(self.evidence, self.fits[key], self.progress)
            self._keep(key, self._escape_local_minimum(state, fit))
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

    def extend(self, key: Key, fit: ModelFit, scored: CandidateScore) -> None:
        """Fit and keep the model of `key`, which is the model of `fit` with the scored candidate added."""
        self._keep(key, fit_with_candidate(self.evidence, fit, scored, self.progress))
        self.latest[key] = scored.candidate

    def offer(self, key: Key, fit: ModelFit) -> None:
        """Keep a fit of the model of `key` if it is better than a known one; `fit` lets it converge later."""
        known = self.fits.get(key)
        if known is None or fit.chi2 < known.chi2:
            self._keep(key, fit)
            self.done.discard(key)

    def _escape_local_minimum(self, state: Iterable[Candidate], fit: ModelFit) -> ModelFit:
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
            tests = ScoreTests.of(self.evidence, reduced, self.progress, [candidate])
            scored = tests.sharper(self.evidence, tests.ranking()[0])
            if tests.chi2() - scored.gain < fit.chi2 - 2.0:  # less is not worth another fit
                fit = self._take_better(fit, fit_with_candidate(self.evidence, reduced, scored, self.progress))
        return fit

    def _take_better(self, fit: ModelFit, other: ModelFit) -> ModelFit:
        """Return the better of the two fits, after the other has converged."""
        if other.chi2 >= fit.chi2:
            return fit
        return min(fit, minimise_chi2(self.evidence, other, self.progress), key=lambda f: f.chi2)

    def _start_from_larger(self, state: Sequence[Candidate]) -> ModelFit:
        """Start a model from the smallest fitted model that contains it, less the effects that it does not have."""
        larger = min((k for k in self.fits if k > frozenset(state)), key=len)
        fit = self.fits[larger]
        for candidate in larger - frozenset(state):
            fit = self.remove(fit, candidate)
        return fit

    def remove(self, fit: ModelFit, candidate: Candidate) -> ModelFit:
        """Remove a candidate from a fit; all other parameters and the launches stay. Nothing is fitted again.

        If that model has no motion from these launches, the base fit gives its parameters and launches.
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
        """The chi^2 of a fitted model plus the cost of its strengths and shape parameters (`model_cost.cost_of`)."""
        return cost_of(self.fits[frozenset(state)], self.base)

    def rivals(self, state: Collection[Candidate]) -> list[ModelFit]:
        """The fits of all models that have as many candidates as this one."""
        return [f for key, f in self.fits.items() if len(key) == len(state)]

    def states(self, state: State = ()) -> Iterator[State]:
        """Yield better and better models until no candidate is significant.

        Each model has one effect more than the one before, or other effects. The search also ends at the largest number
        of effects, and before a step that leads back to an earlier model.
        """
        while len(state) < current_policy().max_effects:
            winner = self._choose_addition(state, self.score_tests(state))
            if winner is None:
                return
            more = self._improve((*state, winner))
            if len(more) <= len(state) and self.cost_of(more) >= self.cost_of(state):  # back to an earlier model
                return
            state = more
            yield state

    def select(self, state: State) -> Selection:
        """The selection that consists of these effects."""
        base = self.fit(())
        return Selection(state, base, self.fit_exactly(state), self.ranking, self.required_sigma, self.trials_factors)

    def search_from(self, found: Selection, effects: Iterable[str], model: Model) -> Selection | None:
        """Search again from other effects, and return the selection if it is better.

        Parameters
        ----------
        found : Selection
            The selection so far.
        effects : iterable of str
            Names of the effects to begin with.
        model : Model
            Their values to begin with.

        Returns
        -------
        Selection or None
            None unless it costs less than `found`; with more effects it must cost less by `rival_excluded_chi2`.
        """
        try:
            begun = self.start_from(effects, model)
        except ValueError:  # alone they have no motion
            return None
        again = self.select(self.finish(begun))
        less = cost_of(found.best, found.base) - cost_of(again.best, found.base)
        required = current_policy().rival_excluded_chi2 if len(again.state) > len(found.state) else 0.0
        return again if less > required else None

    def finish(self, begun: State) -> State:
        """Search on from a model to the last one; if none follows, drop the effects that are not significant."""
        state = [begun, *self.states(begun)][-1]
        return self._improve(state) if state == begun else state

    def drop(self, found: Selection, candidate: Candidate) -> Selection:
        """Drop an effect from a selection and fit everything else again."""
        return self.select(tuple(s for s in found.state if s != candidate))

    def exchange(self, found: Selection, candidate: Candidate, alias: str) -> Selection | None:
        """Exchange an effect of a selection for `alias`; None if that model was never fitted."""
        rest = frozenset(found.state) - {candidate}
        for key in list(self.fits):
            if len(key) == len(found.state) and key > rest and next(iter(key - rest)).name == alias:
                return self.select(tuple(next(iter(key - rest)) if s == candidate else s for s in found.state))
        return None

    def start_from(self, effects: Iterable[str], model: Model) -> State:
        """Fit these effects from a model's values, as a start for the search. Raises ValueError without a motion."""
        base = self.base
        known = candidates_by_name(model, base.model, base.names)
        state = tuple(known[effect] for effect in effects)
        names = (*base.names, *(n for s in state for n in s.strengths + s.shapes))
        begun = base.model.replace({n: model.value(n) for n in names})
        start = linearise(self.evidence, begun, names, base.launches)
        self.offer(frozenset(state), minimise_chi2(self.evidence, start, self.progress))
        return state

    def _improve(self, state: State) -> State:
        """Drop and exchange candidates until nothing is better, or a model comes up again."""
        before: set[frozenset[Candidate]] = set()
        while state:
            before.add(frozenset(state))
            better = self._improve_once(state, self.score_tests(state))
            if better is None or frozenset(better) in before:
                break
            state = better
        return state

    def claims(self, state: State) -> tuple[EffectClaim, ...]:
        """Each effect of a model with its values, errors, aliases and limits."""
        return tuple(self._describe(state, k, self.score_tests(state)) for k in range(len(state)))

    def undetectable(self, state: State) -> tuple[str, ...]:
        """Effects that these collisions cannot show beside those of a model, at any realistic size."""
        return tuple(c.effect for c in self.score_tests(state).ranking() if not c.identifiable)

    def _sigma(self, chi2: float, candidate: Candidate) -> float:
        """The sigma of a chi^2 that a candidate explains, to compare with `required_sigma`.

        It is corrected by the trials factor of the candidate's shape parameters.
        """
        return chi2_to_sigma(chi2, len(candidate.strengths), self.trials_factors.get(candidate.name, 1.0))

    def _choose_addition(self, state: State, tests: ScoreTests) -> Candidate | None:
        """Choose the candidate to add: of the leader and its rivals, the simplest that fits as well as the best.

        None if no candidate is significant, or if much more is missing than any candidate explains.
        """
        ranking = tests.leaders(self.required_sigma)
        if not ranking or ranking[0].sigma <= self.required_sigma:
            return None
        fit = tests.fit
        rivals = self._choose_contenders(tests, ranking)
        for c in rivals:
            key = frozenset({*state, c.candidate})
            if key not in self.fits:
                self.extend(key, fit, c)
        keys = sorted((frozenset({*state, c.candidate}) for c in rivals), key=self.cost_of)
        for key in keys:
            if self.cost_of(key) < self.cost_of(keys[0]) + SCORE_ERROR_CHI2:
                self.fit(tuple(key))
        added = {key: next(iter(key - frozenset(state))) for key in keys}
        significant = [k for k in keys if self._is_significant(fit, self.fits[k], added[k])]
        return added[self._simplest(significant)] if min(keys, key=self.cost_of) in significant else None

    def _is_significant(self, fit: ModelFit, more: ModelFit, candidate: Candidate) -> bool:
        """Tell if a candidate improves the fit by the sigma that a claim needs, and closes enough of the gap."""
        enough = self._sigma(fit.chi2 - more.chi2, candidate) > self.required_sigma
        return enough and not closes_too_little(
            fit.chi2 / fit.points, more.chi2 / more.points, current_policy().min_closed_share
        )

    def _simplest(self, keys: Collection[frozenset[Candidate]]) -> frozenset[Candidate]:
        """Choose the model with the fewest strengths, then shape parameters, among those as good as the best."""
        near = min(map(self.cost_of, keys)) + current_policy().rival_excluded_chi2

        def order(key: frozenset[Candidate]) -> tuple[int, int, float]:
            effects = [s for s in key if s.kind is not None]
            return sum(len(s.strengths) for s in effects), sum(len(s.shapes) for s in effects), self.cost_of(key)

        return min((k for k in keys if self.cost_of(k) <= near), key=order)

    def _choose_contenders(
        self, tests: ScoreTests, ranking: Sequence[CandidateScore], max_rivals: int = 8
    ) -> list[CandidateScore]:
        """Choose the candidates to fit: those that may explain as much as the leader, or have a similar signature.

        Their shape parameters are first refined between the grid values. At most `max_rivals` candidates remain.
        """
        evidence, least = self.evidence, ranking[0].gain / 2 - SCORE_ERROR_CHI2
        chosen = [tests.sharper(evidence, c) if c.gain > least else c for c in ranking if c.gain > 0]
        leader = max(chosen, key=lambda c: c.sigma)
        near = [
            c
            for c in chosen
            if c.gain > (1 - SCORE_ERROR_SHARE) * leader.gain - SCORE_ERROR_CHI2
            or largest_cosine(leader.signature, c.signature) > current_policy().alias_cosine
            or (c.candidate.kind is None and c.sigma > self.required_sigma)
        ]
        return sorted(near, key=lambda c: (c.candidate.kind is not None, -c.gain))[:max_rivals]

    def _improve_once(self, state: State, tests: ScoreTests) -> State | None:
        """Drop one effect, or exchange it for a rival, if that is better; else return None."""
        fit = tests.fit
        for k, candidate in enumerate(state):
            rest, rise = state[:k] + state[k + 1 :], tests.chi2(candidate) - fit.chi2
            if self._sigma(rise, candidate) < 2 * self.required_sigma:
                kept = self.fit(rest)
                if self._sigma(kept.chi2 - fit.chi2, candidate) < self.required_sigma:
                    return rest
            reduced, keys = None, {frozenset(state): candidate}
            for c in self._find_rivals(tests, candidate):
                key = frozenset({*rest, c.candidate})
                keys[key] = c.candidate
                if key not in self.fits:
                    reduced = reduced or self.remove(fit, candidate)
                    best = tests.sharper(self.evidence, c, candidate)
                    self.extend(key, reduced, best)
                if self.cost_of(key) < self.cost_of(state) + SCORE_ERROR_CHI2:
                    self.fit(tuple(key))
                if self.cost_of(key) < self.cost_of(state) - current_policy().rival_excluded_chi2:
                    return (*state[:k], c.candidate, *state[k + 1 :])
            simplest = self._simplest(keys)
            if simplest != frozenset(state):
                return (*state[:k], keys[simplest], *state[k + 1 :])
        return None

    def _find_rivals(self, tests: ScoreTests, candidate: Candidate) -> list[CandidateScore]:
        """Find candidates that, to first order, fit nearly as well as an effect does; the best comes first."""
        total = tests.chi2(candidate)
        rise = total - tests.fit.chi2
        near = tests.fit.chi2 + SCORE_ERROR_CHI2 + SCORE_ERROR_SHARE * rise
        rivals = [c for c in tests.ranking(candidate) if total - c.gain < near and c.effect not in self.absorbed]
        return sorted(rivals, key=lambda c: -c.gain)[:MAX_EXCHANGES]

    def _describe(self, state: State, k: int, tests: ScoreTests) -> EffectClaim:
        """The k-th effect of a model with its values, errors, aliases and limits."""
        candidate, fit = state[k], tests.fit
        rest = frozenset(state) - {candidate}
        worse = self.fit(tuple(rest)).chi2 - fit.chi2
        others = {key - rest: self.cost_of(key) for key in self.fits if len(key) == len(state) and key > rest}
        near = sorted(
            (p, next(iter(s)).name)
            for s, p in others.items()
            if p < self.cost_of(state) + current_policy().rival_excluded_chi2
        )
        ranking = tuple(c for c in tests.ranking(candidate) if c.identifiable and c.effect not in self.absorbed)
        if candidate.kind is None:  # any effect can imitate a constant: it does not count as a rival of it
            ranking = tuple(c for c in ranking if c.candidate.kind is None)
            near = [(p, n) for p, n in near if n in {c.effect for c in ranking}]
        aliases = (candidate.name, *(n for _, n in near if n != candidate.name))
        own = tests.signature(candidate)
        cosines = sorted(((largest_cosine(own, c.signature), c.effect) for c in ranking), reverse=True)
        nearest = max((c for c, effect in cosines if effect not in aliases), default=0.0)
        limit = {s: current_policy().detection_limit_sigma * fit.std[s] for s in candidate.strengths}
        std = profile_std(self.evidence, self.remove(fit, candidate), fit, candidate)
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
            {s: x / float(np.sqrt(max(1 - nearest**2, 1e-12))) for s, x in limit.items()},
        )


def fit_with_candidate(
    evidence: WhitenedClips,
    fit: ModelFit,
    scored: CandidateScore,
    progress: Callable[[], None] = lambda: None,
    min_share: float = 0.5,
) -> ModelFit:
    """Fit a candidate's strengths, then its shape parameters, together with all parameters of a fit.

    The descent starts where the score test leads. If that gains less than `min_share` of what the test promised, the
    fit starts from realistic sizes as well. For a base parameter held at zero it starts from realistic sizes only.

    Parameters
    ----------
    evidence : WhitenedClips
    fit : ModelFit
        The fit without the candidate.
    scored : CandidateScore
        The candidate and its score test beside `fit`.
    progress : callable
        Called now and then.
    min_share : float

    Returns
    -------
    ModelFit
        The best of those descents, roughly converged; `fit` itself if none can start.
    """
    tries = [] if scored.candidate.kind is None else [_descend_from_score(evidence, fit, scored, progress)]
    if not tries or tries[0].chi2 > fit.chi2 - min_share * scored.gain:
        tries += [minimise_chi2(evidence, s, progress, rough=True) for s in _realistic_starts(evidence, fit, scored)]
    return min(tries, key=lambda f: f.chi2, default=fit)


def _descend_from_score(
    evidence: WhitenedClips, fit: ModelFit, scored: CandidateScore, progress: Callable[[], None]
) -> ModelFit:
    candidate, model = scored.candidate, fit.model.replace(scored.shapes)
    strong = minimise_chi2(evidence, fit.extend(model, scored.strengths, scored.columns), progress, rough=True)
    if not candidate.shapes or all(strong.model.value(s) == 0 for s in scored.strengths):
        return strong
    here = predict_tracks(strong.model, strong.launches, evidence.clips)
    slopes = differentiate_all(strong.model, strong.launches, evidence.clips, candidate.shapes, here)
    columns = evidence.whiten([np.stack([s[k] for s in slopes], axis=-1) for k in range(len(here))])
    columns = zero_unidentifiable_shapes(strong.model, candidate.shapes, columns)
    return minimise_chi2(evidence, strong.extend(strong.model, candidate.shapes, columns), progress, rough=True)


def _realistic_starts(
    evidence: WhitenedClips,
    fit: ModelFit,
    scored: CandidateScore,
    shares: Sequence[float] = (0.1, 0.3, 1.0),
    count: int = 2,
) -> list[ModelFit]:
    """The best starts with the candidate's single strength at shares of a realistic size, all else after one step.

    A score test cannot lead to a strength at which the tracks have stopped being linear in it.
    """
    candidate = scored.candidate
    if len(candidate.strengths) > 1:
        return []
    name = candidate.strengths[0]
    size, (low, high) = find_parameter(fit.model, name).typical, parameter_limits(fit.model, name)
    begun: list[ModelFit] = []
    for shapes in candidate.grid(fit.model):
        for value in (sign * share * size for share in shares for sign in (1, -1)):
            if low <= value <= high:
                start = take_one_step(evidence, fit, fit.model.replace({**shapes, name: value}))
                begun += [start] if start else []
    best = sorted(begun, key=lambda f: f.chi2)[:count]
    names = (*fit.names, name, *candidate.shapes)
    return [linearise(evidence, f.model, names, f.launches) for f in best]
