"""A picture of a clip that was not measured, or whose collisions are all misfits: what was found, and what is wrong."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from synthcam_shared.arrays import Array
from tracker.camera.frames import spread_frames
from tracker.detection.background.windows import PixelRegion, find_regions
from tracker.detection.candidates import estimate_pixel_noise, median_of_nine
from tracker.measurement.collision.adequacy import CROWD, MEASURED, MISFIT, NO_SCALE, ONE_BALL
from tracker.notes import Note, NoteKind

if TYPE_CHECKING:
    from tracker.camera.camera import Camera
    from tracker.camera.frames import Frames
    from tracker.camera.recordings import Recording
    from tracker.detection.glints import Glints
    from tracker.detection.link import Tracks


MISFITS = "misfit.png"  # beside the tracks of a clip
UNFOLLOWED = "found, but its steps are those of no ball"
DARKER = "darker than the ground"
UNSHARP = "not followed: too few frames, or no sharp outline"
REFUSALS = "refused.png"  # beside the tracks of a clip, and beside its page


@dataclass(frozen=True)
class NotedPicture:
    """A picture as PNG, and the note that goes with it."""

    png: bytes
    note: Note


def is_refused_clip(tracks: Tracks, rows: Sequence[Mapping[str, Any]], *, in_pieces: bool = False) -> bool:
    """True if a clip gets a picture of refusals: no track, or no collision, unless only the scale is missing.

    in_pieces: most tracks begin or end inside the picture, so that a film without a collision has failed too.
    """
    enough = (*MEASURED, CROWD) if in_pieces else (*MEASURED, CROWD, NO_SCALE, ONE_BALL)
    return len(tracks) == 0 or not any(str(row["status"]) in enough for row in rows)


def draw_refusals(
    clip: Recording, tracks: Tracks, detected: Glints | None = None, *, min_area_px: int = 28, max_things: int = 12
) -> NotedPicture:
    """Draw the frame, of nine that are spread over the film, in which most objects are refused; name the largest.

    detected: what the detector found, also what belongs to no track.
    """
    picks = sorted({*spread_frames(clip.frames)})
    sample = [np.asarray(clip.frames[k]) for k in spread_frames(clip.frames)]
    least = max(8.0 * estimate_pixel_noise(sample), 8.0)
    level: Any = median_of_nine([picture.copy() for picture in sample])
    unfollowed = _list_unfollowed(tracks, detected)
    shots, follows_dark = dict[int, list[tuple[PixelRegion, str]]](), False
    for k in picks:
        frame: Any = np.asarray(clip.frames[k])
        regions = find_regions(cv2.absdiff(frame, level) > least, min_area_px - 1)[:max_things]
        shots[k] = [(region, _explain(region, clip, tracks, unfollowed, k, frame, level)) for region in regions]
        follows_dark |= any(not why and _is_darker(region, frame, level) for region, why in shots[k])
    if follows_dark:
        shots = {k: [(it, UNSHARP if why == DARKER else why) for it, why in shot] for k, shot in shots.items()}
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
    if clip.frames.colours is not None:
        advice += "; --colour NAME reads the film in the plane of a colour"
    counts = f"{_count(len(balls), 'ball')} followed, {_count(len(refused), 'object')} refused{reasons}"
    text = f"{REFUSALS} shows frame {number}: {counts}; {advice}"
    return NotedPicture(
        cv2.imencode(".png", picture[..., ::-1])[1].tobytes(), Note(NoteKind.DETECTOR, text, clip.number)
    )


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' * (number != 1)}"


def _list_unfollowed(tracks: Tracks, detected: Glints | None) -> Array:
    """Detections (n, 3) that belong to no track: frame, x and y."""
    if detected is None or not len(detected):
        return np.empty((0, 3))
    followed = {*zip(tracks.frame.tolist(), tracks.glint_x.tolist(), tracks.glint_y.tolist(), strict=True)}
    places = zip(detected.frame.tolist(), detected.x.tolist(), detected.y.tolist(), strict=True)
    return np.array([place for place in places if place not in followed]).reshape(-1, 3)


def _explain(
    region: PixelRegion,
    clip: Recording,
    tracks: Tracks,
    unfollowed: Array,
    k: int,
    frame: NDArray[Any],
    level: NDArray[Any],
) -> str:
    """Why a region that differs from the background is no ball that is followed; '' where one is."""
    rows, columns = np.nonzero(region.own)
    x, y = region.left + columns.mean(), region.top + rows.mean()
    reach = max(region.own.shape) / 2 + 2
    number = clip.frames.numbers[k]
    balls = tracks.xy[tracks.frame == number]
    if _is_near(balls, (x, y), reach):
        return ""
    if _is_near(unfollowed[unfollowed[:, 0] == number, 1:], (x, y), reach):
        return UNFOLLOWED
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
    return DARKER if _is_darker(region, frame, level) else UNSHARP


def _is_darker(region: PixelRegion, frame: NDArray[Any], level: NDArray[Any]) -> bool:
    """True if a region is darker than the ground in the mean."""
    return bool(np.subtract(frame[region.at], level[region.at], dtype=np.float32)[region.own].mean() < 0)


def _is_near(places: Array, point: tuple[float, float], reach: float) -> bool:
    return len(places) > 0 and bool(np.hypot(*(places - point).T).min() < reach)


def paint_frame(frames: Frames, k: int) -> NDArray[np.uint8]:
    """Paint the frame behind the refusals in red, green and blue (h, w, 3), from its darkest to brightest pixels."""
    colours = frames.colours
    shot = np.asarray(frames[k] if colours is None else colours(k)).astype(np.float32)
    low, high = float(np.percentile(shot, 1)), float(np.percentile(shot, 99.9))
    grey = (np.clip((shot - low) / max(high - low, 1.0), 0, 1) * 255).astype(np.uint8)
    return np.ascontiguousarray(np.repeat(grey[..., None], 3, axis=2) if grey.ndim == 2 else grey[..., :3])


def _draw(clip: Recording, k: int, balls: Array, refused: Sequence[tuple[PixelRegion, str]]) -> NDArray[np.uint8]:
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


def is_misfit_clip(rows: Sequence[Mapping[str, Any]]) -> bool:
    """True if a clip gets a picture of misfits: it has measured collisions, and all of them are misfits."""
    measured = [row["status"] for row in rows if row["status"] in MEASURED]
    return len(measured) > 0 and set(measured) == {MISFIT}


def draw_misfit(
    tracks: Tracks, camera: Camera, rows: Sequence[Mapping[str, Any]], clip: int, frames: Frames | None = None
) -> NotedPicture | None:
    """Draw the first misfit; None where its tied fit lacks a parameter. frames: the film, if there is one."""
    from tracker.report.collision_figures import CollisionView  # here alone: matplotlib is slow to load

    row = next(row for row in rows if row["status"] == MISFIT)
    view = CollisionView.of(pd.Series(row), tracks, camera)
    if not np.isfinite(view.parameters).all():
        return None
    contact = float(row["t_c"]) * camera.fps
    shown = int(np.argmin(np.abs(frames.numbers - contact))) if frames is not None else -1
    what = f"{MISFITS} shows {f'frame {frames.numbers[shown]} with ' if frames is not None else ''}both tracks"
    change = "--frames A:B measures a part of the film" if frames is not None else "leave out rows that do not belong"
    seen, fitted = dict[int, Any](), dict[int, Any]()
    for ball, track in view.balls.items():
        path = view.predict(ball, track.start) if view.is_instantaneous else track.position
        both = (np.column_stack([p, np.full(len(p), camera.radius)]) for p in (track.position, path))
        seen[ball], fitted[ball] = (camera.project(points) for points in both)
    frame = np.concatenate([view.balls[ball].frame for ball in (1, 2)])
    off = np.concatenate([np.hypot(*(seen[ball] - fitted[ball]).T) for ball in (1, 2)])
    variance = np.concatenate([np.trace(view.balls[ball].cov, axis1=1, axis2=2) / 2 for ball in (1, 2)])
    sigmas = off * camera.scale / np.sqrt(variance)
    near_contact_frames = 3
    near = np.abs(frame - contact) <= near_contact_frames
    parts = (~near & (frame < contact), near, ~near & (frame > contact))
    sizes = [float(np.mean(sigmas[part] ** 2)) if part.any() else 0.0 for part in parts]
    largest = int(np.argmax(sizes))
    causes = {  # by where the residuals are largest
        "before the contact": "the striker may slide, spin, or hit something before",
        "at the contact": "check ball_diameter and scale in the camera file; rubber and springs push for several "
        "frames",
        "after the contact": "a tilted plate, unequal balls or another hit may bend the paths",
    }
    where, worst = list(causes)[largest], int(np.argmax(np.where(parts[largest], sigmas, -1)))
    enlarged = _round_down(2 * camera.diameter_px / max(float(np.quantile(off, 0.9)), 1e-9))
    text = f"{what}; the contact lasts, so that it shows no residuals; {change}"
    if view.is_instantaneous:
        text = (
            f"{what} and the residuals of the misfit, {enlarged:g} times enlarged; they are largest {where} (up to "
            f"{off[worst]:.2g} px, {sigmas[worst]:.0f} errors, in frame {frame[worst]}): {causes[where]}; {change}"
        )
    ground = paint_frame(frames, shown) if frames is not None else np.full((*camera.size[::-1], 3), 40, np.uint8)
    lines = ["orange: struck ball", "blue: striker"]
    lines += [f"arrows: residuals x {enlarged:g}", "grey: tied fit"] if view.is_instantaneous else []
    picture = _draw_residuals(
        ground, seen, fitted, enlarged if view.is_instantaneous else 0.0, camera.diameter_px, lines
    )
    return NotedPicture(cv2.imencode(".png", picture[..., ::-1])[1].tobytes(), Note(NoteKind.MISFIT, text, clip))


def _draw_residuals(
    ground: NDArray[np.uint8],
    seen: Mapping[int, Any],
    fitted: Mapping[int, Any],
    enlarged: float,
    margin: float,
    lines: Sequence[str],
) -> NDArray[np.uint8]:
    """The part of the picture around both tracks: fitted paths, positions, and from each an arrow of its residual."""
    every = np.concatenate([*seen.values(), *fitted.values()])
    height, width = ground.shape[:2]
    left, top = np.clip(np.floor(every.min(axis=0) - margin), 0, [width - 2, height - 2]).astype(int)
    right, low = np.clip(np.ceil(every.max(axis=0) + margin), [left + 2, top + 2], [width, height]).astype(int)
    longest_side_px = 1000
    times = float(np.clip(longest_side_px / max(right - left, low - top), 0.25, 16))
    picture: Any = (0.6 * ground[top:low, left:right]).astype(np.uint8)  # darker than what is drawn on it
    picture = cv2.resize(np.ascontiguousarray(picture), None, fx=times, fy=times, interpolation=cv2.INTER_AREA)

    def place(points: Any) -> Any:
        return np.rint((points - [left, top] + 0.5) * times).astype(int)

    colours = {1: (255, 160, 60), 2: (90, 190, 255)}  # of the struck ball and the striker
    for ball, colour in colours.items():
        cv2.polylines(picture, [place(fitted[ball])], False, (200, 200, 200), 1, cv2.LINE_AA)
        tips = fitted[ball] + enlarged * (seen[ball] - fitted[ball])
        for at, tip in zip(place(fitted[ball]), place(tips), strict=True):
            cv2.arrowedLine(picture, at.tolist(), tip.tolist(), colour, 1, cv2.LINE_AA, tipLength=0.2)
        for at in place(seen[ball]):
            cv2.circle(picture, at.tolist(), 2, colour, -1, cv2.LINE_AA)
    for k, line in enumerate(lines):
        (x, y), font = (8, 18 * (k + 1)), cv2.FONT_HERSHEY_SIMPLEX
        across = cv2.getTextSize(line, font, 0.5, 1)[0][0]
        cv2.rectangle(picture, (x - 4, y - 14), (x + across + 4, y + 4), (0, 0, 0), -1)
        cv2.putText(picture, line, (x, y), font, 0.5, (240, 240, 240), 1, cv2.LINE_AA)
    return np.asarray(picture, np.uint8)


def _round_down(value: float) -> float:
    """1, 2 or 5 times a power of ten, at least 1."""
    power = 10.0 ** np.floor(np.log10(max(value, 1.0)))
    return float(power * max(step for step in (1, 2, 5) if step * power <= max(value, 1.0)))
