"""Estimates the still background of a film in which balls move, or rest for a while."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tracker.camera.lens import Array
from tracker.detection.candidates import spread_frames

SURROUNDINGS_PX = (11, 31, 91, 271)  # widths of the neighbourhoods that are averaged, the smallest first


@dataclass(frozen=True, eq=False)
class StillBackground:
    """The picture (h, w) without balls, but with everything else that never moves."""

    level: Array  # counts
    error: Array  # standard errors of the level, counts
    known: NDArray[np.bool_]
    """Whether the pixel was seen without a ball. Elsewhere the level is that of the surroundings, and the error is that
    of the texture."""


def estimate_still_background(frames: Sequence[Any], noise: float) -> StillBackground:
    """Estimate the picture without balls from 31 frames spread over a film.

    A pixel's level is the median of its samples. The exception is a pixel that differs from it in more than a tenth of
    the samples: a ball rested there. The level is then the cluster of samples that is most like the surroundings. If
    the ball was there in all samples, it is the level of the surroundings. `noise` is the standard deviation of one
    pixel in one frame, counts.
    """
    picks = sorted({*spread_frames(frames, 31)})
    stack = np.stack([np.asarray(frames[k]) for k in picks])
    step = max(6.0 * noise, 3.0)  # counts between a pixel with and without a ball, at least
    level = np.empty(stack.shape[1:])
    often = np.empty(level.shape, np.uint8)
    rows = _rows_at_once(stack[:, 0].size)
    for top in range(0, len(level), rows):
        part = stack[:, top : top + rows].astype(float)
        level[top : top + rows] = np.median(part, axis=0)
        often[top : top + rows] = (np.abs(part - level[top : top + rows]) > step).mean(axis=0) > 0.1
    rested = np.asarray(cv2.morphologyEx(often, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)), dtype=np.uint8)
    outlines, _ = cv2.findContours(rested, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(rested, outlines, -1, 1, cv2.FILLED)  # a hole: covered all the time
    known = np.ones(level.shape, bool)
    error = np.full(level.shape, np.sqrt(np.pi / 2 / len(picks)) * noise)  # of a median
    if rested.any():
        where = np.nonzero(rested)
        smooth = _average_surroundings(level, rested)
        near_by = (cv2.dilate(rested, np.ones((31, 31), np.uint8)) == 1) & (rested == 0)
        # a pixel that differs from its surroundings by more than 6 times the usual shows part of a ball
        texture = step + 6.0 * float(np.median(np.abs(level - smooth)[near_by])) if near_by.any() else step
        around = smooth[where]
        seen = _most_like_surroundings(stack[:, where[0], where[1]].astype(float), around, step, texture)
        level[where], known[where] = np.where(np.isnan(seen), around, seen), ~np.isnan(seen)
        error[where] = noise  # with any number of samples: a ball's rim may be in all of them
        error[~known] = max(_texture(level, rested), noise)
    return StillBackground(level, error, known)


def average_uncovered(frames: Sequence[Any], covered: Sequence[NDArray[np.bool_]], noise: float) -> StillBackground:
    """As `estimate_still_background`, where the pixels that balls cover are known: by the mean of the middle half."""
    count: NDArray[np.int64] = np.add.reduce([~c for c in covered], axis=0, dtype=np.int64)
    level = np.empty(count.shape)
    rows = _rows_at_once(len(frames) * count.shape[1])
    rank = np.arange(len(frames))[:, None, None]
    for top in range(0, len(level), rows):
        at = slice(top, top + rows)
        free = [np.where(c[at], np.inf, np.asarray(f[at])) for f, c in zip(frames, covered, strict=True)]
        ordered, n = np.sort(free, axis=0), count[at]
        middle = (rank >= n // 4) & (rank < n - n // 4)
        level[at] = np.where(middle, ordered, 0.0).sum(axis=0) / np.maximum(n - 2 * (n // 4), 1)
    # variance of the mean of the middle half, over that of the mean of all, of normal errors: 1.2
    error, never = np.sqrt(1.2 / np.maximum(count, 1)) * noise, (count == 0).astype(np.uint8)
    if never.any():
        smooth = _average_surroundings(level, never)
        level[never == 1] = smooth[never == 1]
        error[never == 1] = max(_texture(level, never), noise)
    return StillBackground(level, error, never == 0)


def _rows_at_once(pixels_of_a_row: int) -> int:
    """How many rows of all samples are sorted at once, so that memory stays small: 2 million pixels."""
    return max((1 << 21) // pixels_of_a_row, 1)


def _texture(level: Array, hidden: NDArray[np.uint8]) -> float:
    """Standard deviation, counts, by which levels near the hidden pixels differ from their surroundings."""
    beside = (cv2.dilate(hidden, np.ones((31, 31), np.uint8)) == 1) & (hidden == 0)
    off = level - cv2.blur(level, (SURROUNDINGS_PX[1], SURROUNDINGS_PX[1]))
    return 1.4826 * float(np.median(np.abs(off)[beside])) if beside.any() else 0.0


def _most_like_surroundings(samples: Array, around: Array, step: float, texture: float) -> Array:
    """The mean (n,) of the cluster of samples (k, n) that is furthest from the ball; NaN where all show the ball."""
    brighter = samples.max(axis=0) - around > around - samples.min(axis=0)  # the ball, than the plate
    ordered = np.sort(np.where(brighter, samples, -samples), axis=0)
    found = np.full(len(around), np.nan)
    for first in range(len(ordered) - 1):  # a cluster has two samples at least: the darkest one may be a shadow
        near = (ordered >= ordered[first]) & (ordered <= ordered[first] + step / 2)
        size = near.sum(axis=0)
        new = np.isnan(found) & (size > 1)
        found[new] = (np.where(near, ordered, 0).sum(axis=0) / size)[new]
        if not np.isnan(found).any():
            break
    found = np.where(brighter, found, -found)
    return np.where(np.abs(found - around) < texture, found, np.nan)


def _average_surroundings(middle: Array, rested: NDArray[np.uint8]) -> Array:
    """Means (h, w) of near pixels on which no ball has rested, in the smallest neighbourhood with 5 % of them."""
    free, out = (rested == 0).astype(float), np.full(middle.shape, np.nan)
    for wide in SURROUNDINGS_PX:
        weight = cv2.boxFilter(free, -1, (wide, wide), normalize=True)
        found = np.isnan(out) & (weight > 0.05)
        out[found] = (cv2.boxFilter(middle * free, -1, (wide, wide), normalize=True) / np.maximum(weight, 1e-6))[found]
    out[np.isnan(out)] = np.median(middle)
    return out
