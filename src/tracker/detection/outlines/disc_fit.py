"""Fits the centre of a disc by least squares over the pixels at its edge, with the shadow beside it."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from synthcam_shared.arrays import Array, Ints
from tracker.detection.background.still_background import StillBackground
from tracker.detection.glints import SHADED_POSITION_ERROR_RADII
from tracker.detection.outlines.contrast_regions import MIN_BLUR_PX

EDGE_PX = 3.0  # on either side of the outline: the pixels that determine the position
Picture = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class DiscFit:
    """A fitted disc."""

    position: Array  # (2,): px
    cov: Array  # (2, 2): px^2
    fixed: Array  # (2, 2): the part of the covariance that is the same in every frame of a ball at rest
    radius: float  # px
    spread: float  # rms of the residuals, counts


@dataclass(frozen=True)
class DiscAppearance:
    """Properties that the balls of a film have in common."""

    radius: float  # px
    noise: float  # standard deviation of one pixel in one frame, counts
    shaded: bool = False  # one side is brighter, and balls cast shadows
    radius_std: float = 0.0  # standard deviation by which radii differ, px; 0 where each frame has its own


@dataclass(frozen=True)
class DiscScene:
    """One disc in one frame: what its fit depends on, beside the position from which it starts."""

    frame: Picture
    ground: StillBackground
    look: DiscAppearance
    blur: Array  # (2,): displacement during the exposure, px
    others: Sequence[tuple[float, float]] = ()  # positions of the balls that touch this one in the picture, px


def fit_disc(scene: DiscScene, start: Array) -> DiscFit | None:
    """Fit position, radius, width of the edge, brightness of the ball, and its displacement during the exposure.

    Pixels have Huber's weights; errors follow from the residuals. A shaded ball has the brightness of a matte sphere
    under one lamp and uniform light. The ground around it has the brightness of this frame, its shadow included.

    The fit starts from the position `start` (2,), px. The blur is fitted if it is long enough to show (`MIN_BLUR_PX`).
    The result is None where there is no disc.
    """
    look = scene.look
    if not look.shaded:
        return _fit_from(scene, start)
    # The first position is that of the bright part. The fit starts there and at two points further from the lamp.
    starts = [start - share * look.radius * find_lit_side(scene.frame, start, look.radius) for share in (0.0, 0.2, 0.4)]
    tried = [f for at in starts if (f := _fit_from(scene, at)) is not None]
    best = min(tried, key=lambda f: f.spread, default=None)
    for _ in range(3):
        if best is None or np.hypot(*(best.position - start)) > _max_shift(look):
            return None
        at = best.position
        best = _fit_from(scene, at)
        if best is not None and np.hypot(*(best.position - at)) < 0.3:  # px
            break
    return best


def _max_shift(look: DiscAppearance) -> float:
    """How far a fit may move from its first position, px; of a shaded ball that is the middle of its bright part."""
    return 1.5 + look.shaded * 0.25 * look.radius


def find_lit_side(frame: Picture, at: Array, radius: float) -> Array:
    """The direction (2,) in which a disc becomes brighter; zero where none of it is in the picture."""
    rows, columns = _list_pixels(at, int(radius / 2) + 1, frame.shape, 0)
    dx, dy = columns - at[0], rows - at[1]
    inside = np.hypot(dx, dy) < radius / 2
    light = frame[rows[inside], columns[inside]]
    if len(light) == 0:
        return np.zeros(2)
    slope = np.array([np.mean(away[inside] * (light - light.mean())) for away in (dx, dy)])
    return slope / max(float(np.hypot(*slope)), 1e-9)


def _list_pixels(at: Array, reach: int, shape: tuple[int, ...], rim: int) -> Any:
    """Rows and columns (2, h, w) of the pixels around a position, without a rim of the picture."""
    column, row = np.round(at).astype(int)
    top, bottom = max(row - reach, rim), min(row + reach + 1, shape[0] - rim)
    left, right = max(column - reach, rim), min(column + reach + 1, shape[1] - rim)
    return np.mgrid[top:bottom, left:right]


class _EdgePixels(NamedTuple):
    """The pixels (n,) near an outline."""

    x: Array
    y: Array
    light: Array  # counts
    level: Array  # counts of the ground
    doubt: Array  # their errors


class _Minimum(NamedTuple):
    """The end of a fit: its parameters, and what the last step was computed from."""

    now: Array  # x, y, radius, width of the edge, the blur where it is long enough, the terms of the brightness
    cover: Array  # (n,) share of each pixel that the disc covers
    slopes: Array  # (parameters, n)
    left: Array  # (n,) residuals
    weight: Array  # (n,)
    normal: Array  # (parameters, parameters)


def _fit_from(scene: DiscScene, start: Array) -> DiscFit | None:
    """Fit x, y, radius, width of the edge, the blur where it is long enough, and the terms of the brightness."""
    look, pixels = scene.look, _pixels(scene, start)
    if len(pixels.x) < 16:
        return None
    terms = _brightness_terms(pixels.x - start[0], pixels.y - start[1], look)
    found = _minimise(scene, pixels, terms, start)
    if found is None:
        return None
    now, weight = found.now, found.weight
    spread = float(np.sqrt((weight * found.left**2).sum() / max(weight.sum() - len(now), 1.0)))
    far = np.hypot(pixels.x - start[0], pixels.y - start[1])
    inner = far <= max(look.radius, float(far.min()))
    contrast = abs(quick_median((now[-len(terms) :] @ terms)[inner]) - quick_median(pixels.level))
    if (
        float(np.hypot(*(now[:2] - start))) > _find_farthest(scene)
        or np.hypot(0.25 * contrast, 1.2 * look.noise) <= spread  # residuals of a quarter of the contrast: no disc
    ):
        return None
    inverse, usual = np.asarray(np.linalg.inv(found.normal), np.float64), min(look.noise**2, spread**2)
    fixed = _find_lasting_errors(scene, pixels, found, inverse, spread**2 - usual)
    cov = inverse * usual + fixed
    return DiscFit(position=now[:2], cov=cov[:2, :2], fixed=fixed[:2, :2], radius=float(now[2]), spread=spread)


def _find_farthest(scene: DiscScene) -> float:
    """The largest shift of a fit from its start, px."""
    return max(_max_shift(scene.look), 0.25 * float(np.hypot(*scene.blur)))


def _minimise(scene: DiscScene, pixels: _EdgePixels, terms: Array, start: Array) -> _Minimum | None:
    """Minimise the residuals by Gauss and Newton; None if the fit leads too far from its start."""
    (x, y, light, level, doubt), look, blur = pixels, scene.look, scene.blur
    far = np.hypot(x - start[0], y - start[1])
    core = far < look.radius - 0.5 * EDGE_PX
    ball = quick_median(light[core] if core.any() else light[far <= quick_median(far)])
    swept = list(blur) if float(np.hypot(*blur)) >= MIN_BLUR_PX else []
    now = np.array([*start, look.radius, 1.0, *swept, ball, *np.zeros(len(terms) - 1)])
    limit = np.array([0.5, 0.5, 0.5, 0.5, *np.ones(len(swept)), *np.full(len(terms), np.inf)])
    farthest, tiny, turns = _find_farthest(scene), 1e-9 * np.eye(len(now)), 15
    for turn in range(turns):
        cover, slopes = _model(x, y, level, now, terms)
        left = light - level - (now[-len(terms) :] @ terms - level) * cover
        scatter = max(1.4826 * quick_median(np.abs(left)), 0.3)
        weight = np.minimum(1.0, 1.5 * scatter / np.maximum(np.abs(left), 1e-12))
        weight = weight / (1 + (doubt * (1 - cover) / scatter) ** 2)
        normal = (slopes * weight) @ slopes.T + tiny
        pull = slopes @ (weight * left)
        if look.radius_std:
            normal[2, 2] += (scatter / look.radius_std) ** 2
            pull[2] += (scatter / look.radius_std) ** 2 * (look.radius - now[2])
        step = np.linalg.solve(normal, pull)
        now = now + np.minimum(np.maximum(step, -limit), limit)
        now[2], now[3] = max(now[2], 0.5), min(max(now[3], 0.3), EDGE_PX)  # px
        if max(abs(step[0]), abs(step[1])) < 1e-4:
            break
        if math.hypot(now[0] - start[0], now[1] - start[1]) > farthest + math.sqrt(0.5) * (turns - 1 - turn):
            return None  # the turns left cannot bring it back
    return _Minimum(now, cover, slopes, left, weight, normal)


def _find_lasting_errors(
    scene: DiscScene, pixels: _EdgePixels, found: _Minimum, inverse: Array, excess: float
) -> Array:
    """The part of the covariance (parameters, parameters) that is the same in every frame of a ball at rest.

    inverse: of the normal matrix. excess: variance of the residuals beyond that of the noise, counts^2.
    """
    look, now = scene.look, found.now
    doubtful = found.slopes * found.weight * pixels.doubt * (1 - found.cover)
    # errors of a ground that was never seen are common to cells of its texture
    lever = _add_up(inverse @ doubtful, _texture_cells(pixels.x, pixels.y, scene.ground))
    if not look.shaded:
        return np.asarray(inverse * excess + lever @ lever.T)
    sectors = 16  # of the outline, to which errors of the model of a shaded ball are common
    sector = (np.arctan2(pixels.y - now[1], pixels.x - now[0]) // (2 * np.pi / sectors)).astype(int) + sectors
    pulls = _add_up(inverse @ (found.slopes * found.weight * found.left), sector)
    fixed = pulls @ pulls.T + lever @ lever.T
    fixed[:2, :2] += (SHADED_POSITION_ERROR_RADII * look.radius) ** 2 * np.eye(2)
    return np.asarray(fixed)


def _add_up(effects: Array, group: Ints) -> Array:
    """Effects (parameters, n) of the pixels' errors, added up over groups of pixels (n,)."""
    return np.stack([np.bincount(group, line) for line in effects])


