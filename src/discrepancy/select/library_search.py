"""Search the library for missing effects: add, drop and exchange effects until no model is better.

This is forward selection with exchange. Models are compared by `model_cost.compute_cost`. Where the search ends far
from the noise, it begins again from other effects.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.fitting.gauss_newton import minimise_chi2
from discrepancy.fitting.jacobian import linearise
from discrepancy.fitting.model_fit import ModelFit
from discrepancy.fitting.parameters import Candidate, candidates_by_name
from discrepancy.fitting.significance import explains_too_little
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.policy import current_policy
from discrepancy.select.effect_claim import EffectClaim, find_similar_pairs, profile_std
from discrepancy.select.library_fits import SCORE_ERROR_CHI2, Key, LibraryFits, State
from discrepancy.select.model_cost import compute_cost
from discrepancy.select.score_test import CandidateScore, ScoreTests, largest_cosine
from discrepancy.time_left import in_stage
from synthcam.model import Model

SCORE_ERROR_SHARE = 0.2  # beside SCORE_ERROR_CHI2, a score test may be wrong by this share of what the effect explains
MAX_EXCHANGES = 4  # rivals of one effect that are fitted instead of it
MAX_FIRST_EFFECTS = 4  # effects that a search which explains too little begins with


@dataclass(frozen=True)
class InterruptedSearch:
    """The state of a search when its time, s, was over: the effects that fit best and their chi^2 per point."""

    effects: tuple[str, ...]
    chi2: float
    seconds: float


@dataclass(frozen=True)
class Selection:
    """The effects and the free law that a search selected."""

    state: State  # the effects of the library
    # the fits without any effect and with these
    base: ModelFit
    best: ModelFit
    free_law: FittedLaw | None = None  # the free law that explains more than the library
    near_law: FittedLaw | None = None  # a free law that explains nearly as much as the library's best model
    interrupted: InterruptedSearch | None = None  # set if the time was over; nothing is then selected

    @property
    def is_empty(self) -> bool:
        """True if the search selected nothing beside the base model."""
        return not (self.state or self.free_law)

    @property
    def joint_fit(self) -> ModelFit:
        """The fit with everything that was selected, a free law's coefficients among its parameters."""
        return self.free_law.joint_fit if self.free_law else self.best

    def explained_clips(self, clips: tuple[MeasuredCollision, ...]) -> tuple[MeasuredCollision, ...]:
        """The clips, less the displacements of a free law that no effect can hold."""
        return self.free_law.evidence.clips if self.free_law else clips


def make_selection(library: LibraryFits, state: State) -> Selection:
    """Make the result of the search of the library from the effects at which it ended."""
    return Selection(state, library.fit(()), library.fit_exactly(state))


def iterate_models(library: LibraryFits, state: State = ()) -> Iterator[State]:
    """Yield better and better models until no candidate is significant.

    Each model has one effect more than the one before, or other effects. The search also ends at the largest number
    of effects, and before a step that leads back to an earlier model.
    """
    while len(state) < current_policy().max_effects:
        winner = choose_addition(library, state)
        if winner is None:
            return
        before = library.cost_of(state)  # it falls if a larger model shows a better fit
        more = improve_until_stable(library, (*state, winner))
        if len(more) <= len(state) and library.cost_of(more) >= before:  # back to an earlier model
            return
        state = more
        yield state


def complete_search(library: LibraryFits, begun: State) -> State:
    """Complete a search of the library from a model; if no model follows, drop effects that are not significant."""
    state = [begun, *iterate_models(library, begun)][-1]
    return improve_until_stable(library, state) if state == begun else state


