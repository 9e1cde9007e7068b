"""The integrator against closed forms."""

import numpy as np
import pytest
from numpy.polynomial import Chebyshev

from synthcam.dynamics import collocation
from synthcam.dynamics.collocation import NODE_COUNTS, evaluate_series, make_matrices, resample_on_nodes


class Solved:
    """Pieces of a solution, interpolated by numpy's Chebyshev series: (c, problems, m) at x (problems, m)."""

    def __init__(self, pieces):
        self.pieces = pieces
        self.ends = [pieces[0][0][0], *(x[-1] for x, _ in pieces)]

    def __call__(self, x):
        out = np.full((len(self.pieces[0][1]), *x.shape), np.nan)
        for nodes, y in self.pieces:
            fits = [[Chebyshev.fit(nodes, row, len(nodes) - 1) for row in component] for component in y]
            low, high = sorted((nodes[0], nodes[-1]))
            for k, times in enumerate(x):
                here = (times >= low - 1e-14) & (times <= high + 1e-14)
                out[:, k, here] = [component[k](times[here]) for component in fits]
        return out

    def last(self):
        return self.pieces[-1][1][..., -1]


def in_parts(*rest, **more):
    return Solved(collocation.integrate_by_collocation(*rest, **more))


def integrate(right, *rest, **more):
    """With the derivative of everything at once."""

    def whole(x, y):
        yield slice(len(y)), right(x, y)

    return in_parts(whole, *rest, **more)


def test_harmonic_oscillators_for_ten_turns():
    def right(_, y):
        return np.stack([y[1], -y[0]])

    path = integrate(right, (0.0, 20 * np.pi), np.array([[0.0, 1.0], [1.0, 0.0]]))
    x = np.linspace(0, 20 * np.pi, 500)
    expected = [[np.sin(x), np.cos(x)], [np.cos(x), -np.sin(x)]]
    np.testing.assert_allclose(path(np.stack([x, x])), expected, rtol=0, atol=2e-12)
    np.testing.assert_allclose(path.last(), [[0, 1], [1, 0]], rtol=0, atol=2e-12)


@pytest.mark.parametrize("end", [3.0, -3.0])
@pytest.mark.parametrize("inner", [(), (0.2,), (0.1, 0.5)])
def test_both_ways_and_in_pieces(end, inner):
    knots = (0.0, *(share * end for share in inner), end)
    path = integrate(lambda x, y: np.cos(x) * y, knots, np.array([[2.0]]))
    x = np.linspace(0, end, 100)
    np.testing.assert_allclose(path(x[None])[0, 0], 2 * np.exp(np.sin(x)), rtol=1e-13)
    assert set(knots) <= set(path.ends)


@pytest.mark.parametrize("off", [0.0, 1e-3, 50.0, np.nan])
def test_a_guess_changes_nothing(off):
    path = integrate(lambda x, y: y, (0.0, 2.0), np.array([[1.0]]), lambda x: np.exp(x)[None, None] + off)
    x = np.linspace(0, 2, 50)
    np.testing.assert_allclose(path(x[None])[0, 0], np.exp(x), rtol=1e-13)


def test_each_problem_at_times_of_its_own():
    path = integrate(lambda x, y: y, (0.0, 1.0), np.array([[1.0, 2.0, -3.0]]))
    x = np.random.default_rng(0).uniform(0, 1, (3, 40))
    np.testing.assert_allclose(path(x)[0], np.exp(x) * [[1], [2], [-3]], rtol=1e-13)


def test_few_nodes_where_few_will_do():
    paths = [integrate(lambda x, y, f=f: np.cos(f * x) + 0 * y, (0.0, 1.0), np.zeros((1, 1))) for f in (1, 15, 30)]
    sizes = [p.pieces[0][1].shape[-1] for p in paths]
    assert sizes == sorted(sizes)
    assert sizes[0] == NODE_COUNTS[0]
    assert sizes[1] > NODE_COUNTS[1]
    x = np.linspace(0, 1, 50)
    for path, f in zip(paths, (1, 15, 30), strict=True):
        np.testing.assert_allclose(path(x[None])[0, 0], np.sin(f * x) / f, rtol=0, atol=1e-14)


