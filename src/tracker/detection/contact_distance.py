"""The distance of two equal balls that touch, in pixels, whatever the light; `calibrate` makes the scale of it."""

import math
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from synthcam_shared.arrays import Array, Ints
from tracker.detection.glints import PositionFlag
from tracker.detection.link import Tracks

FRAMES_BEFORE = 7  # frames used before the contact
MIN_COMMON_FRAMES = 8  # four before the contact, and four after it


@dataclass(frozen=True)
class ContactDistance:
    """A contact: the distance of the glints there, px, its standard error, and the instant, frames."""

    distance: float
    std: float
    instant: float


def contact_distances(tracks: Tracks, most: int | None = None) -> list[ContactDistance]:
    """Find the contacts between the balls of one clip at which their distance can be measured.

    most: of two balls that approach each other more often, only so many of the nearest approaches are looked at.
    """
    out = []
    shaded = np.array([PositionFlag.SHADED.word in words for words in tracks.flags], dtype=bool)
    lasting = tracks.fixed * shaded[:, None, None]
    balls = [np.flatnonzero(tracks.particle == ball) for ball in np.unique(tracks.particle)]
    long = [rows for rows in balls if len(rows) >= MIN_COMMON_FRAMES]  # noise in dark films has hundreds of short ones
    for one, two in combinations(long, 2):
        frame, i, j = np.intersect1d(tracks.frame[one], tracks.frame[two], assume_unique=True, return_indices=True)
        gap = tracks.xy[two[j]] - tracks.xy[one[i]]
        cov, fixed = (c[two[j]] + c[one[i]] for c in (tracks.cov - lasting, lasting))
        distance = np.hypot(*gap.T)
        rows = _nearest(distance)
        if most is not None and len(rows) > most:
            rows = np.sort(rows[np.argsort(distance[rows], kind="stable")[:most]])
        contacts = (_touch(frame, gap, cov, fixed, k) for k in rows)
        out += [contact for contact in contacts if contact is not None]
    return out


def _nearest(distance: Array) -> Ints:
    """Rows in which two balls are nearer than in any of the FRAMES_BEFORE rows on either side."""
    if len(distance) < MIN_COMMON_FRAMES:
        return np.empty(0, np.int64)
    around = np.lib.stride_tricks.sliding_window_view(
        np.pad(distance, FRAMES_BEFORE, constant_values=np.inf), 2 * FRAMES_BEFORE + 1
    )
    return np.flatnonzero(np.argmin(around, axis=1) == FRAMES_BEFORE)


def _touch(frame: Ints, gap: Array, cov: Array, fixed: Array, k: int) -> ContactDistance | None:
    """Parabolas before and after row k of least distance, and the distance where they meet.

    gap: (n, 2) px from one ball to the other; cov, fixed: its covariances from frame to frame, and of a lasting shift.
    """
    best = None
    # frames after the contact: a parabola holds while both balls slide, and slow balls soon roll
    for span in (7, 6, 5, 4):
        for split in (k, k + 1):  # the contact lies just before or just after the frame of least distance
            before = np.arange(max(0, split - FRAMES_BEFORE), split)
            after = np.arange(split, min(len(frame), split + span))
            if len(before) < 4 or len(after) < 4 or np.any(np.diff(frame[before[0] : after[-1] + 1]) > 1):
                continue
            found = _meet(frame, gap, cov, before, after, float(frame[split]))
            if found is not None and (best is None or found[1] < best[1]):
                best = found
        # chi^2 per degree of freedom of parabolas that hold
        if best is not None and best[1] < 1.8:
            break
    if best is None:
        return None
    contact, chi2 = best
    random, lasting = (float(np.trace(c[k])) / 2 for c in (cov, fixed))
    # beyond this chi^2 the balls did not move so at all
    if chi2 * random > 16.0 * (random + lasting):
        return None
    return ContactDistance(contact.distance, math.sqrt(contact.std**2 * max(1.0, chi2) + lasting), contact.instant)


def _meet(
    frame: Ints, gap: Array, cov: Array, before: Any, after: Any, origin: float
) -> tuple[ContactDistance, float] | None:
    """The contact where parabolas through the rows `before` and `after` meet, and their chi^2 per degree of freedom."""
    sides, chi2, freedom = [], 0.0, 0
    for rows in (before, after):
        t = frame[rows] - origin
        powers = np.vander(t, 3, increasing=True)
        weight = 1.0 / (np.trace(cov[rows], axis1=1, axis2=2) / 2.0)
        normal = np.linalg.inv((powers.T * weight) @ powers)
        fit = normal @ (powers.T * weight) @ gap[rows]
        chi2 += float(weight @ np.sum((gap[rows] - powers @ fit) ** 2, axis=1))
        freedom += 2 * (len(rows) - 3)
        sides.append((fit, normal))
    (early, early_cov), (late, late_cov) = sides
    # px per frame, by which the relative velocity changes in a hit
    if np.hypot(*(late[1] - early[1])) < 0.3:
        return None
    powers = np.vander(np.linspace(-1.5, 0.5, 401), 3, increasing=True)
    row = powers[int(np.argmin(np.sum((powers @ (late - early)) ** 2, axis=1)))]
    instant = row[1]
    kick = (late[1] - early[1]) + 2.0 * instant * (late[2] - early[2])
    velocity_early, velocity_late = (side[1] + 2.0 * instant * side[2] for side in (early, late))
    position = row @ (early + late) / 2.0
    normal = position / np.hypot(*position)
    sizes = [float(row @ c @ row) for c in (early_cov, late_cov)]
    pull = kick / (kick @ kick)
    # An error of either curve moves the position, and, along the change of velocity, the instant.
    drift = float(normal @ (velocity_early + velocity_late) / 2.0)
    of_early, of_late = normal / 2.0 + drift * pull, normal / 2.0 - drift * pull
    std = float(np.sqrt(sizes[0] * (of_early @ of_early) + sizes[1] * (of_late @ of_late)))
    return ContactDistance(float(np.hypot(*position)), std, origin + float(instant)), chi2 / max(freedom, 1)
