"""Measures of tracking papers: alpha, beta, JSC, MOTA, IDF1, HOTA and others.

alpha, beta, JSC and JSC_theta of the Particle Tracking Challenge (Chenouard et al. 2014, Nature Methods 11, 281);
MOTA, MOTP and identity switches (Bernardin & Stiefelhagen 2008), IDF1 (Ristani et al. 2016), HOTA, DetA and AssA
(Luiten et al. 2021). Two positions are paired from a similarity of one half on. The similarity of boxes is their
intersection over union. That of points is 1 - distance/gate for HOTA and 1 - distance/(2 gate) for the other measures.
Clips are pooled by adding their counts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from synthcam_shared.arrays import Array, Ints

GATE_PX = 5.0
Counts = dict[str, float]
HOTA_LEVELS = np.arange(0.05, 0.99, 0.05)
MIN_SIMILARITY = 0.5 - float(np.finfo(float).eps)  # of a pair


class FrameDistances(NamedTuple):
    """A frame: rows of truth and of found; distances px; similarity for pairs, and for HOTA."""

    i: Ints
    j: Ints
    apart: Array
    alike: Array
    alike_hota: Array


@dataclass(frozen=True)
class TrackPoints:
    """Points of several tracks: frame (n,), track (n,) numbered 0..k-1, position (n, 2) px; of boxes their size too."""

    frame: Ints
    track: Ints
    xy: Array
    size: Array | None = None

    @classmethod
    def of(cls, frame: Ints, track: Ints, xy: Array, size: Array | None = None) -> TrackPoints:
        """Renumbers the tracks."""
        return cls(frame, np.unique(track, return_inverse=True)[1].astype(np.int64), xy, size)

    @property
    def tracks(self) -> int:
        """Number of tracks."""
        return int(self.track.max()) + 1 if len(self.track) else 0


@dataclass(frozen=True)
class TrackingCounts:
    """Counts of clips by name, which add; levels (4, 19): by level of HOTA, as `_count_hota` returns them."""

    counts: Counter[str]
    levels: Array

    @classmethod
    def none(cls) -> TrackingCounts:
        """Those of no clip."""
        return cls(Counter(), np.zeros((4, len(HOTA_LEVELS))))

    @classmethod
    def of(cls, truth: TrackPoints, found: TrackPoints, gate: float = GATE_PX) -> TrackingCounts:
        """Those of one clip; gate in px."""
        near = _frame_distances(truth, found, gate)
        counts = _count_challenge(truth, found, near, gate) | _count_clear(truth, found, near)
        return cls(Counter(counts | _count_identity(truth, found, near)), _count_hota(truth, found, near))

    def __add__(self, other: TrackingCounts) -> TrackingCounts:
        counts = self.counts.copy()
        counts.update(other.counts)
        return TrackingCounts(counts, self.levels + other.levels)

    def scores(self) -> dict[str, float]:
        """All measures; NaN where nothing was there to be tracked."""
        n, (hits, misses, extras, linked) = self.counts, self.levels
        with np.errstate(invalid="ignore", divide="ignore"):
            det, ass = hits / (hits + misses + extras), linked / hits
            hota, det_a, ass_a = (
                float(np.mean(np.nan_to_num(level))) if n["truth"] else np.nan
                for level in (np.sqrt(det * ass), det, ass)
            )
        return {
            "alpha": 1 - _ratio(n["distance"], n["empty"]),
            "beta": _ratio(n["empty"] - n["distance"], n["empty"] + n["spurious"]),
            "jsc": _ratio(n["tp"], n["tp"] + n["fn"] + n["fp"]),
            "jsc_theta": _ratio(n["tp_track"], n["tp_track"] + n["fn_track"] + n["fp_track"]),
            "mota": 1 - _ratio(n["clear_fn"] + n["clear_fp"] + n["swaps"], n["truth"]),
            "motp": _ratio(n["clear_alike"], n["truth"] - n["clear_fn"]),
            "idf1": _ratio(2 * n["idtp"], n["truth"] + n["found"]),
            "hota": hota,
            "deta": det_a,
            "assa": ass_a,
            "swaps": int(n["swaps"]),
        }


def score_tracks(clips: Iterable[tuple[TrackPoints, TrackPoints]], gate: float = GATE_PX) -> dict[str, float]:
    """Compute all measures of tracking over clips of (truth, found); gate in px. NaN where nothing could be tracked."""
    return sum((TrackingCounts.of(*clip, gate) for clip in clips), TrackingCounts.none()).scores()


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole else np.nan


def _frame_distances(truth: TrackPoints, found: TrackPoints, gate: float) -> dict[int, FrameDistances]:
    """By frame."""
    out = {}
    for frame in np.union1d(truth.frame, found.frame):
        i, j = np.flatnonzero(truth.frame == frame), np.flatnonzero(found.frame == frame)
        apart = np.linalg.norm(truth.xy[i][:, None] - found.xy[j][None], axis=-1)
        if truth.size is not None and found.size is not None:
            alike = hota = _overlap(truth.xy[i], truth.size[i], found.xy[j], found.size[j])
        else:
            alike, hota = np.maximum(1 - apart / (2 * gate), 0.0), np.maximum(1 - apart / gate, 0.0)
        out[int(frame)] = FrameDistances(i, j, apart, alike, hota)
    return out


def _overlap(one: Array, size: Array, other: Array, other_size: Array) -> Array:
    """Intersection over union of boxes, (n, m), by their middles and sizes."""
    low = np.maximum((one - size / 2)[:, None], (other - other_size / 2)[None])
    high = np.minimum((one + size / 2)[:, None], (other + other_size / 2)[None])
    both = np.prod(np.maximum(high - low, 0.0), axis=-1)
    union = np.prod(size, axis=1)[:, None] + np.prod(other_size, axis=1)[None] - both
    alike: Array = np.divide(both, union, out=np.zeros_like(both), where=union > 0)
    return alike


def _count_challenge(truth: TrackPoints, found: TrackPoints, near: dict[int, FrameDistances], gate: float) -> Counts:
    """Whole tracks paired so that the sum of gated distances is least; a track may stay without partner."""
    n, m = truth.tracks, found.tracks
    length, size = np.bincount(truth.track, minlength=n), np.bincount(found.track, minlength=m)
    cost = np.asarray((length[:, None] + size[None, :]) * gate, dtype=np.float64)  # if they never meet
    close = np.zeros((n, m), dtype=np.int64)
    for i, j, apart, *_ in near.values():
        for a, b in np.ndindex(*apart.shape):
            pair = truth.track[i[a]], found.track[j[b]]
            cost[pair] += np.minimum(apart[a, b], gate) - 2 * gate
            close[pair] += apart[a, b] < gate
    alone = np.full((n, n), 1e12)
    np.fill_diagonal(alone, length * gate)
    # a partner that costs no less than none at all is no partner
    table = np.concatenate([np.where(close > 0, cost, 1e12), alone], axis=1)
    rows, columns = linear_sum_assignment(table)
    real = columns < m
    pairs = rows[real], columns[real]
    tp, matched = int(close[pairs].sum()), int(real.sum())
    spare = int(size.sum() - size[columns[real]].sum())
    return {
        "distance": float(table[rows, columns].sum()), "empty": float(length.sum() * gate), "spurious": spare * gate,
        "tp": tp, "fn": int(length.sum()) - tp, "fp": int(size.sum()) - tp,
        "tp_track": matched, "fn_track": n - matched, "fp_track": m - matched,
    }  # fmt: skip


def _count_clear(truth: TrackPoints, found: TrackPoints, near: dict[int, FrameDistances]) -> Counts:
    """Frame by frame, a partner is kept while it stays within the gate; a frame without either changes nothing."""
    partner: dict[int, int] = {}
    previous: dict[int, int] = {}
    swaps = misses = extras = 0
    summed = 0.0
    for _, (i, j, _, alike, _) in sorted(near.items()):
        if not len(i) or not len(j):
            misses, extras = misses + len(i), extras + len(j)
            continue
        gain = np.where(alike >= MIN_SIMILARITY, alike, 0.0)
        for a, b in zip(*np.nonzero(gain), strict=True):
            if previous.get(int(truth.track[i[a]])) == found.track[j[b]]:
                gain[a, b] += 1000.0  # over any similarity: a partner is kept even where another is more similar
        rows, columns = linear_sum_assignment(-gain)
        met = gain[rows, columns] > 0
        kept = list(zip(truth.track[i[rows[met]]].tolist(), found.track[j[columns[met]]].tolist(), strict=True))
        swaps += sum(partner.get(a, b) != b for a, b in kept)
        summed += float(alike[rows[met], columns[met]].sum())
        misses += len(i) - len(kept)
        extras += len(j) - len(kept)
        previous = dict(kept)
        partner |= previous
    counts = {"truth": len(truth.frame), "found": len(found.frame)}
    return {**counts, "swaps": swaps, "clear_fn": misses, "clear_fp": extras, "clear_alike": summed}


def _count_identity(truth: TrackPoints, found: TrackPoints, near: dict[int, FrameDistances]) -> Counts:
    """One partner for the whole clip, for as many frames as possible."""
    both = np.zeros((truth.tracks, found.tracks))
    for i, j, _, alike, _ in near.values():
        for a, b in np.argwhere(alike >= MIN_SIMILARITY):
            both[truth.track[i[a]], found.track[j[b]]] += 1
    rows, columns = linear_sum_assignment(-both)
    return {"idtp": float(both[rows, columns].sum())}


def _count_hota(truth: TrackPoints, found: TrackPoints, near: dict[int, FrameDistances]) -> Array:
    """(4, levels): hits, misses, extras, and the sum over hits of their association's Jaccard index."""
    n, m = truth.tracks, found.tracks
    overlap = np.zeros((n, m))
    for i, j, _, _, s in near.values():
        union = s.sum(axis=0)[None, :] + s.sum(axis=1)[:, None] - s
        overlap[np.ix_(truth.track[i], found.track[j])] += np.divide(s, union, out=np.zeros_like(s), where=union > 0)
    length, size = np.bincount(truth.track, minlength=n), np.bincount(found.track, minlength=m)
    jaccard = overlap / np.maximum(length[:, None] + size[None, :] - overlap, 1e-12)
    hits = np.zeros(len(HOTA_LEVELS))
    joint = np.zeros((len(HOTA_LEVELS), n, m))
    for i, j, _, _, s in near.values():
        score = jaccard[np.ix_(truth.track[i], found.track[j])] * s
        for a, b in zip(*linear_sum_assignment(-score), strict=True):
            passed = s[a, b] >= HOTA_LEVELS - float(np.finfo(float).eps)
            hits += passed
            joint[:, truth.track[i[a]], found.track[j[b]]] += passed
    association = joint / np.maximum(length[:, None] + size[None, :] - joint, 1e-12)
    linked = (joint * association).sum(axis=(1, 2))
    return np.stack([hits, len(truth.frame) - hits, len(found.frame) - hits, linked])
