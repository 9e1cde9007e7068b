"""Effects of the library that could stand beside a free law in the place of one that is named there."""

from __future__ import annotations

from collections.abc import Callable, Collection

from discrepancy.fitting.model_fit import ModelFit, WhitenedClips
from discrepancy.fitting.parameters import Candidate
from discrepancy.free_laws.fitted_law import FittedLaw
from discrepancy.select.law_fit import fit_law_with_effect
from discrepancy.select.library_search import LOOSE, NEAR, SWAPS
from discrepancy.select.score_test import ScoreTests


def find_replacements(
    evidence: WhitenedClips,
    less: FittedLaw,
    named: Candidate,
    absorbed: Collection[str],
    base: ModelFit,
    progress: Callable[[], None],
) -> list[tuple[str, FittedLaw]]:
    """Fit other effects beside a free law in the place of one of those beside it.

    Parameters
    ----------
    evidence : Evidence
    less : FittedLaw
        The free law without that effect.
    named : Candidate
        The effect.
    absorbed : collection of str
        Effects that are no rivals.
    base : Fit
        What the cost of effects is counted from.
    progress : callable
        Told of progress.

    Returns
    -------
    list of (str, FittedLaw)
        The effects that to first order explain nearly as much, fitted in full, the best first.
    """
    tests = ScoreTests.of(less.evidence, less.joint_fit, progress, about=less.model_without_law)
    ranking = {c.effect: c for c in tests.ranking()}
    if named.name not in ranking:
        return []
    least = (1 - LOOSE) * tests.sharper(less.evidence, ranking.pop(named.name)).gain - NEAR
    told = [c for c in ranking.values() if c.identifiable and c.effect not in absorbed and c.gain > least / 2]
    rivals = [c for c in (tests.sharper(less.evidence, c) for c in told) if c.gain > least]
    fitted = []
    for rival in sorted(rivals, key=lambda c: -c.gain)[:SWAPS]:
        try:
            fitted.append((rival.effect, fit_law_with_effect(evidence, less, rival, base, progress)[1]))
        except ValueError:  # no motion
            continue
    return sorted(fitted, key=lambda pair: pair[1].score)
