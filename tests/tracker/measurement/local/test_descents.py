"""Descents of local fits: those of several hits together, each as it is alone, and none that costs another."""

from dataclasses import replace

import numpy as np
import pytest

from tracker.measurement.collision.collision_model import GRAVITY
from tracker.measurement.local import descents
from tracker.measurement.local.descents import (
    Descent,
    ProblemStack,
    find_covariances_of_known,
    follow_displacements,
    run_alone,
    run_together,
    solve_descents,
    solve_each,
)
from tracker.measurement.local.local_fit import fit_motions
from tracker.measurement.local.local_problem import KnownEnd, KnownSlips, LocalPriors, LocalProblem
from tracker.measurement.local.stretches import ROLL, SLIDE, SLIDE_AND_ROLL, SLIDE_AND_STOP, Stretch, cut_stretch
from tracker.measurement.positions import BallTrack

DIAMETER, NOISE = 0.05, 1e-5


def make_problem(seed, positions, *, lasting=0.0, reach=None):
    """A hit of a rolling ball on another that rolls aside, seen in as many frames on each side.

    reach: of the last position of each side, s, as if it were a mean.
    """
    rng, stretches = np.random.default_rng(seed), []
    for ball, after in ((1, False), (2, False), (1, True), (2, True)):
        time = np.arange(1, positions + ball) * 4e-3 * (1 if after else -1)
        time = np.sort(time)
        place = [0.0, 0.0] if ball == 1 else [-DIAMETER, 0.0]
        path = place + np.outer(time, rng.uniform(0.1, 0.5, 2)) - np.outer(time**2, rng.uniform(0, 0.3, 2))
        cov = np.tile(np.eye(2) * NOISE**2, (len(time), 1, 1))
        fixed = np.tile(np.eye(2) * lasting**2, (len(time), 1, 1))
        near = np.zeros(len(time), dtype=bool)
        noisy = path + rng.normal(0, NOISE, path.shape)
        stretches.append(Stretch(ball, after, time, noisy, cov + fixed, fixed, near, np.ones(len(time), int), 1e-4))
        if reach is not None:
            stretches[-1] = replace(stretches[-1], reach=np.where(np.abs(time) == np.abs(time).max(), reach, 0.0))
    motions = (ROLL, SLIDE_AND_ROLL, SLIDE_AND_ROLL, SLIDE_AND_ROLL)
    return LocalProblem(tuple(stretches), motions, LocalPriors(DIAMETER), False)


def guess(problem, seed=0):
    """A start near the truth, the same for all."""
    x = np.random.default_rng(seed).normal(0, 0.1, problem.size)
    x[:5] = [0.0, 0.0, 0.0, -DIAMETER, 0.0]
    x[5], x[6], x[7] = np.log(0.2), 0.05, 0.1
    for k, motion in enumerate(problem.motions):
        x[problem.start[k] : problem.start[k] + 2] = 0.0
        if motion.ends:
            x[problem.start[k] + 6] = np.log(0.03)
    return x


SLIPS = KnownSlips(
    slips=np.array([[0.2, 0.1], [-0.3, 0.2]]),
    left=np.array([[0.0, 0.0], [0.1, -0.05]]),
    left_std=(0.0, 0.02),
    normal=np.array([0.6, 0.8]),
    share=0.3,
    drag_std=0.01,
    std=0.005,
)


@pytest.mark.parametrize(
    ("lasting", "known"),
    [(0.0, {}), (5e-6, {}), (0.0, {"slips": SLIPS, "ends": (None, KnownEnd(0.4, 0.2, 0.01, 0.004))})],
)
def test_derivatives_are_those_of_differences(lasting, known):
    """Of the cost, by each parameter: half its derivative is that of the residuals times the residuals."""
    priors = LocalPriors(DIAMETER, **known)
    problems = [replace(make_problem(*form), priors=priors) for form in ((1, 8), (2, 12))]
    problems[0] = replace(problems[0], stretches=make_problem(1, 8, lasting=lasting).stretches)
    stack = ProblemStack(problems, np.full((2, 4), 1.3))
    which, x = np.array([1]), guess(problems[1])[None]
    _, pull, square = stack.sum_squares(x, which)
    step = 1e-6
    for k in range(x.shape[1]):
        high, low = x.copy(), x.copy()
        high[0, k] += step
        low[0, k] -= step
        (cost, beyond, _), (less, before, _) = stack.sum_squares(high, which), stack.sum_squares(low, which)
        assert (cost - less)[0] / (4 * step) == pytest.approx(pull[0, k], rel=1e-4, abs=1e-4 * np.abs(pull).max()), k
        assert np.isfinite(beyond - before).all()
    assert square == pytest.approx(np.swapaxes(square, 1, 2))


