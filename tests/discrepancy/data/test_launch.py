"""The columns of a launch, by name."""

import numpy as np
import pytest

from discrepancy.data.launch import HEADING, SIZE, T_C, V0, B, X, Y, normal_speed, possible
from synthcam.dynamics.batch import LAUNCH

HITS = np.array([[0.0, 0.0, 0.1, 0.5, 1.0, 0.6], [0.0, 0.0, 0.1, 0.2, 1.0, -0.8]])


def test_names_are_those_of_the_motion():
    assert [LAUNCH[k] for k in (X, Y, T_C, V0, HEADING, B)] == ["x", "y", "t_c", "v0", "heading", "b"]
    assert len(LAUNCH) == SIZE


def test_the_normal_speed_is_the_part_along_the_line_of_centres():
    assert normal_speed(HITS) == pytest.approx([0.5 * 0.8, 0.2 * 0.6])


@pytest.mark.parametrize(("column", "value"), [(V0, 0.0), (V0, -0.1), (B, 1.0), (B, -1.2)])
def test_a_striker_that_rests_or_misses_is_no_launch(column, value):
    assert possible(HITS)
    wrong = HITS.copy()
    wrong[1, column] = value
    assert not possible(wrong)
