"""Glints of a clip: what a detector is, where detectors are found, and what they are told about the clip."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import entry_points
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from .geometry import Camera, InputError
from .lens import Array
from .search import Ground, ground
from .video import Clip

GROUP = "tracker.detectors"
DEFAULT = "maximum_likelihood"
DEFAULT_SIGMA = 1.0  # px, where neither the camera file nor the clip tells

CLIPPED, STREAK, NEAR, MISFIT, EDGE = 1, 2, 4, 8, 16
WORDS = {CLIPPED: "clipped", STREAK: "streak", NEAR: "near", MISFIT: "misfit", EDGE: "edge"}


@dataclass(frozen=True, eq=False)
class Glints:
    """Glints found; flat arrays (n,): ``frame``, ``x``, ``y`` px, ``cov`` (n, 2, 2) px^2, ``flux`` and
    ``background`` counts, ``flags`` sums of the bits above.
    """

    frame: NDArray[np.int64]
    x: Array
    y: Array
    cov: Array
    flux: Array
    background: Array
    flags: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def xy(self) -> Array:
        """(n, 2) px."""
        return np.stack([self.x, self.y], axis=1)

    def take(self, rows: Any) -> Glints:
        """The glints of ``rows``: indices or a mask."""
        return Glints(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))

    def put(self, rows: Any, part: Glints) -> Glints:
        """The same glints, ``part`` in the place of ``rows``."""
        changed = {name: getattr(self, name).copy() for name in self.__dataclass_fields__}
        for name, values in changed.items():
            values[rows] = getattr(part, name)
        return Glints(**changed)

    @staticmethod
    def none() -> Glints:
        """No glints."""
        return Glints(
            np.empty(0, np.int64), np.empty(0), np.empty(0), np.empty((0, 2, 2)), np.empty(0), np.empty(0),
            np.empty(0, np.int64),
        )  # fmt: skip

    @staticmethod
    def join(parts: Iterable[Glints]) -> Glints:
        """All the parts' glints, in their order."""
        kept = list(parts) or [Glints.none()]
        names = Glints.__dataclass_fields__
        return Glints(*(np.concatenate([getattr(p, name) for p in kept]) for name in names))


@dataclass(frozen=True, eq=False)
class View:
    """What a detector is told of a clip: the camera, nothing missing in it, and the plate without balls."""

    camera: Camera
    plate: Ground

    @property
    def sigma(self) -> float:
        """Width of a resting glint, px."""
        return self.camera.sigma or DEFAULT_SIGMA


class Detector(Protocol):
    """Made once a clip from a View. A detector may also have ``many(frames) -> Glints`` for a whole clip's
    frames at once, as an iterable of (number, frame); else it is called frame by frame.
    """

    def __call__(self, frame: NDArray[Any]) -> Glints:
        """Glints of one grey (h, w) frame; their frame number is ignored."""


def flag_words(flags: NDArray[np.int64], always: Sequence[str] = ()) -> NDArray[np.str_]:
    """Flags as words joined by '|', '' where there is none."""
    table = {
        value: "|".join([*always, *(word for bit, word in WORDS.items() if value & bit)])
        for value in np.unique(flags).tolist()
    }
    return np.array([table[v] for v in flags.tolist()], dtype=np.str_)


def detectors() -> dict[str, Callable[[View], Detector]]:
    """Every detector by name: the files of ``detectors/`` and the entry points of group tracker.detectors."""
    from . import detectors as folder

    found: dict[str, Callable[[View], Detector]] = {}
    for module in pkgutil.iter_modules(folder.__path__):
        found[module.name] = _from_file(module.name)
    for point in entry_points(group=GROUP):
        found.setdefault(point.name, point.load())
    return found


def _from_file(name: str) -> Callable[[View], Detector]:
    module = importlib.import_module(f"{__package__}.detectors.{name}")
    made: list[Any] = [c for c in vars(module).values() if inspect.isclass(c)]
    callables = [c for c in made if c.__module__ == module.__name__ and "__call__" in vars(c)]
    if len(callables) != 1:
        raise TypeError(f"{module.__file__}: expected one callable class, found {len(callables)}")
    found: Callable[[View], Detector] = callables[0]
    return found


def detector(name: str) -> Callable[[View], Detector]:
    """The detector of that name; InputError lists those there are."""
    known = detectors()
    if name not in known:
        raise InputError(f"--detector: no detector {name!r}, expected one of {', '.join(sorted(known))}")
    return known[name]


def look(clip: Clip) -> View:
    """Plate and noise of a clip, and from them what its camera file leaves open."""
    plate = ground(clip.frames)
    if plate.level.shape != clip.frames.shape[1:]:
        raise InputError(f"clip {clip.number}: frames of unequal sizes")
    return View(_completed(clip.camera, plate), plate)


def _completed(camera: Camera, plate: Ground) -> Camera:
    """Noise that the camera file leaves out, from the plate's level and flicker; what is measured is said so."""
    sensor = camera.sensor
    level = float(np.median(plate.level))
    if "sensor.black_level" in camera.assumed:
        sensor = replace(sensor, black_level=level)
    if "sensor.read_noise" in camera.assumed:
        shot = max(level - sensor.black_level, 0.0) / sensor.gain
        rest = max(plate.noise**2 - 1.0 / 12.0 - shot, 1e-4)
        sensor = replace(sensor, read_noise=sensor.gain * rest**0.5)
    return replace(camera, sensor=sensor)


def detect(clip: Clip, view: View, name: str = DEFAULT) -> Glints:
    """All glints of a clip by the detector ``name``, in the order of frames."""
    finder: Any = detector(name)(view)
    frames = enumerate(clip.frames)
    if hasattr(finder, "many"):
        found: Glints = finder.many(frames)
        return found
    parts = []
    for number, frame in frames:
        glints = finder(frame)
        parts.append(replace(glints, frame=np.full(len(glints), number, dtype=np.int64)))
    return Glints.join(parts)
