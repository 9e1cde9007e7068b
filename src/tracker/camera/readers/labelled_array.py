"""Reads films in arrays whose axes have names: Zarr (and OME-Zarr), HDF5, NetCDF.

The largest array of whole numbers is the film. Its attributes name the axes. Without names the last two are the rows
and columns. If the last axis has 3 or 4 entries, these are colours, and the two axes before are rows and columns. A
coordinate of the axis of time gives the times of frames.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam_shared.errors import InputError, first_line
from tracker.camera.film_options import FilmOptions
from tracker.camera.frame_times import FilmClock, describe_missing, drop_equal_pictures, read_clock
from tracker.camera.frames import Frames, make_grey_frames
from tracker.camera.readers.film_axes import choose_axis_entries

HDF5 = (".h5", ".hdf5", ".hdf", ".he5", ".nc", ".nc4", ".cdf", ".netcdf")
UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0}
UNITS |= {"sec": 1.0, "second": 1.0, "millisecond": 1e-3, "microsecond": 1e-6, "nanosecond": 1e-9, "minute": 60.0}
UNITS |= {"hour": 3600.0, "day": 86400.0, "msec": 1e-3, "usec": 1e-6}


@dataclass(frozen=True, eq=False)
class LabelledArray:
    """An array of a file: its name, the names of its axes, what gives its counts, and its coordinate of time."""

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    axes: tuple[str | None, ...]  # their names in the file; None for an axis without one
    chunks: tuple[int, ...]  # entries along each axis that are stored, and so read, together
    read: Callable[[Any], NDArray[Any]]  # takes an index, as ``array[index]`` does
    coordinate: Callable[[str], tuple[NDArray[Any], str] | None]
    """Takes the name of an axis: its values (n,), and their unit, "" if it has none; or None."""
    step: float = 0.0  # spacing of frames, s, where the file gives that alone; else 0


def is_zarr(path: Path) -> bool:
    """Test whether a folder is a Zarr store."""
    names = ("zarr.json", ".zarray", ".zgroup")
    return path.is_dir() and any((path / name).is_file() for name in names)


def read_labelled_array(path: Path, options: FilmOptions) -> Frames:
    """Read the frames of the largest array in a file with named axes. Raises InputError, also for a missing library."""
    max_block_bytes = 256 << 20  # of the chunks that are read at once and kept
    film, notes = _choose_film(path)
    letters = name_axes(film)
    picture = [letters.index("Y"), letters.index("X")]
    if "S" in letters and 2 <= film.shape[letters.index("S")] <= 4:
        picture.append(letters.index("S"))
    outer = [k for k in range(len(letters)) if k not in picture]
    lengths = {letters[k]: film.shape[k] for k in outer}
    time, chosen = choose_axis_entries(path, lengths, options.indices(), notes)
    at, order = letters.index(time) if time else -1, np.argsort(np.argsort(picture))
    dtype = np.dtype(np.uint8 if film.dtype.itemsize == 1 else np.uint16) if film.dtype.kind in "iu" else film.dtype
    plane, count = tuple(film.shape[k] for k in picture), lengths.get(time, 1)
    step = max(1, min(film.chunks[at] if time else 1, max_block_bytes // (math.prod(plane) * film.dtype.itemsize)))
    kept: dict[int, NDArray[Any]] = {}

    def fetch(k: int) -> Any:
        block = k // step
        if block not in kept:
            index = [slice(None) if i in picture else chosen.get(letters[i], 0) for i in range(len(letters))]
            if time:
                index[at] = slice(block * step, min((block + 1) * step, count))
            try:
                found = np.asarray(film.read(tuple(index)))
            except (OSError, ValueError, KeyError, RuntimeError) as error:
                raise InputError(f"{path}: frame {k} cannot be read ({first_line(error)})") from None
            kept.clear()
            kept[block] = np.moveaxis(found, sum(i in picture for i in range(at)), 0) if time else found[None]
        shot = np.transpose(kept[block][k % step], order)
        if film.dtype.kind == "i" and film.dtype.itemsize == 1:  # NetCDF 3 has no other bytes
            return np.ascontiguousarray(shot).view(np.uint8)
        if film.dtype != dtype and (shot.min() < 0 or shot.max() > 65535):
            raise InputError(f"{path}: frame {k} has counts from {shot.min()} to {shot.max()}, expected 0 to 65535")
        return np.ascontiguousarray(shot, dtype=dtype)

    frames = make_grey_frames(path, count, plane, dtype, fetch)
    frames.faults = tuple(notes)
    if time and options.times != "even" and (clock := _read_times(film, film.axes[at])) is not None:
        clock.set(frames)
    return drop_equal_pictures(frames, fetch)


def _choose_film(path: Path) -> tuple[LabelledArray, list[str]]:
    """The largest array of whole numbers with three axes or more, and a note if there are others."""
    try:
        if path.is_dir():
            arrays = list(_list_zarr(path))
        else:
            with path.open("rb") as stream:
                is_classic = stream.read(3) == b"CDF"
            arrays = list(_list_classic(path) if is_classic else _list_hdf5(path))
    except InputError:
        raise
    except (OSError, ValueError, KeyError, RuntimeError, TypeError) as error:
        raise InputError(f"{path}: cannot be read, truncated or damaged ({first_line(error)})") from None
    films = [array for array in arrays if len(array.shape) >= 3 and 0 not in array.shape]
    if not films:
        there = ", ".join(f"{array.name} {array.shape}" for array in arrays[:6]) or "none"
        raise InputError(f"{path}: no array of three axes or more, expected (frames, height, width); arrays: {there}")
    whole = [array for array in films if array.dtype.kind in "iu"] or films
    film = max(whole, key=lambda array: math.prod(array.shape))
    return film, [f"array {film.name} is the film, the largest of {len(films)}"] if len(films) > 1 else []


def name_axes(array: LabelledArray) -> str:
    """Name each axis of an array by a letter: T, Y, X, C, Z, S, P, and Q, I, ... for those that are none of these."""
    letters = [""] * len(array.shape)
    names_of_letter = {  # the names of axes that a letter stands for
        "T": "t time frame frames",
        "Y": "y height row rows",
        "X": "x width col cols column columns",
        "S": "s sample samples rgb rgba band bands",
        "C": "c channel channels ch colour color",
        "Z": "z depth plane focus level",
        "P": "p position clip scene",
    }
    for letter, names in names_of_letter.items():
        found = [k for k, name in enumerate(array.axes) if name is not None and name.lower() in names.split()]
        if found:
            letters[found[0]] = letter
    last = len(letters) - 1
    is_colour = letters[last] in ("", "C") and array.shape[last] in (3, 4) and len(letters) > 3
    if is_colour and (letters[last] == "C" or "X" not in letters):  # without names, or as pictures hold them
        letters[last] = "S"
    for letter in "XY":
        if letter not in letters:
            letters[max(k for k, known in enumerate(letters) if not known)] = letter
    other_letters = "QIHEVRA"
    rest = iter(letter for letter in other_letters if letter not in letters)
    free = [k for k, letter in enumerate(letters) if not letter]
    if "T" not in letters and len(free) == 1 and not any(array.axes):
        letters[free[0]], free = "T", []
    for k in free:
        letters[k] = next(rest)
    return "".join(letters)


def _read_times(array: LabelledArray, axis: str | None) -> FilmClock | None:
    """The clock by the coordinate of an axis, or by the spacing of frames."""
    count = array.shape[array.axes.index(axis)]
    known = array.coordinate(axis) if axis else None
    if known is None:
        return FilmClock(np.arange(count), 1 / array.step) if array.step > 0 else None
    values, unit = np.asarray(known[0]), known[1].split(" since ")[0].strip()
    if len(values) != count or values.dtype.kind not in "iuf":
        return None
    if not unit and values.dtype.kind in "iu":  # numbers of frames
        steps = np.diff(values.astype(np.int64))
        if not len(steps) or steps.min() <= 0:
            return None
        numbers = values.astype(np.int64) - int(values[0])
        return FilmClock(numbers, notes=describe_missing(numbers, 0.0, f"the coordinate {axis}"))
    seconds = UNITS.get(unit, UNITS.get(unit.lower().removesuffix("s"), math.nan)) if unit else 1.0
    resolution = 1e-9 if values.dtype.kind == "f" else seconds
    ticks = np.rint(values * (seconds / resolution)) if values.dtype.kind == "f" else values
    return read_clock(ticks, resolution, f"the coordinate {axis}") if math.isfinite(seconds) else None


def _list_zarr(path: Path) -> Iterator[LabelledArray]:
    try:
        import zarr
    except ImportError:
        raise InputError(f"{path}: a Zarr store, which needs zarr; type: pip install 'synthcam[zarr]'") from None
    root = zarr.open(path, mode="r")
    members = dict(root.members(max_depth=None)) if isinstance(root, zarr.Group) else {"": root}
    for key, node in members.items():
        if not isinstance(node, zarr.Array):
            continue
        above, name = (key.rpartition("/")[0], key.rpartition("/")[2]) if key else ("", "/")
        group = members.get(above, root) if key else None
        axes, step = _read_zarr_axes(node, dict(group.attrs) if isinstance(group, zarr.Group) else {}, name)

        def find(axis: str, above: str = above) -> tuple[NDArray[Any], str] | None:
            found = members.get(f"{above}/{axis}".lstrip("/"))
            return (np.asarray(found[:]), str(found.attrs.get("units", ""))) if isinstance(found, zarr.Array) else None

        chunks = tuple(node.shards or node.chunks)
        yield LabelledArray(key or "/", node.shape, np.dtype(node.dtype), axes, chunks, node.__getitem__, find, step)


def _read_zarr_axes(node: Any, group: Mapping[str, Any], name: str) -> tuple[tuple[str | None, ...], float]:
    """Names of the axes, and the spacing of frames, s, which OME-Zarr has as the scale of the axis of time."""
    own = getattr(node.metadata, "dimension_names", None) or node.attrs.get("_ARRAY_DIMENSIONS")
    image = (group.get("ome", group).get("multiscales") or [{}])[0]
    axes, step = image.get("axes", []), 0.0
    if len(axes) != len(node.shape):
        return tuple(own or [None] * len(node.shape)), step
    names = tuple(axis if isinstance(axis, str) else axis.get("name") for axis in axes)
    for level in image.get("datasets", []):
        scales = [c["scale"] for c in level.get("coordinateTransformations", []) if c.get("type") == "scale"]
        if level.get("path") == name and scales and "t" in names and isinstance(axes[names.index("t")], dict):
            unit = UNITS.get(str(axes[names.index("t")].get("unit", "")), 0.0)
            step = float(scales[0][names.index("t")]) * unit
    return names, step


def _list_hdf5(path: Path) -> Iterator[LabelledArray]:
    try:
        import h5py
    except ImportError:
        raise InputError(f"{path}: an HDF5 file, which needs h5py; type: pip install 'synthcam[hdf5]'") from None
    found = list[Any]()
    h5py.File(path, "r").visititems(lambda _, node: found.append(node) if isinstance(node, h5py.Dataset) else None)
    for node in found:
        if node.dtype.kind not in "iuf":
            continue
        # the name of an axis is that of its scale, as NetCDF has it, or its label
        names = (d[0].name.rpartition("/")[2] if len(d) else d.label for d in (node.dims[k] for k in range(node.ndim)))
        axes = tuple(str(name) or None for name in names)

        def find(axis: str, node: Any = node, axes: tuple[str | None, ...] = axes) -> tuple[NDArray[Any], str] | None:
            scales = node.dims[axes.index(axis)]
            scale = scales[0] if len(scales) else node.parent.get(axis)
            about = dict(scale.attrs) if isinstance(scale, h5py.Dataset) else {"NAME": b"not a netCDF variable"}
            if b"not a netCDF variable" in bytes(about.get("NAME", b"")):
                return None
            return np.asarray(scale[:]), _to_text(about.get("units", ""))

        chunks = node.chunks or (1,) * node.ndim
        yield LabelledArray(node.name, node.shape, node.dtype, axes, chunks, node.__getitem__, find)


def _name_hdf5_axis(node: Any, axis: int) -> str | None:
    """The name of an axis: that of its scale, as NetCDF has it, or its label."""
    dimension = node.dims[axis]
    name = dimension[0].name.rpartition("/")[2] if len(dimension) else dimension.label
    return str(name) or None


def _list_classic(path: Path) -> Iterator[LabelledArray]:
    """Arrays of a NetCDF file of version 3, which is read whole."""
    from scipy.io import netcdf_file

    if path.stat().st_size > 1 << 30:
        raise InputError(f"{path}: a NetCDF 3 file above 1 GiB; convert it: nccopy -k netCDF-4 {path.name} film.nc")
    with netcdf_file(path, "r", mmap=False) as file:
        variables = dict(file.variables)

    def find(axis: str) -> tuple[NDArray[Any], str] | None:
        if axis not in variables:
            return None
        values = variables[axis].data
        return values.astype(values.dtype.newbyteorder("=")), _to_text(getattr(variables[axis], "units", ""))

    for name, variable in variables.items():
        data, axes = variable.data, tuple(variable.dimensions)
        if data.dtype.kind in "iuf":
            kind, chunks = data.dtype.newbyteorder("="), (1,) * data.ndim
            yield LabelledArray(name, data.shape, kind, axes, chunks, data.__getitem__, find)


def _to_text(value: Any) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)