def search_from_other_effects(library: LibraryFits, found: State) -> State:
    """Search again from other first effects, if the model that was found leaves much more than noise.

    Forward selection can end at a local minimum: the effect that is added first may be wrong, and hide what is right.
    As multi-start local search does (Marti, Resende & Ribeiro, Eur. J. Oper. Res. 226 (2013) 1), the search is then
    repeated from several starts. It returns the model of least cost. A larger model than `found` must cost less by
    `SearchPolicy.rival_excluded_chi2`.

    The starts are those of `choose_first_effects`. A start that an exchange leads to a model from which the search went
    on before is skipped. The search ends with the first model that leaves at most `SearchPolicy.poor_chi2_per_point`.

    No candidate is tested that the search without these starts would not test. So the level that corrects for the
    number of candidates also holds for the best of all starts.
    """
    best, ends = found, {frozenset(found)}
    for start in choose_first_effects(library) if is_poor(library, found) else ():
        begun = improve_until_stable(library, (start,))
        if frozenset(begun) in ends:
            continue
        end = complete_search(library, begun)
        ends |= {frozenset(begun), frozenset(end)}
        required = current_policy().rival_excluded_chi2 if len(end) > len(found) else 0.0
        if library.cost_of(end) < min(library.cost_of(best), library.cost_of(found) - required):
            best = end
        if not is_poor(library, best):
            break
    return best


def is_poor(library: LibraryFits, state: State) -> bool:
    """Tell if a model leaves so much chi^2 per point that it does not describe the collisions."""
    fit = library.fit(state)
    return fit.chi2 / fit.points > current_policy().poor_chi2_per_point


@in_stage("search")
def choose_first_effects(library: LibraryFits) -> list[Candidate]:
    """Choose effects from which a search may begin, each fitted beside the base; that of least cost comes first.

    They are the significant candidates that explain most to first order, and that are no aliases of one another.
    Candidates that show only at unrealistic sizes count too: the realistic ones have failed.
    """
    starts = list[CandidateScore]()
    for scored in sorted(library.ranking, key=lambda c: -c.gain):
        if scored.sigma <= library.required_sigma or scored.absorbed or len(starts) == MAX_FIRST_EFFECTS:
            continue
        if all(largest_cosine(scored.signature, s.signature) < current_policy().alias_cosine for s in starts):
            starts.append(scored)
    for scored in starts:
        if library.needs_fit(key := frozenset({scored.candidate}), library.base):
            library.extend(key, library.base, scored)
    return sorted((s.candidate for s in starts), key=lambda c: library.cost_of([c]))


def search_from(library: LibraryFits, found: Selection, effects: Iterable[str], model: Model) -> Selection | None:
    """Search again, beginning with these effects at the values of `model`; return the selection if it is better.

    It must cost less than `found`; with more effects it must cost less by `rival_excluded_chi2`.
    """
    try:
        begun = fit_effects_from(library, effects, model)
    except ValueError:  # alone they have no motion
        return None
    again = make_selection(library, complete_search(library, begun))
    less = compute_cost(found.best, found.base) - compute_cost(again.best, found.base)
    required = current_policy().rival_excluded_chi2 if len(again.state) > len(found.state) else 0.0
    return again if less > required else None


@in_stage("search")
def fit_effects_from(library: LibraryFits, effects: Iterable[str], model: Model) -> State:
    """Fit these effects from a model's values, to start the library search. Raises ValueError without a motion."""
    base = library.base
    known = candidates_by_name(model, base.model, base.names)
    state = tuple(known[effect] for effect in effects)
    names = (*base.names, *(n for s in state for n in s.strengths + s.shapes))
    begun = base.model.replace({n: model.value(n) for n in names})
    start = linearise(library.evidence, begun, names, base.launches)
    library.offer(frozenset(state), minimise_chi2(library.evidence, start))
    return state


def exchange_effect(library: LibraryFits, found: Selection, candidate: Candidate, alias: str) -> Selection | None:
    """Exchange an effect of a selection for `alias`; None if that model was never fitted."""
    rest = frozenset(found.state) - {candidate}
    for key in list(library.fits):
        if len(key) == len(found.state) and key > rest and next(iter(key - rest)).name == alias:
            return make_selection(library, tuple(next(iter(key - rest)) if s == candidate else s for s in found.state))
    return None


