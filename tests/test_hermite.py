"""Tables of known motions: exact on parabolas, kinks among the knots, rows kept apart."""

import numpy as np

from synthcam.hermite import FINE, NEARBY, Follower, Table, around, between


def parabola(times, kink=0.3):
    """Two balls that turn at `kink`: (2, m, 4); just after the kink where a time falls on it."""
    late = np.maximum(times - kink, 0)
    x = 1 + 2 * times - times**2 - 3 * late + 2 * late**2
    v = 2 - 2 * times + np.where(times >= kink, -3 + 4 * late, 0)
    return np.stack([x, -2 * x, v, -2 * v], axis=-1) * np.array([1.0, 10.0])[:, None, None]


def test_parabolas_with_a_kink_are_exact():
    knots = np.array([[0.0, 0.3, 0.3, 1.0], [0.0, 0.1, 0.3, 1.0]])
    table = Table.of(parabola, knots)
    times = np.random.default_rng(0).uniform(0, 1, (2, 50))
    np.testing.assert_allclose(table(np.array([0, 1]), times), parabola(times)[..., :2], rtol=0, atol=1e-13)
    swapped = table(np.array([1, 0, 1]), times[[0, 0, 1]])
    np.testing.assert_allclose(swapped[1], parabola(times[[0, 0]])[0, :, :2], rtol=0, atol=1e-13)
    np.testing.assert_allclose(swapped[0], 10 * swapped[1], rtol=1e-12)


def test_beyond_the_knots_it_goes_straight_on():
    table = Table.of(parabola, np.array([[0.0, 0.3, 1.0], [0.0, 0.3, 1.0]]))
    ends = parabola(np.array([[0.0, 1.0], [0.0, 1.0]]))
    out = table(np.array([0]), np.array([[-0.1, 1.1]]))[0]
    np.testing.assert_allclose(out[0], ends[0, 0, :2] - 0.1 * ends[0, 0, 2:], rtol=0, atol=1e-12)
    np.testing.assert_allclose(out[1], ends[0, 1, :2] + 0.1 * ends[0, 1, 2:], rtol=0, atol=1e-12)


def test_velocities_and_accelerations():
    table = Table.of(parabola, np.array([[0.0, 0.3, 1.0], [0.0, 0.3, 1.0]]))
    times = np.array([[0.1, 0.25, 0.3, 0.7]] * 2)
    place, velocity, acceleration = table.motion(np.array([0, 1]), times)
    np.testing.assert_allclose(place, parabola(times)[..., :2], rtol=0, atol=1e-13)
    np.testing.assert_allclose(velocity, parabola(times)[..., 2:], rtol=0, atol=1e-12)
    bends = np.array([-2, -2, 2, 2.0])[:, None] * [1, -2]
    np.testing.assert_allclose(acceleration, [bends, 10 * bends], rtol=0, atol=1e-11)


def test_following_is_looking_up():
    table = Table.of(
        lambda t: np.stack([np.sin(t), np.cos(t), np.cos(t), -np.sin(t)], axis=-1), np.mgrid[:2, 0:401][1] / 400
    )
    follow, rows = Follower(table, np.array([1, 0])), np.array([1, 0])
    base = np.random.default_rng(2).uniform(0.1, 0.9, (2, 30))
    for late in (0.0, 0.9 * NEARBY, -0.9 * NEARBY, 0.3, 0.3 + 0.5 * NEARBY):
        np.testing.assert_allclose(follow(base + late, slice(None)), table(rows, base + late), rtol=0, atol=1e-14)
    np.testing.assert_allclose(
        follow(base[:1] + 0.3, np.array([1])), table(rows[1:], base[:1] + 0.3), rtol=0, atol=1e-14
    )


def test_knots_are_dense_where_balls_meet():
    knots = around(np.array([0.1, 0.25]), 0.0, 0.4)
    for row, meeting in zip(knots, (0.1, 0.25), strict=True):
        assert row[0] == 0.0
        assert row[-1] == 0.4
        assert np.all(np.diff(row) >= 0)
        assert np.diff(row)[np.searchsorted(row, meeting) - 1] <= 1.1 * FINE


def test_places_between_knots():
    knots = np.array([[0.3, 0.5, 0.5, 0.9]])
    ends = parabola(np.concatenate([knots, knots]))[:1]
    shares = np.linspace(0, 1, 5)
    places = between(ends, np.diff(knots), shares)
    times = knots[:, :-1, None] + shares * np.diff(knots)[..., None]
    np.testing.assert_allclose(places[0], parabola(np.tile(times.reshape(1, -1), (2, 1)))[0, :, :2].reshape(3, 5, 2))
