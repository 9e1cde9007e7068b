"""Prepares the detector of a film once, then finds the balls of any one frame."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from tracker.camera.frames import Frames
from tracker.camera.recordings import Recording
from tracker.detection import detect
from tracker.detection.choose import select_channel, select_detector
from tracker.detection.detector import AnyDetector, View
from tracker.detection.glints import Glints, PositionFlag

MAX_SURVEYED_FRAMES = 400  # of a longer film a detector of outlines surveys so many, spread over it


@dataclass(frozen=True, eq=False)
class PreparedDetector:
    """A detector that knows its film. `detect` may be called from any thread."""

    clip: Recording
    view: View
    name: str
    detector: AnyDetector
    notes: tuple[str, ...] = ()
    rows: np.ndarray[Any, Any] | None = None  # indices of the frames that were surveyed; None: all
    _lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def point(self) -> str:
        """The point that a position gives: "glint" or "centre"."""
        return detect.find_detected_point(self.name, self.clip.camera)

    @property
    def radius_px(self) -> float:
        """Radius of a ball, px, as the detector takes it."""
        return float(getattr(self.detector, "radius", self.view.camera.diameter_px / 2))

    def detect(self, k: int) -> Glints:
        """The balls of frame index `k`, as a run finds them but for what it learns from neighbouring frames."""
        with self._lock:
            numbers = self.clip.frames.numbers
            if self.view.takes is not None:
                near = k if self.rows is None else int(np.abs(self.rows - k).argmin())
                own = min(self._surveyed, key=lambda row: abs(row - near))
                found = detect.run_detector(self.detector, [(own, np.asarray(self.clip.frames[k]))], self.name).glints
            else:  # two neighbours show the motion of a glint, and so its blur
                rows = range(max(k - 1, 0), min(k + 2, len(numbers)))
                frames = [(int(numbers[row]), np.asarray(self._blanked.frames[row])) for row in rows]
                found = detect.run_detector(self.detector, frames, self.name).glints
                found = found.take(found.frame == numbers[k])
        if self.clip.area is not None and len(found):
            size = self.view.camera.size
            x, y = (np.clip(np.rint(at), 0, n - 1).astype(int) for at, n in zip(found.xy.T, size, strict=True))
            found = found.take(self.clip.area[y, x])
        return found

    @cached_property
    def _blanked(self) -> Recording:
        return detect.blank_outside(self.clip, self.view)

    @cached_property
    def _surveyed(self) -> list[int]:
        assert self.view.takes is not None
        return sorted(self.view.takes.scene_of_frames())


def prepare_detector(clip: Recording, channel: str | None) -> PreparedDetector:
    """Prepare the detector of a film for the page: choose channel and detector as a run does. Raises InputError."""
    clip, chosen = select_channel(clip, channel)
    selected = select_detector(clip)
    name = selected.name
    rows, surveyed = None, clip
    if detect.find_detected_point(name, clip.camera) == "centre" and len(clip.frames) > MAX_SURVEYED_FRAMES:
        rows = np.linspace(0, len(clip.frames) - 1, MAX_SURVEYED_FRAMES).round().astype(np.int64)
        surveyed = replace(clip, frames=clip.frames.take(rows), balls=())
    view = detect.make_view(surveyed, name)
    notes = tuple(note for note in (chosen, selected.why) if note)
    detector = detect.load_detector(name)(view)
    for frames in (clip.frames, view.frames):
        if isinstance(frames, Frames):
            frames.forget()  # up to 600 MB, of a survey that is over
    return PreparedDetector(clip, view, detect.detector_name(name), detector, notes, rows)


def list_balls(found: Glints) -> list[dict[str, Any]]:
    """The balls of a frame for the page: position and error, px, correlation, light or area, names of the flags."""
    std = np.sqrt(np.diagonal(found.cov, axis1=1, axis2=2))
    return [
        {
            "x": round(float(found.x[i]), 4),
            "y": round(float(found.y[i]), 4),
            "x_std": float(f"{std[i, 0]:.3g}"),
            "y_std": float(f"{std[i, 1]:.3g}"),
            "correlation": round(float(found.cov[i, 0, 1] / std[i].prod()), 3),
            "flux": float(f"{found.flux[i]:.4g}"),
            "flags": [flag.word for flag in PositionFlag if found.flags[i] & flag],
        }
        for i in range(len(found))
    ]
