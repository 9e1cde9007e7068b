"""The integrator against closed forms."""

import numpy as np
import pytest

from synthcam.spectral import Path, integrate


def test_a_harmonic_oscillator_for_ten_turns():
    path = integrate(lambda _, y: np.column_stack([y[:, 1], -y[:, 0]]), 0.0, 20 * np.pi, [0.0, 1.0])
    x = np.linspace(0, 20 * np.pi, 500)
    np.testing.assert_allclose(path(x), np.column_stack([np.sin(x), np.cos(x)]), rtol=0, atol=2e-12)


@pytest.mark.parametrize("end", [3.0, -3.0])
def test_both_ways(end):
    path = integrate(lambda x, y: (np.cos(x) * y.T).T, 0.0, end, [2.0])
    x = np.linspace(0, end, 100)
    np.testing.assert_allclose(path(x)[:, 0], 2 * np.exp(np.sin(x)), rtol=1e-13)
    assert path.ends[0] == 0
    assert path.ends[-1] == end


def test_a_sharp_bend_is_halved_until_it_is_smooth():
    path = integrate(lambda x, y: 100 / np.cosh(100 * (x - 0.3))[:, None] ** 2, 0.0, 1.0, [0.0])
    x = np.linspace(0, 1, 333)
    exact = np.tanh(100 * (x - 0.3)) + np.tanh(30)
    np.testing.assert_allclose(path(x)[:, 0], exact, rtol=0, atol=1e-11)
    assert len(path.ends) > 3


def test_a_step_is_refused():
    with pytest.raises(ValueError, match="not smooth"):
        integrate(lambda x, y: np.where(x > np.pi / 10, 1.0, 0.0)[:, None], 0.0, 1.0, [0.0])


def test_a_runaway_is_refused_quietly():
    with pytest.raises(ValueError, match="not smooth"):
        integrate(lambda _, y: y**2, 0.0, 1.1, [1.0])


def test_outside_the_ends_it_goes_on():
    path = integrate(lambda _, y: np.ones_like(y), 0.0, 1.0, [0.0])
    assert isinstance(path, Path)
    np.testing.assert_allclose(path(np.array([-0.01, 1.01]))[:, 0], [-0.01, 1.01], rtol=0, atol=1e-12)
