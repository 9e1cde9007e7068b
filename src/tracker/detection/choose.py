"""Chooses the detector and the colour channel that suit a film, from frames spread over it."""

from __future__ import annotations

import math
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
from tracker.detection.candidates import estimate_noise, median_of_nine, spread_frames
from tracker.detection.still_background import estimate_still_background
from tracker.detection.windows import find_regions

GLINTS, DISCS = "maximum_likelihood", "discs"
MIN_BODY_AREA_PX = 28  # of a ball seen whole, 6 px across
MAX_REGIONS = 40  # of a frame that are examined, the largest first
MIN_ROUNDNESS = 0.6  # area over that of the circle around a region
MAX_GLINT_RATIO = (
    4.0  # contrast of the brightest spot over that of the body halfway out; of steel only the glint shines
)
MIN_STEEPNESS = 0.4  # pixels over 4/5 of the contrast among those over 1/5: discs have edges, glints fade
MIN_RADIUS_PX = 4.0  # where no radius is expected: a clipped glint looks like a small disc
SIZE_LIMITS = 0.8, 1.25  # of the radius over the expected one; a glint out of focus is smaller than its ball


def choose_detector(frames: Sequence[Any], camera: Camera) -> tuple[str, str]:
    """Choose the detector from 25 frames spread over a film.

    It is "discs" where a fifth of them, and at least three, show a round body of the common size on a still background;
    else "maximum_likelihood". Where the camera knows the diameter of its balls, only bodies of about that size count.
    The second result is a note that gives the reason; '' for glints, which need none.
    """
    sample = [np.array(frames[k]) for k in spread_frames(frames)]
    noise = estimate_noise(sample)
    if noise > 4.0:  # counts; means of 3 x 3 pixels keep half of an encoder's noise
        frames, noise = SmoothedFrames(frames), noise * 0.5
        sample = [frames[k] for k in spread_frames(frames)]
    level = median_of_nine(sample)
    picks = sorted({*spread_frames(frames, 25)})
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
    if having < max(0.2 * len(picks), 3):
        return GLINTS, ""
    return DISCS, (
        f"detector: discs, because the film shows balls as bodies of {2 * usual:.0f} px, not only their glints; "
        "--detector overrides this"
    )


def choose_channel(frames: Frames, camera: Camera) -> tuple[str, str]:
    """Choose the colour channel, "grey", "red", "green" or "blue", from nine frames spread over a film.

    A red ball on green cloth, for example, may be as grey as the cloth. A colour is chosen if it shows 1.25 times the
    round bodies that grey shows, and 6 more. Where the camera knows the diameter of its balls, only bodies of about
    that size count. The second result is a note that gives the reason; '' for grey.
    """
    if frames.colours is None:
        return GREY, ""
    picks = spread_frames(frames)
    colours = [np.asarray(frames.colours(k)) for k in picks]
    layers = {GREY: [frames[k] for k in picks]}
    layers |= {name: [np.array(picture[..., k]) for picture in colours] for k, name in enumerate(CHANNELS[1:])}
    expected = camera.diameter_px / 2 if camera.knows_diameter else None
    found = {name: _moving_bodies(shots, expected) for name, shots in layers.items()}
    every = np.concatenate(list(found.values()))
    usual = float(np.median(every)) if len(every) else 0.0
    number = {name: int(_of_common_size(radii, usual).sum()) for name, radii in found.items()}
    best = max(number, key=lambda name: number[name])  # the first of equals
    if number[best] < max(1.25 * number[GREY], number[GREY] + 6):
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


def _of_common_size(radii: Array, usual: float) -> NDArray[np.bool_]:
    return np.asarray(np.abs(radii - usual) < 0.25 * usual)


def _moving_bodies(pictures: list[Frame], expected: float | None) -> Array:
    """Radii, px, of the round bodies that differ from the median of nine pictures."""
    level = median_of_nine([picture.copy() for picture in pictures])
    least = _least_contrast(estimate_noise(pictures))
    return np.concatenate([find_round_bodies(picture, level, least, expected) for picture in pictures])


def _shows_large_region(frame: NDArray[Any], level: NDArray[Any], least: float, smallest: float) -> bool:
    """True if a region larger than a glint differs from the plate."""
    return bool(find_regions(cv2.absdiff(frame, level) > math.floor(least), smallest))


def find_round_bodies(frame: NDArray[Any], level: NDArray[Any], least: float, expected: float | None) -> Array:
    """Radii (n,), px, of the round bodies that differ from the background by `least` counts in one frame.

    `expected` is the radius of the balls, px, where the camera file gives it.
    """
    rounding = 0.5  # counts, of the level
    rough = cv2.absdiff(frame, np.rint(level).astype(frame.dtype)) > math.floor(least - rounding)
    found = []
    for region in find_regions(
        rough, MIN_BODY_AREA_PX - 1, lambda at: np.abs(np.subtract(frame[at], level[at], dtype=np.float32)) > least
    )[:MAX_REGIONS]:
        if region.area < MIN_ROUNDNESS * np.pi / 4 * max(region.own.shape) ** 2:
            continue
        rows, columns = np.nonzero(region.own)
        y, x = np.ogrid[: region.own.shape[0], : region.own.shape[1]]
        away = np.hypot(x - columns.mean(), y - rows.mean()) / np.sqrt(region.area / np.pi)
        whole = np.subtract(frame[region.at], level[region.at], dtype=np.float32)
        over, ring = whole[region.own], whole[(away > 0.5) & (away < 0.8)]
        if len(ring) == 0:
            continue
        body = float(np.median(ring))
        steep = (np.abs(over) > 0.8 * abs(body)).sum() / (np.abs(over) > 0.2 * abs(body)).sum()
        radius = np.sqrt((np.abs(over) > abs(body) / 2).sum() / np.pi)
        spot = float(whole[away < 0.9].max())
        glint = spot > max(least, abs(body) * MAX_GLINT_RATIO) or (body < 0 and spot > least)
        low, high = SIZE_LIMITS
        large = radius > MIN_RADIUS_PX if expected is None else low < radius / expected < high
        if not glint and large and steep > MIN_STEEPNESS:
            found.append(radius)
    return np.array(found)
