"""Single places far off the smooth path through those before and after: no motion makes such, a tracker may."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from discrepancy.measured import Measured

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

REACH = 4  # frames to either side, of the same ball and phase, that say where a place should be
BESIDE = 2  # of them on either side at least: where a phase ends, the path may bend
FAR = 8.0  # sigma: noise never reaches that
SMOOTH = 2.0  # sigma, rms: what its neighbours may be off a smooth path themselves; a jump is no spike
NEAR = 10.0  # claimed standard deviations, median, that a model which is nearly right may be off
UNSURE = 0.25  # frames: by so much the contact may be misplaced
ASIDE, FEWEST, WITHIN = 5, 4, 7  # places of one side, at most and at least, and from how many frames


def without_spikes(
    clips: Sequence[Measured], expected: Sequence[Array] | None = None
) -> tuple[list[Measured], list[str]]:
    """The clips without their spikes, and a line for each clip that had some; arguments as for `spikes`."""
    kept, said = [], []
    for k, clip in enumerate(clips):
        found = sorted(spikes(clip, expected[k] if expected else None))
        if found:
            frames = ", ".join(map(str, sorted(set(clip.frame[found].tolist()))))
            many = f"{len(found)} of {len(clip.frame)} places, in frame {frames}"
            said.append(f"clip {clip.clip}: {many}, far off the path through those before and after")
        kept.append(clip.of(np.delete(np.arange(len(clip.frame)), found)) if found else clip)
    return kept, said


def spikes(clip: Measured, expected: Array | None = None) -> set[int]:
    """Rows that are spikes, the largest taken out first: what it does to its neighbours then goes too.

    expected: where a model has the places, (n, 2). If it is nearly right, what is off it bends little, but at the
    contact: spikes are then seen there too, where a slide ends, and at both ends of the clip.
    """
    paths, gone = _Paths.of(clip, expected), set[int]()
    if expected is not None and float(np.median(np.abs(paths.xy) / paths.claimed[:, None])) > NEAR:
        return gone
    typical: float | None = None
    while True:
        inner = paths.inner(gone)
        if typical is None:
            off = [look.off for look in inner.values()]
            typical = max(1.4826 * float(np.median(np.abs(off))), 1e-300) if off else 1.0
        wrong = {row: look for row, look in inner.items() if look.far(typical)}
        if expected is not None and not wrong:
            told = gone | {row for row, look in inner.items() if look.rest < SMOOTH * typical}
            outer = paths.outer((k for k in range(len(clip.frame)) if k not in told), gone, SMOOTH * typical)
            wrong = {row: look for row, look in outer if look.far(typical)}
        if not wrong:
            return gone
        gone.add(max(wrong, key=lambda row: float(np.abs(wrong[row].off).max())))


@dataclass(frozen=True)
class _Look:
    """How far a place is off the path through others, (2,), and the rms of these; in claimed standard deviations."""

    off: Array
    rest: float

    def far(self, typical: float) -> bool:
        """typical: the size of such numbers where there are only errors."""
        return bool(np.abs(self.off).max() > FAR * typical and self.rest < SMOOTH * typical)


@dataclass(frozen=True)
class _Path:
    """A parabola through some places: where it is at a frame, (2,), how fast there, (2,) a frame, and errors."""

    place: Array
    velocity: Array
    std: float
    rest: float


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
    def of(cls, clip: Measured, expected: Array | None) -> _Paths:
        if expected is None:
            return cls(clip.frame, clip.ball, clip.xy, clip.phase(), clip.claimed())
        contact, wide = clip.launch[2] * clip.fps, clip.exposure * clip.fps
        early, late = clip.frame + wide + UNSURE <= contact, clip.frame - UNSURE >= contact
        phase = np.where(early, 0, np.where(late, 1, -1))
        return cls(clip.frame, clip.ball, clip.xy - expected, phase, clip.claimed(), (wide + UNSURE) / 4)

    def _through(self, rows: Ints, row: int) -> _Path:
        """The smoothest path through them or through all but one, which may be a spike itself."""
        path = self._path(rows, row)
        if path.rest < SMOOTH or len(rows) <= FEWEST:
            return path
        return min((self._path(np.delete(rows, k), row) for k in range(len(rows))), key=lambda p: p.rest)

    def _path(self, rows: Ints, row: int) -> _Path:
        design = np.vander((self.frame[rows] - self.frame[row]) / REACH, 3, increasing=True)
        inverse = np.linalg.pinv(design)
        fitted = inverse @ self.xy[rows]
        left = (self.xy[rows] - design @ fitted) / self.claimed[rows, None]
        rest = float(np.sqrt((left**2).sum() / (2 * (len(rows) - 3))))
        return _Path(fitted[0], fitted[1] / REACH, float(np.linalg.norm(self.claimed[rows] * inverse[0])), rest)

    def inner(self, gone: set[int]) -> dict[int, _Look]:
        """Of the places that have neighbours of their phase on both sides, how far they are off the path through these.

        What the path itself is uncertain by is allowed for.
        """
        found: dict[int, _Look] = {}
        for p in range(3):
            for ball in range(2):
                every = np.flatnonzero((self.phase == p) & (self.ball == ball))
                rows = np.array([k for k in every.tolist() if k not in gone], dtype=int)
                for row in rows.tolist():
                    off = self.frame[rows] - self.frame[row]
                    near = rows[(np.abs(off) <= REACH) & (off != 0)]
                    early = int(np.sum(near < row))
                    if min(early, len(near) - early) >= BESIDE and len(near) > 2 * BESIDE:
                        path = self._through(near, row)
                        std = np.hypot(self.claimed[row], path.std)
                        found[row] = _Look((self.xy[row] - path.place) / std, path.rest)
        return found

    def outer(self, rows: Iterable[int], gone: set[int], smooth: float) -> Iterator[tuple[int, _Look]]:
        """Of others, how far they are beyond where those before lead and where those after come from.

        One of these is enough where there is no event between them. smooth: rms of those that tell.
        """
        for row in rows:
            sides = [s for s in (self._side(row, way, gone) for way in (-1, 1)) if s and s.rest < smooth]
            event = self.phase[row] < 0
            if len(sides) < 1 + event:
                continue
            places = np.array([s.place for s in sides])
            bent = self.unsure * np.abs(sides[0].velocity - sides[-1].velocity) * event
            x, std = self.xy[row], np.hypot(self.claimed[row], max(s.std for s in sides))
            beyond = np.maximum(places.min(axis=0) - bent - x, x - places.max(axis=0) - bent)
            yield row, _Look(np.maximum(beyond, 0.0) / std, max(s.rest for s in sides))

    def _side(self, row: int, way: int, gone: set[int]) -> _Path | None:
        """Through the next of the same ball on one side, in the same phase or beside an event; None: too few."""
        phase = self.phase[row] if self.phase[row] >= 0 else (way + 1) // 2
        off = way * (self.frame - self.frame[row])
        near = np.flatnonzero((self.ball == self.ball[row]) & (self.phase == phase) & (off > 0) & (off <= WITHIN))
        kept = [k for k in near[np.argsort(off[near])].tolist() if k not in gone][:ASIDE]
        return self._through(np.array(kept), row) if len(kept) >= FEWEST else None
