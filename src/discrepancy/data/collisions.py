"""A measured collision: both balls' positions in metres, their claimed errors, and a first guess of the launch."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from itertools import product

import numpy as np

from discrepancy.data.launch import MEETS_NOTHING, T_C, B
from discrepancy.policy import current_policy
from synthcam_shared.arrays import Array, Ints, inverse_roots
from tracker.camera.camera import Camera


class EvidenceUnit(Enum):
    """The unit of evidence of a search; its value is the word for several."""

    COLLISION = "collisions"
    STRETCH = "stretches"

    def __str__(self) -> str:
        return self.value

    @property
    def one(self) -> str:
        """The word for one."""
        return self.name.lower()


@dataclass(frozen=True)
class MeasuredCollision:
    """One measured collision: rows sorted by ball, then by frame; ball 0 is the target (1 in files), 1 the striker."""

    clip: int  # the clip's number
    striker: str  # "a" or "b", the ball's name in a scene
    camera: Camera
    frame: Ints  # (n,)
    ball: Ints  # (n,)
    xy: Array  # (n, 2) centres on the plate, m, averaged over the exposure
    covariance: Array  # (n, 2, 2) as the tracks claim it, m^2
    launch: Array  # (6,) or (9,) a first guess, columns as in `discrepancy.data.launch`
    slide_ends: Array  # (2,) a first guess of the time at which each ball stops sliding, s
    # Standard deviation, per axis, of the resting target's error that is the same in all frames, m. The covariance does
    # not contain it.
    offset: float = 0.0
    max_shift_frames: float = 0.0  # largest time shift of a position to an even frame rate; 0 where times are even
    # (n, 2, n, 2) covariance, m^2, of what differs from stretch to stretch: see `discrepancy.fitting.stretch_scatter`.
    # None: nothing does.
    scatter: Array | None = None

    @property
    def is_stretch(self) -> bool:
        """True for the free stretch of one ball: see `discrepancy.data.stretches`."""
        return float(self.launch[B]) == MEETS_NOTHING

    @property
    def fps(self) -> float:
        return self.camera.fps

    @property
    def exposure(self) -> float:
        return self.camera.exposure

    def select(self, rows: Ints) -> MeasuredCollision:
        """The same collision with only these rows."""
        some = {name: getattr(self, name)[rows] for name in ("frame", "ball", "xy", "covariance")}
        scatter = None if self.scatter is None else self.scatter[rows][:, :, rows]
        return replace(self, **some, scatter=scatter)

    def phases(self) -> Ints:
        """(n,): 0 before the contact, 1 sliding, 2 rolling, -1 where the exposure contains the change between them."""
        opens = self.frame / self.fps
        closes = opens + self.exposure
        contact, end = self.launch[T_C], self.slide_ends[self.ball]
        late = opens >= contact
        phases = [late & (opens >= end), late & (closes <= end), closes <= contact]
        return np.select(phases, [2, 1, 0], -1)

    def stretch_rows(self) -> Iterator[Ints]:
        """The rows of each stretch: one ball in one phase, without long gaps."""
        phase = self.phases()
        for p, b in product(range(3), range(2)):
            rows = np.flatnonzero((phase == p) & (self.ball == b))
            yield from _split_at_gaps(rows, self.frame[rows])

    def smooth_stretches(self) -> Iterator[tuple[Array, Array, Ints]]:
        """Stretches of one ball in one phase: positions (n, 2) and claimed std (n,), m, and frames (n,)."""
        claimed = self.claimed_std()
        for rows in self.stretch_rows():
            yield self.xy[rows], claimed[rows], self.frame[rows]

    def paired_stretches(self) -> Iterator[tuple[Array, Array, Array, Array, Ints]]:
        """Stretches of both balls: positions (n, 2) of either, claimed std (n,) of either, m, and frames (n,)."""
        phase, claimed = self.phases(), self.claimed_std()
        split = int(np.sum(self.ball == 0))
        frame, one, two = np.intersect1d(self.frame[:split], self.frame[split:], return_indices=True)
        two = two + split
        for p, q in product(range(3), repeat=2):
            rows = np.flatnonzero((phase[one] == p) & (phase[two] == q))
            for kept in _split_at_gaps(rows, frame[rows]):
                i, j = one[kept], two[kept]
                yield self.xy[i], self.xy[j], claimed[i], claimed[j], frame[kept]

    def claimed_std(self) -> Array:
        """Standard deviation that the tracks claim for each row, (n,), m: the rms of both axes."""
        return np.asarray(np.sqrt(np.trace(self.covariance, axis1=1, axis2=2) / 2))

    @cached_property
    def roots(self) -> Array:
        """Inverse Cholesky factors of the claimed covariances, (n, 2, 2)."""
        return inverse_roots(self.covariance)

    @cached_property
    def resting_offset(self) -> Array:
        """`offset` in claimed standard deviations where the target rests, else zero: (n,)."""
        return np.where((self.ball == 0) & (self.phases() == 0), self.offset / self.claimed_std(), 0.0)


def _split_at_gaps(rows: Ints, frame: Ints) -> Iterator[Ints]:
    """Rows in runs without long gaps between frames, less a margin at either end."""
    margin = current_policy().event_margin_frames
    for part in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(frame) > current_policy().max_frame_gap) + 1):
        if len(part):
            off = frame[part] - frame[part[0]]
            yield rows[part[(off >= margin) & (off <= off[-1] - margin)]]
