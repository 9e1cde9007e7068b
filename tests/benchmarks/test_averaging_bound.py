"""The bound on the rms z of averages, beside rules whose numbers are computed by themselves."""

import numpy as np
import pytest

from benchmarks.tracker.averaging_bound import HITS, SIZES, Bound, Z, judge_rule


def judge(mean, variance):
    """Rms z and claimed errors at each size of d of a rule that does not depend on the hit, by sums over z."""
    squares, errors = np.zeros(len(SIZES)), np.zeros(len(SIZES))
    for share, _ in HITS:
        claimed = 1 + share**2 * variance
        for k, size in enumerate(SIZES):
            weight = np.exp(-((Z - size) ** 2) / 2)
            weight /= weight.sum()
            squares[k] += weight @ ((1 + share**2 * (mean - size) ** 2) / claimed) / len(HITS)
            alone = np.sqrt(1 + share**2) if size else 1.0
            errors[k] += weight @ np.sqrt(claimed) / alone / len(HITS)
    return np.sqrt(squares), errors


@pytest.mark.parametrize("rule", ["ridge", "wide", "soft"])
def test_no_rule_beats_the_bound_on_rules_with_its_errors(rule):
    follow = {"ridge": np.full(len(Z), 0.7), "wide": np.full(len(Z), 0.5), "soft": Z**2 / (Z**2 + 4)}[rule]
    rms, errors = judge(follow * Z, follow if rule != "wide" else np.full(len(Z), 3.0))
    assert Bound().find(rms[0], errors) <= max(rms[1:]) + 0.005


def test_the_average_is_near_the_bound_and_1_25_is_out_of_reach():
    rms, errors = judge_rule()
    limits = np.where(SIZES == 0, errors[0], errors[1:].max())
    assert 1.25 < Bound().find(rms[0], limits) < max(rms) < 1.1 * Bound().find(rms[0], limits)


def test_errors_without_limit_can_always_be_right():
    assert Bound().find(1.0, np.full(len(SIZES), 100.0)) < 1.02


def test_the_dual_has_the_best_rule_for_its_multipliers():
    """Its gradient is then that of its value (envelope theorem), as finite differences give it."""
    rng = np.random.default_rng(1)
    n = len(SIZES)
    x, squares, widths = rng.uniform(0.1, 1.0, 2 * n), np.full(n, 1.5), np.full(n, 1.1)
    _, slack = Bound().dual(x, squares, widths)
    for k in range(2 * n):
        step = 1e-5 * np.eye(2 * n)[k]
        more, less = (Bound().dual(x + sign * step, squares, widths)[0] for sign in (1, -1))
        assert (more - less) / 2e-5 == pytest.approx(slack[k], abs=1e-6)
