"""Parts of what differs from a still background, each of which may be a disc, several, a shadow, or none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tracker.camera.lens import Array
from tracker.detection.disc_fit import BLURRED as BLUR

SMALLEST = 3.0  # px, a radius
ALIKE = 0.25  # of a radius: what differs more is no ball
FULL = 0.9  # area over that of an ellipse with its moments
LONGEST = 2.2  # radii, a way during the exposure
SWEPT = 0.8  # of the major moment's root, and BLUR px: a shorter way is the pixels'
HALF, QUARTER = 0.5, 0.25  # of a region's contrast, that a ball has at its rim; one that is lit from one side
LEANS = 1.4  # the long half axis over the short one of a ball of which a dark side is not seen
BESIDE, CAST, LARGE = 0.5, 3.0, 0.1  # radii from a ball, where its shadow's middle is, and of its area, that is seen
Box = tuple[int, ...]


@dataclass(frozen=True, eq=False)
class ContrastRegion:
    """A connected region of about one contrast: its filled mask at ``left``, ``top``, and its moments."""

    mask: NDArray[np.uint8]
    left: int
    top: int
    area: float
    middle: Array
    minor: float  # px, a half axis: the short one; of a ball lit from one side, whose far side is dark, the long one
    full: float  # over the area of the ellipse with its moments
    way: Array  # px (2,), that a disc moved during the exposure to look so
    contrast: float  # counts, the median
    sign: int  # brighter than the background 1, darker -1, either 0
    lean: Array  # (2,): the slope of its contrast over the contrast, a radius

    @property
    def radius(self) -> float:
        """Of the disc, px: of its area what the way has not added."""
        long = float(np.hypot(*self.way))
        if self.sign > 0 and long == 0:
            return self.minor
        return float((np.sqrt(long**2 + np.pi * self.area) - long) / np.pi)

    def is_disc(self, radius: float) -> bool:
        """Whether it looks as one disc of this radius that moved a little."""
        long = float(np.hypot(*self.way))
        sized = abs(self.minor - radius) < ALIKE * radius and abs(self.radius - radius) < ALIKE * radius
        return sized and self.full > FULL and long < LONGEST * radius

    def fill(self, picture: NDArray[np.uint8]) -> None:
        """Set its pixels in a picture (h, w) to 1."""
        own = self.mask[1:-1, 1:-1]
        at = slice(self.top + 1, self.top + 1 + own.shape[0]), slice(self.left + 1, self.left + 1 + own.shape[1])
        picture[at] |= own


def split_region(apart: NDArray[Any], own: NDArray[np.bool_], box: Box, sign: int, low: float) -> list[ContrastRegion]:
    """What in a region's box has half its contrast, or, of one sign, a quarter of it."""
    left, top, width, height, _ = box
    inside = sign * apart if sign else np.abs(apart)
    if sign:
        own = own & (inside > low / 2)
        if not own.any():
            return []
    high = (own & (inside > (QUARTER if sign > 0 else HALF) * np.median(inside[own]))).view(np.uint8)
    outlines, _ = cv2.findContours(np.pad(high, 1), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    parts = []
    for line in outlines:
        mask = np.zeros((height + 2, width + 2), np.uint8)
        cv2.drawContours(mask, [line], -1, 1, cv2.FILLED)
        m = cv2.moments(mask, binaryImage=True)
        if m["m00"] < np.pi * SMALLEST**2:
            continue
        cov = np.array([[m["mu20"], m["mu11"]], [m["mu11"], m["mu02"]]]) / m["m00"]
        (least, most), axes = np.linalg.eigh(cov)
        long = np.sqrt(max(12 * (most - least), 0.0))
        leans = sign > 0 and most < LEANS**2 * least
        way = (long if not leans and long > max(BLUR, SWEPT * np.sqrt(most)) else 0.0) * axes[:, 1]
        middle = np.array([m["m10"], m["m01"]]) / m["m00"] + [left - 1, top - 1]
        if leans:  # the circle about what is lit of a disc is the disc's
            middle = cv2.minEnclosingCircle(line)[0] + np.array([left - 1, top - 1])
        minor = 2 * np.sqrt(max(most if leans else least, 0.0))
        full = float(m["m00"] / (4 * np.pi * np.sqrt(max(least * most, 1e-9))))
        rows, columns = np.nonzero((mask[1:-1, 1:-1] > 0) & own)
        light = inside[rows, columns]
        moments = [np.dot(light, at - at.sum() / max(len(at), 1)) for at in (columns, rows)]
        lean = 4 * np.array(moments) / max(float(light.sum()) * minor, 1e-9)
        contrast = float(np.median(light))
        parts.append(ContrastRegion(mask, left - 1, top - 1, m["m00"], middle, minor, full, way, contrast, sign, lean))
    return parts


def casts_shadow(ball: ContrastRegion, dark: ContrastRegion) -> bool:
    """Whether a darker part lies as the shadow of a ball would."""
    away = float(np.hypot(*(ball.middle - dark.middle))) / ball.minor
    return dark.sign < 0 and BESIDE < away < CAST and dark.area > LARGE * ball.area


def find_disc_centres(part: ContrastRegion, radius: float) -> list[tuple[float, float]]:
    """Where balls' middles may be in a part: the places furthest from its rim, a radius apart at least."""
    balls = round(part.area / (np.pi * radius**2))
    if balls <= 1:
        return [(part.middle[0] - part.left, part.middle[1] - part.top)]
    depth, middles = cv2.distanceTransform(part.mask, cv2.DIST_L2, 5), []
    for _ in range(balls):
        _, deepest, _, (x, y) = cv2.minMaxLoc(depth)
        if deepest < 0.7 * radius:
            break
        middles.append((float(x), float(y)))
        cv2.circle(depth, (x, y), round(1.3 * radius), 0.0, -1)
    return middles
