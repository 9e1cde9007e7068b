"""Fits a circle of known radius to the outline of a disc that is partly hidden."""

from typing import TypeAlias

import cv2
import numpy as np

from synthcam_shared.arrays import Array
from tracker.detection.outlines.disc_fit import Picture, quick_median

Point: TypeAlias = tuple[float, float]
_ONES = np.eye(2)


def fit_outline_circle(
    frame: Picture, level: Picture, at: Point, radius: float, others: list[Point], low: float
) -> Array | None:
    """Fit a circle to the outline of a hidden disc, which is where rays from the middle cross half the contrast.

    frame, level (h, w): a frame and the background.
    at: the approximate centre, px.
    others: the positions of balls that touch this one, px.
    low: the least contrast, counts.

    The result is the centre (2,), px; None where less than .55 of the outline is visible, or .3 where other balls
    touch.
    """
    rays, step = 72, 0.25  # number of rays; distance of the points along a ray, px
    h, w = frame.shape
    angles = 2 * np.pi * np.arange(rays) / rays
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    middle, scatter = np.array(at), np.inf
    for first, last in ((0.3, 1.6), (0.5, 1.5), (0.5, 1.5)):
        far = np.arange(first * radius, last * radius, step)
        points = middle + far[:, None, None] * directions
        light, ground = _at(frame, points), _at(level, points)
        contrast = quick_median(light[far < 0.7 * radius].ravel()) - ground  # of a pixel that the ball covers fully
        cover = (light - ground) / np.where(np.abs(contrast) < low, np.inf, contrast)
        over = cover > 0.5
        outermost = len(far) - 1 - np.argmax(over[::-1], axis=0)
        edge = over.any(axis=0) & (outermost < len(far) - 1)
        inner, outer = cover[outermost, range(rays)], cover[np.minimum(outermost + 1, len(far) - 1), range(rays)]
        length = far[outermost] + step * (inner - 0.5) / np.maximum(inner - outer, 1e-9)
        tips = middle + length[:, None] * directions
        edge &= ((tips > 1) & (tips < [w - 2, h - 2])).all(axis=1)
        for other in others:
            edge &= np.hypot(*(tips - other).T) > 1.05 * radius
        if edge.sum() < (0.3 if others else 0.55) * rays:
            return None
        middle, scatter = fit_circle(tips[edge], middle, radius)
    return middle if scatter < 0.1 * radius else None  # an outline that scatters more is no ball's


def _at(picture: Picture, points: Array) -> Array:
    """A picture interpolated at points (..., 2) px; 0 outside."""
    x, y = (points[..., k].astype(np.float32) for k in (0, 1))
    return np.asarray(cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0))


def fit_circle(points: Array, start: Array, radius: float) -> tuple[Array, float]:
    """Centre (2,) of a circle of known radius through points (n, 2), and their scatter, px; with Huber's weights."""
    middle, scatter = start.astype(float), 1.0
    for _ in range(12):
        off_centre = points - middle
        far = np.maximum(np.hypot(off_centre[:, 0], off_centre[:, 1]), 1e-9)
        off, slope = far - radius, off_centre / far[:, None]
        off = off - quick_median(off)  # blur and threshold shift the whole outline by the same
        scatter = max(1.4826 * quick_median(np.abs(off)), 1e-3)
        weight = np.minimum(1.0, 1.5 * scatter / np.maximum(np.abs(off), 1e-12))
        pull = weight[:, None] * slope
        (xx, xy), (_, yy) = slope.T @ pull + 1e-9 * _ONES
        fx, fy = off @ pull
        step = np.array([yy * fx - xy * fy, xx * fy - xy * fx]) / (xx * yy - xy * xy)
        middle = middle + step
        if np.hypot(*step) < 1e-4:
            break
    return middle, scatter
