"""Detectors of users: a function in Python, or a class or function in a file or module."""

import hashlib
import importlib.util
import inspect
import os
import pkgutil
import sys
import traceback
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from synthcam_shared.errors import InputError, PluginError
from tracker.detection.detector import DetectorClass, FrameDetector, View
from tracker.detection.glints import Glints


def is_outside_detector(name: str) -> bool:
    """Tell whether a name stands for a file, FILE.py or FILE.py:NAME, or for MODULE:NAME."""
    return ":" in name or name.endswith(".py")


def short_name(name: str) -> str:
    """Name a user's own detector for files and pages: by its class or function, else by its file."""
    where, attribute = _split(name)
    return attribute or Path(where).stem


def digest_detector(name: str) -> str:
    """Digest the file of a user's own detector (SHA-256); nothing for a module."""
    file = Path(_split(name)[0])
    return hashlib.sha256(file.read_bytes()).hexdigest() if file.suffix == ".py" else ""


def load_outside(name: str) -> DetectorClass:
    """Load the detector that FILE.py, FILE.py:NAME or MODULE:NAME stands for. Raises InputError."""
    where, attribute = _split(name)
    file = Path(where)
    if where.endswith(".py"):
        if not file.is_file():
            raise InputError(f"--detector {name}: no such file; expected FILE.py, FILE.py:NAME or MODULE:NAME")
        module = _execute(str(file.resolve()), file.stat().st_mtime_ns)
    else:
        module = _import(where, name)
    return as_detector(_find(module, attribute, name))


def as_detector(given: Any, point: str = "") -> DetectorClass:
    """A class of detectors: the given class, or one that calls a function.

    point: what the function finds, "glint", "centre" or "either"; default: its attribute `point`, else "either".
    """
    if inspect.isclass(given):
        if not any(callable(vars(c).get(m)) for c in given.__mro__ for m in ("__call__", "detect")):
            raise PluginError(f"detector {given.__name__}: expected a method __call__(frame) or detect(frames)")
        return cast("DetectorClass", given)
    if not callable(given):
        raise InputError(f"detector: of type {type(given).__name__}, expected a name, a function or a class")
    return _ask(given, point or str(getattr(given, "point", "either")))


def _ask(function: Callable[[NDArray[Any]], Any], what: str) -> DetectorClass:
    name = str(getattr(function, "__name__", type(function).__name__))

    unknown_error_px = 0.1  # of positions without an error; the fits find out from the tracks how large it is

    class Asked:
        point = what

        def __init__(self, view: View) -> None:
            self.area = float(np.pi / 4 * view.camera.diameter_px**2)

        def __call__(self, frame: NDArray[Any]) -> Glints:
            given = function(np.array(frame))
            if isinstance(given, Glints):
                return given
            try:
                table = np.asarray(given, dtype=np.float64)
            except (TypeError, ValueError):
                raise InputError(
                    f"detector {name}: returned {type(given).__name__}, expected positions (n, 2): x and y in px"
                ) from None
            if table.size == 0:
                return Glints.none()
            if table.ndim != 2 or table.shape[1] not in (2, 3):
                raise InputError(
                    f"detector {name}: returned an array {table.shape}, expected positions (n, 2), x and y in px, or "
                    "(n, 3) with a standard error"
                )
            std = table[:, 2] if table.shape[1] == 3 else unknown_error_px
            return Glints.at(table[:, 0], table[:, 1], std, self.area)

    Asked.__name__ = Asked.__qualname__ = name
    made: Callable[[View], FrameDetector] = Asked
    return made


def _split(name: str) -> tuple[str, str]:
    where, _, attribute = (name, "", "") if name.endswith(".py") else name.rpartition(":")
    return where, attribute


@lru_cache(maxsize=16)
def _execute(file: str, changed: int) -> Any:
    """The module of a file, executed once for each version of it."""
    spec = importlib.util.spec_from_file_location(f"own_detector_{abs(hash(file))}", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses search it there
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        raise PluginError(f"{file}: {describe_fault(error, file)}") from None
    return module


def _import(module: str, name: str) -> Any:
    sys.path.insert(0, os.getcwd())
    try:
        return pkgutil.resolve_name(f"{module}:")
    except (Exception, SystemExit) as error:
        raise PluginError(f"--detector {name}: {type(error).__name__}: {' '.join(str(error).split())}") from None
    finally:
        sys.path.pop(0)


def describe_fault(error: BaseException, file: str = "") -> str:
    """Describe an exception of a user's own detector in one line, with the line where it was raised."""
    if isinstance(error, SyntaxError):
        return f"line {error.lineno}: {error.msg}"
    steps = traceback.extract_tb(error.__traceback__)
    own = next((s for s in reversed(steps) if not file or s.filename == file), steps[-1])
    where = f"line {own.lineno}" if file else f"{own.filename}, line {own.lineno}"
    return f"{where}: {type(error).__name__}: {' '.join(str(error).split())[:200]}"


def _find(module: Any, attribute: str, name: str) -> Any:
    own = {k: v for k, v in vars(module).items() if getattr(v, "__module__", "") == module.__name__ and k[0] != "_"}
    if attribute:
        if not hasattr(module, attribute):
            raise PluginError(f"--detector {name}: no {attribute} in it; there are {', '.join(own) or 'none'}")
        return getattr(module, attribute)
    classes = [v for v in own.values() if inspect.isclass(v) and {"__call__", "detect"} & set(vars(v))]
    functions = {k: v for k, v in own.items() if inspect.isfunction(v)}
    if len(classes) == 1:
        return classes[0]
    if not classes and (len(functions) == 1 or "detect" in functions):
        return functions.get("detect", next(iter(functions.values())))
    there = ", ".join([c.__name__ for c in classes] or functions) or "none"
    raise PluginError(f"--detector {name}: expected one class or function in it, found {there}; say {name}:NAME")