def _texture_cells(x: Array, y: Array, ground: StillBackground) -> Ints:
    """The cell of 4 x 4 px of each pixel (n,) where the ground was never seen; elsewhere a pixel is its own."""
    column, row = x.astype(int), y.astype(int)
    width = column.max() + 1
    own = np.arange(len(x)) + (row.max() + 1) * width
    cell = np.where(ground.known[row, column], own, row // 4 * width + column // 4)
    return np.unique(cell, return_inverse=True)[1]


def _brightness_terms(dx: Array, dy: Array, look: DiscAppearance) -> Array:
    """Terms (terms, n) of a ball's brightness at offsets from its middle: uniform, and a sphere's under a lamp."""
    if not look.shaded:
        return np.ones((1, len(dx)))
    u, v = dx / look.radius, dy / look.radius
    return np.stack([np.ones(len(u)), u, v, np.sqrt(np.maximum(1 - u * u - v * v, 0.0))])


def _pixels(scene: DiscScene, start: Array) -> _EdgePixels:
    """The pixels near the outline of a disc about a position."""
    frame, ground, look, blur = scene.frame, scene.ground, scene.look, scene.blur
    radius = look.radius
    inwards = max(EDGE_PX, 0.3 * radius) if look.shaded else EDGE_PX
    rows, columns = _list_pixels(start, int(radius + EDGE_PX + 2 + np.abs(blur).max() / 2), frame.shape, 1)
    long = float(np.hypot(*blur))
    along = blur / long if long > 0 else np.array([1.0, 0.0])
    dx, dy = columns - start[0], rows - start[1]
    share = np.clip(dx * along[0] + dy * along[1], -long / 2, long / 2)
    off = np.hypot(dx - share * along[0], dy - share * along[1]) - radius  # from the outline of the swept area
    used = (off < EDGE_PX) & (off > -inwards - long / 2)
    for x, y in scene.others:
        used &= np.hypot(columns - x, rows - y) > radius + EDGE_PX
    at = rows[used], columns[used]
    seen, level, doubt = (p[at].astype(float) for p in (frame, ground.level, ground.error))
    if look.shaded:
        share, change = _measure_ground_light(scene, start)(dx[used], dy[used])
        level, doubt = share * level, np.hypot(doubt, change * level)
    return _EdgePixels(columns[used].astype(float), rows[used].astype(float), seen, level, doubt)


def _measure_ground_light(scene: DiscScene, at: Array) -> Callable[[Array, Array], tuple[Array, Array]]:
    """Measure, by direction from a ball, the brightness of the ground relative to the still background.

    `at` (2,) is the centre of the ball, px. The result is a function of offsets dx and dy from the ball, px. It returns
    the relative brightness, 1 outside the shadow, and its difference from the neighbouring directions.
    """
    frame, ground, radius = scene.frame, scene.ground, scene.look.radius
    nearest, furthest = 1.5, 4.5  # distance of the ground from the outline, px
    arc_px = 2.5  # length along the outline over which the brightness is averaged
    min_sigma = 4.0  # standard errors by which ground in shadow is darker than the background
    rows, columns = _list_pixels(at, int(radius + furthest + 2), frame.shape, 1)
    dx, dy = columns - at[0], rows - at[1]
    off = np.hypot(dx, dy) - radius
    used = (off > nearest) & (off < furthest)
    for x, y in scene.others:
        used &= np.hypot(columns - x, rows - y) > radius + nearest
    here = rows[used], columns[used]
    bins = max(int(2 * np.pi * radius / arc_px), 12)
    number = _bin(dx[used], dy[used], bins).astype(int) % bins
    seen = np.bincount(number, frame[here], bins)
    level = np.bincount(number, ground.level[here], bins)
    variance = np.bincount(number, ground.error[here] ** 2, bins)
    share = np.where(level > 0, seen / np.maximum(level, 1e-9), 1.0)
    share[share > 1 - min_sigma * np.sqrt(variance) / np.maximum(level, 1e-9)] = 1.0
    change = np.maximum(np.abs(share - np.roll(share, 1)), np.abs(share - np.roll(share, -1)))

    def at_pixels(dx: Array, dy: Array) -> tuple[Array, Array]:
        at_bin = _bin(dx, dy, bins) - 0.5
        first, part = np.floor(at_bin).astype(int) % bins, at_bin % 1.0
        return (1 - part) * share[first] + part * share[(first + 1) % bins], change[at_bin.round().astype(int) % bins]

    return at_pixels


def _bin(dx: Array, dy: Array, bins: int) -> Array:
    """The direction of offsets, as a number from 0 to `bins`."""
    return np.asarray(np.arctan2(dy, dx) % (2 * np.pi) / (2 * np.pi) * bins)


def _model(x: Array, y: Array, level: Array, now: Array, terms: Array) -> tuple[Array, Array]:
    """Share of each pixel (n,) that the disc covers, and the slopes (parameters, n) of its counts."""
    count = len(terms)
    swept = len(now) - count > 4
    blur = now[4:6] if swept else np.zeros(2)
    # the blur is a sum over points on its line, .7 px apart at most
    points = min(1 + 2 * int(np.hypot(*blur) / (2 * 0.7)), 61)
    s = ((np.arange(points) + 0.5) / points - 0.5)[:, None]
    dx, dy = x - now[0] - s * blur[0], y - now[1] - s * blur[1]
    r = np.maximum(np.hypot(dx, dy), 1e-9)
    bent = now[3] / (2 * now[2])  # widths by which a blurred disc's half brightness lies inside its outline
    z = (r - now[2]) / now[3] + bent
    density = np.exp(-z * z / 2) / np.sqrt(2 * np.pi) / now[3]
    sides = density * dx / r, density * dy / r
    cover, slopes = ndtr(-z).sum(axis=0), np.zeros((len(now), len(x)))
    rows = [*sides, density, density * (z - 2 * bent), *((s * sides[0], s * sides[1]) if swept else ())]
    for k, row in enumerate(rows):
        slopes[k] = row.sum(axis=0)
    cover, slopes = cover / points, slopes * (now[-count:] @ terms - level) / points
    slopes[-count:] = cover * terms
    return cover, slopes


def quick_median(values: NDArray[np.floating]) -> float:
    """The median of values (n,) without NaN: that of numpy.median, for a few hundred in a third of its time."""
    half = len(values) // 2
    if len(values) % 2:
        return float(np.partition(values, half)[half])
    low, high = np.partition(values, (half - 1, half))[half - 1 : half + 1]
    return float((low + high) / 2)
