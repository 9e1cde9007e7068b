"""Expose a picture: noise and counts of the linear camera of EMVA standard 1288, release 4.

The number of electrons is Poisson distributed about signal (1 + PRNU) + dark current. DSNU is added, the full well
clips, read noise and gain follow, and the converter rounds and clips. All random numbers come from keyed seeds.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, ndtr

from synthcam.camera.exposure import Picture
from synthcam_shared.arrays import Array, Float32, Index

Part = slice | Index
Counts = NDArray[np.unsignedinteger[Any]]  # uint8 or uint16

CELLS_OF_TABLE = 1 << 16  # one for each 16-bit random number
OUTERMOST = 1e9  # counts: saturates every pixel, and as an integer fits into 32 bits
MAX_TABLES = 96  # kept, .8 MB each: mains light at 250 frames/s shows 5 to 25 different plates


@dataclass(frozen=True)
class Sensor:
    """A camera's chip."""

    bits: int = 8  # of the converter
    gain: float = 20.0  # e-/count
    read_noise: float = 20.0  # e-
    dark: float = 0.0  # dark current, e-/s
    full_well: float = 6000.0  # e-
    prnu: float = 0.005  # standard deviation of the pixels' response, relative
    dsnu: float = 4.0  # standard deviation of their offset, e-
    black_level: float = 8.0  # counts
    glint_peak: float = 200.0  # counts above black at the peak of the glint of a ball at rest, before clipping
    hot_pixels: float = 0.0  # share of the pixels that leak
    hot_dark: float = 1e6  # mean of their exponentially distributed dark currents, e-/s

    @property
    def noise(self) -> float:
        """Standard deviation of a dark pixel from frame to frame, counts."""
        return float(np.hypot(self.read_noise / self.gain, 12**-0.5))

    @property
    def dtype(self) -> type[np.uint8] | type[np.uint16]:
        """Type of the counts."""
        return np.uint8 if self.bits <= 8 else np.uint16


class ExactPart(NamedTuple):
    """A part of a picture that is exposed pixel by pixel."""

    picture: NDArray[Any]
    rows: Part
    columns: Part


