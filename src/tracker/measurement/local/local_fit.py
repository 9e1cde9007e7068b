"""The local fit: stretches of free motion that meet at a contact, without any law of the impact.

The parameters are the instant of the contact, the place of each body there, and for each stretch a start of its own.
Weak knowledge keeps short stretches regular, as rows of the least squares:

- the bodies touch at about one diameter, and each is in about one place before and after the contact;
- the plate's friction, and its rolling loss, are about the same in all stretches.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from tracker.measurement.collision.collision_model import GRAVITY
from tracker.measurement.local.stretches import REST, ROLL, SLIDE, SLIDE_AND_ROLL, MotionKind, Stretch, evaluate_path

Floats = NDArray[np.float64]
MAX_RESIDUAL = 2.0  # rms residual of a window, in errors
MAX_SOLUTIONS = 8  # that are averaged
MAX_COST = 16.0  # beyond that of the best duration of a slide


@dataclass(frozen=True)
class LocalPriors:
    """Prior values of a fit, with their errors."""

    diameter: float  # m
    distance_share: float = 0.016  # error of the distance at which the bodies touch, diameters
    shift_share: float = 0.005  # by which a body may be elsewhere after the contact, diameters
    friction: float = 0.2  # the plate's
    friction_factor: float = 0.7  # error of its logarithm
    friction_scatter: float = 0.04  # from stretch to stretch, relative
    turn: float = 0.5  # rad, of friction from the direction in which a ball that did not slide is slowed or sped up
    slide_s: float = 0.1  # duration of a slide
    slide_factor: float = 3.0  # error of its logarithm
    loss: float = 0.05  # of rolling, m/s^2; its error is as large
    loss_scatter: float = 0.03  # from stretch to stretch, m/s^2: balls of steel lose more the faster they roll
    push: float = 1.0  # acceleration of bodies that glide, m/s^2


@dataclass(frozen=True)
class LocalProblem:
    """The stretches of one hit with their motions; `glide` if the bodies slide on air, where pushes are unlike.

    slides: of stretches whose slide has an assumed duration, that duration, s, and the error of its logarithm.
    """

    stretches: tuple[Stretch, ...]
    motions: tuple[MotionKind, ...]
    priors: LocalPriors
    glide: bool
    slides: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    start: tuple[int, ...] = field(init=False)  # of each stretch in the vector of parameters
    spans: tuple[float, ...] = field(init=False)  # duration of each stretch, s

    COMMON = 7  # t_c; x, y of ball 1; x, y of ball 2; log of the friction; loss

    def __post_init__(self) -> None:
        ends = np.cumsum([self.COMMON, *(motion.size for motion in self.motions)])
        object.__setattr__(self, "start", tuple(int(end) for end in ends))
        object.__setattr__(self, "spans", tuple(float(np.ptp(s.time)) for s in self.stretches))

    @property
    def size(self) -> int:
        """Number of parameters."""
        return self.start[-1]

    def values(self, x: Floats, k: int) -> Floats:
        """The parameters of a stretch, with its place at the contact."""
        own = x[self.start[k] : self.start[k + 1]].copy()
        own[:2] += x[self.place(k)]
        if self.rubs(k):
            size, angle = float(np.exp(x[5] + own[4])) * GRAVITY, own[5]
            own[4:6] = size * np.cos(angle), size * np.sin(angle)
        if self.slides_first(k):
            own[2:4] -= own[4:6] * min(float(np.exp(own[6])), self.spans[k])
        return own

    def rubs(self, k: int) -> bool:
        """Decide whether a stretch is pushed by friction: its size over the common one and its direction are fitted."""
        return self.motions[k].pushed and not self.glide

    def slides_first(self, k: int) -> bool:
        """Decide whether a stretch begins with a slide; the velocity at its end, which is known better, is fitted.

        The end is that of the slide or that of the stretch, whichever is earlier.
        """
        return self.stretches[k].after and self.motions[k].ends

    def place(self, k: int) -> slice:
        """Find the position of a stretch's body in the vector of parameters."""
        return slice(1, 3) if self.stretches[k].ball == 1 else slice(3, 5)

    @cached_property
    def counted(self) -> NDArray[np.bool_]:
        """Tell which coordinates (2n,) show the size of the errors: not those beside the contact."""
        return np.concatenate([np.repeat(~s.near, 2) for s in self.stretches])

    def residuals(self, x: Floats, sizes: Sequence[float]) -> tuple[Floats, Floats]:
        """Whitened residuals and derivatives, positions first and then what is known.

        sizes: of the errors of each stretch, over the claimed ones.
        """
        whole, slopes, end = list[Floats](), np.zeros((len(self.counted) + len(self._known[0]), self.size)), 0
        for k, (stretch, motion, size) in enumerate(zip(self.stretches, self.motions, sizes, strict=True)):
            own = self.values(x, k)
            path, slope = evaluate_path(motion, own, stretch.time - x[0], stretch.after)
            if self.slides_first(k):
                tau, by_v = min(float(np.exp(own[6])), self.spans[k]), slope[2:4].copy()
                slope[4:6] -= tau * by_v
                if tau < self.spans[k]:
                    slope[6] -= tau * (own[4] * by_v[0] + own[5] * by_v[1])
            if self.rubs(k):
                along = own[4] * slope[4] + own[5] * slope[5]
                slope[5] = own[4] * slope[5] - own[5] * slope[4]
                slope[4] = along
            white = stretch.whiten(np.concatenate([(path - stretch.position)[None], slope])) / size
            rows, end = slice(end, end + white.shape[1]), end + white.shape[1]
            whole.append(white[0])
            slopes[rows, self.start[k] : self.start[k + 1]] = white[1:-1].T
            slopes[rows, self.place(k)] = white[1:3].T
            slopes[rows, 0] = white[-1]
            if self.rubs(k):
                slopes[rows, 5] = white[5]
        known, by = self._known
        slopes[end:] = by
        whole.append(by @ x - known)
        self._add_distance(x, whole[-1], slopes[end:])
        for row, k in enumerate((k for k in range(len(self.stretches)) if self.slides_first(k)), 1):
            self._add_friction_direction(x, k, whole[-1], slopes[end:], row)
        return np.concatenate(whole), slopes

    @cached_property
    def _known(self) -> tuple[Floats, Floats]:
        """Prior knowledge as equations with errors of one: values, and matrix of the parameters.

        The first rows, of the distance and of the directions of friction, are not linear; they are zero here.
        """
        rows = self._list_known()
        matrix = np.zeros((len(rows), self.size))
        for i, (_, error, factors) in enumerate(rows):
            for j, factor in factors.items():
                matrix[i, j] = factor / error
        return np.array([value / error if by else 0.0 for value, error, by in rows]), matrix

    @cached_property
    def log_width(self) -> float:
        """Logarithm of the volume of what is known of the motions, any direction of a slide before the contact."""
        free = sum(self.rubs(k) and not self.slides_first(k) for k in range(len(self.motions)))
        return float(sum(np.log(error) for _, error, _ in self._list_known())) + free * float(np.log(2 * np.pi) / 2)

    def _list_known(self) -> list[tuple[float, float, dict[int, float]]]:
        """Prior knowledge: value, error, and factors of the parameters; none of what is not linear."""
        p = self.priors
        rows: list[tuple[float, float, dict[int, float]]] = [(0.0, p.distance_share * p.diameter, {})]
        slides = [k for k in range(len(self.stretches)) if self.slides_first(k)]
        rows += [(0.0, np.pi / np.sqrt(3) if self.motions[self._before(k)].pushed else p.turn, {}) for k in slides]
        rows += [(np.log(p.friction), p.friction_factor, {5: 1.0}), (p.loss, p.loss, {6: 1.0})]
        for k, motion in enumerate(self.motions):
            at, last = self.start[k], self.start[k + 1] - 1
            rows += [(0.0, p.shift_share * p.diameter, {at + axis: 1.0}) for axis in (0, 1)]
            if motion.pushed and self.glide:
                rows += [(0.0, p.push, {at + 4 + axis: 1.0}) for axis in (0, 1)]
            elif motion.pushed:
                rows.append((0.0, p.friction_scatter, {at + 4: 1.0}))
            if motion.ends:
                lasts, factor = self.slides.get(k, (p.slide_s, p.slide_factor))
                rows.append((np.log(lasts), factor, {at + 6: 1.0}))
            if motion.rolls:
                rows.append((0.0, p.loss_scatter, {last: 1.0, 6: -1.0}))
        return rows

    def _before(self, k: int) -> int:
        """Find the stretch of the same body before the contact."""
        return next(i for i, s in enumerate(self.stretches) if s.ball == self.stretches[k].ball and not s.after)

    def _add_distance(self, x: Floats, known: Floats, by: Floats) -> None:
        """Add the residual and the derivatives of the distance at which the bodies touch."""
        gap, error = x[1:3] - x[3:5], self.priors.distance_share * self.priors.diameter
        apart = max(float(np.hypot(*gap)), 1e-12)
        known[0] = (apart - self.priors.diameter) / error
        by[0, 1:3], by[0, 3:5] = gap / apart / error, -gap / apart / error

    def _add_friction_direction(self, x: Floats, k: int, known: Floats, by: Floats, row: int) -> None:
        """Add the residual and the derivatives of the direction of friction.

        A ball that rolled or rested is brought back towards its velocity before the hit, but for what the rub of the
        bodies adds to its spin. That of a ball that slid is all but unknown.
        """
        before = self._before(k)
        at, from_ = self.start[k], self.start[before]
        moved = self.motions[before].moves
        old = x[from_ + 2 : from_ + 4] if moved else np.zeros(2)
        way = old - x[at + 2 : at + 4]
        size = max(float(np.hypot(*way)), 1e-9)
        share = (float(np.hypot(*old)) + float(np.hypot(*x[at + 2 : at + 4]))) / size
        error = float(np.hypot(0.1 * share, np.pi / np.sqrt(3) if self.motions[before].pushed else self.priors.turn))
        known[row] = ((x[at + 5] - np.arctan2(way[1], way[0]) + np.pi) % (2 * np.pi) - np.pi) / error
        turn = np.array([-way[1], way[0]]) / size**2 / error
        by[row, at + 5], by[row, at + 2 : at + 4] = 1 / error, turn
        if moved:
            by[row, from_ + 2 : from_ + 4] = -turn


