"""Discs on a still background: matte, coloured, dark or bright balls, and pucks, seen by their outlines."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from tracker.camera.lens import Array
from tracker.detection.glints import EDGE, NEAR, Glints, View
from tracker.detection.still_background import still_background

RAYS = 72  # along which the outline is looked for
STEP = 0.25  # px along a ray
LEAST_CONTRAST = 8.0  # counts, and noise deviations, of a ball over the background
SMALLEST = 3.0  # px, a radius
ALIKE = 0.15  # of a radius: outlines that differ more from a circle are no ball's
SEEN = 0.55  # of the rays, at least; and of a ball that touches another
TOUCHING = 0.3
ROUND = 0.75  # area over that of the circle around it, of a region taken for one whole ball
SURE = 1.5  # noise deviations of an outline point off its circle beyond which it counts less (Huber)
TURNS = 12  # of a fit
RING = 3.0  # px on either side of the outline, of the pixels that tell the place


class Discs:
    """Circles through the outlines of what differs from the still background, at half the contrast along rays."""

    point: ClassVar[str] = "centre"

    def __init__(self, view: View) -> None:
        self.view = view
        self.background, self.known = still_background(view.frames, view.plate.noise)
        self.low = max(LEAST_CONTRAST * view.plate.noise, LEAST_CONTRAST)
        self.radius = view.camera.diameter_px / 2 if view.camera.knows_diameter else self._usual_radius()
        turns = 2 * np.pi * np.arange(RAYS) / RAYS
        self.rays = np.stack([np.cos(turns), np.sin(turns)], axis=1)

    def many(self, frames: Iterable[tuple[int, NDArray[Any]]]) -> Glints:
        """Discs of all frames."""
        parts = []
        for number, frame in frames:
            found = self(frame)
            parts.append(Glints(np.full(len(found), number, np.int64), *(getattr(found, n) for n in _REST)))
        return Glints.join(parts)

    def __call__(self, frame: NDArray[Any]) -> Glints:
        """Discs of one frame; ``flux`` is their area, px^2, which balls of one size share."""
        light = frame.astype(np.float64)
        regions, labels = self._regions(np.abs(light - self.background))
        rows = [row for region in regions for row in self._in_region(light, labels, *region)]
        if not rows:
            return Glints.none()
        x, y, xx, xy, yy, flags = np.array(rows).T
        cov = np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2)
        nothing = np.zeros(len(rows))
        area = np.full(len(rows), np.pi * self.radius**2)
        return Glints(np.zeros(len(rows), np.int64), x, y, cov, area, nothing, flags.astype(np.int64))

    def _regions(self, apart: Array) -> tuple[list[tuple[int, tuple[int, ...]]], NDArray[np.int32]]:
        """Connected regions that differ from the background: number and box; and the picture of their numbers."""
        mask = (apart > self.low).view(np.uint8)
        closed = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
        opened = cv2.morphologyEx(closed, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
        count, labels, boxes, _ = cv2.connectedComponentsWithStats(opened, connectivity=4)
        return [(k, tuple(boxes[k].tolist())) for k in range(1, count)], np.asarray(labels, dtype=np.int32)

    def _usual_radius(self) -> float:
        """Of the round regions in frames spread over the film, px; their median."""
        radii, frames = [], self.view.frames
        for k in np.linspace(0, len(frames) - 1, 25).astype(int).tolist():
            apart = np.abs(frames[k] - self.background)
            regions, labels = self._regions(apart)
            for region, (left, top, width, height, area) in regions:
                inside = left > 0 and top > 0 and left + width < apart.shape[1] and top + height < apart.shape[0]
                whole = area > ROUND * np.pi / 4 * max(width, height) ** 2
                if inside and whole and area > np.pi * SMALLEST**2:
                    light = apart[labels == region]
                    radii.append(np.sqrt((light > 0.5 * np.median(light)).sum() / np.pi))
        return float(np.median(radii)) if radii else self.view.camera.diameter_px / 2

    def _in_region(
        self, light: Array, labels: NDArray[np.int32], number: int, box: tuple[int, ...]
    ) -> list[tuple[float, ...]]:
        """Discs of one region, (x, y, xx, xy, yy, flags): one, or more where balls touch in the picture."""
        left, top, width, height, area = box
        whole = np.pi * self.radius**2
        cut = left == 0 or top == 0 or left + width == light.shape[1] or top + height == light.shape[0]
        if not (0.3 if cut else 0.5) * whole < area < 6 * whole or min(width, height) < SMALLEST:
            return []
        own = np.pad((labels[top : top + height, left : left + width] == number).view(np.uint8), 1)
        middles = self._middles(own, round(area / whole))
        middles = [(x + left - 1, y + top - 1) for x, y in middles]
        found = [self._circle(light, at, [m for m in middles if m != at]) for at in middles]
        return [f for f in found if f is not None]

    def _middles(self, own: NDArray[np.uint8], balls: int) -> list[tuple[float, float]]:
        """Where balls' middles may be in a region: the places furthest from its rim, a radius apart at least."""
        if balls <= 1:
            rows, columns = np.nonzero(own)
            return [(float(columns.mean()), float(rows.mean()))]
        depth, middles = cv2.distanceTransform(own, cv2.DIST_L2, 5), []
        for _ in range(balls):
            _, deepest, _, (x, y) = cv2.minMaxLoc(depth)
            if deepest < 0.5 * self.radius:
                break
            middles.append((float(x), float(y)))
            cv2.circle(depth, (x, y), round(1.3 * self.radius), 0.0, -1)
        return middles

    def _circle(
        self, frame: Array, at: tuple[float, float], others: list[tuple[float, float]]
    ) -> tuple[float, ...] | None:
        """The circle of the known radius through the outline around a place; None where there is none."""
        h, w = frame.shape
        middle, fitted = np.array(at), None
        for reach in ((0.3, 1.6), (0.5, 1.5), (0.5, 1.5)):
            far = np.arange(reach[0] * self.radius, reach[1] * self.radius, STEP)
            points = middle + far[:, None, None] * self.rays
            light, ground = _at(frame, points), _at(self.background, points)
            within = far < 0.7 * self.radius
            contrast = float(np.median(light[within])) - ground  # were all of the pixel the ball's
            cover = (light - ground) / np.where(np.abs(contrast) < self.low, np.inf, contrast)
            over = cover > 0.5
            last = len(far) - 1 - np.argmax(over[::-1], axis=0)  # the outermost step still over half
            edge = over.any(axis=0) & (last < len(far) - 1)
            high, low = cover[last, range(RAYS)], cover[np.minimum(last + 1, len(far) - 1), range(RAYS)]
            length = far[last] + STEP * (high - 0.5) / np.maximum(high - low, 1e-9)
            tips = middle + length[:, None] * self.rays
            edge &= ((tips > 1) & (tips < [w - 2, h - 2])).all(axis=1)
            for other in others:
                edge &= np.hypot(*(tips - other).T) > 1.05 * self.radius
            if edge.sum() < (TOUCHING if others else SEEN) * RAYS:
                return None
            fitted = _fixed_circle(tips[edge], middle, self.radius)
            middle = fitted[0]
        assert fitted
        if fitted[2] > ALIKE * self.radius:
            return None
        place, cov = self._edge(frame, middle, fitted[3], others)
        whole = ((place > self.radius) & (place < np.array([w, h]) - 1 - self.radius)).all()
        flags = (NEAR if others else 0) | (0 if whole else EDGE)
        return place[0], place[1], cov[0, 0], cov[0, 1], cov[1, 1], flags

    def _edge(
        self, frame: Array, middle: Array, offset: float, others: list[tuple[float, float]]
    ) -> tuple[Array, Array]:
        """Place (2,) and covariance of a disc by least squares over the pixels at its edge.

        Fitted are place, radius, the edge's width and the ball's brightness there; Huber's weights, errors from the
        residuals.
        """
        radius = self.radius + offset
        reach = int(radius + RING + 2)
        column, row = np.round(middle).astype(int)
        rows, columns = np.mgrid[row - reach : row + reach + 1, column - reach : column + reach + 1]
        far = np.hypot(columns - middle[0], rows - middle[1])
        used = (np.abs(far - radius) < RING) & (rows > 0) & (columns > 0)
        used &= (rows < frame.shape[0] - 1) & (columns < frame.shape[1] - 1)
        for x, y in others:
            used &= np.hypot(columns - x, rows - y) > self.radius + RING
        used[used] = self.known[rows[used], columns[used]]
        y, x = rows[used], columns[used]
        ground, light = self.background[y, x].astype(float), frame[y, x].astype(float)
        ball = float(np.median(light[far[used] < radius - 0.5 * RING]))
        now = np.array([*middle, radius, 1.0, ball])
        for _ in range(TURNS):
            way = np.stack([x - now[0], y - now[1]])
            r = np.hypot(*way)
            z = (r - now[2]) / now[3]
            cover, density = ndtr(-z), np.exp(-z * z / 2) / np.sqrt(2 * np.pi) / now[3]
            slope = (now[4] - ground) * density * np.stack([*(way / r), np.ones_like(r), z])
            slopes = np.concatenate([slope, cover[None]])
            left = light - ground - (now[4] - ground) * cover
            scatter = max(1.4826 * float(np.median(np.abs(left))), 0.3)
            weight = np.minimum(1.0, SURE * scatter / np.maximum(np.abs(left), 1e-12))
            normal = (slopes * weight) @ slopes.T + 1e-9 * np.eye(5)
            step = np.linalg.solve(normal, slopes @ (weight * left))
            now = now + np.clip(step, -0.5, [0.5, 0.5, 0.5, 0.5, np.inf])
            now[3] = np.clip(now[3], 0.3, RING)
            if np.abs(step[:2]).max() < 1e-4:
                break
        spread = float(np.sqrt((weight * left**2).sum() / max(weight.sum() - 5, 1.0)))
        if np.hypot(*(now[:2] - middle)) > 1.0:
            return middle, np.eye(2)
        return now[:2], np.linalg.inv(normal)[:2, :2] * spread**2


