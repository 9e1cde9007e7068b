"""Fits of one stretch: the end of its slide, and the window that is fitted."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import ndtr

from tracker.measurement.local import local_fit
from tracker.measurement.local.descents import run_alone, solve_descents
from tracker.measurement.local.local_estimate import _velocity
from tracker.measurement.local.local_fit import (
    MAX_EVIDENCE_LOST,
    MAX_RESIDUAL_CLAIMED,
    MAX_RESIDUAL_SCATTER,
    SlideDuration,
    _narrow_cells,
    bound_chi2_of_slide,
    choose_window,
    fit_motions,
    fit_single_stretch,
    mix_solutions,
    shows_end,
    weigh_by_residuals,
)
from tracker.measurement.local.local_problem import KnownEnd, KnownSlips, LocalPriors, LocalProblem
from tracker.measurement.local.stretches import (
    REST,
    ROLL,
    SLIDE,
    SLIDE_AND_ROLL,
    SLIDE_AND_STOP,
    Stretch,
    evaluate_path,
)

NOISE = 1e-6
FALL = 0.1  # 1/s, of the rolling loss


def make_stretch(path, time, seed=1, lasting=0.0, ball=1, after=True, size=1.0):
    """size: of the true errors, over the claimed ones."""
    n, noise = len(time), np.random.default_rng(seed).normal(0, size * NOISE, (len(time), 2))
    cov = np.tile(np.eye(2) * NOISE**2, (n, 1, 1))
    fixed = np.tile(np.eye(2) * lasting**2, (n, 1, 1))
    drifts = ((lasting, 0.5),) if lasting else ()
    near, count = np.zeros(n, dtype=bool), np.ones(n, dtype=int)
    return Stretch(ball, after, time, path + noise, cov + fixed, fixed, near, count, 1e-4, drifts)


@pytest.mark.parametrize("seed", range(8))
def test_a_slide_that_outlasts_the_stretch_is_no_short_slide_with_a_large_loss(seed):
    time = np.arange(1, 23) * 4e-3
    stretch = make_stretch(np.outer(time, [0.4, 0.4]) - np.outer(time**2 / 2, [1.1, 1.1]), time, seed)
    found = fit_single_stretch(stretch, 0.0, SLIDE_AND_ROLL, FALL)
    assert np.exp(found.values[6]) > 0.7 * np.ptp(time)
    assert found.values[2:4] == pytest.approx([0.4, 0.4], abs=1e-3)
    assert found.chi2 < 2 * found.dof


@pytest.mark.parametrize(
    ("force_from", "force", "lasting", "longest"),
    [(np.inf, 0.0, 0.0, 1.0), (np.inf, 0.0, 1e-5, 1.0), (0.12, 30.0, 0.0, 0.25), (0.12, 0.03, 1e-5, 0.25)],
)
def test_a_window_ends_before_a_force_that_the_motions_lack(force_from, force, lasting, longest):
    """An error of the map that lasts over the whole way hides no force."""
    time = np.arange(1, 51) * 4e-3
    path = np.outer(time, [0.4, 0.1]) + np.outer(np.maximum(time - force_from, 0) ** 2, [0.0, force])
    motions = (SLIDE,) if lasting else (SLIDE, ROLL, SLIDE_AND_ROLL)
    window = choose_window(make_stretch(path, time, lasting=lasting), 0.0, motions, FALL)
    assert longest * 0.2 <= window.time[-1] <= max(longest * 0.2, min(force_from, 0.2)) + 8e-3


def test_errors_larger_than_claimed_shorten_no_window():
    time = np.arange(1, 51) * 4e-3
    stretch = make_stretch(np.outer(time, [0.4, 0.1]), time, size=6.0)
    assert choose_window(stretch, 0.0, (SLIDE, ROLL, SLIDE_AND_ROLL), FALL) is stretch


def test_errors_that_the_scatter_understates_hardly_choose_the_window():
    """They last, and are 2.4 times those by the scatter: the limit of claimed errors would shorten many windows."""
    rng, time, rho = np.random.default_rng(1), np.arange(1, 51) * 4e-3, 0.7
    whole = dict.fromkeys((MAX_RESIDUAL_CLAIMED, MAX_RESIDUAL_SCATTER), 0)
    for _ in range(60):
        errors = rng.normal(0, 2.4, (50, 2))
        for k in range(1, 50):
            errors[k] = rho * errors[k - 1] + np.sqrt(1 - rho**2) * errors[k]
        stretch = make_stretch(np.outer(time, [0.4, 0.1]) + NOISE * errors, time, size=0.0)
        for limit in whole:
            whole[limit] += choose_window(stretch, 0.0, (SLIDE,), FALL, limit) is stretch
    assert whole[MAX_RESIDUAL_SCATTER] >= 57 > 45 > whole[MAX_RESIDUAL_CLAIMED]


def slide_path(time, speed, friction, slide_s):
    """Position along x of a body that slides for `slide_s` from time 0 on, and then moves on."""
    early, late = np.minimum(time, slide_s), np.maximum(time - slide_s, 0)
    return np.outer(speed * early - friction * early**2 / 2 + (speed - friction * slide_s) * late, [1.0, 0.0])


@pytest.mark.parametrize("lasting", [0.0, 1e-5, 1e-4])
def test_no_slide_has_a_smaller_chi2_than_its_bound(lasting):
    """Of slides that stop anywhere or go on as on air, for positions of such slides and of balls that roll on."""
    rng, time, least = np.random.default_rng(5), np.arange(1, 36) * 4e-3, []
    for _ in range(60):
        speed, slide_s, stop_s = rng.uniform(0.05, 0.5), rng.uniform(0, 0.2), rng.uniform(0, 0.2)
        stops = slide_path(time, speed, speed / stop_s, stop_s)
        for path in (stops, slide_path(time, speed, rng.uniform(0.1, 3), slide_s)):
            stretch = make_stretch(path, time, rng.integers(1e6), lasting)
            stretch.near[: rng.integers(0, 3)] = True
            stretch.position[stretch.near] += rng.normal(0, 1e-4, 2)
            bound, counted = bound_chi2_of_slide(stretch), np.repeat(~stretch.near, 2)
            for duration in (stop_s, *rng.uniform(0, 0.2, 20)):
                values = np.array([0.0, 0.0, speed, 0.0, -speed / duration, 0.0])
                for motion in (SLIDE_AND_STOP, SLIDE):
                    off = stretch.position - evaluate_path(motion, values, time, after=True)[0]
                    least.append((stretch.whiten(off)[counted] ** 2).sum() - bound)
    assert min(least) > -1e-6


def test_a_ball_that_rolls_on_after_its_slide_slides_not_to_rest():
    time, noise = np.arange(1, 36) * 4e-3, 3 * np.sqrt(2 * 70)
    for seed in range(20):
        rolls = make_stretch(slide_path(time, 0.4, 2.0, 0.05), time, seed)
        stops = make_stretch(slide_path(time, 0.15, 2.0, 0.075), time, seed)
        assert bound_chi2_of_slide(rolls) > 1e2 * 70
        assert bound_chi2_of_slide(stops) < 70 + noise


def test_residuals_are_weighed_from_the_contact_on(monkeypatch):
    """Positions far from the contact are means of three: in time the first before it, and the last after it."""
    before, after, diameter = np.arange(-30, 0) * 4e-3, np.arange(1, 31) * 4e-3, 0.05
    many = np.r_[np.ones(20, dtype=int), np.full(10, 3)]
    stretches = (
        make_stretch(np.zeros((30, 2)), before, 1, after=False),
        make_stretch(np.outer(before, [1.0, 0.0]) - [diameter, 0], before, 2, ball=2, after=False),
        make_stretch(np.outer(after, [0.9, 0.0]), after, 3),
        make_stretch(np.outer(after, [0.1, 0.0]) - [diameter, 0], after, 4, ball=2),
    )
    stretches = [replace(s, count=many if s.after else many[::-1]) for s in stretches]
    found, seen = run_alone(fit_motions(stretches, 0.0, True, ("air",), LocalPriors(diameter))), {}

    def measure_variances(residuals, freedom, columns, counts, firsts):
        seen.update(residuals=residuals, counts=counts, columns=columns, firsts=firsts)
        return [4.0] * len(residuals), 9.0, 16.0

    monkeypatch.setattr(local_fit, "measure_variances", measure_variances)
    [again] = run_alone(weigh_by_residuals(found, known=False))
    assert again.sizes == pytest.approx((3.0, 2.0, 2.0, 2.0))  # a body at rest has the mean
    dry = replace(found[0].problem, motions=(REST, *[SLIDE_AND_STOP] * 3))
    [again] = run_alone(weigh_by_residuals([replace(found[0], problem=dry)], known=False))
    assert again.sizes == pytest.approx((4.0, 2.0, 2.0, 2.0))  # or the error of one position
    assert seen["firsts"] == pytest.approx([1.0] * 3, abs=0.01)
    np.testing.assert_array_equal(seen["counts"], [many] * 3)
    parts = found[0].residual.reshape(4, 30, 2)
    np.testing.assert_array_equal(seen["residuals"], [parts[1][::-1], parts[2], parts[3]])
    assert seen["columns"] == [3, 3, 3]


@pytest.mark.parametrize("known", [True, False])
def test_only_motions_that_no_error_makes_likely_are_not_solved_again(known):
    """Bodies that slide are no bodies on air; the errors of two stretches are larger than claimed."""
    before, time, diameter = np.arange(-40, 0) * 4e-3, np.arange(1, 51) * 4e-3, 0.05
    stretches = (
        make_stretch(np.zeros((40, 2)), before, 1, after=False),
        make_stretch(np.outer(before, [1.0, 0.0]) - [diameter, 0], before, 2, ball=2, after=False, size=3.0),
        make_stretch(slide_path(time, 0.9, 1.6, 0.1), time, 3, size=1.5),
        make_stretch(slide_path(time, 0.1, -1.6, 0.1) - [diameter, 0], time, 4, ball=2),
    )
    found = run_alone(fit_motions(stretches, 0.0, True, ("cloth", "air"), LocalPriors(diameter)))
    steps = weigh_by_residuals(found, known)
    asked = next(steps)
    solved = solve_descents(asked)
    left = [one for one in found if not any(one.problem is descent.problems[0] for descent in asked)]
    assert any(one.problem.glide for one in left)
    best = max(one.log_evidence for [one] in solved)
    for one in left:
        [[again]] = solve_descents([replace(asked[0], problems=[one.problem], x=one.x[None])])
        assert again.log_evidence < best - MAX_EVIDENCE_LOST
    with pytest.raises(StopIteration) as end:
        steps.send(solved)
    assert len(end.value.value) == len(found)
    assert end.value.value[0].log_evidence == best


@pytest.mark.parametrize("size", [1.0, 3.0])
def test_slides_that_a_bound_excludes_change_nothing(monkeypatch, size):
    """Of balls that slide and then roll, with errors as claimed or larger in two stretches."""
    before, time, diameter = np.arange(-20, 0) * 4e-3, np.arange(1, 41) * 4e-3, 0.05
    stretches = (
        make_stretch(np.zeros((20, 2)), before, 1, after=False),
        make_stretch(np.outer(before, [1.0, 0.0]) - [diameter, 0], before, 2, ball=2, after=False, size=size),
        make_stretch(slide_path(time, 0.9, 1.9, 0.1), time, 3, size=size),
        make_stretch(slide_path(time, 0.1, -1.9, 0.05) - [diameter, 0], time, 4, ball=2),
    )

    def fit():
        found = yield from fit_motions(stretches, 0.0, True, ("cloth", "sliding", "air"), LocalPriors(diameter))
        weighed = yield from weigh_by_residuals(found, True)
        return found, (yield from mix_solutions(weighed))

    found, quick = run_alone(fit())
    assert found[0].is_good == (size == 1.0)
    monkeypatch.setattr(local_fit, "_are_no_slides", lambda *_: False)
    every, slow = run_alone(fit())
    assert sum(not one.problem.glide for one in every) == len(found)
    assert len(every) - len(found) == 2 * (size > 1)
    for (weight, one), (same, other) in zip(quick, slow, strict=True):
        assert weight == same
        assert np.array_equal(one.x, other.x)


@pytest.mark.parametrize(("slide_s", "seen"), [(0.5, False), (0.199, False), (0.1, True)])
def test_an_end_of_a_slide_that_is_not_seen_leaves_the_velocity_known(slide_s, seen):
    """The struck body slides for longer than it is seen, nearly as long, or for half of that."""
    before, time, diameter = np.arange(-40, 0) * 4e-3, np.arange(1, 51) * 4e-3, 0.05
    stretches = (
        make_stretch(np.zeros((40, 2)), before, 1, after=False),
        make_stretch(np.outer(before, [1.0, 0.0]) - [diameter, 0], before, 2, ball=2, after=False),
        make_stretch(slide_path(time, 0.9, 1.6, slide_s), time, 3),
        make_stretch(slide_path(time, 0.1, -1.6, 0.1) - [diameter, 0], time, 4, ball=2),
    )
    found = run_alone(fit_motions(stretches, 0.0, True, ("cloth",), LocalPriors(diameter)))
    assert shows_end(found[0], 2) == seen
    assert run_alone(mix_solutions(found, durations=0))  # none fits
    mixture = run_alone(mix_solutions(found))
    assert sum(weight for weight, _ in mixture) == pytest.approx(1)
    speeds = np.array([one.problem.values(one.x, 2)[2] for _, one in mixture])
    assert speeds == pytest.approx(0.9, abs=1e-3)


@pytest.mark.parametrize("k", [2, 3])
def test_evidence_of_known_slips_does_not_depend_on_whether_the_end_of_a_slide_shows(k):
    """One fit of the duration has the evidence of all durations one by one. Motions are chosen by that."""
    before, time, diameter, decel, share = np.arange(-40, 0) * 4e-3, np.arange(1, 51) * 4e-3, 0.05, 3.2, 0.3
    lasts = [2 * (0.9 + share) / 7 / decel, 2 * (0.9 - share) / 7 / decel]
    stretches = (
        make_stretch(np.zeros((40, 2)), before, 1, after=False),
        make_stretch(np.outer(before, [1.0, 0.0]) - [diameter, 0], before, 2, ball=2, after=False),
        make_stretch(slide_path(time, 0.9, decel, lasts[0]), time, 3),
        make_stretch(slide_path(time, 0.1, -decel, lasts[1]) - [diameter, 0], time, 4, ball=2),
    )
    slips = np.array([[0.9 + share, 0.0], [share - 0.9, 0.0]])
    known = KnownSlips(slips, np.zeros((2, 2)), (0.0, 0.0), np.array([1.0, 0.0]), share, 0.02, 0.02)
    [one] = run_alone(fit_motions(stretches, 0.0, True, ("cloth",), LocalPriors(diameter, slips=known)))
    assert one.problem.slips == (2, 3)
    assert shows_end(one, k)
    parts = run_alone(local_fit._vary_each_slide([(0.0, one)], k, 6, may_slide_on=False))
    apart = np.array([local_fit._log_weight(part) for part in parts])
    assert np.logaddexp.reduce(apart) == pytest.approx(one.log_evidence, abs=0.4)


def test_slides_that_outlast_the_stretches_by_far_leave_friction_and_velocities_right(monkeypatch):
    """They last for nine and five stretches, as their slips say. Two stretches at most raised the friction to 0.8."""
    before, time, diameter, decel, share = np.arange(-20, 0) * 25e-5, np.arange(1, 9) * 25e-5, 0.003, 2.4, 0.25
    speed = 0.12
    slips = np.array([[(0.95 + share) * speed, 0.0], [(share - 0.95) * speed, 0.0]])
    lasts = 2 * np.abs(slips[:, 0]) / (7 * decel)
    assert (lasts / time[-1]).round().tolist() == [9, 5]
    stretches = (
        make_stretch(np.zeros((20, 2)), before, after=False, size=0.0),
        make_stretch(np.outer(before, [speed, 0.0]) - [diameter, 0], before, ball=2, after=False, size=0.0),
        make_stretch(slide_path(time, 0.95 * speed, decel, lasts[0]), time, size=0.0),
        make_stretch(slide_path(time, 0.05 * speed, -decel, lasts[1]) - [diameter, 0], time, ball=2, size=0.0),
    )
    normal, std = np.array([1.0, 0.0]), 0.01 * speed
    known = KnownSlips(slips, np.zeros((2, 2)), (0.0, 0.0), normal, share, std, std)
    priors = LocalPriors(diameter, friction=decel / 9.81, slips=known)
    found = run_alone(fit_motions(stretches, 0.0, True, ("cloth",), priors, ((REST,), (ROLL,))))
    weights, parts = zip(*run_alone(mix_solutions(found)), strict=True)
    assert np.exp(np.dot(weights, [one.x[5] for one in parts])) == pytest.approx(decel / 9.81, rel=0.1)
    after = [[_velocity(one, one.x[None], ball, True)[0, 0] for ball in (1, 2)] for one in parts]
    assert np.dot(weights, after) == pytest.approx([0.95 * speed, 0.05 * speed], abs=2e-4)
    evidence = list[float]()
    for most in (0.7, 1.0, 1.4):
        monkeypatch.setattr(local_fit, "MAX_OPEN_ERROR", most)
        each = run_alone(local_fit._vary_each_slide([(0.0, found[0])], 2, 6, may_slide_on=False))
        evidence.append(np.logaddexp.reduce([local_fit._log_weight(part) for part in each]))
    assert evidence == pytest.approx([evidence[1]] * 3, abs=0.3)


def test_a_duration_of_a_slide_starts_next_to_that_of_the_free_fit():
    """From the middle of its cell a descent was cut as hopeless, and a contact lost its r."""
    time = np.arange(1, 23) * 4e-3
    problem = LocalProblem(
        (make_stretch(np.outer(time, [0.4, 0.1]), time),), (SLIDE_AND_ROLL,), LocalPriors(0.06), False
    )
    at = problem.start[0] + 6
    free = SimpleNamespace(problem=problem, x=np.zeros(problem.size), sizes=(1.0,))
    free.x[at] = np.log(0.010)
    cells = [SlideDuration(lasts, 0.3, 0.0) for lasts in (0.002, 0.009, 0.1)]
    [descent] = next(local_fit._solve_with_durations([(0.0, free)], 0, cells))
    edge = np.exp(np.sqrt(3) * 0.3)
    assert np.exp(descent.x[:, at]) == pytest.approx([0.002 * edge, 0.010, 0.1 / edge])


@pytest.mark.parametrize(("after", "may_slide_on"), [(False, True), (False, False), (True, True)])
def test_a_roll_before_a_hit_may_have_begun_at_any_time(after, may_slide_on):
    """A curve that no position contradicts: the roll is uniform over the 80 ms, beside a slide up to the contact."""
    time = np.arange(1, 21) * 4e-3 * (1 if after else -1)
    stretch = make_stretch(np.outer(time, [0.4, 0.1]), time, ball=2, after=after, size=0.0)
    problem = LocalProblem((stretch,), (SLIDE_AND_ROLL,), LocalPriors(0.06), False)
    x = np.zeros(problem.size)
    x[5], x[problem.start[0] + 2] = np.log(0.2), 2.0
    free = SimpleNamespace(problem=problem, x=x, sizes=(1.0,))
    cells = local_fit._list_durations(free, 0, 6, may_slide_on)
    shares = [np.exp(cell.log_prior) for cell in cells if cell.lasts < 0.08]
    begins, mean_s = 1 if may_slide_on and not after else 0, 2.0 / (7 * 0.2 * 9.81)  # of slides at 2 m/s
    slides_on = mean_s / (mean_s + 0.08)
    if after:
        assert sum(shares) == pytest.approx(0.47, abs=0.02)  # of the normal prior of the logarithm
        return
    assert min(cell.lasts for cell in cells) < (1e-5 if may_slide_on else 1e-3)
    if may_slide_on:
        assert shares[0] == pytest.approx(slides_on, abs=1e-3)
    density = [np.exp(c.log_prior) / (c.error * c.lasts * np.sqrt(12)) for c in cells[begins:] if c.lasts < 0.08]
    assert density == pytest.approx([(1 - slides_on * begins) / 0.08] * len(density), rel=0.05)


def list_open_durations(share):
    """List durations above a stretch of 80 ms, of a slide that lasts for `share` of it by its slip."""
    last, slips = 0.08, np.array([[0.5, 0.0], [0.5, 0.0]])
    time = np.arange(1, 21) * last / 20
    known = KnownSlips(slips, np.zeros((2, 2)), (0.0, 0.0), np.array([1.0, 0.0]), 0.0, 0.02, 0.02)
    moves = [make_stretch(np.outer(time, [0.4, 0.1]), time, ball=ball, size=0.0) for ball in (1, 2)]
    problem = LocalProblem(tuple(moves), (SLIDE_AND_ROLL, SLIDE_AND_ROLL), LocalPriors(0.06, slips=known), False)
    assert problem.slips == (0, 1)
    x = np.zeros(problem.size)
    x[5] = np.log(2 * 0.5 / (7 * share * last * 9.81))
    free = SimpleNamespace(problem=problem, x=x, sizes=(1.0, 1.0))
    return [cell for cell in local_fit._list_durations(free, 0, 6, False) if cell.lasts > last], last


@pytest.mark.parametrize("share", [0.3, 1.0, 2.0, 4.0, 9.0, 100.0])
def test_a_slide_that_a_slip_shows_hardly_lasts_twice(share):
    """The prior of durations above a stretch leaves those within it to others, and is even around the known one."""
    cells, last = list_open_durations(share)
    lies = [np.exp(c.log_prior) * ndtr((np.log(last) - np.log(c.lasts)) / c.error) for c in cells]
    assert sum(lies) < 0.05
    tried = np.log(last * np.geomspace(max(1.3, share / 2), max(4.0, 1.5 * share), 50))
    even = sum(
        np.exp(c.log_prior - ((tried - np.log(c.lasts)) / c.error) ** 2 / 2) / (c.error * np.sqrt(2 * np.pi))
        for c in cells
    )
    assert np.abs(np.log(even)).max() < 0.5, np.log(even).round(2).tolist()


def test_a_duration_that_is_known_lies_where_draws_of_it_lie_in_each_cell():
    ends, end = np.array([1e-6, 1e-5, 1.2e-3, 3.7e-3, 6e-3, 0.1, 0.2]), KnownEnd(0.0, 0.1, 4e-3, 1.5e-3)
    draws = end.rolls + end.rolls_std * np.random.default_rng(1).standard_normal(400_000)
    moments = _narrow_cells(ends, np.full(6, 7.0), np.full(6, 8.0), end)
    assert moments[0][0] == 7.0  # a slide up to the contact
    cells = zip(ends[:-1], ends[1:], *moments, strict=True)
    for low, high, mean, std in cells:
        own = draws[(draws > low) & (draws < high)]
        if low > 1e-6 and len(own) > 1000:
            assert (mean, std) == pytest.approx((own.mean(), own.std()), rel=0.02)
    assert moments[0][-1] == 7.0  # all but never there
