"""A picture of a clip whose collisions are all misfits (rejected by the tied fit): tracks, and enlarged residuals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tracker.measurement.collision.adequacy import MEASURED, MISFIT
from tracker.notes import Note, NoteKind
from tracker.report.refusals import NotedPicture, paint_frame

if TYPE_CHECKING:
    from tracker.camera.camera import Camera
    from tracker.camera.frames import Frames
    from tracker.detection.link import Tracks

MISFITS = "misfit.png"  # beside the tracks of a clip


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
    picture = _draw(ground, seen, fitted, enlarged if view.is_instantaneous else 0.0, camera.diameter_px, lines)
    return NotedPicture(cv2.imencode(".png", picture[..., ::-1])[1].tobytes(), Note(NoteKind.MISFIT, text, clip))


def _draw(
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
