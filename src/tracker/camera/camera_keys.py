"""Limits of pictures, the reading of JSON files, and the words of messages about wrong values."""

import json
from pathlib import Path
from typing import Any

MOST_PIXELS = 1 << 28  # of one frame
LONGEST_SIDE = (1 << 15) - 1  # px, the most that OpenCV's routines take
VIEW_ERROR_COUNT = 11  # of a row of view_errors: relative focal length, cx, cy, k1, k2, rotation vector after R, t
CHANNELS = ("grey", "red", "green", "blue")  # in which a film in colour can be read
DARK = "dark"  # the channel in which what is dark in grey is bright
CONTRAST = "contrast"  # that in which all that differs from the picture without balls is bright
PLANES = ("red-green", "red-blue", "green-blue", "colour", "plate")  # and in these, which shadows hardly change


def read_json(path: Path, most: int = 1 << 20) -> Any:
    """Read a JSON file, such as a camera's, of at most so many bytes. Raises ValueError with a reason, or OSError."""
    if path.stat().st_size > most:
        raise ValueError(f"more than {most >> 20} MB")
    try:
        return json.loads(path.read_text(encoding="utf-8-sig"), object_pairs_hook=_once)
    except RecursionError:
        raise ValueError("nested too deeply") from None
    except ValueError as error:  # not UTF-8, not JSON, or a number of more digits than Python reads
        raise ValueError(str(error).partition(";")[0]) from None


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"key {next(format_wrong_value(k) for k in keys if keys.count(k) > 1)} given twice")
    return table


def format_wrong_value(value: Any, quoted: bool = True, most: int = 40) -> str:
    """Format a wrong value as one line of a message, of at most so many characters."""
    try:
        text = repr(value) if quoted else str(value)
    except (ValueError, RecursionError):  # more digits than Python writes, or too deep
        text = f"a {type(value).__name__} too long to show"
    line = "".join(c if c.isprintable() else " " for c in text)
    return line if len(line) <= most else f"{line[: most - 3]}..."
