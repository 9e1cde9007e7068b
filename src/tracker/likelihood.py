"""Maximum likelihood of glints in small windows, all at once: place, flux and background of each.

Each pixel's count is normal about the pixel-integrated model, its variance that of the sensor at that mean; a
pixel at the ceiling says only that it is at least there. Newton steps use the expected information (Fisher
scoring), whose inverse is the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from .bound import ROOT_TWO_PI, Shape, fisher, glint_shape, information
from .geometry import Sensor
from .lens import Array

STEPS = 30
CLOSE = 2e-4  # px and log flux: a step this small ends the search


@dataclass(frozen=True)
class Fit:
    """Of n windows: ``xy`` (n, 2) px from the central pixel, ``flux`` and ``background`` (n,) counts, ``cov``
    (n, 2, 2) px^2, ``flux_std``, ``chi2`` a degree of freedom over open pixels, ``loglik``, ``settled`` (n,).
    """

    xy: Array
    flux: Array
    background: Array
    cov: Array
    flux_std: Array
    chi2: Array
    loglik: Array
    settled: Array


def fit(
    windows: Array,
    used: Array,
    xy: Array,
    streaks: Array,
    sigma: float,
    sensor: Sensor,
) -> Fit:
    """Fits glints of width ``sigma`` to ``windows`` (n, s, s), counts, where ``used`` (n, s, s) is 1.

    ``xy`` (n, 2) px from the central pixel: where to start; ``streaks`` (n, 2) px: way during the exposure.
    """
    half = windows.shape[1] // 2
    theta = _start(windows, used, xy, streaks, sigma, sensor)
    active = np.arange(len(windows))
    settled = np.zeros(len(windows))
    for _ in range(STEPS):
        if len(active) == 0:
            break
        now, counts, use = theta[active], windows[active], used[active]
        shape = glint_shape(now[:, :2], streaks[active], sigma, half)
        flux = np.exp(now[:, 2])
        mean = now[:, 3, None, None] + flux[:, None, None] * shape.value
        told = fisher(information(mean, sensor) * use, shape, flux)
        slope = _gradient(_score(counts, mean, sensor) * use, shape, flux)
        step = _solve(told, slope)
        limit = np.array([0.7 * sigma, 0.7 * sigma, 0.7])
        step[:, :3] = np.clip(step[:, :3], -limit, limit)
        theta[active] = now + step
        theta[active, :2] = np.clip(theta[active, :2], -half, half)
        still = np.max(np.abs(step[:, :3]), axis=1) > CLOSE
        settled[active[~still]] = 1.0
        active = active[still]
    return _result(theta, windows, used, streaks, sigma, sensor, settled)


def _start(windows: Array, used: Array, xy: Array, streaks: Array, sigma: float, sensor: Sensor) -> Array:
    """Places as given; flux and background by weighted linear least squares at those places."""
    shape = glint_shape(xy, streaks, sigma, windows.shape[1] // 2)
    weight = used / np.maximum(sensor.variance(windows), 1e-9)
    total = weight.sum(axis=(1, 2))
    mean_shape = (weight * shape.value).sum(axis=(1, 2)) / total
    mean_count = (weight * windows).sum(axis=(1, 2)) / total
    spread = shape.value - mean_shape[:, None, None]
    power = (weight * spread * spread).sum(axis=(1, 2))
    flux = (weight * spread * windows).sum(axis=(1, 2)) / np.maximum(power, 1e-300)
    flux = np.maximum(flux, 3.0 / np.sqrt(np.maximum(power, 1e-300)))
    return np.column_stack([xy, np.log(flux), mean_count - flux * mean_shape])


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


def _gradient(score: Array, shape: Shape, flux: Array) -> Array:
    n = len(flux)
    flat = score.reshape(n, -1, 1)
    sums = [(part.reshape(n, 1, -1) @ flat)[:, 0, 0] for part in (shape.by_x, shape.by_y, shape.value)]
    return np.column_stack([flux * sums[0], flux * sums[1], flux * sums[2], flat.sum(axis=1)[:, 0]])


def _solve(told: Array, slope: Array) -> Array:
    """Steps; a trace of ridge keeps a window without a glint solvable."""
    ridge = 1e-9 * np.trace(told, axis1=1, axis2=2)[:, None] / 4.0 + 1e-12
    loaded = told + np.eye(4) * ridge[..., None]
    return np.asarray(np.linalg.solve(loaded, slope[..., None])[..., 0], dtype=np.float64)


def _result(
    theta: Array, windows: Array, used: Array, streaks: Array, sigma: float, sensor: Sensor, settled: Array
) -> Fit:
    flux = np.exp(theta[:, 2])
    shape = glint_shape(theta[:, :2], streaks, sigma, windows.shape[1] // 2)
    mean = theta[:, 3, None, None] + flux[:, None, None] * shape.value
    told = fisher(information(mean, sensor) * used, shape, flux)
    told = told + np.eye(4) * (1e-9 * np.trace(told, axis1=1, axis2=2)[:, None, None] / 4.0 + 1e-12)
    cov = np.linalg.inv(told)
    variance = sensor.variance(mean)
    is_open = used * (windows < sensor.ceiling)
    square = (windows - mean) ** 2 / variance
    freedom = np.maximum(is_open.sum(axis=(1, 2)) - 4.0, 1.0)
    z = (sensor.ceiling - 0.5 - mean) / np.sqrt(variance)
    loglik = is_open * (-0.5 * square - 0.5 * np.log(variance)) + (used - is_open) * log_ndtr(-z)
    return Fit(
        xy=theta[:, :2].copy(),
        flux=flux,
        background=theta[:, 3].copy(),
        cov=np.ascontiguousarray(cov[:, :2, :2]),
        flux_std=flux * np.sqrt(cov[:, 2, 2]),
        chi2=(is_open * square).sum(axis=(1, 2)) / freedom,
        loglik=loglik.sum(axis=(1, 2)),
        settled=settled,
    )
