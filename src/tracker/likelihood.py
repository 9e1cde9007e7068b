"""Maximum likelihood of glints in small windows, all at once: place, flux and what lies under the glint.

Each pixel's count is normal about the pixel-integrated model, its variance that of the sensor at that mean; a
pixel at the ceiling says only that it is at least there. Under the glint lies the ball's body, a mirror of the
room. Its shape is given, learnt from all of a clip's glints (``learn``), and moves with the glint, on a free level;
where it is not, to second order a level and a bowl about its middle, both free. Newton steps use the expected
information (Fisher scoring), whose inverse is the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from .body import POWERS, Body
from .bound import ROOT_TWO_PI, fisher, glint_shape, information, slopes
from .lens import Array
from .sensor import Sensor

STEPS = 30
LOG_FLUX = (-5.0, 18.0)
MOST = 1e6  # counts, of anything under a glint
SWINGING = 8  # steps, after which a glint still on the move is swinging about its place: half steps from there
LESSONS = 3  # steps of the shared body
ROUGH = 0.02  # px and log flux, a first fit before them
CLOSE = 2e-4  # px and log flux: a step this small usually ends the search


@dataclass(frozen=True, eq=False)
class Windows:
    """What is fitted: ``counts`` (n, s, s), ``used`` (n, s, s) 1 where a pixel counts, ``start`` (n, 2) px from
    the central pixel, ``streak`` (n, 2) px the way during the exposure, ``bowl`` (n, 2) px from glint to the
    body's centre. ``ghosts`` (n, g, 3): places from the central pixel, px, of weaker glints and 1 where there
    is one, else 0.
    """

    counts: Array
    used: Array
    start: Array
    streak: Array
    bowl: Array
    ghosts: Array

    def __len__(self) -> int:
        return len(self.counts)

    @property
    def half(self) -> int:
        return int(self.counts.shape[1]) // 2

    def take(self, rows: Any) -> Windows:
        """The windows of ``rows``."""
        return Windows(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))


@dataclass(frozen=True, eq=False)
class Fit:
    """Of n windows: ``xy`` (n, 2) px from the central pixel, ``flux`` and ``background`` (n,) counts, ``cov``
    (n, 2, 2) px^2 and ``fixed``, the part of it that a resting ball has in every frame alike, ``flux_std``,
    ``chi2`` a degree of freedom over open pixels, ``loglik``, ``settled`` (n,).
    """

    xy: Array
    flux: Array
    background: Array
    cov: Array
    fixed: Array
    flux_std: Array
    chi2: Array
    loglik: Array
    settled: Array


def fit(windows: Windows, sigma: float, sensor: Sensor, body: Body | None = None, close: float = CLOSE) -> Fit:
    """Fits a glint of width ``sigma`` px to each window, on a body of known shape or on a bowl of its own.

    A step under ``close``, px and log flux, ends the search.
    """
    theta = _start(windows, sigma, sensor, body)
    active = np.arange(len(windows))
    settled = np.zeros(len(windows))
    for number in range(STEPS):
        if len(active) == 0:
            break
        part = windows.take(active)
        step = _step(theta[active], part, sigma, sensor, body)
        if number >= SWINGING:
            step *= 0.5
        theta[active] += step
        _bounded(theta, active, part.half)
        still = np.max(np.abs(step[:, :3]), axis=1) > close
        settled[active[~still]] = 1.0
        active = active[still]
    return _result(theta, windows, sigma, sensor, body, settled)


def _bounded(theta: Array, active: NDArray[np.int64], half: int) -> None:
    """Keeps runaway fits where they can still be computed; they never settle."""
    theta[active, :2] = np.clip(theta[active, :2], -half, half)
    theta[active, 2] = np.clip(theta[active, 2], *LOG_FLUX)
    theta[active, 3:] = np.clip(theta[active, 3:], -MOST, MOST)


def _model(theta: Array, windows: Windows, sigma: float, body: Body | None) -> tuple[Array, Array]:
    """Means (n, s, s) and their derivatives (n, p, s, s) by x, y, log flux, level, a free bowl, the ghosts' fluxes."""
    half = windows.half
    shape = glint_shape(theta[:, :2], windows.streak, sigma, half)
    flux = np.exp(theta[:, 2])
    middle = theta[:, :2] + windows.bowl
    linear = [np.ones_like(shape.value)]
    if body is None:
        square = (np.arange(-half, half + 1.0) - middle[..., None]) ** 2
        linear.append((square[:, 1, :, None] + square[:, 0, None, :]) / half**2)
    for g in range(windows.ghosts.shape[1]):
        ghost = windows.ghosts[:, g]
        lit = glint_shape(ghost[:, :2], windows.streak, sigma, half).value
        linear.append(lit * ghost[:, 2, None, None])
    mean = flux[:, None, None] * shape.value
    for i, basis in enumerate(linear):
        mean += theta[:, 3 + i, None, None] * basis
    parts = np.concatenate([slopes(shape, flux)[:, :3], np.stack(linear, axis=1)], axis=1)
    if body is not None:
        height, by_x, by_y = body.height(middle, windows.streak, half)
        mean += height
        parts[:, 0] += by_x
        parts[:, 1] += by_y
    return mean, parts


