"""Glints of a clip: what a detector returns, and what it knows of the clip."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tracker.camera.camera import Camera
from tracker.camera.lens import Array
from tracker.detection.candidates import EmptyPlate
from tracker.detection.takes import Takes

CLIPPED, BLURRED, NEAR, MISFIT, EDGE, SHADED = 1, 2, 4, 8, 16, 32
WORDS = {CLIPPED: "clipped", BLURRED: "streak", NEAR: "near", MISFIT: "misfit", EDGE: "edge", SHADED: "shaded"}
UNLIT = (
    0.01  # of a radius, by which a ball lies off whose far side is in its own shadow, alike over a ball's width: rms of
)
# 640 positions in four films of white balls (scenes/matte_white.yaml)


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
    def at(x: Any, y: Any, std: Any, flux: Any = 1.0, full: Any = False) -> Glints:
        """Glints at places (n,), px, with standard errors in x and y alike; full: whether a pixel is clipped."""
        n = np.size(x)
        place = [np.array(np.broadcast_to(np.asarray(v, np.float64), (n,))) for v in (x, y, std, flux)]
        cov = np.square(place[2])[:, None, None] * np.eye(2)
        flags = np.array(np.broadcast_to(np.where(full, CLIPPED, 0), (n,)), np.int64)
        return Glints(np.zeros(n, np.int64), place[0], place[1], cov, place[3], np.zeros(n), flags)

    @staticmethod
    def join(parts: Iterable[Glints]) -> Glints:
        """All the parts' glints, in their order."""
        kept = list(parts) or [Glints.none()]
        names = Glints.__dataclass_fields__
        return Glints(*(np.concatenate([getattr(p, name) for p in kept]) for name in names))


@dataclass(frozen=True, eq=False)
class View:
    """What a detector knows of a clip: the camera, nothing missing in it, the plate without balls, and the frames."""

    camera: Camera
    plate: EmptyPlate
    frames: Sequence[Any] = ()
    takes: Takes | None = None
    notes: tuple[str, ...] = ()

    @property
    def sigma(self) -> float:
        """Width of a resting glint, px."""
        assert self.camera.sigma is not None  # filled in by ``estimate_unknown_settings``
        return self.camera.sigma


class Detector(Protocol):
    """Made once a clip from a View. A detector may also have ``many(frames) -> Glints`` for a whole clip's
    frames at once, as an iterable of (number, frame); else it is called frame by frame.
    """

    def __call__(self, frame: NDArray[Any]) -> Glints:
        """Glints of one grey (h, w) frame; their frame number is ignored."""


def describe_flags(flags: NDArray[np.int64], always: Sequence[str] = ()) -> NDArray[np.str_]:
    """Flags as words joined by '|', '' where there is none."""
    table = {
        value: "|".join([*always, *(word for bit, word in WORDS.items() if value & bit)])
        for value in np.unique(flags).tolist()
    }
    return np.array([table[v] for v in flags.tolist()], dtype=np.str_)
