"""Removes single positions that no smooth motion explains: they lie far off a parabola through their neighbours."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from discrepancy.arrays import Array, Ints
from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import T_C
from discrepancy.data.notes import SearchNote, SearchNoteKind
from discrepancy.policy import SearchPolicy, current_policy

NEIGHBOUR_FRAMES = 4  # frames to either side whose positions predict one between them
ONE_SIDE_FRAMES = 7  # frames to one side whose positions predict the next one
MIN_PATH_POSITIONS = 4  # of such a path


def remove_outliers(
    clips: Sequence[MeasuredCollision], expected: Sequence[Array] | None = None
) -> list[MeasuredCollision]:
    """Remove outliers, single positions that no smooth motion explains, from clips.

    expected: positions (n, 2) that a model predicts for each clip, m; see `find_outliers`. An outlier that both balls,
    or several clips, have in the same frame is then kept: it is a fault of the clock.
    """
    found = [find_outliers(clip, expected[k] if expected else None) for k, clip in enumerate(clips)]
    if expected:
        both = [Counter(c.frame[sorted(rows)].tolist()) for c, rows in zip(clips, found, strict=True)]
        often = Counter(frame for own in both for frame in own)
        same = {frame for frame, count in often.items() if count >= current_policy().same_frame_clips}
        for c, own, rows in zip(clips, both, found, strict=True):
            rows -= {k for k in rows if own[int(c.frame[k])] > 1 or int(c.frame[k]) in same}
    kept = (np.delete(np.arange(len(c.frame)), sorted(rows)) for c, rows in zip(clips, found, strict=True))
    return [c.select(k) if rows else c for c, rows, k in zip(clips, found, kept, strict=True)]


def note_removed_points(clips: Sequence[MeasuredCollision], kept: Sequence[MeasuredCollision]) -> list[SearchNote]:
    """Note for each clip which outlier positions it lost between `clips` and `kept`, with their frames."""
    by_number, notes = {c.clip: c for c in kept}, []
    same_order = [c.clip for c in clips] == [c.clip for c in kept]  # stretches of a crowd have one number
    for c, own in zip(clips, kept if same_order else [by_number[c.clip] for c in clips], strict=True):
        left = set(zip(own.ball.tolist(), own.frame.tolist(), strict=True))
        gone = [f for b, f in zip(c.ball.tolist(), c.frame.tolist(), strict=True) if (b, f) not in left]
        if gone:
            count = {"count": len(gone), "total": len(c.frame)}
            notes.append(SearchNote(SearchNoteKind.OUTLIERS, c.clip, tuple(sorted(set(gone))), count))
    return notes


def find_outliers(clip: MeasuredCollision, expected: Array | None = None) -> set[int]:
    """Find the rows of single outlier positions, which lie far off a parabola through their neighbours.

    A position is compared with a parabola through its neighbours of the same ball and phase. It is an outlier if it is
    more than `SearchPolicy.outlier_position_sigma` typical distances off and the neighbours themselves are smooth. The
    worst outlier is removed first and its neighbours are tested again, because it distorts their parabolas.

    expected: positions (n, 2) that a model predicts, m. If the model is nearly right, its residuals are smooth through
    a slide's end too. Outliers are then also found near events and at both ends of the clip: positions outside both
    extrapolations, from the past and from the future.
    """
    policy, paths = current_policy(), _Paths.of(clip, expected)
    if expected is not None and np.median(np.abs(paths.xy) / paths.claimed[:, None]) > policy.max_model_error_sigma:
        return set()
    every = range(len(clip.frame))
    inner = paths.inner(every)
    typical = max(1.4826 * float(np.median(np.abs([o.off for o in inner.values()]))), 1e-300) if inner else 1.0
    smooth = policy.max_neighbour_rms * typical
    outer: dict[int, _Offset] | None = None
    while True:
        wrong = {row: offset for row, offset in inner.items() if offset.is_outlier(typical, policy)}
        if expected is not None and not wrong:
            if outer is None:
                outer = paths.outer(every, smooth)
            explained = {row for row, offset in inner.items() if offset.rest < smooth}
            wrong = {row: o for row, o in outer.items() if row not in explained and o.is_outlier(typical, policy)}
        if not wrong:
            return paths.gone
        worst = max(wrong, key=lambda row: float(np.abs(wrong[row].off).max()))
        paths.gone.add(worst)
        near = paths.near(worst)
        inner = {row: offset for row, offset in inner.items() if row not in near} | paths.inner(near)
        if outer is not None:
            outer = {row: offset for row, offset in outer.items() if row not in near} | paths.outer(near, smooth)


@dataclass(frozen=True)
class _Offset:
    """A position's distance from the path through others, (2,), and the rms of these; in claimed deviations."""

    off: Array
    rest: float

    def is_outlier(self, typical: float, policy: SearchPolicy) -> bool:
        """typical: the size of such distances where there are only errors."""
        far = bool(np.abs(self.off).max() > policy.outlier_position_sigma * typical)
        return far and self.rest < policy.max_neighbour_rms * typical


@dataclass(frozen=True)
class _Parabola:
    """A parabola through positions: its position (2,) and velocity (2,) per frame at one frame, its error, its rms."""

    position: Array
    velocity: Array
    std: float
    rest: float


@lru_cache(maxsize=4096)
def _parabola(frames: tuple[int, ...]) -> tuple[Array, Array]:
    """Design matrix (n, 3) of a parabola at these frames, and its pseudoinverse."""
    design = np.vander(np.array(frames) / NEIGHBOUR_FRAMES, 3, increasing=True)
    return design, np.asarray(np.linalg.pinv(design))