def _step(theta: Array, windows: Windows, sigma: float, sensor: Sensor, body: Body | None) -> Array:
    mean, parts = _model(theta, windows, sigma, body)
    told = fisher(information(mean, sensor) * windows.used, parts)
    score = _score(windows.counts, mean, sensor) * windows.used
    flat = parts.reshape(*parts.shape[:2], -1)
    slope = (flat @ score.reshape(len(flat), -1, 1))[..., 0]
    step = np.linalg.solve(_loaded(told), slope[..., None])[..., 0]
    limit = np.array([0.7 * sigma, 0.7 * sigma, 0.7])
    step[:, :3] = np.clip(step[:, :3], -limit, limit)
    return np.asarray(step, dtype=np.float64)


def _loaded(told: Array) -> Array:
    """A trace of ridge, so that a window that lacks a glint or a ghost stays solvable."""
    size = np.diagonal(told, axis1=1, axis2=2)
    ridge = 1e-9 * size + 1e-12
    return np.asarray(told + np.eye(told.shape[1]) * ridge[:, None, :], dtype=np.float64)


def _start(windows: Windows, sigma: float, sensor: Sensor, body: Body | None) -> Array:
    """Places as given; flux and level by weighted linear least squares of the open pixels at those places."""
    shape = glint_shape(windows.start, windows.streak, sigma, windows.half)
    weight = windows.used * (windows.counts < sensor.ceiling) / np.maximum(sensor.variance(windows.counts), 1e-9)
    total = np.maximum(weight.sum(axis=(1, 2)), 1e-300)
    mean_shape = (weight * shape.value).sum(axis=(1, 2)) / total
    mean_count = (weight * windows.counts).sum(axis=(1, 2)) / total
    spread = shape.value - mean_shape[:, None, None]
    power = np.maximum((weight * spread * spread).sum(axis=(1, 2)), 1e-300)
    flux = (weight * spread * windows.counts).sum(axis=(1, 2)) / power
    flux = np.maximum(flux, 3.0 / np.sqrt(power))
    rest = np.zeros((len(windows), (body is None) + windows.ghosts.shape[1]))
    return np.column_stack([windows.start, np.log(flux), mean_count - flux * mean_shape, rest])


def _score(counts: Array, mean: Array, sensor: Sensor) -> Array:
    """d log likelihood / d mean of each pixel."""
    variance = sensor.variance(mean)
    k = sensor.variance_slope(mean) / (2.0 * variance)
    miss = counts - mean
    score = miss / variance + k * (miss * miss / variance - 1.0)
    full = counts >= sensor.ceiling
    if np.any(full):
        root = 1.0 / np.sqrt(variance[full])
        z = (sensor.ceiling - 0.5 - mean[full]) * root
        hazard = np.exp(-0.5 * z * z - log_ndtr(-z)) / ROOT_TWO_PI
        score[full] = hazard * (root + k[full] * z)
    return np.asarray(score, dtype=np.float64)


