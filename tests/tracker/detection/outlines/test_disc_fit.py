"""The quick median is numpy's."""

import numpy as np
import pytest

from tracker.detection.outlines.disc_fit import quick_median


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 400, 401])
def test_it_is_the_median_of_numpy(count):
    for kind in (np.float32, np.float64):
        values = np.random.default_rng(count).normal(0, 1, count).astype(kind)
        before = values.copy()
        assert quick_median(values) == np.median(values)
        assert np.array_equal(values, before)
    assert quick_median(np.full(count, 7.0)) == 7.0
