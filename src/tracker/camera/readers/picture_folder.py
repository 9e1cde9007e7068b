"""Reads the pictures of a folder as a film, one at a time."""

import re
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tifffile

from synthcam_shared.arrays import Ints
from synthcam_shared.errors import InputError, first_line
from tracker.camera.film_options import DEFAULT_OPTIONS, FilmOptions
from tracker.camera.frame_times import describe_missing, drop_copies
from tracker.camera.frames import Frames, make_grey_frames
from tracker.camera.readers.tiff_stack import choose_light_conversion

TIFF = (".tif", ".tiff")
KEPT_BYTES = 100 << 20  # of pictures that stay in memory, because the planes of a film's colours are tried in turn
PICTURES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp")


def is_hidden_file(path: Path) -> bool:
    """Test whether a file in a folder of pictures is an operating system's own: ``._`` files, Thumbs.db."""
    ignored = ("thumbs.db", "desktop.ini", "ehthumbs.db")
    return path.name.startswith(".") or path.name.lower() in ignored


def list_pictures(folder: Path) -> list[Path]:
    """Pictures of a folder, 2 before 10, without hidden files."""
    found = [p for p in folder.iterdir() if p.suffix.lower() in PICTURES and p.is_file() and not is_hidden_file(p)]
    return sorted(found, key=lambda p: [int(s) if s.isdigit() else s for s in re.split(r"(\d+)", p.name)])


def read_picture_folder(folder: Path, options: FilmOptions = DEFAULT_OPTIONS) -> Frames:
    """Frames of a folder of pictures. Raises InputError, which names the picture."""
    paths = list_pictures(folder)
    first = read_picture(paths[0])

    def fetch(k: int) -> Any:
        picture = read_picture(paths[k])
        if picture.shape != first.shape or picture.dtype != first.dtype:
            has, wants = (f"{'x'.join(map(str, a.shape[1::-1]))} {a.dtype}" for a in (picture, first))
            raise InputError(f"{paths[k]}: {has}, expected {wants} as in {paths[0].name}")
        return picture

    recall = lru_cache(maxsize=KEPT_BYTES // max(first.nbytes, 1))(fetch)
    # a detector of the user's own may change the pictures that it gets
    frames = make_grey_frames(paths[0], len(paths), first.shape, first.dtype, lambda k: recall(k).copy())
    frames.lossy = paths[0].suffix.lower() in (".jpg", ".jpeg")
    hidden = sorted(path.name for path in folder.iterdir() if path.is_file() and is_hidden_file(path))
    if hidden:
        shown = ", ".join(hidden[:3]) + (", ..." if len(hidden) > 3 else "")
        frames.faults = (f"{len(hidden)} hidden file{'s are' if len(hidden) > 1 else ' is'} skipped: {shown}",)
    if paths[0].suffix.lower() in TIFF:
        with tifffile.TiffFile(paths[0]) as tif:
            frames.faults += choose_light_conversion(tif.series[0].keyframe)[1]
    if options.times != "even":
        numbers, note = find_picture_numbers([path.name for path in paths])
        if numbers is not None:
            frames.numbers = numbers
            frames.faults += describe_missing(numbers, 0.0, "the numbers of the pictures")
        frames.faults += (note,) if note else ()
    return drop_copies(frames, (lambda k: paths[k].stat().st_size, lambda k: paths[k].read_bytes()))


def find_picture_numbers(names: list[str]) -> tuple[Ints | None, str]:
    """Find the frame numbers in the names of pictures; None, with a note if need be, where names count no frames."""
    split = [re.split(r"(\d+)", name) for name in names]
    if len({tuple(parts[::2]) for parts in split}) > 1:
        return None, ""
    columns = [[int(parts[k]) for parts in split] for k in range(1, len(split[0]), 2)]
    growing = [k for k, values in enumerate(columns) if len(set(values)) > 1]
    steps = {k: np.diff(np.array(columns[k], dtype=object)) for k in growing}
    if not growing or any((steps[k] == 1).all() for k in growing):
        return None, ""
    k = growing[0]
    decimals = split[0][2 * k].endswith(".") and k > 0  # 0.004 is no count
    if len(growing) > 1 or decimals or not (steps[k] > 0).all() or columns[k][-1] - columns[k][0] > 2**31:
        return None, "names of pictures do not count frames; pictures are taken as evenly spaced, in the order of names"
    number = np.array(columns[k], dtype=np.int64)
    whole = np.gcd.reduce(np.diff(number))
    if np.median(np.diff(number)) / whole > 5:  # times of an uneven clock
        return None, (
            f"numbers of pictures do not count frames: they grow by {min(steps[k])} to {max(steps[k])}; "
            "pictures are taken as evenly spaced"
        )
    return number - number[0], ""


def read_picture(path: Path) -> Any:
    """Read a picture of a folder, in colour with red first. Raises InputError where it cannot be read."""
    if path.suffix.lower() in TIFF:
        try:
            with tifffile.TiffFile(path) as tif:
                series = tif.series[0]
                picture: Any = np.asarray(series.asarray())
                paint = choose_light_conversion(series.keyframe)[0]
            if series.axes.endswith("SYX") and picture.ndim == 3:  # red, green and blue apart
                picture = np.moveaxis(picture, 0, -1)
            return paint(picture) if paint is not None else picture
        except Exception as error:
            raise InputError(f"{path}: cannot be read as TIFF, truncated or damaged ({first_line(error)})") from None
    try:
        # read here, since OpenCV ends the program at a name that is not UTF-8
        picture = cv2.imdecode(np.fromfile(path, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except (cv2.error, OSError) as error:  # a header that promises more than there is memory for
        raise InputError(f"{path}: cannot be read as a picture ({first_line(error)})") from None
    if picture is None:
        raise InputError(f"{path}: cannot be read as a picture, truncated or damaged")
    return picture[..., 2::-1] if picture.ndim == 3 else picture  # OpenCV gives blue first
