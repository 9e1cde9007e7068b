"""Find the free laws: all that the modules of the folder `laws` list."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.fitting.parameters import is_known_parameter
from discrepancy.free_laws import laws
from discrepancy.free_laws.law_kinds import FreeLaw
from discrepancy.free_laws.ranges import compute_ranges
from synthcam.model import Model
from synthcam_shared.arrays import Array
from synthcam_shared.errors import PluginError


@cache
def list_free_laws() -> tuple[FreeLaw, ...]:
    """List every free law, sorted by name, without axes yet.

    Raises PluginError where a module of `laws` has no tuple LAWS of free laws, or two laws have one name.
    """
    found: dict[str, FreeLaw] = {}
    for info in pkgutil.iter_modules(laws.__path__):
        module = importlib.import_module(f"{laws.__name__}.{info.name}")
        listed = getattr(module, "LAWS", None)
        if not (isinstance(listed, tuple) and listed and all(isinstance(law, FreeLaw) for law in listed)):
            raise PluginError(f"{module.__name__}: expected LAWS, a tuple of free laws; found {listed!r}")
        for law in listed:
            if law.base_name in found:
                raise PluginError(f"{module.__name__}: {law.base_name}: there is a free law of this name already")
            found[law.base_name] = law
    return tuple(found[name] for name in sorted(found))


def count_laws() -> int:
    """Count the free laws that a search chooses from, those of one ball included."""
    return sum(3 if law.one_ball else 1 for law in list_free_laws())


def free_laws_over(model: Model, launches: Array, clips: Sequence[MeasuredCollision]) -> tuple[FreeLaw, ...]:
    """Set the axes of every free law to the ranges that a fit's motion covers: sorted by name. Laws that the motion
    does not cover are left out, and those of an effect that the library lacks.
    """
    covered, found = compute_ranges(model, launches, clips), []
    for law in list_free_laws():
        if not all(is_known_parameter(name) for name, _ in law.owners):
            continue
        for ball in ("", "a", "b") if law.one_ball else ("",):
            if axes := law.over(covered[ball]):
                found.append(replace(law, axes=axes, ball=ball))
    return tuple(sorted(found, key=lambda law: law.name))
