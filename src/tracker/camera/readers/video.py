"""Reads videos in passes from front to back, a frame at a time, with FFmpeg's decoders (PyAV).

Counts are luma. They are the counts of a grey picture, or the Y' plane of Y'CbCr. The file's own matrix (ITU-R BT.601
or 709) made that plane from red, green and blue. A limited range, black at 16 and white at 235, is stretched to 0 and
255, as the camera had it before the encoder. Each code keeps a count of its own. Encoders with loss leave less than a
count of 255, so that their 10 and 12 bits are read as 8.

Times are the file's time stamps. Fields of interlaced frames become frames of their own, with lines between by
interpolation.
"""

import re
from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from av.video.frame import VideoFrame
from av.video.reformatter import ColorRange
from numpy.typing import NDArray

from synthcam_shared.errors import InputError
from tracker.camera.fields import FieldOrder, separate_fields
from tracker.camera.film_options import DEFAULT_OPTIONS, FilmOptions
from tracker.camera.frame_times import drop_repeated, rates_agree, read_clock
from tracker.camera.frames import Frames, check_frame_size, make_grey_frames

av.logging.set_libav_level(av.logging.PANIC)  # a note reports what is wrong with a film, once


@dataclass
class VideoContents:
    """Result of one pass over a video: times in ticks, key frames, colour, and faults."""

    codec: str
    curve: int  # FFmpeg's number of the transfer curve
    tick: float
    fps: float
    promised: int  # frames that the file says it has; 0 where it does not say
    length: float  # that the file says it has, s; 0 where it does not say
    aspect: float
    streams: int
    times: list[int | None]
    damaged: list[int]
    coloured: bool = False
    keys: list[int] = field(default_factory=list)
    changes: list[float] = field(default_factory=list)
    fields: FieldOrder = field(default_factory=FieldOrder)

    @property
    def has_times(self) -> bool:
        """True if each frame has a time of its own."""
        known = [time for time in self.times if time is not None]
        return len(known) == len(self.times) and all(a < b for a, b in pairwise(known))


def read_video(path: Path, options: FilmOptions = DEFAULT_OPTIONS, contents: VideoContents | None = None) -> Frames:
    """Read the frames of a video; ``faults`` say what is wrong with it. contents: of an earlier pass over the file."""
    try:
        first_frame, found = _scan_video(path) if contents is None else (_read_first(path), contents)
    except (av.error.FFmpegError, StopIteration, IndexError):  # no video in it
        raise InputError(f"{path}: no frame can be decoded, expected a video that FFmpeg reads") from None
    lossless = "ffv1 rawvideo huffyuv ffvhuff utvideo magicyuv lagarith png tiff bmp dpx qtrle v210 v410 r210".split()
    lossy = found.codec not in lossless
    grey, deep = _choose_conversion(first_frame, lossy)
    first = grey(first_frame)
    dtype = np.dtype(np.uint16 if deep else np.uint8)
    reader = _VideoReader(path, found, grey)
    frames = make_grey_frames(path, len(found.times), first.shape, dtype, reader)
    frames.fps, frames.lossy, frames.aspect, frames.contents = found.fps, lossy, found.aspect, found
    if found.coloured and not _is_rgb(first_frame):
        frames.colours = _VideoReader(path, found, _make_rgb_reader(first_frame, deep))
    faults = list(_describe_faults(found))
    clock = read_clock(found.times, found.tick, "the time stamps") if found.has_times else None  # type: ignore[arg-type]
    if clock is not None and options.times != "even":
        frames.numbers, frames.seconds = clock.numbers, clock.seconds
        if not rates_agree(found.fps, clock.fps, 1e-3):
            frames.fps = clock.fps
        faults += clock.notes
    frames.faults = tuple(faults)
    order = found.fields.find_first() if not _quarter_turns(first_frame) else None
    if options.fields != "auto":
        order = (order or 0) if options.fields == "separate" else None
    if order is not None:
        return separate_fields(frames, order)
    if found.fields.flagged and options.fields == "auto":
        frames.faults += ("the file says interlaced, but both fields of a frame show one instant; --fields separate",)
    return drop_repeated(frames, np.array(found.changes))


def _open_stream(path: Path) -> tuple[Any, Any]:
    container = av.open(str(path))
    if not container.streams.video:
        container.close()
        raise IndexError("no video")
    stream = max(container.streams.video, key=_judge_stream)
    stream.thread_type = "AUTO"
    return container, stream


def _judge_stream(stream: Any) -> tuple[bool, bool, float, int]:
    """Orders video streams: a cover picture is none, then the longest and the first."""
    cover = int(stream.disposition) & 0x400 != 0  # AV_DISPOSITION_ATTACHED_PIC
    picture = stream.codec_context is not None and stream.codec_context.name in ("mjpeg", "png", "bmp", "gif", "webp")
    length = float(stream.duration * stream.time_base) if stream.duration and stream.time_base else 0.0
    return not cover, not (picture and stream.frames == 1), length, -stream.index


