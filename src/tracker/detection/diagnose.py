"""Why a clip shows no ball that can be followed, in words that say what to change."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from tracker.detection.candidates import CandidateSearch
from tracker.detection.glints import Glints, View
from tracker.detection.link import Tracks

FEWEST = 6  # glints in a clip, below which a reason is given
SAMPLED = 9  # frames
FLICKER = 5.0  # counts, of the plate from frame to frame
FULL = 0.5  # share of the pixels at the ceiling: overexposed
DIFFERS, LEAST = 4.0, 8.0  # noise deviations, and counts, of what differs from the background
SHIFTED = 1.0  # px, of the whole picture
STIRRED, MOVED = 0.03, 0.3  # of the pixels, that differ: where the camera moves, and where there is no still background
TINY, MANY = 28, 40  # px, of a disc; discs in a frame
RIM, AT_ONCE, LOOSE = 0.06, 2, 4  # of the longer side; frames; ends of tracks: see warn_of_loose_ends
HOLE = 6.0  # noise deviations of a 5 x 5 mean, of something darker than the plate


def explain_no_glints(frames: Sequence[Any], view: View, glints: Glints) -> str:
    """The reason in one line; '' where there are glints enough."""
    still = np.array_equal(frames[0], frames[-1])
    if len(glints) >= FEWEST and not still:
        return ""
    sample = [np.array(frames[round(k * (len(frames) - 1) / (SAMPLED - 1))]) for k in range(SAMPLED)]
    level, noise = view.plate.level, view.plate.noise
    if np.mean([np.mean(s >= view.camera.sensor.ceiling) for s in sample]) > FULL:
        return "overexposed: most of the picture is at the sensor's limit"
    if all(np.array_equal(s, sample[0]) for s in sample):
        return "nothing moves: all frames are the same picture"
    if len(glints) >= FEWEST:
        return ""
    search = CandidateSearch(view.plate, view.sigma, apart=max(4.0, 0.8 * view.camera.diameter_px))
    crowded = sum(search(s).crowded for s in sample) > SAMPLED // 2
    if crowded or np.ptp([np.median(s) for s in sample]) > FLICKER:
        return "the light changes: most of the picture stands out from the plate"
    if any(_hole(s, level, noise, view.camera.diameter_px) for s in sample):
        return "dark balls on a bright ground: a glint brighter than the plate is needed"
    if len(glints):
        return f"too few detections: {len(glints)} glints in {len(frames)} frames"
    return "no balls: nothing stands out from the plate"


def explain_no_discs(frames: Sequence[Any], view: View) -> str:
    """The reason in one line why a film shows no disc that moves on a still background."""
    picks = [round(k * (len(frames) - 1) / (SAMPLED - 1)) for k in range(SAMPLED)]
    sample = [np.asarray(frames[k]).astype(np.float32) for k in picks]
    if all(np.array_equal(s, sample[0]) for s in sample):
        return "nothing moves: all frames are the same picture"
    level = np.median(np.array(sample), axis=0).astype(np.float32)
    apart = [(cv2.absdiff(s, level) > max(DIFFERS * view.plate.noise, LEAST)).view(np.uint8) for s in sample]
    shifts = np.array([cv2.phaseCorrelate(sample[0], s)[0] for s in sample[1:]])
    way = float(np.median(np.hypot(shifts[:, 0], shifts[:, 1])))
    share = float(np.median(np.array([float(a.mean()) for a in apart])))
    if share > STIRRED and way > SHIFTED:
        return f"no still background: the camera moves, by {way:.0f} px and more"
    if share > MOVED:
        return "no still background: the light changes, or most of the picture moves"
    areas = [cv2.connectedComponentsWithStats(a, connectivity=4)[2][1:, cv2.CC_STAT_AREA] for a in apart]
    largest = max((int(a.max()) for a in areas if len(a)), default=0)
    if largest == 0:
        return f"nothing moves: nothing differs from the background by {LEAST:g} counts"
    if largest < TINY:
        return f"too small: what moves covers {largest} pixels at most, expected balls of 6 px across at least"
    if np.median([np.sum(a > TINY) for a in areas]) > MANY:
        return f"too many: over {MANY} things differ from the background in most frames"
    return "nothing round moves on a still background"


def warn_of_loose_ends(tracks: Tracks, size: tuple[int, int], spans: Sequence[tuple[int, int]]) -> tuple[str, ...]:
    """A warning where most tracks begin or end as no ball's does, amid a take and amid the picture; else none.

    At the picture's rim as well, if they stay there: what flickers in one place does not come in from outside.

    size: width and height, px. spans: first and last frame of each take.
    """
    rows = [np.flatnonzero(tracks.particle == one) for one in np.unique(tracks.particle)]
    ends = np.array([r[[tracks.frame[r].argmin(), tracks.frame[r].argmax()]] for r in rows], dtype=int).ravel()
    x, y, frame = tracks.x[ends], tracks.y[ends], tracks.frame[ends]
    way = np.array([max(np.ptp(tracks.x[r]), np.ptp(tracks.y[r])) for r in rows])
    rim = np.minimum.reduce([x, y, size[0] - 1 - x, size[1] - 1 - y]) < RIM * max(size)
    rim &= np.repeat(way, 2) > RIM * max(size)
    cut = np.abs(frame[:, None] - np.array(spans).ravel()).min(axis=1) <= AT_ONCE
    loose = ~(rim | cut)
    if loose.sum() < max(LOOSE, 0.5 * len(ends)):
        return ()
    return (
        f"{loose.sum()} of the {len(ends)} ends of tracks are no ball's that comes in or leaves: these may be "
        "no balls, but reflections, specks, or more objects than can be told apart",
    )


def _hole(frame: Any, level: Any, noise: float, diameter: float) -> bool:
    """Whether something of about a ball's size is darker than the plate."""
    lack = cv2.blur(cv2.subtract(level, frame, dtype=cv2.CV_32F), (5, 5))
    dark = int(np.count_nonzero(lack > HOLE * noise / 5.0 + 1.0))
    return dark > 0.15 * diameter**2