@dataclass(frozen=True)
class LocalSolution:
    """The minimum of a problem.

    chi2 and dof are those of the positions that are not beside the contact. Their errors are smaller or larger than
    assumed, so that they say nothing about the size of the others.
    """

    problem: LocalProblem
    x: Floats
    cov: Floats
    sizes: tuple[float, ...]  # of the errors of each stretch, over the claimed ones
    residual: Floats  # (2n,) of all positions
    freedom: Floats  # (2n,) degrees of freedom of each residual
    cost: float  # chi^2 with what is known
    cost_of_known: float
    log_volume: float  # logarithm of the volume of the errors: half that of the determinant of cov

    @property
    def chi2(self) -> float:
        """Sum of squared residuals."""
        return float((self.residual[self.problem.counted] ** 2).sum())

    @property
    def dof(self) -> float:
        """Degrees of freedom."""
        return max(float(self.freedom[self.problem.counted].sum()), 0.5)

    @property
    def is_good(self) -> bool:
        """True if chi^2 is what the claimed errors make it, and nothing known is far off."""
        usual = abs(self.chi2 - self.dof) < 3 * float(np.sqrt(2 * self.dof))
        return usual and self.cost_of_known < 15

    @property
    def log_evidence(self) -> float:
        """Logarithm of the probability of the positions by the motions of the problem, but for a constant."""
        return self.log_volume - self.cost / 2 - self.problem.log_width

    @property
    def cost_with_price(self) -> float:
        """Cost with a price for each parameter that the positions determine, by which problems are compared."""
        n = len(self.residual)
        return self.cost + (n - float(self.freedom.sum())) * float(np.log(max(n, 2)))


