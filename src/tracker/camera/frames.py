"""Opens recordings: a dataset, a clip, a TIFF stack, a folder of pictures, a video.

Frames are read one at a time where they are asked for, so memory does not grow with a clip's length. Of a
dataset only ``frames.tif`` and ``camera.json`` are ever opened.
"""

from __future__ import annotations

import logging
import re
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, overload

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from tracker.camera.camera import Camera, InputError
from tracker.camera.camera_keys import LONGEST_SIDE, MOST_PIXELS, first_line

Frame = NDArray[np.uint8] | NDArray[np.uint16]

TIFF = (".tif", ".tiff")
PICTURES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp")
VIDEOS = (".avi", ".mkv", ".mp4", ".mov", ".m4v", ".mpg", ".webm")
GREY = (b"Y800", b"GREY", b"I420", b"Y1\0\n", b"Y1\0\x0c", b"Y1\0\x0e", b"Y1\0\x10")  # of I420 the grey plane
GREY_WEIGHTS = (
    0.299,
    0.587,
    0.114,
)  # ITU-R BT.601, as OpenCV and scikit-image's users expect of red, green, blue


class Frames(Sequence[Any]):
    """A sequence of grey (h, w) uint8 or uint16 frames, each read when asked for."""

    fps = 0.0  # that a video file claims

    def __init__(self, count: int, shape: tuple[int, int], dtype: Any, fetch: Callable[[int], Frame]) -> None:
        self.shape = (count, *shape)
        self.dtype = np.dtype(dtype)
        self._fetch = fetch

    def __len__(self) -> int:
        return self.shape[0]

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> list[Frame]: ...
    def __getitem__(self, index: int | slice) -> Frame | list[Frame]:
        if isinstance(index, slice):
            return [self._fetch(k) for k in range(*index.indices(len(self)))]
        if not -len(self) <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        return self._fetch(index % len(self))

    def __iter__(self) -> Iterator[Frame]:
        return (self._fetch(k) for k in range(len(self)))


@dataclass(frozen=True, eq=False)
class Clip:
    """One recording: its number, camera and frames; ``note`` says what was converted or assumed."""

    number: int
    camera: Camera
    frames: Frames
    note: str = ""


@dataclass(frozen=True)
class Source:
    """Where clips come from. Cheap to send to another process: files are opened by ``clip``."""

    path: Path
    clips: tuple[tuple[int, Path], ...]
    camera: Path | None = None
    dataset: bool = False

    def __len__(self) -> int:
        return len(self.clips)

    def clip(self, index: int) -> Clip:
        """Opens clip ``index`` (its index in the source, not its number)."""
        number, location = self.clips[index]
        own = location.parent / "camera.json" if location.is_file() else location / "camera.json"
        chosen = self.camera if self.camera is not None else own if own.is_file() else None
        if chosen is None and self.dataset:
            raise InputError(f"{own}: no such file, expected the clip's camera.json")
        frames, note = open_frames(location)
        camera = Camera.read(chosen) if chosen is not None else None
        return recorded(number, frames, note, camera, (f"{location}", f"{chosen}"))

    def camera_files(self) -> list[Path]:
        """The camera file of each clip, where there is one."""
        if self.camera is not None:
            return [self.camera]
        files = [(p.parent if p.is_file() else p) / "camera.json" for _, p in self.clips]
        return [f for f in files if f.is_file()]


def recorded(number: int, frames: Frames, note: str, camera: Camera | None, names: tuple[str, str]) -> Clip:
    """Frames and their camera as one clip. names: of film and camera, for the InputError where their sizes differ."""
    size, bits = (frames.shape[2], frames.shape[1]), 8 * frames.dtype.itemsize
    if camera is None:
        note = "; ".join(filter(None, [note, "no camera file: pixels only"]))
        return Clip(number, Camera.unknown(size, bits), frames, note)
    if camera.size != size:
        asked = "x".join(map(str, camera.size))
        raise InputError(f"{names[0]}: frames are {size[0]}x{size[1]}, expected {asked} by size in {names[1]}")
    if "sensor.bits" in camera.assumed:
        camera = replace(camera, sensor=replace(camera.sensor, bits=bits))
    return Clip(number, camera, frames, note)


