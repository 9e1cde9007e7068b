"""Values of an integrated motion, against integrals in closed form."""

import itertools

import numpy as np
import pytest

from synthcam.dynamics.collocation import make_matrices
from synthcam.dynamics.forces import END_SLIP_SHARE
from synthcam.dynamics.integrated_motion import IntegratedMotion
from synthcam.dynamics.propagate import END_TIMES, LOG_SLIP_BREAK
from synthcam.model import Bodies

KNOTS = np.log(END_SLIP_SHARE) * np.array([0.0, LOG_SLIP_BREAK, 1.0])
LASTS = np.array([0.04, 0.013])
BODIES = Bodies(np.ones(2), np.ones(2), np.zeros(2), np.full(2, 0.4))


def place(t):
    """A parabola, and a path whose bend grows as the logarithm of the time left: (2, k, m)."""
    left = LASTS[:, None] - t
    return np.stack([0.02 + t - 3 * t * t, 0.05 * left**2 * np.log(np.maximum(left, 1e-300))])


def integral(t):
    left = LASTS[:, None] - t
    log = np.log(np.maximum(left, 1e-300))
    return np.stack([0.02 * t + t**2 / 2 - t**3, -0.05 / 3 * left**3 * (log - 1 / 3)])


def led(pieces, power):
    nothing = np.zeros((2, 9))
    return IntegratedMotion(np.zeros(2), LASTS, nothing, BODIES, 9.81, pieces, power, np.zeros(2, dtype=bool))


def read(logarithmic):
    if logarithmic:
        nodes = [(a + b) / 2 + (b - a) / 2 * make_matrices(28).nodes for a, b in itertools.pairwise(KNOTS)]
        shares = [*(1 - np.exp(x) for x in nodes), 1 - END_SLIP_SHARE * (1 - END_TIMES)]
        return led([(s * LASTS[:, None], place(s * LASTS[:, None])) for s in shares], 3)
    z = make_matrices(20).nodes  # an uneven image of nodes
    times = LASTS[:, None] * (1 + z + 0.1 * (z * z - 1)) / 2
    return led([(times, place(times)[:1].repeat(2, axis=0))], 1)


@pytest.mark.parametrize("logarithmic", [True, False])
@pytest.mark.parametrize("wide", [1e-4, 5e-4, 0.02, 0.9])
def test_means_are_those_of_the_integral(logarithmic, wide):
    """Exposures anywhere in a slide, of one width and of several, across all knots and up to the end."""
    reading, exact = read(logarithmic), slice(None) if logarithmic else slice(1)
    centres = wide / 2 + np.linspace(0, 1 - wide, 40)
    middle, each = centres * LASTS[:, None], wide * LASTS[:, None] + 0 * centres
    for width in (each, wide * LASTS.min()):
        long = middle.astype(np.longdouble)
        expected = (integral(long + width / 2) - integral(long - width / 2)) / width
        np.testing.assert_allclose(reading.average_centres(middle, width)[exact], expected[exact], rtol=0, atol=5e-14)


@pytest.mark.parametrize("logarithmic", [True, False])
def test_the_narrower_the_nearer_to_an_instant(logarithmic):
    reading, exact = read(logarithmic), slice(None) if logarithmic else slice(1)
    times = np.linspace(0.01, 0.99, 30) * LASTS[:, None]
    for wide in (0.0, 1e-12, 1e-8, 0 * times):
        np.testing.assert_allclose(reading.average_centres(times, wide)[exact], place(times)[exact], rtol=0, atol=2e-14)


def test_a_path_with_a_sharp_bend_takes_more_nodes():
    z = make_matrices(64).nodes
    times = LASTS[:, None] * (1 + z) / 2
    bend = np.tanh(10 * (times / LASTS[:, None] - 0.5))
    reading = led([(times, np.stack([bend, bend]) * 1e-5)], 1)
    assert reading._position_series[0].shape[-1] == 64
    instants = np.linspace(0, 1, 99) * LASTS[:, None]
    found = reading.average_centres(instants, 0.0)[0]
    np.testing.assert_allclose(found, 1e-5 * np.tanh(10 * (instants / LASTS[:, None] - 0.5)), rtol=0, atol=1e-13)
