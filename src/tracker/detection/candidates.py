"""The fast first search: the empty plate of a film with its noise, and the pixels brighter than it by more."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import cv2
import numpy as np
from numpy.typing import NDArray

from synthcam_shared.arrays import Array, Ints
from tracker.camera.frames import Frames, spread_frames
from tracker.settings import DetectionSettings

ROUNDING_NOISE_COUNTS = 0.29  # standard deviation of rounding to whole counts, 1/sqrt(12)
# Sorting network for the median of nine (Paeth 1990, Graphics Gems): exact, and as fast as the minimum.
MEDIAN_OF_NINE = (
    (1, 2), (4, 5), (7, 8), (0, 1), (3, 4), (6, 7), (1, 2), (4, 5), (7, 8), (0, 3), (5, 8), (4, 7), (3, 6), (1, 4),
    (2, 5), (4, 7), (4, 2), (6, 4), (4, 2),
)  # fmt: skip
MAX_FITTED = 64  # candidates of a frame; maximum likelihood takes minutes for more
MAX_FOLLOWED = 512  # of a frame, by centroids and linear fits
_SAMPLED = WeakKeyDictionary[Frames, tuple[NDArray[Any], float]]()
RAISED_SHARE = 0.01  # of the pixels over the threshold, from which the plate itself may have become lighter


@dataclass(frozen=True, eq=False)
class EmptyPlate:
    """The plate without balls."""

    level: NDArray[Any]  # counts (h, w), in the type of the frames
    noise: float  # standard deviation of one pixel in one frame, counts
    hot: Ints = field(default_factory=lambda: np.empty(0, np.int64))
    """Indices into the flattened plate of hot pixels, which are always bright."""


def estimate_empty_plate(frames: Sequence[Any]) -> EmptyPlate:
    """Estimate the empty plate of a clip and its noise from nine frames spread over it.

    The median of the nine contains no moving ball. A ball at rest stays in the median. Its brightness
    above its surroundings reveals it. The smooth part of the plate, a median over about 60 px, replaces it.
    """
    middle, noise = sample_plate(frames)
    middle = middle.copy()
    smooth = _smooth(middle)
    over = np.asarray(cv2.subtract(middle, smooth, dtype=cv2.CV_32F), dtype=np.float32)
    risen = over >= 4.0 * noise / 3.0 + 1.0
    hot = _find_hot_pixels(over, np.flatnonzero(risen), noise)
    risen.ravel()[hot] = False
    wide = np.flatnonzero(cv2.dilate(risen.view(np.uint8), np.ones((7, 7), np.uint8)))
    kept = middle.ravel()[hot]
    middle.ravel()[wide] = np.rint(smooth.ravel()[wide]).astype(middle.dtype)
    middle.ravel()[hot] = kept
    return EmptyPlate(middle, noise, hot)


def sample_plate(frames: Sequence[Any]) -> tuple[NDArray[Any], float]:
    """The median of nine frames spread over a film, and the noise of a pixel. The choice of a detector asks first."""
    known = _SAMPLED.get(frames) if isinstance(frames, Frames) else None
    if known is not None:
        return known
    sample = [np.array(frames[k]) for k in spread_frames(frames)]
    noise = estimate_pixel_noise(sample)
    found = median_of_nine(sample), noise
    if isinstance(frames, Frames):
        found[0].flags.writeable = False
        _SAMPLED[frames] = found
    return found


def _find_hot_pixels(over: NDArray[np.float32], risen: Ints, noise: float) -> Ints:
    """Those of the risen pixels (k,) whose neighbours are too dark for a glint."""
    # The sharpest glint that optics give, .55 px wide, has at least a quarter of its peak in a neighbouring pixel.
    neighbour_share = 0.25
    h, w = over.shape
    row, column = risen // w, risen % w
    around = [
        over[np.clip(row + down, 0, h - 1), np.clip(column + right, 0, w - 1)]
        for down, right in ((-1, 0), (1, 0), (0, -1), (0, 1))
    ]
    return np.asarray(risen[np.max(around, axis=0) < neighbour_share * over.ravel()[risen] + noise])


def median_of_nine(sheets: list[NDArray[Any]]) -> NDArray[Any]:
    """Compute the empty plate as the median of nine pictures. They are overwritten, as fresh memory costs more time."""
    spare = np.empty_like(sheets[0])
    for low, high in MEDIAN_OF_NINE:
        one, two = sheets[low], sheets[high]
        sheets[low], spare = np.asarray(cv2.min(one, two, dst=spare)), one
        sheets[high] = np.asarray(cv2.max(one, two, dst=two))
    return sheets[4]


def _smooth(picture: NDArray[Any]) -> NDArray[np.float32]:
    """The smooth part of a picture: a median over 5 x 5 cells of 12 px."""
    h, w = picture.shape
    rows, columns = max(h // 12, 1), max(w // 12, 1)
    coarse = cv2.resize(picture.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA)
    calm = cv2.medianBlur(coarse, 5)
    return np.asarray(cv2.resize(calm, (w, h), interpolation=cv2.INTER_LINEAR), dtype=np.float32)


def estimate_pixel_noise(sample: list[NDArray[Any]]) -> float:
    """Estimate the noise of the empty plate: of a pixel in one frame, counts. Balls cover too few pixels to matter."""
    h, w = sample[0].shape
    step = max(1, math.isqrt(h * w // 4000))
    thin = np.stack([s[::step, ::step] for s in sample]).astype(np.float32)
    steps = np.diff(thin, axis=0)
    differences = steps[np.any(steps != 0.0, axis=(1, 2))].ravel()  # a repeated frame shows no noise
    if len(differences) == 0:
        return ROUNDING_NOISE_COUNTS
    return max(estimate_noise_at_rest(differences) / math.sqrt(2.0), ROUNDING_NOISE_COUNTS)


def estimate_noise_at_rest(change: NDArray[np.float32]) -> float:
    """Estimate the noise of a plate whose pixels rest: their change between frames in which no ball moves there.

    Bodies that cover a tenth of the picture change so many pixels that their changes pass for noise. The median of all
    changes then shows how much a pixel of the plate changes.
    """
    max_over_median = 4.0  # of the spread; an encoder changes some pixels more than others, but not so much
    spread, size = float(np.std(change)), np.abs(change)
    typical = max(1.4826 * float(np.median(size)), 1.0) if size.size else 0.0
    for start in (spread, typical):
        spread = start
        for _ in range(4):
            kept = change[size <= 4.0 * spread + 1.0]
            spread = float(np.std(kept)) if kept.size else 0.0
        if spread <= max_over_median * typical:
            break
    return spread


@dataclass(frozen=True, eq=False)
class Candidates:
    """Candidates of one frame, brightest first."""

    column: Ints  # their pixels (n,), as `row`
    row: Ints
    strength: Array  # sums (n,) of the counts above the plate in a box about the pixel
    crowded: bool = False
    """So many pixels are bright that the frame does not show a few balls; no candidates are returned then."""

    @staticmethod
    def none(crowded: bool = False) -> Candidates:
        """No candidates."""
        return Candidates(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0), crowded)


class _CutSums:
    """Sums over boxes of what bytes exceed a floor by, cut off at 255, by adding shifted pictures."""

    def __init__(self, shape: tuple[int, ...], box: int) -> None:
        (self.height, self.width), self.box, self.rim = shape, box, box // 2
        wide = self.width + 2 * self.rim
        self.lifted = np.zeros((self.height + 2 * self.rim, wide), np.uint8)
        self.columns = np.zeros((self.height, wide), np.uint8)
        self.sums = np.empty(shape, np.uint8)

    def add_up(self, frame: NDArray[np.uint8], floor: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The sums (h, w). They are overwritten by the next call."""
        self._add_columns(frame, floor)
        w, down = self.width, self.columns
        cv2.add(down[:, :w], down[:, 1 : 1 + w], dst=self.sums)
        for k in range(2, self.box):
            cv2.add(self.sums, down[:, k : k + w], dst=self.sums)
        return self.sums

    def whole(self, rows: Ints, columns: Ints) -> Array:
        """The sums (k,) at pixels, not cut off."""
        span = np.arange(self.box)
        pixels = self.lifted[(rows[:, None] + span)[:, :, None], (columns[:, None] + span)[:, None]]
        return np.asarray(pixels.sum(axis=(1, 2), dtype=np.float64))

    def _add_columns(self, frame: NDArray[np.uint8], floor: NDArray[np.uint8]) -> None:
        """Lift a frame off the floor, beyond whose rim it is reflected, and add up the columns of all boxes."""
        (h, w), rim, lifted = frame.shape, self.rim, self.lifted
        cv2.subtract(frame, floor, dst=lifted[rim : rim + h, rim : rim + w])
        _reflect_rim(lifted, rim, (h, w))
        cv2.add(lifted[:h], lifted[1 : 1 + h], dst=self.columns)
        for k in range(2, self.box):
            cv2.add(self.columns, lifted[k : k + h], dst=self.columns)


