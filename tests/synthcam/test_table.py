import numpy as np
import pytest

from synthcam.table import SmoothTable

X = (0.0, 0.1, 0.25, 0.3, 0.6)


def test_a_straight_line_is_itself_whatever_the_places_and_goes_through_all_values():
    places = np.linspace(0, 0.6, 97)
    np.testing.assert_allclose(SmoothTable(X, tuple(1 - 2 * x for x in X))(places), 1 - 2 * places, atol=1e-13)
    rough = (0.1, 0.5, -0.2, 0.3, 0.25)
    np.testing.assert_allclose(SmoothTable(X, rough)(np.array(X)), rough, atol=1e-13)
    assert SmoothTable((0.0, 1.0), (2.0, 4.0))(np.array(0.25)) == pytest.approx(2.5, rel=1e-14)


def test_a_smooth_curve_is_followed_between_its_places():
    x, between = np.linspace(0, 1, 41), np.linspace(0, 1, 977)
    bump = SmoothTable(tuple(x.tolist()), tuple(np.exp(-(((x - 0.4) / 0.1) ** 2) / 2).tolist()))
    np.testing.assert_allclose(bump(between), np.exp(-(((between - 0.4) / 0.1) ** 2) / 2), atol=1e-5)


def test_beyond_the_ends_it_levels_off_within_a_twentieth_of_the_range():
    line = SmoothTable((0.0, 0.2, 1.0), (0.0, 0.4, 2.0))
    np.testing.assert_allclose(line(np.array([1.2, 7.0, -3.0])), [2.1, 2.1, -0.1], atol=1e-9)
    flat = SmoothTable((0.0, 1.0), (3.0, 3.0))
    np.testing.assert_allclose(flat(np.array([-1.0, 2.0])), 3.0, atol=1e-14)


@pytest.mark.parametrize("closed", [True, False])
def test_of_an_angle_it_goes_on_after_a_whole_turn(closed):
    angles = np.linspace(-np.pi, np.pi, 73)
    if not closed:
        angles = angles[:-1]
    curve = SmoothTable(tuple(angles.tolist()), tuple(np.cos(2 * angles).tolist()), turn=True)
    where = np.array([-3.1, 0.02, 3.14159, 0.02 + 2 * np.pi, -40.0])
    np.testing.assert_allclose(curve(where), np.cos(2 * where), atol=1e-7)
    assert curve(np.array(0.02)) == pytest.approx(curve(np.array(0.02 + 2 * np.pi)), abs=1e-13)
    three = SmoothTable((-2.0, 0.0, 2.0), (1.0, 2.0, 1.0), turn=True)
    assert three(np.array(np.pi)) == pytest.approx(three(np.array(-np.pi)), abs=1e-13)


def test_a_map_of_two_parts_is_a_product_of_lines_within_and_level_without():
    sides = np.linspace(0, 1, 5), np.linspace(-1, 1, 4)
    x, y = (s.ravel() for s in np.meshgrid(*sides))  # not in the order of the sides
    pairs = tuple(zip(x.tolist(), y.tolist(), strict=True))
    both = SmoothTable(pairs, tuple(zip((x * (2 + y)).tolist(), (x - y).tolist(), strict=True)))
    a, b = np.array([0.13, 0.7]), np.array([0.41, -0.9])
    np.testing.assert_allclose(both(a, b), np.stack([a * (2 + b), a - b], axis=-1), atol=1e-12)
    np.testing.assert_allclose(both(np.array(7.0), np.array(0.5)), [1.05 * 2.5, 1.05 - 0.5], atol=1e-8)
    assert both(np.zeros((3, 4)), np.zeros((3, 4))).shape == (3, 4, 2)


@pytest.mark.parametrize(
    ("x", "y", "turn", "said"),
    [
        ((0.0,), (1.0,), False, "x: expected 2 to"),
        ((0.0, 1.0), (1.0,), False, "y: expected a value for each of 2 points, found 1"),
        ((0.0, 0.0), (1.0, 2.0), False, "x: expected rising"),
        ((0.0, float("nan")), (1.0, 2.0), False, "x: expected finite"),
        ((0.0, 1.0), (1.0, (2.0, 3.0)), False, "y: expected finite numbers, or pairs"),
        (((0.0, 0.0), (0.0, 1.0), (1.0, 0.0)), (1.0, 1.0, 1.0), False, "whole grid"),
        (((0.0, 0.0), (0.0, 1.0)), (1.0, 1.0), False, "2 points or more along each axis"),
        ((0.0, 7.0), (1.0, 2.0), True, "within one turn"),
        ((0.0, 1e-9, 2e-9, 1.0), (1.0, 2.0, 1.0, 2.0), False, "points that are spaced more evenly"),
        ((0.0, 3.0, 2 * np.pi), (1.0, 2.0, 1.5), True, "same value after a whole turn"),
    ],
)
def test_what_is_no_table_is_said(x, y, turn, said):
    with pytest.raises(ValueError, match=said):
        SmoothTable(x, y, turn)