_REST = ("x", "y", "cov", "flux", "background", "flags", "fixed")


def _at(picture: Array, points: Array) -> Array:
    """A picture between its pixels, at points (..., 2) px; 0 outside."""
    x, y = (points[..., k].astype(np.float32) for k in (0, 1))
    return np.asarray(cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0))


def _fixed_circle(points: Array, start: Array, radius: float) -> tuple[Array, Array, float, float]:
    """Centre (2,) of a circle of known radius through points (n, 2), its covariance, their scatter and offset, px.

    Huber's weights; neighbouring points of an outline share their errors, so that as many count as pixels lie on it.
    """
    middle, scatter = start.astype(float), 1.0
    for _ in range(TURNS):
        way = points - middle
        far = np.maximum(np.hypot(way[:, 0], way[:, 1]), 1e-9)
        off, slope = far - radius, way / far[:, None]
        offset = float(np.median(off))  # blur and threshold shift the whole outline alike
        off = off - offset
        scatter = max(1.4826 * float(np.median(np.abs(off))), 1e-3)
        weight = np.minimum(1.0, SURE * scatter / np.maximum(np.abs(off), 1e-12))
        normal = slope.T @ (weight[:, None] * slope)
        step = np.linalg.solve(normal + 1e-9 * np.eye(2), slope.T @ (weight * off))
        middle = middle + step
        if np.hypot(*step) < 1e-4:
            break
    shared = max(len(points) / (2 * np.pi * radius), 1.0)
    cov = np.linalg.inv(normal + 1e-9 * np.eye(2)) * scatter**2 * shared + 1e-6 * np.eye(2)
    return middle, cov, scatter, offset
