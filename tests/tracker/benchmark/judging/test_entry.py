"""The published figure: a weighted mean of errors, computed by hand."""

import math

import numpy as np
import pytest
from benchmark_suite import Given, suite

from tracker.benchmark.judging.entry import judge_quantities


def test_the_published_value_is_the_weighted_mean_of_the_errors():
    made = suite()
    part = made.parts["bright"]
    true = made.scalars("axes").set_index("clip")["r"]
    stds, offs = {0: 1e-3, 1: 2e-3}, {0: 3e-3, 1: -1e-3}

    class Claims(Given):
        def of(self, film, clip):
            row = {"collision": 0, "status": "ok", "r": true[clip] + offs[clip], "r_std": stds[clip]}
            return super().of(film, clip)[0], [row]

    found = judge_quantities(made, Claims(made), part, min_collisions=2)
    weights = np.array([1 / stds[c] ** 2 for c in (0, 1)])
    mean = float((weights * [offs[0], offs[1]]).sum() / weights.sum())
    assert (found["clips"], found["measured"]) == (2, 2)
    assert found["r"]["published"] == pytest.approx(mean)
    assert found["r"]["published_std"] == pytest.approx(1 / math.sqrt(weights.sum()))
    assert found["r"]["bound"] > 0


def test_of_nothing_measured_nothing_is_published():
    made = suite()
    found = judge_quantities(made, Given(made), made.parts["bright"])
    assert found["measured"] == 0
    assert "r" not in found or math.isnan(found["r"]["published"])
