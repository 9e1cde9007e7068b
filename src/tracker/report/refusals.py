"""One frame of a film that could not be measured: what was found in it, what was refused, and why."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tracker.camera.frames import spread_frames
from tracker.detection.background.windows import PixelRegion, find_regions
from tracker.detection.candidates import estimate_pixel_noise, median_of_nine
from tracker.measurement.collision.adequacy import CROWD, MEASURED, NO_SCALE, ONE_BALL
from tracker.notes import Note, NoteKind

if TYPE_CHECKING:
    from tracker.camera.frames import Frames
    from tracker.camera.recordings import Recording
    from tracker.detection.link import Tracks

REFUSALS = "refused.png"  # beside the tracks of a clip, and beside its page
MAX_NAMED_THINGS = 12  # things that are named, the largest first


@dataclass(frozen=True)
class NotedPicture:
    """A picture as PNG, and the note that goes with it."""

    png: bytes
    note: Note


def is_refused_clip(tracks: Tracks, rows: Sequence[Mapping[str, Any]]) -> bool:
    """True if a clip gets a picture of refusals: no track, or no collision, unless only the scale is missing."""
    states = [str(row["status"]) for row in rows]
    return len(tracks) == 0 or not any(state in (*MEASURED, CROWD, NO_SCALE, ONE_BALL) for state in states)


def draw_refusals(clip: Recording, tracks: Tracks, *, min_area_px: int = 28) -> NotedPicture:
    """Draw the frame, of nine that are spread over the film, in which most things are refused."""
    picks = sorted({*spread_frames(clip.frames)})
    sample = [np.asarray(clip.frames[k]) for k in spread_frames(clip.frames)]
    least = max(8.0 * estimate_pixel_noise(sample), 8.0)
    level: Any = median_of_nine([picture.copy() for picture in sample])
    shots = {}
    for k in picks:
        frame: Any = np.asarray(clip.frames[k])
        regions = find_regions(cv2.absdiff(frame, level) > least, min_area_px - 1)[:MAX_NAMED_THINGS]
        shots[k] = [(region, _explain(region, clip, tracks, k, frame, level)) for region in regions]
    shown = max(picks, key=lambda k: (sum(bool(why) for _, why in shots[k]), len(shots[k])))
    number = int(clip.frames.numbers[shown])
    balls = tracks.xy[tracks.frame == number]
    refused = [(region, why) for region, why in shots[shown] if why]
    picture = _draw(clip, shown, balls, refused)
    kinds = Counter(why for _, why in refused)
    reasons = f" ({', '.join(f'{count} {why}' for why, count in kinds.most_common())})" if refused else ""
    if refused or len(balls):
        advice = f"--ball X,Y@{number} points at a ball that is missed, --region and --mask exclude what is none"
    else:
        advice = f"nothing in it differs from other frames by {least:.0f} counts; --ball X,Y@{number} points at a ball"
    counts = f"{len(balls)} balls found, {len(refused)} things refused{reasons}"
    text = f"{REFUSALS} shows frame {number}: {counts}; {advice}"
    return NotedPicture(
        cv2.imencode(".png", picture[..., ::-1])[1].tobytes(), Note(NoteKind.DETECTOR, text, clip.number)
    )


def _explain(
    region: PixelRegion, clip: Recording, tracks: Tracks, k: int, frame: NDArray[Any], level: NDArray[Any]
) -> str:
    """Why a region that differs from the background is no ball; '' where one was found in it."""
    rows, columns = np.nonzero(region.own)
    x, y = region.left + columns.mean(), region.top + rows.mean()
    reach = max(region.own.shape) / 2 + 2
    balls = tracks.xy[tracks.frame == clip.frames.numbers[k]]
    if len(balls) and np.hypot(*(balls - [x, y]).T).min() < reach:
        return ""
    if clip.area is not None and not clip.area[int(y), int(x)]:
        return "outside the region"
    if region.touches_rim(frame.shape):
        return "cut by the rim"
    usual = float(np.sqrt(np.median(tracks.flux) / np.pi)) if len(tracks) else clip.camera.diameter_px / 2
    radius = np.sqrt(region.area / np.pi)
    if region.area < 0.6 * np.pi / 4 * max(region.own.shape) ** 2:
        return "not round"
    if (len(tracks) or clip.camera.knows_diameter) and not 0.75 < radius / usual < 1.25:
        return "too small" if radius < usual else "too large"
    darker = np.subtract(frame[region.at], level[region.at], dtype=np.float32)[region.own].mean() < 0
    return "darker than the ground" if darker else "not followed: too few frames, or no sharp outline"


def paint_frame(frames: Frames, k: int) -> NDArray[np.uint8]:
    """Paint the frame behind the refusals in red, green and blue (h, w, 3), from its darkest to brightest pixels."""
    colours = frames.colours
    shot = np.asarray(frames[k] if colours is None else colours(k)).astype(np.float32)
    low, high = float(np.percentile(shot, 1)), float(np.percentile(shot, 99.9))
    grey = (np.clip((shot - low) / max(high - low, 1.0), 0, 1) * 255).astype(np.uint8)
    return np.ascontiguousarray(np.repeat(grey[..., None], 3, axis=2) if grey.ndim == 2 else grey[..., :3])


def _draw(
    clip: Recording, k: int, balls: NDArray[np.float64], refused: Sequence[tuple[PixelRegion, str]]
) -> NDArray[np.uint8]:
    """The frame with circles about what was found and boxes with reasons about what was refused, (h, w, 3)."""
    picture: Any = paint_frame(clip.frames, k)
    times = float(np.clip(900 / max(picture.shape[:2]), 0.25, 4))
    picture = cv2.resize(picture, None, fx=times, fy=times, interpolation=cv2.INTER_AREA)
    green, red = (60, 220, 60), (255, 80, 60)  # of what was found, and of what was refused
    for x, y in (balls + 0.5) * times:
        cv2.circle(picture, (round(x), round(y)), max(round(times * clip.camera.diameter_px / 2), 8), green, 2)
    for region, why in refused:
        height, width = region.own.shape
        corner = round(region.left * times), round(region.top * times)
        other = round((region.left + width) * times), round((region.top + height) * times)
        cv2.rectangle(picture, corner, other, red, 2)
        across = cv2.getTextSize(why, cv2.FONT_HERSHEY_SIMPLEX, 0.5, 1)[0][0]
        at = max(min(corner[0], picture.shape[1] - across), 0), max(corner[1] - 5, 12)
        cv2.putText(picture, why, at, cv2.FONT_HERSHEY_SIMPLEX, 0.5, red, 1, cv2.LINE_AA)
    return np.asarray(picture, np.uint8)