class SensorChip:
    """One copy of a sensor. Its fixed pattern depends on root_seed alone: it is the same in every clip.

    size: (w, h) px. exposure: s.
    """

    def __init__(self, sensor: Sensor, size: tuple[int, int], exposure: float, root_seed: int) -> None:
        self.sensor, self.exposure, self.root_seed = sensor, exposure, root_seed
        w, h = size
        rng = _generator(root_seed, (0,))
        self.response = 1 + sensor.prnu * rng.standard_normal((h, w))
        self.offset = sensor.dsnu * rng.standard_normal((h, w))
        self.hot = np.zeros(0, np.intp)
        if sensor.hot_pixels:
            rng = _generator(root_seed, (2,))
            self.hot = np.flatnonzero(rng.random((h, w)) < sensor.hot_pixels)
            self.leak = np.zeros((h, w))
            self.leak.flat[self.hot] = sensor.hot_dark * rng.exponential(size=len(self.hot))
        self._backgrounds: list[_Background] = []

    def expose(self, picture: Picture | Float32, clip: int, frame: int) -> Counts:
        """Expose a picture: counts (h, w), uint8 up to 8 bits, else uint16.

        The noise depends on (root_seed, clip, frame) only. A bare array of picture values is exposed pixel by pixel,
        which is slower.
        """
        return self.expose_film([picture], clip, [frame])[0]

    def expose_film(self, pictures: Sequence[Picture | Float32], clip: int, frames: Sequence[int]) -> list[Counts]:
        """Expose the pictures of several frames as `expose` does each: seeds first, then the plate, then the balls.

        One frame after the other takes longer: its pixels fill the processor's caches, and each step finds them cold.
        """
        streams = [_generator(self.root_seed, (clip, 1, frame)) for frame in frames]
        plates = [self._tables(picture.plate) if isinstance(picture, Picture) else None for picture in pictures]
        exposed = list[Counts]()
        for plate, run in groupby(zip(plates, streams, strict=True), lambda each: each[0]):
            rngs = [rng for _, rng in run]
            exposed += plate.expose(rngs) if plate else [np.empty(self.offset.shape, self.sensor.dtype) for _ in rngs]
        parts = [
            (k, part)
            for k, (picture, plate) in enumerate(zip(pictures, plates, strict=True))
            for part in self._list_parts(picture, plate is not None)
        ]
        found = self._expose_exactly([(part, streams[k]) for k, part in parts])
        for (k, part), counts in zip(parts, found, strict=True):
            exposed[k][part.rows, part.columns] = counts
        return exposed

    def _list_parts(self, picture: Picture | Float32, by_tables: bool) -> list[ExactPart]:
        """List the parts of a picture that no table holds: balls and hot pixels, or all of it."""
        if not isinstance(picture, Picture) or not by_tables:
            return [ExactPart(picture.image if isinstance(picture, Picture) else picture, slice(None), slice(None))]
        parts = [ExactPart(part, *box) for box, part in zip(picture.boxes, picture.parts, strict=True)]
        if picture.changed is not None:
            at = np.unravel_index(picture.changed, picture.plate.shape)
            parts = [ExactPart(picture.image[at], *at)]
        if len(self.hot):
            at = np.unravel_index(self.hot, picture.plate.shape)
            parts.append(ExactPart(picture.image[at], *at))
        return parts

    def electrons(self, picture: NDArray[Any], rows: Part, columns: Part) -> Array:
        """Compute the mean number of electrons in the pixels of a part of the picture."""
        sensor = self.sensor
        signal = picture * (sensor.glint_peak * sensor.gain)
        mean = np.asarray(signal * self.response[rows, columns])
        np.maximum(mean, 0, out=mean)
        mean += sensor.dark * self.exposure
        return mean + self.leak[rows, columns] * self.exposure if len(self.hot) else mean

    def _tables(self, plate: Float32) -> "_Background | None":
        """Find the tables of a plate, or make them; None if it is too bright for tables."""
        found = next((b for b in self._backgrounds if b.plate is plate), None)
        found = found or next((b for b in self._backgrounds if np.array_equal(b.plate, plate)), None)
        if not found:
            found = _Background(self, plate)
            self._backgrounds.append(found)
            while len(self._backgrounds) > 1 and sum(len(b.groups) for b in self._backgrounds) > MAX_TABLES:
                del self._backgrounds[0]
        found.plate = plate  # recognised by its identity the next time
        return None if found.deep else found

    def _expose_exactly(self, parts: Sequence[tuple[ExactPart, np.random.Generator]]) -> list[Counts]:
        """Expose parts of pictures pixel by pixel, each with its own random numbers; those of all parts in a row."""
        sensor = self.sensor
        if not parts:
            return []
        means = [self.electrons(part.picture, part.rows, part.columns).ravel() for part, _ in parts]
        offsets = [self.offset[part.rows, part.columns].ravel() for part, _ in parts]
        ends = np.cumsum([0, *map(len, means)])
        charge, noise = np.empty(ends[-1]), np.empty(ends[-1])
        for (_, rng), mean, first, last in zip(parts, means, ends, ends[1:], strict=False):
            charge[first:last] = rng.poisson(mean)
            rng.standard_normal(out=noise[first:last])
        charge += np.concatenate(offsets)
        np.minimum(charge, sensor.full_well, out=charge)
        noise *= sensor.read_noise
        charge += noise
        charge /= sensor.gain
        charge += sensor.black_level
        counts = digitise(charge, sensor.bits)
        return [
            counts[first:last].reshape(part.picture.shape)
            for (part, _), first, last in zip(parts, ends, ends[1:], strict=False)
        ]


def digitise(values: NDArray[Any], bits: int) -> Counts:
    """Digitise what a pixel holds: round to counts (half to even), and clip to the converter's range."""
    counts = np.rint(values)
    np.maximum(counts, 0, out=counts)
    np.minimum(counts, (1 << bits) - 1, out=counts)
    return np.asarray(counts, dtype=np.uint8 if bits <= 8 else np.uint16)


