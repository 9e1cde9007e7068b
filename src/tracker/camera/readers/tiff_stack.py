"""Reads TIFF stacks, a frame at a time.

The metadata say which axis is time (ImageJ, OME, tifffile's own). If none is, the longest other axis is taken. Other
axes, such as channels and focal planes, are reduced to one entry, the first or the one that the user selects.
"""

import logging
import math
import struct
import sys
import weakref
import xml.etree.ElementTree
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from logging.handlers import BufferingHandler
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tifffile

from synthcam_shared.arrays import Ints
from synthcam_shared.errors import InputError, first_line
from tracker.camera.film_options import DEFAULT_OPTIONS, FilmOptions
from tracker.camera.frame_times import FilmClock, drop_copies, read_clock
from tracker.camera.frames import Frames, check_frame_size, check_pixel_type, make_grey_frames
from tracker.camera.readers.film_axes import choose_axis_entries, choose_axis_entry

logging.getLogger("tifffile").addHandler(logging.NullHandler())  # its warnings name lines of source code


@dataclass(frozen=True, eq=False)
class _Layout:
    """Layout of the frames of a stack: pages, or one after the other from an offset."""

    plane: tuple[int, ...]  # shape of a page
    axes: str  # of a page, of Y, X, S
    pages: Ints  # of each frame, its page
    total: int  # pages in the file
    dtype: np.dtype[Any]
    offset: int | None
    notes: tuple[str, ...]
    sample: int | None  # the sample of a pixel that is taken, where it is no colour


def read_tiff_stack(path: Path, options: FilmOptions = DEFAULT_OPTIONS) -> Frames:
    """Frames of a TIFF stack. Raises InputError if it is damaged."""
    # that tifffile raises at damaged tags
    unreadable = RuntimeError, ValueError, TypeError, AttributeError, AssertionError
    try:
        with _raise_logged_errors(path), tifffile.TiffFile(path) as tif:
            layout = _read_layout(path, tif, options)
            doubts = _check_file(path, tif, layout)
            order = tif.byteorder
            paint, notes = choose_light_conversion(tif.series[0].keyframe)
            clock = _read_times(tif, layout) if options.times != "even" else None
    except InputError:
        raise
    except (tifffile.TiffFileError, OSError, LookupError, ArithmeticError, struct.error, *unreadable) as error:
        raise InputError(f"{path}: cannot be read as TIFF, truncated or damaged ({first_line(error)})") from None
    if 0 in layout.plane:
        raise InputError(f"{path}: expected a stack of pictures, not an array of {layout.plane}")
    check_frame_size(path, tuple(layout.plane[layout.axes.index(axis)] for axis in "YX"))
    check_pixel_type(path, layout.dtype)
    read: Callable[[int], Any]
    if layout.offset is not None:
        read = _read_by_offset(path, layout, layout.dtype.newbyteorder(order))
    else:
        read = _read_pages(path, layout)
        try:
            read(len(layout.pages) - 1)
        except InputError:
            last = len(layout.pages) - 1
            raise InputError(f"{path}: truncated, frame {last} of {last + 1} cannot be read") from None

    def fetch(k: int) -> Any:
        picture = read(k)
        if layout.axes == "SYX":
            picture = np.moveaxis(picture, 0, -1)
        if layout.sample is not None:
            picture = np.ascontiguousarray(picture[..., layout.sample])
        return paint(picture) if paint is not None else picture

    first = fetch(0)
    frames = make_grey_frames(path, len(layout.pages), first.shape, first.dtype, fetch)
    frames.faults = (*layout.notes, *notes, *doubts)
    if clock is not None:
        clock.set(frames)
    return drop_copies(frames, _list_pieces(path, layout))


def choose_light_conversion(page: Any) -> tuple[Callable[[Any], Any] | None, tuple[str, ...]]:
    """Find how pixels of a TIFF page become light, if they are inverted counts or entries of a palette."""
    photometric, bits = int(page.photometric), int(page.bitspersample)
    if photometric == 0:  # MinIsWhite
        top = 2**bits - 1
        return (lambda picture: (top - picture).astype(picture.dtype)), ("MinIsWhite: counts are inverted",)
    if photometric == 3 and page.colormap is not None:
        colours = np.asarray(page.colormap).T  # red, green and blue of each entry, 16 bit
        if np.ptp(colours, axis=1).max() == 0 and np.array_equal(colours[:, 0] >> 8, np.arange(len(colours))):
            return None, ()  # the entries are greys in order
        table = (colours >> 8).astype(np.uint8)
        grey = np.ptp(table, axis=1).max() == 0
        table = table[:, 0].copy() if grey else table
        return (lambda picture: table[picture]), (f"palette: converted to {'grey' if grey else 'colours'}",)
    return None, ()


