"""Glints of a clip: what a detector is, where detectors are found, and what they are told about the clip."""

from __future__ import annotations

import importlib
import inspect
import math
import pkgutil
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import entry_points
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tracker.camera.camera import Camera, InputError
from tracker.camera.frames import Clip
from tracker.camera.lens import Array
from tracker.detection.autocalibrate import completed
from tracker.detection.candidates import Ground, ground
from tracker.detection.streak_length import CURIOUS, PLAIN, SETTLED, SURE, Streaks

GROUP = "tracker.detectors"
LOOKS = 5  # again at a clip, until its streaks are as long as they are taken to be
SWINGS = 0.8  # of the last change's logarithm, one back again that is too large
DEFAULT = "maximum_likelihood"

CLIPPED, STREAK, NEAR, MISFIT, EDGE = 1, 2, 4, 8, 16
WORDS = {CLIPPED: "clipped", STREAK: "streak", NEAR: "near", MISFIT: "misfit", EDGE: "edge"}


@dataclass(frozen=True, eq=False)
class Glints:
    """Glints found; flat arrays (n,): ``frame``, ``x``, ``y`` px, ``cov`` (n, 2, 2) px^2, ``flux`` and
    ``background`` counts, ``flags`` sums of the bits above; ``fixed`` (n, 2, 2) px^2 the part of ``cov`` that a
    ball at rest has in every frame alike (zero where a detector does not know).
    """

    frame: NDArray[np.int64]
    x: Array
    y: Array
    cov: Array
    flux: Array
    background: Array
    flags: NDArray[np.int64]
    fixed: Array = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        if len(self.fixed) == 0:
            object.__setattr__(self, "fixed", np.zeros_like(self.cov))

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
        assert self.camera.sigma is not None  # filled in by ``completed``
        return self.camera.sigma


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
    from tracker.detection import detectors as folder

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
    from tracker.detection import detectors as folder

    if name in {module.name for module in pkgutil.iter_modules(folder.__path__)}:
        return _from_file(name)  # without reading every other
    known = detectors()
    if name not in known:
        raise InputError(f"--detector: no detector {name!r}, expected one of {', '.join(sorted(known))}")
    return known[name]


def look(clip: Clip) -> View:
    """Plate and noise of a clip, and from them what its camera file leaves open."""
    plate = ground(clip.frames)
    if plate.level.shape != clip.frames.shape[1:]:
        raise InputError(f"clip {clip.number}: frames of unequal sizes")
    return View(completed(clip.camera, plate, clip.frames), plate)


def detect(clip: Clip, view: View, name: str = DEFAULT) -> Glints:
    """All glints of a clip by the detector ``name``, in the order of frames."""
    return _searched(clip, detector(name)(view))


def settled(clip: Clip, view: View, name: str = DEFAULT) -> tuple[Glints, View]:
    """All glints, and the view with the exposure that their streaks tell where that is not the camera file's.

    That is so where they differ by more than SURE of its errors and by PLAIN. Else, or where the looks do not come to
    an end, the view is the one given, and the glints are those of `detect`.
    """
    finder: Any = detector(name)(view)
    first = _searched(clip, finder)
    streaks = getattr(finder, "streaks", None)
    if not isinstance(streaks, Streaks):
        return first, view
    length, error, hint = streaks.length()
    if hint < CURIOUS or abs(length - 1.0) < PLAIN:
        return first, view
    now = view
    for _ in range(LOOKS):
        seen = min(now.camera.exposed * length, 1.0 / now.camera.fps)
        now = replace(now, camera=replace(now.camera, exposure_seen=seen))
        finder, last = detector(name)(now), length
        glints = _searched(clip, finder)
        length, error, _ = finder.streaks.length()
        if abs(length - 1.0) < SETTLED:
            change = abs(1.0 - view.camera.exposure / seen)
            return (glints, now) if change > max(PLAIN, SURE * error) else (first, view)
        if (length > 1.0) != (last > 1.0) and abs(math.log(length)) > SWINGS * abs(math.log(last)):
            break  # it swings about and will not settle: something else is wrong with the glints
    return first, view


def _searched(clip: Clip, finder: Any) -> Glints:
    frames = enumerate(clip.frames)
    if hasattr(finder, "many"):
        found: Glints = finder.many(frames)
        return found
    parts = []
    for number, frame in frames:
        glints = finder(frame)
        parts.append(replace(glints, frame=np.full(len(glints), number, dtype=np.int64)))
    return Glints.join(parts)
