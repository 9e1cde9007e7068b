"""Regions that differ from a still background: distinguishes a disc from several discs, a shadow, or something else."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from synthcam_shared.arrays import Array, Flags

MIN_BLUR_PX = 1.5  # the shortest displacement during the exposure that is fitted; shorter ones do not show
MIN_STREAK_FULLNESS = 0.96
Lit: TypeAlias = tuple[NDArray[Any], Flags]  # contrasts in a box, counts, and which of its pixels count


@dataclass(frozen=True, eq=False)
class ContrastRegion:
    """A connected region of about one contrast, with its moments."""

    mask: NDArray[np.uint8]  # the region with its holes filled, and a rim of one pixel
    left: int  # where the mask lies in the picture, px
    top: int
    area: float  # px^2
    middle: Array  # (2,): centroid, px; of a ball lit from one side that of the smallest circle around it
    minor: float  # short half axis, px; of a ball lit from one side, whose far side is dark, the long one
    fullness: float  # area over that of the ellipse with the same moments
    blur: Array  # (2,): the displacement during the exposure that gives a disc this shape, px
    contrast: float  # median difference from the background, counts
    sign: int  # 1 brighter than the background, -1 darker, 0 either
    lean: Array  # (2,): relative change of its contrast over a radius, the direction from which it is lit

    @property
    def radius(self) -> float:
        """Radius of the disc, px, from the area without that which the blur has added."""
        long = float(np.hypot(*self.blur))
        if self.sign > 0 and long == 0:
            return self.minor
        return float((np.sqrt(long**2 + np.pi * self.area) - long) / np.pi)

    def is_disc(self, radius: float, tolerance: float, elongated: bool = False) -> bool:
        """True if it has the shape of one disc that moved a little.

        radius, tolerance: of the disc, px, and relative to it. elongated: balls look elongated at rest. Their blur and
        the radius without it then mean little.
        """
        smaller = 0.35 if elongated else tolerance
        too_small = radius - self.minor >= tolerance * radius or radius - self.radius >= smaller * radius
        too_large = max(self.minor, self.radius) - radius >= tolerance * radius
        if too_small or too_large or self.fullness <= 0.9:
            return False
        long = float(np.hypot(*self.blur)) / max(radius, 1e-9)
        # Two discs that touch are as long as a streak of 3.5 radii, but have a waist.
        return long < 2.2 or (elongated and long < 3.5 and self.fullness > MIN_STREAK_FULLNESS)

    def is_oblong_disc(self, radius: float, tolerance: float) -> bool:
        """True if it has the size of one disc at rest that a lens, an oblique view or its mount makes a little oblong.

        As a streak it would be of a smaller disc.
        """
        max_axes, min_fullness = 1.35, 0.95  # long half axis over short one
        equal = float(np.sqrt(self.area / np.pi))
        oblong = np.hypot(*self.blur) > 0 and equal**2 < max_axes * self.minor**2
        return bool(oblong and self.fullness > min_fullness and abs(equal / radius - 1) < 0.5 * tolerance)

    @property
    def at(self) -> tuple[slice, slice]:
        """Index of the mask without its rim into the picture."""
        rows, columns = self.mask.shape
        return slice(self.top + 1, self.top + rows - 1), slice(self.left + 1, self.left + columns - 1)

    def fill(self, picture: NDArray[np.uint8]) -> None:
        """Set the region's pixels in a picture (h, w) to 1."""
        picture[self.at] |= self.mask[1:-1, 1:-1]