def _decode(container: Any, stream: Any, failed: Callable[[], None] = lambda: None) -> Iterator[VideoFrame]:
    """Frames that can be decoded, in the order in which they are shown."""
    packets = container.demux(stream)
    while True:
        try:
            packet = next(packets)
        except (StopIteration, av.error.FFmpegError):  # the end, or where a file is cut off
            return
        try:
            frames = packet.decode()
        except av.error.FFmpegError:
            failed()
            continue
        yield from frames


def _read_first(path: Path) -> VideoFrame:
    """The first frame that can be decoded. Raises StopIteration without one."""
    container, stream = _open_stream(path)
    with container:
        return next(_decode(container, stream))


def _scan_video(path: Path) -> tuple[VideoFrame, VideoContents]:
    """Decodes all, for what containers claim of themselves are guesses: the first frame, and the contents."""
    container, stream = _open_stream(path)
    with container:
        times, damaged = list[int | None](), list[int]()
        frames = _decode(container, stream, lambda: damaged.append(len(times)))
        first = next(frames)
        check_frame_size(path, (first.height, first.width))
        length = stream.duration * stream.time_base if stream.duration else (container.duration or 0) / av.time_base
        found = VideoContents(
            times=times,
            damaged=damaged,
            codec=stream.codec_context.name,
            curve=int(getattr(first, "color_trc", 0) or 0),
            tick=float(stream.time_base or 0),
            fps=float(stream.average_rate or stream.guessed_rate or 0),
            promised=int(stream.frames),
            length=float(length),
            aspect=float(stream.sample_aspect_ratio or 1),
            streams=sum(_judge_stream(other)[:2] == (True, True) for other in container.streams.video),
        )
        before: NDArray[Any] | None = None
        for frame in chain([first], frames):
            if (frame.width, frame.height) != (first.width, first.height):
                has, wants = (f"{f.width}x{f.height}" for f in (frame, first))
                raise InputError(f"{path}: frame {len(times)} is {has}, expected {wants} as frame 0")
            if frame.is_corrupt:
                damaged.append(len(times))
            if not found.coloured and len(times) % 8 == 0:  # a ball in colour may come in late
                found.coloured = _has_colour(frame)
            if frame.key_frame:
                found.keys.append(len(times))
            times.append(frame.pts)
            after = _plane(frame, 0, 8 if frame.format.components[0].bits <= 8 else 16)
            found.fields.flagged |= frame.interlaced_frame
            if before is not None:
                found.changes.append(cv2.norm(before, after, cv2.NORM_L2SQR))
                if frame.height > 2 and (frame.interlaced_frame or (not found.fields.flagged and len(times) % 4 == 1)):
                    found.fields.add(before, after)
            before = after
        return first, found


def _describe_faults(found: VideoContents) -> Iterator[str]:
    """Lines on what in a video is not as one would expect."""
    count, promised = len(found.times), found.promised
    if not promised and found.has_times and count > 1:
        mean_step = (found.times[-1] - found.times[0]) * found.tick / (count - 1)  # type: ignore[operator]
        promised = int(found.length / mean_step) if mean_step > 0 else 0
    elif not promised:
        promised = int(found.length * found.fps)
    if count < 0.99 * promised - 1:
        yield f"truncated or damaged: {count} of the {promised} frames that the file promises can be decoded"
    if found.damaged:
        yield f"damaged: {len(found.damaged)} frames could not be decoded whole, the first at frame {found.damaged[0]}"
    hdr_curves = {16: "PQ", 18: "HLG"}  # by FFmpeg's number of a transfer curve
    if curve := hdr_curves.get(found.curve):
        yield (
            f"the film has the HDR curve {curve}: counts are not in proportion to light. Centres of outlines hold; "
            "errors of glints may not, and sensor.gamma does not describe it"
        )
    if found.streams > 1:
        yield f"the file has {found.streams} videos: the longest is taken"
    if not found.has_times and any(time is not None for time in found.times):
        yield "time stamps are missing or go backwards; frames are taken as evenly spaced"


