"""Compare changes of an experiment: by how much limits fall, and which experiment would distinguish two effects."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.fitting.model_fit import ModelFit
from discrepancy.fitting.parameters import Candidate
from discrepancy.fitting.predict import predict_tracks
from discrepancy.noise.model import Noise
from discrepancy.planning.changes import CHANGES, TOGETHER, apply_change
from discrepancy.planning.experiment import PlannedExperiment, StatedErrors
from discrepancy.planning.limits import Signatures, StrengthLimits
from discrepancy.policy import current_policy
from discrepancy.select.score_test import ScoreTests, largest_cosine, prepare_trial

Limits = tuple[StrengthLimits, ...]
Pair = tuple[str, str]
Shaped = tuple[Candidate, dict[str, float]]  # an effect, with values of its shape parameters
AS_FILMED = "these collisions"


@dataclass(frozen=True)
class ChangeLimits:
    """A change of the experiment, by name and in words, and the limits with it."""

    name: str
    words: str
    limits: Limits


@dataclass(frozen=True)
class ChangeGain:
    """The gain of a change. limit, naming: by which factor limits and naming limits fall, the geometric mean over the
    strengths that are detectable with and without it.
    """

    name: str
    words: str
    limit: float
    naming: float
    parts: tuple[Pair, ...]  # pairs of effects that only the change makes distinguishable
    joins: tuple[Pair, ...]  # pairs that it makes indistinguishable
    shows: tuple[str, ...]  # strengths that are detectable only with it
    hides: tuple[str, ...]  # strengths that are detectable only without it


def limits_with_changes(
    experiment: PlannedExperiment, progress: Callable[[], None] = lambda: None
) -> tuple[Limits, tuple[ChangeLimits, ...]]:
    """Compute the limits of all effects for the planned experiment, and with every possible change of it.

    A large experiment is thinned out first, and the limits are those of the remaining collisions. progress: called
    after each change.
    """
    part = experiment.thin_out()
    before, after = Signatures.of(part).limits(), []
    progress()
    for change in (*CHANGES, TOGETHER):
        with suppress(ValueError):  # the changed experiment has no motion
            if made := apply_change(change, part):
                after.append(ChangeLimits(change.name, made[0], Signatures.of(made[1]).limits()))
        progress()
    return before, tuple(after)


def compute_gain_of_change(before: Limits, after: ChangeLimits, of: Sequence[str]) -> ChangeGain:
    """Compute by how much a change of the experiment lowers limits, for the effects named in `of`."""
    one, other = ({x.strength: x for x in limits if x.effect in of} for limits in (before, after.limits))
    both = [(one[k], other[k]) for k in one if k in other and one[k].shows and other[k].shows]
    pairs, again = indistinguishable_pairs(before, of), indistinguishable_pairs(after.limits, of)
    seen = {x.effect for x in after.limits if x.shows}
    return ChangeGain(
        name=after.name,
        words=after.words,
        limit=_geometric_mean([a.limit / b.limit for a, b in both]),
        naming=_geometric_mean([_naming_limit(a) / _naming_limit(b) for a, b in both]),
        parts=tuple(p for p in pairs if p not in again and seen.issuperset(p)),
        joins=tuple(p for p in again if p not in pairs),
        shows=tuple(k for k in one if k in other and other[k].shows and not one[k].shows),
        hides=tuple(k for k in one if k in other and one[k].shows and not other[k].shows),
    )


def _naming_limit(limit: StrengthLimits) -> float:
    cosine = limit.rivals[0].cosine if limit.rivals else 0.0
    return limit.limit / max(math.sqrt(1 - cosine**2), 1e-2)  # a change of a smaller sine is no gain


def _geometric_mean(ratios: Sequence[float]) -> float:
    return float(np.exp(np.mean(np.log(ratios)))) if ratios else 1.0


def cosine_of_pair(limits: Limits, pair: Pair) -> float:
    """Compare two effects in a plan: the largest cosine between their signatures; 1 if one of them has none."""
    rivals = [(x.effect, r) for x in limits for r in x.rivals]
    return max((r.cosine for effect, r in rivals if (effect, r.effect) in (pair, pair[::-1])), default=1.0)


def indistinguishable_pairs(limits: Limits, of: Sequence[str]) -> tuple[Pair, ...]:
    """List the pairs that a change could make distinguishable, with one effect in `of`; most similar first."""
    shown = sorted({x.effect for x in limits if x.shows})
    known = {frozenset((x.effect, a)) for x in limits if x.shows for a in x.indistinguishable}
    pairs = [p for p in combinations(shown, 2) if frozenset(p) in known and set(p) & set(of)]
    return tuple(sorted(pairs, key=lambda p: -cosine_of_pair(limits, p)))


@dataclass(frozen=True)
class CollisionsNeeded:
    """The collisions that a wanted limit takes.

    clips, clips_to_name: collisions to record for a detection limit, and for a naming limit, of that size; None if no
    number suffices.
    """

    strength: str
    limit: float  # the wanted one
    clips: int | None
    clips_to_name: int | None
    at: dict[int, float]  # the detection limit at some numbers of collisions

    def sentence(self) -> str:
        """How many collisions detect the strength, and how many name it."""
        detect, name = (n or "no number of" for n in (self.clips, self.clips_to_name))
        return (
            f"{self.strength} = {self.limit:g}: {detect} collisions detect it; {name} distinguish it from the most "
            "similar effect, so that a search names it"
        )


def count_collisions_needed(
    strength: str, wanted: float, here: StrengthLimits, count: int, limit_at: Callable[[int], float], most: int = 400
) -> CollisionsNeeded:
    """Compare a limit with the wanted one: estimate how many collisions bring it down to that.

    The limit is computed for `count` collisions and for twice as many. A power law through both gives a number, at
    which the limit is computed once more unless the number exceeds `most`. From there the limit falls as one over the
    square root of the number.

    here: the limit for `count` collisions; limit_at: takes a number of collisions and returns their limit.
    """
    if not math.isfinite(here.limit):
        return CollisionsNeeded(strength, wanted, None, None, {})
    least, at = current_policy().min_collisions, {count: here.limit, 2 * count: limit_at(2 * count)}
    power = max(math.log2(at[count] / at[2 * count]), 0.25)
    near = max(math.ceil(count * (here.limit / wanted) ** (1 / power)), least)
    if near <= most and near not in at:
        at[near] = limit_at(near)
    base = min(at, key=lambda n: abs(math.log(n / near)))

    def number(times: float) -> int | None:
        exact = base * (at[base] * times / wanted) ** 2
        return max(math.ceil(exact - 1e-9), least) if math.isfinite(exact) else None

    to_name = number(here.naming_limit / here.limit)
    return CollisionsNeeded(strength, wanted, number(1.0), to_name, dict(sorted(at.items())))


@dataclass(frozen=True)
class ComparedDesign:
    """Collisions that could be filmed, in words, and the cosine of the two effects' signatures in them."""

    words: str
    cosine: float


