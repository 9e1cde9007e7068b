"""Chooses the detector and the colour channel that suit a film, from frames spread over it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tracker.camera.camera import Camera
from tracker.camera.camera_keys import CHANNELS
from tracker.camera.frames import GREY, Frame, Frames
from tracker.camera.lens import Array
from tracker.camera.recordings import Recording
from tracker.detection.candidates import estimate_noise, median_of_nine
from tracker.detection.still_background import estimate_still_background

GLINTS, DISCS = "maximum_likelihood", "discs"
MIN_BODY_AREA_PX = 28  # of a ball seen whole, 6 px across


def choose_detector(
    frames: Sequence[Any], camera: Camera, *, sampled_frames: int = 25, min_share: float = 0.2
) -> tuple[str, str]:
    """Choose the detector from frames spread over a film.

    Parameters
    ----------
    frames : sequence of (h, w) arrays
    camera : Camera
        Where the diameter of its balls is known, only bodies of about that size count.
    sampled_frames : int
    min_share : float
        Share of the frames, and at least three, that must show a round body of the common size.

    Returns
    -------
    str
        "discs" where round bodies of one size differ from the still background, else "maximum_likelihood".
    str
        A note that gives the reason; '' for glints, which need none.
    """
    last = len(frames) - 1
    sample = [np.array(frames[round(k * last / 8)]) for k in range(9)]
    noise = estimate_noise(sample)
    if noise > 4.0:  # counts; means of 3 x 3 pixels keep half of an encoder's noise
        frames, noise = SmoothedFrames(frames), noise * 0.5
        sample = [frames[round(k * last / 8)] for k in range(9)]
    level = median_of_nine(sample)
    picks = sorted({round(k * last / (sampled_frames - 1)) for k in range(sampled_frames)})
    least = _least_contrast(noise)
    expected = camera.diameter_px / 2 if camera.knows_diameter else None
    smallest = max(MIN_BODY_AREA_PX, 0.25 * np.pi * expected**2) if expected else MIN_BODY_AREA_PX
    if not any(_shows_large_region(np.asarray(frames[k]), level, least, smallest) for k in picks):
        return GLINTS, ""
    level = estimate_still_background(frames, noise).level
    found = [find_round_bodies(np.asarray(frames[k]), level, least, expected) for k in picks]
    radii = np.concatenate(found)
    if len(radii) == 0:
        return GLINTS, ""
    usual = float(np.median(radii))
    having = sum(bool(_of_common_size(r, usual).any()) for r in found)
    if having < max(min_share * len(picks), 3):
        return GLINTS, ""
    return DISCS, (
        f"detector: discs, because the film shows balls as bodies of {2 * usual:.0f} px, not only their glints; "
        "--detector overrides this"
    )


def choose_channel(frames: Frames, camera: Camera, *, min_ratio: float = 1.25, min_more: int = 6) -> tuple[str, str]:
    """Choose the colour channel from nine frames spread over a film.

    A red ball on green cloth, for example, may be as grey as the cloth.

    Parameters
    ----------
    frames : Frames
    camera : Camera
        Where the diameter of its balls is known, only bodies of about that size count.
    min_ratio, min_more : float, int
        A colour is chosen if it shows this many times the bodies that grey shows, and this many more.

    Returns
    -------
    str
        "grey", "red", "green" or "blue".
    str
        A note that gives the reason; '' for grey.
    """
    if frames.colours is None:
        return GREY, ""
    picks = [round(k * (len(frames) - 1) / 8) for k in range(9)]
    colours = [np.asarray(frames.colours(k)) for k in picks]
    layers = {name: [np.array(picture[..., k]) for picture in colours] for k, name in enumerate(CHANNELS[1:])}
    expected = camera.diameter_px / 2 if camera.knows_diameter else None
    found = {
        name: _moving_bodies(shots, expected) for name, shots in ({GREY: [frames[k] for k in picks]} | layers).items()
    }
    every = np.concatenate(list(found.values()))
    usual = float(np.median(every)) if len(every) else 0.0
    number = {name: int(_of_common_size(radii, usual).sum()) for name, radii in found.items()}
    best = max(number, key=lambda name: number[name])  # the first of equals
    if number[best] < max(min_ratio * number[GREY], number[GREY] + min_more):
        return GREY, ""
    return best, (
        f"channel: {best}, because it shows {number[best]} round bodies where grey shows {number[GREY]}; "
        "--channel overrides this"
    )


def select_channel(clip: Recording, name: str | None) -> tuple[Recording, str]:
    """The recording in the channel ``name``, or in the chosen one, and a note that gives the reason.

    Raises InputError for a channel that the film does not have.
    """
    if name is not None:
        return clip.select_channel(name), ""
    best, why = choose_channel(clip.frames, clip.camera)
    return clip.select_channel(best), why


class SmoothedFrames(Sequence[Any]):
    """The frames of a film, each as the means of 3 x 3 of its pixels."""

    def __init__(self, frames: Sequence[Any]) -> None:
        self.frames = frames

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, k: Any) -> Any:
        return cv2.blur(np.asarray(self.frames[k]), (3, 3))


def _least_contrast(noise: float) -> float:
    """Counts by which a body differs from the plate at least: 8, and 8 standard deviations of the noise."""
    return max(8.0 * noise, 8.0)


def _of_common_size(radii: Array, usual: float, tolerance: float = 0.25) -> NDArray[np.bool_]:
    return np.asarray(np.abs(radii - usual) < tolerance * usual)


def _moving_bodies(pictures: list[Frame], expected: float | None) -> Array:
    """Radii, px, of the round bodies that differ from the median of nine pictures."""
    level = median_of_nine([picture.copy() for picture in pictures]).astype(float)
    least = _least_contrast(estimate_noise(pictures))
    return np.concatenate([find_round_bodies(picture, level, least, expected) for picture in pictures])


def _shows_large_region(frame: NDArray[Any], level: NDArray[Any], least: float, smallest: float) -> bool:
    """True if a region larger than a glint differs from the plate."""
    mask = (cv2.absdiff(frame, level) > least).view(np.uint8)
    areas = cv2.connectedComponentsWithStats(mask, connectivity=4)[2][1:, cv2.CC_STAT_AREA]
    return bool((areas > smallest).any())


def find_round_bodies(
    frame: NDArray[Any],
    level: NDArray[Any],
    least: float,
    expected: float | None,
    *,
    max_regions: int = 40,
    min_roundness: float = 0.6,
    max_glint_ratio: float = 4.0,
    min_steepness: float = 0.4,
    min_radius_px: float = 4.0,
    size_limits: tuple[float, float] = (0.8, 1.25),
) -> NDArray[np.float64]:
    """Find the round bodies in one frame.

    Parameters
    ----------
    frame, level : (h, w) array
        The frame and the background, counts.
    least : float
        Least difference of the two, counts.
    expected : float or None
        Radius of the balls, px, where the camera file gives it.
    max_regions : int
        How many regions are examined, the largest first.
    min_roundness : float
        Least area over that of the circle around a region.
    max_glint_ratio : float
        Greatest contrast of the brightest spot over that of the body halfway out. Of a steel ball only the glint is
        bright.
    min_steepness : float
        Least share of pixels over four fifths of the contrast among those over a fifth: discs have edges, glints fade.
    min_radius_px : float
        Least radius where none is expected: a clipped glint looks like a small disc.
    size_limits : tuple of float
        Limits of the radius over the expected one. A glint out of focus is smaller than its ball.

    Returns
    -------
    ndarray of shape (n,)
        Their radii, px.
    """
    mask = (np.abs(frame - level) > least).view(np.uint8)
    _, labels, boxes, middles = cv2.connectedComponentsWithStats(mask, connectivity=4)
    largest = [k for k in np.argsort(-boxes[:, cv2.CC_STAT_AREA])[: max_regions + 1].tolist() if k > 0]
    found = []
    for left, top, width, height, area, k in ((*boxes[k].tolist(), k) for k in largest):
        if area < MIN_BODY_AREA_PX or area < min_roundness * np.pi / 4 * max(width, height) ** 2:
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
        glint = spot > max(least, abs(body) * max_glint_ratio) or (body < 0 and spot > least)
        low, high = size_limits
        large = radius > min_radius_px if expected is None else low < radius / expected < high
        if not glint and large and steep > min_steepness:
            found.append(radius)
    return np.array(found)
