"""Estimates the still background of a film in which balls move, or rest for a while."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from synthcam_shared.arrays import Array, Flags
from tracker.camera.frames import pick_spread

SURROUNDINGS_PX = (11, 31, 91, 271)  # widths of the neighbourhoods that are averaged, the smallest first


@dataclass(frozen=True, eq=False)
class StillBackground:
    """The picture (h, w) without balls, but with everything else that never moves."""

    level: NDArray[np.float32]  # counts
    error: NDArray[np.float32]  # standard errors of the level, counts
    known: Flags
    """True where the pixel was seen without a ball. Elsewhere the level is that of the surroundings, and the error is
    that of the texture."""
    _blurred: dict[Any, NDArray[Any]] = field(default_factory=dict, repr=False)

    def was_seen_around(self, x: int, y: int, reach: int) -> bool:
        """True if more than half of the pixels around one were seen without a ball."""
        return bool(self.known[max(y - reach, 0) : y + reach + 1, max(x - reach, 0) : x + reach + 1].mean() > 0.5)

    def blur(self, box: tuple[int, int], dtype: Any) -> NDArray[Any]:
        """Means of the level over boxes (width, height), px, rounded to the pixel type `dtype`."""
        key = box, np.dtype(dtype)
        if key not in self._blurred:
            mean = cv2.blur(self.level, box)
            self._blurred[key] = mean if key[1].kind == "f" else np.rint(mean).astype(dtype)
        return self._blurred[key]


def estimate_still_background(frames: Sequence[Any], noise: float, box: tuple[int, int] = (1, 1)) -> StillBackground:
    """Estimate the still background of a film, the picture without balls, from 31 frames spread over it.

    A pixel's level is the median of its samples. The exception is a pixel that differs from it in more than a tenth of
    the samples: a ball rested there. The level is then the cluster of samples that is most like the surroundings. If
    the ball was there in all samples, it is the level of the surroundings.

    noise: standard deviation of one pixel in one frame, counts; box: width and height, px, over which each frame is
    averaged first. It works in strips of rows, so that a large film takes little memory beside its frames.
    """
    pictures = [np.asarray(frame) for frame in pick_spread(frames, 31)]
    count = len(pictures)
    step = max(6.0 * noise, 3.0)  # counts between a pixel with and without a ball, at least
    level = np.empty(pictures[0].shape, np.float32)
    often = np.empty(level.shape, np.uint8)
    for at in cut_strips(level.shape):
        sheets = [_blur_rows(picture, at, box) for picture in pictures]
        low, high = sort_sheets(sheets, ((count - 1) // 2, count // 2))
        level[at] = (low + high) / 2
        away: NDArray[np.uint8] = np.zeros(low.shape, np.uint8)
        for sheet in sheets:
            away += np.abs(sheet - level[at]) > step
        often[at] = away / count > 0.1
    rested = np.asarray(cv2.morphologyEx(often, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)), dtype=np.uint8)
    outlines, _ = cv2.findContours(rested, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(rested, outlines, -1, 1, cv2.FILLED)  # a hole: covered all the time
    known = np.ones(level.shape, bool)
    error = np.full(level.shape, np.sqrt(np.pi / 2 / count) * noise, np.float32)  # of a median
    if rested.any():
        rows, columns = part = _find_box(rested)
        where = np.nonzero(rested[part])
        samples = np.stack([_blur_rows(picture, rows, box)[:, columns][where] for picture in pictures]).astype(float)
        _fill_rested(samples, rested[part], noise, StillBackground(level[part], error[part], known[part]))
    return StillBackground(level, error, known)


def _blur_rows(picture: NDArray[Any], at: slice, box: tuple[int, int]) -> NDArray[Any]:
    """Means over boxes (width, height) at these rows of a picture, as of the whole picture."""
    if box == (1, 1):
        return picture[at]
    above = min(at.start, box[1] // 2)
    return np.asarray(cv2.blur(picture[at.start - above : at.stop + box[1] // 2], box))[above:][: at.stop - at.start]


def _fill_rested(samples: Array, rested: NDArray[np.uint8], noise: float, ground: StillBackground) -> None:
    """Set the background where a ball rested, from the samples (k, n) of these n pixels."""
    level, error, known = ground.level, ground.error, ground.known
    step = max(6.0 * noise, 3.0)
    where = np.nonzero(rested)
    smooth = _average_surroundings(level, rested)
    near_by = _find_beside(rested)
    # a pixel that differs from its surroundings by more than 6 times the usual shows part of a ball
    texture = step + 6.0 * float(np.median(np.abs(level - smooth)[near_by])) if near_by.any() else step
    around = smooth[where].astype(float)
    seen = _most_like_surroundings(samples, around, step, texture)
    level[where], known[where] = np.where(np.isnan(seen), around, seen), ~np.isnan(seen)
    error[where] = noise  # with any number of samples: a ball's rim may be in all of them
    error[~known] = max(_texture(level, rested), noise)


def average_uncovered(
    frames: Sequence[Any], covered: Sequence[NDArray[np.uint8]], noise: float, changes: Sequence[float] = ()
) -> StillBackground:
    """As `estimate_still_background`, where the pixels that balls cover are known: by the mean of the middle half.

    covered: a mask of each frame, packed along its rows (`np.packbits`); changes: counts by which each frame is
    brighter than the background.
    """
    shown, total = [np.asarray(frame) for frame in frames], len(frames)
    level, width = np.empty(shown[0].shape, np.float32), shown[0].shape[1]
    count = np.full(level.shape, total, np.int16)
    middle = range(total // 4, total - total // 4)
    for at in cut_strips(level.shape):
        sheets = [picture[at] for picture in shown]
        if any(changes):
            sheets = [sheet.astype(np.float32) - np.float32(c) for sheet, c in zip(sheets, changes, strict=True)]
        level[at] = np.add.reduce(sort_sheets(sheets, middle)) / np.float32(len(middle))
        masks = [np.unpackbits(own[at], axis=1, count=width).view(np.bool_) for own in covered]
        count[at] -= np.add.reduce(masks, dtype=np.int16)
        partly = count[at] < total
        if partly.any():
            free = [
                np.where(own[partly], np.float32(np.inf), sheet[partly])[None].astype(np.float32)
                for sheet, own in zip(sheets, masks, strict=True)
            ]
            n = count[at][partly]
            sums = np.zeros(len(n), np.float32)
            for rank, value in enumerate(sort_sheets(free, range(total))):
                used = (rank >= n // 4) & (rank < n - n // 4)
                sums[used] += value[0, used]
            level[at][partly] = sums / np.maximum(n - 2 * (n // 4), 1)
    # variance of the mean of the middle half, over that of the mean of all, of normal errors: 1.2
    error = (np.sqrt(1.2 / np.maximum(np.arange(total + 1), 1)) * noise).astype(np.float32)[count]
    never = (count == 0).view(np.uint8)
    if never.any():
        box = _find_box(never)
        hidden, around = never[box] == 1, level[box]
        around[hidden] = _average_surroundings(around, never[box])[hidden]
        error[box][hidden] = max(_texture(around, never[box]), noise)
    return StillBackground(level, error, never == 0)


def _find_box(hidden: NDArray[np.uint8]) -> tuple[slice, slice]:
    """Index of the box around all hidden pixels, with the surroundings from which they are filled."""
    rim = SURROUNDINGS_PX[-1] // 2 + 16
    left, top, width, height = cv2.boundingRect(hidden)
    return slice(max(top - rim, 0), top + height + rim), slice(max(left - rim, 0), left + width + rim)


def _find_beside(hidden: NDArray[np.uint8]) -> Flags:
    """Pixels within 15 px of hidden ones."""
    return np.asarray((cv2.dilate(hidden, np.ones((31, 31), np.uint8)) == 1) & (hidden == 0))


def _texture(level: NDArray[np.float32], hidden: NDArray[np.uint8]) -> float:
    """Standard deviation, counts, by which levels near the hidden pixels differ from their surroundings."""
    beside = _find_beside(hidden)
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


def _average_surroundings(middle: NDArray[np.float32], rested: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Means (h, w) of near pixels on which no ball has rested, in the smallest neighbourhood with 5 % of them."""
    free, out = (rested == 0).astype(np.float32), np.full(middle.shape, np.nan, np.float32)
    for wide in SURROUNDINGS_PX:
        weight = cv2.boxFilter(free, -1, (wide, wide), normalize=True)
        found = np.isnan(out) & (weight > 0.05)
        out[found] = (cv2.boxFilter(middle * free, -1, (wide, wide), normalize=True) / np.maximum(weight, 1e-6))[found]
        if not np.isnan(out).any():
            break
    out[np.isnan(out)] = np.median(middle)
    return out