@contextmanager
def _raise_logged_errors(path: Path) -> Iterator[None]:
    """Raise an error where tifffile only logs a broken chain of pages and continues with the pages it has."""
    heard, logger = BufferingHandler(sys.maxsize), logging.getLogger("tifffile")
    heard.setLevel(logging.ERROR)
    passed_on = logger.propagate
    logger.addHandler(heard)
    logger.propagate = False
    try:
        yield
    finally:
        logger.propagate = passed_on
        logger.removeHandler(heard)
    if heard.buffer:
        message = heard.buffer[0].getMessage()
        raise InputError(f"{path}: truncated or damaged ({message.splitlines()[0][:120]})")


def _read_layout(path: Path, tif: tifffile.TiffFile, options: FilmOptions) -> _Layout:
    series, wanted = tif.series[0], options.indices()
    page, offset, dtype = series.keyframe, series.dataoffset, np.dtype(series.dtype)
    plane, axes = tuple(page.shape), str(page.axes)
    if len(tif.series) > 1:  # pages that no program declared to be one stack
        if any(s.shape != series.shape or s.dtype != series.dtype for s in tif.series):
            raise InputError(f"{path}: pages of unequal size or type, expected all the same")
        outer: tuple[int, ...] = (len(tif.pages),)
        letters, offset = "T", None
    else:
        outer, letters = tuple(series.shape), str(series.axes)
        inner = len(letters) - next((n for n in range(len(letters)) if math.prod(outer[n:]) == math.prod(plane)), 0)
        outer, letters = outer[: len(letters) - inner], letters[: len(letters) - inner]
    if set(axes) - set("SYX") or not {"Y", "X"} <= set(axes):
        raise InputError(
            f"{path}: truncated or damaged, a page has the axes {axes or None}, expected those of a picture"
        )
    samples, sample, notes = plane[axes.index("S")] if "S" in axes else 1, None, list[str]()
    if samples > 4 or "S" in wanted or (samples > 1 and _has_unnamed_samples(page)):
        sample = choose_axis_entry(path, "S", samples, wanted, notes)
    lengths = dict(zip(letters, outer, strict=True))
    time, chosen = choose_axis_entries(path, lengths, wanted, notes)
    count = lengths.get(time, 1)
    index = tuple(np.arange(count) if axis == time else np.full(count, chosen[axis]) for axis in letters)
    pages = np.ravel_multi_index(index, outer) if outer else np.zeros(1)
    pages, start = np.asarray(pages, dtype=np.int64), None if offset is None else int(offset)
    return _Layout(plane, axes, pages, math.prod(outer), dtype, start, tuple(notes), sample)


def _has_unnamed_samples(page: Any) -> bool:
    """Whether the pixels of a grey picture have further samples that are no transparency."""
    grey, transparency = (0, 1), (1, 2)  # of the tags PhotometricInterpretation and ExtraSamples
    return int(page.photometric) in grey and not (page.extrasamples and set(page.extrasamples) <= set(transparency))


