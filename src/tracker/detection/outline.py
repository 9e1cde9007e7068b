"""A circle of known radius through the outline of a disc of which a part only is seen."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tracker.camera.lens import Array

Picture = NDArray[np.floating[Any]]
RAYS = 72  # along which the outline is looked for
STEP = 0.25  # px along a ray
ALIKE = 0.1  # of a radius: outlines that scatter more about a circle are no ball's
SEEN, TOUCHING = 0.55, 0.3  # of the rays, at least; of a ball that touches another
SURE = 1.5  # noise deviations of an outline point off its circle beyond which it counts less (Huber)
TURNS = 12
ANGLES = 2 * np.pi * np.arange(RAYS) / RAYS
WAYS = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)


def fit_outline_circle(
    frame: Picture, level: Array, at: tuple[float, float], radius: float, others: list[tuple[float, float]], low: float
) -> Array | None:
    """Centre (2,) px of the circle through the outline, at half the contrast along rays; None where there is none.

    Parameters
    ----------
    frame, level : (h, w) array
        A frame, and the background.
    at : (x, y)
        About where, px.
    radius : float
        px.
    others : list of (x, y)
        Places of balls that touch this one.
    low : float
        Counts, the least contrast.
    """
    h, w = frame.shape
    middle, scatter = np.array(at), np.inf
    for first, last in ((0.3, 1.6), (0.5, 1.5), (0.5, 1.5)):
        far = np.arange(first * radius, last * radius, STEP)
        points = middle + far[:, None, None] * WAYS
        light, ground = _at(frame, points), _at(level, points)
        contrast = float(np.median(light[far < 0.7 * radius])) - ground  # were all of the pixel the ball's
        cover = (light - ground) / np.where(np.abs(contrast) < low, np.inf, contrast)
        over = cover > 0.5
        outermost = len(far) - 1 - np.argmax(over[::-1], axis=0)
        edge = over.any(axis=0) & (outermost < len(far) - 1)
        inner, outer = cover[outermost, range(RAYS)], cover[np.minimum(outermost + 1, len(far) - 1), range(RAYS)]
        length = far[outermost] + STEP * (inner - 0.5) / np.maximum(inner - outer, 1e-9)
        tips = middle + length[:, None] * WAYS
        edge &= ((tips > 1) & (tips < [w - 2, h - 2])).all(axis=1)
        for other in others:
            edge &= np.hypot(*(tips - other).T) > 1.05 * radius
        if edge.sum() < (TOUCHING if others else SEEN) * RAYS:
            return None
        middle, scatter = _circle(tips[edge], middle, radius)
    return middle if scatter < ALIKE * radius else None


def _at(picture: Picture, points: Array) -> Array:
    """A picture between its pixels, at points (..., 2) px; 0 outside."""
    x, y = (points[..., k].astype(np.float32) for k in (0, 1))
    return np.asarray(cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0))


def _circle(points: Array, start: Array, radius: float) -> tuple[Array, float]:
    """Centre (2,) of a circle of known radius through points (n, 2), their scatter about it, px; by Huber's weights."""
    middle, scatter = start.astype(float), 1.0
    for _ in range(TURNS):
        way = points - middle
        far = np.maximum(np.hypot(way[:, 0], way[:, 1]), 1e-9)
        off, slope = far - radius, way / far[:, None]
        off = off - np.median(off)  # blur and threshold shift the whole outline alike
        scatter = max(1.4826 * float(np.median(np.abs(off))), 1e-3)
        weight = np.minimum(1.0, SURE * scatter / np.maximum(np.abs(off), 1e-12))
        step = np.linalg.solve(slope.T @ (weight[:, None] * slope) + 1e-9 * np.eye(2), slope.T @ (weight * off))
        middle = middle + step
        if np.hypot(*step) < 1e-4:
            break
    return middle, scatter
