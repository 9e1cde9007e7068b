"""The radius of a ball's outline, in pixels, from the mean picture around its glint.

A mirror ball shows the room within .71 of its radius, brightest in the middle, and the plate outside of that. Against
a bright ground its own edge shows too. Either gives the radius.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.special import ndtr

from synthcam_shared.arrays import Array, Flags
from tracker.detection.candidates import EmptyPlate
from tracker.detection.detector import OutlineRadius
from tracker.detection.glints import Glints

HALF_WINDOW_PX = 36  # px, of the mean picture


def measure_outline(frames: Sequence[Any], plate: EmptyPlate, glints: Glints, sigma: float) -> OutlineRadius | None:
    """Measure the outline's radius in a ball's mean picture; None if it is too dark to be seen, or not round."""
    stack = _mean(frames, plate, glints, sigma)
    if stack is None:
        return None
    picture, weight = stack
    blur = math.sqrt(sigma**2 + 1.0 / 12.0)  # windows are centred on the nearest pixel
    first_radii_px = (2.5, 4, 5.5, 7.5, 10, 14, 19, 25)  # first guesses of the radius
    fits = [_fit(picture, weight, blur, float(size)) for size in first_radii_px]
    best = min(fits, key=lambda fit: float(fit.cost))
    freedom = max(int(np.count_nonzero(weight)) - 6, 1)
    try:
        cov = np.linalg.inv(best.jac.T @ best.jac) * (2.0 * best.cost / freedom)
    except np.linalg.LinAlgError:
        return None
    radius = math.exp(best.x[0])
    std = radius * math.sqrt(max(float(cov[0, 0]), 0.0))
    inside = first_radii_px[0] < radius < 0.8 * HALF_WINDOW_PX and math.hypot(*best.x[1:]) < 0.4 * radius
    # If the glint covers most of the ball, a small disc can look like the rim of a larger ball. Fits whose radius
    # differs by more than 10 % are rivals.
    rivals = [fit.cost for fit in fits if abs(fit.x[0] - best.x[0]) > 0.1]
    # a rival must be worse by 30 in chi^2
    if rivals and min(rivals) - best.cost < 15.0 * max(1.0, 2.0 * best.cost / freedom):
        return None
    # without a ball, on mere ground, chi^2 must be clearly larger
    used, excess = weight > 0, 60.0 * max(1.0, 2.0 * best.cost / freedom)
    ground = np.average(picture[used], weights=weight[used] ** 2)
    empty = float(np.sum((picture[used] * weight[used] - weight[used] * ground) ** 2))
    if not inside or not std < radius / 20.0 or not empty - 2.0 * best.cost > excess:
        return None
    # 1 % of the radius: rooms are uneven, and balls are not ideal mirrors
    return OutlineRadius(radius, math.hypot(std, 0.01 * radius))


def _mean(frames: Sequence[Any], plate: EmptyPlate, glints: Glints, sigma: float) -> tuple[Array, Array] | None:
    """Mean over the plate (s, s) about single glints, and the root of each pixel's weight, 1/counts."""
    h, w = plate.level.shape
    half = HALF_WINDOW_PX
    column, row = np.rint(glints.x).astype(np.int64), np.rint(glints.y).astype(np.int64)
    inside = (column >= half) & (column < w - half) & (row >= half) & (row < h - half)
    chosen = np.flatnonzero(inside & _is_only_glint(glints))
    if len(chosen) < 20:
        return None
    # more windows do not make the mean better
    chosen = chosen[np.unique(np.linspace(0, len(chosen) - 1, 400).round().astype(np.int64))]
    total = np.zeros((2 * half + 1, 2 * half + 1))
    for k in chosen.tolist():
        part = slice(row[k] - half, row[k] + half + 1), slice(column[k] - half, column[k] + half + 1)
        total += frames[int(glints.frame[k])][part].astype(np.float64)
        total -= float(np.median(plate.level[part]))
    offsets = np.arange(-half, half + 1.0)
    # the glint itself, 3.6 of its widths about its centre, is left out
    core = offsets[:, None] ** 2 + offsets**2 < (3.6 * sigma + 1.0) ** 2
    return total / len(chosen), np.where(core, 0.0, math.sqrt(len(chosen)) / plate.noise)


def _is_only_glint(glints: Glints) -> Flags:
    """Which glints are the only one of their frame within the window."""
    alone = np.ones(len(glints), dtype=bool)
    for number in np.unique(glints.frame).tolist():
        rows = np.flatnonzero(glints.frame == number)
        apart = np.max(np.abs(glints.xy[rows][:, None] - glints.xy[rows][None]), axis=2)
        np.fill_diagonal(apart, np.inf)
        alone[rows] = apart.min(axis=1) > 1.8 * HALF_WINDOW_PX
    return alone


def _fit(picture: Array, weight: Array, blur: float, size: float) -> Any:
    """Radius (its logarithm) and centre by least squares; disc, bowl and ground solved for at each step."""

    def misfit(at: Array) -> Array:
        parts = _parts(math.exp(at[0]), at[1], at[2], blur) * weight[..., None]
        flat, wanted = parts.reshape(-1, parts.shape[-1]), (picture * weight).ravel()
        height = np.linalg.solve(flat.T @ flat + 1e-9 * np.eye(flat.shape[1]), flat.T @ wanted)
        return np.asarray(wanted - flat @ height, dtype=np.float64)

    aside = 0.5 * size + 1.0
    bounds = [math.log(2.0), -aside, -aside], [math.log(HALF_WINDOW_PX), aside, aside]
    return least_squares(misfit, [math.log(size), 0.0, 0.0], bounds=bounds, x_scale=[0.1, 1.0, 1.0], max_nfev=30)


def _parts(radius: float, x: float, y: float, blur: float) -> Array:
    """(s, s, 3): the disc, the bowl of what it mirrors of the room, the ground; edges blurred."""
    offsets = np.arange(-HALF_WINDOW_PX, HALF_WINDOW_PX + 1.0)
    distance = np.hypot(offsets - x, offsets[:, None] - y)
    disc = ndtr((radius - distance) / blur)
    # 1 - 2 q falls to zero with a slope of 4 rim / R^2: its blurred ramp is the normal's loss integral.
    rim = radius / math.sqrt(2.0)
    z = (rim - distance) / blur
    ramp = blur * (z * ndtr(z) + np.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi))
    bowl = ramp * (2.0 * rim - np.minimum(ramp, rim)) * 2.0 / radius**2
    return np.stack([disc, bowl, np.ones_like(disc)], axis=-1)
