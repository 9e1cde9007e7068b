"""The gain of a change of the experiment, and the number of collisions that a limit needs."""

import dataclasses
import math

import pytest

from discrepancy.planning.compare import (
    ChangeLimits,
    compute_gain_of_change,
    cosine_of_pair,
    count_collisions_needed,
    indistinguishable_pairs,
)
from discrepancy.planning.limits import Rival, StrengthLimits


def limit(effect, size, rival="other", cosine=0.5, shows=True):
    naming = size / math.sqrt(1 - cosine**2)
    rivals = (Rival(rival, cosine, {}),)
    return StrengthLimits(effect, f"{effect}.x", "1", 1.0, {}, size, naming, shows, rivals, size, size, (size, size))


BEFORE = (limit("one", 0.4, "two", 0.95), limit("two", 0.1, "one", 0.95))


def test_a_gain_is_the_mean_ratio_and_the_pairs_parted():
    after = ChangeLimits("c", "words", (limit("one", 0.1, "two", 0.6), limit("two", 0.1, "one", 0.6)))
    found = compute_gain_of_change(BEFORE, after, ["one", "two"])
    assert found.limit == pytest.approx(2.0)
    assert found.naming == pytest.approx(2 * 0.8 / math.sqrt(1 - 0.95**2))
    assert found.parts == (("one", "two"),)
    assert found.joins == ()


def test_an_effect_that_no_longer_shows_is_not_parted_but_hidden():
    after = ChangeLimits("c", "words", (limit("one", 0.1, "two", 0.6, shows=False), limit("two", 0.1, "one", 0.6)))
    found = compute_gain_of_change(BEFORE, after, ["one", "two"])
    assert found.parts == ()
    assert found.hides == ("one.x",)
    assert found.limit == pytest.approx(1.0)


def test_pairs_are_of_those_asked_for():
    assert indistinguishable_pairs(BEFORE, ["one"]) == (("one", "two"),)
    assert indistinguishable_pairs(BEFORE, ["three"]) == ()
    assert cosine_of_pair(BEFORE, ("one", "two")) == 0.95
    assert cosine_of_pair(BEFORE, ("one", "three")) == 1.0


@pytest.mark.parametrize(("wanted", "clips"), [(0.1, 40), (0.2, 10), (0.05, 160), (0.001, 400_000), (1.0, 6)])
def test_a_limit_that_falls_as_the_root_takes_the_square(wanted, clips):
    here = limit("one", 0.2 * math.sqrt(10 / 30))
    asked = []

    def limit_at(count):
        asked.append(count)
        return 0.2 * math.sqrt(10 / count)

    found = count_collisions_needed("one.x", wanted, here, 30, limit_at, 400)
    assert found.clips == clips
    assert max(asked) <= 400
    assert found.clips_to_name >= found.clips


def test_what_the_fit_absorbs_takes_no_number():
    here = dataclasses.replace(limit("one", 1.0), limit=math.inf, naming_limit=math.inf)
    assert count_collisions_needed("one.x", 0.1, here, 30, lambda count: math.inf, 400).clips is None
