"""Quadrature against integrals in closed form."""

import numpy as np
import pytest

from synthcam_shared.arrays import list_gauss_nodes


@pytest.mark.parametrize("count", [1, 4, 12])
def test_gauss_nodes_integrate_polynomials_up_to_twice_their_number(count):
    nodes, weights = list_gauss_nodes(count)
    for power in range(2 * count):
        assert weights @ nodes**power == pytest.approx(2 / (power + 1) if power % 2 == 0 else 0, abs=1e-14)
    even = 2 * count
    assert abs(weights @ nodes**even - 2 / (even + 1)) > 1e-8, "the next power is beyond them"


def test_nodes_that_all_callers_share_cannot_be_changed():
    nodes, weights = list_gauss_nodes(4)
    assert list_gauss_nodes(4)[0] is nodes
    for shared in (nodes, weights):
        with pytest.raises(ValueError, match="read-only"):
            shared += np.ones(4)
