"""A lamp's cells against its own shape, and flicker against a plain mean."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from synthcam.camera.lamp import Flicker, Lamp

AT = np.array([0.02, -0.01, 0.45])
SHAPES = {
    "disc": (Lamp(AT, 0.05), lambda u, v: u * u + v * v < 0.05**2),
    "ring": (Lamp(AT, 0.05, "ring", 0.03), lambda u, v: (u * u + v * v < 0.05**2) & (u * u + v * v > 0.03**2)),
    "bar": (
        Lamp(AT, 0.01, "bar", length=0.08, width=0.02, angle=0.7),
        lambda u, v: (abs(u * np.cos(0.7) + v * np.sin(0.7)) < 0.04) & (abs(v * np.cos(0.7) - u * np.sin(0.7)) < 0.01),
    ),
}


def second_moments(cells):
    """xx, yy, xy of the whole lamp about its middle, and its area."""
    at, area = (cells.positions - AT)[:, :2], cells.areas
    own = cells.spread + np.stack([at[:, 0] ** 2, at[:, 1] ** 2, at[:, 0] * at[:, 1]], axis=1)
    return area @ own / area.sum(), area.sum()


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("largest", [1.0, 0.02, 0.004])
def test_cells_make_up_the_lamp(name, largest):
    lamp, inside = SHAPES[name]
    side = (np.arange(1200) + 0.5) / 1200 * 0.12 - 0.06
    u, v = np.meshgrid(side, side)
    lit = inside(u, v)
    cells = lamp.cells(largest)
    moments, area = second_moments(cells)
    assert area == pytest.approx(lit.sum() * 1e-8, rel=2e-3)
    np.testing.assert_allclose(moments, [np.mean(w[lit]) for w in (u * u, v * v, u * v)], rtol=4e-3, atol=2e-7)
    assert (len(cells.areas) > 1) == (largest < 0.05 if name != "bar" else largest < 0.04)
    assert 4 * np.sqrt(cells.spread[:, :2].max()) < 2.1 * largest or largest == 1.0


def test_a_lamp_turned_to_the_centre_faces_it():
    lamp = Lamp(np.array([0.3, 0.1, 0.4]), 0.02, towards=np.zeros(3))
    shine = lamp.axes[:, 2]
    np.testing.assert_allclose(lamp.position + np.linalg.norm(lamp.position) * shine, 0, atol=1e-12)
    np.testing.assert_allclose(lamp.axes.T @ lamp.axes, np.eye(3), atol=1e-12)
    assert abs((lamp.cells(0.002).positions - lamp.position) @ shine).max() < 1e-12
    np.testing.assert_array_equal(Lamp(AT, 0.01).axes, np.diag([1.0, 1.0, -1.0]))


@given(st.floats(0, 1), st.floats(20, 400), st.floats(-4, 4), st.floats(0, 1), st.floats(0, 0.02))
def test_flicker_over_an_exposure_is_the_mean(depth, frequency, phase, start, length):
    flicker = Flicker(depth, frequency, phase)
    times = start + (np.arange(2000) + 0.5) / 2000 * length
    expected = np.mean(1 + depth * np.cos(2 * np.pi * frequency * times + phase))
    assert flicker.mean(np.array(start), np.array(start + length)) == pytest.approx(expected, abs=1e-4)
    assert Flicker().mean(np.array(start), np.array(start)) == 1.0


def test_a_lamp_without_area_is_refused():
    with pytest.raises(ValueError, match="lamp inner"):
        Lamp(AT, 0.05, "ring")
    with pytest.raises(ValueError, match="lamp length"):
        Lamp(AT, 0.05, "bar")
