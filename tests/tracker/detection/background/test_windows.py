"""The coarse search and the sorting network give what scipy and numpy find in whole pictures."""

import cv2
import numpy as np
import pytest
from scipy import ndimage

from tracker.detection.background.still_background import (
    average_uncovered,
    cut_strips,
    estimate_still_background,
    sort_sheets,
)
from tracker.detection.background.windows import find_regions


def whole_search(mask, least):
    """Sets of pixels of the regions of a mask, found in the whole picture."""
    labels, count = ndimage.label(mask)  # four neighbours
    sets = (frozenset(map(tuple, np.argwhere(labels == k + 1).tolist())) for k in range(count))
    return {pixels for pixels in sets if len(pixels) > least}


def pixels_of(region):
    return frozenset((int(y) + region.top, int(x) + region.left) for y, x in np.argwhere(region.own))


@pytest.mark.parametrize("shape", [(48, 64), (50, 71), (16, 16), (7, 9), (33, 100)])
@pytest.mark.parametrize("share", [0.02, 0.3, 0.6])
def test_regions_are_those_of_the_whole_picture(shape, share):
    """Specks, blobs that share tiles, and one region over all; sizes that are no multiples of a tile."""
    rng = np.random.default_rng(1)
    mask = ndimage.uniform_filter(rng.random(shape), 3) < np.quantile(
        ndimage.uniform_filter(rng.random(shape), 3), share
    )
    found = find_regions(mask, 5)
    assert {pixels_of(region) for region in found} == whole_search(mask, 5)
    assert [region.area for region in found] == sorted((region.own.sum() for region in found), reverse=True)


def test_regions_of_an_exact_mask_lie_in_a_rough_one():
    """The rough mask joins two regions that the exact one parts; the specks of the rough one are none."""
    exact = np.zeros((80, 90), bool)
    exact[10:20, 10:20] = exact[10:20, 21:40] = exact[60:80, 80:90] = True
    rough = ndimage.binary_dilation(exact)
    rough[40, ::4] = True
    found = find_regions(rough, 28, lambda at: exact[at])
    assert {pixels_of(region) for region in found} == whole_search(exact, 28)
    assert [region.touches_rim(exact.shape) for region in found] == [True, False, False]


@pytest.mark.parametrize("count", [1, 2, 3, 8, 9, 12, 31])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_sorted_strips_are_those_of_numpy(count, dtype):
    rng, ranks = np.random.default_rng(count), (0, count // 3, (count - 1) // 2, count // 2)
    pictures = [rng.integers(0, 60, (40, 1000)).astype(dtype) for _ in range(count)]
    expected = np.sort(pictures, axis=0)[list(ranks)]
    out = np.full(expected.shape, -1.0)
    for at in cut_strips(pictures[0].shape):
        out[:, at] = sort_sheets([picture[at] for picture in pictures], ranks)
    assert np.array_equal(out, expected)


@pytest.mark.parametrize("count", [12, 31])
def test_a_background_that_is_never_covered_is_the_median(count):
    rng = np.random.default_rng(0)
    pictures = rng.integers(90, 96, (count, 30, 40)).astype(np.uint8)
    found = estimate_still_background(pictures, 3.0)
    assert np.array_equal(found.level, np.median(pictures, axis=0))
    assert found.known.all()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_background_over_boxes_is_that_of_averaged_frames_also_where_strips_meet(dtype):
    pictures = [np.random.default_rng(k).integers(90, 96, (70, 1000)).astype(dtype) for k in range(9)]
    pictures[4][:, :30] += 50  # what rests there is seen in one frame of nine
    whole = estimate_still_background([cv2.blur(p, (5, 5)) for p in pictures], 0.5)
    own = estimate_still_background(pictures, 0.5, (5, 5))
    for name in ("level", "error", "known"):
        assert np.array_equal(getattr(own, name), getattr(whole, name))


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_the_mean_of_the_middle_half_leaves_covered_pixels_out(dtype):
    rng = np.random.default_rng(0)
    pictures, covered = rng.integers(0, 250, (9, 20, 30)).astype(dtype), rng.random((9, 20, 30)) < 0.3
    changes = rng.integers(-3, 4, 9) * (dtype == np.float32)  # of brightness
    brighter = pictures + changes[:, None, None].astype(dtype)
    found = average_uncovered(list(brighter), list(np.packbits(covered, axis=2)), 2.0, list(changes))
    for row, column in np.argwhere(~covered.all(axis=0)):
        free = np.sort(pictures[~covered[:, row, column], row, column].astype(float))
        middle = free[len(free) // 4 : len(free) - len(free) // 4]
        assert found.level[row, column] == pytest.approx(middle.mean(), rel=1e-6)
        assert found.error[row, column] == pytest.approx(2 * np.sqrt(1.2 / len(free)), rel=1e-6)
    assert np.array_equal(found.known, ~covered.all(axis=0))