def solve(
    problem: LocalProblem,
    x: Floats,
    sizes: Sequence[float],
    steps: int = 40,
    hopeless: float = np.inf,
    gain_at_end: float = 1e-4,
) -> LocalSolution:
    """Descend to the minimum by damped Gauss-Newton steps (Levenberg and Marquardt).

    hopeless: the cost above which the descent ends after two steps, because nothing needs so poor a solution.
    """
    damping, (r, j) = 1e-3, problem.residuals(x, sizes)
    cost = float(r @ r)
    for turn in range(steps):
        square, pull = j.T @ j, j.T @ r
        scale = np.diag(square)
        while True:
            step = -np.linalg.solve(square + damping * np.diag(scale + 1e-12), pull)
            tried = _within_reach(problem, x, np.asarray(step, dtype=np.float64))
            new_r, new_j = problem.residuals(tried, sizes)
            new = float(new_r @ new_r)
            if new <= cost or damping > 1e8:
                break
            damping *= 8
        gain, x = cost - new, tried if new <= cost else x
        if not new <= cost:
            break
        r, j, cost, damping = new_r, new_j, new, damping / 5
        if gain < gain_at_end * (1 + 1e-3 * cost) or (turn and cost > hopeless):
            break
    n = 2 * sum(map(len, problem.stretches))
    size = np.sqrt(np.maximum((j**2).sum(axis=0), 1e-300))
    square = (j / size).T @ (j / size)
    cov = np.linalg.pinv(square, rcond=1e-13, hermitian=True) / np.outer(size, size)
    freedom = 1 - ((j[:n] @ cov) * j[:n]).sum(axis=1)
    free = (j == 0).all(axis=0)  # the direction of a slide that no position shows: any
    volume = -float(np.linalg.slogdet(square + np.diag(1.0 * free))[1] / 2 + np.log(np.where(free, 0.55, size)).sum())
    return LocalSolution(problem, x, cov, tuple(sizes), r[:n], freedom, cost, float(r[n:] @ r[n:]), volume)


