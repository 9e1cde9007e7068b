"""The picture of one exposure: the shutter time in pieces, the spots blurred in each, and the pixels that change.

The unit of a picture is the peak pixel of a glint after blur and pixel integration. The glint is the primary one of a
ball at rest at the world's origin, and lies on a pixel's centre.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.special import ndtr

from synthcam.camera.pinhole import PinholeCamera
from synthcam_shared.arrays import Array, Float32, Index, list_gauss_nodes

Box = tuple[slice, slice]


@dataclass(frozen=True)
class Picture:
    """The mean image over one exposure."""

    plate: Float32  # the image (h, w) without balls; the same array for a whole film
    boxes: tuple[Box, ...]  # disjoint rows and columns outside of which the image is the plate
    parts: tuple[Float32, ...]  # the image in each box
    changed: Index | None = None  # of many balls: numbers of the pixels in the boxes that differ from the plate

    @cached_property
    def image(self) -> Float32:
        """(h, w)."""
        image = self.plate.copy()
        for box, part in zip(self.boxes, self.parts, strict=True):
            image[box] = part
        return image


@dataclass(frozen=True)
class SubExposures:
    """Sub-exposures, each with its weight in the mean of its frame."""

    times: Array  # (T,), s
    weights: Array  # (T,)
    frames: Index  # numbers (T,)


def split_at_breaks(intervals: Array, breaks: Array) -> tuple[Array, Array, Index]:
    """Split exposures (F, 2), s, at the breaks.

    Returns bounds (P, 2), s, weights (P,), which sum to 1 in a frame, and numbers of the frames (P,).
    """
    bounds, weights, frames = [], [], []
    for frame, (start, end) in enumerate(intervals):
        inside = breaks[(breaks > start) & (breaks < end)]
        for a, b in pairwise([start, *inside, end]):
            bounds.append((a, b))
            weights.append((b - a) / (end - start) if end > start else 1.0)
            frames.append(frame)
    return np.array(bounds).reshape(-1, 2), np.array(weights), np.array(frames, dtype=np.intp)


def place_sub_exposures(
    bounds: Array, weights: Array, frames: Index, travel: Array, wave: Array | float = 0
) -> SubExposures:
    """Place the nodes of the sub-exposures in each piece that `split_at_breaks` returns.

    Their number keeps the blurred glint within 1e-4 of its peak. Its centroid is exact for any number if the motion is
    a polynomial of low degree. travel: path (P,) of the balls over the blur's sigma. wave: change (P,) of the light's
    phase, rad.
    """
    counts = np.select([travel < 0.02, travel < 0.5], [1, 2], 2 + np.ceil(travel)).astype(int)
    counts = np.maximum(counts, np.where(np.asarray(wave) > 0, 2 + np.ceil(wave), 1).astype(int))
    middles, halves = bounds.mean(axis=1), np.diff(bounds, axis=1)[:, 0] / 2
    times, parts = [np.zeros(0)], [np.zeros(0)]
    for middle, half, weight, n in zip(middles, halves, weights, counts.tolist(), strict=True):
        nodes, shares = list_gauss_nodes(n)
        times.append(middle + half * nodes)
        parts.append(weight / 2 * shares)
    return SubExposures(np.concatenate(times), np.concatenate(parts), np.repeat(frames, counts))


def merge_sub_exposures(
    moments: SubExposures, positions: Array, pixels: Array, counts: Index
) -> tuple[SubExposures, Array, Array]:
    """Merge the sub-exposures of each frame into counts (F,) of them, by their order in time.

    A ball then stands at its mean position, wherever its velocity jumped. Returns the merged ones, their positions (T,
    N, 3), m, and variances (T, N, 2), px^2: of the balls' pixels (., N, 2) about these. A spot that is widened by the
    variances keeps its first three moments.
    """
    whole = np.bincount(moments.frames, moments.weights, len(counts))
    before = np.cumsum(moments.weights) - moments.weights / 2 - (np.cumsum(whole) - whole)[moments.frames]
    wanted = counts[moments.frames]
    part = np.clip(before / whole[moments.frames] * wanted, 0, wanted - 1).astype(int)
    key = (np.cumsum(counts) - counts)[moments.frames] + part
    first = np.flatnonzero(np.diff(key, prepend=-1))
    weights = np.add.reduceat(moments.weights, first)
    share = moments.weights / np.repeat(weights, np.diff(np.append(first, len(key))))

    def mean(of: Array) -> Array:
        return np.asarray(np.add.reduceat(of * share.reshape(-1, *[1] * (of.ndim - 1)), first))

    middle = np.repeat(mean(pixels), np.diff(np.append(first, len(key))), axis=0)
    merged = SubExposures(mean(moments.times), weights, moments.frames[first])
    return merged, mean(positions), mean((pixels - middle) ** 2)


def integrate_spots(pixels: Array, variances: Array, origins: Array, width: int, steps: int = 1) -> tuple[Array, Array]:
    """Integrate the blurred spots of an exposure, Gaussians of unit flux, over square pixels: rows and columns.

    Their outer product is the spot in the box whose first pixel is origins (G, 2) (column, row), sampled at `steps`
    points per pixel.
    """
    edges = np.arange(width * steps + steps) / steps - 0.5
    sides = []
    for axis in (1, 0):
        position = (pixels - origins)[:, axis, None]
        below = ndtr((edges - position) / np.sqrt(variances[:, axis, None]))
        sides.append(below[:, steps:] - below[:, :-steps])
    return sides[0], sides[1]


def blur_matrix(width: int, margin: int, fineness: int, sigma: float, steps: int = 1) -> Float32:
    """Make the matrix (width steps, (width - 2 margin) fineness) from samples of a line to blurred pixels.

    Each sample is 1/fineness px wide. It is blurred by a Gaussian and integrated over each pixel, at `steps` points per
    pixel. The pixels reach `margin` further out than the samples on both sides.
    """
    at = (np.arange((width - 2 * margin) * fineness) + 0.5) / fineness - 0.5 + margin
    edges = np.arange(width * steps + steps)[:, None] / steps - 0.5
    below = ndtr((edges - at) / sigma)
    return ((below[steps:] - below[:-steps]) / fineness).astype(np.float32)


def blur_tiles(tiles: Float32, blur: Float32) -> Float32:
    """Compute blur @ tiles @ blur.T for tiles (n, s, s) and blur (w, s), by the band of the matrix and in pieces.

    OpenBLAS starts threads for products of more than 2.6e5 multiplications. The last bit then depends on their number.
    On busy cores the threads wait for each other: 25 to 90 ms for 2 ms of work.
    """
    if blur.size * blur.shape[1] < 2e5:
        return np.asarray(blur @ tiles @ blur.T)
    across = _multiply_by_bands(tiles, blur)
    return np.swapaxes(_multiply_by_bands(np.ascontiguousarray(np.swapaxes(across, 1, 2)), blur), 1, 2)


def _multiply_by_bands(tiles: Float32, blur: Float32) -> Float32:
    out = np.empty((len(tiles), len(blur), tiles.shape[2]), np.float32)
    for first in range(0, len(blur), 16):
        rows = slice(first, first + 16)
        used = np.flatnonzero((blur[rows] > 1e-12).any(axis=0))
        band = slice(used[0], used[-1] + 1) if len(used) else slice(None)
        part = np.ascontiguousarray(blur[rows, band])
        strip = max(1, int(2e5 / part.size))
        for left in range(0, tiles.shape[2], strip):
            out[:, rows, left : left + strip] = part @ tiles[:, band, left : left + strip]
    return out


class BallSquares:
    """Squares of pixels, one for each frame and ball in view, wide enough for the ball, its motion and the blur.

    A patch depends on its own frame alone. origins: first column and row (P, 2). widths: (P,) px. number: the patch of
    a frame and ball (F, N); -1 out of view.
    """

    def __init__(
        self, camera: PinholeCamera, margin: int, moments: SubExposures, pixels: Array, extent: Array, frames: int
    ) -> None:
        self.margin = margin
        balls = pixels.shape[1]
        low, high = np.full((frames, balls, 2), np.inf), np.full((frames, balls, 2), -np.inf)
        around = extent[..., None] + self.margin
        np.minimum.at(low, moments.frames, pixels - around)
        np.maximum.at(high, moments.frames, pixels + around)
        inside = ((high > 0) & (low < np.array(camera.size) - 1)).all(axis=2)
        self.number = np.full((frames, balls), -1)
        self.number[inside] = np.arange(inside.sum())
        self.origins = np.floor(low[inside]).astype(int)
        ends = np.ceil(high[inside]).astype(int) + 1
        # In steps of 8 px, so that many patches have one width and are drawn together.
        self.widths = -(-(ends - self.origins).max(axis=1) // 8) * 8

    def ranks(self, selected: Index) -> Index:
        """Rank of each patch among the `selected`; -1 for others and, as the last entry, for no patch."""
        ranks = np.full(len(self.widths) + 1, -1)
        ranks[selected] = np.arange(len(selected))
        return ranks

    def box(self, number: int, size: tuple[int, int]) -> tuple[int, int, int, int]:
        """Top, bottom, left and right of a patch within an image of size (w, h)."""
        (left, top), width, (w, h) = self.origins[number].tolist(), int(self.widths[number]), size
        return max(top, 0), min(top + width, h), max(left, 0), min(left + width, w)


def outline_half_width(camera: PinholeCamera, positions: Array, radii: Array, slope: Array) -> Array:
    """Compute the half width (T, N) px of each ball in an exposure: an ellipse off the camera's axis."""
    away = camera.centre - positions
    slant = np.linalg.norm(away, axis=2) / -(away @ camera.R[2])
    return np.asarray(radii * np.linalg.norm(slope, axis=(2, 3)) * slant / np.sqrt(2) * 1.02 + 0.5)