def _check_file(path: Path, tif: tifffile.TiffFile, layout: _Layout) -> tuple[str, ...]:
    """Raise InputError for a file whose tags contradict it: pixels where tags or other pixels lie, or too few frames.

    A damaged tag, such as an offset, else gives other pixels without an error. Notes say what is doubtful: pages with
    the pixels of others, and bytes for frames that no page refers to. If a stack has several files, only this one is
    checked.
    """
    bilevel, tags = (2, 3, 4), [_read_tags(tif, offset) for offset in _list_page_offsets(tif)]
    if layout.offset is None:
        every = [each for each in _list_pages(tif) if each is not None and each.parent is tif]
    else:  # to read a page takes as long as to measure a glint: of pages with the same tags, one is read
        first = dict(reversed([(each.content, k) for k, each in enumerate(tags)]))
        every = [tif.pages[k] for k in first.values()]
    for each in every:
        if int(each.compression) in bilevel and int(each.bitspersample) != 1:
            raise InputError(f"{path}: damaged, pixels of {each.bitspersample} bits, compressed as black and white")
    page: Any = tif.series[0].keyframe
    if (size := page.tags.get("BitsPerSample")) is not None and size.count not in (1, page.samplesperpixel):
        raise InputError(f"{path}: damaged, the bits of {size.count} samples, but {page.samplesperpixel} in a pixel")
    if len(tif.pages) > layout.total:
        raise InputError(
            f"{path}: truncated or damaged, {len(tif.pages)} pages, but its metadata declare {layout.total}"
        )
    if layout.offset is None:
        frames = [
            tuple((at, at + n) for at, n in zip(each.dataoffsets, each.databytecounts, strict=True) if n)
            for each in every
        ]
        data, count = {part for parts in frames for part in parts}, len(frames)
    else:
        size = layout.total * math.prod(layout.plane) * layout.dtype.itemsize
        frames, data, count = [], {(layout.offset, layout.offset + size)}, layout.total
    about = {(0, 16 if tif.is_bigtiff else 8)}.union(*(each.spans for each in tags))
    spans = sorted((first, last, name) for name, some in (("pixels", data), ("tags", about)) for first, last in some)
    for before, after in pairwise(spans):
        if after[0] < before[1] and "pixels" in (before[2], after[2]):
            raise InputError(f"{path}: damaged, {before[2]} and {after[2]} lie at the same bytes, from {after[0]} on")
    notes = list[str]()
    if layout.offset is not None and 1 < len(tif.pages) < layout.total:  # one page for all frames is ordinary
        notes.append(
            f"{len(tif.pages)} pages, but the metadata declare {layout.total} frames: all of them are read;"
            " if the film is not right, write the stack again"
        )
    if len(set(frames)) < len(frames):
        notes.append(f"{len(frames) - len(set(frames))} pages have the pixels of another page; is the file damaged?")
    ends, starts = (0, *(last for _, last, _ in spans)), (*(first for first, _, _ in spans), path.stat().st_size)
    gap = max(start - end for start, end in zip(starts, np.maximum.accumulate(ends).tolist(), strict=True))
    if gap >= max(sum(last - first for first, last in data) / max(count, 1), 1000):
        notes.append(f"{gap} bytes in a row belong to no page: are frames lost?")
    return tuple(notes)


def _list_pages(tif: tifffile.TiffFile) -> Any:
    return tif.pages if len(tif.series) > 1 else tif.series[0].pages


class _PageTags(NamedTuple):
    """The tags of a page: where they lie in the file, and what they say."""

    spans: tuple[tuple[int, int], ...]  # first and beyond last byte, also of values that lie apart from their tags
    content: tuple[bytes, ...]  # all but where the pixels and those values lie


def _list_page_offsets(tif: tifffile.TiffFile) -> list[int]:
    """Where the tags of each page lie: each page says where the next one is."""
    tiff: Any = tif.tiff
    file, found, pages = tif.filehandle, list[int](), len(tif.pages)
    file.seek(tiff.offsetsize)  # in the header, the offset of the first page
    for _ in range(pages):
        (offset,) = struct.unpack(tiff.offsetformat, file.read(tiff.offsetsize))
        found.append(offset)
        file.seek(offset)
        (count,) = struct.unpack(tiff.tagnoformat, file.read(tiff.tagnosize))
        file.seek(offset + tiff.tagnosize + count * tiff.tagsize)
    return found


def _read_tags(tif: tifffile.TiffFile, offset: int) -> _PageTags:
    """Read the tags of a page as they are stored."""
    strip_offsets = 273  # the number of the tag
    tiff: Any = tif.tiff
    file, order, inline = tif.filehandle, tiff.byteorder, tiff.offsetsize
    file.seek(offset)
    (count,) = struct.unpack(tiff.tagnoformat, file.read(tiff.tagnosize))
    tags = file.read(count * tiff.tagsize)
    spans, content = [(offset, offset + tiff.tagnosize + len(tags) + inline)], list[bytes]()
    for start in range(0, len(tags) - tiff.tagsize + 1, tiff.tagsize):
        tag = tags[start : start + tiff.tagsize]
        number, kind, values = struct.unpack_from(f"{order}HH{'Q' if inline == 8 else 'I'}", tag)
        size = values * struct.calcsize(f"={tifffile.TIFF.DATA_FORMATS.get(kind, '')}")
        content.append(tag[:-inline])
        if size > inline:
            first = int.from_bytes(tag[-inline:], "little" if order == "<" else "big")
            spans.append((first, first + size))
            file.seek(first)
            content.append(file.read(min(size, 1 << 16)))
        elif number != strip_offsets:
            content.append(tag[-inline:])
    return _PageTags(tuple(spans), tuple(content))


