"""Shows one film frame by frame: pictures as JPEG or PNG, with brightness, channel and size as asked for."""

from __future__ import annotations

import secrets
import threading
from collections import OrderedDict
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from synthcam_shared.errors import InputError
from tracker.camera.camera import Camera
from tracker.camera.camera_keys import CHANNELS, PLANES
from tracker.camera.film_options import FilmOptions
from tracker.camera.frames import GREY, Frames, spread_frames
from tracker.camera.recordings import Recording, RecordingSource, make_recording

COLOUR = "colour film"  # the channel of the page that shows all colours
MAX_KEPT_BYTES = 128 << 20  # of decoded frames, for steps to and fro


@dataclass(frozen=True)
class PictureLook:
    """The look of a picture."""

    channel: str = GREY
    low: float = 0.0  # share of white that becomes black
    high: float = 1.0  # share of white that becomes white
    reduce: int = 1  # film pixels per pixel of the picture, along one side
    box: tuple[int, int, int, int] | None = None  # left, top, width and height of the part shown, px; None is all

    def __post_init__(self) -> None:
        max_reduction = 16
        if not 0 <= self.low < self.high <= 1:
            raise InputError(f"brightness: expected 0 <= low < high <= 1, not {self.low:g} and {self.high:g}")
        if not 1 <= self.reduce <= max_reduction:
            raise InputError(f"reduce: expected 1 to {max_reduction}, not {self.reduce}")


class FilmView:
    """One clip of a source. Its frames are read one at a time, by one thread at a time."""

    def __init__(self, source: RecordingSource, index: int) -> None:
        self.source, self.index = source, index
        self.number, frames = source.open_film(index)
        self.location = source.clips[index][1]
        self.mark = secrets.token_hex(6)  # part of the address of each picture, which browsers keep
        self._lock, self._last, self._closed = threading.RLock(), -1, False
        self.frames = frames
        self.clip = make_recording(self.number, self.frames, None, (f"{self.location}", ""))
        self._planes: dict[str, Frames] = {GREY: self.clip.frames}
        self._kept: OrderedDict[tuple[str, int], NDArray[Any]] = OrderedDict()

    def close(self) -> None:
        """End passes over the film: they raise InputError at their next frame."""
        self._closed = True

    def open_recording(self, camera: Camera | None, options: FilmOptions, *, apart: bool = False) -> Recording:
        """The clip with a camera and options; apart: so that reading it does not disturb the viewer."""
        frames = self._apart if apart else self.frames
        return make_recording(self.number, frames, camera, (f"{self.location}", "the camera"), options)

    @cached_property
    def _apart(self) -> Frames:
        """The film once more, with the frames that the page has decoded."""
        frames, lock = self.source.open_film(self.index, self.frames.contents)[1], threading.RLock()

        def check_open() -> None:
            if self._closed:
                raise InputError(f"{self.location}: closed")

        def read(k: int) -> Any:
            check_open()
            kept = self._kept.get((GREY, k)) if frames.aspect == 1 else None
            if kept is not None:
                return kept
            with lock:
                return frames[k]

        out = frames.with_fetch(read)
        out.faults, colours = frames.faults, frames.colours
        if colours is not None:

            def read_colours(k: int) -> Any:
                check_open()
                with lock:
                    return colours(k)

            out.colours = read_colours
        return out

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, px."""
        return self.clip.frames.shape[2], self.clip.frames.shape[1]

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels that can be shown, the first one at the start."""
        if self.clip.frames.colours is None:
            return (GREY,)
        return (COLOUR, *CHANNELS, *PLANES)

    @cached_property
    def white(self) -> float:
        """The count that is shown as white where brightness is not changed."""
        frames = self.clip.frames
        return frames.white([] if frames.dtype == np.uint8 else self._read_sample())

    @cached_property
    def levels(self) -> tuple[float, float]:
        """Shares of white between which nearly all pixels lie, for a film that is dark or faint."""
        thin = [picture[::3, ::3] for picture in self._read_sample()]
        low, high = (
            float(edge([np.quantile(picture, share) for picture in thin])) / self.white
            for share, edge in ((0.005, np.min), (0.9995, np.max))
        )
        return round(max(low, 0.0), 3), round(min(max(high, low + 0.02), 1.0), 3)

    def _read_sample(self) -> list[NDArray[Any]]:
        return [np.asarray(self.clip.frames[k]) for k in sorted({*spread_frames(self.clip.frames)})]

    def read(self, k: int, channel: str = GREY) -> NDArray[Any]:
        """Counts of a frame in one channel, (h, w) or, of all colours, (h, w, 3). Raises InputError."""
        if not 0 <= k < len(self.clip.frames):
            raise InputError(f"frame {k}: expected 0 to {len(self.clip.frames) - 1}")
        if channel not in self.channels:
            raise InputError(f"channel: expected one of {', '.join(self.channels)}, not {channel!r}")
        with self._lock:
            key = channel, k
            if key not in self._kept:
                back = 0
                if k + 1 == self._last:
                    # a video is decoded from a key frame on: decode a dozen at once when one goes back
                    back = min(12, MAX_KEPT_BYTES // (2 * next(reversed(self._kept.values())).nbytes))
                for row in range(max(k - back, 0), k + 1):
                    self._keep(row, channel)
            self._last = k
            self._kept.move_to_end(key)
            return self._kept[key]

    def _keep(self, k: int, channel: str) -> None:
        if (channel, k) not in self._kept:
            self._kept[channel, k] = self._decode(k, channel)
            while len(self._kept) > 1 and sum(p.nbytes for p in self._kept.values()) > MAX_KEPT_BYTES:
                self._kept.popitem(last=False)

    def _decode(self, k: int, channel: str) -> NDArray[Any]:
        if channel == COLOUR:
            assert self.clip.frames.colours is not None
            return np.asarray(self.clip.frames.colours(k))[..., :3]
        if channel not in self._planes:
            self._planes[channel] = self.clip.frames.select_channel(channel)
        return np.asarray(self._planes[channel][k])

    def draw(self, k: int, look: PictureLook, kind: str) -> bytes:
        """A frame as a picture, of the kind "jpg" or "png". Raises InputError."""
        picture = self.read(k, look.channel)
        if look.box is not None:
            left, top, width, height = look.box
            left, top = min(max(left, 0), self.size[0] - 1), min(max(top, 0), self.size[1] - 1)
            picture = picture[top : top + max(height, 1), left : left + max(width, 1)]
        if look.reduce > 1:
            shown = [max(n // look.reduce, 1) for n in (picture.shape[1], picture.shape[0])]
            picture = cv2.resize(np.ascontiguousarray(picture), shown, interpolation=cv2.INTER_AREA)
        white = 255.0 if picture.dtype == np.uint8 else self.white
        counts = np.arange(256 if picture.dtype == np.uint8 else 65536)
        share = (counts / white - look.low) / (look.high - look.low)
        shown_8 = np.clip(np.rint(255 * share), 0, 255).astype(np.uint8)[picture]
        bgr = shown_8[..., ::-1] if shown_8.ndim == 3 else shown_8
        settings = [cv2.IMWRITE_JPEG_QUALITY, 90] if kind == "jpg" else [cv2.IMWRITE_PNG_COMPRESSION, 1]
        return cv2.imencode(f".{kind}", bgr, settings)[1].tobytes()
