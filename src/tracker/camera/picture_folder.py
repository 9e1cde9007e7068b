"""Reads the pictures of a folder as a film, one at a time."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tifffile

from synthcam_shared.errors import InputError
from tracker.camera.camera_keys import first_line
from tracker.camera.frames import Frames, check_frame_size, check_pixel_type, make_grey_frames

TIFF = (".tif", ".tiff")
PICTURES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp")


def list_pictures(folder: Path) -> list[Path]:
    """Pictures of a folder, 2 before 10."""
    found = [p for p in folder.iterdir() if p.suffix.lower() in PICTURES and p.is_file()]
    return sorted(found, key=lambda p: [int(s) if s.isdigit() else s for s in re.split(r"(\d+)", p.name)])


def read_picture_folder(folder: Path) -> Frames:
    """Frames of a folder of pictures. Raises InputError, which names the picture."""
    paths = list_pictures(folder)
    first = read_picture(paths[0])
    check_pixel_type(paths[0], first.dtype)
    check_frame_size(paths[0], first.shape)

    def fetch(k: int) -> Any:
        picture = read_picture(paths[k])
        if picture.shape != first.shape or picture.dtype != first.dtype:
            has, wants = (f"{'x'.join(map(str, a.shape[1::-1]))} {a.dtype}" for a in (picture, first))
            raise InputError(f"{paths[k]}: {has}, expected {wants} as in {paths[0].name}")
        return picture

    frames = make_grey_frames(folder, len(paths), first.shape, first.dtype, fetch)
    frames.lossy = paths[0].suffix.lower() in (".jpg", ".jpeg")
    return frames


def read_picture(path: Path) -> Any:
    """A picture, in colour with red first. Raises InputError where it cannot be read."""
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
