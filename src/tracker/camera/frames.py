"""`Frames`: the grey pictures of a film, or a plane of its colours, read when indexed; counts made linear in light."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, overload

import cv2
import numpy as np
from numpy.typing import NDArray

from synthcam_shared.arrays import Array, Flags, Ints
from synthcam_shared.errors import InputError
from tracker.camera.camera_keys import CHANNELS, CONTRAST, DARK, LONGEST_SIDE, MOST_PIXELS, PLANES
from tracker.camera.colour_planes import is_plane, read_contrast, read_plane

Frame = NDArray[np.uint8] | NDArray[np.uint16]
T = TypeVar("T")

GREY = CHANNELS[0]


class Frames(Sequence[Any]):
    """A sequence of grey (h, w) uint8 or uint16 frames, each read when asked for."""

    fps = 0.0  # frames a second by the film's own clock; 0 if it has none
    lossy = False  # whether they were encoded with loss
    fields = False  # whether they are the fields of interlaced frames, two of each
    aspect = 1.0  # width of a pixel over its height
    seconds: Array | None = None  # time of each frame by that clock, where they are not evenly spaced
    faults: tuple[str, ...] = ()  # of their file
    colours: Callable[[int], Any] | None = None  # red, green and blue (h, w, 3) of a frame, where the film has them
    film_colours: Callable[[int], Any] | None = None  # as `colours`, of the film of which these are a plane
    contents: Any = None  # what a pass over a video found, for `read_video` to open it again without a pass

    def __init__(self, count: int, shape: tuple[int, int], dtype: Any, fetch: Callable[[int], Frame]) -> None:
        self.shape: tuple[int, int, int] = (count, *shape)
        self.numbers: Ints = np.arange(count)  # frame times after the first frame: jumps where some miss
        self.dtype = np.dtype(dtype)
        self._fetch = fetch
        self._kept: dict[int, Frame] = {}

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
        k = index % len(self)
        return self._kept[k] if k in self._kept else self._fetch(k)

    def remember(self, numbers: Iterable[int], most_bytes: int = 600 << 20) -> None:
        """Read these frames in one pass and keep them, because they are asked for again and again, in other orders.

        A video is decoded once for them. Nothing is kept where it would take more than `most_bytes` of memory.
        """
        wanted = sorted(set(numbers))
        if self._kept.keys() >= set(wanted):
            return
        if len(wanted) * math.prod(self.shape[1:]) * self.dtype.itemsize <= most_bytes:
            self._kept = {k: self._kept[k] for k in wanted if k in self._kept}  # the others are released first
            self._kept = {k: self[k] for k in wanted}

    def forget(self) -> None:
        """Release the frames that are kept."""
        self._kept = {}

    def __iter__(self) -> Iterator[Frame]:
        return (self._fetch(k) for k in range(len(self)))

    def with_fetch(self, fetch: Callable[[int], Frame], dtype: Any = None) -> Frames:
        """As many frames of the same size, fetched in another way."""
        return self._share(Frames(len(self), self.shape[1:], dtype or self.dtype, fetch))

    def cut(self, first: int, end: int | None) -> Frames:
        """The frames of these numbers alone, `end` without, which keep their numbers and times."""
        rows = np.flatnonzero((self.numbers >= first) & (self.numbers < (np.inf if end is None else end)))
        if len(rows) < 2:
            raise InputError(f"--frames: {len(rows)} frames from {first} on, expected two at least of {len(self)}")
        out = self.take(rows)
        out.numbers, out.seconds = self.numbers[rows], None if self.seconds is None else self.seconds[rows]
        return out

    def crop(self, area: Flags) -> Frames:
        """The smallest part of each frame that holds an area (h, w)."""
        rows, columns = np.flatnonzero(area.any(axis=1)), np.flatnonzero(area.any(axis=0))
        at = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
        shape = (int(np.ptp(rows)) + 1, int(np.ptp(columns)) + 1)
        return self.convert(lambda picture: np.ascontiguousarray(picture[at]), shape, self.dtype)

    def convert(self, change: Callable[[Any], Any], shape: tuple[int, int], dtype: Any) -> Frames:
        """As many frames, whose pictures and colours a function has changed."""
        out, colours = self._share(Frames(len(self), shape, dtype, lambda k: change(self._fetch(k)))), self.colours
        if colours is not None:
            out.colours = lambda k: change(colours(k))
        return out

    def take(self, rows: Ints) -> Frames:
        """Those frames alone, with their numbers and times."""
        out = self._share(Frames(len(rows), self.shape[1:], self.dtype, lambda k: self._fetch(int(rows[k]))))
        out.faults, colours = self.faults, self.colours
        if colours is not None:
            out.colours = lambda k: colours(int(rows[k]))
        out.numbers = self.numbers[rows] - self.numbers[rows[0]]
        out.seconds = None if self.seconds is None else self.seconds[rows] - self.seconds[rows[0]]
        return out

    def _share(self, out: Frames) -> Frames:
        """Other frames, with what is known of this film and its clock."""
        for name in ("fps", "lossy", "fields", "aspect", "seconds", "numbers", "contents"):
            setattr(out, name, getattr(self, name))
        return out

    def stretch_pixels(self) -> Frames:
        """The same frames with square pixels: `aspect` times as wide, as a player shows them."""
        if abs(self.aspect - 1) < 1e-3:
            return self
        height, width = self.shape[1:]
        size = (round(width * self.aspect), height)

        def stretch(picture: Any) -> Any:
            return cv2.resize(np.ascontiguousarray(picture), size, interpolation=cv2.INTER_CUBIC)

        out = self.convert(stretch, (height, size[0]), self.dtype)
        out.faults, out.aspect = self.faults, 1.0
        return out

    def select_channel(self, name: str) -> Frames:
        """The frames in "dark", "red", "green", "blue" or a plane of `colour_planes`.

        "dark" is white less grey. Raises InputError for any other than "dark" and "contrast" of a film in grey.
        """
        if name not in (*CHANNELS, DARK) and not is_plane(name):
            known = ", ".join((*CHANNELS, DARK, *PLANES, CONTRAST))
            raise InputError(f"--channel: expected one of {known} or #rrggbb, not {name!r}")
        colours = self.colours
        if name == GREY:
            return self
        if name == DARK:
            some = [self[k] for k in spread_frames(self)] if self.dtype != np.uint8 else ()
            white: Any = np.full(self.shape[1:], self.white(some), self.dtype)

            def invert(k: int) -> Any:
                return cv2.subtract(white, np.asarray(self[k]))

            return self.with_fetch(invert)
        if name == CONTRAST:

            def read_grey(k: int) -> Any:
                return np.asarray(self[k])

            return self._convert_later(
                lambda: read_contrast(list(map(read_grey, spread_frames(self)))), read_grey, np.uint8
            )
        if colours is None:
            raise InputError(f"--channel: the film is in grey, expected no {name!r}")

        def sample() -> list[Any]:
            return [np.asarray(colours(k)) for k in sorted({*np.linspace(0, len(self) - 1, 9).astype(int).tolist()})]

        def make() -> Callable[[Any], Any]:
            return read_plane(name, sample, self.white(sample() if self.dtype != np.uint8 else ()))

        out = self._convert_later(make, colours, np.uint8 if is_plane(name) else None)
        out.film_colours = colours
        return out

    def _convert_later(
        self, make: Callable[[], Callable[[Any], Any]], read: Callable[[int], Any], dtype: Any
    ) -> Frames:
        """The frames in a plane; `make` looks at the film when the first frame is asked for."""
        made = cache(make)
        return self.with_fetch(lambda k: made()(read(k)), dtype)

    def white(self, pictures: Sequence[Any]) -> float:
        """The count of white: 255, or the largest of these pictures where the film has more bits."""
        return 255.0 if self.dtype == np.uint8 else float(max(np.max(picture) for picture in pictures)) or 1.0


def make_grey_frames(
    path: Path | str, count: int, plane: tuple[int, ...], dtype: Any, fetch: Callable[[int], Any]
) -> Frames:
    """Frames in grey; those of pictures in colour have ``colours`` too. Raises InputError for other types and sizes."""
    check_pixel_type(path, np.dtype(dtype))
    check_frame_size(path, plane)
    if len(plane) == 2:
        return Frames(count, (plane[0], plane[1]), dtype, fetch)
    if len(plane) != 3 or plane[2] not in (2, 3, 4):
        raise InputError(f"{path}: pictures of shape {plane}, expected (height, width) or colour")
    if plane[2] == 2:  # grey and alpha
        return Frames(count, (plane[0], plane[1]), dtype, lambda k: np.ascontiguousarray(fetch(k)[..., 0]))

    def grey(k: int) -> Any:
        mix = fetch(k)[..., :3] @ np.array((0.299, 0.587, 0.114))  # ITU-R BT.601, of red, green, blue
        return np.round(mix).astype(dtype)

    out = Frames(count, (plane[0], plane[1]), dtype, grey)
    out.colours = fetch
    return out


def linearise_counts(frames: Frames, gamma: float) -> Frames:
    """Linearise frames whose counts are light to the power of 1/gamma: in proportion to light, in 16 bits."""
    top = 2.0 ** (8 * frames.dtype.itemsize) - 1
    table = np.rint((np.arange(top + 1) / top) ** gamma * (2**16 - 1)).astype(np.uint16)
    return frames.convert(lambda picture: table[picture], frames.shape[1:], np.uint16)


def check_two_frames(path: Path | str, frames: Frames) -> None:
    """Check that a recording has two frames or more. Raises InputError."""
    if len(frames) < 2:
        raise InputError(f"{path}: one frame only, expected at least two to follow a ball")


def check_frame_size(path: Path | str, plane: tuple[int, ...]) -> None:
    height, width = plane[:2]
    if height * width > MOST_PIXELS or max(height, width) > LONGEST_SIDE:
        raise InputError(f"{path}: pictures of {width} x {height}, expected at most {MOST_PIXELS} pixels")


def check_pixel_type(path: Path | str, dtype: Any) -> None:
    if dtype.kind == "f":
        raise InputError(f"{path}: float pixels, expected counts as uint8 or uint16 (which cannot hold NaN)")
    if dtype not in (np.uint8, np.uint16):
        raise InputError(f"{path}: pixels of type {dtype}, expected uint8 or uint16")


def spread_frames(frames: Sequence[Any], count: int = 9) -> list[int]:
    """Choose `count` frames that are spread over a film; some come twice in a short one."""
    return [round(k * (len(frames) - 1) / (count - 1)) for k in range(count)]


def pick_spread(items: Sequence[T], count: int) -> list[T]:
    """Pick at most `count` items that are spread over a sequence, such as a film or numbers of frames, each once."""
    return [items[k] for k in sorted({*spread_frames(items, count)})]