class _Background:
    """Noise of the plate by tables of the inverse distribution function.

    A 16-bit uniform number selects one of 65536 equally likely cells of (shot + read noise), each represented by its
    median. The two outermost cells are divided into 65536 again, so that the tails reach 6.2 sigma. The table holds
    `OUTERMOST` for them, so that their pixels are among the saturated ones, of which a dark plate has no others. Only
    the fixed pattern is approximated: pixels whose variances differ by less than `uneven` share one of at most 64
    tables.
    """

    def __init__(self, chip: SensorChip, plate: Float32, uneven: float = 0.01) -> None:
        sensor = chip.sensor
        self.plate, self.sensor = plate, sensor
        means = chip.electrons(plate, slice(None), slice(None))
        means.flat[chip.hot] = np.median(means)  # hot pixels are drawn separately
        top = means.max() + 9 * np.sqrt(means.max() + 1) + chip.offset.max()
        self.deep = bool(top > sensor.full_well)
        self.groups: list[tuple[Index, Float32, Float32]] = []
        if self.deep:
            return
        variance = means + sensor.read_noise**2
        base = max(variance.min(), 1e-9)  # a pixel without light and read noise has no variance
        ratio = variance.max() / base
        levels = min(int(np.ceil(np.log(ratio) / uneven)) if ratio > 1 else 1, 64)
        level = np.zeros(means.shape, int)
        if levels > 1:
            level = np.minimum(levels * np.log(np.maximum(variance, base) / base) / np.log(ratio), levels - 1).astype(
                int
            )
        shift = np.empty(means.shape)
        self.owner = np.zeros(means.size, np.int8)  # the group of each pixel
        for k in range(levels):
            members = np.flatnonzero(level == k)
            if len(members):
                self.owner[members] = len(self.groups)
                mean = float(means.flat[members].mean())
                shift.flat[members] = means.flat[members] - mean
                tables = (table / sensor.gain for table in tabulate_noise(mean, sensor.read_noise))
                body, tails = (np.ascontiguousarray(table, dtype=np.float32) for table in tables)
                body[[0, -1]] = OUTERMOST
                self.groups.append((members, body, tails))
        self.level = ((shift + chip.offset) / sensor.gain + sensor.black_level).astype(np.float32)

    def expose(self, streams: Sequence[np.random.Generator]) -> list[Counts]:
        """Expose the plate once by each stream of random numbers."""
        size, bits = self.plate.shape, self.sensor.bits
        exposed: list[Counts] = [np.empty(size, self.sensor.dtype) for _ in streams]
        kind = cv2.CV_8U if bits <= 8 else cv2.CV_16U
        for counts, rng in zip(exposed, streams, strict=True):
            raw = np.asarray(rng.bit_generator.random_raw(-(-counts.size // 4)))
            cells = raw.astype("<u8", copy=False).view("<u2")[: counts.size]
            if len(self.groups) == 1:
                noise = _look_up(self.groups[0][1], cells)
            else:
                noise = np.empty(counts.size, np.float32)
                for members, body, _ in self.groups:
                    noise[members] = body[cells[members]]
            cv2.add(noise.reshape(size), self.level, dst=counts, dtype=kind)  # rounds half to even and saturates
            saturated = _find_saturated(counts)
            if bits not in (8, 16):
                np.minimum(counts, (1 << bits) - 1, out=counts)
            outer = saturated[cells[saturated] + np.uint16(1) <= 1]  # the first cell and, wrapped round, the last
            counts.flat[outer] = digitise(self._draw_tails(outer, cells[outer], rng) + self.level.flat[outer], bits)
        return exposed

    def _draw_tails(self, outer: Index, cells: NDArray[np.uint16], rng: np.random.Generator) -> Float32:
        """Draw the noise of the pixels whose cells are outermost. outer: their numbers."""
        finer = rng.integers(0, CELLS_OF_TABLE, len(outer))
        side = (cells > 0).astype(int)
        if len(self.groups) == 1:
            return np.asarray(self.groups[0][2][side, finer])
        noise, owner = np.empty(len(outer), np.float32), self.owner[outer]
        for k, (_, _, tails) in enumerate(self.groups):
            own = owner == k
            noise[own] = tails[side[own], finer[own]]
        return noise


def _find_saturated(counts: Counts) -> Index:
    """Find the numbers of the pixels with the largest count; of a few bytes by a search from each to the next."""
    few, top = 64, int(np.iinfo(counts.dtype).max)
    if counts.dtype == np.uint8:
        whole, found = counts.tobytes(), list[int]()
        at = whole.find(top)
        while at >= 0 and len(found) < few:
            found.append(at)
            at = whole.find(top, at + 1)
        if at < 0:
            return np.array(found, dtype=np.intp)
    return np.flatnonzero(counts == top)


def _look_up(table: Float32, cells: NDArray[np.uint16]) -> Float32:
    """Compute table[cells]. OpenCV 5 does it four times faster; earlier versions have 8-bit tables only."""
    if int(cv2.__version__.split(".")[0]) >= 5:
        found: Any = cv2.LUT(cells.reshape(1, -1), table.reshape(1, -1))
        return np.asarray(found).ravel()
    return np.take(table, cells)


def tabulate_noise(mean: float, read_noise: float) -> tuple[Array, Array]:
    """Tabulate the noise of a pixel's electrons by their mean: shot noise and read noise.

    Returns the medians of 65536 equally likely cells, (65536,), and those of the divisions of the outer two cells,
    (2, 65536).
    """
    if mean == 0 and read_noise == 0:
        return np.zeros(CELLS_OF_TABLE), np.zeros((2, CELLS_OF_TABLE))
    spread = np.sqrt(mean + read_noise**2)
    numbers = np.arange(max(0, np.floor(mean - 9 * np.sqrt(mean) - 9)), np.ceil(mean + 9 * np.sqrt(mean) + 20))
    log_weights = numbers * np.log(mean) - mean - gammaln(numbers + 1) if mean > 0 else -1e9 * numbers
    weights = np.exp(log_weights)
    at = (np.arange(CELLS_OF_TABLE) + 0.5) / CELLS_OF_TABLE
    if read_noise == 0:
        below = np.cumsum(weights)
        above = np.cumsum(weights[::-1])[::-1]
        last = len(numbers) - 1
        middle = numbers[np.minimum(np.searchsorted(below, at), last)]
        low = numbers[np.minimum(np.searchsorted(below, at / CELLS_OF_TABLE), last)]
        high = numbers[np.maximum(len(numbers) - 1 - np.searchsorted(above[::-1], at / CELLS_OF_TABLE), 0)]
        return middle, np.stack([low, high])
    grid = np.linspace(max(mean - 9 * spread, -9 * read_noise), mean + 9 * spread + 20, 4096)
    below, above = _integrate_noise(grid, numbers, weights, read_noise)
    middle = np.interp(at, below, grid)
    # On a logarithmic scale, the interpolation stays accurate in the tails.
    low = np.interp(np.log(at / CELLS_OF_TABLE), np.log(below + 1e-300), grid)
    high = np.interp(np.log(at / CELLS_OF_TABLE), np.log(above[::-1] + 1e-300), grid[::-1])
    return middle, np.stack([low, high])


def _integrate_noise(grid: Array, numbers: Array, weights: Array, read_noise: float) -> tuple[Array, Array]:
    """Compute the probabilities of fewer and of more electrons than those of a grid.

    numbers, weights: of the electrons without read noise, the numbers rising by 1. Each tail is summed from its own end
    and the other side follows from it, so both tails keep their digits.
    """
    rows_at_once, last_score = 64, 10.0  # ndtr(-10) is 1e-23
    below, above = np.empty(len(grid)), np.empty(len(grid))
    sums = np.concatenate([[0.0], np.cumsum(weights)])
    rest = np.concatenate([np.cumsum(weights[::-1])[::-1], [0.0]])
    middle = numbers @ weights
    for first in range(0, len(grid), rows_at_once):
        rows = slice(first, first + rows_at_once)
        at = grid[rows]
        reach = last_score * read_noise
        low, high = np.searchsorted(numbers, (at[0] - reach, at[-1] + reach))
        scores = (at[:, None] - numbers[low:high]) / read_noise
        if at[-1] < middle:
            below[rows] = sums[low] + ndtr(scores) @ weights[low:high]
            above[rows] = sums[-1] - below[rows]
        else:
            above[rows] = rest[high] + ndtr(-scores) @ weights[low:high]
            below[rows] = sums[-1] - above[rows]
    return below, above


def _generator(root_seed: int, key: tuple[int, ...]) -> np.random.Generator:
    """Random numbers. key: (0,) of the fixed pattern, (2,) of hot pixels, (clip, 1, frame) of the noise."""
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence(root_seed, spawn_key=key)))
