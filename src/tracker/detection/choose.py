"""Which detector a film asks for: one of glints on a dark plate, or one of discs on a still background."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tracker.camera.camera import Camera
from tracker.detection.candidates import estimate_noise, median_of_nine
from tracker.detection.still_background import estimate_still_background

GLINTS, DISCS = "maximum_likelihood", "discs"
LOOKED = 25  # frames
LEAST = 8.0  # counts, and noise deviations, of what differs from the plate
SMALLEST = 28  # px, an area
MOST = 40  # regions of a frame
ROUND = 0.6  # area over that of the circle around it
BODY = 0.25  # of the brightest spot on it, a ball's contrast halfway out: of a steel ball only the glint is seen
STEEP = 0.4  # of the pixels over a fifth of the contrast, those over four fifths: discs have edges, glints fade
NOISY, LEFT = 4.0, 0.5  # counts of noise, from which means are of 3 x 3 pixels; and what is then left of it
LARGE = 4.0  # px, a radius where the camera file gives none: a clipped glint looks like a small disc
SIZES = 0.8, 1.25  # times the radius that a camera file gives: a glint out of focus is smaller than its ball
ALIKE = 0.25  # of a radius
OFTEN = 0.2  # of the frames


def choose_detector(frames: Sequence[Any], camera: Camera) -> tuple[str, str]:
    """Choose a detector from frames spread over a film.

    Parameters
    ----------
    frames : sequence of (h, w) arrays
    camera : Camera
        A region is a ball's only if it has about its diameter, where that is known.

    Returns
    -------
    str
        "discs" where round bodies of one size differ from the still background in OFTEN of the frames, else
        "maximum_likelihood".
    str
        Why, for a note; '' for glints, which need none.
    """
    last = len(frames) - 1
    sample = [np.array(frames[round(k * last / 8)]) for k in range(9)]
    noise = estimate_noise(sample)
    if noise > NOISY:
        frames, noise = SmoothedFrames(frames), noise * LEFT
        sample = [frames[round(k * last / 8)] for k in range(9)]
    level = median_of_nine(sample)
    picks = sorted({round(k * last / (LOOKED - 1)) for k in range(LOOKED)})
    least = max(LEAST * noise, LEAST)
    expected = camera.diameter_px / 2 if camera.knows_diameter else None
    smallest = max(SMALLEST, 0.25 * np.pi * expected**2) if expected else SMALLEST
    if not any(_large(np.asarray(frames[k]), level, least, smallest) for k in picks):
        return GLINTS, ""
    level = estimate_still_background(frames, noise).level
    seen = [find_round_bodies(np.asarray(frames[k]), level, least, expected) for k in picks]
    radii = np.concatenate(seen)
    if len(radii) == 0:
        return GLINTS, ""
    usual = float(np.median(radii))
    having = sum(bool((np.abs(r - usual) < ALIKE * usual).any()) for r in seen)
    if having < max(OFTEN * len(picks), 3):
        return GLINTS, ""
    return DISCS, f"detector: discs, for bodies of {2 * usual:.0f} px are seen, not glints alone; --detector forces"


class SmoothedFrames(Sequence[Any]):
    """The frames of a film, each the means of 3 x 3 of its pixels."""

    def __init__(self, frames: Sequence[Any]) -> None:
        self.frames = frames

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, k: Any) -> Any:
        return cv2.blur(np.asarray(self.frames[k]), (3, 3))


def _large(frame: NDArray[Any], level: NDArray[Any], least: float, smallest: float) -> bool:
    """Whether anything larger than a glint differs from the plate."""
    mask = (cv2.absdiff(frame, level) > least).view(np.uint8)
    areas = cv2.connectedComponentsWithStats(mask, connectivity=4)[2][1:, cv2.CC_STAT_AREA]
    return bool((areas > smallest).any())


def find_round_bodies(
    frame: NDArray[Any], level: NDArray[Any], least: float, expected: float | None
) -> NDArray[np.float64]:
    """Radii, px, of the round bodies in one frame."""
    mask = (np.abs(frame - level) > least).view(np.uint8)
    _, labels, boxes, middles = cv2.connectedComponentsWithStats(mask, connectivity=4)
    largest = [k for k in np.argsort(-boxes[:, cv2.CC_STAT_AREA])[: MOST + 1].tolist() if k > 0]
    found = []
    for left, top, width, height, area, k in ((*boxes[k].tolist(), k) for k in largest):
        if area < SMALLEST or area < ROUND * np.pi / 4 * max(width, height) ** 2:
            continue
        part = slice(top, top + height), slice(left, left + width)
        y, x = np.mgrid[part]
        away = np.hypot(x - middles[k][0], y - middles[k][1]) / np.sqrt(area / np.pi)
        whole = frame[part] - level[part]
        over, ring = whole[labels[part] == k], whole[(away > 0.5) & (away < 0.8)]
        if len(ring) == 0:
            continue
        body = float(np.median(ring))
        steep = (np.abs(over) > 0.8 * abs(body)).sum() / (np.abs(over) > 0.2 * abs(body)).sum()
        radius = np.sqrt((np.abs(over) > abs(body) / 2).sum() / np.pi)
        spot = float(whole[away < 0.9].max())
        glint = spot > max(least, abs(body) / BODY) or (body < 0 and spot > least)
        large = radius > LARGE if expected is None else SIZES[0] < radius / expected < SIZES[1]
        if not glint and large and steep > STEEP:
            found.append(radius)
    return np.array(found)
