"""The matrices on the nodes of a piece, against integrals known in closed form."""

import numpy as np
import pytest

from synthcam.dynamics.pushed_ball import mesh


@pytest.mark.parametrize("size", [12, 24])
def test_matrices_on_a_cubic(size):
    on = mesh(size)
    x = on.x
    values = 1 - 2 * x + 3 * x**3
    np.testing.assert_allclose(values @ on.integral, x - x**2 + 0.75 * x**4, rtol=0, atol=1e-14)
    np.testing.assert_allclose(values @ on.slope, -2 + 9 * x**2, rtol=0, atol=1e-11)
    left = (1 - 1 + 0.75) - (x - x**2 + 0.75 * x**4)
    np.testing.assert_allclose((values @ on.rest)[:-1], (left / np.where(x < 1, 1 - x, 1))[:-1], rtol=0, atol=1e-12)
    assert (values @ on.rest)[-1] == pytest.approx(values[-1])
    # 1 - 2 x + 3 x^3 = 2 - (1 - x)(1 + 3 x + 3 x^2), over 1 - x
    turned = -2 * np.log(np.where(x < 1, 1 - x, 1)) - (x + 1.5 * x**2 + x**3)
    np.testing.assert_allclose((values @ on.turn)[:-1], turned[:-1], rtol=0, atol=1e-12)
    assert np.isfinite((values @ on.turn)[-1])


def test_the_last_coefficient_is_the_last_polynomials():
    on = mesh(12)
    coefficients = np.cos(11 * np.arccos(2 * on.x - 1)) @ on.coefficients
    np.testing.assert_allclose(coefficients, np.eye(12)[-1], rtol=0, atol=1e-13)