@pytest.mark.parametrize("size", [1.0, 3e4])
def test_derivatives_of_dry_friction_are_those_of_differences(size):
    """Of the cost, by each parameter; one body stops amid its positions. With large errors what is known counts."""
    problem = replace(make_problem(1, 12), motions=(SLIDE_AND_STOP,) * 4, glide=True)
    stack, which = ProblemStack([problem], np.full((1, 4), size)), np.array([0])
    x = np.random.default_rng(1).normal(0, 0.1, (1, problem.size))
    x[0, :5] = [0.0, 0.0, 0.0, -DIAMETER, 0.0]
    for k, speed in enumerate((0.1, 0.5, 0.4, 0.05)):
        x[0, problem.start[k] : problem.start[k] + 6] = [0.0, 0.0, speed, 0.01, -1.5, 0.1]
    _, pull, _ = stack.sum_squares(x, which)
    step = 1e-6
    for k in range(problem.size):
        high, low = (stack.sum_squares(x + sign * step * np.eye(problem.size)[k], which)[0][0] for sign in (1, -1))
        assert (high - low) / (4 * step) == pytest.approx(pull[0, k], rel=1e-4, abs=1e-5 * np.abs(pull).max()), k


def test_the_prior_of_dry_friction_has_the_same_weight_for_each_friction():
    """Its integral over the acceleration of a stretch does not depend on the common friction."""
    problem = replace(make_problem(1, 12), motions=(SLIDE_AND_STOP,) * 4, glide=True)
    stack, side, weights = ProblemStack([problem], np.ones((1, 4))), np.linspace(-2, 2, 101), []
    for friction in (0.05, 0.2):
        unit = friction * GRAVITY
        x = np.zeros((len(side) ** 2, problem.size))
        x[:, 5] = np.log(friction)
        for k in range(4):
            x[:, problem.start[k] + 2 : problem.start[k] + 6] = [1.0, 0.0, -unit, 0.0]
        x[:, problem.start[3] + 4 : problem.start[3] + 6] = unit * np.stack(np.meshgrid(side - 1, side), -1).reshape(
            -1, 2
        )
        known, _ = stack._weigh_known(x, np.zeros(len(x), dtype=int))
        rows = known[:, stack.curved - 2 : stack.curved]
        integral = np.exp(-(rows**2).sum(axis=1) / 2).sum() * (unit * (side[1] - side[0])) ** 2
        weights.append(integral**4 * np.exp(problem.find_log_density(x[0])))
    assert weights[0] == pytest.approx(weights[1], rel=1e-6)


def test_friction_of_other_stretches_slows_a_body_that_hardly_shows_it():
    """Three stretches of 60 positions show 1.5 m/s^2; the last has four, which show next to nothing."""
    stretches, diameter = [], 0.03
    for ball, after, speed, n in ((1, False, 0.0, 60), (2, False, 1.0, 60), (1, True, 0.9, 60), (2, True, 0.1, 4)):
        time = np.sort(np.arange(1, n + 1) / 240 * (1 if after else -1))
        way = speed * time - 0.75 * time**2 if speed else 0 * time
        position = np.column_stack([way - diameter * (ball == 2), 0 * way])
        cov = np.tile(np.eye(2) * NOISE**2, (n, 1, 1))
        near, count = np.zeros(n, dtype=bool), np.ones(n, int)
        stretches.append(Stretch(ball, after, time, position, cov, 0 * cov, near, count))
    found = run_alone(fit_motions(stretches, 0.0, True, ("sliding",), LocalPriors(diameter)))
    solution, at = found[0], found[0].problem.start[3]
    assert solution.problem.motions[3] == SLIDE_AND_STOP
    assert solution.x[at + 4] == pytest.approx(-1.5, abs=0.03)
    assert 0.1 < np.sqrt(solution.cov[at + 4, at + 4]) / 1.5 < 0.25


@pytest.mark.parametrize("stops_s", [0.9, 0.305])
def test_means_of_neighbours_bias_no_velocity(stops_s):
    """Of 400 positions without noise, most are averaged. One body may stop within a mean."""
    speed, diameter, stretches = 1.5 * stops_s, 0.03, []
    for ball, after, v in ((1, False, 0.0), (2, False, 2.0), (1, True, speed), (2, True, 0.6)):
        time = np.sort(np.arange(1, 401) / 1000 * (1 if after else -1))
        until = np.minimum(time, v / 1.5) if after else time
        position = np.column_stack([v * until - 0.75 * until**2 * (v > 0) - diameter * (ball == 2), 0 * time])
        track = BallTrack(ball, np.arange(400), time, position, np.tile(np.eye(2) * NOISE**2, (400, 1, 1)), 0.0)
        stretches.append(cut_stretch(track, ball, after, 1.0, (0.0, 0.0), 1e-3))
    assert all(len(s) < 50 for s in stretches)
    [solution, *_] = run_alone(fit_motions(stretches, 0.0, True, ("sliding",), LocalPriors(diameter)))
    velocities = [solution.x[solution.problem.start[k] + 2] for k in (1, 2, 3)]
    assert velocities == pytest.approx([2.0, speed, 0.6], abs=2e-6)


