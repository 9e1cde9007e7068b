"""Finds connected regions: coarsely, in tiles of a picture, and pixel by pixel where a tile has some."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from synthcam_shared.arrays import Flags

TILE_PX = 16


Index: TypeAlias = tuple[slice, slice]


@dataclass(frozen=True, eq=False)
class PixelRegion:
    """A connected region (4 neighbours): its place in the picture, px, and which pixels of its box are its own."""

    left: int
    top: int
    area: int
    own: Flags

    @property
    def at(self) -> Index:
        """Index of the box into the picture."""
        height, width = self.own.shape
        return slice(self.top, self.top + height), slice(self.left, self.left + width)

    def touches_rim(self, shape: tuple[int, ...]) -> bool:
        """True if the region touches the rim of a picture of this shape."""
        rows, columns = self.at
        return min(self.left, self.top) == 0 or rows.stop == shape[0] or columns.stop == shape[1]


def find_regions(rough: Flags, least: float, examine: Callable[[Index], Flags] | None = None) -> list[PixelRegion]:
    """Find the connected regions of more than `least` pixels, the largest first.

    rough: a quick mask (h, w) that holds all of their pixels, and few others. examine: takes the index of a window, and
    returns its exact mask; default: `rough` is exact.
    """
    found = []
    for at, own in _find_windows(rough, least):
        mask = (rough[at] if examine is None else examine(at)) & own
        count, labels, boxes, _ = cv2.connectedComponentsWithStats(mask.view(np.uint8), connectivity=4)
        for k in range(1, count):
            left, top, width, height, area = boxes[k].tolist()
            if area > least:
                part = labels[top : top + height, left : left + width] == k
                found.append(PixelRegion(left + at[1].start, top + at[0].start, area, part))
    return sorted(found, key=lambda region: -region.area)


def _find_windows(mask: Flags, least: float) -> Iterator[tuple[Index, Flags]]:
    """Windows with regions of more than `least` pixels, each region in one of them; and the pixels of their tiles."""
    height, width = mask.shape
    counts = _count_in_tiles(mask)
    found, labels, boxes, _ = cv2.connectedComponentsWithStats((counts > 0).view(np.uint8), connectivity=8)
    totals = np.bincount(labels.ravel(), counts.ravel(), found)
    for k in range(1, found):
        if totals[k] <= least:
            continue
        left, top, across, down = boxes[k][:4].tolist()
        tiles = labels[top : top + down, left : left + across] == k
        rows = slice(top * TILE_PX, min((top + down) * TILE_PX, height))
        columns = slice(left * TILE_PX, min((left + across) * TILE_PX, width))
        own = tiles.repeat(TILE_PX, axis=0).repeat(TILE_PX, axis=1)
        yield (rows, columns), own[: rows.stop - rows.start, : columns.stop - columns.start]


def _count_in_tiles(mask: Flags) -> NDArray[np.int32]:
    """How many pixels of each tile are true."""
    height, width = mask.shape
    whole = height // TILE_PX
    byte = np.ascontiguousarray(mask).view(np.uint8)
    columns = byte[: whole * TILE_PX].reshape(whole, TILE_PX, width).sum(axis=1, dtype=np.uint8)
    if height % TILE_PX:
        columns = np.vstack([columns, byte[whole * TILE_PX :].sum(axis=0, dtype=np.uint8)])
    return np.add.reduceat(columns, np.arange(0, width, TILE_PX), axis=1, dtype=np.int32)