def _within_reach(problem: LocalProblem, x: Floats, step: Floats) -> Floats:
    """A step whose logarithms change by at most one."""
    out = x + step
    taus = [problem.start[k] + 6 for k, motion in enumerate(problem.motions) if motion.ends]
    logs = [5, *taus, *(problem.start[k] + 4 for k in range(len(problem.motions)) if problem.rubs(k))]
    out[logs] = np.clip(out[logs], x[logs] - 1, x[logs] + 1)
    out[taus] = np.clip(out[taus], np.log(1e-4), np.log(1e2))
    return out


# --- starts ---


@dataclass(frozen=True)
class StretchFit:
    """A fit of one stretch alone: its parameters, with the place at the contact."""

    values: Floats
    chi2: float  # by the claimed errors, with those that last, of the positions that are not beside the contact
    dof: float  # degrees of freedom of chi2


def fit_single_stretch(stretch: Stretch, contact: float, motion: MotionKind, zooms: int = 3) -> StretchFit:
    """Fit one stretch alone, by linear fits over a few durations of the slide, and again about the best of them."""
    span = float(np.abs(stretch.time - contact).max())
    taus = np.geomspace(span / 40, 1.5 * span, 12)
    costs, fits, left = _fit_each(stretch, contact, motion, taus)
    best = int(np.argmin(costs))
    for _ in range(zooms if motion.ends else 0):
        taus = np.geomspace(taus[max(best - 1, 0)], taus[min(best + 1, len(taus) - 1)], 7)
        costs, fits, left = _fit_each(stretch, contact, motion, taus)
        best = int(np.argmin(costs))
    out, plain = np.zeros(motion.size), fits.shape[1] - motion.rolls
    out[: 2 * plain] = fits[best, :plain].ravel()
    if motion.ends:
        out[6] = np.log(taus[best])
    if motion.rolls:
        out[-1] = 0.05
    counted = ~stretch.near
    chi2 = float((stretch.far.whiten(left[best][counted]) ** 2).sum()) if counted.any() else 0.0
    return StretchFit(out, chi2, max(2 * int(counted.sum()) - motion.size, 1))


