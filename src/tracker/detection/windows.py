"""Finds the windows of a picture that hold connected regions, so that only these are examined pixel by pixel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

TILE_PX = 16


@dataclass(frozen=True, eq=False)
class Window:
    """A rectangle of a picture, and which of its pixels (h, w) belong to the same group of regions."""

    rows: slice
    columns: slice
    own: NDArray[np.bool_]

    @property
    def at(self) -> tuple[slice, slice]:
        """Index into the picture."""
        return self.rows, self.columns

    def widen(self, by: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
        """Index of the window with a rim of so many pixels, as far as it lies in the picture; of the window in it."""
        top, left = max(self.rows.start - by, 0), max(self.columns.start - by, 0)
        wide = slice(top, self.rows.stop + by), slice(left, self.columns.stop + by)
        inner = [slice(s.start - a, s.stop - a) for s, a in ((self.rows, top), (self.columns, left))]
        return wide, (inner[0], inner[1])


def find_windows(mask: NDArray[np.bool_], least: float) -> Iterator[Window]:
    """Find the windows of a mask (h, w) with its connected regions (4 neighbours) of more than `least` pixels.

    Regions in neighbouring tiles share a window. Each region lies in one window whole; a window may hold small ones too.
    """
    height, width = mask.shape
    counts = _count_in_tiles(mask)
    found, labels, boxes, _ = cv2.connectedComponentsWithStats((counts > 0).view(np.uint8), connectivity=8)
    totals = np.bincount(labels.ravel(), counts.ravel(), found)
    for k in np.flatnonzero(totals > least).tolist():
        if k == 0:
            continue
        left, top, across, down = boxes[k][:4].tolist()
        tiles = labels[top : top + down, left : left + across] == k
        rows = slice(top * TILE_PX, min((top + down) * TILE_PX, height))
        columns = slice(left * TILE_PX, min((left + across) * TILE_PX, width))
        own = tiles.repeat(TILE_PX, axis=0).repeat(TILE_PX, axis=1)
        yield Window(rows, columns, own[: rows.stop - rows.start, : columns.stop - columns.start])


def _count_in_tiles(mask: NDArray[np.bool_]) -> NDArray[np.int32]:
    """How many pixels of each tile are true."""
    height, width = mask.shape
    whole = height // TILE_PX
    byte = np.ascontiguousarray(mask).view(np.uint8)
    columns = byte[: whole * TILE_PX].reshape(whole, TILE_PX, width).sum(axis=1, dtype=np.uint8)
    if height % TILE_PX:
        columns = np.vstack([columns, byte[whole * TILE_PX :].sum(axis=0, dtype=np.uint8)])
    return np.add.reduceat(columns, np.arange(0, width, TILE_PX), axis=1, dtype=np.int32)
