"""The integrator against closed forms."""

import numpy as np
import pytest

from synthcam.spectral import Path, integrate


def test_harmonic_oscillators_for_ten_turns():
    def right(_, y):
        return np.stack([y[..., 1], -y[..., 0]], axis=-1)

    path = integrate(right, 0.0, 20 * np.pi, np.array([[0.0, 1.0], [1.0, 0.0]]))
    x = np.linspace(0, 20 * np.pi, 500)
    sine, cosine = np.column_stack([np.sin(x), np.cos(x)]), np.column_stack([np.cos(x), -np.sin(x)])
    np.testing.assert_allclose(path(np.stack([x, x])), [sine, cosine], rtol=0, atol=2e-12)


@pytest.mark.parametrize("end", [3.0, -3.0])
def test_both_ways(end):
    path = integrate(lambda x, y: np.cos(x)[:, None] * y, 0.0, end, np.array([[2.0]]))
    x = np.linspace(0, end, 100)
    np.testing.assert_allclose(path(x[None])[0, :, 0], 2 * np.exp(np.sin(x)), rtol=1e-13)
    assert path.ends[0] == 0
    assert path.ends[-1] == end


def test_each_problem_at_times_of_its_own():
    path = integrate(lambda x, y: y, 0.0, 1.0, np.array([[1.0], [2.0], [-3.0]]))
    x = np.random.default_rng(0).uniform(0, 1, (3, 40))
    np.testing.assert_allclose(path(x)[..., 0], np.exp(x) * [[1], [2], [-3]], rtol=1e-13)


def test_a_sharp_bend_is_halved_until_it_is_smooth():
    def right(x, y):
        return np.array([1.0, 2.0])[:, None, None] * 100 / np.cosh(100 * (x - 0.3))[:, None] ** 2

    path = integrate(right, 0.0, 1.0, np.zeros((2, 1)))
    x = np.linspace(0, 1, 333)
    exact = np.tanh(100 * (x - 0.3)) + np.tanh(30)
    np.testing.assert_allclose(path(np.stack([x, x]))[..., 0], [exact, 2 * exact], rtol=0, atol=2e-11)
    assert len(path.ends) > 3


def test_a_step_is_refused():
    with pytest.raises(ValueError, match="not smooth"):
        integrate(lambda x, y: np.where(x > np.pi / 10, 1.0, 0.0)[:, None] + 0 * y, 0.0, 1.0, np.zeros((1, 1)))


def test_a_runaway_is_refused_quietly():
    with pytest.raises(ValueError, match="not smooth"):
        integrate(lambda _, y: y**2, 0.0, 1.1, np.ones((1, 1)))


def test_outside_the_ends_it_goes_on():
    path = integrate(lambda _, y: np.ones_like(y), 0.0, 1.0, np.zeros((1, 1)))
    assert isinstance(path, Path)
    np.testing.assert_allclose(path(np.array([[-0.01, 1.01]]))[0, :, 0], [-0.01, 1.01], rtol=0, atol=1e-12)