def find_undetectable(library: LibraryFits, state: State) -> tuple[str, ...]:
    """Find the effects of the library that these collisions cannot show beside a model: see `max_detection_limit`."""
    return tuple(c.effect for c in library.score_tests(state).ranking() if not c.identifiable)


# --- Add an effect ---


@in_stage("search")
def choose_addition(library: LibraryFits, state: State) -> Candidate | None:
    """Choose the candidate that the library search adds: of leader and rivals, the simplest that fits as well.

    None if no candidate is significant, or if much more is missing than any candidate explains.
    """
    tests = library.score_tests(state)
    ranking, fit = tests.leaders(library.required_sigma), tests.fit
    if not ranking or ranking[0].sigma <= library.required_sigma:
        return None
    added = {frozenset({*state, c.candidate}): c for c in _choose_contenders(library, tests, ranking)}
    for key, scored in added.items():
        if library.needs_fit(key, fit):
            library.extend(key, fit, scored)
    keys = sorted(added, key=library.cost_of)
    for key in keys:
        if library.cost_of(key) < library.cost_of(keys[0]) + SCORE_ERROR_CHI2:
            library.fit(key)
    significant = [k for k in keys if _is_significant(library, fit, library.fits[k], added[k].candidate)]
    if min(keys, key=library.cost_of) not in significant:
        return None
    return added[choose_simplest(library, significant)].candidate


def _is_significant(library: LibraryFits, fit: ModelFit, more: ModelFit, candidate: Candidate) -> bool:
    """Tell if a candidate improves the fit by the sigma that a claim needs, and closes enough of the gap."""
    least = current_policy().min_closed_share
    enough = library.convert_to_sigma(fit.chi2 - more.chi2, candidate) > library.required_sigma
    return enough and not explains_too_little(fit.chi2 / fit.points, more.chi2 / more.points, least)


def choose_simplest(library: LibraryFits, keys: Collection[Key]) -> Key:
    """Choose the model with the fewest strengths, then shape parameters, among those that fit as well as the best."""
    near = min(map(library.cost_of, keys)) + current_policy().rival_excluded_chi2

    def order(key: Key) -> tuple[int, int, float]:
        effects = [s for s in key if s.kind is not None]
        return sum(len(s.strengths) for s in effects), sum(len(s.shapes) for s in effects), library.cost_of(key)

    return min((k for k in keys if library.cost_of(k) <= near), key=order)


def _choose_contenders(
    library: LibraryFits, tests: ScoreTests, ranking: Sequence[CandidateScore], max_rivals: int = 8
) -> list[CandidateScore]:
    """Choose candidates, with refined shapes, that may explain as much as the leader or have a similar signature."""
    least = ranking[0].gain / 2 - SCORE_ERROR_CHI2
    chosen = [tests.sharper(library.evidence, c) if c.gain > least else c for c in ranking if c.gain > 0]
    leader = max(chosen, key=lambda c: c.sigma)
    near = [
        c
        for c in chosen
        if c.gain > (1 - SCORE_ERROR_SHARE) * leader.gain - SCORE_ERROR_CHI2
        or largest_cosine(leader.signature, c.signature) > current_policy().alias_cosine
        or (c.candidate.kind is None and c.sigma > library.required_sigma)
    ]
    return sorted(near, key=lambda c: (c.candidate.kind is not None, -c.gain))[:max_rivals]


# --- Drop or exchange an effect ---


@in_stage("search")
def improve_until_stable(library: LibraryFits, state: State) -> State:
    """Drop and exchange candidates until nothing is better, or a model comes up again."""
    before: set[Key] = set()
    while state:
        before.add(frozenset(state))
        better = improve_once(library, state)
        if better is None or frozenset(better) in before:
            break
        state = better
    return state


