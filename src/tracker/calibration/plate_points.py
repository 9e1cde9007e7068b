"""Known points of the plate and where they are seen: from a table, or from a board in the picture."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from synthcam_shared.arrays import Array
from synthcam_shared.errors import InputError
from synthcam_shared.settings import did_you_mean
from tracker.camera.camera_keys import format_wrong_value
from tracker.camera.readers.picture_folder import PICTURES, read_picture
from tracker.camera.recordings import open_source
from tracker.tables.content import FileContent
from tracker.tables.rows import to_numbers

MIN_POINTS = 4


@dataclass(frozen=True)
class PlatePoints:
    """Points (n, 2) in px and m, x right and y up on the plate as seen from above; what messages call them."""

    pixels: Array
    metres: Array
    where: str


def read_points(path: Path) -> PlatePoints:
    """Points of a table with x_px, y_px (pixel centres at whole numbers), x, y (m on the plate). Raises InputError."""
    columns = ("x_px", "y_px", "x", "y")
    content = FileContent.of(path)
    table = content.cells()
    if missing := [name for name in columns if name not in table]:
        there = format_wrong_value(", ".join(map(str, table.columns)), quoted=False)
        raise content.wrong(f"no column {', '.join(missing)}, expected {', '.join(columns)} (px, m); found {there}")
    pixels, metres = (
        np.column_stack([to_numbers(table[name], name, content.where) for name in names])
        for names in (columns[:2], columns[2:])
    )
    if not np.isfinite(pixels).all() or not np.isfinite(metres).all():
        raise content.wrong("expected four numbers in each row")
    return PlatePoints(pixels, metres, content.where)


def read_picture_size(source: Path) -> tuple[int, int]:
    """Read the size of the picture, or film, in which points of the plate are seen: width and height, px."""
    height, width = _pictures(source)[0].shape[:2]
    return int(width), int(height)


def find_board(source: Path, board: str) -> PlatePoints:
    """The corners of a board that lies on the plate, in the first picture, of a film too, in which it is found.

    board: a chessboard, a ChArUco board, or one ArUco marker. Raises InputError.
    """
    kind, sizes = _board(board)
    for picture in _pictures(source):
        found = _corners(_eight_bits(picture), kind, sizes)
        if found is not None and len(found[0]) >= MIN_POINTS:
            return PlatePoints(found[0], found[1], f"{source}")
    raise InputError(f"{source}: no board {board} found in it, expected one that lies flat and is seen whole")


def _pictures(source: Path) -> list[Any]:
    if source.is_file() and source.suffix.lower() in PICTURES:
        return [read_picture(source)]
    frames = open_source(source).open_film(0)[1].stretch_pixels()
    # the first frames of a film are searched for a board
    return [frames[k] for k in range(min(len(frames), 20))]


def _eight_bits(picture: Any) -> Any:
    grey = picture if picture.ndim == 2 else cv2.cvtColor(np.ascontiguousarray(picture[..., :3]), cv2.COLOR_RGB2GRAY)
    return grey if grey.dtype == np.uint8 else (grey * (255.0 / max(int(grey.max()), 1))).astype(np.uint8)


def _board(board: str) -> tuple[str, dict[str, Any]]:
    """chessboard, charuco or marker, and its sizes: columns, rows, square, marker, dict."""
    sizes: dict[str, Any] = {"dict": "4X4_50"}
    syntax = "expected COLUMNSxROWS,square=M[,marker=M,dict=4X4_50], or marker=M[,dict=4X4_50]"
    for part in board.split(","):
        key, _, value = part.strip().partition("=")
        if (grid := re.fullmatch(r"(\d{1,3})x(\d{1,3})", part.strip())) is not None:
            sizes |= {"columns": int(grid[1]), "rows": int(grid[2])}
        elif key in ("square", "marker") and re.fullmatch(r"\d*\.?\d+(e-?\d+)?", value) and 0 < float(value) < 10:
            sizes[key] = float(value)
        elif key == "dict" and value:
            sizes["dict"] = value.upper().removeprefix("DICT_")
        else:
            raise InputError(f"--board: {format_wrong_value(part)}: {syntax}")
    names = {n.lower(): n for n in (n.removeprefix("DICT_") for n in dir(cv2.aruco) if n.startswith("DICT_"))}
    if sizes["dict"] not in names.values():
        hint = did_you_mean(sizes["dict"], names, written=names)
        raise InputError(
            f"--board: dict={format_wrong_value(sizes['dict'], quoted=False)}: no such dictionary of OpenCV{hint}"
        )
    given = set(sizes) - {"dict"}
    kinds = {"chessboard": {"columns", "rows", "square"}, "charuco": {"columns", "rows", "square", "marker"}}
    kind = next((kind for kind, keys in {**kinds, "marker": {"marker"}}.items() if keys == given), None)
    if kind is None or (kind != "marker" and not min(sizes["columns"], sizes["rows"]) > 2):
        raise InputError(f"--board: {format_wrong_value(board)}: {syntax}, of at least 3x3")
    if kind == "charuco" and sizes["marker"] >= sizes["square"]:
        raise InputError(f"--board: marker {sizes['marker']:g}: expected less than the square, {sizes['square']:g}")
    return kind, sizes


def _corners(grey: Any, kind: str, sizes: dict[str, Any]) -> tuple[Array, Array] | None:
    """Pixels (n, 2) and places (n, 2) of a board's corners."""
    if kind == "chessboard":
        return _chessboard(grey, sizes)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{sizes['dict']}"))
    if kind == "marker":
        settings = cv2.aruco.DetectorParameters()
        settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        corners, _, _ = cv2.aruco.ArucoDetector(dictionary, settings).detectMarkers(grey)
        places = sizes["marker"] * np.array([[0, 0], [1, 0], [1, -1], [0, -1]])
        return (np.asarray(corners[0], np.float64).reshape(4, 2), places) if len(corners) == 1 else None
    shape = (sizes["columns"], sizes["rows"])
    board = cv2.aruco.CharucoBoard(shape, sizes["square"], sizes["marker"], dictionary)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(grey)
    if ids is None:
        return None
    places = np.asarray(board.getChessboardCorners(), np.float64)[ids.ravel(), :2] * [1, -1]
    return np.asarray(corners, np.float64).reshape(-1, 2), places


def _chessboard(grey: Any, sizes: dict[str, Any]) -> tuple[Array, Array] | None:
    """Inner corners of so many squares; or, as OpenCV counts, so many inner corners."""
    for less in (1, 0):
        columns, rows = sizes["columns"] - less, sizes["rows"] - less
        found, corners = cv2.findChessboardCornersSB(grey, (columns, rows))
        if found:
            pixels = np.asarray(corners, np.float64).reshape(-1, 2)
            across, down = np.meshgrid(np.arange(columns), np.arange(rows))
            places = sizes["square"] * np.column_stack([across.ravel(), -down.ravel()]).astype(np.float64)
            turned = np.linalg.det(np.stack([pixels[1] - pixels[0], pixels[columns] - pixels[0]]))
            return pixels, places * [1, 1 if turned > 0 else -1]
    return None