def _fit_each(stretch: Stretch, contact: float, motion: MotionKind, taus: Floats) -> tuple[Floats, Floats, Floats]:
    """Fit a stretch with each duration (m,) of its slide: costs (m,), values (m, k, 2) and residuals (m, n, 2), m."""
    since = stretch.time - contact
    weight = 1 / stretch.std
    ahead = np.abs(since)
    far = np.maximum(ahead - taus[:, None], 0.0) ** 2 / 2 if motion.ends else np.zeros((1, len(since)))
    curve = far if motion.ends and not stretch.after else ahead**2 / 2 - far
    columns = [np.ones_like(curve)]
    if motion.moves:
        columns.append(np.broadcast_to(since, curve.shape))
    widths = [0.0] * len(columns)
    if motion.pushed:
        columns.append(curve)
        widths.append(2.0)  # m/s^2
    if motion.rolls:
        columns.append(ahead**2 / 2 - curve if motion.pushed else ahead**2 / 2 + 0 * far)
        widths.append(0.1)  # m/s^2
    basis = np.stack(columns, -1) * weight[:, None]
    square = np.swapaxes(basis, 1, 2) @ basis
    for k, width in enumerate(widths):
        if width > 0:
            square[:, k, k] += 1 / width**2 + 1e-9 * square[:, k, k]
    seen = stretch.position * weight[:, None]
    fits = np.linalg.solve(square, np.swapaxes(basis, 1, 2) @ seen)
    left = seen - basis @ fits
    known = sum((fits[:, k] ** 2).sum(axis=1) / width**2 for k, width in enumerate(widths) if width > 0)
    return np.asarray((left**2).sum(axis=(1, 2)) + known), np.asarray(fits), left / weight[:, None]


def correlation_factor(left: Floats) -> float:
    """Factor on the variances of a fit whose residuals (n, 2) are correlated from one position to the next."""
    if len(left) < 6:
        return 1.0
    rho = float((left[1:] * left[:-1]).sum() / max(float((left**2).sum()), 1e-300))
    rho = min(max(rho + 2 / len(left), 0.0), 0.9)  # residuals of a fit are less correlated than the errors
    return (1 + rho) / (1 - rho)


def choose_window(stretch: Stretch, contact: float, motions: Sequence[MotionKind], least: int = 5) -> Stretch:
    """Shorten a stretch to the longest window in which the residuals are at most MAX_RESIDUAL errors.

    Any force that the motions lack raises the residuals of a window that shows it. The rule does not look at the error
    of the velocity, because the smallest of several uncertain errors is too small. Where no window is so good, the
    errors are larger than claimed, as of films with loss: the best of the windows then shows how large they are.
    """
    ahead, tried = np.abs(stretch.time - contact), list[tuple[Stretch, float]]()
    for share in (1.0, 0.63, 0.4, 0.25, 0.16, 0.1):
        keep = ahead <= share * float(ahead.max(initial=0.0)) * 1.0001
        if int(keep.sum()) < min(least, len(stretch)):
            break
        window = stretch.where(keep)
        fits = (fit_single_stretch(window, contact, m) for m in motions if 2 * len(window) > m.size)
        tried.append((window, min((fit.chi2 / fit.dof for fit in fits), default=np.inf)))
        if tried[-1][1] <= MAX_RESIDUAL**2:
            return window
    best = min((misfit for _, misfit in tried), default=np.inf)
    return next((window for window, misfit in tried if misfit <= MAX_RESIDUAL**2 * best), stretch)


def guess_contact(stretches: Sequence[Stretch], contact: float) -> float:
    """Guess the instant at which straight lines before and after the contact meet best."""
    shift, turn = np.zeros(2), np.zeros(2)
    top = bottom = 0.0
    for ball in (1, 2):
        lines = {s.after: _line(s, contact) for s in stretches if s.ball == ball}
        if len(lines) < 2:
            continue
        shift, turn = lines[True][0] - lines[False][0], lines[True][1] - lines[False][1]
        top, bottom = top - float(turn @ shift), bottom + float(turn @ turn)
    return contact + (top / bottom if bottom > 0 else 0.0)