def improve_once(library: LibraryFits, state: State) -> State | None:
    """Drop one effect, or exchange it for a rival, if that is better; else return None."""
    tests = library.score_tests(state)
    fit = tests.fit
    for k, candidate in enumerate(state):
        library.improve_part(state, candidate)
        rest, rise = state[:k] + state[k + 1 :], tests.chi2(candidate) - fit.chi2
        if library.convert_to_sigma(rise, candidate) < 2 * library.required_sigma:
            worse = library.fit(rest).chi2 - fit.chi2
            if library.convert_to_sigma(worse, candidate) < library.required_sigma:
                return rest
        reduced, keys = None, {frozenset(state): candidate}
        for c in _find_rivals(library, tests, candidate):
            key = frozenset({*rest, c.candidate})
            keys[key] = c.candidate
            if key not in library.fits:
                reduced = reduced or library.remove(fit, candidate)
                library.extend(key, reduced, tests.sharper(library.evidence, c, candidate))
            if library.cost_of(key) < library.cost_of(state) + SCORE_ERROR_CHI2:
                library.fit(key)
            if library.cost_of(key) < library.cost_of(state) - current_policy().rival_excluded_chi2:
                return (*state[:k], c.candidate, *state[k + 1 :])
        simplest = choose_simplest(library, keys)
        if simplest != frozenset(state):
            return (*state[:k], keys[simplest], *state[k + 1 :])
    return None


def _find_rivals(library: LibraryFits, tests: ScoreTests, candidate: Candidate) -> list[CandidateScore]:
    """Find candidates that, to first order, fit nearly as well as an effect does; the best comes first."""
    total = tests.chi2(candidate)
    near = tests.fit.chi2 + SCORE_ERROR_CHI2 + SCORE_ERROR_SHARE * (total - tests.fit.chi2)
    rivals = [c for c in tests.ranking(candidate) if total - c.gain < near and c.effect not in library.absorbed]
    return sorted(rivals, key=lambda c: -c.gain)[:MAX_EXCHANGES]


# --- Claim the effects of a model ---


def describe_claims(library: LibraryFits, state: State) -> tuple[EffectClaim, ...]:
    """Make a claim of each effect at which the search of the library ended, with values, errors, aliases and limits."""
    tests = library.score_tests(state)
    return tuple(_describe_claim(library, state, candidate, tests) for candidate in state)


def _describe_claim(library: LibraryFits, state: State, candidate: Candidate, tests: ScoreTests) -> EffectClaim:
    policy, fit, rest = current_policy(), tests.fit, frozenset(state) - {candidate}
    worse = library.fit(rest).chi2 - fit.chi2
    others = {key - rest: library.cost_of(key) for key in library.fits if len(key) == len(state) and key > rest}
    most = library.cost_of(state) + policy.rival_excluded_chi2
    near = [name for _, name in sorted((p, next(iter(s)).name) for s, p in others.items() if p < most)]
    ranking = tuple(c for c in tests.ranking(candidate) if c.identifiable and c.effect not in library.absorbed)
    if candidate.kind is None:  # any effect can imitate a constant: it does not count as a rival of it
        ranking = tuple(c for c in ranking if c.candidate.kind is None)
        near = [name for name in near if name in {c.effect for c in ranking}]
    aliases = (candidate.name, *(name for name in near if name != candidate.name))
    own = tests.signature(candidate)
    cosines = sorted(((largest_cosine(own, c.signature), c.effect) for c in ranking), reverse=True)
    nearest = max((c for c, effect in cosines if effect not in aliases), default=0.0)
    limit = {s: policy.detection_limit_sigma * fit.std[s] for s in candidate.strengths}
    std = profile_std(library.evidence, library.remove(fit, candidate), fit, candidate)
    similar = [((effect,), cosine) for cosine, effect in cosines if cosine > policy.alias_cosine]
    return replace(
        EffectClaim.of(candidate, fit, std, library.convert_to_sigma(worse, candidate)),
        aliases=aliases,
        alike=(*similar, *find_similar_pairs(own, ranking)),
        limit=limit,
        naming={s: x / float(np.sqrt(max(1 - nearest**2, 1e-12))) for s, x in limit.items()},
    )
