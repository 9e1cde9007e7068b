"""The friction of the plate by the free paths of a film: balls slide with a constant acceleration, and then roll.

No contact is needed. The acceleration of a slide is mu_k g, whatever its direction and duration. Each path gives the
likelihood of each friction, as a mean over these.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import i0e, logsumexp

from synthcam_shared.arrays import Array
from tracker.gas.free_paths import FreePath
from tracker.measurement.collision.collision_model import GRAVITY
from tracker.measurement.positions import BallTrack

MIN_POSITIONS = 10  # of a path
MAX_POSITIONS = 120  # the first ones of a longer path: later the loss of a rolling ball changes with its speed
MIN_PATHS = 3  # that show the friction
MIN_LOG_RATIO = 2.0  # of the likelihoods of frictions, of a path that shows it
MAX_LOG_RATIO = 30.0  # of the chances of two ends of a slide that count
MAX_DECEL_ERROR = 0.11  # of a slide as long as its path, over mu_k g; the prior of its end draws less certain ones
MAX_ERROR = 0.1  # relative, of a friction that is reported
MAX_SIGMA = 3.0  # by which the residuals of a path may exceed the noise
MISSED_SHARE = 0.05  # of the paths, on which something else happens, such as a contact that is not found
ROLLING_LOSS = 0.1  # m/s^2, rms of a component of the loss of rolling, in a film that does not show it
LEAST_NOISE = 1e-7  # m; tracks of a simulation may have none
FRICTIONS = np.geomspace(0.03, 0.9, 200)  # first, then more narrowly; with 100 an error may be a tenth too small


def measure_sliding_friction(
    balls: Sequence[BallTrack], paths: Sequence[FreePath], noise: float, rolling: Mapping[str, float] | None = None
) -> dict[str, float]:
    """Measure the friction of the plate by all free paths of balls that slide and roll.

    It is the mean of the likely ones, if `MISSED_SHARE` of the paths say nothing about it, because more happens there.
    The paths count as independent. The standard error is the larger of two: by the width of the likelihood, and by the
    scatter of its slopes from path to path. The latter allows for a friction that differs from path to path.

    Parameters
    ----------
    balls : sequence of BallTrack
        The tracks, in m.
    paths : sequence of FreePath
        Of these balls.
    noise : float
        Standard deviation of a coordinate, m.
    rolling : mapping, optional
        What the film shows of the loss of rolling, from `measure_rolling_loss`; NaN where it shows nothing.

    Returns
    -------
    dict
        mu_k and mu_k_std; NaN if fewer than `MIN_PATHS` show it, or if its error is above `MAX_ERROR`.
    """
    noise = max(noise, LEAST_NOISE)
    tracks, shows = {ball.particle: ball for ball in balls}, list[_PathLikelihood]()
    for path in paths:
        ball = tracks[path.ball]
        free = (path.time >= path.free_from) & (path.time <= path.rolls_until)
        rows = np.searchsorted(ball.frame, path.frame[free])[:MAX_POSITIONS]
        if len(rows) >= MIN_POSITIONS:
            time, position = ball.time[rows], ball.position[rows]
            own = _PathLikelihood.of(time, position, noise, _expect_loss(time, position, rolling or {}))
            shows += [] if own is None or own.ratio < MIN_LOG_RATIO else [own]
    while len(shows) >= MIN_PATHS:
        value, error = _combine(shows)
        certain = [own for own in shows if own.decel_error <= MAX_DECEL_ERROR * value * GRAVITY]
        if len(certain) == len(shows) and error < MAX_ERROR:
            return {"mu_k": value, "mu_k_std": error * value}
        if len(certain) == len(shows):
            break
        shows = certain
    return {"mu_k": float("nan"), "mu_k_std": float("nan")}


def _expect_loss(time: Array, position: Array, rolling: Mapping[str, float]) -> float:
    """Expect the loss of a path that rolls: the rms of a component, m/s^2. rolling: the law of the film, or none."""
    names = ("rolling_speed", "rolling_loss", "rolling_drag", "rolling_loss_std", "rolling_drag_std")
    middle, loss, drag, loss_std, drag_std = (rolling.get(name, np.nan) for name in names)
    faster = float(np.hypot(*(position[-1] - position[0])) / (time[-1] - time[0])) - middle
    if np.isfinite(drag):
        loss, loss_std = loss + drag * faster, np.hypot(loss_std, drag_std * faster)
    size = float(np.hypot(loss, loss_std) / np.sqrt(2))
    return size if np.isfinite(size) else ROLLING_LOSS


def _combine(shows: Sequence[_PathLikelihood]) -> tuple[float, float]:
    """Combine paths: the mean of the likely frictions, and its relative standard error."""
    tried, every = FRICTIONS, np.array([own.weigh(own.first) for own in shows])
    for _ in range(5):  # each time nearer to what is likely, until the steps are far smaller than the error
        log = np.log(tried)
        chance = np.exp((total := every.sum(axis=0)) - total.max())
        middle = float(chance @ log / chance.sum())
        width, step = float(np.sqrt(chance @ (log - middle) ** 2 / chance.sum())), float(log[1] - log[0])
        if width > 3 * step:
            break
        tried = np.exp(middle + 6 * max(width, step) * np.linspace(-1, 1, 61))
        every = np.array([own.weigh(own.find_log(tried)) for own in shows])
    slopes = np.array([np.interp(middle + width, log, own) - np.interp(middle - width, log, own) for own in every])
    return float(np.exp(middle)), width * max(1.0, float(np.sqrt((slopes**2).sum())) / 2)


@dataclass(frozen=True, eq=False)
class _PathLikelihood:
    """The likelihood of the friction by one path, for each end of its slide.

    found, error (n,): acceleration by the slide and its standard error, m/s^2. log_chance (n,): of the end, without
    what the friction changes. first: logarithms of the likelihoods of `FRICTIONS`. total: that of a friction that is
    equally likely in its logarithm. ratio: the largest over the smallest of `first`, as a logarithm.
    decel_error: standard error of the acceleration of a slide that lasts for the whole path, m/s^2.
    """

    found: Array
    error: Array
    log_chance: Array
    first: Array = field(default_factory=lambda: np.empty(0))
    total: float = 0.0
    ratio: float = 0.0
    decel_error: float = 0.0

    @staticmethod
    def of(time: Array, position: Array, noise: float, loss: float) -> _PathLikelihood | None:
        """Fit a path, times (n,) s and positions (n, 2) m, by each end of its slide; None if none fits, or shows it.

        Its end is equally likely in its logarithm. Ends lie nearer to one another where the likelihood changes fast.
        """
        first_ends, halvings, max_change = 40, 8, 1.0
        since, where = time - time[0], (position - position.mean(axis=0)) / noise
        ends = np.geomspace(since[-1] / (2 * len(time)), 3 * since[-1], first_ends)
        fits = fit_ends(since, where, ends, noise, loss)
        decel_error = float(fits[-1][-1])
        if decel_error > MAX_DECEL_ERROR * FRICTIONS[-1] * GRAVITY:
            return None
        for _ in range(halvings):
            chi2, volume, found, error = fits
            log = -chi2 / 2 - volume
            likely = log > log.max() - MAX_LOG_RATIO
            change = np.maximum(np.abs(np.diff(log)), np.abs(np.diff(found)) / np.minimum(error[1:], error[:-1]))
            beside = np.maximum(np.append(change[1:], 0.0), np.append(0.0, change[:-1])) / 2  # a peak may lie between
            wide = np.flatnonzero((likely[1:] | likely[:-1]) & (np.maximum(change, beside) > max_change))
            if not len(wide):
                break
            added = np.sqrt(ends[wide] * ends[wide + 1])
            new = fit_ends(since, where, added, noise, loss)
            fits = [np.insert(old, wide + 1, more) for old, more in zip(fits, new, strict=True)]
            ends = np.insert(ends, wide + 1, added)
        (chi2, volume, found, error), dof = fits, 2 * len(time) - 7
        if chi2.min() > dof + MAX_SIGMA * np.sqrt(2 * dof):
            return None
        log_chance = np.log(np.gradient(np.log(ends))) - chi2 / 2 - volume
        may = log_chance > log_chance.max() - MAX_LOG_RATIO
        own = _PathLikelihood(found[may], error[may], log_chance[may])
        first = own.find_log(FRICTIONS)
        total, ratio = float(logsumexp(first) - np.log(len(first))), float(np.ptp(first))
        return replace(own, first=first, total=total, ratio=ratio, decel_error=decel_error)

    def find_log(self, frictions: Array) -> Array:
        """Find the logarithm of the likelihood of each friction (k,), as a mean over ends and directions."""
        decel, variance = frictions * GRAVITY, self.error[:, None] ** 2
        off = (decel - self.found[:, None]) ** 2 / (2 * variance)
        sharp, ratio = 1e6, decel * self.found[:, None] / variance  # beyond it the Bessel function has its limit
        limit = -np.log(2 * np.pi * np.maximum(ratio, sharp)) / 2
        any_direction = np.where(ratio < sharp, np.log(i0e(np.minimum(ratio, sharp))), limit)
        return np.asarray(logsumexp(self.log_chance[:, None] + any_direction - off, axis=0))

    def weigh(self, log: Array) -> Array:
        """Weigh frictions by the logarithms (k,) of their likelihoods; allow for a path that seems to show any."""
        return np.asarray(np.logaddexp(np.log1p(-MISSED_SHARE) + log - self.total, np.log(MISSED_SHARE)))


def fit_ends(since: Array, where: Array, ends: Array, noise: float, loss: float) -> list[Array]:
    """Fit a slide and a roll to a path for each end (k,) of the slide, s.

    Position, velocity, loss of rolling, and acceleration of the slide may be any.

    since (n,): s since the first position. where (n, 2): positions over the noise, m. loss: rms of a component of the
    loss of rolling, m/s^2.

    Returns chi^2; the logarithm of the volume that all but the acceleration fill, up to a constant; the size of the
    acceleration and its standard error, m/s^2: (k,) each.
    """
    slid, rolled = np.minimum(since, ends[:, None]), np.maximum(since - ends[:, None], 0.0)
    columns = np.broadcast_arrays(1.0, since, rolled**2 / 2, slid * (since - slid / 2))
    design = np.stack(columns, axis=-1) / noise  # (k, n, 4)
    square = np.swapaxes(design, 1, 2) @ design
    square[:, 2, 2] += 1 / loss**2
    size = np.sqrt(np.einsum("kii->ki", square))  # units in which the equations are well conditioned
    square /= size[:, :, None] * size[:, None, :]
    pull = np.swapaxes(design, 1, 2) @ where / size[:, :, None]
    inverse = np.linalg.inv(square)
    value = inverse @ pull
    value += inverse @ (pull - square @ value)  # once more, because the terms are nearly proportional
    chi2 = (where**2).sum() - (value * pull).sum(axis=(1, 2))
    volume = np.linalg.slogdet(square[:, :3, :3])[1] + 2 * np.log(size[:, :3]).sum(axis=1)
    return [chi2, volume, np.hypot(*value[:, 3].T) / size[:, 3], np.sqrt(inverse[:, 3, 3]) / size[:, 3]]
