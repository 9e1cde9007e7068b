"""The free laws there are: each is a file of the folder `laws`, found by its being there."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Iterator, Sequence
from functools import cache
from types import ModuleType

from discrepancy.arrays import Array
from discrepancy.data.collisions import Measured
from discrepancy.free_laws import laws
from discrepancy.free_laws.free_law import FreeLaw
from discrepancy.free_laws.ranges import ranges
from synthcam.model import Model


def laws_in(package: ModuleType) -> Iterator[type[FreeLaw]]:
    """The free laws of a package: each of its modules holds one subclass of FreeLaw."""
    for info in sorted(pkgutil.iter_modules(package.__path__), key=lambda i: i.name):
        module = importlib.import_module(f"{package.__name__}.{info.name}")
        own = [c for c in vars(module).values() if inspect.isclass(c) and issubclass(c, FreeLaw)]
        own = [c for c in own if c.__module__ == module.__name__]
        if len(own) != 1:
            raise TypeError(f"{module.__name__}: expected one free law in the file, found {len(own)}")
        yield own[0]


@cache
def library() -> tuple[type[FreeLaw], ...]:
    """Every free law found in the folder `laws`."""
    return tuple(laws_in(laws))


def law_count() -> int:
    """How many there are to choose from, those of one ball alone among them."""
    return sum(3 if kind.one_ball else 1 for kind in library())


def free_laws(model: Model, launches: Array, clips: Sequence[Measured]) -> tuple[FreeLaw, ...]:
    """Every free law, each over the range that these clips cover; sorted by name.

    Parameters
    ----------
    model : Model
        A fit, whose motion is looked at for the ranges.
    launches : (clips, 6) array
        Columns as in `discrepancy.data.launch`.
    clips : sequence of Measured

    Returns
    -------
    tuple of FreeLaw
        Without those of which the clips show nothing.
    """
    covered, found = ranges(model, launches, clips), []
    for kind in library():
        for ball in ("", "a", "b") if kind.one_ball else ("",):
            if axes := kind.over(covered[ball]):
                found.append(kind(axes, ball))
    return tuple(sorted(found, key=lambda law: law.name))