def test_a_sharp_bend_is_halved_until_it_is_smooth():
    def right(x, y):
        return np.array([1.0, 2.0])[None, :, None] * 100 / np.cosh(100 * (x - 0.3)) ** 2

    path = integrate(right, (0.0, 1.0), np.zeros((1, 2)))
    x = np.linspace(0, 1, 333)
    exact = np.tanh(100 * (x - 0.3)) + np.tanh(30)
    np.testing.assert_allclose(path(np.stack([x, x]))[0], [exact, 2 * exact], rtol=0, atol=2e-11)
    assert len(path.ends) > 3


def test_a_step_is_refused():
    with pytest.raises(ValueError, match="not smooth"):
        integrate(lambda x, y: np.where(x > np.pi / 10, 1.0, 0.0) + 0 * y, (0.0, 1.0), np.zeros((1, 1)))


def test_a_kink_passes_only_between_pieces():
    def right(x, y):
        return np.abs(x - 0.3) + 0 * y

    with pytest.raises(ValueError, match="not smooth"):
        integrate(right, (0.0, 1.0), np.zeros((1, 1)), max_halvings=6)
    path = integrate(right, (0.0, 0.3, 1.0), np.zeros((1, 1)), max_halvings=0)
    assert path.last()[0, 0] == pytest.approx((0.3**2 + 0.7**2) / 2, abs=1e-14)


def test_a_runaway_is_refused_quietly():
    with pytest.raises(ValueError, match="not smooth"):
        integrate(lambda _, y: y**2, (0.0, 1.1), np.ones((1, 1)))


def test_slope_and_curvature_of_a_series():
    on, x = make_matrices(20), np.linspace(-1, 1, 30)
    c = (np.exp(1.5 * on.nodes) @ on.coefficients)[None, None]
    np.testing.assert_allclose(evaluate_series(c @ on.slope, x[None])[0, 0], 1.5 * np.exp(1.5 * x), rtol=1e-11)
    np.testing.assert_allclose(evaluate_series(c @ on.curvature, x[None])[0, 0], 2.25 * np.exp(1.5 * x), rtol=1e-9)


def test_parts_one_after_the_other():
    """x'' = -x, v first, then x by the new v; their product feeds nothing, and is right all the same."""
    calls = {"v": 0, "x": 0, "xv": 0}

    def right(_, y):
        calls["v"] += 1
        yield slice(0, 1), -y[1:2]
        calls["x"] += 1
        yield slice(1, 2), y[0:1]
        calls["xv"] += 1
        yield slice(2, 3), y[0:1] * y[1:2]

    path = in_parts(right, (0.0, 2.0), np.array([[1.0], [0.0], [0.0]]), few=26, feed=2)
    x = np.linspace(0, 2, 50)
    expected = np.stack([np.cos(x), np.sin(x), np.sin(x) ** 2 / 2])
    np.testing.assert_allclose(path(x[None])[:, 0], expected, rtol=0, atol=1e-14)
    assert calls["v"] == calls["x"] > calls["xv"]


def test_values_at_images_of_nodes_are_read_on_nodes():
    z = make_matrices(32).nodes
    places = np.stack([z, np.tanh(0.8 * z) / np.tanh(0.8), (z + 0.2 * (z * z - 1))])
    read = resample_on_nodes(np.exp(np.stack([places, -2 * places])), places, 20)
    on = make_matrices(20).nodes
    np.testing.assert_allclose(read, np.exp([[on] * 3, [-2 * on] * 3]), rtol=0, atol=2e-13)


def test_values_at_nodes():
    path = integrate(lambda x, y: np.cos(x) * y, (0.0, 1.0, 2.0), np.array([[1.0, 3.0]]))
    for x, y in path.pieces:
        np.testing.assert_allclose(y[0], np.exp(np.sin(x)) * [[1], [3]], rtol=1e-13)