def learn(windows: Windows, sigma: float, sensor: Sensor, end: float) -> Body:
    """The one body under which all the windows are likeliest, each with a place, flux and level of its own.

    The windows' own parameters are eliminated (Schur complement); their problem is nearly linear in the body.
    """
    theta = _start(windows, sigma, sensor, Body(end, np.zeros(len(POWERS))))
    own = fit(windows, sigma, sensor, close=ROUGH)
    theta[:, :3] = np.column_stack([own.xy, np.log(own.flux)])
    body = Body(end, np.zeros(len(POWERS)))
    for _ in range(LESSONS):
        mean, parts = _model(theta, windows, sigma, body)
        shared = body.basis(theta[:, :2] + windows.bowl, windows.half)
        told = fisher(information(mean, sensor) * windows.used, np.concatenate([parts, shared], axis=1))
        score = (_score(windows.counts, mean, sensor) * windows.used).reshape(len(theta), -1, 1)
        slope = np.concatenate([parts, shared], axis=1).reshape(len(theta), told.shape[1], -1) @ score
        of_own, across, of_body = _loaded(told)[:, :4, :4], told[:, :4, 4:], told[:, 4:, 4:]
        solved = np.linalg.solve(of_own, np.concatenate([across, slope[:, :4]], axis=2))
        left = (of_body - across.transpose(0, 2, 1) @ solved[:, :, :-1]).sum(axis=0)
        push = (slope[:, 4:] - across.transpose(0, 2, 1) @ solved[:, :, -1:]).sum(axis=0)
        change = np.linalg.solve(left + 1e-9 * np.diag(np.diag(left)) + 1e-12 * np.eye(len(left)), push)
        theta += np.clip(solved[:, :, -1:] - solved[:, :, :-1] @ change, -MOST, MOST)[..., 0]
        _bounded(theta, np.arange(len(theta)), windows.half)
        body = Body(end, np.clip(body.coefficients + change[:, 0], -MOST, MOST))
    return body


def _result(theta: Array, windows: Windows, sigma: float, sensor: Sensor, body: Body | None, settled: Array) -> Fit:
    mean, parts = _model(theta, windows, sigma, body)
    cov = np.linalg.inv(_loaded(fisher(information(mean, sensor) * windows.used, parts)))
    flux = np.exp(theta[:, 2])
    variance = sensor.variance(mean)
    is_open = windows.used * (windows.counts < sensor.ceiling)
    square = (windows.counts - mean) ** 2 / variance
    # A fixed error of a pixel shifts the place by cov d_a m / v: its covariance is that of these shifts.
    pattern = cov @ fisher(is_open * sensor.fixed_variance(mean) / variance**2, parts) @ cov
    freedom = np.maximum(is_open.sum(axis=(1, 2)) - theta.shape[1], 1.0)
    tail = np.zeros_like(mean)
    full = (windows.used > 0) & (is_open == 0)
    tail[full] = log_ndtr((mean[full] - sensor.ceiling + 0.5) / np.sqrt(variance[full]))
    loglik = is_open * (-0.5 * square - 0.5 * np.log(variance)) + tail
    return Fit(
        xy=theta[:, :2].copy(),
        flux=flux,
        background=theta[:, 3].copy(),
        cov=np.ascontiguousarray(cov[:, :2, :2]),
        fixed=np.ascontiguousarray(pattern[:, :2, :2]),
        flux_std=flux * np.sqrt(cov[:, 2, 2]),
        chi2=(is_open * square).sum(axis=(1, 2)) / freedom,
        loglik=loglik.sum(axis=(1, 2)),
        settled=settled,
    )
