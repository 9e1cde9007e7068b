"""Finds balls that turn back unseen at the rim of the picture: one may have left it, and another one entered."""

import numpy as np

from synthcam_shared.arrays import Array, Ints


def find_unseen_turns(frame: Ints, ids: Ints, xy: Array, size: tuple[int, int], diameter: float) -> Ints:
    """Find the detections that follow such a turn, by row.

    A wall at the rim turns balls too. So a side of the picture counts only if no ball is seen to turn there by itself.
    frame, ids: (n,) frame and track of each detection, -1 for none. xy: (n, 2), px. size: of the picture. diameter: of
    a ball, px.
    """
    least_speed = 0.05 * diameter  # px per usual step, out and back in, of a ball that turns
    longest_step = 1.5  # usual steps; frames are missing in a longer one
    order = np.lexsort((frame, ids))
    order = order[ids[order] >= 0]
    if len(order) < 3:
        return order[:0]
    time, place = np.diff(frame[order]), xy[order]
    own = np.diff(ids[order]) == 0
    usual = float(np.median(time[own])) if own.any() else 1.0
    v = np.diff(place, axis=0) / np.where(own, time, 1)[:, None] * usual
    k = 1 + np.flatnonzero(own[1:] & own[:-1])  # step k, from detection k to the next, has one before it
    follows = np.append(own, False)[k + 1]
    back = np.where(follows[:, None], np.append(v, [[0.0, 0.0]], axis=0)[k + 1], v[k])
    missing, out = np.append(time > longest_step * usual, False), [k[:0]]
    unseen, seen = missing[k], ~(missing[k - 1] | missing[k] | (missing[k + 1] & follows))
    for axis, outward in ((0, -1), (0, 1), (1, -1), (1, 1)):
        away = size[axis] - 1 - place[k, axis] if outward > 0 else place[k, axis]
        speed = outward * v[k - 1, axis]
        turned = (speed > least_speed) & (outward * back[:, axis] < -least_speed) & (away < diameter + speed)
        hidden = k[turned & unseen]
        if len(hidden) and not _is_one_alone(order[k[turned & seen]], frame, xy, 1.5 * diameter):
            out.append(hidden)
    return np.unique(order[np.concatenate(out) + 1])


def _is_one_alone(rows: Ints, frame: Ints, xy: Array, apart: float) -> bool:
    """True if one of these detections has no other within this distance, px, in its frame."""
    by_frame = np.argsort(frame, kind="stable")
    starts, ends = (np.searchsorted(frame[by_frame], frame[rows], side) for side in ("left", "right"))
    near = (xy[by_frame[start:end]] - xy[row] for row, start, end in zip(rows, starts, ends, strict=True))
    return any(int((np.hypot(*off.T) < apart).sum()) <= 1 for off in near)
