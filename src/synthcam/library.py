"""The library of effects: every file of the folder `effects`, and the effects that users and packages add.

Users name a folder of their own; packages declare entry points of the group `synthcam.effects`.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import keyword
import pkgutil
import sys
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import MISSING, fields
from functools import _lru_cache_wrapper, cache
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import TypeVar

from synthcam import effects
from synthcam.effect import LAWS, Effect
from synthcam.tabulated_law import SEARCH_ONLY_LAWS, table_names
from synthcam_shared.arguments import check_arguments
from synthcam_shared.errors import InputError, PluginError

T = TypeVar("T")
GROUP = "synthcam.effects"  # of entry points
_folders: dict[Path, dict[str, type[Effect]]] = {}
_forget: list[Callable[[], None]] = []


def find_plugin_classes(package: ModuleType, base: type[T]) -> Iterator[type[T]]:
    """Find the plug-ins of a package, as the library does: the subclass of `base` in each module, by name."""
    for info in sorted(pkgutil.iter_modules(package.__path__), key=lambda i: i.name):
        yield _only_class(importlib.import_module(f"{package.__name__}.{info.name}"), base)


def _only_class(module: ModuleType, base: type[T]) -> type[T]:
    own = [c for c in vars(module).values() if inspect.isclass(c) and issubclass(c, base)]
    own = [c for c in own if c.__module__ == module.__name__]
    if len(own) != 1:
        raise PluginError(f"{module.__name__}: expected one {base.__name__} in the file, found {len(own)}")
    return own[0]


def cache_until_effects_change(make: Callable[[], T]) -> _lru_cache_wrapper[T]:
    """Decorate a function of the library whose result must be made again when effects are added."""
    made = cache(make)
    _forget.append(made.cache_clear)
    return made


@cache_until_effects_change
def library() -> dict[str, type[Effect]]:
    """Return every effect by name: of synthcam, then of packages, then of folders that were added."""
    found = {e.name(): e for e in find_plugin_classes(effects, Effect)}
    for point in sorted(entry_points(group=GROUP), key=lambda p: p.name):
        found[point.name] = _load_entry_point(point.name, point.load, found)
    for added in _folders.values():
        found |= added
    return found


def _load_entry_point(name: str, load: Callable[[], object], known: dict[str, type[Effect]]) -> type[Effect]:
    where = f"entry point {name} of {GROUP}"
    check_name(name, where, known)
    try:
        kind = load()
    except (Exception, SystemExit) as error:  # a package may raise anything
        raise PluginError(f"{where}: {type(error).__name__}: {' '.join(str(error).split())}") from None
    if not (inspect.isclass(kind) and issubclass(kind, Effect)):
        raise PluginError(f"{where}: expected a class of Effect, found {type(kind).__name__}")
    if kind.name() != name:
        raise PluginError(f"{where}: expected the name of the effect's file, {kind.name()}")
    _check(kind, where)
    return kind


@check_arguments
def add_effects(folder: str | Path) -> None:
    """Add the effects of your own folder to the library, one file for each, written like those of synthcam.

    Parameters
    ----------
    folder : str or Path
        Every .py file in it must hold one effect, except files whose names begin with "_". Adding a folder twice
        changes nothing.

    Raises
    ------
    InputError
        One line: which file, and what is wrong with it.

    Examples
    --------
    >>> import synthcam
    >>> synthcam.add_effects("my_effects")
    Traceback (most recent call last):
    ...
    synthcam_shared.errors.InputError: my_effects: no such folder; expected one with effects, NAME.py
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; expected one with effects, NAME.py")
    if folder.resolve() in _folders:
        return
    files = sorted(f for f in folder.glob("*.py") if not f.name.startswith("_"))
    if not files:
        raise InputError(f"{folder}: holds no effect; expected files NAME.py")
    found: dict[str, type[Effect]] = {}
    for file in files:
        found[file.stem] = _load_file(file, library())
    _folders[folder.resolve()] = found
    for forget in _forget:
        forget()


def list_added_folders() -> tuple[Path, ...]:
    """Return the folders that were added, for worker processes that must add them too."""
    return tuple(_folders)


def hash_effect_files(names: Iterable[str]) -> dict[str, str]:
    """Hash those of these effects that are from added folders: SHA-256 of each file, by name."""
    files = {name: folder / f"{name}.py" for folder, found in _folders.items() for name in found}
    return {name: hashlib.sha256(files[name].read_bytes()).hexdigest() for name in sorted(names) if name in files}


def check_name(name: str, where: str, known: Collection[str] | None = None) -> None:
    """Check the name of an effect. Raises PluginError, also where a `known` one, by default of the library, has it."""
    if not (name.isascii() and name.isidentifier() and name == name.lower()) or name.startswith("_"):
        raise PluginError(f"{where}: expected a name of lower-case letters, digits and _, such as my_effect")
    if keyword.iskeyword(name):
        raise PluginError(f"{where}: a word of Python's grammar; choose another name, such as {name}_effect")
    if name in (library() if known is None else known):
        raise PluginError(f"{where}: an effect of this name exists already; choose another name")
    if name in {*table_names(), *SEARCH_ONLY_LAWS, *LAWS}:
        raise PluginError(f"{where}: this is the name of a law; choose another name")


def _load_file(file: Path, known: dict[str, type[Effect]]) -> type[Effect]:
    """Load the effect in a file. Raises PluginError."""
    check_name(file.stem, str(file), known)
    key = hashlib.sha256(str(file.resolve().parent).encode()).hexdigest()[:12]
    name = f"synthcam_effects_of_a_folder_{key}.{file.stem}"  # no package has such a name
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses search it there
    try:
        spec.loader.exec_module(module)
        kind = _only_class(module, Effect)
        _check(kind, str(file))
    except BaseException as error:
        del sys.modules[name]
        if not isinstance(error, Exception | SystemExit):
            raise
        message = " ".join(str(error).split()).removeprefix(f"{name}: ").removeprefix(f"{file}: ")
        if isinstance(error, SyntaxError):
            message = f"line {error.lineno}: {error.msg}"
        elif not isinstance(error, InputError):
            message = f"{type(error).__name__}: {message}"
        raise PluginError(f"{file}: {message}") from None
    return kind


def _check(kind: type[Effect], where: str) -> None:
    """Raise PluginError if a class is not a complete effect."""
    if "__dataclass_params__" not in vars(kind):
        raise PluginError(f"{where}: expected @dataclass(frozen=True) before class {kind.__name__}")
    for plain in (f.name for f in fields(kind) if "typical" not in f.metadata or f.default is MISSING):
        example = f'{plain}: float = parameter("1", typical=1)'
        raise PluginError(f"{where}: {plain}: expected a parameter, such as {example}")
    if not kind.laws:
        raise PluginError(f"{where}: changes no law; expected a method named as one of {', '.join(LAWS)}")
    if not kind.strengths():
        raise PluginError(f"{where}: expected a parameter that is not fixed: the effect's strength")
    try:
        kind.absent()
        kind()
    except ValueError as error:
        raise PluginError(f"{where}: {error}") from None
