"""Fits many touching discs of known radius together to the pixels of one region, as of balls in a rack."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from synthcam_shared.arrays import Array, Flags
from tracker.detection.background.windows import find_regions
from tracker.detection.outlines.contrast_regions import ContrastRegion
from tracker.detection.outlines.disc_fit import DiscFit

Floats = NDArray[np.floating[Any]]
MAX_DISCS = 24  # of one region
MAX_RADIUS = 1.1  # of a disc, over the common one
EDGE_WIDTH_PX = 1.0  # over which the edge of a disc fades; a plane that saturates has edges as steep as a pixel
ENLARGEMENT_PX = 1.2  # of a radius: a plane that saturates shows a pixel that a ball covers by a tenth
SHRINKAGE_PX = 0.8  # of the radius of a dark ball whose rim hardly differs from the plate, where no larger one fits
CONTACT_BONUS = 0.2  # of the score of a first centre, for each disc that it touches: gaps of a rack hardly show
RADIUS_SPREAD = 0.1  # standard deviation of the radii, relative: a disc of more contrast looks larger


def estimate_least_distance(radius: float, diameter: float | None) -> float:
    """Estimate the least distance of two centres, px, in a plane that shows discs about a pixel too large.

    radius: of discs in the plane, px. diameter: of the balls, px, where it is known.
    """
    return diameter if diameter is not None else max(2 * (radius - ENLARGEMENT_PX), 1.5 * radius)


def pack_region(region: ContrastRegion, cover: Floats, radius: float, apart: float) -> list[DiscFit]:
    """Fit touching discs to a region of a picture, as `fit_disc_packing`.

    cover: (h, w) of the whole picture, the share of each pixel that discs cover. Pixels further than one from the
    region count as bare. Dim ones in its holes count as covered by more than half: a ball may have dim parts. A ball
    that hardly differs from the plate belongs to the region that it touches.
    """
    least = 0.12  # share of a dim pixel, above that of noise
    rows, columns = region.at
    margin = int(np.ceil(apart)) + 2
    top, left = max(rows.start - margin, 0), max(columns.start - margin, 0)
    at = slice(top, rows.stop + margin), slice(left, columns.stop + margin)
    shown = np.ascontiguousarray(cover[at], np.float32)
    own = np.zeros(shown.shape, np.uint8)
    own[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left] = region.mask[1:-1, 1:-1]
    near = cv2.dilate(own, np.ones((3, 3), np.uint8))
    smooth = np.asarray(cv2.blur(shown, (3, 3)), np.float32)
    filled = np.maximum(shown * near, 0.6 * (own & (smooth > least)))
    whole = np.maximum(filled, _find_faint_parts(shown, smooth, own, apart))
    return fit_disc_packing(whole, (left, top), radius, apart)


def _find_faint_parts(shown: Floats, smooth: Floats, own: NDArray[np.uint8], apart: float) -> NDArray[np.float32]:
    """Find what touches a region and is as faint as a ball of nearly the plate's colour: 1 there, 0 elsewhere.

    shown, smooth: (h, w) shares, and their means over 3 x 3 pixels. own: the pixels of the region.
    """
    least, least_width_px = 0.2, 5  # share, above that of the plate beside coloured balls; of what is no blurred rim
    rim = cv2.dilate(own, np.ones((5, 5), np.uint8))
    others = np.zeros_like(own)
    for other in find_regions((shown > 0.5) & (rim == 0), 0.25 * np.pi * (apart / 2) ** 2):
        others[other.at] |= other.own
    beside = cv2.dilate(others, np.ones((5, 5), np.uint8))
    faint = ((smooth > least) & (rim == 0) & (beside == 0)).view(np.uint8)
    element = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (least_width_px, least_width_px))
    wide = cv2.morphologyEx(cv2.morphologyEx(faint, cv2.MORPH_OPEN, element), cv2.MORPH_CLOSE, element)
    touching = np.zeros(own.shape, np.float32)
    for part in find_regions((wide > 0) | (rim > 0), 0):
        if own[part.at][part.own].any():
            touching[part.at][part.own] = wide[part.at][part.own]
    # the rim was left out: the closing fills it where a faint part lies behind it
    filled = cv2.morphologyEx(np.maximum(touching, own), cv2.MORPH_CLOSE, element)
    return np.asarray(np.where(cv2.dilate(touching, np.ones((7, 7), np.uint8)) > 0, filled, 0), np.float32)


def fit_disc_packing(cover: Floats, corner: tuple[int, int], radius: float, apart: float) -> list[DiscFit]:
    """Fit up to `MAX_DISCS` touching discs to a region.

    cover: (h, w), the share of each pixel that discs cover, 0 to 1, and 0 outside the region.
    corner: left and top of it in the picture.
    radius: of each disc, px.
    apart: the least distance of two centres, px; less than two radii where a plane shows discs larger than they are.

    First centres are those whose discs lie in the region, cover pixels that no other disc covers, and follow the
    outline of the region. Then all centres and radii are fitted to the pixels by least squares. The result is empty

    - where the discs and the region differ too much;
    - where the convex hull of the region is nearer to it, as to a bar;
    - where two discs overlap.

    No disc is smaller than a ball, unless no other fit explains the region.
    """
    of_few, of_many, many = 0.9, 0.87, 6  # least area that discs and region share, over that of either; number of discs
    reach = int(np.ceil(1.3 * radius)) + 2
    padded = np.pad(np.clip(cover, 0.0, 1.0), reach).astype(np.float32)
    largest = MAX_DISCS * np.pi * ((MAX_RADIUS * radius) ** 2 + EDGE_WIDTH_PX**2)  # area of all discs, px^2
    if of_many * padded[padded > 0.5].sum() > largest:  # as of a person; the search would take seconds
        return []
    centres = _find_first_centres(padded > 0.5, radius, apart)
    if len(centres) < 2 or len(centres) > MAX_DISCS:
        return []
    rows, columns = np.nonzero(cv2.dilate((padded > 0.1).view(np.uint8), np.ones((5, 5), np.uint8)))
    pixels = _Pixels(columns.astype(float), rows.astype(float), padded[rows, columns].astype(float))
    starts = np.column_stack([centres, np.full(len(centres), radius)])
    min_overlap = max(of_few if len(centres) < many else of_many, _measure_solidity(padded > 0.5))
    for shrinkage in (0.0, SHRINKAGE_PX):
        fit = _fit_discs(pixels, starts, radius, apart, apart / 2 - shrinkage)
        if fit.overlap >= min_overlap and fit.least_distance >= 0.83 * apart:
            break
    else:
        return []
    shift = np.subtract(corner, reach)
    return [
        DiscFit(disc[:2] + shift, cov, np.zeros((2, 2)), float(disc[2]), spread=0.0)
        for disc, cov in zip(fit.discs, fit.covariances, strict=True)
    ]


def _measure_solidity(mask: Flags) -> float:
    """The area of a region over that of its convex hull: a bar has no waists, as discs that touch have."""
    points = np.argwhere(mask)[:, ::-1].astype(np.int32)
    hull = cv2.fillConvexPoly(np.zeros(mask.shape, np.uint8), cv2.convexHull(points), 1)
    return float(mask.sum() / hull.sum())


def _make_disc(radius: float) -> NDArray[np.float32]:
    """A kernel with the distances of its pixels from the middle, px."""
    reach = int(np.ceil(radius)) + 1
    away: NDArray[np.float32] = np.hypot(*np.mgrid[-reach : reach + 1, -reach : reach + 1]).astype(np.float32)
    return away


def _find_first_centres(mask: Flags, radius: float, apart: float) -> Array:
    """Centres (n, 2), px: one after the other, where a disc explains the most pixels and outline still unexplained."""
    min_uncovered = 0.7  # share of a disc that no other disc covers
    min_inside, min_faint_inside = 0.93, 0.8  # share of a disc in the region; of one whose rim may not show
    edge = 1.2  # px, from an outline that a disc explains
    away = _make_disc(radius + edge)
    core = (away < 0.42 * apart).astype(np.float32)
    whole = (away < apart / 2).astype(np.float32)
    ring = ((away > apart / 2 - 1) & (away < radius + 0.75)).astype(np.float32)
    ring /= 2 * np.pi * radius
    free = mask.astype(np.float32)
    inside = cv2.filter2D(free, -1, core / core.sum(), borderType=cv2.BORDER_CONSTANT)
    least = min_inside
    eroded = cv2.erode(mask.view(np.uint8), np.ones((3, 3), np.uint8)) > 0
    outline = (mask & ~eroded).astype(np.float32)
    rows, columns = np.mgrid[: mask.shape[0], : mask.shape[1]]
    centres, contacts = list[tuple[int, int]](), np.zeros(mask.shape)
    while len(centres) <= MAX_DISCS:
        uncovered = cv2.filter2D(free, -1, whole / whole.sum(), borderType=cv2.BORDER_CONSTANT)
        support = cv2.filter2D(outline, -1, ring, borderType=cv2.BORDER_CONSTANT)
        score = uncovered + support + CONTACT_BONUS * contacts
        _, best, _, (x, y) = cv2.minMaxLoc(np.where((inside >= least) & (uncovered > min_uncovered), score, 0.0))
        if best <= 0 and least == min_inside:
            least = min_faint_inside
            continue
        if best <= 0:
            break
        centres.append((x, y))
        far = np.hypot(columns - x, rows - y)
        contacts += np.exp(-0.5 * ((far - apart) / (0.06 * apart)) ** 2)
        free[far < apart / 2] = 0
        outline[far < radius + edge] = 0
        inside[far <= 0.85 * apart] = 0  # first centres are a pixel off
    return np.array(centres, float).reshape(-1, 2)


@dataclass(frozen=True, eq=False)
class _Pixels:
    """The pixels of a region and around it."""

    x: Array
    y: Array
    cover: Array  # share that discs cover


@dataclass(frozen=True, eq=False)
class _PackingFit:
    """Result of the fit of all discs of a region."""

    discs: Array  # (n, 3): x, y, radius, px
    covariances: Array  # (n, 2, 2): px^2
    overlap: float  # area that the discs and the region share, over the area that either has
    least_distance: float  # of two centres, px


def _fit_discs(pixels: _Pixels, discs: Array, radius: float, apart: float, min_radius: float) -> _PackingFit:
    """Fit centres and radii by Gauss-Newton steps; radii are tied to the common one, and discs repel."""
    largest_step, turns = 0.5, 12  # px
    count, prior = len(discs), 1 / (RADIUS_SPREAD * radius) ** 2
    tie = np.tile([0.0, 0.0, prior], count)
    normal, variance, model = np.eye(3 * count), 1.0, pixels.cover
    for _ in range(turns):
        model, slopes = _render(pixels, discs)
        off = pixels.cover - model
        variance = max(float(np.mean(off**2)), 1e-4)
        normal = slopes @ slopes.T / variance + np.diag(tie) + 1e-6 * np.eye(3 * count)
        pull = slopes @ off / variance - tie * (discs - [0.0, 0.0, radius]).ravel()
        stiffness, push = _repel(discs, apart, _measure_stiffness(radius) / variance)
        normal, pull = normal + stiffness, pull + push
        step = np.linalg.solve(normal, pull).reshape(-1, 3)
        discs = discs + np.clip(step, -largest_step, largest_step)
        # none grows over gaps that do not show
        discs[:, 2] = np.clip(discs[:, 2], min_radius, MAX_RADIUS * radius)
        if np.abs(step).max() < 0.01:
            break
    blocks = np.linalg.inv(normal).reshape(count, 3, count, 3)
    covariances = np.array([blocks[k, :2, k, :2] for k in range(count)])
    both, either = np.minimum(model, pixels.cover).sum(), np.maximum(model, pixels.cover).sum()
    away = np.hypot(*(discs[:, None, :2] - discs[None, :, :2]).transpose(2, 0, 1))
    least_distance = float(away[~np.eye(count, dtype=bool)].min())
    return _PackingFit(discs, covariances, float(both / either), least_distance)


def _render(pixels: _Pixels, discs: Array) -> tuple[Array, Array]:
    """The share of each pixel that discs cover, and its derivatives (3 n, pixels) by x, y and radius of each disc."""
    dx, dy = pixels.x - discs[:, :1], pixels.y - discs[:, 1:2]
    far = np.maximum(np.hypot(dx, dy), 1e-6)
    share = np.clip(0.5 + (discs[:, 2:] - far) / (2 * EDGE_WIDTH_PX), 0.0, 1.0)
    steep = np.where((share > 0) & (share < 1), 1 / (2 * EDGE_WIDTH_PX), 0.0)
    bare = 1 - share
    before = np.cumprod(np.vstack([np.ones(len(pixels.x)), bare[:-1]]), axis=0)
    after = np.cumprod(np.vstack([np.ones(len(pixels.x)), bare[:0:-1]]), axis=0)[::-1]
    others = before * after * steep
    slopes = np.stack([others * dx / far, others * dy / far, others], axis=1).reshape(-1, len(pixels.x))
    return 1 - bare.prod(axis=0), slopes


def _measure_stiffness(radius: float) -> float:
    """Element of the normal matrix, px^-2 in units of the variance of a pixel, by which an outline holds its disc."""
    return float(np.pi * radius / (2 * EDGE_WIDTH_PX))


def _repel(discs: Array, apart: float, weight: float) -> tuple[Array, Array]:
    """Normal matrix (3 n, 3 n) and pull (3 n,) of pairs of discs that are nearer than they can be.

    weight: stiffness of the contact of two discs, px^-2.
    """
    stiffness, push = np.zeros((discs.size, discs.size)), np.zeros(discs.size)
    off = discs[:, None, :2] - discs[None, :, :2]
    away = np.hypot(*off.transpose(2, 0, 1))
    for i, j in np.argwhere(np.triu(away < apart, 1)):
        along = np.zeros(discs.size)
        along[3 * i : 3 * i + 2] = off[i, j] / max(away[i, j], 1e-6)
        along[3 * j : 3 * j + 2] = -along[3 * i : 3 * i + 2]
        stiffness += weight * np.outer(along, along)
        push += weight * (apart - away[i, j]) * along
    return stiffness, push
