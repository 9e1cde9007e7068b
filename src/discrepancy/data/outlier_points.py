"""Removes single positions that no smooth motion explains: they lie far off a parabola through their neighbours."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import T_C
from discrepancy.data.notes import SearchNote, SearchNoteKind
from discrepancy.policy import SearchPolicy, current_policy
from synthcam_shared.arrays import Array, Flags, Ints

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
    by_number, removed = {c.clip: c for c in kept}, dict[int, list[int]]()
    totals = Counter[int]()
    same_order = [c.clip for c in clips] == [c.clip for c in kept]  # stretches of a crowd have one number
    for c, own in zip(clips, kept if same_order else [by_number[c.clip] for c in clips], strict=True):
        left = set(zip(own.ball.tolist(), own.frame.tolist(), strict=True))
        gone = [f for b, f in zip(c.ball.tolist(), c.frame.tolist(), strict=True) if (b, f) not in left]
        removed.setdefault(c.clip, []).extend(gone)
        totals[c.clip] += len(c.frame)
    return [
        SearchNote(
            SearchNoteKind.OUTLIERS, number, tuple(sorted(set(gone))), {"count": len(gone), "total": totals[number]}
        )
        for number, gone in removed.items()
        if gone
    ]


def find_outliers(clip: MeasuredCollision, expected: Array | None = None) -> set[int]:
    """Find the rows of single outlier positions, which lie far off a parabola through their neighbours.

    A position is compared with a parabola through its neighbours of the same ball and phase. It is an outlier if it is
    more than `SearchPolicy.outlier_position_sigma` typical distances off and the neighbours themselves are smooth. The
    worst outlier is removed first and the others are tested again, because it distorts the parabolas of its neighbours.

    expected: positions (n, 2) that a model predicts, m. If the model is nearly right, its residuals are smooth through
    a slide's end too. Outliers are then also found near events and at both ends of the clip: positions outside both
    extrapolations, from the past and from the future.
    """
    policy, paths = current_policy(), _Paths.of(clip, expected)
    if expected is not None and np.median(np.abs(paths.xy) / paths.claimed[:, None]) > policy.max_model_error_sigma:
        return set()
    offsets = paths.inner()
    known = np.isfinite(offsets.rest)
    typical = max(1.4826 * float(np.median(np.abs(offsets.off[known]))), 1e-300) if known.any() else 1.0
    smooth = policy.max_neighbour_rms * typical
    while True:
        size = offsets.outlier_sizes(typical, policy)
        if expected is not None and not size.any():
            size = np.where(offsets.rest < smooth, 0.0, paths.outer(smooth).outlier_sizes(typical, policy))
        if not size.any():
            return set(np.flatnonzero(paths.gone).tolist())
        paths.gone[np.argmax(size)] = True
        offsets = paths.inner()


@dataclass(frozen=True)
class _Offsets:
    """Distances of positions from the paths through others, in claimed deviations; NaN where there is no path."""

    off: Array  # (n, 2)
    rest: Array  # (n,): rms of the others about their path

    def outlier_sizes(self, typical: float, policy: SearchPolicy) -> Array:
        """The distance (n,) of each outlier, 0 for others; typical: of positions where there are only errors."""
        size = np.abs(self.off).max(axis=1)
        far = size > policy.outlier_position_sigma * typical
        return np.where(far & (self.rest < policy.max_neighbour_rms * typical), size, 0.0)


@dataclass(frozen=True)
class _Parabolas:
    """Parabolas through other positions, each evaluated at the frame of its row; NaN for rows without one."""

    values: Array  # (n, 6), in the order of the properties

    @property
    def position(self) -> Array:
        return self.values[:, :2]

    @property
    def velocity(self) -> Array:
        """Per frame."""
        return self.values[:, 2:4]

    @property
    def std(self) -> Array:
        """Errors of the positions."""
        return self.values[:, 4]

    @property
    def rest(self) -> Array:
        """The rms of the other positions about each parabola, in claimed deviations."""
        return self.values[:, 5]


@lru_cache(maxsize=4096)
def _parabola(frames: tuple[int, ...]) -> tuple[Array, Array]:
    """Design matrix (n, 3) of a parabola at these frames, and its pseudoinverse."""
    design = np.vander(np.array(frames) / NEIGHBOUR_FRAMES, 3, increasing=True)
    return design, np.asarray(np.linalg.pinv(design))


@dataclass(frozen=True)
class _Paths:
    """The rows of a clip, and those that are removed as outliers.

    The window of a row holds the rows of its ball nearest to it in time, `ONE_SIDE_FRAMES` on either side, in order.
    """

    xy: Array  # (n, 2), m; less the positions that a model predicts
    phase: Ints  # (n,), -1 in an exposure that holds an event
    claimed: Array  # (n,), m
    max_rms: float  # of a path that needs no position left out, in claimed deviations
    window: Ints  # (n, w): rows
    ahead: Ints  # (n, w): by how many frames they are later; far where there is no such row
    gone: Flags  # (n,)
    unsure: float = 0.0  # a quarter of the time in which that event may be, frames

    @classmethod
    def of(cls, clip: MeasuredCollision, expected: Array | None) -> _Paths:
        policy, claimed, count = current_policy(), clip.claimed_std(), len(clip.frame)
        order = np.lexsort((clip.frame, clip.ball))
        places = np.argsort(order)[:, None] + np.arange(-ONE_SIDE_FRAMES, ONE_SIDE_FRAMES + 1)
        window = order[np.clip(places, 0, count - 1)]
        there = (places >= 0) & (places < count) & (clip.ball[window] == clip.ball[:, None])
        ahead = np.where(there, clip.frame[window] - clip.frame[:, None], 2 * ONE_SIDE_FRAMES)
        xy, phase, unsure = clip.xy, clip.phases(), 0.0
        if expected is not None:
            contact, wide, error = clip.launch[T_C] * clip.fps, clip.exposure * clip.fps, policy.contact_error_frames
            phases = [clip.frame + wide + error <= contact, clip.frame - error >= contact]
            xy, phase, unsure = clip.xy - expected, np.select(phases, [0, 1], -1), (wide + error) / 4
        gone = np.zeros(count, dtype=np.bool_)
        return cls(xy, phase, claimed, policy.max_neighbour_rms, window, ahead, gone, unsure)

    def inner(self) -> _Offsets:
        """Distances of positions from the path through their neighbours, of those with two or more on either side.

        Neighbours are positions of the same ball and phase. The distance is in units of the total standard deviation,
        the path's included.
        """
        near = self._in_phase(self.phase) & (np.abs(self.ahead) <= NEIGHBOUR_FRAMES) & (self.ahead != 0)
        sides = [(near & (sign * self.ahead > 0)).sum(axis=1) for sign in (-1, 1)]
        some = (np.minimum(*sides) >= 2) & (sum(sides) > 4) & ~self.gone & (self.phase >= 0)
        path = self._fit_smoothest(near & some[:, None])
        return _Offsets((self.xy - path.position) / np.hypot(self.claimed, path.std)[:, None], path.rest)

    def outer(self, smooth: float) -> _Offsets:
        """Distances from the interval between two extrapolations of an rms up to `smooth`, or one without an event."""
        sides = [self._extrapolate(direction) for direction in (-1, 1)]
        seen, event = np.array([side.rest < smooth for side in sides]), self.phase < 0
        enough = (seen.sum(axis=0) >= 1 + event) & ~self.gone
        low = np.where(seen[..., None], [s.position for s in sides], np.inf).min(axis=0)
        high = np.where(seen[..., None], [s.position for s in sides], -np.inf).max(axis=0)
        bent = np.where(event[:, None], self.unsure * np.abs(sides[0].velocity - sides[1].velocity), 0.0)
        std = np.hypot(self.claimed, np.where(seen, [s.std for s in sides], 0.0).max(axis=0))
        beyond = np.maximum(low - bent - self.xy, self.xy - high - bent)
        off = np.where(enough[:, None], np.maximum(beyond, 0.0) / std[:, None], np.nan)
        return _Offsets(off, np.where(enough, np.where(seen, [s.rest for s in sides], 0.0).max(axis=0), np.nan))

    def _extrapolate(self, direction: int) -> _Parabolas:
        """The paths through the next five of the ball on one side, in one phase; none where they are too few."""
        phase = np.where(self.phase >= 0, self.phase, (direction + 1) // 2)
        off = direction * self.ahead
        some = self._in_phase(phase) & (off > 0) & (off <= ONE_SIDE_FRAMES)
        nearest = some & (np.cumsum(some[:, ::direction], axis=1)[:, ::direction] <= 5)
        return self._fit_smoothest(nearest & (nearest.sum(axis=1) >= MIN_PATH_POSITIONS)[:, None])

    def _in_phase(self, phase: Ints) -> Flags:
        """Which rows of each window are in this phase (n,) and not removed: (n, w)."""
        return np.asarray((self.phase[self.window] == phase[:, None]) & ~self.gone[self.window])

    def _fit_smoothest(self, near: Flags) -> _Parabolas:
        """The smoothest paths through these rows of each window, or through all but one, which may be an outlier."""
        best = self._fit(near)
        rough = ~(best.rest < self.max_rms) & (near.sum(axis=1) > MIN_PATH_POSITIONS)
        for column in np.flatnonzero((near & rough[:, None]).any(axis=0)).tolist():
            fewer = near & (rough & near[:, column])[:, None]
            fewer[:, column] = False
            other = self._fit(fewer)
            best = _Parabolas(np.where((other.rest < best.rest)[:, None], other.values, best.values))
        return best

    def _fit(self, near: Flags) -> _Parabolas:
        """The paths through these rows of each window; those with the same frames are fitted together."""
        values = np.full((len(near), 6), np.nan)
        frames = np.where(near, 1 << np.clip(self.ahead + ONE_SIDE_FRAMES, 0, 31), 0).sum(axis=1)
        for same in np.unique(frames[frames > 0]).tolist():
            rows = np.flatnonzero(frames == same)
            chosen = near[rows]
            others = self.window[rows][chosen].reshape(len(rows), -1)
            design, inverse = _parabola(tuple(self.ahead[rows[0]][chosen[0]].tolist()))
            xy, claimed = self.xy[others], self.claimed[others]
            fitted = inverse @ xy
            left = (xy - design @ fitted) / claimed[..., None]
            values[rows, :2], values[rows, 2:4] = fitted[:, 0], fitted[:, 1] / NEIGHBOUR_FRAMES
            values[rows, 4] = np.linalg.norm(claimed * inverse[0], axis=1)
            values[rows, 5] = np.sqrt((left**2).sum(axis=(1, 2)) / (2 * (len(design) - 3)))
        return _Parabolas(values)
