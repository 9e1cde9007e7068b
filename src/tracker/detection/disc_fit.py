"""The place of a disc in the picture, by least squares over the pixels at its edge."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from tracker.camera.lens import Array
from tracker.detection.glints import UNLIT
from tracker.detection.shadow import measure_ground_light
from tracker.detection.still_background import StillBackground

SURE = 1.5  # deviations beyond which a pixel counts less (Huber)
TURNS = 15
RING = 3.0  # px on either side of the outline, of the pixels that tell the place
BLURRED = 1.5  # px, a way during the exposure that is fitted
POINTS = 0.7  # px between the places that make up the way
ASTRAY = 1.5  # px, or a quarter of the way, that a fit may move off its start
LEANING = 0.25  # of the radius, the same, more, of a ball lit from one side: its bright part was the start
DEEP = 0.3  # of the radius, the same as RING inwards, of such a ball
GRAIN = 4  # px, of a texture's cells
AWAY = 0.0, 0.2, 0.4  # radii from the lit side, of the places from which the fit of such a ball starts
SECTORS = 16  # of the outline, each of which is off the model as a whole
POOR = 0.25  # of the contrast, rms of what a fit leaves: no disc
AGAIN, FIRM = 3, 0.3  # fits at most, and px that the last one moves, of a ball lit from one side
Picture = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class DiscFit:
    """x, y px and their covariance, the part of it that a ball at rest has in every frame alike; radius px; rms of what
    the fit leaves, counts.
    """

    place: Array
    cov: Array
    fixed: Array
    radius: float
    spread: float


@dataclass(frozen=True)
class DiscAppearance:
    """What the balls of a film share.

    Attributes
    ----------
    radius : float
        px.
    noise : float
        Of one pixel in one frame, counts.
    shaded : bool
        One side is brighter, and shadows fall.
    tied : float
        px, by which radii differ; 0 where each frame's is its own.
    """

    radius: float
    noise: float
    shaded: bool = False
    tied: float = 0.0


def fit_disc(
    frame: Picture,
    ground: StillBackground,
    start: Array,
    look: DiscAppearance,
    way: Array,
    others: list[tuple[float, float]],
) -> DiscFit | None:
    """Fit place, radius, the edge's width, the ball's brightness there, and its way during the exposure.

    Huber's weights, errors from the residuals. A shaded ball's brightness is that of a matte sphere under one lamp and
    even light; the ground about it is taken as bright as it is in this frame, in its shadow too.

    Parameters
    ----------
    frame : (h, w) array
    ground : Background
    start : (2,) array
        Place, px.
    look : Look
    way : (2,) array
        During the exposure, px; fitted if it is BLURRED at least.
    others : list of (x, y)
        Places of balls that touch this one in the picture.

    Returns
    -------
    Found or None
        None where there is no disc.
    """
    if not look.shaded:
        return _fit_from(frame, ground, start, look, way, others)
    starts = [start - share * look.radius * _lit_side(frame, start, look.radius) for share in AWAY]
    tried = [f for f in (_fit_from(frame, ground, at, look, way, others) for at in starts) if f is not None]
    best = min(tried, key=lambda f: f.spread, default=None)
    for _ in range(AGAIN):
        if best is None or np.hypot(*(best.place - start)) > ASTRAY + LEANING * look.radius:
            return None
        at = best.place
        best = _fit_from(frame, ground, at, look, way, others)
        if best is not None and np.hypot(*(best.place - at)) < FIRM:
            break
    return best


def _lit_side(frame: Picture, at: Array, radius: float) -> Array:
    """The direction (2,) of the brightness on a disc; zero where none of it is in the picture."""
    rows, columns = np.mgrid[_about(at, radius / 2, frame.shape)]
    dx, dy = columns - at[0], rows - at[1]
    inside = np.hypot(dx, dy) < radius / 2
    light = frame[rows[inside], columns[inside]]
    if len(light) == 0:
        return np.zeros(2)
    slope = np.array([np.mean(dx[inside] * (light - light.mean())), np.mean(dy[inside] * (light - light.mean()))])
    return slope / max(float(np.hypot(*slope)), 1e-9)


def _about(at: Array, reach: float, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Rows and columns of a picture about a place."""
    (column, row), far = np.round(at).astype(int), int(reach) + 1
    return slice(max(row - far, 0), min(row + far + 1, shape[0])), slice(
        max(column - far, 0), min(column + far + 1, shape[1])
    )


