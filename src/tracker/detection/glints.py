"""`Glints`: the balls that a detector found, as arrays of positions with their covariances and flags."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, fields, replace
from enum import IntFlag
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from synthcam_shared.arrays import Array, Ints

SHADED_POSITION_ERROR_RADII = 0.01
"""Systematic position error, in ball radii, of a ball whose far side lies in its own shadow. It stays the same over
about a ball's width of travel. It is the rms of 640 positions in four films of white balls (scenes/matte_white.yaml).
"""


class PositionFlag(IntFlag):
    """Properties that may impair a position, as bits of a sum."""

    CLIPPED = 1  # a pixel of it is at the sensor's limit
    STREAK = 2  # it moved by more than half its width during the exposure
    NEAR = 4  # another ball is near
    MISFIT = 8  # the residuals of its fit are larger than the noise; its covariance is increased by as much
    EDGE = 16  # a part of it is cut off by the edge of the picture
    SHADED = 32  # it is lit from one side; its far side lies in its own shadow
    EXCHANGE = 64  # from here on the track may be that of another ball

    @property
    def word(self) -> str:
        """How tables name it."""
        return str(self.name).lower()


@dataclass(frozen=True, eq=False)
class RowArrays:
    """Base of a table whose columns are arrays of equal length."""

    def __len__(self) -> int:
        return len(getattr(self, fields(self)[0].name))

    def take(self, rows: Any) -> Self:
        """The rows that indices or a mask select."""
        return replace(self, **{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    @classmethod
    def join(cls, parts: Iterable[Self]) -> Self:
        """The rows of all parts, of which there must be one at least, in their order."""
        kept = list(parts)
        return replace(kept[0], **{f.name: np.concatenate([getattr(p, f.name) for p in kept]) for f in fields(cls)})


@dataclass(frozen=True, eq=False)
class Glints(RowArrays):
    """Detections of balls in one or more frames.

    The positions are those of glints, or of the centres of outlines where the detector's ``point`` is "centre".
    """

    frame: Ints  # (n,)
    x: Array  # (n,): position, px; pixel centres are at whole numbers
    y: Array
    cov: Array  # (n, 2, 2): covariance of the position, px^2
    flux: Array  # (n,): counts above the background; of an outline its area, px^2
    background: Array  # (n,): counts per pixel
    flags: Ints  # (n,): sums of `PositionFlag`
    fixed: Array = field(default_factory=lambda: np.empty(0))
    """The part of ``cov`` that is the same in every frame of a ball at rest, px^2. Zero where it is not known."""

    def __post_init__(self) -> None:
        if len(self.fixed) == 0:
            object.__setattr__(self, "fixed", np.zeros_like(self.cov))

    @property
    def xy(self) -> Array:
        """Positions (n, 2), px."""
        return np.stack([self.x, self.y], axis=1)

    def put(self, rows: Any, part: Glints) -> None:
        """Replace the detections of ``rows`` by ``part``."""
        for column in fields(self):
            getattr(self, column.name)[rows] = getattr(part, column.name)

    @staticmethod
    def none() -> Glints:
        """No detections."""
        return Glints.at([], [], 1.0)

    @staticmethod
    def at(x: Any, y: Any, std: Any, flux: Any = 1.0, full: Any = False) -> Glints:
        """Detections of one frame from positions (n,), px; the other arguments are one for all or (n,).

        std: standard errors of x and of y, px, or covariances (n, 2, 2). full: whether a pixel is at the limit.
        """
        n = np.size(x)
        x, y, flux = (np.array(np.broadcast_to(np.asarray(v, np.float64), (n,))) for v in (x, y, flux))
        cov = std if np.ndim(std) == 3 else np.square(np.broadcast_to(std, (n,)))[:, None, None] * np.eye(2)
        flags = np.array(np.broadcast_to(np.where(full, PositionFlag.CLIPPED, 0), (n,)), np.int64)
        return Glints(np.zeros(n, np.int64), x, y, cov, flux, np.zeros(n), flags)


def describe_flags(flags: Ints) -> NDArray[np.str_]:
    """Flags (n,) as words joined by '|'; '' where there is none."""
    table = {value: "|".join(flag.word for flag in PositionFlag(value)) for value in np.unique(flags).tolist()}
    return np.array([table[v] for v in flags.tolist()], dtype=np.str_)
