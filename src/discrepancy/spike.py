"""Single places far off the smooth path through those before and after: no motion makes such, a tracker may."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from discrepancy.measured import Measured

Array = NDArray[np.float64]

REACH = 4  # frames to either side, of the same ball and phase, that say where a place should be
BESIDE = 2  # of them on either side at least: where a phase ends, the path may bend
FAR = 8.0  # sigma: noise never reaches that
SMOOTH = 3.0  # sigma, rms: what its neighbours may be off a smooth path themselves; a jump is no spike


def without_spikes(clips: Sequence[Measured]) -> tuple[list[Measured], list[str]]:
    """The clips without their spikes, and a line for each clip that had some."""
    kept, said = [], []
    for clip in clips:
        found = sorted(spikes(clip))
        if found:
            frames = ", ".join(map(str, sorted(set(clip.frame[found].tolist()))))
            places = f"{len(found)} of {len(clip.frame)} places, in frame {frames}"
            said.append(f"clip {clip.clip}: {places}, far off the path through those before and after")
        kept.append(clip.of(np.delete(np.arange(len(clip.frame)), found)) if found else clip)
    return kept, said


def spikes(clip: Measured) -> set[int]:
    """Rows that are spikes, the largest taken out first: what it does to its neighbours then goes too."""
    phase, claimed, gone = clip.phase(), clip.claimed(), set[int]()
    paths = [np.flatnonzero((phase == p) & (clip.ball == b)) for p in range(3) for b in range(2)]
    scale: float | None = None
    while True:
        looks = []
        for path in paths:
            rows = np.array([k for k in path.tolist() if k not in gone], dtype=int)
            looks += list(_looks(clip.frame[rows], clip.xy[rows], claimed[rows], rows))
        if not looks:
            return gone
        off = np.array([far for _, far, _ in looks])
        if scale is None:
            scale = max(1.4826 * float(np.median(np.abs(off))), 1e-300)
        most = np.abs(off).max(axis=1) / scale
        wrong = [k for k, (_, _, rest) in enumerate(looks) if most[k] > FAR and rest < SMOOTH * scale]
        if not wrong:
            return gone
        gone.add(looks[max(wrong, key=lambda k: float(most[k]))][0])


def _looks(
    frame: NDArray[np.int64], xy: Array, claimed: Array, rows: NDArray[np.int64]
) -> Iterator[tuple[int, Array, float]]:
    """Of each place with enough neighbours: its row, how far it is off their parabola (2,), and their own rms off it.

    Both in claimed standard deviations, what the parabola itself is uncertain by allowed for.
    """
    for k in range(len(rows)):
        near = np.flatnonzero((np.abs(frame - frame[k]) <= REACH) & (frame != frame[k]))
        early = int(np.sum(frame[near] < frame[k]))
        if min(early, len(near) - early) < BESIDE or len(near) < 5:
            continue
        design = np.vander((frame[near] - frame[k]) / REACH, 3, increasing=True)
        inverse = np.linalg.pinv(design)
        fitted = inverse @ xy[near]
        left = xy[near] - design @ fitted
        rest = float(np.sqrt(((left / claimed[near, None]) ** 2).sum() / (2 * (len(near) - 3))))
        yield int(rows[k]), (xy[k] - fitted[0]) / np.hypot(claimed[k], np.linalg.norm(claimed[near] * inverse[0])), rest
