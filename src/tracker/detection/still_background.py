"""The still background of a film in which balls move, or rest for a while: from frames spread over the film."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tracker.camera.lens import Array

SAMPLES = 31  # frames looked at
BAND = 1 << 21  # pixels of all samples held at once while they are sorted
APART = 6.0  # noise deviations between the two levels of a pixel
ROUGH = 6.0  # times the usual difference from what lies around: a pixel that differs by more shows part of a ball
SELDOM = 0.1  # of the samples: a pixel that is off its median less often has one level
WIDTHS = (11, 31, 91, 271)  # px, of the neighbourhoods in which surroundings are looked for
MIDDLE_HALF = 1.2  # variance of the mean of a sample's middle half, over that of its mean, of normal errors
ENOUGH = 0.05  # of a neighbourhood, free of balls


@dataclass(frozen=True, eq=False)
class StillBackground:
    """The picture without balls: ``level`` (h, w) counts, its ``error``, and whether it is ``known`` at a pixel.

    Where it is not, the level is that of what lies around, and the error is the texture's.
    """

    level: Array
    error: Array
    known: NDArray[np.bool_]


def estimate_still_background(frames: Sequence[Any], noise: float) -> StillBackground:
    """Find the picture without balls.

    A pixel's level is its median, unless it is off that in more than SELDOM of the samples: there a ball rested, or
    came to rest, and the level is the densest cluster of samples on the side of what lies around. Where a ball was in
    all samples, it is what lies around.

    Parameters
    ----------
    frames : sequence of (h, w) arrays
    noise : float
        Of one pixel in one frame, counts.

    Returns
    -------
    Background
        What never moves stays in it. Not known are pixels that were never seen without a ball.
    """
    picks = sorted({round(k * (len(frames) - 1) / (SAMPLES - 1)) for k in range(SAMPLES)})
    stack, step = np.stack([np.asarray(frames[k]) for k in picks]), max(APART * noise, 3.0)
    level = np.empty(stack.shape[1:])
    often = np.empty(level.shape, np.uint8)
    rows = max(BAND // stack[:, 0].size, 1)
    for top in range(0, len(level), rows):
        part = stack[:, top : top + rows].astype(float)
        level[top : top + rows] = np.median(part, axis=0)
        often[top : top + rows] = (np.abs(part - level[top : top + rows]) > step).mean(axis=0) > SELDOM
    rested = np.asarray(cv2.morphologyEx(often, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)), dtype=np.uint8)
    outlines, _ = cv2.findContours(rested, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(rested, outlines, -1, 1, cv2.FILLED)  # what is covered all the time is a hole
    known = np.ones(level.shape, bool)
    error = np.full(level.shape, np.sqrt(np.pi / 2 / len(picks)) * noise)  # of a median
    if rested.any():
        where = np.nonzero(rested)
        smooth = _around(level, rested)
        near_by = (cv2.dilate(rested, np.ones((31, 31), np.uint8)) == 1) & (rested == 0)
        texture = step + ROUGH * float(np.median(np.abs(level - smooth)[near_by])) if near_by.any() else step
        around = smooth[where]
        seen = _nearest(stack[:, where[0], where[1]].astype(float), around, step, texture)
        level[where], known[where] = np.where(np.isnan(seen), around, seen), ~np.isnan(seen)
        error[where] = noise  # however many samples: a ball's rim may be in all of them
        error[~known] = max(_texture(level, rested), noise)
    return StillBackground(level, error, known)


def average_uncovered(frames: Sequence[Any], covered: Sequence[NDArray[np.bool_]], noise: float) -> StillBackground:
    """Find the same picture, where it is known what of each frame balls cover: the mean of the middle half elsewhere.

    Parameters
    ----------
    frames : sequence of (h, w) arrays
    covered : sequence of (h, w) arrays of bool
    noise : float
        Of one pixel in one frame, counts.
    """
    count: NDArray[np.int64] = np.add.reduce([~c for c in covered], axis=0, dtype=np.int64)
    level = np.empty(count.shape)
    rows = max(BAND // (len(frames) * count.shape[1]), 1)
    rank = np.arange(len(frames))[:, None, None]
    for top in range(0, len(level), rows):
        at = slice(top, top + rows)
        free = [np.where(c[at], np.inf, np.asarray(f[at])) for f, c in zip(frames, covered, strict=True)]
        ordered, n = np.sort(free, axis=0), count[at]
        middle = (rank >= n // 4) & (rank < n - n // 4)
        level[at] = np.where(middle, ordered, 0.0).sum(axis=0) / np.maximum(n - 2 * (n // 4), 1)
    error, never = np.sqrt(MIDDLE_HALF / np.maximum(count, 1)) * noise, (count == 0).astype(np.uint8)
    if never.any():
        smooth = _around(level, never)
        level[never == 1] = smooth[never == 1]
        error[never == 1] = max(_texture(level, never), noise)
    return StillBackground(level, error, never == 0)


def _texture(level: Array, hidden: NDArray[np.uint8]) -> float:
    """Standard deviation of the levels near what is hidden from what lies around, counts."""
    beside = (cv2.dilate(hidden, np.ones((31, 31), np.uint8)) == 1) & (hidden == 0)
    off = level - cv2.blur(level, (WIDTHS[1], WIDTHS[1]))
    return 1.4826 * float(np.median(np.abs(off)[beside])) if beside.any() else 0.0


def _nearest(samples: Array, around: Array, step: float, texture: float) -> Array:
    """Of pixels' samples (k, n) the mean of the cluster furthest from the ball.

    NaN where all show a part of a ball.
    """
    brighter = samples.max(axis=0) - around > around - samples.min(axis=0)  # than the plate, the ball
    ordered = np.sort(np.where(brighter, samples, -samples), axis=0)
    found = np.full(len(around), np.nan)
    for first in range(len(ordered) - 1):  # of two samples at least: the darkest one may be a shadow
        near = (ordered >= ordered[first]) & (ordered <= ordered[first] + step / 2)
        size = near.sum(axis=0)
        new = np.isnan(found) & (size > 1)
        found[new] = (np.where(near, ordered, 0).sum(axis=0) / size)[new]
        if not np.isnan(found).any():
            break
    found = np.where(brighter, found, -found)
    return np.where(np.abs(found - around) < texture, found, np.nan)


def _around(middle: Array, rested: NDArray[np.uint8]) -> Array:
    """Means of the pixels near by on which no ball has rested, (h, w)."""
    free, out = (rested == 0).astype(float), np.full(middle.shape, np.nan)
    for wide in WIDTHS:
        weight = cv2.boxFilter(free, -1, (wide, wide), normalize=True)
        found = np.isnan(out) & (weight > ENOUGH)
        out[found] = (cv2.boxFilter(middle * free, -1, (wide, wide), normalize=True) / np.maximum(weight, 1e-6))[found]
    out[np.isnan(out)] = np.median(middle)
    return out