def open_source(path: Path | str, camera: Path | str | None = None) -> Source:
    """Source behind ``path``; ``camera`` stands in for the source's own camera.json. Raises InputError."""
    location = Path(path)
    given = Path(camera) if camera is not None else None
    if given is not None:
        Camera.read(given)
    if not location.exists():
        raise InputError(f"{location}: no such file or folder, expected a dataset, clip, stack, video or pictures")
    if location.is_file():
        if location.suffix.lower() not in TIFF + VIDEOS:
            raise InputError(
                f"{location}: expected a TIFF stack or a video, not a {location.suffix or 'nameless'} file"
            )
        return Source(location, ((0, location),), given)
    if (location / "clips").is_dir():
        return _dataset(location, given)
    if (location / "frames.tif").is_file():
        number = int(location.name) if location.name.isdecimal() else 0
        return Source(location, ((number, location / "frames.tif"),), given)
    if not _pictures(location):
        raise InputError(f"{location}: an empty folder, expected clips/, frames.tif or pictures ({' '.join(PICTURES)})")
    return Source(location, ((0, location),), given)


def _dataset(location: Path, camera: Path | None) -> Source:
    clips = []
    for folder in sorted((location / "clips").iterdir()):
        if folder.is_dir() and folder.name.isdecimal():
            if not (folder / "frames.tif").is_file():
                raise InputError(f"{folder / 'frames.tif'}: no such file, expected the clip's frames")
            clips.append((int(folder.name), folder / "frames.tif"))
    if not clips:
        raise InputError(f"{location / 'clips'}: no clips, expected folders 000000, 000001, ...")
    return Source(location, tuple(sorted(clips)), camera, dataset=True)


def open_frames(location: Path) -> tuple[Frames, str]:
    """Frames of a stack, a video or a folder of pictures, and a note of what was converted."""
    if location.is_dir():
        frames, note = _folder(location)
    elif location.suffix.lower() in TIFF:
        frames, note = _stack(location)
    else:
        frames, note = _video(location)
    at_least_two(location, frames)
    return frames, note


def at_least_two(location: Path | str, frames: Frames) -> None:
    """Raises InputError for less than two frames."""
    if len(frames) < 2:
        raise InputError(f"{location}: one frame only, expected at least two to follow a ball")


def _pictures(folder: Path) -> list[Path]:
    """Pictures of a folder, 2 before 10."""
    found = [p for p in folder.iterdir() if p.suffix.lower() in PICTURES and p.is_file()]
    return sorted(found, key=lambda p: [int(s) if s.isdigit() else s for s in re.split(r"(\d+)", p.name)])


def _stack(path: Path) -> tuple[Frames, str]:
    try:
        with _complaints(path), tifffile.TiffFile(path) as tif:
            shape, dtype, colour, offset = _layout(path, tif)
            order = tif.byteorder
    except (tifffile.TiffFileError, OSError, IndexError, KeyError, struct.error) as error:
        raise InputError(f"{path}: cannot be read as TIFF, truncated or damaged ({first_line(error)})") from None
    plane = shape[-3:] if colour else shape[-2:]
    if len(shape) < len(plane) or 0 in shape:
        raise InputError(f"{path}: expected a stack of pictures, not an array of {shape}")
    not_too_large(path, plane)
    count = int(np.prod(shape[: len(shape) - len(plane)], dtype=np.int64))
    pixel_type(path, dtype)
    if offset is not None:
        fetch: Callable[[int], Any] = _Pieces(path, offset, count, plane, dtype.newbyteorder(order))
    else:
        fetch = _Pages(path, plane)
        try:
            fetch(count - 1)
        except InputError:
            raise InputError(f"{path}: truncated, frame {count - 1} of {count} cannot be read") from None
    return grey_frames(path, count, plane, dtype, fetch)