def _line(stretch: Stretch, contact: float, most: int = 6) -> tuple[Floats, Floats]:
    rows = slice(0, most) if stretch.after else slice(-most, None)
    t, x = stretch.time[rows] - contact, stretch.position[rows]
    if len(t) < 2 or np.ptp(t) == 0:
        return x.mean(axis=0), np.zeros(2)
    v = (t - t.mean()) @ x / float(((t - t.mean()) ** 2).sum())
    return x.mean(axis=0) - v * t.mean(), v


def list_motions(stretches: Sequence[Stretch], rests: bool, glide: bool) -> Iterator[tuple[MotionKind, ...]]:
    """List the motions that the stretches may have, on air (glide) or on a plate."""
    choices: list[tuple[MotionKind, ...]] = []
    for s in stretches:
        if s.ball == 1 and not s.after and rests:
            choices.append((REST,))
        elif glide:
            choices.append((SLIDE,))
        elif s.after:
            choices.append((SLIDE_AND_ROLL,))
        else:
            choices.append((ROLL, SLIDE_AND_ROLL, SLIDE) if s.ball == 2 else (ROLL,))
    yield from product(*choices)


def fit_motions(
    stretches: Sequence[Stretch], contact: float, rests: bool, glides: Sequence[bool], priors: LocalPriors
) -> list[LocalSolution]:
    """Fit the motions that the stretches may have, the simplest first, until one describes the positions.

    That one is returned alone. If none does, all are returned, and first the one of the smallest cost with its price.
    """
    found: list[LocalSolution] = []
    for glide in glides:
        for motions in list_motions(stretches, rests, glide):
            problem = LocalProblem(tuple(stretches), motions, priors, glide)
            x = np.zeros(problem.size)
            x[0], x[5], x[6] = contact, np.log(priors.friction), priors.loss
            places: dict[int, list[Floats]] = {1: [], 2: []}
            for k, (s, motion) in enumerate(zip(stretches, motions, strict=True)):
                own = fit_single_stretch(s, contact, motion).values
                if problem.slides_first(k):
                    own[2:4] += own[4:6] * min(float(np.exp(own[6])), problem.spans[k])
                if problem.rubs(k):
                    own[4:6] = 0.0, np.arctan2(own[5], own[4])
                x[problem.start[k] : problem.start[k + 1]] = own
                places[s.ball].append(own[:2])
            for ball, own_places in places.items():
                x[2 * ball - 1 : 2 * ball + 1] = np.mean(own_places, axis=0)
            for k in range(len(stretches)):
                x[problem.start[k] : problem.start[k] + 2] -= x[problem.place(k)]
            found.append(_try_other_starts(solve(problem, x, [1.0] * len(stretches))))
            if found[-1].is_good:  # the simplest come first
                return found[-1:]
    noise = max(1.0, min(s.chi2 / s.dof for s in found))
    return sorted(found, key=lambda s: s.cost / noise + s.cost_with_price - s.cost)


def _try_other_starts(solution: LocalSolution) -> LocalSolution:
    """Solve again from other durations of the roll before the contact, if the solution is a poor one; the best of all.

    A long roll with a large loss looks like a slide, so that there may be several minima.
    """
    problem, tries = solution.problem, [solution]
    for k, motion in enumerate(problem.motions):
        if motion.ends and not problem.stretches[k].after and not solution.is_good:
            for share in (0.2, 0.5, 0.8):
                x = solution.x.copy()
                x[problem.start[k] + 6], x[problem.start[k + 1] - 1] = np.log(share * problem.spans[k]), x[6]
                tries.append(solve(problem, x, solution.sizes, steps=15))
    return min(tries, key=lambda one: one.cost)


