"""The columns of a launch, by name."""

import numpy as np
import pytest

from discrepancy.data.launch import (
    HEADING,
    SIDE,
    SLIP,
    T_C,
    V0,
    WITH_SPIN,
    B,
    X,
    Y,
    allow_side_spin,
    equalise_launches,
    find_free_launch_columns,
    is_possible_launch,
    limit_spins,
    normal_speed,
)
from synthcam.dynamics.batch import LAUNCH_COLUMNS
from synthcam.dynamics.launch import SPIN_COLUMNS

HITS = np.array([[0.0, 0.0, 0.1, 0.5, 1.0, 0.6], [0.0, 0.0, 0.1, 0.2, 1.0, -0.8]])


def test_names_are_those_of_the_motion():
    assert [LAUNCH_COLUMNS[k] for k in (X, Y, T_C, V0, HEADING, B)] == ["x", "y", "t_c", "v0", "heading", "b"]
    assert [(LAUNCH_COLUMNS + SPIN_COLUMNS)[k] for k in (*range(WITH_SPIN)[SLIP], SIDE)] == [
        "slip_along",
        "slip_across",
        "side",
    ]
    assert len(LAUNCH_COLUMNS + SPIN_COLUMNS) == WITH_SPIN


def test_the_normal_speed_is_the_part_along_the_line_of_centres():
    assert normal_speed(HITS) == pytest.approx([0.5 * 0.8, 0.2 * 0.6])


@pytest.mark.parametrize(("column", "value"), [(V0, 0.0), (V0, -0.1), (B, 1.0), (B, -1.2)])
def test_a_striker_that_rests_or_misses_is_no_launch(column, value):
    assert is_possible_launch(HITS)
    wrong = HITS.copy()
    wrong[1, column] = value
    assert not is_possible_launch(wrong)


@pytest.mark.parametrize(("side", "start"), [((), 5e-4), ((0.0, 0.0, 0.0), 5e-4), ((0.0, 0.1, -0.02), -0.02)])
def test_a_striker_without_side_spin_starts_from_a_small_one(side, start):
    """No derivative leads a fit on from zero, where a launch has no column to be fitted."""
    found = allow_side_spin(np.array([*HITS[0], *side]))
    assert found[SIDE] == pytest.approx(start)
    assert found[SLIP].tolist() == list(side[:2] or (0.0, 0.0))
    assert find_free_launch_columns(found[None])[0, SIDE]


def test_a_ball_that_rolls_has_no_slip_to_be_fitted():
    rolls, spins, slides = HITS[0], [*HITS[0], 0.0, 0.0, 0.1], [*HITS[0], 0.0, -0.1, 0.0]
    every = np.array(equalise_launches([rolls, np.array(spins), np.array(slides)]))
    assert find_free_launch_columns(every)[:, :6].all()
    assert find_free_launch_columns(every)[:, 6:].tolist() == [[False] * 3, [False, False, True], [True, True, False]]
    assert [len(one) for one in equalise_launches([rolls, np.array([*rolls, 0.0, 0.0, 0.0])])] == [6, 6]


@pytest.mark.parametrize(
    ("rejected", "told", "each"),
    [(8, 6, True), (8, 5, False), (0, 6, False)],
)
def test_where_strikers_spin_that_no_rejected_model_tells_each_may(rejected, told, each):
    """Six strikers spin, and eight others are in clips whose model is rejected; five are too few to tell."""
    rolls, spins = HITS[0], np.array([*HITS[0], 0.0, 0.0, 0.1])
    every = np.array(
        equalise_launches(told * [spins] + 8 * [rolls], told * [False] + rejected * [True] + (8 - rejected) * [False])
    )
    assert find_free_launch_columns(every)[told:, 8].all() == each
    assert find_free_launch_columns(every)[:told, 8].all()


def test_a_striker_whose_slide_has_all_but_ended_rolls():
    """A slip that ends has no direction: derivatives by it were 1e5 of those by all else, and no step gained."""
    launches = np.array([[0, 0, 0.1, 2.0, 0, 0.3, 0.03, -0.02, 1.0], [0, 0, 0.1, 2.0, 0, 0.3, 0.05, 0.0, 0.0]])
    rolling = limit_spins(launches)
    assert rolling[0].tolist() == [0, 0, 0.1, 2.0, 0, 0.3, 0, 0, 1.0]
    assert np.array_equal(rolling[1], launches[1])
    assert np.array_equal(limit_spins(launches[:, :6]), launches[:, :6])


def test_no_striker_spins_far_faster_than_it_moves():
    """Slips of 10^3 m/s were fitted to strikers of 4 m/s that did not slide as the model says."""
    launches = np.array([[0, 0, 0.1, 2.0, 0, 0.3, 300.0, -400.0, 90.0], [0, 0, 0.1, 2.0, 0, 0.3, 6.0, 3.0, -19.0]])
    held = limit_spins(launches)
    assert held[0, 6:] == pytest.approx([12.0, -16.0, 20.0])
    assert np.array_equal(held[1], launches[1])
    assert np.array_equal(held[:, :6], launches[:, :6])


def test_where_most_strikers_spin_each_may():
    rolls, spins = HITS[0], np.array([*HITS[0], 0.0, 0.0, 0.1])
    assert find_free_launch_columns(np.array(equalise_launches([rolls, spins, -spins])))[:, SIDE].all()
    assert find_free_launch_columns(np.array(equalise_launches([rolls, rolls, spins])))[:, SIDE].tolist() == [
        False,
        False,
        True,
    ]
