"""Sorts pictures pixel by pixel, by a network of minima and maxima: exact, and fast on strips that fit into the cache."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

STRIP_PIXELS = 1 << 15  # of each picture; all strips of 31 pictures fit into a cache of 1 to 2 MB


def sort_strips(
    pictures: Sequence[NDArray[Any]], ranks: Sequence[int]
) -> Iterator[tuple[slice, list[NDArray[np.float32]]]]:
    """Sort pictures (h, w) of one type pixel by pixel, and yield strips of rows: which, and the values of these ranks.

    Rank 0 is the least value. Pixels are uint8, uint16 or float32.
    """
    height, width = pictures[0].shape
    network = _make_network(len(pictures), tuple(ranks))
    rows = max(STRIP_PIXELS // width, 1)
    for top in range(0, height, rows):
        at = slice(top, top + rows)
        sheets = [np.array(picture[at]) for picture in pictures]
        spare = np.empty_like(sheets[0])
        for low, high in network:
            one, two = sheets[low], sheets[high]
            sheets[low], spare = np.asarray(cv2.min(one, two, dst=spare)), one
            sheets[high] = np.asarray(cv2.max(one, two, dst=two))
        yield at, [sheets[rank].astype(np.float32) for rank in ranks]


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