@contextmanager
def _complaints(path: Path) -> Iterator[None]:
    """tifffile logs a broken chain of pages and goes on with the pages it has: here that is an error."""
    heard, logger = _Heard(logging.ERROR), logging.getLogger("tifffile")
    passed_on = logger.propagate
    logger.addHandler(heard)
    logger.propagate = False
    try:
        yield
    finally:
        logger.propagate = passed_on
        logger.removeHandler(heard)
    if heard.said:
        raise InputError(f"{path}: truncated or damaged ({heard.said[0].splitlines()[0][:120]})")


class _Heard(logging.Handler):
    """Keeps what is logged."""

    def __init__(self, level: int) -> None:
        super().__init__(level)
        self.said: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.said.append(record.getMessage())


def _layout(path: Path, tif: tifffile.TiffFile) -> tuple[tuple[int, ...], Any, bool, int | None]:
    """Shape, type, whether in colour, and where the pixels start if they lie in one piece."""
    series = tif.series[0]
    shape, dtype, offset = tuple(series.shape), np.dtype(series.dtype), series.dataoffset
    colour = series.axes[-1:] == "S" and shape[-1] in (3, 4)
    if len(tif.series) > 1:  # pages that no program declared to be one stack
        if any(s.shape != shape or s.dtype != dtype for s in tif.series):
            raise InputError(f"{path}: pages of unequal size or type, expected all alike")
        plane = shape[-3:] if colour else shape[-2:]
        return (len(tif.pages), *plane), dtype, colour, None
    return shape, dtype, colour, None if offset is None else int(offset)


class _Pieces:
    """Frames that lie one after the other: read by their offset in the file, so that no more than one is held."""

    def __init__(self, path: Path, offset: int, count: int, plane: tuple[int, ...], dtype: Any) -> None:
        self.path, self.offset, self.count, self.plane, self.dtype = path, offset, count, plane, dtype
        self.pixels = int(np.prod(plane))
        missing = offset + count * self.pixels * dtype.itemsize - path.stat().st_size
        if missing > 0:
            raise InputError(f"{path}: truncated, {missing} bytes short of {count} frames")
        self.file = path.open("rb", buffering=0)

    def __call__(self, k: int) -> Any:
        flat = np.empty(self.pixels, dtype=self.dtype)
        self.file.seek(self.offset + k * flat.nbytes)
        if self.file.readinto(flat.view(np.uint8).data) < flat.nbytes:
            raise InputError(f"{self.path}: truncated, frame {k} of {self.count} cannot be read")
        return flat.reshape(self.plane).astype(self.dtype.newbyteorder("="), copy=False)

    def __del__(self) -> None:
        if hasattr(self, "file"):
            self.file.close()


class _Pages:
    """Compressed frames or frames apart: one page of the file each; the file stays open between them."""

    def __init__(self, path: Path, plane: tuple[int, ...]) -> None:
        self.path, self.plane = path, plane
        self.file = tifffile.TiffFile(path)

    def __call__(self, k: int) -> Any:
        try:
            return np.asarray(self.file.pages[k].asarray()).reshape(self.plane)
        except Exception as error:  # decoders raise their own kinds
            raise InputError(f"{self.path}: frame {k} cannot be read ({first_line(error)})") from None

    def __del__(self) -> None:
        if hasattr(self, "file"):
            self.file.close()


def _folder(folder: Path) -> tuple[Frames, str]:
    paths = _pictures(folder)
    first = _picture(paths[0])
    pixel_type(paths[0], first.dtype)
    not_too_large(paths[0], first.shape)

    def fetch(k: int) -> Any:
        picture = _picture(paths[k])
        if picture.shape != first.shape or picture.dtype != first.dtype:
            has, wants = (f"{'x'.join(map(str, a.shape[1::-1]))} {a.dtype}" for a in (picture, first))
            raise InputError(f"{paths[k]}: {has}, expected {wants} as in {paths[0].name}")
        return picture

    return grey_frames(folder, len(paths), first.shape, first.dtype, fetch)