def _fit_from(
    frame: Picture,
    ground: StillBackground,
    start: Array,
    look: DiscAppearance,
    way: Array,
    others: list[tuple[float, float]],
) -> DiscFit | None:
    """One fit, from ``start``."""
    x, y, light, level, doubt = _pixels(frame, ground, start, look, way, others)
    long = float(np.hypot(*way))
    if len(x) < 16:
        return None
    looks = _looks(x - start[0], y - start[1], look)
    far = np.hypot(x - start[0], y - start[1])
    core = far < look.radius - 0.5 * RING
    ball = float(np.median(light[core] if core.any() else light[far <= np.median(far)]))
    swept = list(way) if long >= BLURRED else []
    now = np.array([*start, look.radius, 1.0, *swept, ball, *np.zeros(len(looks) - 1)])
    limit = np.array([0.5, 0.5, 0.5, 0.5, *np.ones(len(swept)), *np.full(len(looks), np.inf)])
    for _ in range(TURNS):
        cover, slopes = _model(x, y, level, now, looks)
        left = light - level - (now[-len(looks) :] @ looks - level) * cover
        scatter = max(1.4826 * float(np.median(np.abs(left))), 0.3)
        weight = np.minimum(1.0, SURE * scatter / np.maximum(np.abs(left), 1e-12))
        weight = weight / (1 + (doubt * (1 - cover) / scatter) ** 2)
        normal = (slopes * weight) @ slopes.T + 1e-9 * np.eye(len(now))
        pull = slopes @ (weight * left)
        if look.tied:
            normal[2, 2] += (scatter / look.tied) ** 2
            pull[2] += (scatter / look.tied) ** 2 * (look.radius - now[2])
        step = np.linalg.solve(normal, pull)
        now = now + np.clip(step, -limit, limit)
        now[3] = np.clip(now[3], 0.3, RING)
        if np.abs(step[:2]).max() < 1e-4:
            break
    spread = float(np.sqrt((weight * left**2).sum() / max(weight.sum() - len(now), 1.0)))
    away = float(np.hypot(*(now[:2] - start)))
    inner = far <= max(look.radius, float(far.min()))
    contrast = abs(float(np.median((now[-len(looks) :] @ looks)[inner])) - float(np.median(level)))
    if (
        away > max(ASTRAY + look.shaded * LEANING * look.radius, 0.25 * long)
        or np.hypot(POOR * contrast, 1.2 * look.noise) < spread
    ):
        return None
    inverse = np.linalg.inv(normal)
    usual = min(look.noise**2, spread**2)
    lever = _pool_unknown_cells(inverse @ (slopes * weight * doubt * (1 - cover)), x, y, ground)
    fixed = inverse * (spread**2 - usual) + lever @ lever.T
    if look.shaded:  # errors of the model, which are those of whole sectors
        sector = (np.arctan2(y - now[1], x - now[0]) // (2 * np.pi / SECTORS)).astype(int) + SECTORS
        pulls = np.stack([np.bincount(sector, line) for line in inverse @ (slopes * weight * left)])
        fixed = pulls @ pulls.T + lever @ lever.T
        fixed[:2, :2] += (UNLIT * look.radius) ** 2 * np.eye(2)
    return DiscFit(now[:2], (inverse * usual + fixed)[:2, :2], fixed[:2, :2], float(now[2]), spread)


def _pool_unknown_cells(lever: NDArray[np.float64], x: Array, y: Array, ground: StillBackground) -> NDArray[np.float64]:
    """Effects of pixels' errors, (parameters, n), those joined that err alike: where the ground was never seen."""
    column, row = x.astype(int), y.astype(int)
    own = np.arange(len(x)) + (row.max() + 1) * (column.max() + 1)
    cell = np.where(ground.known[row, column], own, row // GRAIN * (column.max() + 1) + column // GRAIN)
    cells = np.unique(cell, return_inverse=True)[1]
    return np.stack([np.bincount(cells, line) for line in lever])


def _looks(dx: Array, dy: Array, look: DiscAppearance) -> NDArray[np.float64]:
    """What a ball's brightness is a sum of, (terms, n) at places from its middle: even; of a sphere under a lamp."""
    if not look.shaded:
        return np.ones((1, len(dx)))
    u, v = dx / look.radius, dy / look.radius
    return np.stack([np.ones(len(u)), u, v, np.sqrt(np.maximum(1 - u * u - v * v, 0.0))])


def _pixels(
    frame: Picture,
    ground: StillBackground,
    start: Array,
    look: DiscAppearance,
    way: Array,
    others: list[tuple[float, float]],
) -> tuple[Array, Array, Array, Array, Array]:
    """x, y, count, ground and its error of the pixels near the outline, over a ground that is known."""
    height, width = frame.shape
    radius, deep = look.radius, max(RING, DEEP * look.radius) if look.shaded else RING
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
    used = (off < RING) & (off > -deep - long / 2)
    for x, y in others:
        used &= np.hypot(columns - x, rows - y) > radius + RING
    at = rows[used], columns[used]
    seen, level, doubt = (p[at].astype(float) for p in (frame, ground.level, ground.error))
    if look.shaded:
        share, change = measure_ground_light(frame, ground, start, radius, others)(dx[used], dy[used])
        level, doubt = share * level, np.hypot(doubt, change * level)
    return columns[used].astype(float), rows[used].astype(float), seen, level, doubt


def _model(
    x: Array, y: Array, level: Array, now: Array, looks: NDArray[np.float64]
) -> tuple[Array, NDArray[np.float64]]:
    """Share of each pixel (n,) that the disc covers, and the slopes (parameters, n) of its counts."""
    terms = len(looks)
    swept = len(now) - terms > 4
    way = now[4:6] if swept else np.zeros(2)
    points = min(1 + 2 * int(np.hypot(*way) / (2 * POINTS)), 61)
    cover, slopes = np.zeros(len(x)), np.zeros((len(now), len(x)))
    for s in (np.arange(points) + 0.5) / points - 0.5:
        dx, dy = x - now[0] - s * way[0], y - now[1] - s * way[1]
        r = np.maximum(np.hypot(dx, dy), 1e-9)
        bent = now[3] / (2 * now[2])  # widths by which a blurred disc's half brightness lies inside its outline
        z = (r - now[2]) / now[3] + bent
        density = np.exp(-z * z / 2) / np.sqrt(2 * np.pi) / now[3]
        cover += ndtr(-z)
        sides = density * dx / r, density * dy / r
        slopes[0] += sides[0]
        slopes[1] += sides[1]
        slopes[2] += density
        slopes[3] += density * (z - 2 * bent)
        if swept:
            slopes[4] += s * sides[0]
            slopes[5] += s * sides[1]
    cover, slopes = cover / points, slopes * (now[-terms:] @ looks - level) / points
    slopes[-terms:] = cover * looks
    return cover, slopes
