"""Tracks in metres: where each ball was, when, and how well that is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from .geometry import Camera
    from .link import Tracks

Floats = NDArray[np.float64]
UNKNOWN_STD_PX = 0.1  # stands in where a table gives no covariance; the fit then finds the true scale itself


@dataclass(frozen=True)
class Course:
    """One ball's way over the plate, by frame.

    frame (n,) int; start (n,) s, start of the frame's exposure; place (n, 2) m, mean over the exposure;
    cov (n, 2, 2) m^2; weighed: False where the covariances are a stand-in whose scale is not known.
    """

    particle: int
    frame: NDArray[np.int64]
    start: Floats
    place: Floats
    cov: Floats
    exposure: float
    weighed: bool = True

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def time(self) -> Floats:
        """(n,) s, middle of each exposure."""
        return self.start + self.exposure / 2

    def where(self, rows: NDArray[np.bool_]) -> Course:
        """The same ball, only those rows."""
        return Course(
            self.particle, self.frame[rows], self.start[rows], self.place[rows], self.cov[rows],
            self.exposure, self.weighed,
        )  # fmt: skip


def courses(tracks: Tracks, camera: Camera) -> list[Course]:
    """One Course per particle, in order of particle number; rows without a finite place are left out."""
    xy = np.column_stack([tracks.x, tracks.y]).astype(np.float64)
    keep = np.isfinite(xy).all(axis=1)
    frame, particle = np.asarray(tracks.frame)[keep].astype(np.int64), np.asarray(tracks.particle)[keep]
    place, slope = camera.unproject(xy[keep])
    pixel = np.asarray(tracks.cov, dtype=np.float64)[keep]
    determinant = pixel[:, 0, 0] * pixel[:, 1, 1] - pixel[:, 0, 1] * pixel[:, 1, 0]
    weighed = len(pixel) > 0 and bool(np.all((determinant > 0) & (pixel[:, 0, 0] > 0)))  # NaN fails both
    if not weighed:
        pixel = np.broadcast_to(np.eye(2) * UNKNOWN_STD_PX**2, pixel.shape)
    cov = slope @ pixel @ np.swapaxes(slope, 1, 2)
    start = frame / camera.fps
    found = []
    for ball in np.unique(particle):
        rows = np.flatnonzero(particle == ball)
        rows = rows[np.unique(frame[rows], return_index=True)[1]]  # in order; a frame given twice counts once
        found.append(Course(int(ball), frame[rows], start[rows], place[rows], cov[rows], camera.exposure, weighed))
    return found
