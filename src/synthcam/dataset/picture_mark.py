"""A mark in pictures and animations by which a later run knows that synthcam made them and may replace them."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

from synthcam_shared.outputs import check_writable
from synthcam_shared.overwriting import check_replaceable

MARK = b"made by synthcam"


def check_picture_output(path: Path, command: str) -> None:
    """Raise InputError if a picture cannot be written, or a file without the mark of synthcam stands there."""
    check_replaceable(path, MARK, command)
    check_writable(path)


def mark_picture(data: bytes, suffix: str) -> bytes:
    """Add the mark to a PNG, GIF or MP4 as a comment that viewers ignore."""
    if suffix == ".png":  # a text chunk after the header, which ends at byte 33
        chunk = b"tEXtComment\0" + MARK
        return data[:33] + struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk)) + data[33:]
    if suffix == ".gif":  # a comment extension before the trailer
        return data[:-1] + b"\x21\xfe" + bytes([len(MARK)]) + MARK + b"\0" + data[-1:]
    return data + struct.pack(">I", 8 + len(MARK)) + b"free" + MARK
