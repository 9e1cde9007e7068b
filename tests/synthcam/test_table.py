import numpy as np
import pytest

from synthcam.table import Table

X = (0.0, 0.1, 0.25, 0.3, 0.6)


def test_a_cubic_is_itself_between_uneven_places():
    places = np.linspace(0, 0.6, 97)
    curve = Table(X, tuple(1 + x - 4 * x**3 for x in X))
    np.testing.assert_allclose(curve(places), 1 + places - 4 * places**3, rtol=1e-13)


def test_two_and_three_places_are_a_line_and_a_parabola():
    assert Table((0.0, 1.0), (2.0, 4.0))(np.array(0.25)) == pytest.approx(2.5, rel=1e-14)
    assert Table((0.0, 1.0, 2.0), (0.0, 1.0, 4.0))(np.array(0.5)) == pytest.approx(0.25, rel=1e-14)


def test_beyond_the_ends_it_stays_as_it_is_there():
    curve = Table(X, tuple(x**2 for x in X))
    np.testing.assert_allclose(curve(np.array([-1.0, 0.6, 0.7, 50.0])), [0.0, 0.36, 0.36, 0.36], atol=1e-15)


@pytest.mark.parametrize("closed", [True, False])
def test_of_an_angle_it_goes_on_after_a_whole_turn(closed):
    angles = np.linspace(-np.pi, np.pi, 73)
    if not closed:
        angles = angles[:-1]
    curve = Table(tuple(angles.tolist()), tuple(np.cos(2 * angles).tolist()), turn=True)
    where = np.array([-3.1, 0.02, 3.14159, 0.02 + 2 * np.pi, -40.0])
    np.testing.assert_allclose(curve(where), np.cos(2 * where), atol=2e-5)  # (2 pi / 36)^4 / 384 is 2.4e-6 of a step
    assert curve(np.array(0.02)) == pytest.approx(curve(np.array(0.02 + 2 * np.pi)), abs=1e-13)


def test_a_map_of_two_parts_is_a_product_of_cubics_within_and_its_edge_without():
    sides = np.linspace(0, 1, 5), np.linspace(-1, 1, 4)
    x, y = (s.ravel() for s in np.meshgrid(*sides))  # not in the order of the sides
    pairs = tuple(zip(x.tolist(), y.tolist(), strict=True))
    both = Table(pairs, tuple(zip((x**3 * y**2).tolist(), (x - y**3).tolist(), strict=True)))
    a, b = np.array([0.13, 0.7]), np.array([0.41, -0.9])
    np.testing.assert_allclose(both(a, b), np.stack([a**3 * b**2, a - b**3], axis=-1), atol=1e-13)
    np.testing.assert_allclose(both(np.array(7.0), np.array(0.5)), [0.25, 1 - 0.125], atol=1e-13)


@pytest.mark.parametrize(
    ("x", "y", "turn", "said"),
    [
        ((0.0,), (1.0,), False, "x: expected 2 to"),
        ((0.0, 1.0), (1.0,), False, "y: expected a value for each of 2 places, found 1"),
        ((0.0, 0.0), (1.0, 2.0), False, "x: expected rising"),
        ((0.0, float("nan")), (1.0, 2.0), False, "x: expected finite"),
        ((0.0, 1.0), (1.0, (2.0, 3.0)), False, "y: expected finite numbers, or pairs"),
        (((0.0, 0.0), (0.0, 1.0), (1.0, 0.0)), (1.0, 1.0, 1.0), False, "whole grid"),
        (((0.0, 0.0), (0.0, 1.0)), (1.0, 1.0), False, "two places or more along each axis"),
        ((0.0, 7.0), (1.0, 2.0), True, "within one turn"),
        ((0.0, 3.0, 2 * np.pi), (1.0, 2.0, 1.5), True, "same value after a whole turn"),
    ],
)
def test_what_is_no_table_is_said(x, y, turn, said):
    with pytest.raises(ValueError, match=said):
        Table(x, y, turn)