def merge_boxes(boxes: Sequence[tuple[int, int, int, int]]) -> tuple[Box, ...]:
    """Merge the patches of an exposure that touch: from boxes (top, bottom, left, right), disjoint rows and columns."""
    apart: list[tuple[int, int, int, int]] = []
    for new in boxes:
        a, b, c, d = new
        while True:
            touching = [q for q in apart if a < q[1] and q[0] < b and c < q[3] and q[2] < d]
            if not touching:
                break
            apart = [q for q in apart if q not in touching]
            a, c = min(a, *(q[0] for q in touching)), min(c, *(q[2] for q in touching))
            b, d = max(b, *(q[1] for q in touching)), max(d, *(q[3] for q in touching))
        apart.append((a, b, c, d))
    return tuple((slice(a, b), slice(c, d)) for a, b, c, d in apart)


def add_to_plate(
    plate: Float32, corners: Sequence[tuple[int, int, int, int]], changes: Sequence[tuple[Box, Float32, Float32 | None]]
) -> Picture:
    """Add the patches that balls change, one or two in each box, to the picture of a plate. corners: of the boxes.

    Boxes that touch are merged, and few boxes stay. The merged boxes of many balls would hold much of the plate: the
    picture is then one box, with a list of its changed pixels.
    """
    least_change = 1e-5  # over the peak of a glint, by which a pixel differs from the plate
    many = len(corners) > 4  # balls, up to which their pixels are drawn in boxes
    if many:
        boxes: tuple[Box, ...] = ((slice(0, plate.shape[0]), slice(0, plate.shape[1])),)
        changed = np.zeros(plate.shape, bool)
    else:
        boxes = merge_boxes(corners)
    parts = [plate[box].copy() for box in boxes]
    for (here, *added), (top, bottom, left, right) in zip(changes, corners, strict=True):
        rows, columns, part = next(
            (rows, columns, part)
            for (rows, columns), part in zip(boxes, parts, strict=True)
            if rows.start <= top < rows.stop and columns.start <= left < columns.stop
        )
        image = part[top - rows.start : bottom - rows.start, left - columns.start : right - columns.start]
        for change in added:
            if change is not None:
                image += change
                if many:
                    changed[here] |= np.abs(change) > least_change
    return Picture(plate, boxes, tuple(parts), np.flatnonzero(changed) if many else None)