@pytest.mark.parametrize("lasting", [0.0, 5e-6])
def test_hits_are_solved_together_as_alone(lasting):
    """Of different numbers of positions, starts, priors and sizes of the errors, but for rounding."""
    given = ((1, 8, None), (2, 20, None), (3, 13, 0.01))
    problems = [make_problem(seed, count, lasting=lasting, reach=reach) for seed, count, reach in given]
    problems.append(replace(problems[1], priors=LocalPriors(DIAMETER, loss=0.3, turn=0.2)))
    asked = [
        Descent([problem], guess(problem, k)[None], [1.0 + k] * 4, steps=5 + k) for k, problem in enumerate(problems)
    ]
    found = solve_descents(asked)
    for descent, [together] in zip(asked, found, strict=True):
        [[alone]] = solve_descents([descent])
        std, same = np.sqrt(np.diag(alone.cov)), np.sqrt(np.diag(together.cov))
        shown = std < 1e6  # the direction of a slide that no position shows has any error
        assert together.x == pytest.approx(alone.x, abs=1e-7 * std[shown].max())
        assert same[shown] == pytest.approx(std[shown], rel=1e-7)
        assert (same[~shown] > 1e6).all()
        for name in ("cost", "cost_of_known", "log_volume", "residual", "freedom"):
            assert getattr(together, name) == pytest.approx(getattr(alone, name), rel=1e-6, abs=1e-6), name
        assert together.sizes == tuple(descent.sizes)
    assert len({one.cost for [one] in found}) == len(found)


def test_errors_of_positions_and_of_what_is_known_make_up_the_covariance():
    """Errors of single positions, one after the other, move the parameters by the part that is not of what is known."""
    priors = LocalPriors(DIAMETER, slips=SLIPS, ends=(None, KnownEnd(0.4, 0.2, 0.01, 0.004)))
    problem = replace(make_problem(1, 8), priors=priors)
    [[found]] = solve_descents([Descent([problem], guess(problem)[None], [1.3] * 4, steps=30, least_gain=1e-12)])
    count = 2 * sum(map(len, problem.stretches))
    errors = (1.3 * NOISE * np.eye(count)).reshape(count, -1, 2)
    parts = np.split(errors, np.cumsum([len(s) for s in problem.stretches])[:-1], axis=1)
    changes = follow_displacements(found, parts)
    std = np.sqrt(np.diag(found.cov))
    of_positions, of_known = (
        (part / np.outer(std, std)) for part in (changes.T @ changes, find_covariances_of_known([found])[0])
    )
    assert of_positions + of_known == pytest.approx(found.cov / np.outer(std, std), abs=1e-6)
    assert 0.05 < np.diag(of_known).max() < 1 + 1e-9
    assert 0.05 < np.diag(of_positions).max() <= 1


def test_damping_slows_no_descent_of_a_linear_problem(monkeypatch):
    """Bodies that glide: only the distance at the contact is not linear. A descent without damping takes four steps."""
    problem, steps, sum_squares = make_problem(1, 20), [], ProblemStack.sum_squares
    problem = replace(problem, motions=(SLIDE,) * 4, glide=True)
    start = np.zeros(problem.size)
    start[:7] = guess(problem)[:7]
    monkeypatch.setattr(ProblemStack, "sum_squares", lambda *given: steps.append(0) or sum_squares(*given))
    [[found]] = solve_descents([Descent([problem], start[None], [1.0] * 4)])
    assert len(steps) <= 5
    [[exact]] = solve_descents([Descent([problem], found.x[None], [1.0] * 4, least_gain=0.0)])
    assert found.cost == pytest.approx(exact.cost, abs=1e-6)


