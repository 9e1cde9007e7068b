"""A recording with its tracks drawn on it, as pictures and as a film that browsers play."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from synthcam_shared.arrays import Array

if TYPE_CHECKING:
    from tracker.camera.camera import Camera
    from tracker.camera.frames import Frames
    from tracker.detection.link import Tracks

Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class Overlay:
    """Frames first to last of a recording with the positions, outlines and paths of the balls.

    first, last: counted in the file.
    events: times (s) and captions.
    trail: number of frames for which a path is shown.
    max_width: of a picture, px.
    """

    frames: Frames
    tracks: Tracks
    camera: Camera
    first: int
    last: int
    events: tuple[tuple[float, str], ...] = ()
    trail: int = 25
    max_width: int = 1280
    rate: ClassVar[int] = 25  # frames per second of the film
    colours: ClassVar = ((193, 68, 14), (77, 150, 230), (120, 170, 40), (190, 110, 220), (230, 180, 30))
    fraction_bits: ClassVar[int] = 4  # of OpenCV's fixed-point coordinates

    def __iter__(self) -> Iterator[Picture]:
        """Yield (h, w, 3) RGB pictures of one even size."""
        low, high = self._grey_range()
        counts = np.arange(np.iinfo(self.frames.dtype).max + 1, dtype=np.float32)
        # the power makes dark parts brighter
        greys = (np.clip((counts - low) / (high - low), 0, 1) ** 0.75 * 255).astype(np.uint8)
        width = max(self.frames.shape[2], self.frames.shape[1])
        times = float(min(2, self.max_width // width)) if width <= self.max_width else self.max_width / width
        for k in range(self.first, self.last + 1):
            frame: NDArray[np.integer[Any]] = np.asarray(self.frames[k])
            if times >= 1:
                large = cv2.resize(greys[frame], None, fx=times, fy=times, interpolation=cv2.INTER_NEAREST)
            else:
                large = greys[cv2.resize(frame, None, fx=times, fy=times, interpolation=cv2.INTER_AREA)]
            picture: Any = cv2.cvtColor(large, cv2.COLOR_GRAY2RGB)
            self._draw(picture, int(self.frames.numbers[k]), times)
            height, across = (n - n % 2 for n in picture.shape[:2])  # H.264 needs even sizes
            yield np.ascontiguousarray(picture[:height, :across])

    def _grey_range(self) -> tuple[float, float]:
        """Counts that are shown as black and as white, from at most 25 frames."""
        chosen = np.linspace(self.first, self.last, min(25, self.last - self.first + 1)).astype(int)
        pixels = np.zeros(np.iinfo(self.frames.dtype).max + 1, np.int64)  # of each count
        for k in np.unique(chosen).tolist():
            pixels += np.bincount(np.ravel(self.frames[k]), minlength=len(pixels))
        up_to = np.cumsum(pixels)
        rank, part = divmod(0.01 * (up_to[-1] - 1), 1)
        below, above = (float(np.searchsorted(up_to, rank + more, side="right")) for more in (0, 1))
        low, high = below + part * (above - below), float(np.flatnonzero(pixels)[-1])
        return low, max(high, low + 1.0)

    def _draw(self, picture: Picture, k: int, times: float) -> None:
        tracks, radius = self.tracks, self.camera.diameter_px / 2
        recent = (tracks.frame <= k) & (tracks.frame > k - self.trail)
        for particle in np.unique(tracks.particle[recent]):
            colour = self.colours[int(particle) % len(self.colours)]
            mine = recent & (tracks.particle == particle)
            trail = self._to_fixed_point(tracks.xy[mine], times)
            cv2.polylines(picture, [trail], False, colour, 1, cv2.LINE_AA, self.fraction_bits)
            for row in np.flatnonzero(mine & (tracks.frame == k)).tolist():
                self._ball(picture, row, times * radius if self.camera.knows_diameter else 0.0, times, colour)
        caption = f"frame {k}"
        if self.camera.metric:
            time = k / self.camera.fps
            past = [event for at, event in self.events if at <= time]
            caption += f"   {1e3 * time:.1f} ms   {past[-1] if past else ''}"
        cv2.putText(picture, caption, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, cv2.LINE_AA)

    def _ball(self, picture: Picture, row: int, radius: float, times: float, colour: tuple[int, int, int]) -> None:
        tracks = self.tracks
        ((x, y),) = self._to_fixed_point(tracks.xy[row : row + 1], times)
        bits, lines = self.fraction_bits, cv2.LINE_AA
        if radius:
            cv2.circle(picture, (int(x), int(y)), round(radius * 2**bits), colour, 1, lines, bits)
        cv2.drawMarker(picture, (int(x) >> bits, int(y) >> bits), colour, cv2.MARKER_CROSS, 9, 1, lines)
        at = (int(x) >> bits) + round(max(radius, 5)), (int(y) >> bits) - round(max(radius, 5))
        text = str(int(tracks.particle[row]))
        cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 1, lines)

    def _to_fixed_point(self, xy: Array, times: float) -> NDArray[np.int32]:
        """Convert pixels of the recording to OpenCV's fixed-point coordinates of the overlay."""
        return np.asarray(np.round(((xy + 0.5) * times - 0.5) * 2**self.fraction_bits), dtype=np.int32)


def encode_mp4(pictures: Iterable[Picture]) -> bytes:
    """Encode pictures with tracks as an H.264 film; the same pictures give the same bytes.

    Slower presets of x264 show the thin coloured lines worse.
    """
    tools = "cabac=1:no-deblock=0"  # the quickest preset lacks these, which make smaller files
    settings = {"crf": "28", "preset": "ultrafast", "x264-params": tools, "threads": "1", "g": "10", "bf": "0"}
    stream = io.BytesIO()
    film: Any = None
    with av.open(stream, "w", format="mp4") as container:
        for picture in pictures:
            if film is None:
                film = container.add_stream("libx264", rate=Overlay.rate, options=settings)
                film.height, film.width = picture.shape[:2]
                film.pix_fmt = "yuv420p"
            planes: Any = cv2.cvtColor(picture, cv2.COLOR_RGB2YUV_I420)  # in a third of FFmpeg's time
            container.mux(film.encode(av.VideoFrame.from_ndarray(planes, format="yuv420p")))
        if film is not None:
            container.mux(film.encode())
    return stream.getvalue()


def choose_frames(frames: int, contacts: Sequence[float], max_frames: int = 750) -> tuple[int, int]:
    """Choose the first and last frame of the film with tracks drawn on it.

    All frames are shown where they are at most `max_frames`; else so many, which begin shortly before the first of
    `contacts` (frames).
    """
    if frames <= max_frames:
        return 0, frames - 1
    first = int(np.clip(min(contacts, default=0.0) - max_frames / 4, 0, frames - max_frames))
    return first, first + max_frames - 1
