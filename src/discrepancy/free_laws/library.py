"""The free laws there are: each is a file of the folder `laws`, found by its being there."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

from discrepancy.arrays import Array
from discrepancy.data.collisions import MeasuredCollision
from discrepancy.free_laws import laws
from discrepancy.free_laws.law_kinds import FreeLaw
from discrepancy.free_laws.ranges import compute_ranges
from synthcam.library import classes_in
from synthcam.model import Model


@cache
def library() -> tuple[type[FreeLaw], ...]:
    """Every free law found in the folder `laws`."""
    return tuple(classes_in(laws, FreeLaw))  # type: ignore[type-abstract]


def law_count() -> int:
    """How many there are to choose from, those of one ball alone among them."""
    return sum(3 if kind.one_ball else 1 for kind in library())


def free_laws_over(model: Model, launches: Array, clips: Sequence[MeasuredCollision]) -> tuple[FreeLaw, ...]:
    """Every free law, each over the range that these clips cover; sorted by name.

    Parameters
    ----------
    model : Model
        A fit, whose motion is looked at for the ranges.
    launches : (clips, p) array
        Columns as in `discrepancy.data.launch`.
    clips : sequence of Measured

    Returns
    -------
    tuple of FreeLaw
        Without those of which the clips show nothing.
    """
    covered, found = compute_ranges(model, launches, clips), []
    for kind in library():
        for ball in ("", "a", "b") if kind.one_ball else ("",):
            if axes := kind.over(covered[ball]):
                found.append(kind(axes, ball))
    return tuple(sorted(found, key=lambda law: law.name))
