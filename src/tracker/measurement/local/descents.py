"""Solves local fits by damped Gauss-Newton steps, those of many hits at once.

A local fit takes dozens of small descents, each from the solutions of those before. `FitInSteps` is such a fit: it
yields the descents that it needs next, and gets their solutions. `run_together` advances the fits of many hits and
solves what they need at the same time. Problems of the same form go into one stack of arrays, because numpy's time for
one small problem is mostly that of its calls.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from itertools import groupby
from typing import NamedTuple, TypeAlias, TypeVar

import numpy as np

from synthcam_shared.arrays import Array, Ints
from tracker.measurement.collision.collision_model import GRAVITY
from tracker.measurement.local.local_problem import ANY_TURN, LocalProblem, LocalSolution
from tracker.measurement.local.stretches import MotionKind, Stretch, evaluate_path

Found = TypeVar("Found")

# A problem is as good as linear if each step so far has gained this share of what it would gain in a linear one.
# Damping then only slows the descent down, and falls by this factor.
LINEAR_SHARE, LINEAR_DAMPING_FACTOR = 0.95, 1e-3
SHORT_STEP = 0.1  # of logarithms, and of directions in rad, up to which a last step of little gain is not checked


@dataclass(frozen=True)
class Descent:
    """Local fits of one hit from x (m, n). The problems differ only in what is known.

    hopeless: by which a cost exceeds the least one where the descent ends after four steps, because nothing needs so
    poor a solution.
    """

    problems: Sequence[LocalProblem]
    x: Array
    sizes: Sequence[float]  # of the errors of each stretch, over the claimed ones
    steps: int = 40
    hopeless: float = np.inf
    least_gain: float = 1e-4


FitInSteps: TypeAlias = Generator[list[Descent], list[list[LocalSolution]], Found]


def run_alone(fit: FitInSteps[Found]) -> Found:
    """Run one local fit to its end."""
    [found] = run_together([fit])
    return found


def run_together(fits: Sequence[FitInSteps[Found]]) -> list[Found]:
    """Run local fits to their ends, and solve what they need at the same time together."""
    out, waiting = dict[int, Found](), dict[int, list[Descent]]()

    def advance(number: int, answer: list[list[LocalSolution]] | Exception | None) -> None:
        fit = fits[number]
        try:
            waiting[number] = fit.throw(answer) if isinstance(answer, Exception) else fit.send(answer)  # type: ignore[arg-type]
        except StopIteration as end:
            out[number] = end.value

    for number in range(len(fits)):
        advance(number, None)
    while waiting:
        asked = dict(waiting)
        waiting.clear()
        for number, answer in zip(asked, _answer(list(asked.values())), strict=True):
            advance(number, answer)
    return [out[number] for number in range(len(fits))]


def _answer(asked: Sequence[list[Descent]]) -> list[list[list[LocalSolution]] | Exception]:
    """The solutions of the descents of each fit, or the error of a fit whose arithmetic fails."""
    try:
        found = iter(solve_descents([descent for each in asked for descent in each]))
        return [[next(found) for _ in each] for each in asked]
    except (ArithmeticError, ValueError) as error:
        if len(asked) == 1:
            return [error]
        return [answer for each in asked for answer in _answer([each])]  # one hit never costs the others


def solve_descents(descents: Sequence[Descent]) -> list[list[LocalSolution]]:
    """Solve local fits of one or several hits (Levenberg and Marquardt)."""
    out = dict[int, list[LocalSolution]]()
    by_form = sorted(range(len(descents)), key=lambda k: repr(descents[k].problems[0].form))
    for _, same in groupby(by_form, key=lambda k: descents[k].problems[0].form):
        for part in _split(list(same), descents):
            out |= zip(part, _solve_stack([descents[k] for k in part]), strict=True)
    return [out[k] for k in range(len(descents))]


def _split(numbers: Sequence[int], descents: Sequence[Descent], most: int = 100) -> Iterator[list[int]]:
    """Split the numbers of descents into parts of at most so many problems, or of one descent; more are no quicker."""
    part, count = list[int](), 0
    for number in numbers:
        more = len(descents[number].problems)
        if part and count + more > most:
            yield part
            part, count = [], 0
        part.append(number)
        count += more
    yield part


def _solve_stack(descents: Sequence[Descent]) -> list[list[LocalSolution]]:
    """Solve the descents of problems of the same form."""
    count = np.array([len(descent.problems) for descent in descents])
    first = np.cumsum(count) - count
    problems = [problem for descent in descents for problem in descent.problems]
    names = ("sizes", "steps", "hopeless", "least_gain")
    given = ([getattr(descent, name) for descent in descents] for name in names)
    sizes, steps, hopeless, least_gain = (np.repeat(values, count, axis=0) for values in given)
    stack = ProblemStack(problems, sizes)
    x, each = np.concatenate([descent.x for descent in descents]), np.arange(stack.one.size)
    active = np.arange(len(x))
    cost, pull, square = stack.sum_squares(x, active)
    damping, turns = np.full(len(x), 1e-3), np.zeros(len(x), dtype=int)
    is_linear = np.ones(len(x), dtype=bool)
    while len(active):
        own_pull, own_square = pull[active], square[active]
        size = np.sqrt(np.diagonal(own_square, axis1=1, axis2=2) + 1e-12)
        damped = own_square / size[:, :, None] / size[:, None]
        damped[:, each, each] += damping[active][:, None]
        step = -solve_each(damped, (own_pull / size)[..., None])[..., 0] / size
        tried = stack.keep_within_reach(x[active], step)
        moved = tried - x[active]
        predicted = -(moved * (2 * own_pull + (own_square @ moved[..., None])[..., 0])).sum(axis=1)
        least = least_gain[active] * (1 + 1e-3 * cost[active])
        # so short a step gains as much as in a linear problem, which its residuals need not confirm
        short = (predicted < least_gain[active]) & (np.abs(moved[:, stack.short]).max(axis=1) < SHORT_STEP)
        x[active[short]], cost[active[short]] = tried[short], (cost[active] - predicted)[short]
        active, tried, predicted, least = active[~short], tried[~short], predicted[~short], least[~short]
        if not len(active):
            break
        new, new_pull, new_square = stack.sum_squares(tried, active)
        gain = cost[active] - new
        better, at = gain >= 0, active[gain >= 0]
        x[at], cost[at], pull[at], square[at] = tried[better], new[better], new_pull[better], new_square[better]
        is_linear[active] &= better & (gain > LINEAR_SHARE * predicted)
        damping[active] *= np.where(better, np.where(is_linear[active], LINEAR_DAMPING_FACTOR, 0.2), 8.0)
        turns[at] += 1
        ends = np.zeros(len(x), dtype=bool)
        ends[at] = (gain < least)[better] | (turns[at] >= steps[at])
        least_cost = np.repeat(np.minimum.reduceat(cost, first), count)
        ends |= (damping > 1e8) | ((turns > 3) & (cost > least_cost + hopeless))
        active = active[~ends[active]]
    found = iter(_read_solutions(stack, x, cost, square))
    return [[next(found) for _ in descent.problems] for descent in descents]


def _read_solutions(stack: ProblemStack, x: Array, cost: Array, square: Array) -> list[LocalSolution]:
    """The solutions of a stack by its parameters, costs and squared derivatives at the minima."""
    square = square.copy()
    for k in stack.one.free_turns:  # if positions hardly show a direction, its linear error is many turns
        square[:, stack.one.start[k] + 5, stack.one.start[k] + 5] += 1 / ANY_TURN**2
    size = np.sqrt(np.maximum(np.diagonal(square, axis1=1, axis2=2), 1e-300))
    unit = square / size[:, :, None] / size[:, None]
    cov = np.linalg.pinv(unit, rcond=1e-13, hermitian=True) / (size[:, :, None] * size[:, None])
    volume = -np.linalg.slogdet(unit)[1] / 2 - np.log(size).sum(axis=1)

    @cache
    def weigh_all() -> tuple[Array, Array, Array]:
        return stack.weigh_positions(x, cov)

    def weigh(i: int) -> tuple[Array, Array, float]:
        residuals, freedoms, known = weigh_all()
        return residuals[i][stack.present[i]], freedoms[i][stack.present[i]], float(known[i])

    return [
        LocalSolution(problem, x[i], cov[i], tuple(sizes), float(cost[i]), float(volume[i]), partial(weigh, i))
        for i, (problem, sizes) in enumerate(zip(stack.problems, stack.sizes.tolist(), strict=True))
    ]


def follow_displacements(solution: LocalSolution, moved: Sequence[Array]) -> Array:
    """Compute the changes (m, n) of the parameters, to first order, by m displacements of all positions.

    moved: displacements (m, positions, 2) of each stretch, m.
    """
    problem, alone = solution.problem, np.zeros(1, dtype=np.int64)
    stack, pull = ProblemStack([problem], np.array([solution.sizes])), np.zeros((len(moved[0]), problem.size))
    for k, white in enumerate(stack._whiten_stretches(solution.x[None], alone)):
        rows, columns = stack.parts[k]
        by = white[0, rows[1:]]
        pull[:, columns] += problem.stretches[k].whiten(moved[k]) / solution.sizes[k] @ by.T
    return np.asarray(pull @ solution.cov)


def find_covariances_of_known(solutions: Sequence[LocalSolution]) -> list[Array]:
    """Find the part of the covariance (n, n) of each solution that errors of what is known make, not of positions."""
    out, alone = list[Array](), np.zeros(1, dtype=np.int64)
    for one in solutions:
        _, by = ProblemStack([one.problem], np.array([one.sizes]))._weigh_known(one.x[None], alone)
        through = by[0] @ one.cov
        out.append(through.T @ through)
    return out


def solve_each(square: Array, pull: Array) -> Array:
    """Solve the linear systems (m, n, n) of local fits; NaN of a singular one, whose step is then rejected."""
    try:
        return np.asarray(np.linalg.solve(square, pull))
    except np.linalg.LinAlgError:
        if len(square) == 1:
            return np.full_like(pull, np.nan)
        return np.concatenate([solve_each(square[k : k + 1], pull[k : k + 1]) for k in range(len(square))])


class StretchStack(NamedTuple):
    """The stretches of one side of h hits, with as many positions each; those that a stretch lacks have no weight."""

    stretches: Sequence[Stretch]
    time: Array  # (h, n) s
    reach: Array  # (h, n) s, of means to either side; 0: single frames
    position: Array  # (h, n, 2) m
    root: Array | None  # (h, n, 2, 2) that whitens each position; None if errors of different positions correlate

    @staticmethod
    @lru_cache(maxsize=8)  # the descents of one hit are about the same stretches
    def of(stretches: tuple[Stretch, ...]) -> StretchStack:
        """Stack stretches."""
        most = max(map(len, stretches))
        filled = [np.minimum(np.arange(most), len(s) - 1) for s in stretches]
        root = None
        if not any(s.whiten.blocks for s in stretches):
            root = np.stack([s.whiten.alone[rows] for s, rows in zip(stretches, filled, strict=True)])
            for s, own in zip(stretches, root, strict=True):
                own[len(s) :] = 0.0
        time, position = (
            np.stack([getattr(s, name)[rows] for s, rows in zip(stretches, filled, strict=True)])
            for name in ("time", "position")
        )
        reaches = (np.zeros(len(s)) if s.reach is None else s.reach for s in stretches)
        reach = np.stack([own[rows] for own, rows in zip(reaches, filled, strict=True)])
        return StretchStack(stretches, time, reach, position, root)

    def whiten(self, errors: Array, hits: Ints) -> Array:
        """Whiten errors (m, k, n, 2) of problems of each of these hits (m,), in ascending order: (m, k, 2n)."""
        if len(self.stretches) == 1:
            return self.stretches[0].whiten(errors)
        out = np.zeros(errors.shape)
        if self.root is not None:
            root = self.root[hits][:, None]
            out[..., 0] = root[..., 0, 0] * errors[..., 0]
            out[..., 1] = root[..., 1, 0] * errors[..., 0] + root[..., 1, 1] * errors[..., 1]
            return out.reshape(*errors.shape[:-2], -1)
        out = out.reshape(*errors.shape[:-2], -1)
        for hit in np.unique(hits):
            rows, stretch = hits == hit, self.stretches[hit]
            out[rows, :, : 2 * len(stretch)] = stretch.whiten(errors[rows, :, : len(stretch)])
        return out


class ProblemStack:
    """Problems of the same form, of one or several hits, whose residuals are computed together.

    A stretch depends on a few of the parameters only, so sums of squares are those of its own rows and parameters.
    """

    def __init__(self, problems: Sequence[LocalProblem], sizes: Array) -> None:
        """sizes (m, 4): of the errors of each stretch, over the claimed ones."""
        self.problems, self.sizes, self.one = problems, sizes, problems[0]
        numbers = dict[int, int]()  # of the hits
        self.hit = np.array([numbers.setdefault(id(p.stretches), len(numbers)) for p in problems])
        _, firsts = np.unique(self.hit, return_index=True)
        self.sides = [StretchStack.of(side) for side in zip(*(problems[k].stretches for k in firsts), strict=True)]
        lengths = np.array([[len(s) for s in p.stretches] for p in problems])
        present = [np.arange(2 * side.time.shape[1]) < 2 * lengths[:, k, None] for k, side in enumerate(self.sides)]
        self.present = np.concatenate(present, axis=1)  # (m, 2n) whether a coordinate is one of the problem
        self.parts = [_list_parameters(self.one, k) for k in range(len(self.sides))]
        self.groups = _group_stretches(self.one)
        # (h, g, n) s; no reaches of single frames alone
        self.times = [_stack_times([self.sides[k].time for k in group]) for group in self.groups]
        reaches = (_stack_times([self.sides[k].reach for k in group]) for group in self.groups)
        self.reaches = [reach if reach.any() else None for reach in reaches]
        self.spans = np.array([p.spans for p in problems])
        motions = list(enumerate(self.one.motions))
        self.taus = np.array([self.one.start[k] + 6 for k, motion in motions if motion.ends], dtype=np.int64)
        rubs = [self.one.start[k] + axis for k, _ in motions if self.one.rubs(k) for axis in (4, 5)]
        self.short = np.array([5, *self.taus.tolist(), *rubs])
        self.known, self.by_known = (np.stack(part) for part in zip(*(p.known for p in problems), strict=True))
        self.square_of_known = np.swapaxes(self.by_known, 1, 2) @ self.by_known
        self.turns, self.slips, self.dry = self.one.turns, self.one.slips, self.one.dry
        self.dry_scatter = np.array([p.priors.dry_scatter for p in problems])  # (m, 2)
        self.curved = 1 + len(self.turns) + 2 * len(self.slips) + 2 * len(self.dry)  # rows of what is not linear
        priors = [p.priors for p in problems]
        self.diameter = np.array([p.diameter for p in priors])
        self.distance_error = np.array([p.distance_share * p.diameter for p in priors])
        self.turn = np.array([[p.find_turn(k) for k in self.turns] for p in problems])  # (m, turns) rad
        ends = [[p.find_end(k) for k in self.turns] for p in problems]
        self.towards = np.array([[np.nan if end is None else end.towards for end in each] for each in ends])
        if self.slips:
            slips = [p.priors.slips for p in problems]
            # (m, 4, 4), (m, 2, 2), (m, 2, 2)
            self.whiten, self.drag, self.left = (
                np.array([getattr(one, name) for one in slips]) for name in ("whiten", "drag", "left")
            )

    def keep_within_reach(self, x: Array, step: Array) -> Array:
        """x (m, n) after steps whose logarithms, and directions of friction in rad, change by at most one."""
        out, middle = x + step, x[:, self.short]
        out[:, self.short] = np.minimum(np.maximum(out[:, self.short], middle - 1), middle + 1)
        out[:, self.taus] = np.minimum(np.maximum(out[:, self.taus], np.log(1e-10)), np.log(1e2))
        return out

    def sum_squares(self, x: Array, which: Ints) -> tuple[Array, Array, Array]:
        """Sums of squared whitened residuals r (m,), of their derivatives J times r (m, n), and of J by J (m, n, n).

        x (m, n): parameters of these problems (m,).
        """
        known, by = self._weigh_known(x, which)
        curved = by[:, : self.curved]  # the other rows are always the same
        square = self.square_of_known[which] + np.swapaxes(curved, 1, 2) @ curved
        cost, pull = (known**2).sum(axis=1), (known[:, None] @ by)[:, 0]
        for (rows, columns), white in zip(self.parts, self._whiten_stretches(x, which), strict=True):
            own = (white @ np.swapaxes(white, 1, 2))[:, rows[:, None], rows]
            cost += own[:, 0, 0]
            pull[:, columns] += own[:, 1:, 0]
            square[:, columns[:, None], columns] += own[:, 1:, 1:]
        return cost, pull, square

    def weigh_positions(self, x: Array, cov: Array) -> tuple[Array, Array, Array]:
        """Whitened residuals (m, 2n) of all problems, their degrees of freedom, and the cost (m,) of what is known."""
        which, residuals, freedoms = np.arange(len(x)), list[Array](), list[Array]()
        for (rows, columns), white in zip(self.parts, self._whiten_stretches(x, which), strict=True):
            by = white[:, rows[1:]]
            residuals.append(white[:, 0])
            freedoms.append(1 - (by * (cov[:, columns[:, None], columns] @ by)).sum(axis=1))
        known, _ = self._weigh_known(x, which)
        return np.concatenate(residuals, axis=1), np.concatenate(freedoms, axis=1), (known**2).sum(axis=1)

    def _whiten_stretches(self, x: Array, which: Ints) -> list[Array]:
        """Whitened residuals of each stretch, and their derivatives by its own parameters, the instant, and the fall.

        Returns (m, 1 + size + 1, 2n) for each, in that order, or one row more of a body that rolls.
        """
        out, hits = dict[int, Array](), self.hit[which]
        for group, time, reach in zip(self.groups, self.times, self.reaches, strict=True):
            means_over = None if reach is None else reach[hits]
            path, slope = self._evaluate_paths(x, which, group, time[hits], means_over)
            for number, k in enumerate(group):
                side = self.sides[k]
                n = side.time.shape[1]
                off = (path[:, number, :n] - side.position[hits])[:, None]
                white = side.whiten(np.concatenate([off, slope[:, number, :, :n]], axis=1), hits)
                white /= self.sizes[which, k, None, None]
                out[k] = white
        return [out[k] for k in range(len(self.sides))]

    def _evaluate_paths(
        self, x: Array, which: Ints, group: Sequence[int], time: Array, reach: Array | None
    ) -> tuple[Array, Array]:
        """Paths (m, g, n, 2) of stretches of one motion at times (m, g, n), s, and derivatives as of `evaluate_path`.

        reach (m, g, n): means over so much time to either side, s. All at once, because most of the time is that of
        numpy's calls.
        """
        one, span = self.one, self.spans[which][:, group]
        own = np.stack([one.values(x, k, span[:, number]) for number, k in enumerate(group)], axis=1)
        since, after = time - x[:, :1, None], one.stretches[group[0]].after
        path, slope = evaluate_path(one.motions[group[0]], own, since, after, reach, x[:, 7, None, None])
        if one.slides_first(group[0]):
            lasts = np.exp(own[..., 6])
            tau, by_v = np.minimum(lasts, span)[..., None, None, None], slope[:, :, 2:4].copy()
            slope[:, :, 4:6] -= tau * by_v
            ends = tau[:, :, 0] * (lasts < span)[..., None, None]
            turned = own[..., 4, None, None] * by_v[:, :, 0] + own[..., 5, None, None] * by_v[:, :, 1]
            slope[:, :, 6] -= ends * turned
        if one.rubs(group[0]):
            ax, ay = own[..., 4, None, None], own[..., 5, None, None]
            along = ax * slope[:, :, 4] + ay * slope[:, :, 5]
            slope[:, :, 5] = ax * slope[:, :, 5] - ay * slope[:, :, 4]
            slope[:, :, 4] = along
        return path, slope

    def _weigh_known(self, x: Array, which: Ints) -> tuple[Array, Array]:
        """Residuals (m, rows) of what is known, and their derivatives (m, rows, n)."""
        by = self.by_known[which]
        known = (by @ x[..., None])[..., 0] - self.known[which]
        gap, error = x[:, 1:3] - x[:, 3:5], self.distance_error[which]
        apart = np.maximum(np.hypot(gap[:, 0], gap[:, 1]), 1e-12)
        known[:, 0] = (apart - self.diameter[which]) / error  # of the distance at which the bodies touch
        by[:, 0, 1:3] = gap / apart[:, None] / error[:, None]
        by[:, 0, 3:5] = -by[:, 0, 1:3]
        for row, k in enumerate(self.turns, 1):
            self._add_friction_direction(x, which, k, known, by, row)
        if self.slips:
            rows = slice(1 + len(self.turns), 1 + len(self.turns) + 2 * len(self.slips))
            self._add_slips(x, which, known[:, rows], by[:, rows])
        for number, k in enumerate(self.dry, -len(self.dry)):
            rows = slice(self.curved + 2 * number, self.curved + 2 * number + 2)
            self._add_dry_friction(x, which, k, known[:, rows], by[:, rows])
        return known, by

    def _add_dry_friction(self, x: Array, which: Ints, k: int, known: Array, by: Array) -> None:
        """Add the residuals (m, 2) of dry friction, along the path and across it, and their derivatives (m, 2, n)."""
        at, (scatter_along, scatter_across) = self.one.start[k], self.dry_scatter[which].T
        v, pull = x[:, at + 2 : at + 4], x[:, at + 4 : at + 6] / (np.exp(x[:, 5:6]) * GRAVITY)
        speed = np.maximum(np.hypot(v[:, 0], v[:, 1]), 1e-6)[:, None]
        along = v / speed
        across = np.column_stack([-along[:, 1], along[:, 0]])
        axes = np.stack([along / scatter_along[:, None], across / scatter_across[:, None]], axis=1)
        known[:] = (axes @ pull[..., None])[..., 0]
        by[:, :, at + 4 : at + 6] = axes / (np.exp(x[:, 5]) * GRAVITY)[:, None, None]
        by[:, :, 5] = -known
        known[:, 0] += 1 / scatter_along
        turned = np.stack([across / scatter_along[:, None], -along / scatter_across[:, None]], axis=1)
        by[:, :, at + 2 : at + 4] = (turned @ pull[..., None]) * (across / speed)[:, None]

    def _add_slips(self, x: Array, which: Ints, known: Array, by: Array) -> None:
        """Add the residuals (m, 4) of slips that are known, and their derivatives (m, 4, n).

        A slide costs two sevenths of the slip. The slip follows from the velocities just before and after the contact,
        as `KnownSlips` says.
        """
        one, drag, left = self.one, self.drag[which], self.left[which]
        off, slope = np.zeros((len(x), 4)), np.zeros(by.shape)
        for number, k in enumerate(self.slips):
            own, at, span = one.stretches[k].ball, one.start[k], self.spans[which, k]
            rows, motion = slice(2 * number, 2 * number + 2), one.values(x, k, span)
            tau, pull = np.exp(x[:, at + 6])[:, None], motion[:, 4:6]
            lost = 3.5 * tau - np.minimum(tau, span[:, None])
            off[:, rows] = 3.5 * tau * pull + motion[:, 2:4] + left[:, own - 1]
            off[:, rows] -= (drag @ left.sum(axis=1)[..., None])[..., 0]
            slope[:, rows, at + 2 : at + 4] = np.eye(2)
            slope[:, rows, 5] = slope[:, rows, at + 4] = lost * pull
            slope[:, rows, at + 5] = lost * np.column_stack([-pull[:, 1], pull[:, 0]])
            slope[:, rows, at + 6] = (3.5 - (tau < span[:, None])) * tau * pull
            for ball in (1, 2):
                before = one.find_stretch(ball, after=False)
                if one.motions[before].moves:
                    goes = slice(one.start[before] + 2, one.start[before] + 4)
                    share = drag - np.eye(2) * (ball == own)
                    off[:, rows] += (share @ x[:, goes, None])[..., 0]
                    slope[:, rows, goes] = share
        known[:] = (self.whiten[which] @ off[..., None])[..., 0]
        by[:] = self.whiten[which] @ slope

    def _add_friction_direction(self, x: Array, which: Ints, k: int, known: Array, by: Array, row: int) -> None:
        """Add the residual and the derivatives of the direction of friction.

        Unless it is known, a ball that rolled or rested returns towards its velocity before the hit, apart from the
        spin that the friction between the bodies adds. That of a ball that slid is all but unknown.
        """
        if not self.one.stretches[k].after:
            at = self.one.start[k] + 5
            known[:, row] = _turn_between(x[:, at], self.towards[which, row - 1]) / self.turn[which, row - 1]
            by[:, row, at] = 1 / self.turn[which, row - 1]
            return
        one = self.one
        before = one.find_stretch(one.stretches[k].ball, after=False)
        at, from_ = one.start[k], one.start[before]
        moved, now = one.motions[before].moves, x[:, at + 2 : at + 4]
        old = x[:, from_ + 2 : from_ + 4] if moved else np.zeros_like(now)
        way = old - now
        size = np.maximum(np.hypot(way[:, 0], way[:, 1]), 1e-9)
        share = (np.hypot(old[:, 0], old[:, 1]) + np.hypot(now[:, 0], now[:, 1])) / size
        error = np.hypot(0.1 * share, self.turn[which, row - 1])
        known[:, row] = _turn_between(x[:, at + 5], np.arctan2(way[:, 1], way[:, 0])) / error
        turn = np.column_stack([-way[:, 1], way[:, 0]]) / (size**2 * error)[:, None]
        by[:, row, at + 5], by[:, row, at + 2 : at + 4] = 1 / error, turn
        if moved:
            by[:, row, from_ + 2 : from_ + 4] = -turn


def _turn_between(angle: Array, other: Array) -> Array:
    """Angles less other ones, rad, from -pi to pi."""
    return np.asarray((angle - other + np.pi) % (2 * np.pi) - np.pi)


def _group_stretches(problem: LocalProblem) -> list[list[int]]:
    """Numbers of the stretches whose paths are evaluated together: those of one motion on one side of the contact."""
    groups = dict[tuple[MotionKind, bool], list[int]]()
    for k, (stretch, motion) in enumerate(zip(problem.stretches, problem.motions, strict=True)):
        groups.setdefault((motion, stretch.after), []).append(k)
    return list(groups.values())


def _stack_times(times: Sequence[Array]) -> Array:
    """Times (h, g, n) of g sides of h hits; those of a shorter side are followed by copies of its last time."""
    most = max(time.shape[1] for time in times)
    return np.stack([time[:, np.minimum(np.arange(most), time.shape[1] - 1)] for time in times], axis=1)


def _list_parameters(problem: LocalProblem, k: int) -> tuple[Ints, Ints]:
    """The rows of `_whiten_stretches` of a stretch that count, and the parameters to which all but the first belong.

    A row counts twice if its derivative is also that by a parameter which stretches share.
    """
    size = problem.motions[k].size
    start, place = problem.start[k], problem.place(k)
    rows, columns = [0, *range(1, size + 2), 1, 2], [*range(start, start + size), 0, place.start, place.start + 1]
    if problem.rubs(k):
        rows, columns = [*rows, 5], [*columns, 5]
    if problem.motions[k].rolls:
        rows, columns = [*rows, size + 2], [*columns, 7]
    return np.array(rows), np.array(columns)
