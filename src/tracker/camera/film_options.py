"""Options on how a film is read: frames and times, channel, fields, region; and hints on where balls are."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypedDict

import cv2
import numpy as np

from synthcam_shared.arguments import check_keywords
from synthcam_shared.arrays import Flags
from synthcam_shared.errors import InputError


@dataclass(frozen=True)
class BallExample:
    """A ball that the user points at: its centre and, if given, its radius, px, in one frame."""

    x: float
    y: float
    radius: float | None
    frame: int


def parse_frames(text: str) -> tuple[int, int | None]:
    """Parse the option --frames A:B of a film: the first frame, and the one after the last. Raises InputError."""
    match = re.fullmatch(r"(\d*):(\d*)", text.replace(" ", ""))
    if match is None or (match[1] and match[2] and int(match[1]) >= int(match[2])):
        raise InputError(f"--frames {text!r}: expected A:B, the first frame and the one after the last, such as 20:80")
    return int(match[1] or 0), int(match[2]) if match[2] else None


@dataclass(frozen=True)
class RegionPart:
    """A box of two opposite corners or a polygon of three or more, px; `outside`: what lies in it is left out."""

    corners: tuple[tuple[float, float], ...]
    outside: bool = False

    def fill(self, shape: tuple[int, int]) -> Flags:
        """Tell which pixels (h, w) lie in it, by their centres."""
        y, x = np.ogrid[: shape[0], : shape[1]]
        if len(self.corners) == 2:
            (left, top), (right, bottom) = self.corners
            return np.asarray((x >= left) & (x <= right) & (y >= top) & (y <= bottom))
        crossed = np.zeros((shape[0], shape[1] + 1), np.uint8)  # 1 where the sides cross a row an odd number of times
        for (x0, y0), (x1, y1) in zip(self.corners, (*self.corners[1:], self.corners[0]), strict=True):
            rows = np.flatnonzero((y0 <= y) != (y1 <= y))
            at = x0 + (x1 - x0) * (rows - y0) / ((y1 - y0) or 1.0)
            crossed[rows, np.clip(np.ceil(at), 0, shape[1]).astype(np.intp)] ^= 1
        # a pixel is inside where a ray to the right crosses an odd number of sides
        return np.bitwise_xor.accumulate(crossed[:, :0:-1], axis=1)[:, ::-1].view(np.bool_)


def parse_region(text: str, *, max_corner_px: float = 1e6) -> tuple[RegionPart, ...]:
    """Parse the option --region of a film: boxes and polygons, in which balls are looked for, px.

    Parts are separated by `;`, and begin with "not" to leave out. Raises InputError.

    max_corner_px: of a corner, in x or y; a larger number is surely a mistake.
    """
    parts = []
    for written in text.split(";"):
        words = written.split()
        outside = bool(words) and words[0] == "not"
        try:
            points = [tuple(map(float, word.split(","))) for word in words[outside:]]
        except ValueError:
            points = []
        if [len(point) for point in points] == [4]:
            left, top, right, bottom = points[0]
            corners = [(left, top), (right, bottom)]
            is_valid = right > left and bottom > top
        else:
            corners = [(point[0], point[1]) for point in points if len(point) == 2]
            is_valid = len(corners) == len(points) > 2
        if not is_valid or not np.all(np.abs(corners) <= max_corner_px):
            raise InputError(
                f"--region {text!r}: expected X0,Y0,X1,Y1 in px, left and upper before right and lower, "
                "or the corners X,Y X,Y X,Y ... of a polygon"
            )
        parts.append(RegionPart(tuple(corners), outside))
    return tuple(parts)


def parse_ball(text: str) -> BallExample:
    """Parse the hint --ball of a film: "X,Y@FRAME" or "X,Y,R@FRAME". Raises InputError."""
    number = r"(\d+(?:\.\d+)?)"
    match = re.fullmatch(rf"{number},{number}(?:,{number})?@(\d+)", text.replace(" ", ""))
    if match is None:
        raise InputError(f"--ball {text!r}: expected X,Y@FRAME or X,Y,R@FRAME in px, such as 120,58,13@5")
    return BallExample(float(match[1]), float(match[2]), float(match[3]) if match[3] else None, int(match[4]))


def parse_colour(text: str) -> str:
    """Parse the hint --colour of a film: "#rrggbb", or a name of CSS. Raises InputError."""
    from matplotlib.colors import to_hex

    try:
        return str(to_hex(text))
    except ValueError:
        raise InputError(f"--colour: unknown {text!r}, expected #rrggbb or a name such as orange") from None


def read_search_area(region: str, mask: str, shape: tuple[int, int]) -> Flags | None:
    """Read the options --region and --mask of a film: the pixels (h, w) of the search, or None. Raises InputError."""
    if not region and not mask:
        return None
    area = np.ones(shape, bool)
    if mask:
        path = Path(mask)
        data = np.fromfile(path, np.uint8) if path.is_file() else np.empty(0, np.uint8)
        picture: Any = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if len(data) else None
        if picture is None:
            raise InputError(f"--mask {path}: no picture that can be read, expected one that is white where balls are")
        if picture.shape != shape:
            has, wants = (f"{s[1]}x{s[0]}" for s in (picture.shape, shape))
            raise InputError(f"--mask {path}: {has} pixels, expected {wants} as the film")
        area &= picture > 127
    if region:
        parts = parse_region(region)
        kept = [part.fill(shape) for part in parts if not part.outside]
        area &= np.any(kept, axis=0) if kept else True
        for part in parts:
            area &= ~part.fill(shape) if part.outside else True
    if not area.any():
        raise InputError(f"{'--region ' + region if region else '--mask ' + mask}: no pixel of the film is left")
    return area


class FilmKeywords(TypedDict, total=False):
    """The fields of `FilmOptions`, as keywords of a function."""

    times: str
    select: str
    fields: str
    frames: str
    region: str
    mask: str | Path
    ball: Sequence[str]


@dataclass(frozen=True)
class FilmOptions:
    """Options of reading a film.

    times: "auto" takes the spacing of frames from the film and the rate from the camera file, "file" both from the
    film. With "even" the program spaces the frames evenly, whatever the film says.
    fields: of interlaced video, "separate" makes two frames of each, "weave" leaves them, "auto" looks at the film.
    """

    times: str = "auto"
    select: str = ""  # entries of axes that are not time, as in "C=1,Z=0"; others take their first
    fields: str = "auto"
    frames: str = ""  # which are read, "A:B" without B; "": all
    region: str = ""  # where balls are looked for, as `parse_region` reads it; "": everywhere
    mask: str = ""  # path of a picture that is white where balls are looked for
    ball: tuple[str, ...] = ()  # examples of balls, "X,Y@FRAME" or "X,Y,R@FRAME" in px

    @staticmethod
    def of(given: FilmKeywords) -> FilmOptions:
        """Make the options of keywords. Raises InputError for an unknown one, and for a value of another type."""
        check_keywords(given, FilmKeywords.__annotations__)
        for ball in given.get("ball", ()):
            if not isinstance(ball, str):
                raise InputError(f"ball: holds {type(ball).__name__}, expected str, such as '120,58@5'")
        values: dict[str, Any] = {**given}
        values |= {"mask": str(given.get("mask", "")), "ball": tuple(given.get("ball", ()))}
        return FilmOptions(**values)

    def __post_init__(self) -> None:
        for name, known in (("times", ("auto", "file", "even")), ("fields", ("auto", "separate", "weave"))):
            if (value := getattr(self, name)) not in known:
                raise InputError(f"--{name}: expected one of {', '.join(known)}, not {value!r}")
        self.indices()
        if self.frames:
            parse_frames(self.frames)
        if self.region:
            parse_region(self.region)
        self.balls()

    def balls(self) -> tuple[BallExample, ...]:
        """The examples of balls. Raises InputError."""
        return tuple(parse_ball(text) for text in self.ball)

    def indices(self) -> dict[str, int]:
        """The entry of each axis that is selected. Raises InputError."""
        found = {}
        letters = "CZSPAHEVRQI"  # of tifffile and OME: channel, focal plane, sample, position, ...
        for part in filter(None, self.select.replace(" ", "").split(",")):
            axis, _, index = part.partition("=")
            if axis.upper() not in letters or len(axis) != 1 or not index.isdecimal():
                raise InputError(f"--select: {part!r}: expected AXIS=NUMBER, such as C=1 or Z=0, joined by commas")
            found[axis.upper()] = int(index)
        return found

    def changed(self) -> dict[str, Any]:
        """The options that differ from the defaults; the SHA-256 of the file of a mask."""
        plain = FilmOptions.__dataclass_fields__
        found = {name: value for name, value in vars(self).items() if value != plain[name].default}
        if self.mask:
            found["mask"] = hashlib.sha256(Path(self.mask).read_bytes()).hexdigest()
        return found | ({"ball": list(self.ball)} if self.ball else {})


DEFAULT_OPTIONS = FilmOptions()
