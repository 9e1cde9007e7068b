"""The library of effects: each is a file of the folder `effects`, found by its being there."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from functools import cache
from types import ModuleType
from typing import TypeVar

from commandline.errors import PluginError
from synthcam import effects
from synthcam.effect import Effect

T = TypeVar("T")


def classes_in(package: ModuleType, base: type[T]) -> Iterator[type[T]]:
    """The one subclass of `base` in each module of a package, by the modules' names. Raises TypeError."""
    for info in sorted(pkgutil.iter_modules(package.__path__), key=lambda i: i.name):
        module = importlib.import_module(f"{package.__name__}.{info.name}")
        own = [c for c in vars(module).values() if inspect.isclass(c) and issubclass(c, base)]
        own = [c for c in own if c.__module__ == module.__name__]
        if len(own) != 1:
            raise PluginError(f"{module.__name__}: expected one {base.__name__} in the file, found {len(own)}")
        yield own[0]


@cache
def library() -> dict[str, type[Effect]]:
    """Every effect found in the folder `effects`, by name."""
    return {e.name(): e for e in classes_in(effects, Effect)}
