"""What each change of an experiment would gain: limits that fall, effects that it parts."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from discrepancy.planning.changes import CHANGES, TOGETHER, apply_change
from discrepancy.planning.experiment import Experiment
from discrepancy.planning.pair_advice import thin_out
from discrepancy.planning.signatures import Limit, Signatures
from discrepancy.policy import current_policy

LEAST_APART = 1e-2  # sine between signatures: alike beyond that, a change of it is no gain
Limits = tuple[Limit, ...]
Pair = tuple[str, str]


@dataclass(frozen=True)
class ChangeLimits:
    """A change of the experiment, and the limits with it. name: as of `changes`; words: what was changed."""

    name: str
    words: str
    limits: Limits


@dataclass(frozen=True)
class ChangeGain:
    """What a change would gain.

    Attributes
    ----------
    name, words : str
        Of the change.
    limit, naming : float
        How many times smaller limits and naming limits become: geometric mean over the strengths that show with and
        without the change.
    parts, joins : tuple of (str, str)
        Pairs of effects that could not be told apart without it, and that cannot with it.
    shows, hides : tuple of str
        Strengths that show with it alone, and without it alone.
    """

    name: str
    words: str
    limit: float
    naming: float
    parts: tuple[Pair, ...]
    joins: tuple[Pair, ...]
    shows: tuple[str, ...]
    hides: tuple[str, ...]


def limits_with_changes(
    experiment: Experiment, progress: Callable[[], None] = lambda: None
) -> tuple[Limits, tuple[ChangeLimits, ...]]:
    """The limits of all effects as the experiment is, and under every change that is possible.

    Of a large experiment some collisions are taken; limits are of these.

    Parameters
    ----------
    experiment : Experiment
    progress : callable
        Told after each.

    Returns
    -------
    before : tuple of Limit
    after : tuple of Tried
    """
    part = thin_out(experiment)
    before, after = Signatures.of(part).limits(), []
    progress()
    for change in (*CHANGES, TOGETHER):
        try:
            made = apply_change(change, part)
            if made is not None:
                after.append(ChangeLimits(change.name, made[0], Signatures.of(made[1]).limits()))
        except ValueError:  # the changed experiment has no motion
            pass
        progress()
    return before, tuple(after)


def compute_gain(before: Limits, after: ChangeLimits, of: Sequence[str]) -> ChangeGain:
    """What a change gains for the effects named."""
    one, other = ({x.strength: x for x in limits if x.effect in of} for limits in (before, after.limits))
    both = [(one[k], other[k]) for k in one if k in other and one[k].shows and other[k].shows]
    pairs, again = indistinguishable_pairs(before, of), indistinguishable_pairs(after.limits, of)
    seen = {x.effect for x in after.limits if x.shows}
    return ChangeGain(
        after.name,
        after.words,
        _geometric_mean([a.limit / b.limit for a, b in both]),
        _geometric_mean([_naming_limit(a) / _naming_limit(b) for a, b in both]),
        tuple(p for p in pairs if p not in again and seen.issuperset(p)),
        tuple(p for p in again if p not in pairs),
        tuple(k for k in one if k in other and other[k].shows and not one[k].shows),
        tuple(k for k in one if k in other and one[k].shows and not other[k].shows),
    )


def _naming_limit(limit: Limit) -> float:
    cosine = limit.rivals[0].cosine if limit.rivals else 0.0
    return limit.limit / max(math.sqrt(1 - cosine**2), LEAST_APART)


def _geometric_mean(ratios: Sequence[float]) -> float:
    return float(np.exp(np.mean(np.log(ratios)))) if ratios else 1.0


def largest_cosine(limits: Limits, pair: Pair) -> float:
    """The largest cosine between the signatures of two effects; 1 where one of them has none."""
    found = [
        r.cosine
        for one, other in (pair, pair[::-1])
        for row in limits
        if row.effect == one
        for r in row.rivals
        if r.effect == other
    ]
    return max(found, default=1.0)


def indistinguishable_pairs(limits: Limits, of: Sequence[str]) -> tuple[Pair, ...]:
    """Pairs of effects, one of them at least among those named, that could not be told apart; the likest first."""
    shown = sorted({x.effect for x in limits if x.shows})
    known = {frozenset((x.effect, a)) for x in limits if x.shows for a in x.indistinguishable}
    pairs = [p for p in combinations(shown, 2) if frozenset(p) in known and set(p) & set(of)]
    return tuple(sorted(pairs, key=lambda p: -largest_cosine(limits, p)))


@dataclass(frozen=True)
class CollisionsNeeded:
    """A limit that is asked for.

    Attributes
    ----------
    strength : str
    limit : float
        That is wanted.
    clips, clips_to_name : int or None
        Collisions to record for a detection limit, and a naming limit, of that size; None where no number would do.
    at : dict of int to float
        The detection limit at some numbers of collisions.
    """

    strength: str
    limit: float
    clips: int | None
    clips_to_name: int | None
    at: dict[int, float]


def count_collisions_needed(
    strength: str, wanted: float, here: Limit, count: int, limit_at: Callable[[int], float], most: int
) -> CollisionsNeeded:
    """How many collisions would bring a strength's limit down to one that is wanted.

    The limit is worked out for `count` and twice as many; a power law through both leads to a number, at which it is
    worked out once more unless it exceeds `most`. From there it falls as one over the root of the number.

    Parameters
    ----------
    strength : str
    wanted : float
    here : Limit
        Of `count` collisions.
    count : int
    limit_at : callable
        The limit for a number of collisions.
    most : int

    Returns
    -------
    Wanted
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

    return CollisionsNeeded(
        strength, wanted, number(1.0), number(here.naming_limit / here.limit), dict(sorted(at.items()))
    )