def weigh_by_residuals(found: Sequence[LocalSolution], known: bool, shared: float = 8.0) -> list[LocalSolution]:
    """Solve all again with errors as large and as lasting as the residuals of each stretch of the first; best first.

    known: errors are claimed, and are never smaller than that. shared: degrees of freedom with which the mean of all
    stretches counts in each. A body at rest takes the mean, because recorders round or drop its positions.
    """
    solution = found[0]
    if known and solution.is_good:
        return [solution]
    problem = solution.problem
    ends = 2 * np.cumsum([len(s) for s in problem.stretches])[:-1]
    parts = zip(*(np.split(v, ends) for v in (solution.residual, solution.freedom, problem.counted)), strict=True)
    squares, freedom, lasting = {}, {}, {}
    for k, (left, free, counted) in enumerate(parts):
        if problem.motions[k].moves:
            squares[k] = float((left[counted] ** 2).sum())
            freedom[k] = max(float(free[counted].sum()), 0.5)
            lasting[k] = correlation_factor(left[counted].reshape(-1, 2))
    total = sum(freedom.values())
    mean = sum(squares.values()) / total
    usual = sum(freedom[k] * factor for k, factor in lasting.items()) / total
    sizes = []
    for k, size in enumerate(solution.sizes):
        square, factor = mean, usual
        if k in squares:
            own = freedom[k] / (freedom[k] + shared)
            square = (squares[k] + shared * mean) / (freedom[k] + shared)
            factor = own * lasting[k] + (1 - own) * usual
        square *= factor
        sizes.append(size * float(np.sqrt(max(square, 1.0 if known else 1e-12))))
    again = [solve(one.problem, one.x, sizes) for one in found]
    return sorted(again, key=lambda s: -s.log_evidence)


def shows_end(solution: LocalSolution, k: int, *, least_positions: int = 4, least_sigma: float = 10.0) -> bool:
    """Decide whether the positions show when the slide of a stretch ends.

    The part next to the contact holds `least_positions`. If the slide filled the stretch, one end of it would be off
    by `least_sigma` of its errors. The duration is known to a fifth.
    """
    problem, stretch, at = solution.problem, solution.problem.stretches[k], solution.problem.start[k]
    tau = float(np.exp(solution.x[at + 6]))
    since = np.abs(stretch.time - solution.x[0])
    rolls_s = float(since.max()) - tau if stretch.after else min(tau, float(since.max()))
    off = float(np.hypot(*problem.values(solution.x, k)[4:6])) * max(rolls_s, 0.0) ** 2 / 2
    error = float(np.median(stretch.std)) * solution.sizes[k]
    held = int((~stretch.near & (since < tau)).sum())
    return held >= least_positions and off > least_sigma * error and bool(solution.cov[at + 6, at + 6] < 0.2**2)


def mix_solutions(
    found: Sequence[LocalSolution],
    *,
    shifts: Sequence[float] = (0.1, 0.3, 1.0),
    durations: int = 6,
    least_weight: float = 0.05,
) -> list[tuple[float, LocalSolution]]:
    """Weigh the motions that the stretches may have by their evidence, each with all durations of its slides.

    A fit of the duration of a slide has no error to rely on where the positions do not show its end. While the slide
    outlasts the stretch, nothing depends on it; as soon as it ends earlier, all does. So such a slide gets each
    duration in turn, with its evidence times its prior. Before a contact that is the duration of rolling. The distance
    by which a body may be elsewhere after the contact gets each of `shifts` in turn, over the prior one.
    """
    best = max(one.log_evidence for one in found)
    mixture = list[tuple[float, LocalSolution]]()
    for one in found:
        if one.log_evidence < best - 7:  # its slides may fit better with another duration
            continue
        parts = _drop_unlikely([(0.0, _solve_with_shift(one, share)) for share in shifts], least_weight)
        usual = one.problem.priors.shift_share
        shifts = [each.problem.priors.shift_share / usual for _, each in parts]  # the next motions have the same
        for k, motion in enumerate(one.problem.motions):
            if motion.ends and not shows_end(one, k):
                parts = _drop_unlikely(_vary_each_slide(parts, k, durations, least_weight), least_weight)
        mixture += parts
    mixture = _drop_unlikely(mixture, least_weight)
    weights = np.exp([_log_weight(part) - _log_weight(mixture[0]) for part in mixture])
    return [(float(w), one) for w, (_, one) in zip(weights / weights.sum(), mixture, strict=True)]