def split_region(
    apart: NDArray[Any], own: Flags, corner: tuple[int, int], sign: int, low: float, min_radius: float
) -> list[ContrastRegion]:
    """Split a region into parts that have half of its contrast.

    apart: (h, w) differences from the background, counts.
    own: (h, w), the pixels of the region.
    corner: left and top of both in the picture, px.
    sign: 1 takes only what is brighter than the background, -1 what is darker, 0 both. A brighter part may have a
    quarter of the contrast at its rim: it may be a ball that is lit from one side.
    low, min_radius: least contrast, counts, and least radius, px, of a part.
    """
    left, top = corner
    inside = sign * apart if sign else np.abs(apart)
    if sign:
        own = own & (inside > low / 2)
        if not own.any():
            return []
    high = (own & (inside > (0.25 if sign > 0 else 0.5) * np.median(inside[own]))).view(np.uint8)
    outlines, _ = cv2.findContours(np.pad(high, 1), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    parts = []
    for line in outlines:
        x, y, width, height = cv2.boundingRect(line)  # a region may have many parts, each far smaller than its box
        mask = np.zeros((height + 2, width + 2), np.uint8)
        line = line - np.array([x - 1, y - 1], dtype=line.dtype)
        cv2.drawContours(mask, [line], -1, 1, cv2.FILLED)
        moments = cv2.moments(mask, binaryImage=True)
        if moments["m00"] >= np.pi * min_radius**2:
            here = slice(y - 1, y - 1 + height), slice(x - 1, x - 1 + width)
            lit = inside[here], (mask[1:-1, 1:-1] > 0) & own[here]
            parts.append(_measure_part(line, mask, moments, lit, (left + x - 2, top + y - 2), sign))
    return parts


def _measure_part(
    line: NDArray[Any], mask: NDArray[np.uint8], m: Mapping[str, float], lit: Lit, corner: tuple[int, int], sign: int
) -> ContrastRegion:
    """The part within an outline, by its mask, the moments of the mask, and the contrast at its pixels."""
    max_lean_ratio = 1.4  # long half axis over short one of a ball whose dark side does not show
    min_blur_share = 0.8  # of the long axis' standard deviation; a shorter blur is an effect of the pixels
    cov = np.array([[m["mu20"], m["mu11"]], [m["mu11"], m["mu02"]]]) / m["m00"]
    (least, most), axes = np.linalg.eigh(cov)
    long = np.sqrt(max(12 * (most - least), 0.0))
    leans = sign > 0 and most < max_lean_ratio**2 * least
    moved = not leans and long > max(MIN_BLUR_PX, min_blur_share * np.sqrt(most))
    minor = 2 * np.sqrt(max(most if leans else least, 0.0))
    inside, shown = lit
    rows, columns = np.nonzero(shown)
    light = inside[rows, columns]
    moments = [np.dot(light, at - at.sum() / max(len(at), 1)) for at in (columns, rows)]
    # the circle around the lit part of a disc is that of the disc
    middle = np.array(cv2.minEnclosingCircle(line)[0]) if leans else np.array([m["m10"], m["m01"]]) / m["m00"]
    return ContrastRegion(
        mask=mask,
        left=corner[0],
        top=corner[1],
        area=m["m00"],
        middle=middle + np.array(corner),
        minor=minor,
        fullness=float(m["m00"] / (4 * np.pi * np.sqrt(max(least * most, 1e-9)))),
        blur=(long if moved else 0.0) * axes[:, 1],
        contrast=float(np.median(light)),
        sign=sign,
        lean=4 * np.array(moments) / max(float(light.sum()) * minor, 1e-9),
    )


def casts_shadow(ball: ContrastRegion, dark: ContrastRegion) -> bool:
    """True if a darker region lies where the shadow of a ball would: its middle half a radius to three radii away."""
    away = float(np.hypot(*(ball.middle - dark.middle))) / ball.minor
    return dark.sign < 0 and 0.5 < away < 3.0 and dark.area > 0.1 * ball.area


def find_disc_centres(region: ContrastRegion, radius: float) -> list[tuple[float, float]]:
    """Possible centres (x, y) of balls in a region: the points furthest from its rim, a radius apart at least."""
    balls = round(region.area / (np.pi * radius**2))
    if balls <= 1:
        return [(region.middle[0] - region.left, region.middle[1] - region.top)]
    return _find_deepest(cv2.distanceTransform(region.mask, cv2.DIST_L2, 5), balls, 0.7 * radius, 1.3 * radius)


def _find_deepest(depth: NDArray[Any], most: int, least: float, apart: float) -> list[tuple[float, float]]:
    """The deepest points (x, y), at least so deep and so far apart, px; `depth` (h, w) is cleared around them."""
    found = list[tuple[float, float]]()
    for _ in range(most):
        _, deepest, _, (x, y) = cv2.minMaxLoc(depth)
        if deepest < least:
            break
        found.append((float(x), float(y)))
        cv2.circle(depth, (x, y), round(apart), 0.0, -1)
    return found


def find_touching_discs(own: NDArray[Any]) -> tuple[float, list[tuple[float, float]]]:
    """Radius, px, and centres (x, y) of the discs of one size that touch in a region; none if it is anything else.

    own: (h, w), the pixels of the region. The centres are the points furthest from its rim. Between two neighbours the
    region has a waist, which a bar lacks. The discs have the area of the region, which they have not in a hand.
    """
    most, nothing = 8, (0.0, list[tuple[float, float]]())
    depth = cv2.distanceTransform(np.pad(own, 1).astype(np.uint8), cv2.DIST_L2, 5)
    radius = float(depth.max()) - 0.5  # the rim is half a pixel within the first pixel outside
    centres = _find_deepest(depth.copy(), most + 1, 0.8 * radius, 1.4 * radius)
    if not 2 <= len(centres) <= most or abs(float(own.sum()) / (len(centres) * np.pi * radius**2) - 1) > 0.2:
        return nothing
    for i, one in enumerate(centres):
        for two in centres[:i]:
            apart = float(np.hypot(one[0] - two[0], one[1] - two[1])) / radius
            x, y = round((one[0] + two[0]) / 2), round((one[1] + two[1]) / 2)
            if apart < 1.6 or (apart < 2.4 and depth[y, x] > 0.65 * radius):
                return nothing
    return radius, [(x - 1, y - 1) for x, y in centres]
