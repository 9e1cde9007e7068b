"""Free stretches of tracks: a ball between two contacts slides, then rolls, and nothing else acts on it.

A stretch has a free start. Its acceleration is constant while it slides; then it loses speed evenly, along its own
direction. `FreeStretch` holds the residuals of this motion and what its own parameters can absorb.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from tracker.measurement.positions import BallTrack

Floats = NDArray[np.float64]
MIN_POSITIONS = 10  # of a stretch
MAX_SECONDS = 1.5  # longer ones are cut: spin, cloth and drag bend a path that lasts
MAX_GAP_FRAMES = 10
FRAMES_BESIDE_CONTACT = 1.5  # positions nearer to a contact or a kink do not count
NEAR_DIAMETERS = 1.15  # distance of centres at which another ball may be touched
MAX_CHI2 = 30.0  # per degree of freedom, of a stretch; one with more has a contact that was not seen
MAX_ACCELERATION = 3.5  # m/s^2, of a ball that slides; what changes the velocity faster is a contact
KINK_POSITIONS = 4  # to either side, from which a velocity is read
KINK_SIGMA = 6.0  # standard errors by which the velocity changes at a contact
REST_SIGMA = 5.0  # standard errors of a velocity within which a ball may rest
SLIDE_GAIN = 9.0  # reduction of chi^2 for which a stretch slides first
TIMES_OF_SLIDE = 6  # ends of the slide that are tried in a stretch
MIN_SCATTER_OF_LOSS, MIN_SCATTER_OF_SLIDE = 0.2, 0.04  # of the accelerations of rolling and sliding, relative
MIN_OF_PRIOR = 5  # stretches that show an acceleration


@dataclass(frozen=True)
class FrictionPrior:
    """Losses and accelerations that stretches of one set have in common, each with its scatter, m/s^2."""

    loss: float
    loss_std: float
    slide: float
    slide_std: float

    @staticmethod
    def of(stretches: Sequence[FreeStretch]) -> FrictionPrior:
        """Estimate them by medians over stretches; the scatter is at least a share of the value.

        A slide counts by the chi^2 that it explains: noise and a warp make weak ones.
        """
        rolling = [one for one in stretches if np.isfinite(one.loss)]
        sliding = [one for one in stretches if np.isfinite(one.slide)]
        losses, slides = np.array([one.loss for one in rolling]), np.array([one.slide for one in sliding])
        gains = np.array([one.gain for one in sliding])
        loss, loss_std = _median_and_scatter(losses, np.ones(len(losses)), MIN_SCATTER_OF_LOSS)
        slide, slide_std = _median_and_scatter(slides, gains, MIN_SCATTER_OF_SLIDE)
        return FrictionPrior(loss, loss_std, slide, slide_std)


def _median_and_scatter(values: Floats, weights: Floats, least: float) -> tuple[float, float]:
    """Weighted median, and weighted median distance from it as a standard deviation."""
    if len(values) < MIN_OF_PRIOR:
        return 0.0, float("inf")

    def median(of: Floats) -> float:
        order = np.argsort(of)
        return float(of[order][np.searchsorted(weights[order].cumsum(), weights.sum() / 2)])

    middle = median(values)
    return middle, max(1.4826 * median(np.abs(values - middle)), least * abs(middle), 1e-12)


@dataclass(frozen=True, eq=False)
class FreeStretch:
    """n positions of one ball, and the residuals of its free motion.

    time (n,) s; position (n, 2) m; std (n,) m. end: until when the ball slides, s from the first position. loss, slide:
    accelerations of rolling and sliding, m/s^2; NaN where there is none. gain: chi^2 that the slide explains.
    residual: position minus motion, x of all positions before y, then the distances from a prior, (2n + e,), in
    standard errors. absorbed (2n + e, p): orthonormal columns of what the motion can absorb.
    """

    time: Floats
    position: Floats
    std: Floats
    end: float
    loss: float
    slide: float
    gain: float
    residual: Floats
    absorbed: Floats

    @property
    def dof(self) -> int:
        """Degrees of freedom of the residuals."""
        return int(self.absorbed.shape[0] - self.absorbed.shape[1])

    @property
    def chi2(self) -> float:
        """Sum of squared residuals."""
        return float(self.residual @ self.residual)

    def project(self, columns: Floats) -> Floats:
        """Subtract from columns (2n, k), in standard errors, what the free motion absorbs: (2n + e, k)."""
        whole = np.concatenate([columns, np.zeros((len(self.residual) - len(columns), columns.shape[1]))])
        return np.asarray(whole - self.absorbed @ (self.absorbed.T @ whole))

    def fit_again(self, shift: Floats, prior: FrictionPrior | None = None) -> FreeStretch:
        """Fit the motion again, to positions that are shifted by (n, 2) m; the residuals stay those without the shift.

        To first order in the shift, such residuals do not depend on the shift but for what the motion can absorb.
        """
        fitted = fit_stretch(self.time, self.position + shift, self.std, prior)
        moved = fitted.project((shift / self.std[:, None]).T.reshape(-1, 1))[:, 0]
        return replace(fitted, position=self.position, residual=fitted.residual - moved)


def find_free_stretches(balls: Sequence[BallTrack], diameter: float) -> list[FreeStretch]:
    """Find and fit the free stretches of the balls of one recording; diameter: m, or NaN if unknown."""
    noise = measure_noise(balls)
    out = []
    for ball in balls:
        if len(ball) < MIN_POSITIONS or not np.isfinite(noise):
            continue
        near = np.array([*find_near_times(ball, balls, diameter)])
        changes = _measure_kinks(ball, noise)
        for rows in _cut(ball, near, changes, noise):
            out += _fit_parts(ball, rows, changes, noise)
    return out


def _fit_parts(ball: BallTrack, rows: NDArray[np.int64], changes: Floats, noise: float) -> list[FreeStretch]:
    """Fit the motion of these rows; if it does not describe them, cut them where the velocity changes most."""
    if len(rows) < MIN_POSITIONS:
        return []
    found = fit_stretch(ball.time[rows], ball.position[rows], np.full(len(rows), noise))
    if found.chi2 < MAX_CHI2 * found.dof or len(rows) < 2 * MIN_POSITIONS:
        return [found]
    inner = slice(KINK_POSITIONS, len(rows) - KINK_POSITIONS)
    middle = KINK_POSITIONS + int(np.argmax(changes[rows][inner]))
    parts = rows[: middle - 1], rows[middle + 1 :]
    return [one for part in parts for one in _fit_parts(ball, part, changes, noise)]


def measure_noise(balls: Sequence[BallTrack]) -> float:
    """Standard deviation of positions, m, from third differences, which smooth motion hardly has; NaN without any."""
    parts = [np.diff(ball.position, 3, axis=0)[np.diff(ball.frame, 3) == 0] for ball in balls if len(ball) > 3]
    moving = [part[np.abs(part).sum(axis=1) > 0] for part in parts]
    every = np.concatenate([*moving, np.empty((0, 2))])
    return float(1.4826 * np.median(np.abs(every)) / np.sqrt(20)) if len(every) else float("nan")


def find_near_times(ball: BallTrack, balls: Sequence[BallTrack], diameter: float) -> Iterator[float]:
    """Iterate over the times at which another ball is so near that it may touch this one."""
    for other in balls if np.isfinite(diameter) else ():
        if other is ball:
            continue
        _, mine, its = np.intersect1d(ball.frame, other.frame, return_indices=True)
        apart = np.hypot(*(ball.position[mine] - other.position[its]).T)
        step = np.abs(np.diff(apart, prepend=apart[:1]))
        yield from ball.time[mine][apart < NEAR_DIAMETERS * diameter + step].tolist()


def _measure_kinks(ball: BallTrack, noise: float) -> Floats:
    """Changes of the velocity before each position (n,), over those that friction and noise can make."""
    k, time, out = KINK_POSITIONS, ball.time, np.zeros(len(ball))
    for i in range(k, len(time) - k + 1):
        before, after = slice(i - k, i), slice(i, i + k)
        (v, s), (w, q) = (_velocity(time[part], ball.position[part]) for part in (before, after))
        between = time[after].mean() - time[before].mean()
        out[min(i, len(out) - 1)] = np.hypot(*(w - v)) / (
            MAX_ACCELERATION * between + KINK_SIGMA * noise * np.hypot(s, q)
        )
    return out


def _velocity(time: Floats, position: Floats) -> tuple[Floats, float]:
    """Velocity of a straight line, and its standard error per standard error of a position."""
    since = time - time.mean()
    spread = float(since @ since)
    return since @ position / spread, spread**-0.5


def _cut(ball: BallTrack, near: Floats, changes: Floats, noise: float) -> Iterator[NDArray[np.int64]]:
    """Iterate over the rows of the stretches between contacts, gaps and rests."""
    time, frame_time = ball.time, float(np.median(np.diff(ball.time)))
    kinks = np.flatnonzero((changes > 1) & (changes == maximum_filter1d(changes, 2 * KINK_POSITIONS - 1)))
    contacts = np.append(near, (time[kinks - 1] + time[kinks]) / 2)
    free = np.ones(len(time), dtype=bool)
    for at in contacts:
        free &= np.abs(time - at) > FRAMES_BESIDE_CONTACT * frame_time
    cuts = np.flatnonzero(~free[1:] | ~free[:-1] | (np.diff(ball.frame) > MAX_GAP_FRAMES)) + 1
    for part in np.split(np.arange(len(time)), cuts):
        if len(part) < MIN_POSITIONS or not free[part].all():
            continue
        pieces = max(int(np.ceil((time[part[-1]] - time[part[0]]) / MAX_SECONDS)), 1)
        for rows in np.array_split(part, pieces):
            if len(rows) < MIN_POSITIONS:
                continue
            velocity, error = _velocity(time[rows], ball.position[rows])
            if np.hypot(*velocity) > REST_SIGMA * noise * error:
                yield rows


def fit_stretch(time: Floats, position: Floats, std: Floats, prior: FrictionPrior | None = None) -> FreeStretch:
    """Fit a motion that rolls all along, and one that slides first; take the latter if it is much better."""
    duration = float(time[-1] - time[0])
    rolling = _fit(time, position, std, 0.0, prior)
    tried = [duration * (k + 1) / TIMES_OF_SLIDE for k in range(TIMES_OF_SLIDE)]
    first = min(tried, key=lambda end: _fit(time, position, std, end, steps=1).chi2)
    sliding = _fit(time, position, std, first, prior)
    gain = rolling.chi2 - sliding.chi2
    return replace(sliding, gain=gain) if gain > SLIDE_GAIN else rolling


def _fit(
    time: Floats, position: Floats, std: Floats, end: float, prior: FrictionPrior | None = None, steps: int = 6
) -> FreeStretch:
    """Fit the motion that slides until about `end`, s, and then rolls; with one step, exactly until then."""
    n, since = len(time), time - time[0]
    weight, target, loss = np.tile(1 / std, 2)[:, None], position.T.ravel(), 0.0
    acceleration: Floats = np.zeros(2)
    along, slides = _unit(_velocity(since, position)[0]), end > 0
    for step in range(steps):
        late = np.maximum(since - end, 0.0)
        rolls, turns = bool(late[-1] > 0), bool(late[-1] > 0) and slides and step > 0
        shapes = [np.ones(n), since]
        if slides:
            shapes.append(np.where(late > 0, end * (since - end / 2), since**2 / 2))
        columns = [np.outer(axis, shape).ravel() for shape in shapes for axis in np.eye(2)]
        if turns:  # another end of the slide
            columns.append(np.outer(acceleration + loss * along, late).ravel())
        if rolls:
            columns.append(-np.outer(along, late**2 / 2).ravel())
        rows, aims = np.column_stack(columns) * weight, target * weight[:, 0]
        if prior is not None:
            pulls = _pull(prior, rows.shape[1], rolls, _unit(acceleration) if slides and step > 0 else None)
            rows, aims = np.concatenate([rows, *(row for row, _ in pulls)]), np.append(aims, [aim for _, aim in pulls])
        solution = np.linalg.lstsq(rows, aims, rcond=None)[0]
        loss = float(solution[-1]) if rolls else 0.0
        if slides:
            acceleration = np.asarray(solution[4:6], dtype=np.float64)
        if turns and step < steps - 1:
            end = float(np.clip(end + solution[6], 0.3 * end, since[-1]))
        before, along = along, _unit(solution[2:4] + acceleration * end)  # in which it rolls on
        if turns and abs(solution[6]) < 1e-4 * since[-1] and np.abs(along - before).max() < 1e-6:
            break
    return FreeStretch(
        time=time,
        position=position,
        std=std,
        end=end,
        loss=loss if rolls else float("nan"),
        slide=float(np.hypot(*acceleration)) if slides else float("nan"),
        gain=0.0,
        residual=np.asarray(aims - rows @ solution),
        absorbed=np.linalg.qr(rows)[0],
    )


def _pull(prior: FrictionPrior, size: int, rolls: bool, along: Floats | None) -> list[tuple[Floats, float]]:
    """Rows (1, size) and aims that draw the loss, and the acceleration along its own direction, to the prior."""
    out = []
    if rolls:
        row = np.zeros((1, size))
        row[0, -1] = 1 / prior.loss_std
        out.append((row, prior.loss / prior.loss_std))
    if along is not None:
        row = np.zeros((1, size))
        row[0, 4:6] = along / prior.slide_std
        out.append((row, prior.slide / prior.slide_std))
    return out


def _unit(vector: Floats) -> Floats:
    return np.asarray(vector / max(float(np.hypot(*vector)), 1e-300))
