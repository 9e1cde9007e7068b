"""Single places far off the smooth path through those before and after: no motion makes such, a tracker may."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from discrepancy.arrays import Array, Ints
from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import T_C
from discrepancy.policy import current_policy

REACH = 4  # frames to either side, of the same ball and phase, that say where a place should be
BESIDE = 2  # of them on either side at least: where a phase ends, the path may bend
ASIDE, FEWEST, WITHIN = 5, 4, 7  # places of one side, at most and at least, and from how many frames


def remove_outliers(
    clips: Sequence[MeasuredCollision], expected: Sequence[Array] | None = None
) -> list[MeasuredCollision]:
    """Take the outlier points out of clips.

    Parameters
    ----------
    clips : sequence of Measured
    expected : sequence of (n, 2) array, optional
        Positions that a model predicts for each clip, m; see `find_outliers`. Outliers that both balls or several
        clips have in the same frame are then kept: they are a fault of the clock.

    Returns
    -------
    list of Measured
    """
    found = [find_outliers(clip, expected[k] if expected else None) for k, clip in enumerate(clips)]
    if expected:
        both = [Counter(c.frame[sorted(rows)].tolist()) for c, rows in zip(clips, found, strict=True)]
        often = Counter(frame for own in both for frame in own)
        for c, own, rows in zip(clips, both, found, strict=True):
            rows -= {
                k
                for k in rows
                if own[int(c.frame[k])] > 1 or often[int(c.frame[k])] >= current_policy().same_frame_clips
            }
    return [
        c.select(np.delete(np.arange(len(c.frame)), sorted(r))) if r else c for c, r in zip(clips, found, strict=True)
    ]


def describe_removed_points(clips: Sequence[MeasuredCollision], kept: Sequence[MeasuredCollision]) -> list[str]:
    """A line for each clip that lost positions between `clips` and `kept`, with their frames."""
    left, said = {c.clip: set(zip(c.ball.tolist(), c.frame.tolist(), strict=True)) for c in kept}, []
    for c in clips:
        gone = [f for b, f in zip(c.ball.tolist(), c.frame.tolist(), strict=True) if (b, f) not in left[c.clip]]
        if gone:
            frames = ", ".join(map(str, sorted(set(gone))))
            places = f"{len(gone)} of {len(c.frame)} places, in frame {frames}"
            said.append(f"clip {c.clip}: {places}, far off the path through those before and after")
    return said


def find_outliers(clip: MeasuredCollision, expected: Array | None = None) -> set[int]:
    """Rows that are outliers, the largest taken out first: what it does to its neighbours then goes too.

    expected: where a model has the places, (n, 2). If it is nearly right, what is off it bends little, but at the
    contact: outliers are then seen there too, where a slide ends, and at both ends of the clip.
    """
    paths, gone = _Paths.of(clip, expected), set[int]()
    if (
        expected is not None
        and float(np.median(np.abs(paths.xy) / paths.claimed[:, None])) > current_policy().max_model_error_sigma
    ):
        return gone
    todo = range(len(clip.frame))
    inner = paths.inner(todo, gone)
    typical = max(1.4826 * float(np.median(np.abs([o.off for o in inner.values()]))), 1e-300) if inner else 1.0
    outer: dict[int, _Offset] | None = None
    while True:
        wrong = {row: offset for row, offset in inner.items() if offset.far(typical)}
        if expected is not None and not wrong:
            if outer is None:
                outer = paths.outer(todo, gone, current_policy().max_neighbour_rms * typical)
            told = {row for row, offset in inner.items() if offset.rest < current_policy().max_neighbour_rms * typical}
            wrong = {row: offset for row, offset in outer.items() if row not in told and offset.far(typical)}
        if not wrong:
            return gone
        worst = max(wrong, key=lambda row: float(np.abs(wrong[row].off).max()))
        gone.add(worst)
        near = paths.near(worst)
        inner = {row: offset for row, offset in inner.items() if row not in near} | paths.inner(near, gone)
        if outer is not None:
            again = paths.outer(near, gone, current_policy().max_neighbour_rms * typical)
            outer = {row: offset for row, offset in outer.items() if row not in near} | again


@dataclass(frozen=True)
class _Offset:
    """How far a place is off the path through others, (2,), and the rms of these; in claimed standard deviations."""

    off: Array
    rest: float

    def far(self, typical: float) -> bool:
        """typical: the size of such numbers where there are only errors."""
        return bool(
            np.abs(self.off).max() > current_policy().outlier_position_sigma * typical
            and self.rest < current_policy().max_neighbour_rms * typical
        )


@dataclass(frozen=True)
class _Path:
    """A parabola through some places: where it is at a frame, (2,), how fast there, (2,) a frame, and errors."""

    place: Array
    velocity: Array
    std: float
    rest: float


@lru_cache(maxsize=4096)
def _parabola(frames: tuple[int, ...]) -> tuple[Array, Array]:
    """Places (n, 3) at these frames by the coefficients of a parabola, and the inverse of that."""
    design = np.vander(np.array(frames) / REACH, 3, increasing=True)
    return design, np.asarray(np.linalg.pinv(design))


@dataclass(frozen=True)
class _Paths:
    """frame, ball (n,); xy (n, 2), m; phase (n,), -1 in an exposure that holds an event; claimed (n,), m.

    unsure: in frames, a quarter of the time in which that event may be.
    """

    frame: Ints
    ball: Ints
    xy: Array
    phase: Ints
    claimed: Array
    unsure: float = 0.0

    @classmethod
    def of(cls, clip: MeasuredCollision, expected: Array | None) -> _Paths:
        if expected is None:
            return cls(clip.frame, clip.ball, clip.xy, clip.phases(), clip.claimed_std())
        contact, wide = clip.launch[T_C] * clip.fps, clip.exposure * clip.fps
        early, late = (
            clip.frame + wide + current_policy().contact_error_frames <= contact,
            clip.frame - current_policy().contact_error_frames >= contact,
        )
        phase = np.where(early, 0, np.where(late, 1, -1))
        return cls(
            clip.frame,
            clip.ball,
            clip.xy - expected,
            phase,
            clip.claimed_std(),
            (wide + current_policy().contact_error_frames) / 4,
        )

    def _through(self, rows: Ints, row: int) -> _Path:
        """The smoothest path through them or through all but one, which may be an outlier itself."""
        path = self._path(rows, row)
        if path.rest < current_policy().max_neighbour_rms or len(rows) <= FEWEST:
            return path
        return min((self._path(np.delete(rows, k), row) for k in range(len(rows))), key=lambda p: p.rest)

    def _path(self, rows: Ints, row: int) -> _Path:
        design, inverse = _parabola(tuple((self.frame[rows] - self.frame[row]).tolist()))
        fitted = inverse @ self.xy[rows]
        left = (self.xy[rows] - design @ fitted) / self.claimed[rows, None]
        rest = float(np.sqrt((left**2).sum() / (2 * (len(rows) - 3))))
        return _Path(fitted[0], fitted[1] / REACH, float(np.linalg.norm(self.claimed[rows] * inverse[0])), rest)

    def near(self, row: int) -> list[int]:
        """The rows whose offset an outlier there may have spoilt, itself among them."""
        within = np.abs(self.frame - self.frame[row]) <= WITHIN
        return np.flatnonzero(within & (self.ball == self.ball[row])).tolist()

    def inner(self, rows: Iterable[int], gone: set[int]) -> dict[int, _Offset]:
        """How far these rows are off the smooth path through their neighbours, where they have some on both sides.

        Neighbours are positions of the same ball and phase. The path's own uncertainty is allowed for.
        """
        found: dict[int, _Offset] = {}
        for row in rows:
            if row in gone or self.phase[row] < 0:
                continue
            off = self.frame - self.frame[row]
            same = (self.phase == self.phase[row]) & (self.ball == self.ball[row])
            near = self._kept(same & (np.abs(off) <= REACH) & (off != 0), gone)
            early = int(np.sum(off[near] < 0))
            if min(early, len(near) - early) >= BESIDE and len(near) > 2 * BESIDE:
                path = self._through(near, row)
                std = np.hypot(self.claimed[row], path.std)
                found[row] = _Offset((self.xy[row] - path.place) / std, path.rest)
        return found

    def outer(self, rows: Iterable[int], gone: set[int], smooth: float) -> dict[int, _Offset]:
        """How far these rows are off both paths that the positions before and after them make, continued to there.

        One path is enough where there is no event between. Paths that are rougher than `smooth` (rms) do not count.
        """
        found: dict[int, _Offset] = {}
        for row in rows:
            if row in gone:
                continue
            sides = [s for s in (self._side(row, way, gone) for way in (-1, 1)) if s and s.rest < smooth]
            event = self.phase[row] < 0
            if len(sides) < 1 + event:
                continue
            places = np.array([s.place for s in sides])
            bent = self.unsure * np.abs(sides[0].velocity - sides[-1].velocity) * event
            x, std = self.xy[row], np.hypot(self.claimed[row], max(s.std for s in sides))
            beyond = np.maximum(places.min(axis=0) - bent - x, x - places.max(axis=0) - bent)
            found[row] = _Offset(np.maximum(beyond, 0.0) / std, max(s.rest for s in sides))
        return found

    def _side(self, row: int, way: int, gone: set[int]) -> _Path | None:
        """Through the next of the same ball on one side, in the same phase or beside an event; None: too few."""
        phase = self.phase[row] if self.phase[row] >= 0 else (way + 1) // 2
        off = way * (self.frame - self.frame[row])
        near = self._kept((self.ball == self.ball[row]) & (self.phase == phase) & (off > 0) & (off <= WITHIN), gone)
        kept = near[np.argsort(off[near], kind="stable")][:ASIDE]
        return self._through(kept, row) if len(kept) >= FEWEST else None

    def _kept(self, mask: NDArray[np.bool_], gone: set[int]) -> Ints:
        return np.array([k for k in np.flatnonzero(mask).tolist() if k not in gone], dtype=np.int64)