@dataclass(frozen=True)
class _Paths:
    """The rows of a clip, and those that are removed as outliers."""

    frame: Ints  # (n,)
    ball: Ints  # (n,)
    xy: Array  # (n, 2), m; less the positions that a model predicts
    phase: Ints  # (n,), -1 in an exposure that holds an event
    claimed: Array  # (n,), m
    max_rms: float  # of a path that needs no position left out, in claimed deviations
    unsure: float = 0.0  # a quarter of the time in which that event may be, frames
    gone: set[int] = field(default_factory=set)

    @classmethod
    def of(cls, clip: MeasuredCollision, expected: Array | None) -> _Paths:
        policy, claimed = current_policy(), clip.claimed_std()
        if expected is None:
            return cls(clip.frame, clip.ball, clip.xy, clip.phases(), claimed, policy.max_neighbour_rms)
        contact, wide, error = clip.launch[T_C] * clip.fps, clip.exposure * clip.fps, policy.contact_error_frames
        phases = [clip.frame + wide + error <= contact, clip.frame - error >= contact]
        phase = np.select(phases, [0, 1], -1)
        unsure = (wide + error) / 4
        return cls(clip.frame, clip.ball, clip.xy - expected, phase, claimed, policy.max_neighbour_rms, unsure)

    def _through(self, rows: Ints, row: int) -> _Parabola:
        """The smoothest path through these rows, or through all but one, which may be an outlier itself."""
        path = self._path(rows, row)
        if path.rest < self.max_rms or len(rows) <= MIN_PATH_POSITIONS:
            return path
        return min((self._path(np.delete(rows, k), row) for k in range(len(rows))), key=lambda p: p.rest)

    def _path(self, rows: Ints, row: int) -> _Parabola:
        design, inverse = _parabola(tuple((self.frame[rows] - self.frame[row]).tolist()))
        fitted = inverse @ self.xy[rows]
        left = (self.xy[rows] - design @ fitted) / self.claimed[rows, None]
        std, rest = np.linalg.norm(self.claimed[rows] * inverse[0]), np.sqrt((left**2).sum() / (2 * (len(rows) - 3)))
        return _Parabola(fitted[0], fitted[1] / NEIGHBOUR_FRAMES, float(std), float(rest))

    def near(self, row: int) -> list[int]:
        """The rows whose distances an outlier in this row distorts, itself among them."""
        within = np.abs(self.frame - self.frame[row]) <= ONE_SIDE_FRAMES
        return np.flatnonzero(within & (self.ball == self.ball[row])).tolist()

    def inner(self, rows: Iterable[int]) -> dict[int, _Offset]:
        """Distances of these rows from the path through their neighbours, of those with two or more on either side.

        Neighbours are positions of the same ball and phase. The distance is in units of the total standard deviation,
        the path's included.
        """
        found: dict[int, _Offset] = {}
        for row in rows:
            if row in self.gone or self.phase[row] < 0:
                continue
            off = self.frame - self.frame[row]
            near = self._neighbours(row, self.phase[row], (np.abs(off) <= NEIGHBOUR_FRAMES) & (off != 0))
            early = int(np.sum(off[near] < 0))
            if min(early, len(near) - early) >= 2 and len(near) > 4:
                path = self._through(near, row)
                std = np.hypot(self.claimed[row], path.std)
                found[row] = _Offset((self.xy[row] - path.position) / std, path.rest)
        return found

    def outer(self, rows: Iterable[int], smooth: float) -> dict[int, _Offset]:
        """Distances of these rows from the interval between two extrapolations, from the past and from the future.

        One extrapolation is enough where no event is near. Paths with an rms above `smooth` do not count.
        """
        found: dict[int, _Offset] = {}
        for row in rows:
            if row in self.gone:
                continue
            both = (self._extrapolate(row, direction) for direction in (-1, 1))
            sides = [side for side in both if side and side.rest < smooth]
            event = self.phase[row] < 0
            if len(sides) < 1 + event:
                continue
            ends = np.array([s.position for s in sides])
            bent = self.unsure * np.abs(sides[0].velocity - sides[-1].velocity) * event
            x, std = self.xy[row], np.hypot(self.claimed[row], max(s.std for s in sides))
            beyond = np.maximum(ends.min(axis=0) - bent - x, x - ends.max(axis=0) - bent)
            found[row] = _Offset(np.maximum(beyond, 0.0) / std, max(s.rest for s in sides))
        return found

    def _extrapolate(self, row: int, direction: int) -> _Parabola | None:
        """The path through the next five of the ball on one side, in one phase; None where they are too few."""
        phase = self.phase[row] if self.phase[row] >= 0 else (direction + 1) // 2
        off = direction * (self.frame - self.frame[row])
        near = self._neighbours(row, phase, (off > 0) & (off <= ONE_SIDE_FRAMES))
        kept = near[np.argsort(off[near], kind="stable")][:5]
        return self._through(kept, row) if len(kept) >= MIN_PATH_POSITIONS else None

    def _neighbours(self, row: int, phase: int, within: NDArray[np.bool_]) -> Ints:
        """The rows of the same ball in this phase, without those that are removed."""
        some = np.flatnonzero(within & (self.phase == phase) & (self.ball == self.ball[row]))
        return np.array([k for k in some.tolist() if k not in self.gone], dtype=np.int64)
