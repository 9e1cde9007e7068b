"""Counts the balls on a plate of one colour, alone or packed, in the plane of distances from that colour."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from synthcam_shared.arrays import Flags
from tracker.detection.background.windows import find_regions
from tracker.detection.outlines.contrast_regions import ContrastRegion, split_region
from tracker.detection.outlines.disc_packing import Floats, estimate_least_distance, pack_region

CONTRAST_COUNTS = 100.0  # half of that of a ball
RADIUS_TOLERANCE = 0.25


@dataclass(frozen=True)
class BallsOnPlate:
    """The bodies in a plane of distances from the plate."""

    counts: tuple[int, ...] = ()  # of balls, by picture
    share: float = 0.0  # of the area that differs from the plate and does not always rest, which the balls cover

    @property
    def total(self) -> int:
        return sum(self.counts)

    @property
    def are_all(self) -> bool:
        """True if three or more balls cover nearly all that differs from the plate, and their number hardly changes."""
        least, min_share, max_changes = 3, 0.9, 0.1  # changes of the number, added up, over the total
        changes = np.abs(np.diff(self.counts)).sum()
        return (
            self.total >= least * len(self.counts) > 0
            and self.share > min_share
            and float(changes) < max_changes * self.total
        )


def count_balls_on_plate(pictures: Sequence[NDArray[Any]], diameter: float | None) -> BallsOnPlate:
    """Count the balls in pictures of the plane "plate", spread over a film.

    diameter: of the balls, px, where it is known. A body that rests in all pictures counts if `find_balls_at_rest`
    finds it.
    """
    largest = 1.5  # radius in the plane over that of the camera file; the plane enlarges balls
    shares = [np.asarray(picture, np.float32) / (2 * CONTRAST_COUNTS) for picture in pictures]
    at_rest = np.min(shares, axis=0) > 0.5
    regions = [_find_moving_regions(share, at_rest) for share in shares]
    radii = [one.minor for every in regions for one in every if one.is_disc(one.minor, RADIUS_TOLERANCE)]
    radius = float(np.median(radii)) if radii else 0.0
    if not radii or (diameter is not None and not 1 - RADIUS_TOLERANCE < radius / (diameter / 2) < largest):
        return BallsOnPlate()
    apart, counts, covered, whole = estimate_least_distance(radius, diameter), list[int](), 0.0, 0.0
    at_rest &= ~find_balls_at_rest(shares, at_rest, radius, apart)
    for share in shares:
        every = _find_moving_regions(share, at_rest)
        found = [1 if _is_ball(one, radius, apart) else len(pack_region(one, share, radius, apart)) for one in every]
        counts.append(sum(found))
        covered += sum(one.area for one, balls in zip(every, found, strict=True) if balls)
        whole += sum(one.area for one in every)
    return BallsOnPlate(tuple(counts), covered / whole)


def find_balls_at_rest(shares: Iterable[Floats], at_rest: Flags, radius: float, apart: float) -> Flags:
    """Find the balls among what rests in all pictures, with a rim of two pixels.

    They belong, in one of the pictures, to a group of discs of the usual radius that the plate surrounds and of which
    another moves. shares: (h, w) of each picture, of the contrast of a ball. at_rest: the pixels that never are bare.
    radius, apart: of the discs, and the least distance of two centres, px.
    """
    least, most = 0.02, 0.98  # share of a group that rests, where some of it does and some does not
    balls = np.zeros(at_rest.shape, np.uint8)
    for share in shares:
        for one in _find_moving_regions(share, at_rest) if at_rest.any() else ():
            own = one.mask[1:-1, 1:-1] > 0
            rests = (at_rest[one.at] & own).sum() / own.sum()
            known = not (at_rest[one.at] & own & (balls[one.at] == 0)).any()
            discs = pack_region(one, share, radius, apart) if least < rests < most and not known else []
            if discs:
                one.fill(balls)
            for disc in discs:  # also one that hardly differs from the plate
                x, y = np.round(disc.position).astype(int).tolist()
                cv2.circle(balls, (x, y), int(np.ceil(apart / 2)), 1, -1)
    return np.asarray(cv2.dilate(balls, np.ones((5, 5), np.uint8)) > 0)


def _is_ball(one: ContrastRegion, radius: float, apart: float) -> bool:
    """True for one disc of the usual radius, or of that of the ball, which one of little contrast has."""
    return any(one.is_disc(each, RADIUS_TOLERANCE) for each in (radius, apart / 2))


def _find_moving_regions(share: Floats, at_rest: Flags) -> list[ContrastRegion]:
    """The regions of a picture that differ from the plate, without those that rest in all pictures."""
    min_area_px, max_rest = 28, 0.98
    found = list[ContrastRegion]()
    for region in find_regions(share > 0.5, min_area_px):
        if (at_rest[region.at] & region.own).sum() < max_rest * region.area:
            found += split_region(share[region.at], region.own, (region.left, region.top), 0, 0.5, 3.0)
    return found