def test_a_short_last_step_of_a_descent_is_right_though_nothing_is_computed_there(monkeypatch):
    """From a hundredth of the errors off, it leads on, and to the cost that it states."""
    problem, evaluated, sum_squares = make_problem(1, 20), [], ProblemStack.sum_squares
    [[exact]] = solve_descents([Descent([problem], guess(problem)[None], [1.0] * 4, least_gain=0.0)])
    error = np.sqrt(np.diag(exact.cov))
    correlation = exact.cov / np.outer(error, error)
    start = exact.x + 0.01 * error * np.random.default_rng(1).multivariate_normal(0 * error, correlation)
    monkeypatch.setattr(ProblemStack, "sum_squares", lambda *given: evaluated.append(0) or sum_squares(*given))
    [[found]] = solve_descents([Descent([problem], start[None], [1.0] * 4, least_gain=1e-2)])
    assert len(evaluated) == 1
    stack = ProblemStack([problem], np.ones((1, 4)))
    (before,), (after,) = (sum_squares(stack, x[None], np.array([0]))[0] for x in (start, found.x))
    assert 1e-3 < before - after < 1e-2
    assert found.cost == pytest.approx(after, abs=1e-3)
    assert found.cost == pytest.approx(exact.cost, abs=1e-3)
    known = error < 1  # not the logarithms of durations that no position shows
    assert np.sqrt(np.diag(found.cov))[known] == pytest.approx(error[known], rel=0.03)


def test_slips_have_the_errors_of_draws():
    """The drag is the same for both balls, and what is left of an earlier slip enters both."""
    rng, drag = np.random.default_rng(1), SLIPS.drag
    left = 0.02 * rng.standard_normal((200_000, 2))
    of_share = 0.01 * rng.standard_normal((200_000, 1)) * SLIPS.normal
    own = 0.005 * rng.standard_normal((200_000, 4))
    errors = own + np.hstack([of_share - left @ drag.T, of_share + left - left @ drag.T])
    assert np.cov(SLIPS.whiten @ errors.T) == pytest.approx(np.eye(4), abs=0.02)


def test_a_failure_of_arithmetic_costs_no_other_hit(monkeypatch):
    def solve(asked, *, original=descents._solve_stack):
        if any(np.isnan(descent.x).any() for descent in asked):
            raise np.linalg.LinAlgError("no eigenvalues")
        return original(asked)

    def fit(x):
        try:
            [[solution]] = yield [Descent([problem], x[None], [1.0] * 4)]
        except ValueError as error:
            return str(error)
        return solution.cost

    monkeypatch.setattr(descents, "_solve_stack", solve)
    problem = make_problem(1, 8)
    x = guess(problem)
    alone = run_alone(fit(x))
    assert run_together([fit(x), fit(np.full_like(x, np.nan)), fit(x)]) == [alone, "no eigenvalues", alone]


def test_fits_that_need_several_descents_or_none_end_in_their_order():
    def fit(turns):
        for turn in range(turns):
            solutions = yield [Descent([problem], guess(problem, turn)[None], [1.0] * 4, steps=1)] * turn
            assert len(solutions) == turn
        return turns

    problem = make_problem(1, 8)
    assert run_together([fit(turns) for turns in (2, 0, 3, 1)]) == [2, 0, 3, 1]


def test_a_singular_system_stops_no_other():
    systems = np.stack([2 * np.eye(2), np.ones((2, 2))])
    one, singular = solve_each(systems, np.ones((2, 2, 1)))
    assert one.ravel().tolist() == [0.5, 0.5]
    assert np.isnan(singular).all()


def test_the_prior_of_slips_counts_for_their_durations_and_directions():
    """A slip is 7/2 of what friction takes in its duration. The density goes with the area of steps of these two."""
    problem = replace(make_problem(1, 8), priors=LocalPriors(DIAMETER, slips=SLIPS))
    problem = replace(problem, slides=dict.fromkeys(problem.slips, (0.03, 1.0)))

    def find_slip(x, k):
        lasts, angle = np.exp(x[problem.start[k] + 6]), x[problem.start[k] + 5]
        return 3.5 * lasts * GRAVITY * np.exp(x[5] + x[problem.start[k] + 4]) * np.array([np.cos(angle), np.sin(angle)])

    def find_log_area(x):
        out, step = 0.0, 1e-5
        for k in problem.slips:
            steps = step * np.eye(problem.size)[[problem.start[k] + 5, problem.start[k] + 6]]
            out += np.log(
                abs(np.linalg.det([(find_slip(x + by, k) - find_slip(x - by, k)) / (2 * step) for by in steps]))
            )
        return out

    assert len(problem.slips) == 2
    one, other = guess(problem, 1), guess(problem, 2)
    for k, lasts in zip(problem.slips, (0.1, 0.05), strict=True):
        other[problem.start[k] + 6] = np.log(lasts)
    change = problem.find_log_density(other) - problem.find_log_density(one)
    assert change == pytest.approx(find_log_area(other) - find_log_area(one), abs=1e-6)
    assert abs(change) > 1