def _reflect_rim(picture: NDArray[np.uint8], rim: int, shape: tuple[int, ...]) -> None:
    """Reflect a picture of a shape (h, w) at its edges in what lies beyond them, out to `rim`."""
    for rows, n in zip((picture, picture.T), shape, strict=True):
        rows[:rim] = rows[rim : 2 * rim][::-1]
        rows[n + rim : n + 2 * rim] = rows[n : n + rim][::-1]


class _BrightBoxes(NamedTuple):
    """Boxes (m,) of some frames, whose sums exceed a threshold."""

    number: Ints  # of the frame
    row: Ints  # of the pixel in the middle
    column: Ints
    sums: Ints  # of what the pixels exceed a floor by


class _FewBrightBoxes:
    """Finds the boxes whose sums of bytes over a floor exceed a threshold, in frames with few bright pixels.

    Two frames are first looked at together, by the larger of each two pixels. The sums of what it exceeds the level of
    the plate by tell where a box may be bright. They are over one more row than a box has, from every other row on, and
    so half as many. Only the boxes there are then added up in each frame.
    """

    TOGETHER = 2  # frames; of more, the noise looks bright
    WORD = 8  # sums that are compared together

    def __init__(self, level: NDArray[np.uint8], drop: int, box: int, threshold: int) -> None:
        """drop: counts from the level of the plate to the floor; threshold: of the sums over that floor."""
        self.given = level, drop, box, threshold
        self.level, self.floor = level, cv2.subtract(level, np.full_like(level, drop))
        self.box, self.threshold, self.rim, (self.height, self.width) = box, threshold, box // 2, level.shape
        self.limit = np.uint8(threshold - box * box * drop)  # a pixel exceeds the level by `drop` less, if at all
        rows, wide = self.height + 2 * self.rim, self.width + 2 * self.rim
        self.lifted = np.zeros((rows + rows % 2, wide + -wide % self.WORD), np.uint8)
        self.pairs = np.zeros((len(self.lifted) // 2, self.lifted.shape[1]), np.uint8)
        self.columns, self.sums = np.zeros((2, len(self.pairs) - self.rim, self.lifted.shape[1]), np.uint8)
        self.over, self.larger = np.zeros(self.sums.shape, np.bool_), np.empty_like(level)
        self.is_quick = True  # whether few sums are bright
        # pixels beyond the rim are reflections; those farther out are of no box whose middle is in the picture
        self.row_at, self.column_at = (
            np.pad(np.pad(np.arange(n), self.rim, mode="symmetric"), (0, self.WORD + box), mode="edge")
            for n in level.shape
        )

    def __reduce__(self) -> tuple[type[_FewBrightBoxes], tuple[Any, ...]]:
        """Make new memory in another process, in place of a copy of this."""
        return _FewBrightBoxes, self.given

    def find_words(self, frames: Sequence[NDArray[np.uint8]]) -> Ints | None:
        """Numbers (k,) of the words that hold a bright sum, in one or two frames; None where there are many."""
        most = 0.002  # of the sums, from which on it is quicker to add up all boxes
        if not self.is_quick:
            return None
        rim, lifted, pairs, columns = self.rim, self.lifted, self.pairs, self.columns
        larger = frames[0] if len(frames) == 1 else cv2.max(frames[0], frames[1], dst=self.larger)
        cv2.subtract(larger, self.level, dst=lifted[rim : rim + self.height, rim : rim + self.width])
        _reflect_rim(lifted, rim, self.level.shape)
        cv2.add(lifted[::2], lifted[1::2], dst=pairs)
        cv2.add(pairs[: len(columns)], pairs[1 : 1 + len(columns)], dst=columns)
        for k in range(2, rim + 1):
            cv2.add(columns, pairs[k : k + len(columns)], dst=columns)
        # one row after the other: sums across the ends of two rows are of no box within the rim
        down, sums = columns.ravel(), self.sums.ravel()[: 1 - self.box]
        cv2.add(down[: len(sums)], down[1 : 1 + len(sums)], dst=sums)
        for k in range(2, self.box):
            cv2.add(sums, down[k : k + len(sums)], dst=sums)
        np.greater(self.sums, self.limit, out=self.over)
        words = np.asarray((self.over.ravel().view(np.uint64) != 0).nonzero()[0])
        self.is_quick = len(words) < max(most * self.over.size, 64)
        return words if self.is_quick else None

    def add_up(self, frames: Sequence[NDArray[np.uint8]], words: Sequence[Ints]) -> _BrightBoxes:
        """Add up the boxes of these words of each frame, each box once."""
        counts = [len(own) for own in words]
        top, left = np.divmod(np.concatenate(words), self.over.shape[1] // self.WORD)
        top, left = 2 * top, self.WORD * left
        rows = self.row_at[top[:, None] + np.arange(self.box + 1)]
        columns = self.column_at[left[:, None] + np.arange(self.WORD + self.box - 1)]
        at = rows[:, :, None] * self.width + columns[:, None]
        parts = np.split(at, np.cumsum(counts)[:-1])
        seen = np.concatenate([frame.ravel()[part] for frame, part in zip(frames, parts, strict=True)])
        lifted = np.maximum(seen.astype(np.int16) - self.floor.ravel()[at], 0)  # of whole boxes no sum is too large
        middle = lifted[:, 1 : self.box].sum(axis=1, dtype=np.int16)
        down = np.stack([lifted[:, 0] + middle, middle + lifted[:, self.box]], axis=1)
        sums = down[..., : self.WORD].copy()
        for k in range(1, self.box):
            sums += down[..., k : k + self.WORD]
        word, lower, across = (sums > self.threshold).nonzero()
        row, column, of_boxes = top[word] + lower, left[word] + across, sums[word, lower, across].astype(np.int64)
        inside = (row < self.height) & (column < self.width)
        number = np.repeat(np.arange(len(frames)), counts)[word]
        return _BrightBoxes(number[inside], row[inside], column[inside], of_boxes[inside])


class CandidateSearch:
    """Finds the local maxima of a box sum over the plate.

    `sigma` is the Gaussian width of a glint, px. Each candidate is the strongest within the distance `apart`, px. At
    most `most` candidates of a frame are kept, unless the settings say how many.
    """

    def __init__(
        self,
        plate: EmptyPlate,
        sigma: float,
        apart: float,
        settings: DetectionSettings | None = None,
        most: int = MAX_FITTED,
    ) -> None:
        settings = settings or DetectionSettings()
        self.apart, self.plate = apart, plate
        self.most = settings.max_candidates_per_frame or most
        self.box = max(3, 2 * round(1.2 * sigma) + 1)
        # Differences are unsigned. To keep negative noise, the search subtracts a little less than the plate.
        drop = math.ceil(3.0 * plate.noise)
        self.floor: NDArray[Any] = cv2.subtract(plate.level, np.full_like(plate.level, drop))
        area = self.box * self.box
        small = plate.level.dtype == np.uint8 and area * 255 < 2**15
        self.depth = cv2.CV_16S if small else cv2.CV_32F
        least = area * drop + settings.candidate_sigma * self.box * plate.noise * math.sqrt(1.0 + 1.0 / 6.0)
        self.threshold = math.floor(least)  # a whole number, so that whole sums need no conversion
        self.base = float(area * drop)
        # In small boxes, sums of bytes that are cut off at 255 decide as whole ones do, and cost half of their time.
        cut = small and self.threshold < 255 and self.box <= 5
        self.cut_sums = _CutSums(plate.level.shape, self.box) if cut else None
        self.few = _FewBrightBoxes(plate.level, drop, self.box, self.threshold) if cut else None
        # Kept between frames: fresh memory of this size would cost more time than the sums.
        shape = (0, 0) if cut else plate.level.shape
        self.over, self.lifted = np.empty(shape, np.bool_), np.empty(shape, plate.level.dtype)
        self.sums = np.empty(shape, np.int16 if small else np.float32)

    @cached_property
    def smooth(self) -> NDArray[np.float32]:
        """The plate's smooth part."""
        return _smooth(self.plate.level)

    def __call__(self, frame: NDArray[Any]) -> Candidates:
        """The candidates of a frame (h, w)."""
        [found] = self.search_together([frame])
        return found

    def search_together(self, frames: Sequence[NDArray[Any]]) -> list[Candidates]:
        """The candidates of each of some frames; most of the time of small frames is that of numpy's calls."""
        out, words = list[Candidates | None](), list[Ints]()
        if self.few is not None:
            for first in range(0, len(frames), self.few.TOGETHER):
                some = frames[first : first + self.few.TOGETHER]
                found = self.few.find_words(some)
                if found is None:
                    break
                words += [found] * len(some)
        if self.few is not None and words:
            out += self._choose_strongest(len(words), self.few.add_up(frames[: len(words)], words))
        out += [None] * (len(frames) - len(out))
        return [self._search_thoroughly(frame) if one is None else one for frame, one in zip(frames, out, strict=True)]

    def _choose_strongest(self, count: int, boxes: _BrightBoxes) -> list[Candidates | None]:
        """The strongest pixels of each of so many frames, as `_strongest`; None where one has too many for that."""
        # Sorted by frame, then the strongest and of equals the first: one key takes a fifth of the time of three.
        shift, top, width = 31, 2**16 - 1, self.plate.level.shape[1]  # bits of a pixel's number, more than a sum
        key = np.sort((((boxes.number << 16) + top - boxes.sums) << shift) + boxes.row * width + boxes.column)
        rows, columns = np.divmod(key & (2**shift - 1), width)
        frame, values = key >> (shift + 16), (top - (key >> shift & top)).astype(np.float64)
        numbers = np.arange(count + 1)
        many = np.diff(frame.searchsorted(numbers)) > RAISED_SHARE * self.plate.level.size
        chosen, left = [np.empty(0, np.int64)], np.arange(len(frame))
        for _ in range(self.most):
            if not len(left):
                break
            heads = np.append(True, frame[left[1:]] != frame[left[:-1]])
            best, of_left = left[heads], np.cumsum(heads) - 1
            chosen.append(best)
            across, down = columns[left] - columns[best[of_left]], rows[left] - rows[best[of_left]]
            left = left[across * across + down * down > self.apart**2]
        kept = np.concatenate(chosen)
        kept = kept[np.argsort(frame[kept], kind="stable")]
        limits = frame[kept].searchsorted(numbers)
        rows, columns, values = rows[kept], columns[kept], values[kept] - self.base
        parts = zip(many.tolist(), limits[:-1].tolist(), limits[1:].tolist(), strict=True)
        return [
            None if full else Candidates(columns[first:end], rows[first:end], values[first:end])
            for full, first, end in parts
        ]

    def _search_thoroughly(self, frame: NDArray[Any]) -> Candidates:
        """The candidates of a frame, which may have many bright pixels."""
        crowded_share = 0.3  # of the pixels over the threshold: too much for balls
        max_shift = 3.0  # counts by which an encoder shifts a whole plate or half of one, at most
        hits, strength = self._over(frame, self.floor)
        if len(hits) > RAISED_SHARE * frame.size:
            raised = np.rint(_smooth(frame) - self.smooth)
            level = self.floor + np.where(np.abs(raised) <= max_shift, raised, 0.0)
            hits, strength = self._over(frame, np.clip(level, 0, np.iinfo(frame.dtype).max).astype(frame.dtype))
        if len(hits) == 0:
            return Candidates.none()
        if len(hits) > crowded_share * frame.size:
            return Candidates.none(crowded=True)
        rows, columns = np.divmod(hits, frame.shape[1])
        return self._strongest(columns, rows, strength)

    def _over(self, frame: NDArray[Any], floor: NDArray[Any]) -> tuple[Ints, Array]:
        """Indices (k,) of the pixels whose box sum above `floor` exceeds the threshold, and these sums."""
        if self.cut_sums is not None:
            over = np.greater(self.cut_sums.add_up(frame, floor), np.uint8(self.threshold))
            hits = _find_few(over.ravel())
            return hits, self.cut_sums.whole(*np.divmod(hits, frame.shape[1]))
        lifted = cv2.subtract(frame, floor, dst=self.lifted)
        box, edge = (self.box, self.box), cv2.BORDER_REFLECT
        sums = cv2.boxFilter(lifted, self.depth, box, dst=self.sums, normalize=False, borderType=edge)
        hits = np.flatnonzero(np.greater(sums, self.threshold, out=self.over).ravel())
        return hits, self.sums.ravel()[hits].astype(np.float64)

    def _strongest(self, columns: Ints, rows: Ints, values: Array) -> Candidates:
        """The strongest pixels, each farther than `apart` from a stronger one; rows ascend."""
        free, chosen = np.ones(len(values), dtype=np.bool_), list[int]()
        for best in np.argsort(-values, kind="stable").tolist():  # the first of equals
            if free[best]:  # false of most
                if len(chosen) == self.most or values[best] <= 0:
                    break
                chosen.append(best)
                ends = math.ceil(rows[best] - self.apart), math.floor(rows[best] + self.apart) + 1
                band = slice(*rows.searchsorted(ends).tolist())
                across, down = columns[band] - columns[best], rows[band] - rows[best]
                free[band] &= across * across + down * down > self.apart**2
        return Candidates(columns[chosen], rows[chosen], values[chosen] - self.base)


def _find_few(flags: NDArray[np.bool_]) -> Ints:
    """Find the true flags (n,), of which there are few, in less than half the time of np.flatnonzero."""
    whole = len(flags) // 8 * 8
    words = (flags[:whole].view(np.uint64) != 0).nonzero()[0]
    at = np.asarray((words[:, None] * 8 + np.arange(8)).ravel())
    if whole < len(flags):
        at = np.append(at, np.arange(whole, len(flags)))
    return np.asarray(at[flags[at]])


def estimate_coarse_positions(windows: Array, half: int) -> Array:
    """Estimate positions of candidates (n, 2), px from the central pixel: centroids of cores in (n, s, s)."""
    core = windows[:, half - 1 : half + 2, half - 1 : half + 2]
    weight = np.maximum(core - np.median(windows.reshape(len(windows), -1), axis=1)[:, None, None], 0.0)
    total = np.maximum(weight.sum(axis=(1, 2)), 1e-9)
    offsets = np.arange(-1, 2)
    x = (weight.sum(axis=1) * offsets).sum(axis=1) / total
    y = (weight.sum(axis=2) * offsets).sum(axis=1) / total
    return np.column_stack([x, y]) * 1.3  # a core three pixels wide biases the centroid towards its middle
