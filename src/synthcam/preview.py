"""One frame of a scene as a picture for people, and how fast frames are made."""

from __future__ import annotations

import itertools
import time
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from synthcam.dataset import view_of
from synthcam.generate import film
from synthcam.scene import Clip, check_scene

Counts = NDArray[np.uint8] | NDArray[np.uint16]
TIMED = 40  # frames


def write_preview(clip: Clip, seed: int, path: Path, frame: int | None, magnify: int) -> None:
    """Write frame number `frame` of a clip (default: the last before the contact) as a PNG.

    magnify > 0: the balls so many times larger stand below the frame, with their faint bodies brought out.
    """
    view = view_of(clip)
    hit = view.motion.first("contact")
    when = hit.t if hit else 0.5 * clip.frames / clip.camera.fps
    k = frame if frame is not None else int((when - clip.camera.exposure) * clip.camera.fps)
    k = min(max(k, 0), clip.frames - 1)
    counts = next(itertools.islice(film(clip, view, seed), k, None))
    picture = _grey(counts, clip.sensor.bits)
    if magnify:
        middle = clip.camera.project(view.at(np.array([k / clip.camera.fps]))[:, 0, :3]).mean(axis=0)
        black = clip.sensor.black_level / 2 ** (clip.sensor.bits - 8)
        picture = _with_inset(picture, middle, magnify, black)
    ok, data = cv2.imencode(".png", picture)
    if not ok:
        raise OSError(f"{path}: could not be encoded as PNG")
    path.write_bytes(data.tobytes())


def _grey(counts: Counts, bits: int) -> NDArray[np.uint8]:
    return (counts >> (bits - 8)).astype(np.uint8) if bits > 8 else counts.astype(np.uint8)


def _with_inset(
    picture: NDArray[np.uint8], middle: NDArray[np.float64], magnify: int, black: float
) -> NDArray[np.uint8]:
    """The frame, and below it a strip round `middle`, magnified, black subtracted, cube root to show what is dark."""
    width = picture.shape[1]
    across, down = width // magnify, max(width // magnify // 2, 1)
    left = int(np.clip(round(middle[0]) - across // 2, 0, picture.shape[1] - across))
    top = int(np.clip(round(middle[1]) - down // 2, 0, max(picture.shape[0] - down, 0)))
    patch = picture[top : top + down, left : left + across]
    lifted = (255 * np.cbrt(np.clip((patch - black) / (255 - black), 0, 1))).astype(np.uint8)
    large = np.kron(lifted, np.ones((magnify, magnify), np.uint8))
    strip = np.zeros((large.shape[0] + 4, width), np.uint8)
    strip[:4] = 90
    strip[4:, : large.shape[1]] = large
    return np.vstack([picture, strip])


def speed() -> float:
    """Frames a second of one process: two balls, 640 x 480, drawn and exposed, after a first clip to warm up."""
    settings = {"launch": {"b": 0.2, "v0": 0.3}, "timing": {"frames": TIMED, "contact_frame": 0.5 * TIMED}}
    clip = check_scene(settings, "doctor").draw(0, 0)
    for _ in range(2):
        started = time.perf_counter()
        for _ in film(clip, view_of(clip), 0):
            pass
        seconds = time.perf_counter() - started
    return TIMED / seconds
