"""The friction of the plate by the free paths of a film: balls slide with a constant acceleration, and then roll.

No contact is needed. The acceleration of a slide is mu_k g, whatever its direction and duration. Each path gives the
likelihood of each friction, as a mean over these.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ive, logsumexp

from synthcam_shared.arrays import Array
from tracker.gas.free_paths import FreePath
from tracker.measurement.collision.collision_model import GRAVITY
from tracker.measurement.positions import BallTrack

MIN_POSITIONS = 10  # of a path
MAX_POSITIONS = 120  # the first ones of a longer path: later the loss of a rolling ball changes with its speed
MIN_PATHS = 3  # that show the friction
MIN_LOG_RATIO = 2.0  # of the likelihoods of frictions, of a path that shows it
MAX_LOG_RATIO = 30.0  # of the chances of two ends of a slide that count
MAX_DECEL_ERROR = 0.25  # m/s^2, of a slide that lasts for the whole path; the prior of its end draws less certain ones
MAX_ERROR = 0.1  # relative, of a friction that is reported
MAX_SIGMA = 3.0  # by which the residuals of a path may exceed the noise
MISSED_SHARE = 0.05  # of the paths, on which something else happens, such as a contact that is not found
ROLLING_LOSS = 0.1  # m/s^2, rms of a component of the acceleration of a ball that rolls
LEAST_NOISE = 1e-7  # m; tracks of a simulation may have none
FRICTIONS = np.geomspace(0.03, 0.9, 800)  # first, then more narrowly about the likeliest


def measure_sliding_friction(balls: Sequence[BallTrack], paths: Sequence[FreePath], noise: float) -> dict[str, float]:
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
            own = _PathLikelihood.of(ball.time[rows], ball.position[rows], noise)
            shows += [] if own is None or own.ratio < MIN_LOG_RATIO else [own]
    nothing = {"mu_k": float("nan"), "mu_k_std": float("nan")}
    if len(shows) < MIN_PATHS:
        return nothing
    tried = FRICTIONS
    for _ in range(5):  # each time nearer to what is likely, until the steps are far smaller than the error
        every, log = np.array([own.weigh(tried) for own in shows]), np.log(tried)
        chance = np.exp((total := every.sum(axis=0)) - total.max())
        middle = float(chance @ log / chance.sum())
        width, step = float(np.sqrt(chance @ (log - middle) ** 2 / chance.sum())), float(log[1] - log[0])
        if width > 3 * step:
            break
        tried = np.exp(middle + 6 * max(width, step) * np.linspace(-1, 1, 61))
    slopes = np.array([np.interp(middle + width, log, own) - np.interp(middle - width, log, own) for own in every])
    error = width * max(1.0, float(np.sqrt((slopes**2).sum())) / 2)
    value = float(np.exp(middle))
    return {"mu_k": value, "mu_k_std": error * value} if error < MAX_ERROR else nothing


@dataclass(frozen=True, eq=False)
class _PathLikelihood:
    """The likelihood of the friction by one path, for each end of its slide.

    found, error (n,): acceleration by the slide and its standard error, m/s^2. log_chance (n,): of the end, without
    what the friction changes. total: logarithm of the likelihood of a friction that is equally likely in its logarithm.
    ratio: logarithm of the largest over the smallest likelihood of `FRICTIONS`.
    """

    found: Array
    error: Array
    log_chance: Array
    total: float = 0.0
    ratio: float = 0.0

    @staticmethod
    def of(time: Array, position: Array, noise: float) -> _PathLikelihood | None:
        """Fit a path, times (n,) s and positions (n, 2) m, by each end of its slide; None if none fits, or shows it.

        Its end is equally likely in its logarithm. Ends lie nearer to one another where the likelihood changes fast.
        """
        first_ends, halvings, max_change = 40, 8, 1.0
        since, where = time - time[0], (position - position.mean(axis=0)) / noise
        ends = np.geomspace(since[-1] / (2 * len(time)), 3 * since[-1], first_ends)
        if fit_ends(since, where, ends[-1:], noise)[-1][0] > MAX_DECEL_ERROR:
            return None
        fits = fit_ends(since, where, ends, noise)
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
            new = fit_ends(since, where, added, noise)
            fits = [np.insert(old, wide + 1, more) for old, more in zip(fits, new, strict=True)]
            ends = np.insert(ends, wide + 1, added)
        (chi2, volume, found, error), dof = fits, 2 * len(time) - 7
        if chi2.min() > dof + MAX_SIGMA * np.sqrt(2 * dof):
            return None
        log_chance = np.log(np.gradient(np.log(ends))) - chi2 / 2 - volume
        may = log_chance > log_chance.max() - MAX_LOG_RATIO
        own = _PathLikelihood(found[may], error[may], log_chance[may])
        every = own.find_log(FRICTIONS)
        return replace(own, total=float(logsumexp(every) - np.log(len(every))), ratio=float(np.ptp(every)))

    def find_log(self, frictions: Array) -> Array:
        """Find the logarithm of the likelihood of each friction (k,), as a mean over ends and directions."""
        decel, variance = frictions * GRAVITY, self.error[:, None] ** 2
        off = (decel - self.found[:, None]) ** 2 / (2 * variance)
        sharp, ratio = 1e6, decel * self.found[:, None] / variance  # beyond it the Bessel function has its limit
        limit = -np.log(2 * np.pi * np.maximum(ratio, sharp)) / 2
        any_direction = np.where(ratio < sharp, np.log(ive(0, np.minimum(ratio, sharp))), limit)
        return np.asarray(logsumexp(self.log_chance[:, None] + any_direction - off, axis=0))

    def weigh(self, frictions: Array) -> Array:
        """Weigh frictions (k,) by the logarithm of their likelihood, which allows for a path that seems to show any."""
        log = self.find_log(frictions) - self.total
        return np.asarray(np.logaddexp(np.log1p(-MISSED_SHARE) + log, np.log(MISSED_SHARE)))


def fit_ends(since: Array, where: Array, ends: Array, noise: float) -> list[Array]:
    """Fit a slide and a roll to a path for each end (k,) of the slide, s.

    Position, velocity, loss of rolling, and acceleration of the slide may be any.

    since (n,): s since the first position. where (n, 2): positions over the noise, m.

    Returns chi^2; the logarithm of the volume that all but the acceleration fill, up to a constant; the size of the
    acceleration and its standard error, m/s^2: (k,) each.
    """
    slid, rolled = np.minimum(since, ends[:, None]), np.maximum(since - ends[:, None], 0.0)
    columns = np.broadcast_arrays(1.0, since, rolled**2 / 2, slid * (since - slid / 2))
    design = np.stack(columns, axis=-1) / noise  # (k, n, 4)
    square = np.swapaxes(design, 1, 2) @ design
    square[:, 2, 2] += 1 / ROLLING_LOSS**2
    size = np.sqrt(np.einsum("kii->ki", square))  # units in which the equations are well conditioned
    square /= size[:, :, None] * size[:, None, :]
    pull = np.swapaxes(design, 1, 2) @ where / size[:, :, None]
    inverse = np.linalg.inv(square)
    value = inverse @ pull
    value += inverse @ (pull - square @ value)  # once more, because the terms are nearly proportional
    chi2 = (where**2).sum() - (value * pull).sum(axis=(1, 2))
    volume = np.linalg.slogdet(square[:, :3, :3])[1] + 2 * np.log(size[:, :3]).sum(axis=1)
    return [chi2, volume, np.hypot(*value[:, 3].T) / size[:, 3], np.sqrt(inverse[:, 3, 3]) / size[:, 3]]
