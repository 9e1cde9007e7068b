"""Packing the true places of a mask, against a loop."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from synthcam.dynamics.packed import PackedRows


@given(arrays(bool, st.tuples(st.integers(1, 6), st.integers(1, 9))))
def test_each_row_keeps_its_own_in_order(mask):
    values = np.arange(mask.size, dtype=float).reshape(mask.shape)
    some = PackedRows(mask)
    packed = some.gather(values)
    assert packed.shape == (len(mask), mask.sum(axis=1).max())
    assert some.any == mask.any()
    for row, own, kept, taken in zip(values, mask, packed, some.inside, strict=True):
        np.testing.assert_array_equal(kept[: own.sum()], row[own])
        np.testing.assert_array_equal(kept[own.sum() :], 0.0)
        np.testing.assert_array_equal(taken, np.arange(len(taken)) < own.sum())