def _picture(path: Path) -> Any:
    if path.suffix.lower() in TIFF:
        try:
            return np.asarray(tifffile.imread(path))
        except Exception as error:
            raise InputError(f"{path}: cannot be read as TIFF, truncated or damaged ({first_line(error)})") from None
    try:
        picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:  # a header that promises more than there is memory for
        raise InputError(f"{path}: cannot be read as a picture ({first_line(error)})") from None
    if picture is None:
        raise InputError(f"{path}: cannot be read as a picture, truncated or damaged")
    return picture[..., 2::-1] if picture.ndim == 3 else picture  # OpenCV gives blue first


def _video(path: Path) -> tuple[Frames, str]:
    with _quiet():
        reader, note = _reader(path)
        ok, first = reader.read()
        if not ok or first is None:
            raise InputError(f"{path}: no frame can be decoded, expected a video that FFmpeg reads")
        count = 1  # containers' own counts are guesses: count what can be decoded
        while reader.grab():
            count += 1
        fps = float(reader.get(cv2.CAP_PROP_FPS))
        reader.release()
    plane = first.shape[:2] if first.shape[2:] == (1,) else first.shape
    state: dict[str, Any] = {"next": -1}

    def fetch(k: int) -> Any:
        with _quiet():
            if state["next"] < 0 or k < state["next"]:
                state["reader"], _ = _reader(path)
                state["next"] = 0
            while state["next"] < k:
                state["reader"].grab()
                state["next"] += 1
            ok, frame = state["reader"].read()
            state["next"] += 1
        if not ok:
            raise InputError(f"{path}: frame {k} of {count} cannot be decoded")
        frame = frame.reshape(plane)
        return frame[..., 2::-1] if frame.ndim == 3 else frame

    frames, grey = grey_frames(path, count, plane, first.dtype, fetch)
    frames.fps = fps
    return frames, "; ".join(filter(None, [note, grey]))


def _reader(path: Path) -> tuple[cv2.VideoCapture, str]:
    """A video from its start, and a note of what is lost: grey as it is stored, all else as 8 bits of colour."""
    raw = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_CONVERT_RGB, 0])
    code = int(raw.get(cv2.CAP_PROP_CODEC_PIXEL_FORMAT)) & 0xFFFFFFFF
    kind = code.to_bytes(4, "little")
    if kind in GREY:
        return raw, ""
    deep = kind[:1] == b"Y" and 8 < kind[3] <= 16  # FFmpeg's codes end with the depth
    return cv2.VideoCapture(str(path)), f"{kind[3]} bits of colour read as 8" if deep else ""


@contextmanager
def _quiet() -> Iterator[None]:
    """OpenCV says nothing: it warns, at each frame, of grey planes taken as they are, which is done on purpose."""
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)


def grey_frames(
    path: Path | str, count: int, plane: tuple[int, ...], dtype: Any, fetch: Callable[[int], Any]
) -> tuple[Frames, str]:
    """Frames in grey, and a note where they were in colour."""
    if len(plane) == 2:
        return Frames(count, (plane[0], plane[1]), dtype, fetch), ""
    if len(plane) != 3 or plane[2] not in (2, 3, 4):
        raise InputError(f"{path}: pictures of shape {plane}, expected (height, width) or colour")

    def grey(k: int) -> Any:
        mix = fetch(k)[..., :3] @ np.array(GREY_WEIGHTS)
        return np.round(mix).astype(dtype)

    return Frames(count, (plane[0], plane[1]), dtype, grey), "colour converted to grey"


def not_too_large(path: Path | str, plane: tuple[int, ...]) -> None:
    height, width = plane[:2]
    if height * width > MOST_PIXELS or max(height, width) > LONGEST_SIDE:
        raise InputError(f"{path}: pictures of {width} x {height}, expected at most {MOST_PIXELS} pixels")


def pixel_type(path: Path | str, dtype: Any) -> None:
    if dtype.kind == "f":
        raise InputError(f"{path}: float pixels, expected counts as uint8 or uint16 (NaN has no place in them)")
    if dtype not in (np.uint8, np.uint16):
        raise InputError(f"{path}: pixels of type {dtype}, expected uint8 or uint16")