def compare_designs(
    clips: Sequence[MeasuredCollision], noise: Noise, fit: ModelFit, one: Shaped, other: Shaped
) -> tuple[ComparedDesign, ...]:
    """Compute the cosine of two effects' signatures in the filmed collisions and in others that could be filmed.

    Both effects have zero strength; all other parameters have their fitted values. First come the collisions as they
    are (`PlannedExperiment.thin_out` selects some). Then come those with each possible change of `changes.CHANGES`, and
    last those with all changes of launches at once.
    """
    for candidate, _ in (one, other):
        fit = fit.drop(candidate.remove_from(fit.model), candidate.strengths + candidate.shapes)
    claimed = np.concatenate([c.claimed_std() for c in clips])
    error_px = float(np.sqrt((claimed**2).mean())) / clips[0].camera.scale
    filmed = PlannedExperiment(
        model=fit.model,
        names=fit.names,
        clips=tuple(clips),
        launches=fit.launches,
        films=tuple(range(int(c.frame.min()), int(c.frame.max()) + 1) for c in clips),
        errors=StatedErrors(error_px),
        noise=noise,
    ).thin_out()
    found = [ComparedDesign(AS_FILMED, _cosine(filmed, one, other))]
    for change in (*CHANGES, TOGETHER):
        try:
            changed = apply_change(change, filmed)
        except ValueError:  # no motion
            continue
        if changed is not None:
            found.append(ComparedDesign(changed[0], _cosine(changed[1], one, other)))
    return tuple(found)


def _cosine(experiment: PlannedExperiment, one: Shaped, other: Shaped) -> float:
    """The cosine between two effects' signatures; 1 without a motion, or if the fit absorbs one of the two."""
    evidence, launches = experiment.evidence, experiment.launches
    try:
        here = experiment.fit()
        expected = predict_tracks(here.model, launches, evidence.clips)
        trials = tuple(
            prepare_trial(evidence, here.model, launches, candidate, shapes, expected)
            for candidate, shapes in (one, other)
        )
    except ValueError:
        return 1.0
    first, second = ScoreTests(here, trials).ranking()  # what is absorbed comes last
    return 1.0 if second.absorbed else largest_cosine(first.signature, second.signature)


def advise_on_pair(one: Candidate, other: Candidate, found: Sequence[ComparedDesign]) -> str:
    """Advise, in a sentence, on the design that distinguishes two effects best.

    A single change is preferred to all changes at once, unless these lower the cosine much more. found: from
    `compare_designs`.
    """
    as_filmed, *proposed = found
    policy = current_policy()
    best = min(proposed, key=lambda d: d.cosine, default=as_filmed)
    single = min(proposed[:-1], key=lambda d: d.cosine, default=as_filmed)
    if single.cosine < policy.separated_cosine or single.cosine < best.cosine + policy.min_cosine_gain:
        best = single
    pair = f"{one.name} and {other.name}"
    if best.cosine < min(policy.separated_cosine, as_filmed.cosine):
        falls = f"the cosine of their signatures falls from {as_filmed.cosine:.3f} to {best.cosine:.3f}"
        return f"To distinguish {pair}: {best.words}; {falls}."
    if as_filmed.cosine < policy.separated_cosine:
        already = f"the cosine of their signatures is {as_filmed.cosine:.3f}"
        return f"To distinguish {pair}: more collisions like these; {already}."
    other_measurements = {  # by the law that an effect bends
        "camera": "film a plate of known lengths with the same camera",
        "measure": "film balls at rest at known positions, or move the lamp",
        "clock": "film a clock with the same camera",
        "exposure": "film a flashing light with the same camera",
        "mass": "weigh the balls",
        "radius": "measure the balls' diameters",
    }
    laws = dict.fromkeys(law for c in (one, other) if c.kind is not None for law in c.kind.laws)
    means = list(dict.fromkeys(other_measurements[law] for law in laws if law in other_measurements))
    otherwise = "; ".join(means) if means else "one of the two must be measured by other means"
    return f"No collisions of two balls distinguish {pair} (cosine {best.cosine:.3f} at best): {otherwise}."
