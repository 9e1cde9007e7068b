"""A recording with its tracks drawn on it: pictures, and a film of them that browsers play."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import av
import cv2
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from tracker.camera.camera import Camera
    from tracker.camera.frames import Frames
    from tracker.detection.link import Tracks

Picture = NDArray[np.uint8]

COLOURS = ((193, 68, 14), (77, 150, 230), (120, 170, 40), (190, 110, 220), (230, 180, 30))  # red, green, blue
WIDEST, MOST_TIMES = 1280, 2  # px of the overlay; times a small picture is enlarged
TRAIL = 25  # frames behind a ball
LOOKED_AT = 25  # frames from which the grey levels' range is taken
BRIGHTER = 0.75  # power of the grey levels, so that what is dark is seen
SHIFT = 4  # fractional bits of OpenCV's coordinates
RATE = 25  # frames a second of the film
CRF = 28


@dataclass(frozen=True)
class Overlay:
    """Frames first to last of a recording, drawn with what was found in them."""

    frames: Frames
    tracks: Tracks
    camera: Camera
    first: int
    last: int
    marks: tuple[tuple[float, str], ...] = ()  # s, and what happens then

    def __iter__(self) -> Iterator[Picture]:
        """(h, w, 3) pictures, red first, all of one even size."""
        low, high = self._grey_range()
        times = self._magnification()
        for k in range(self.first, self.last + 1):
            grey = np.clip((self.frames[k].astype(np.float32) - low) / (high - low), 0, 1) ** BRIGHTER * 255
            if times >= 1:
                large = np.repeat(np.repeat(grey.astype(np.uint8), int(times), 0), int(times), 1)
            else:
                large = cv2.resize(grey.astype(np.uint8), None, fx=times, fy=times, interpolation=cv2.INTER_AREA)
            picture: Any = cv2.cvtColor(large, cv2.COLOR_GRAY2RGB)
            self._draw(picture, k, times)
            height, width = (n - n % 2 for n in picture.shape[:2])  # as H.264 wants it
            yield np.ascontiguousarray(picture[:height, :width])

    def _grey_range(self) -> tuple[float, float]:
        """Counts shown as black and as white."""
        chosen = np.linspace(self.first, self.last, min(LOOKED_AT, self.last - self.first + 1)).astype(int)
        sample = np.stack([self.frames[int(k)] for k in np.unique(chosen)]).astype(np.float64)
        low, high = float(np.percentile(sample, 1)), float(sample.max())
        return low, max(high, low + 1.0)

    def _magnification(self) -> float:
        width = max(self.frames.shape[2], self.frames.shape[1])
        return float(min(MOST_TIMES, WIDEST // width)) if width <= WIDEST else WIDEST / width

    def _draw(self, picture: Picture, k: int, times: float) -> None:
        tracks, radius = self.tracks, self.camera.diameter_px / 2
        recent = (tracks.frame <= k) & (tracks.frame > k - TRAIL)
        for particle in np.unique(tracks.particle[recent]):
            colour = COLOURS[int(particle) % len(COLOURS)]
            mine = recent & (tracks.particle == particle)
            trail = _to_fixed_point(tracks.xy[mine], times)
            cv2.polylines(picture, [trail], False, colour, 1, cv2.LINE_AA, SHIFT)
            for row in np.flatnonzero(mine & (tracks.frame == k)).tolist():
                self._ball(picture, row, times * radius if self.camera.knows_diameter else 0.0, times, colour)
        cv2.putText(picture, self._caption(k), (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, cv2.LINE_AA)

    def _ball(self, picture: Picture, row: int, radius: float, times: float, colour: tuple[int, int, int]) -> None:
        tracks = self.tracks
        ((x, y),) = _to_fixed_point(tracks.xy[row : row + 1], times)
        if radius:
            cv2.circle(picture, (int(x), int(y)), round(radius * 2**SHIFT), colour, 1, cv2.LINE_AA, SHIFT)
        cv2.drawMarker(picture, (int(x) >> SHIFT, int(y) >> SHIFT), colour, cv2.MARKER_CROSS, 9, 1, cv2.LINE_AA)
        at = (int(x) >> SHIFT) + round(max(radius, 5)), (int(y) >> SHIFT) - round(max(radius, 5))
        text = str(int(tracks.particle[row]))
        cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 1, cv2.LINE_AA)

    def _caption(self, k: int) -> str:
        if not self.camera.metric:
            return f"frame {k}"
        time = k / self.camera.fps
        met = [what for at, what in self.marks if at <= time]
        return f"frame {k}   {1e3 * time:.1f} ms   {met[-1] if met else ''}"


def _to_fixed_point(xy: NDArray[np.float64], times: float) -> NDArray[np.int32]:
    """Pixels of the recording as OpenCV's fixed-point coordinates of the overlay."""
    return np.asarray(np.round(((xy + 0.5) * times - 0.5) * 2**SHIFT), dtype=np.int32)


def encode_mp4(pictures: Iterable[Picture]) -> bytes:
    """The pictures as an H.264 film; the same bytes for the same pictures."""
    stream = io.BytesIO()
    film: Any = None
    with av.open(stream, "w", format="mp4") as container:
        for picture in pictures:
            if film is None:
                settings = {"crf": str(CRF), "preset": "veryfast", "threads": "1", "g": "10", "bf": "0"}
                film = container.add_stream("libx264", rate=RATE, options=settings)
                film.height, film.width = picture.shape[:2]
                film.pix_fmt = "yuv420p"
            container.mux(film.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        if film is not None:
            container.mux(film.encode())
    return stream.getvalue()


def choose_frames(frames: int, contacts: Sequence[float], most: int) -> tuple[int, int]:
    """First and last of the frames to show: all, or of many as many as allowed, the first contact (frame) early."""
    if frames <= most:
        return 0, frames - 1
    first = int(np.clip(min(contacts, default=0.0) - most / 4, 0, frames - most))
    return first, first + most - 1
