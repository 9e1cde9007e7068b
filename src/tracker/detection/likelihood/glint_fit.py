"""Fits glints in small windows by maximum likelihood, all at once: position, flux and the background under them.

Each pixel's count is normally distributed about the pixel-integrated model, with the sensor's variance at that mean. A
pixel at the ceiling is censored: its count is at least that. Under the glint lies the ball profile, the image of the
room. Its shape may be known (`learn_profile`); then it moves with the glint and has a free level. Otherwise it is a
free level and a free bowl, to second order about its middle. Newton steps use the expected information (Fisher
scoring), whose inverse is the covariance.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_ndtr

from synthcam_shared.arrays import Array, Flags
from tracker.camera.sensor import SensorSpec
from tracker.detection.glints import RowArrays
from tracker.detection.likelihood.ball_profile import POWERS, BallProfile
from tracker.detection.likelihood.cramer_rao import (
    ROOT_TWO_PI,
    compute_fisher_information,
    compute_glint_shape,
    compute_pixel_information,
    pixel_noise,
)

MAX_COUNTS = 1e6  # of a background's parameters, where a fit runs away


@dataclass(frozen=True, eq=False)
class GlintWindows(RowArrays):
    """Pixels in which n glints are fitted, each in a window of s by s."""

    counts: Array  # (n, s, s)
    used: Array  # (n, s, s): 1 where a pixel enters the fit, else 0
    start: Array  # (n, 2): first positions, px from the central pixel
    blur: Array  # (n, 2): displacements during the exposure, px
    bowl: Array  # (n, 2): from the glints to the middles of the ball profiles, px
    secondaries: Array  # (n, g, 3): secondary glints, px from the central pixel, and 1 where there is one, else 0

    @property
    def half(self) -> int:
        return int(self.counts.shape[1]) // 2


@dataclass(frozen=True, eq=False)
class GlintFit(RowArrays):
    """Fits of n windows."""

    xy: Array  # (n, 2): px from the central pixel
    flux: Array  # counts, as the next two
    background: Array
    flux_std: Array
    cov: Array  # (n, 2, 2): covariances of the positions, px^2
    fixed: Array  # (n, 2, 2): the part that is the same in every frame of a ball at rest
    chi2: Array  # per degree of freedom, over open pixels
    loglik: Array
    converged: Flags
    cross: Array  # (n, 2): covariance of position and log flux, px
    secondary: Array  # (n, 4): flux of the first secondary glint, counts; its covariance with x and y; its variance


def fit_glints(
    windows: GlintWindows,
    sigma: float,
    sensor: SensorSpec,
    profile: BallProfile | None = None,
    tolerance: float = 0.003,
    max_steps: int = 30,
) -> GlintFit:
    """Fit a glint of width `sigma`, px, to each window, on a ball profile of known shape or on a bowl of its own.

    A step below `tolerance`, px and log flux, is the last one: the next would be a hundredth of it. A fit that still
    moves after `few_steps` on less light than the error of that is no glint. It ends unconverged.
    """
    few_steps = 8  # of Fisher scoring
    theta = _clip_parameters(_start(windows, sigma, sensor, profile), windows.half)
    active, part, limit = np.arange(len(windows)), windows, _step_limits(sigma)
    ended, fits = [], []
    for number in range(max_steps):
        seen = _compare(part, *_model(theta[active], part, sigma, profile), sensor)
        step = np.asarray(np.linalg.solve(seen.info, seen.slope[..., None])[..., 0], dtype=np.float64)
        step[:, :3] = np.clip(step[:, :3], -limit, limit)
        if number >= few_steps:  # a glint that still moves swings about its position
            step *= 0.5
        theta[active] = _clip_parameters(theta[active] + step, windows.half)
        still = np.max(np.abs(step[:, :3]), axis=1) > tolerance
        ends = np.full(len(active), True) if number == max_steps - 1 else ~still
        if number >= few_steps:
            ends |= np.linalg.inv(seen.info)[:, 2, 2] > 1.0  # of the logarithm of the flux
        if ends.any():
            ended.append(active[ends])
            fits.append(
                _finish(theta[active[ends]], seen.take(ends), part.take(ends), step[ends], ~still[ends], sensor)
            )
            active = active[~ends]
            part = windows.take(active)
        if len(active) == 0:
            break
    return GlintFit.join(fits).take(np.argsort(np.concatenate(ended)))


def _step_limits(sigma: float) -> Array:
    """The largest step: px, px and log flux."""
    return 0.7 * np.array([sigma, sigma, 1.0])


def _clip_parameters(theta: Array, half: int) -> Array:
    """Keep runaway fits where they can still be computed; they never converge."""
    low = [-half, -half, -5.0] + [-MAX_COUNTS] * (theta.shape[1] - 3)
    high = [half, half, 18.0] + [MAX_COUNTS] * (theta.shape[1] - 3)
    return np.clip(theta, low, high)


def _model(
    theta: Array, windows: GlintWindows, sigma: float, profile: BallProfile | None, room: int = 0
) -> tuple[Array, Array]:
    """Means (n, s, s) of the pixels and their derivatives (n, p, s, s).

    The derivatives are by x, y, log flux, level, a free bowl where there is no profile, and the fluxes of secondaries.
    `room` further ones are left empty.
    """
    half, secondaries = windows.half, windows.secondaries.shape[1]
    shape = compute_glint_shape(theta[:, :2], windows.blur, sigma, half)
    flux = np.exp(theta[:, 2])[:, None, None]
    middle = theta[:, :2] + windows.bowl
    parts = np.empty((len(theta), 4 + (profile is None) + secondaries + room, *shape.value.shape[1:]))
    for i, one in enumerate((shape.by_x, shape.by_y, shape.value)):
        np.multiply(flux, one, out=parts[:, i])
    parts[:, 3] = 1.0
    mean = parts[:, 2] + theta[:, 3, None, None]
    if profile is None:
        square = (np.arange(-half, half + 1.0) - middle[..., None]) ** 2 / half**2
        np.add(square[:, 1, :, None], square[:, 0, None, :], out=parts[:, 4])
        mean += theta[:, 4, None, None] * parts[:, 4]
    else:
        height, by_x, by_y = profile.height(middle, windows.blur, half)
        mean += height
        parts[:, 0] += by_x
        parts[:, 1] += by_y
    for g in range(secondaries):
        secondary, at = windows.secondaries[:, g], 4 + (profile is None) + g
        lit = compute_glint_shape(secondary[:, :2], windows.blur, sigma, half).value
        np.multiply(lit, secondary[:, 2, None, None], out=parts[:, at])
        mean += theta[:, at, None, None] * parts[:, at]
    return mean, parts


@dataclass(frozen=True, eq=False)
class _Comparison(RowArrays):
    """A model compared with its windows."""

    mean: Array  # (n, s, s): of the pixels' counts
    variance: Array  # (n, s, s): the same
    parts: Array  # (n, p, s, s): derivatives of the means by the parameters
    info: Array  # (n, p, p): Fisher information on the parameters
    slope: Array  # (n, p): score, the derivative of the log likelihood by the parameters


def _compare(windows: GlintWindows, mean: Array, parts: Array, sensor: SensorSpec) -> _Comparison:
    noise = pixel_noise(mean, sensor)
    info = compute_fisher_information(compute_pixel_information(mean, sensor, noise) * windows.used, parts)
    # a very small ridge, so that the equations of a window without a glint or a secondary have a solution
    ridge = 1e-9 * np.diagonal(info, axis1=1, axis2=2) + 1e-12
    score = _score(windows.counts, mean, sensor, noise)
    score *= windows.used
    slope = parts.reshape(*parts.shape[:2], -1) @ score.reshape(len(parts), -1, 1)
    return _Comparison(mean, noise[0], parts, info + np.eye(info.shape[1]) * ridge[:, None, :], slope[..., 0])


def _start(windows: GlintWindows, sigma: float, sensor: SensorSpec, profile: BallProfile | None) -> Array:
    """Positions as given; flux and level by weighted linear least squares of the open pixels at those positions."""
    shape = compute_glint_shape(windows.start, windows.blur, sigma, windows.half)
    weight = windows.used * (windows.counts < sensor.ceiling) / np.maximum(sensor.variance(windows.counts), 1e-9)
    total = np.maximum(weight.sum(axis=(1, 2)), 1e-300)
    mean_shape = (weight * shape.value).sum(axis=(1, 2)) / total
    mean_count = (weight * windows.counts).sum(axis=(1, 2)) / total
    rise = shape.value - mean_shape[:, None, None]
    power = np.maximum((weight * rise * rise).sum(axis=(1, 2)), 1e-300)
    flux = (weight * rise * windows.counts).sum(axis=(1, 2)) / power
    flux = np.maximum(flux, 3.0 / np.sqrt(power))
    rest = np.zeros((len(windows), (profile is None) + windows.secondaries.shape[1]))
    return np.column_stack([windows.start, np.log(flux), mean_count - flux * mean_shape, rest])


def _score(counts: Array, mean: Array, sensor: SensorSpec, noise: tuple[Array, Array]) -> Array:
    """d log likelihood / d mean of each pixel."""
    variance, k = noise
    miss = counts - mean
    score = miss / variance
    score += k * (miss * score - 1.0)
    full = counts >= sensor.ceiling
    if np.any(full):
        root = 1.0 / np.sqrt(variance[full])
        z = (sensor.ceiling - 0.5 - mean[full]) * root
        hazard = np.exp(-0.5 * z * z - log_ndtr(-z)) / ROOT_TWO_PI
        score[full] = hazard * (root + k[full] * z)
    return score


def learn_profile(windows: GlintWindows, sigma: float, sensor: SensorSpec, end: float) -> tuple[BallProfile, Array]:
    """Fit the ball profile together with the glints of all windows, by maximum likelihood.

    Each window has a position, flux and level of its own. These are eliminated (Schur complement); the remaining
    problem is nearly linear, so that two steps are enough. Beyond the radius `end`, px, the ball mirrors no room. The
    second result are the positions (n, 2) of the glints, px from the central pixel.
    """
    profile, limit = BallProfile(end, np.zeros(len(POWERS))), _step_limits(sigma)
    theta = _start(windows, sigma, sensor, profile)
    own = fit_glints(windows, sigma, sensor, tolerance=0.1)  # clipped glints need a first fit
    theta[:, :3] = np.column_stack([own.xy, np.log(own.flux)])
    for _ in range(2):
        mean, parts = _model(theta, windows, sigma, profile, room=len(POWERS))
        parts[:, 4:] = profile.basis(theta[:, :2] + windows.bowl, windows.half)
        seen = _compare(windows, mean, parts, sensor)
        of_own, across, of_profile = seen.info[:, :4, :4], seen.info[:, :4, 4:], seen.info[:, 4:, 4:]
        slope = seen.slope[..., None]
        solved = np.linalg.solve(of_own, np.concatenate([across, slope[:, :4]], axis=2))
        left = (of_profile - across.transpose(0, 2, 1) @ solved[:, :, :-1]).sum(axis=0)
        push = (slope[:, 4:] - across.transpose(0, 2, 1) @ solved[:, :, -1:]).sum(axis=0)
        change = np.linalg.solve(left + 1e-9 * np.diag(np.diag(left)) + 1e-12 * np.eye(len(left)), push)
        step = (solved[:, :, -1:] - solved[:, :, :-1] @ change)[..., 0]
        step[:, :3] = np.clip(step[:, :3], -limit, limit)
        theta = _clip_parameters(theta + step, windows.half)
        profile = BallProfile(end, np.clip(profile.coefficients + change[:, 0], -MAX_COUNTS, MAX_COUNTS))
    return profile, theta[:, :2]


def score_blur_length(
    windows: GlintWindows, known: Array, still: Flags, sigma: float, sensor: SensorSpec
) -> tuple[Array, Array]:
    """Fit how the glint of each window depends on the length of its blur: score and information on its logarithm.

    A Schur complement eliminates the nuisance parameters. Each window has its position, flux, level, bowl and width of
    the glint. All windows together have an elliptical shape of resting glints. `known` (n, 4) are positions from the
    central pixel, px, log fluxes and levels. The windows that are `still` hardly move: they give the width of a glint,
    which may differ from `sigma`, px.
    """
    theta = np.column_stack([known, np.zeros(len(windows))])
    mean, parts = _model(theta, windows, sigma, None, room=1)
    along, twist, across = _bends(theta, windows, sigma)
    parts[:, 5] = wider = sigma**2 * (along + across)
    seen = _compare(windows, mean, parts, sensor)
    step = np.linalg.solve(seen.info, seen.slope[..., None])[..., 0]
    theta = _clip_parameters(theta + step[:, :5], windows.half)
    sigma *= math.exp(float(np.clip(np.median(step[still, 5]), -0.5, 0.5)))
    mean, parts = _model(theta, windows, sigma, None, room=4)
    parts[:, 5], parts[:, 6], parts[:, 7] = wider, along - across, twist
    nudge = 0.05  # relative change of the blur, for a numerical derivative
    one, other = (
        compute_glint_shape(theta[:, :2], by * windows.blur, sigma, windows.half).value for by in (1 - nudge, 1 + nudge)
    )
    parts[:, 8] = np.exp(theta[:, 2])[:, None, None] * (other - one) / (2.0 * nudge)
    seen = _compare(windows, mean, parts, sensor)
    mixed = seen.info[:, :6, 6:]
    solved = np.linalg.solve(seen.info[:, :6, :6], np.concatenate([mixed, seen.slope[:, :6, None]], axis=2))
    left = seen.info[:, 6:, 6:] - mixed.transpose(0, 2, 1) @ solved[..., :3]
    score = seen.slope[:, 6:] - (mixed.transpose(0, 2, 1) @ solved[..., 3:])[..., 0]
    whole = left.sum(axis=0)
    by = np.append(-np.linalg.solve(whole[:2, :2], whole[:2, 2]), 1.0)
    return score @ by, np.einsum("i,nij,j->n", by, left, by)


def fit_blurs(windows: GlintWindows, known: Array, sigma: float, sensor: SensorSpec) -> Array:
    """Fit the blurs (n, 2), px, of glints of width `sigma`, px, together with position, flux, level and bowl.

    windows: with the blurs to begin from, which are not zero. known: (n, 4), as of `score_blur_length`.
    """
    max_steps, tolerance = 8, 0.01  # px
    nudge, limit = 0.05 * sigma, np.append(_step_limits(sigma), [1.5 * sigma] * 2)
    theta, blur = np.column_stack([known, np.zeros(len(windows))]), windows.blur.copy()
    for _ in range(max_steps):
        own = replace(windows, blur=blur)
        mean, parts = _model(theta, own, sigma, None, room=2)
        for axis, shift in enumerate(nudge * np.eye(2)):
            less, more = (compute_glint_shape(theta[:, :2], blur + by, sigma, own.half).value for by in (-shift, shift))
            parts[:, 5 + axis] = np.exp(theta[:, 2])[:, None, None] * (more - less) / (2.0 * nudge)
        seen = _compare(own, mean, parts, sensor)
        step = np.linalg.solve(seen.info, seen.slope[..., None])[..., 0]
        bounded = [0, 1, 2, 5, 6]
        step[:, bounded] = np.clip(step[:, bounded], -limit, limit)
        theta, blur = _clip_parameters(theta + step[:, :5], own.half), blur + step[:, 5:]
        if np.max(np.abs(step[:, 5:])) < tolerance:
            break
    return blur


def _bends(theta: Array, windows: GlintWindows, sigma: float) -> tuple[Array, Array, Array]:
    """Second derivatives of glints by xx, xy and yy, counts/px^2, (n, s, s) each."""
    flux, by = np.exp(theta[:, 2])[:, None, None], 0.05 * sigma
    left, right, up, down = (
        compute_glint_shape(theta[:, :2] + shift, windows.blur, sigma, windows.half)
        for shift in ((-by, 0.0), (by, 0.0), (0.0, -by), (0.0, by))
    )
    factor = flux / (2.0 * by)
    return factor * (right.by_x - left.by_x), factor * (right.by_y - left.by_y), factor * (down.by_y - up.by_y)


def _finish(
    theta: Array, seen: _Comparison, windows: GlintWindows, step: Array, converged: Flags, sensor: SensorSpec
) -> GlintFit:
    """The results of fits whose last ``step`` (n, p) increases the log likelihood by half of step . slope."""
    mean, variance, flux = seen.mean, seen.variance, np.exp(theta[:, 2])
    cov = np.asarray(np.linalg.inv(seen.info), dtype=np.float64)
    full = windows.counts >= sensor.ceiling
    is_open = windows.used * ~full if full.any() else windows.used
    square = (windows.counts - mean) ** 2 / variance
    # A fixed error of a pixel shifts the position by cov d_a m / v: its covariance is that of these shifts.
    pattern = (
        cov @ compute_fisher_information(is_open * sensor.fixed_pattern_variance(mean) / variance**2, seen.parts) @ cov
    )
    freedom = np.maximum(is_open.sum(axis=(1, 2)) - step.shape[1], 1.0)
    gain = np.where(converged, (step * seen.slope).sum(axis=1), 0.0)
    loglik = is_open * (-0.5 * square - 0.5 * np.log(variance))
    beyond = full & (windows.used > 0)
    if beyond.any():
        loglik[beyond] = log_ndtr((mean[beyond] - sensor.ceiling + 0.5) / np.sqrt(variance[beyond]))
    secondary, g = np.full((len(theta), 4), np.nan), windows.secondaries.shape[1]
    if g:
        secondary = np.column_stack([theta[:, -g], cov[:, [0, 1, -g], -g]])
    return GlintFit(
        xy=theta[:, :2],
        flux=flux,
        background=theta[:, 3],
        flux_std=flux * np.sqrt(cov[:, 2, 2]),
        cov=cov[:, :2, :2],
        fixed=pattern[:, :2, :2],
        chi2=((is_open * square).sum(axis=(1, 2)) - gain) / freedom,
        loglik=loglik.sum(axis=(1, 2)) + gain / 2,
        converged=converged,
        cross=cov[:, :2, 2],
        secondary=secondary,
    )