def _read_by_offset(path: Path, layout: _Layout, dtype: np.dtype[Any]) -> Callable[[int], Any]:
    """A reader of frames that lie one after the other, by their offset in the file; no more than one is held."""
    pixels, count = math.prod(layout.plane), len(layout.pages)
    assert layout.offset is not None
    start = layout.offset
    missing = start + layout.total * pixels * dtype.itemsize - path.stat().st_size
    if missing > 0:
        raise InputError(f"{path}: truncated, {missing} bytes short of {layout.total} frames")
    file = path.open("rb", buffering=0)

    def fetch(k: int) -> Any:
        flat = np.empty(pixels, dtype=dtype)
        file.seek(start + int(layout.pages[k]) * flat.nbytes)
        if file.readinto(flat.view(np.uint8).data) < flat.nbytes:
            raise InputError(f"{path}: truncated, frame {k} of {count} cannot be read")
        return flat.reshape(layout.plane).astype(dtype.newbyteorder("="), copy=False)

    weakref.finalize(fetch, file.close)
    return fetch


def _read_pages(path: Path, layout: _Layout) -> Callable[[int], Any]:
    """A reader of frames that are compressed or apart, one page of the file each; the file stays open between them."""
    file = tifffile.TiffFile(path)
    pages = _list_pages(file)

    def fetch(k: int) -> Any:
        try:
            page = pages[int(layout.pages[k])]
            if page is None:
                raise ValueError("the file does not hold it")
            picture = np.asarray(page.asarray())
            if (picture.size, picture.dtype) != (math.prod(layout.plane), layout.dtype.newbyteorder("=")):
                raise ValueError(f"{picture.shape} of {picture.dtype}, expected {layout.plane} of {layout.dtype}")
            return picture.reshape(layout.plane)
        except Exception as error:  # decoders raise their own kinds
            raise InputError(f"{path}: frame {k} cannot be read ({first_line(error)})") from None

    weakref.finalize(fetch, file.close)
    return fetch


def _list_pieces(path: Path, layout: _Layout) -> tuple[Callable[[int], Any], ...]:
    """Functions that give parts of a frame as they are stored, by which two frames are compared."""
    file = path.open("rb", buffering=0)

    def read_at(offset: int, size: int) -> bytes:
        file.seek(offset)
        return file.read(size)

    weakref.finalize(read_at, file.close)
    if layout.offset is not None:
        size = math.prod(layout.plane) * layout.dtype.itemsize
        starts, part = (layout.offset + layout.pages * size).tolist(), min(size, 1 << 12)
        return lambda k: read_at(starts[k] + (size - part) // 2, part), lambda k: read_at(starts[k], size)
    tif = tifffile.TiffFile(path)
    pages = _list_pages(tif)

    def list_counts(k: int) -> Any:
        page = pages[int(layout.pages[k])]
        elsewhere = page is None or page.parent is not tif  # in another file of the stack: never the same
        return (k,) if elsewhere else tuple(page.databytecounts)

    def read_parts(k: int) -> list[bytes]:
        page = pages[int(layout.pages[k])]
        return [read_at(offset, size) for offset, size in zip(page.dataoffsets, page.databytecounts, strict=True)]

    weakref.finalize(list_counts, tif.close)
    return list_counts, read_parts


def _read_times(tif: tifffile.TiffFile, layout: _Layout) -> FilmClock | None:
    """The clock of a stack: OME's DeltaT or TimeIncrement, ImageJ's interval."""
    unit = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "msec": 1e-3, "µs": 1e-6, "us": 1e-6, "min": 60.0, "": 1.0}
    if tif.ome_metadata:
        return _read_ome_times(tif.ome_metadata, len(layout.pages), unit)
    known = tif.imagej_metadata or {}
    interval = known.get("finterval", 0)
    seconds = unit.get(str(known.get("tunit", "s")).strip().lower(), math.nan)
    if isinstance(interval, int | float) and interval > 0 and seconds > 0:
        return FilmClock(np.arange(len(layout.pages)), 1 / (interval * seconds))
    return None


def _read_ome_times(text: str, count: int, unit: dict[str, float]) -> FilmClock | None:
    try:
        pixels = next(e for e in xml.etree.ElementTree.fromstring(text).iter() if e.tag.endswith("}Pixels"))
        times = dict[int, float]()
        for plane in (e for e in pixels if e.tag.endswith("}Plane")):
            seconds = unit.get(plane.get("DeltaTUnit", "s"), math.nan)
            times.setdefault(int(plane.get("TheT", "0")), float(plane.get("DeltaT", "nan")) * seconds)
        if len(times) == count:
            # OME writes times with the digits of a float
            ticks = np.array([times[k] for k in sorted(times)])
            if (clock := read_clock(np.round(ticks * 1e6), 1e-6, "DeltaT")) is not None:
                return clock
        step = float(pixels.get("TimeIncrement", "nan")) * unit.get(pixels.get("TimeIncrementUnit", "s"), math.nan)
    except (StopIteration, ValueError, xml.etree.ElementTree.ParseError):
        return None
    return FilmClock(np.arange(count), 1 / step) if step > 0 else None
