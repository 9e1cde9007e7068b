"""Pieces between known instants: exact on parabolas, with a kink at one of the knots."""

import numpy as np

from synthcam.dynamics.hermite import interpolate_hermite


def parabola(times, kink=0.3):
    """Two balls that turn at `kink`: (2, m, 4); just after the kink where a time falls on it."""
    late = np.maximum(times - kink, 0)
    x = 1 + 2 * times - times**2 - 3 * late + 2 * late**2
    v = 2 - 2 * times + np.where(times >= kink, -3 + 4 * late, 0)
    return np.stack([x, -2 * x, v, -2 * v], axis=-1) * np.array([1.0, 10.0])[:, None, None]


def test_places_between_knots():
    knots = np.array([[0.3, 0.5, 0.5, 0.9]])
    ends = parabola(np.concatenate([knots, knots]))[:1]
    shares = np.linspace(0, 1, 5)
    places = interpolate_hermite(ends, np.diff(knots), shares)
    times = knots[:, :-1, None] + shares * np.diff(knots)[..., None]
    np.testing.assert_allclose(places[0], parabola(np.tile(times.reshape(1, -1), (2, 1)))[0, :, :2].reshape(3, 5, 2))