def _solve_with_shift(solution: LocalSolution, share: float) -> LocalSolution:
    """Solve again with another distance by which a body may be elsewhere after the contact."""
    priors = solution.problem.priors
    problem = replace(solution.problem, priors=replace(priors, shift_share=share * priors.shift_share))
    return solve(problem, solution.x, solution.sizes, steps=8)


def _log_weight(part: tuple[float, LocalSolution]) -> float:
    """Logarithm of the prior of a solution and of its evidence."""
    return part[0] + part[1].log_evidence


def _drop_unlikely(parts: list[tuple[float, LocalSolution]], least: float) -> list[tuple[float, LocalSolution]]:
    """Sort solutions by their weights, largest first; drop those below a share of the largest."""
    parts = sorted(parts, key=lambda part: -_log_weight(part))[:MAX_SOLUTIONS]
    return [part for part in parts if _log_weight(part) >= _log_weight(parts[0]) + np.log(least)]


def _vary_each_slide(
    parts: Sequence[tuple[float, LocalSolution]], k: int, durations: int, least: float, margin: float = 3.0
) -> list[tuple[float, LocalSolution]]:
    """Solve each solution, the likeliest first, with each duration of one slide.

    The others get only durations that are likely in the first, by `least` and a margin of the logarithm.
    """
    likely, out = range(durations + 2), list[tuple[float, LocalSolution]]()
    for log, each in parts:
        cells = {i: (log + more, one) for i, (more, one) in _vary_slide(each, k, durations, likely).items()}
        if not out:
            best = max(map(_log_weight, cells.values()))
            likely = [i for i, one in cells.items() if _log_weight(one) >= best + np.log(least) - margin]
        out += cells.values()
    return out


def _vary_slide(
    solution: LocalSolution, k: int, durations: int, likely: Container[int]
) -> dict[int, tuple[float, LocalSolution]]:
    """Solve with the likely durations of one slide, of all these: below the first position, cells, above the stretch.

    The logarithm of the prior of its cell comes with each.
    """
    problem, priors, stretch = solution.problem, solution.problem.priors, solution.problem.stretches[k]
    since = np.abs(stretch.time - solution.x[0])
    first, last = max(float(since.min()), 1e-5), float(since.max())
    edges = np.linspace(first, max(last, 1.01 * first), durations + 1)
    middles = np.concatenate([[first / 2], (edges[1:] + edges[:-1]) / 2, [1.5 * edges[-1]]])
    widths = np.concatenate([[0.3], np.diff(edges) / np.sqrt(12) / middles[1:-1], [0.1]])  # of the logarithms
    below = norm.cdf((np.log(edges) - np.log(priors.slide_s)) / priors.slide_factor)
    masses = np.diff(np.concatenate([[0.0], below, [1.0]]))
    motion, at, found = problem.motions[k], problem.start[k] + 6, dict[int, tuple[float, LocalSolution]]()
    fine = np.concatenate([middles, edges, np.linspace(0, middles[-1], 5 * durations)[1:]])
    costs = _fit_each(stretch, float(solution.x[0]), motion, fine)[0] / solution.sizes[k] ** 2
    cell = np.searchsorted(edges, fine)
    for i in range(len(middles)):
        if i not in likely or not (costs[cell == i] < costs.min() + MAX_COST).any():
            continue
        x = solution.x.copy()
        x[at] = np.log(middles[i])
        slides = {**problem.slides, k: (float(middles[i]), float(widths[i]))}
        hopeless = min((one.cost for _, one in found.values()), default=np.inf) + 1.5 * MAX_COST
        one = solve(replace(problem, slides=slides), x, solution.sizes, 8, hopeless, 3e-3)
        found[i] = float(np.log(max(masses[i], 1e-12))), one
    return found or {0: (0.0, solution)}
