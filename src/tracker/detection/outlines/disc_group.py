"""Fits several touching discs of known radius together to the outline of one region."""

from collections.abc import Iterator
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from synthcam_shared.arrays import Array, Flags
from tracker.detection.outlines.disc_fit import DiscFit
from tracker.detection.outlines.hidden_disc import fit_circle

Size = tuple[int, ...]


def fit_disc_group(mask: NDArray[np.uint8], corner: tuple[int, int], radius: float, picture: Size) -> list[DiscFit]:
    """Fit two to four touching discs to a region that no single disc explains.

    mask: (h, w), the region without holes, with a rim of one pixel. corner: left and top of the mask in the picture.
    radius: of each disc, px. picture: height and width, where outlines end.

    Each point of the outline belongs to the disc whose circle it is nearest to, and each circle is fitted to its
    points. The two alternate. The result is empty where the union of the discs differs too much from the region, or
    where their convex hull, or a rectangle, is nearer to it. Discs have waists between them, and the streak of one
    has none. The claimed error is the scatter of the outline, because smear shifts neighbouring points by the same.
    """
    min_overlap = 0.85  # area that the union of discs and the region share, over the area that either has
    max_waist = 0.9  # least width over that of the region; one disc in motion has 1
    min_apart = 1.5  # between two centres, radii; encoders smear the outlines of touching discs into each other
    outline = _read_outline(mask, corner, picture)
    rows, columns = np.nonzero(mask)
    points = np.stack([columns, rows], axis=1).astype(float)
    some = points[:: max(len(points) // 500, 1)]
    reach = int(radius) + 2
    region = np.pad(mask, reach) > 0
    y, x = (np.arange(size) + first - reach for size, first in zip(region.shape, corner[::-1], strict=True))
    seen = ((y >= 0) & (y < picture[0]))[:, None] & (x >= 0) & (x < picture[1])
    of_box, waist = _measure_bar(points)
    best, shared, balls = list[DiscFit](), min_overlap, len(points) / (np.pi * radius**2)
    most = min(int(np.ceil(balls)), 4) if waist < max_waist else 0
    for count in range(max(2, int(balls)), most + 1):
        for starts in _list_starts(some, radius, count):
            circles = _fit_circles(outline, _divide(some, starts), radius)
            centres = [centre for centre, _ in circles]
            if not circles or min(np.hypot(*(a - b)) for a, b in combinations(centres, 2)) < min_apart * radius:
                continue
            outer = radius + _measure_smear(outline, np.array(centres), radius)
            within = [centre + reach for centre in centres]
            overlap, of_hull = _measure_overlaps(region, seen, within, outer)
            of_bar = _measure_overlaps(region, seen, within, radius)[1]
            if overlap > max(shared, of_hull, of_bar, of_box):
                shared = overlap
                best = [
                    DiscFit(centre + corner, scatter**2 * np.eye(2), np.zeros((2, 2)), outer, spread=0.0)
                    for centre, scatter in circles
                ]
    return best


def _measure_bar(points: Array) -> tuple[float, float]:
    """The share of its bounding bar that a region covers, and its least width between the ends over that of the bar.

    points: (n, 2), the pixels of the region. The bar may lie at any angle. Its ends are as long as half its width; in a
    streak they are round. Each width is the mean over a tenth of the length. A region that is hardly longer than wide
    is no streak, and gets 0.
    """
    middle, sides, degrees = cv2.minAreaRect(points.astype(np.float32))
    width, length = sorted(np.add(sides, 1.0))
    turn = np.deg2rad(degrees + 90 * (sides[1] > sides[0]))
    along = (points - middle) @ [np.cos(turn), np.sin(turn)]
    places = np.linspace(-1, 1, 15)[:, None] * (length - width) / 2
    widths = np.clip(length / 20 + 0.5 - np.abs(along - places), 0, 1).sum(axis=1) / (length / 10)
    return len(points) / (width * length), float(widths.min()) / width * (length > 1.3 * width)


def _read_outline(mask: NDArray[np.uint8], corner: tuple[int, int], picture: Size) -> Array:
    """Points (n, 2) of the outline of a region within its mask, px, without those at the rim of the picture."""
    lines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outline = np.concatenate(lines)[:, 0].astype(float)
    x, y = (outline + corner).T
    return np.asarray(outline[(x > 1) & (y > 1) & (x < picture[1] - 2) & (y < picture[0] - 2)])


def _list_starts(points: Array, radius: float, count: int) -> Iterator[Array]:
    """Yield first centres (count, 2): along the long axis of the region, then at the corners of a polygon."""
    middle, axes = points.mean(axis=0), np.linalg.eigh(np.cov(points.T))[1]
    yield middle + 1.8 * radius * (np.arange(count) - (count - 1) / 2)[:, None] * axes[:, 1]
    for turn in (0.0, np.pi / count) if count > 2 else ():
        angles = turn + 2 * np.pi * np.arange(count) / count
        yield middle + radius / np.sin(np.pi / count) * np.stack([np.cos(angles), np.sin(angles)], axis=1) @ axes.T


def _divide(points: Array, centres: Array) -> Array:
    """Centres (count, 2) of the parts of a region, each of which is nearest to its own centre (k-means)."""
    for _ in range(10):
        nearest = np.hypot(*(points[:, None] - centres).transpose(2, 0, 1)).argmin(axis=1)
        own = [points[nearest == k] for k in range(len(centres))]
        centres = np.array([part.mean(axis=0) if len(part) else old for part, old in zip(own, centres, strict=True)])
    return centres


def _fit_circles(outline: Array, centres: Array, radius: float) -> list[tuple[Array, float]]:
    """Centre and scatter, px, of circles of known radius through an outline.

    Empty where one has less than a sixth of its outline.
    """
    circles = list[tuple[Array, float]]()
    for _ in range(8):
        off = np.abs(np.hypot(*(outline[:, None] - centres).transpose(2, 0, 1)) - radius)
        own = [outline[off.argmin(axis=1) == k] for k in range(len(centres))]
        if min(map(len, own)) < 2 * np.pi * radius / 6:
            return []
        circles = [fit_circle(part, old, radius) for part, old in zip(own, centres, strict=True)]
        centres = np.array([centre for centre, _ in circles])
    return circles


def _measure_smear(outline: Array, centres: Array, radius: float) -> float:
    """How far an outline lies outside its circles, px: blur and threshold shift all of it by the same."""
    far = np.hypot(*(outline[:, None] - centres).transpose(2, 0, 1)).min(axis=1) + 0.5  # from middles of pixels
    return float(np.clip(np.median(far) - radius, -0.2 * radius, 0.2 * radius))


def _measure_overlaps(region: Flags, seen: Flags, centres: list[Array], radius: float) -> tuple[float, float]:
    """The area that discs and a region share, over the area that either has, among the pixels seen.

    The second number is the same of the convex hull of the discs, which has no waists, as a bar or a streak has none.
    """
    discs = np.zeros(region.shape, np.uint8)
    rows, columns = np.mgrid[: region.shape[0], : region.shape[1]]
    for x, y in centres:
        discs |= np.hypot(columns - x, rows - y) < radius
    angles = np.arange(0, 2 * np.pi, 0.1)
    circle = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    around = cv2.convexHull(np.concatenate([centre + circle for centre in centres]).astype(np.float32))
    hull = cv2.fillConvexPoly(discs.copy(), np.rint(around).astype(np.int32), 1)
    shares = [(region & some).sum() / ((region | some) & seen).sum() for some in (discs > 0, hull > 0)]
    return float(shares[0]), float(shares[1])
