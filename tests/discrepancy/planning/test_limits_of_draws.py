"""Several draws of an experiment as a typical one."""

import math

import pytest

from discrepancy.planning.limits import Rival, StrengthLimits, count_draws, median_limits


def limit(size, shows=True, **cosines):
    rivals = tuple(Rival(name, c, {}) for name, c in sorted(cosines.items(), key=lambda pair: -pair[1]))
    return StrengthLimits("one", "one.x", "1", 1.0, {}, size, size, shows, rivals, size, size, (size, size))


def test_limits_and_cosines_are_medians():
    (found,) = median_limits([(limit(1.0, a=0.9, b=0.6),), (limit(4.0, a=0.1, b=0.6),), (limit(2.0, a=0.2, b=0.6),)])
    assert found.limit == found.best == found.worst == 2.0
    assert [(r.effect, r.cosine) for r in found.rivals] == [("b", 0.6), ("a", 0.2)]
    assert found.naming_limit == pytest.approx(2.0 / 0.8)
    assert found.scatter == (1.0, 4.0)


def test_what_shows_in_most_draws_shows():
    one, two = limit(1.0), limit(math.inf, shows=False)
    assert median_limits([(one,), (one,), (two,)])[0].shows
    assert not median_limits([(one,), (two,), (two,)])[0].shows


def test_a_rival_in_few_draws_is_none():
    (found,) = median_limits([(limit(1.0, a=0.9),), (limit(1.0),), (limit(1.0),)])
    assert found.rivals == ()
    assert found.naming_limit == 1.0


@pytest.mark.parametrize(("clips", "draws"), [(6, 5), (30, 5), (60, 3), (150, 1), (1000, 1)])
def test_few_collisions_are_drawn_more_often(clips, draws):
    assert count_draws(clips) == draws
