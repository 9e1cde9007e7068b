"""The time left of a search, against searches that were timed: when each stage began, s of processor time."""

import math

import pytest

from discrepancy.time_left import LIMITED_STAGES, SearchClock

NOTHING = ((1.90, "noise"), (2.00, "fit"), (2.40, "search"), (3.46, "only free laws"), (4.10, "gap"), (4.41, ""))
NOTHING_IN_40 = ((2.33, "noise"), (2.57, "fit"), (3.25, "search"), (4.97, "only free laws"), (6.91, "gap"), (7.41, ""))
TWO_EFFECTS = (
    (3.97, "noise"), (4.08, "fit"), (4.76, "search"), (6.00, "free laws"), (8.94, "search"), (10.85, "free laws"),
    (14.14, "search"), (17.86, "free laws"), (21.12, "gap"), (22.40, ""),
)  # fmt: skip


def follow(stages, limit_s=math.inf, repeats=1):
    """The times, estimates and true times left of a search, each tenth of a second; rounds begin at the fit."""
    begun = [(at, name) for at, name in stages if name in (*LIMITED_STAGES, "fit")]
    length = stages[-2][0] - begun[0][0]
    rounds = [(at + k * length, name) for k in range(repeats) for at, name in begun]
    end = stages[-1][0] + (repeats - 1) * length
    clock, rows = SearchClock(limit_s), []
    for k in range(int(10 * begun[0][0]), int(10 * (stages[-2][0] + (repeats - 1) * length))):
        now = k / 10
        clock.enter([name for at, name in rounds if at <= now + 0.1][-1], now)
        rows.append((now, clock.estimate_left(now), end - now))
    return rows


def test_the_estimate_approaches_the_truth_as_levels_pass():
    """After each level the largest error is a smaller share of the whole."""
    rows, whole = follow(TWO_EFFECTS), TWO_EFFECTS[-1][0]
    worst = [
        max(abs(left - true) for now, left, true in rows if first < now < last and math.isfinite(left)) / whole
        for first, last in ((6.2, 8.8), (9.0, 14.0), (14.3, 21.0))
    ]
    assert worst[0] > worst[1] > worst[2]
    assert worst[2] < 0.15


def test_a_search_that_finds_nothing_is_over_after_a_level():
    for stages in (NOTHING, NOTHING_IN_40):
        errors = [left - true for _, left, true in follow(stages) if math.isfinite(left)]
        assert len(errors) > 3
        assert max(map(abs, errors)) < 0.15 * stages[-1][0]


def test_a_round_is_as_long_as_the_one_before():
    rows, second = follow(TWO_EFFECTS, repeats=2), 21.12
    late = [(left, true) for now, left, true in rows if now > second + 0.8]
    assert len(late) > 100
    assert all(left == pytest.approx(true, abs=2.0) for left, true in late)


def test_the_end_of_a_stage_that_takes_far_longer_than_the_last_is_not_known():
    """A search of 116 stretches of billiard balls: its second level added waves of the plate."""
    clock = SearchClock(600.0)
    for stage, now in (("fit", 30.0), ("search", 40.0), ("free laws", 60.0), ("search", 80.0)):
        clock.enter(stage, now)
    assert clock.estimate_left(90.0) == pytest.approx(10 + 20 + 20)
    assert clock.estimate_left(135.0) == pytest.approx(0.2 * 55 + 20 + 0.5 * (55 + 20))
    assert math.isnan(clock.estimate_left(141.0))


def test_nothing_is_estimated_before_there_is_a_ground_and_the_limit_bounds_it():
    assert all(math.isnan(left) for now, left, _ in follow(TWO_EFFECTS) if now < 5.9)
    assert all(left <= 12.0 - now for now, left, _ in follow(TWO_EFFECTS, limit_s=12.0) if 6.1 < now < 12)