class _VideoReader:
    """Frame k when asked for: decodes on from the last one, or from the key frame before k."""

    def __init__(self, path: Path, found: VideoContents, grey: Callable[[VideoFrame], NDArray[Any]]) -> None:
        self.path, self.times, self.keys, self.grey = path, found.times, found.keys, grey
        self.at = {time: k for k, time in enumerate(found.times)} if found.has_times else None
        self.recent: dict[int, NDArray[Any]] = {}
        self.source: tuple[Any, Any] | None = None
        self.numbered: Iterator[tuple[int, VideoFrame]] = iter(())
        self.next = 0

    def __call__(self, k: int) -> NDArray[Any]:
        if k in self.recent:
            return self.recent[k]
        self._seek(k)
        frame = self._decode_up_to(k)
        if frame is None:  # a key frame that is none
            self._open()
            frame = self._decode_up_to(k)
        if frame is None:
            raise InputError(f"{self.path}: frame {k} of {len(self.times)} cannot be decoded")
        picture = self.recent[k] = self.grey(frame)
        if len(self.recent) > 8:  # frames, for steps back; a longer step decodes from the key frame before
            del self.recent[next(iter(self.recent))]
        return picture

    def _seek(self, k: int) -> None:
        """Goes to the last key frame before k, unless decoding stands between the two."""
        before = bisect_right(self.keys, k)
        key = self.keys[before - 1] if before and self.at is not None else 0
        if self.source is None or (self.at is None and k < self.next):
            self._open()
        elif self.at is not None and not key <= self.next <= k:
            container, stream = self.source
            try:
                container.seek(self.times[key], stream=stream)
            except av.error.FFmpegError:  # a format that cannot be searched
                self._open()
                return
            self.numbered, self.next = self._numbers(_decode(container, stream)), key

    def _decode_up_to(self, k: int) -> VideoFrame | None:
        for number, frame in self.numbered:
            self.next = number + 1
            if number >= k:
                return frame if number == k else None
        return None

    def _open(self) -> None:
        if self.source is not None:
            self.source[0].close()
        self.source = _open_stream(self.path)
        self.numbered, self.next = self._numbers(_decode(*self.source)), 0

    def _numbers(self, frames: Iterator[VideoFrame]) -> Iterator[tuple[int, VideoFrame]]:
        if self.at is None:
            yield from enumerate(frames)
            return
        for frame in frames:
            if frame.pts in self.at:
                yield self.at[frame.pts], frame

    def __del__(self) -> None:
        if self.source is not None:
            self.source[0].close()


def _is_rgb(frame: VideoFrame) -> bool:
    return bool(frame.format.is_rgb or frame.format.has_palette or frame.format.is_bayer)


def _choose_conversion(first: VideoFrame, lossy: bool) -> tuple[Callable[[VideoFrame], NDArray[Any]], bool]:
    """How frames become counts (or red, green and blue), and whether in 16 bits."""
    layout, turn = first.format, _quarter_turns(first)
    bits = max(part.bits for part in layout.components)
    if _is_rgb(first):
        deep = bits > 8 and not lossy
        return _make_rgb_reader(first, deep), deep
    luma_first = re.compile(r"(yuvj?4\d\dp|yuva4\d\dp|gray)(\d+le|8)?|nv(12|16|21|24)")  # the first plane is the luma
    other = "" if luma_first.fullmatch(layout.name) else "yuv444p16le" if bits > 8 else "yuv444p"
    bits = 16 if other == "yuv444p16le" else bits
    full = first.color_range == ColorRange.JPEG or layout.name.startswith("yuvj")
    if layout.name.startswith("gray"):
        full = first.color_range != ColorRange.MPEG
    deep = bits > 8 and not lossy
    table = None if full and (deep or bits == 8) else _make_counts(bits, full, bits if deep else 8)

    def luma(frame: VideoFrame) -> NDArray[Any]:
        plane = _plane(frame.reformat(format=other) if other else frame, 0, bits)
        if bits == 8 and table is not None:
            counts: NDArray[Any] = np.asarray(cv2.LUT(plane, table))
        else:
            counts = plane.copy() if table is None else table[plane]
        return np.ascontiguousarray(np.rot90(counts, turn)) if turn else counts

    return luma, deep


def _make_rgb_reader(first: VideoFrame, deep: bool) -> Callable[[VideoFrame], NDArray[Any]]:
    """Frames as red, green and blue, (h, w, 3)."""
    name, turn = "rgb48le" if deep else "rgb24", _quarter_turns(first)
    return lambda frame: np.rot90(frame.reformat(format=name).to_ndarray(), turn)


def _quarter_turns(first: VideoFrame) -> int:
    """Quarters of a turn to the left by which pictures are shown."""
    return round(first.rotation / 90) % 4


def _plane(frame: VideoFrame, index: int, bits: int) -> NDArray[Any]:
    plane = frame.planes[index]
    dtype = np.dtype(np.uint8 if bits <= 8 else "<u2")
    rows: NDArray[Any] = np.frombuffer(memoryview(plane), dtype)
    return rows.reshape(plane.height, plane.line_size // dtype.itemsize)[:, : plane.width]


def _make_counts(bits: int, full: bool, wanted: int) -> NDArray[Any]:
    """Counts of so many wanted bits by code, black 0 and white 2^wanted - 1."""
    black, white = (0.0, 2.0**bits - 1) if full else (16 * 2.0 ** (bits - 8), 235 * 2.0 ** (bits - 8))
    top = 2.0**wanted - 1
    counts = (np.arange(2**bits) - black) * top / (white - black)
    return np.clip(np.rint(counts), 0, top).astype(np.uint8 if wanted == 8 else np.uint16)


def _has_colour(frame: VideoFrame) -> bool:
    """True if a thousandth of a Y'CbCr picture is more than 12 counts of 255 off grey."""
    parts = frame.format.components
    if len(parts) < 3:
        return False
    chroma = frame.reformat(format="yuv444p") if frame.format.name != "yuv420p" else frame
    return any(float(np.mean(np.abs(_plane(chroma, k, 8).astype(np.int16) - 128) > 12)) > 1e-3 for k in (1, 2))
