"""Derivatives by a parameter that hardly moves the tracks are zero."""

import numpy as np
import pytest

from discrepancy.fitting.jacobian import zero_unidentifiable_shapes
from discrepancy.fitting.parameters import list_candidates
from synthcam.model import Model


@pytest.mark.parametrize(("seen", "silent"), [(0.9, True), (1.1, False)])
def test_a_positive_shape_that_its_whole_range_hardly_shows_is_silent(seen, silent):
    """Its range is of factors: the derivative by its logarithm is its value times that by itself."""
    model = Model().replace({"stribeck.rise": 1e-3, "stribeck.slip": 0.07})
    stribeck = next(s for s in list_candidates(Model(), ()) if s.name == "stribeck")
    tried = [shapes["stribeck.slip"] for shapes in stribeck.grid(Model())]
    slope = seen / (0.07 * np.log(max(tried) / min(tried)))
    (left,) = zero_unidentifiable_shapes(
        model, ["stribeck.rise", "stribeck.slip"], (np.array([[1e-9, 0.6 * slope], [0, 0.8 * slope]]),)
    )
    assert left[0, 0] == 1e-9  # a strength has no range
    assert left[:, 1].any() != silent
