"""How well tracks follow the truth, in the measures that tracking papers use.

alpha, beta, JSC and JSC_theta of the Particle Tracking Challenge (Chenouard et al. 2014, Nature Methods 11, 281);
MOTA and identity switches (Bernardin & Stiefelhagen 2008), IDF1 (Ristani et al. 2016), HOTA (Luiten et al. 2021)
with the similarity 1 - distance/gate. All are counts first and ratios last, so clips pool by adding.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

GATE_PX = 5.0
Counts = dict[str, float]
HOTA_LEVELS = np.arange(0.05, 0.99, 0.05)


@dataclass(frozen=True)
class Dots:
    """Points of several tracks: frame (n,), track (n,) numbered 0..k-1, position (n, 2) px."""

    frame: Ints
    track: Ints
    xy: Floats

    @classmethod
    def of(cls, frame: Ints, track: Ints, xy: Floats) -> Dots:
        """Renumbers the tracks."""
        return cls(frame, np.unique(track, return_inverse=True)[1].astype(np.int64), xy)

    @property
    def tracks(self) -> int:
        """Number of tracks."""
        return int(self.track.max()) + 1 if len(self.track) else 0


def tracking_scores(clips: list[tuple[Dots, Dots]], gate: float = GATE_PX) -> dict[str, float]:
    """All measures over clips of (truth, found); gate in px. NaN where nothing was there to be tracked."""
    n: defaultdict[str, float] = defaultdict(float)
    levels = np.zeros((4, len(HOTA_LEVELS)))
    for truth, found in clips:
        near = _distances(truth, found)
        for counts in (_challenge, _clear, _identity):
            for name, count in counts(truth, found, near, gate).items():
                n[name] += count
        levels += _hota(truth, found, near, gate)
    hits, misses, extras, linked = levels
    with np.errstate(invalid="ignore", divide="ignore"):
        det, ass = hits / (hits + misses + extras), linked / hits
        hota = float(np.mean(np.nan_to_num(np.sqrt(det * ass)))) if n["truth"] else np.nan
    return {
        "alpha": 1 - _ratio(n["distance"], n["empty"]),
        "beta": _ratio(n["empty"] - n["distance"], n["empty"] + n["spurious"]),
        "jsc": _ratio(n["tp"], n["tp"] + n["fn"] + n["fp"]),
        "jsc_theta": _ratio(n["tp_track"], n["tp_track"] + n["fn_track"] + n["fp_track"]),
        "mota": 1 - _ratio(n["clear_fn"] + n["clear_fp"] + n["swaps"], n["truth"]),
        "idf1": _ratio(2 * n["idtp"], n["truth"] + n["found"]),
        "hota": hota,
        "swaps": int(n["swaps"]),
    }


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole else np.nan


def _distances(truth: Dots, found: Dots) -> dict[int, tuple[Ints, Ints, Floats]]:
    """frame -> (rows of truth, rows of found, distances px)."""
    out = {}
    for frame in np.union1d(truth.frame, found.frame):
        i, j = np.flatnonzero(truth.frame == frame), np.flatnonzero(found.frame == frame)
        apart = np.linalg.norm(truth.xy[i][:, None] - found.xy[j][None], axis=-1)
        out[int(frame)] = (i, j, apart)
    return out


def _challenge(truth: Dots, found: Dots, near: dict[int, tuple[Ints, Ints, Floats]], gate: float) -> Counts:
    """Whole tracks paired so that the sum of gated distances is least; a track may stay without partner."""
    n, m = truth.tracks, found.tracks
    length, size = np.bincount(truth.track, minlength=n), np.bincount(found.track, minlength=m)
    cost = np.asarray((length[:, None] + size[None, :]) * gate, dtype=np.float64)  # if they never meet
    close = np.zeros((n, m), dtype=np.int64)
    for i, j, apart in near.values():
        for a, b in np.ndindex(*apart.shape):
            pair = truth.track[i[a]], found.track[j[b]]
            cost[pair] += np.minimum(apart[a, b], gate) - 2 * gate
            close[pair] += apart[a, b] < gate
    alone = np.full((n, n), np.inf)
    np.fill_diagonal(alone, length * gate)
    # a partner that costs no less than none at all is no partner
    table = np.concatenate([np.where(close > 0, cost, 1e12), np.where(np.isinf(alone), 1e12, alone)], axis=1)
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


def _clear(truth: Dots, found: Dots, near: dict[int, tuple[Ints, Ints, Floats]], gate: float) -> Counts:
    """Frame by frame, a partner is kept while it stays within the gate."""
    partner: dict[int, int] = {}
    previous: dict[int, int] = {}
    swaps = misses = extras = 0
    for _, (i, j, apart) in sorted(near.items()):
        gain = np.where(apart <= gate, gate + 1e-6 - apart, 0.0)
        for a, b in zip(*np.nonzero(gain), strict=True):
            if previous.get(int(truth.track[i[a]])) == found.track[j[b]]:
                gain[a, b] += 1000 * gate
        rows, columns = linear_sum_assignment(-gain)
        met = gain[rows, columns] > 0
        kept = list(zip(truth.track[i[rows[met]]].tolist(), found.track[j[columns[met]]].tolist(), strict=True))
        swaps += sum(partner.get(a, b) != b for a, b in kept)
        misses += len(i) - len(kept)
        extras += len(j) - len(kept)
        previous = dict(kept)
        partner |= previous
    counts = {"truth": len(truth.frame), "found": len(found.frame)}
    return {**counts, "swaps": swaps, "clear_fn": misses, "clear_fp": extras}


def _identity(truth: Dots, found: Dots, near: dict[int, tuple[Ints, Ints, Floats]], gate: float) -> Counts:
    """One partner for the whole clip, for as many frames as possible."""
    both = np.zeros((truth.tracks, found.tracks))
    for i, j, apart in near.values():
        for a, b in np.argwhere(apart <= gate):
            both[truth.track[i[a]], found.track[j[b]]] += 1
    rows, columns = linear_sum_assignment(-both)
    return {"idtp": float(both[rows, columns].sum())}


def _hota(truth: Dots, found: Dots, near: dict[int, tuple[Ints, Ints, Floats]], gate: float) -> Floats:
    """(4, levels): hits, misses, extras, and the sum over hits of their association's Jaccard index."""
    n, m = truth.tracks, found.tracks
    alike = {f: np.clip(1 - apart / gate, 0, 1) for f, (_, _, apart) in near.items()}
    overlap = np.zeros((n, m))
    for f, (i, j, _) in near.items():
        s = alike[f]
        union = s.sum(axis=0)[None, :] + s.sum(axis=1)[:, None] - s
        overlap[np.ix_(truth.track[i], found.track[j])] += np.divide(s, union, out=np.zeros_like(s), where=union > 0)
    length, size = np.bincount(truth.track, minlength=n), np.bincount(found.track, minlength=m)
    jaccard = overlap / np.maximum(length[:, None] + size[None, :] - overlap, 1e-12)
    hits = np.zeros(len(HOTA_LEVELS))
    joint = np.zeros((len(HOTA_LEVELS), n, m))
    for f, (i, j, _) in near.items():
        s = alike[f]
        score = jaccard[np.ix_(truth.track[i], found.track[j])] * s
        for a, b in zip(*linear_sum_assignment(-score), strict=True):
            passed = s[a, b] >= HOTA_LEVELS - 1e-12
            hits += passed
            joint[:, truth.track[i[a]], found.track[j[b]]] += passed
    association = joint / np.maximum(length[:, None] + size[None, :] - joint, 1e-12)
    linked = (joint * association).sum(axis=(1, 2))
    return np.stack([hits, len(truth.frame) - hits, len(found.frame) - hits, linked])
