"""The fast first search: the empty plate of a film with its noise, and the pixels brighter than it by more."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary

import cv2
import numpy as np
from numpy.typing import NDArray

from synthcam_shared.arrays import Array, Flags, Ints
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
    """Sums over boxes of what bytes exceed a floor by, cut off at 255, by adding shifted pictures.

    A sum over a threshold has at least one column of the box over that threshold's share of a column. Where few columns
    are so bright, only the boxes that hold one are added up.
    """

    WORD = 8  # pixels that are looked at together

    def __init__(self, shape: tuple[int, ...], box: int) -> None:
        (self.height, self.width), self.box, self.rim = shape, box, box // 2
        self.wide = self.width + 2 * self.rim
        size = self.height * self.wide  # of the sums of columns, to which a part of a word is added
        self.down, self.over = (
            np.zeros(size + -size % self.WORD, np.uint8),
            np.zeros(size + -size % self.WORD, np.bool_),
        )
        self.columns = self.down[:size].reshape(self.height, self.wide)
        size += 2 * self.rim * self.wide
        self.pixels = np.zeros(size + 2 * self.WORD, np.uint8)
        self.lifted = self.pixels[:size].reshape(-1, self.wide)
        self.sums = np.empty(shape, np.uint8)
        self.is_quick = True  # whether few columns are so bright
        rows, across = np.arange(box) * self.wide, np.arange(1 - box, self.WORD + box - 1)
        self.around = np.add.outer(rows, across).ravel()  # the pixels of the boxes that hold a column of a word

    def __reduce__(self) -> tuple[type[_CutSums], tuple[tuple[int, int], int]]:
        """Make new memory in another process: pickled, views would become arrays of their own."""
        return _CutSums, ((self.height, self.width), self.box)

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
        pixels = (rows * self.wide + columns)[:, None] + np.add.outer(span * self.wide, span).ravel()
        return np.asarray(self.pixels[pixels].sum(axis=1, dtype=np.float64))

    def find_bright_words(
        self, frame: NDArray[np.uint8], floor: NDArray[np.uint8], threshold: int
    ) -> tuple[Ints, NDArray[np.uint8]] | None:
        """Words (k,) of pixels with a bright column, and the pixels of their boxes; None where there are many.

        The pixels are (k, box, 8 + 2 (box - 1)).
        """
        most = 0.002  # share of the words, from which on it is quicker to add up all boxes
        if not self.is_quick:
            return None
        self._add_columns(frame, floor)
        np.greater(self.down, np.uint8(threshold // self.box), out=self.over)
        words = np.asarray((self.over.view(np.uint64) != 0).nonzero()[0])
        self.is_quick = len(words) < max(most * len(self.over), 64)
        if not self.is_quick:
            return None
        around = self.pixels[(words * self.WORD)[:, None] + self.around]
        return words, around.reshape(len(words), self.box, self.WORD + 2 * (self.box - 1))

    def find_boxes(self, words: Ints, pixels: NDArray[np.uint8], threshold: int) -> tuple[Ints, Ints, Ints]:
        """The boxes (m,) of bright words whose sums exceed a threshold: word, first pixel, and sum, not cut off.

        A box that holds columns of two words is in both. Some boxes reach across the rim; see `locate`.
        """
        down = pixels.sum(axis=1, dtype=np.int64)
        count = self.WORD + self.box - 1
        sums = down[:, :count].copy()
        for k in range(1, self.box):
            sums += down[:, k : k + count]
        word, at = (sums > threshold).nonzero()
        return word, words[word] * self.WORD + at + (1 - self.box), sums[word, at]

    def locate(self, first: Ints) -> tuple[Ints, Ints, Flags]:
        """Rows and columns (m,) of the pixels in the middle of boxes, and whether a box lies within the rim."""
        rows, columns = np.divmod(first, self.wide)
        return rows, columns, (rows >= 0) & (columns < self.width) & (rows < self.height)

    def _add_columns(self, frame: NDArray[np.uint8], floor: NDArray[np.uint8]) -> None:
        """Lift a frame off the floor, beyond whose rim it is reflected, and add up the columns of all boxes."""
        (h, w), rim, lifted = frame.shape, self.rim, self.lifted
        cv2.subtract(frame, floor, dst=lifted[rim : rim + h, rim : rim + w])
        for picture, n in ((lifted, h), (lifted.T, w)):
            picture[:rim] = picture[rim : 2 * rim][::-1]
            picture[n + rim :] = picture[n : n + rim][::-1]
        cv2.add(lifted[:h], lifted[1 : 1 + h], dst=self.columns)
        for k in range(2, self.box):
            cv2.add(self.columns, lifted[k : k + h], dst=self.columns)


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
        bright, waiting, out = list[tuple[Ints, NDArray[np.uint8]]](), list[int](), list[Candidates | None]()
        for k, frame in enumerate(frames):
            found = self.cut_sums and self.cut_sums.find_bright_words(frame, self.floor, self.threshold)
            out.append(None if found else self._search_thoroughly(frame))
            if found:
                waiting.append(k)
                bright.append(found)
        if self.cut_sums and waiting:
            of_frame = np.repeat(waiting, [len(words) for words, _ in bright])
            words, pixels = (np.concatenate(part) for part in zip(*bright, strict=True))
            word, first, sums = self.cut_sums.find_boxes(words, pixels, self.threshold)
            strongest = self._choose_strongest(self.cut_sums, waiting, of_frame[word], first, sums)
            for k, one in zip(waiting, strongest, strict=True):
                out[k] = one
        return [self._search_thoroughly(frames[k]) if one is None else one for k, one in enumerate(out)]

    def _choose_strongest(
        self, boxes: _CutSums, numbers: Sequence[int], frame: Ints, first: Ints, sums: Ints
    ) -> list[Candidates | None]:
        """The strongest pixels of each of these frames, as `_strongest`; None where one has too many for that."""
        # Sorted by frame, then the strongest and of equals the first: one key takes a fifth of the time of three.
        shift, top = 31, 2**16 - 1  # bits of a pixel's number, and more than a sum
        key = np.sort((((frame << 16) + top - sums) << shift) + first + boxes.box)  # first > -box
        first = (key & (2**shift - 1)) - boxes.box
        rows, columns, inside = boxes.locate(first)
        frame, values = (key >> (shift + 16))[inside], (top - (key >> shift & top))[inside].astype(np.float64)
        rows, columns = rows[inside], columns[inside]
        limits = frame.searchsorted([*numbers, numbers[-1] + 1])
        many = np.diff(limits) > RAISED_SHARE * self.plate.level.size
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
        limits = frame[kept].searchsorted([*numbers, numbers[-1] + 1])
        return [
            None if full else Candidates(columns[own], rows[own], values[own] - self.base)
            for full, own in zip(many.tolist(), np.split(kept, limits[1:-1]), strict=True)
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
