"""The place of a disc in the picture, by least squares over the pixels at its edge."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from tracker.camera.lens import Array
from tracker.detection.still_background import Background

SURE = 1.5  # deviations beyond which a pixel counts less (Huber)
TURNS = 15
RING = 3.0  # px on either side of the outline, of the pixels that tell the place
BLURRED = 1.5  # px, a way during the exposure that is fitted
POINTS = 0.7  # px between the places that make up the way
ASTRAY = 1.5  # px, or a quarter of the way, that a fit may move off its start
POOR = 0.25  # of the contrast, rms of what a fit leaves: no disc
Picture = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Found:
    """x, y px and their covariance, the part of it that a ball at rest has in every frame alike, and the radius."""

    place: Array
    cov: Array
    fixed: Array
    radius: float


def fit_disc(
    frame: Picture,
    ground: Background,
    start: Array,
    radius: float,
    way: Array,
    others: list[tuple[float, float]],
    noise: float,
) -> Found | None:
    """Fit place, radius, the edge's width, the ball's brightness there, and its way during the exposure.

    Huber's weights, errors from the residuals.

    Parameters
    ----------
    frame : (h, w) array
    ground : Background
    start : (2,) array
        Place, px.
    radius : float
        px.
    way : (2,) array
        During the exposure, px; fitted if it is BLURRED at least.
    others : list of (x, y)
        Places of balls that touch this one in the picture.
    noise : float
        Of one pixel in one frame, counts.

    Returns
    -------
    Found or None
        None where there is no disc.
    """
    x, y, light, level, doubt = _pixels(frame, ground, start, radius, way, others)
    swept = float(np.hypot(*way)) >= BLURRED
    if len(x) < 16:
        return None
    far = np.hypot(x - start[0], y - start[1])
    core = far < radius - 0.5 * RING
    ball = float(np.median(light[core] if core.any() else light[far <= np.median(far)]))
    now = np.array([*start, radius, 1.0, ball, *(way if swept else ())])
    for _ in range(TURNS):
        cover, slopes = _model(x, y, level, now)
        left = light - level - (now[4] - level) * cover
        scatter = max(1.4826 * float(np.median(np.abs(left))), 0.3)
        weight = np.minimum(1.0, SURE * scatter / np.maximum(np.abs(left), 1e-12))
        weight = weight / (1 + (doubt * (1 - cover) / scatter) ** 2)
        normal = (slopes * weight) @ slopes.T + 1e-9 * np.eye(len(now))
        step = np.linalg.solve(normal, slopes @ (weight * left))
        limit = np.array([0.5, 0.5, 0.5, 0.5, np.inf, 1.0, 1.0])[: len(now)]
        now = now + np.clip(step, -limit, limit)
        now[3] = np.clip(now[3], 0.3, RING)
        if np.abs(step[:2]).max() < 1e-4:
            break
    spread = float(np.sqrt((weight * left**2).sum() / max(weight.sum() - len(now), 1.0)))
    away = float(np.hypot(*(now[:2] - start)))
    contrast = abs(now[4] - float(np.median(level)))
    if away > max(ASTRAY, 0.25 * np.hypot(*way)) or spread > POOR * contrast:
        return None
    inverse = np.linalg.inv(normal)
    usual = min(noise**2, spread**2)
    lever = inverse @ (slopes * weight * doubt * (1 - cover))
    fixed = inverse * (spread**2 - usual) + lever @ lever.T
    return Found(now[:2], (inverse * usual + fixed)[:2, :2], fixed[:2, :2], float(now[2]))


def _pixels(
    frame: Picture,
    ground: Background,
    start: Array,
    radius: float,
    way: Array,
    others: list[tuple[float, float]],
) -> tuple[Array, Array, Array, Array, Array]:
    """x, y, count, ground and its error of the pixels near the outline, over a ground that is known."""
    height, width = frame.shape
    reach = int(radius + RING + 2 + np.abs(way).max() / 2)
    column, row = np.round(start).astype(int)
    top, bottom = max(row - reach, 1), min(row + reach + 1, height - 1)
    left, right = max(column - reach, 1), min(column + reach + 1, width - 1)
    rows, columns = np.mgrid[top:bottom, left:right]
    long = float(np.hypot(*way))
    along = way / long if long > 0 else np.array([1.0, 0.0])
    dx, dy = columns - start[0], rows - start[1]
    share = np.clip(dx * along[0] + dy * along[1], -long / 2, long / 2)
    off = np.hypot(dx - share * along[0], dy - share * along[1]) - radius  # from the outline of all it sweeps
    used = (off < RING) & (off > -RING - long / 2)
    for x, y in others:
        used &= np.hypot(columns - x, rows - y) > radius + RING
    used[used] = ground.known[rows[used], columns[used]]
    at = rows[used], columns[used]
    seen, level, doubt = (p[at].astype(float) for p in (frame, ground.level, ground.error))
    return columns[used].astype(float), rows[used].astype(float), seen, level, doubt


def _model(x: Array, y: Array, level: Array, now: Array) -> tuple[Array, NDArray[np.float64]]:
    """Share of each pixel (n,) that the disc covers, and the slopes (parameters, n) of its counts."""
    way = now[5:] if len(now) > 5 else np.zeros(2)
    points = min(1 + 2 * int(np.hypot(*way) / (2 * POINTS)), 61)
    cover, slopes = np.zeros(len(x)), np.zeros((len(now), len(x)))
    for s in (np.arange(points) + 0.5) / points - 0.5:
        dx, dy = x - now[0] - s * way[0], y - now[1] - s * way[1]
        r = np.maximum(np.hypot(dx, dy), 1e-9)
        z = (r - now[2]) / now[3]
        density = np.exp(-z * z / 2) / np.sqrt(2 * np.pi) / now[3]
        cover += ndtr(-z)
        sides = density * dx / r, density * dy / r
        slopes[0] += sides[0]
        slopes[1] += sides[1]
        slopes[2] += density
        slopes[3] += density * z
        if len(now) > 5:
            slopes[5] += s * sides[0]
            slopes[6] += s * sides[1]
    cover, slopes = cover / points, slopes * (now[4] - level) / points
    slopes[4] = cover
    return cover, slopes
