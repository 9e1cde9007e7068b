"""Limits of several draws of one experiment as those of a typical one."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from discrepancy.planning.signatures import SAME, Limit, Rival

ENOUGH = 150  # collisions, over all draws: limits of 30 scatter by a fifth from one draw to the next
MOST = 5  # draws


def count_draws(clips: int) -> int:
    """How many draws of so many collisions make a typical one."""
    return min(MOST, math.ceil(ENOUGH / clips))


def median_limits(draws: Sequence[tuple[Limit, ...]]) -> tuple[Limit, ...]:
    """The median over draws of each strength's limit, and of its likeness to each other effect.

    Parameters
    ----------
    draws : sequence of tuple of Limit
        Of the same scene, in the same order.

    Returns
    -------
    tuple of Limit
    """
    return tuple(_median(rows) for rows in zip(*draws, strict=True))


def _median(rows: Sequence[Limit]) -> Limit:
    cosines: dict[str, list[Rival]] = {}
    for row in rows:
        for rival in row.rivals:
            cosines.setdefault(rival.effect, []).append(rival)
    rivals = [
        dataclasses.replace(found[0], cosine=float(np.median([r.cosine for r in found])))
        for found in cosines.values()
        if 2 * len(found) > len(rows)
    ]
    rivals.sort(key=lambda r: -r.cosine)
    limit, best, worst = (float(np.median([getattr(r, key) for r in rows])) for key in ("limit", "best", "worst"))
    apart = 1 - rivals[0].cosine ** 2 if rivals else 1.0
    return dataclasses.replace(
        rows[0],
        limit=limit,
        naming_limit=limit / math.sqrt(apart) if apart > SAME else math.inf,
        shows=2 * sum(r.shows for r in rows) > len(rows),
        rivals=tuple(rivals),
        best=best,
        worst=worst,
        scatter=(min(r.limit for r in rows), max(r.limit for r in rows)),
    )