def cut_strips(shape: tuple[int, ...], strip_pixels: int = 1 << 15) -> Iterator[slice]:
    """Cut a picture into strips of whole rows: 31 of one strip fit into a cache of 1 to 2 MB."""
    rows = max(strip_pixels // shape[1], 1)
    return (slice(top, min(top + rows, shape[0])) for top in range(0, shape[0], rows))


def sort_sheets(sheets: Sequence[NDArray[Any]], ranks: Sequence[int]) -> list[NDArray[np.float32]]:
    """Sort equal parts (h, w) of pictures, uint8, uint16 or float32, by pixel: those of these ranks, 0 the least."""
    sheets = [np.array(sheet) for sheet in sheets]
    spare = np.empty_like(sheets[0])
    for low, high in _make_network(len(sheets), tuple(ranks)):
        one, two = sheets[low], sheets[high]
        sheets[low], spare = np.asarray(cv2.min(one, two, dst=spare)), one
        sheets[high] = np.asarray(cv2.max(one, two, dst=two))
    return [sheets[rank].astype(np.float32) for rank in ranks]


@cache
def _make_network(count: int, ranks: tuple[int, ...]) -> tuple[tuple[int, int], ...]:
    """Pairs of numbers to compare and exchange: merge exchange (Knuth, vol. 3, 5.2.2 M) as far as the ranks need it."""
    pairs = []
    first = (1 << (count - 1).bit_length()) // 2
    step = first
    while step:
        last, phase, apart = first, 0, step
        while True:
            pairs += [(k, k + apart) for k in range(count - apart) if k & step == phase]
            if last == step:
                break
            apart, last, phase = last - step, last // 2, step
        step //= 2
    needed, used = set(ranks), []
    for low, high in reversed(pairs):
        if low in needed or high in needed:
            needed |= {low, high}
            used.append((low, high))
    return tuple(reversed(used))
