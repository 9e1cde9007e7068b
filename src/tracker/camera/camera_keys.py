"""The keys that camera.json may hold, the numbers that make sense in them, and how its text is read."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any

MOST_BYTES = 1 << 20  # of a camera file
MOST_PIXELS = 1 << 28  # of one frame
LONGEST_SIDE = (1 << 15) - 1  # px, the most that OpenCV's routines take
NUMBERS = 11  # of a row of view_errors: focal length over itself, cx, cy, k1, k2, rotation vector after R, t
CHANNELS = ("grey", "red", "green", "blue")  # of a film in colour, as one of which it is read
SHOWN = 40  # characters of a wrong value in a message

KEYS = {  # by section; "" is the file itself
    "": "K dist R t size fps exposure scale ball_diameter striker lamp psf sensor shutter lens surface "
    "scale_std fps_std ball_diameter_std view_errors assumed metric exposure_seen_s calibration video ball",
    "lamp": "position position_std radius shape inner length width angle facing flicker second radiance",
    "psf": "sigma_px defocus_px f_number pixel_pitch wavelength",
    "sensor": "bits gain read_noise dark prnu dsnu full_well black_level codec_noise gamma hot_pixels hot_dark",
    "shutter": "kind line_time",
    "lens": "vignetting",
    "ball": "finish colour",
    "video": "codec crf q gamma chroma",
    "surface": "steel roughness scratches scratch_slope plate_gloss plate_roughness plate_texture plate_grain "
    "plate_shadow",
}
LIMITS = {  # least and most, both included: wider than any apparatus, narrow enough for arithmetic to hold
    "fps": (1e-6, 1e9),
    "exposure": (0.0, 1e6),
    "scale": (1e-9, 1.0),
    "ball_diameter": (1e-7, 10.0),
    "scale_std": (0.0, 1.0),
    "fps_std": (0.0, 1e9),
    "ball_diameter_std": (0.0, 10.0),
    "view_errors": (-1e3, 1e3),
    "K": (-1e9, 1e9),
    "dist": (-1e12, 1e12),
    "R": (-1.001, 1.001),
    "t": (-1e6, 1e6),
    "lamp.position": (-1e6, 1e6),
    "lamp.position_std": (0.0, 100.0),
    "lamp.radius": (0.0, 100.0),
    "lamp.inner": (0.0, 100.0),
    "lamp.length": (0.0, 100.0),
    "lamp.width": (0.0, 100.0),
    "psf.sigma_px": (0.01, 100.0),
    "psf.defocus_px": (0.0, 1e3),
    "psf.f_number": (0.0, 1e3),
    "surface.roughness": (0.0, 1e3),
    "surface.scratches": (0.0, 1e3),
    "shutter.line_time": (0.0, 1.0),
    "sensor.bits": (1.0, 16.0),
    "sensor.gain": (1e-6, 1e6),
    "sensor.read_noise": (0.0, 1e6),
    "sensor.dark": (0.0, 1e12),
    "sensor.prnu": (0.0, 1.0),
    "sensor.dsnu": (0.0, 1e6),
    "sensor.full_well": (1e-6, 1e12),
    "sensor.black_level": (0.0, 65535.0),
    "sensor.codec_noise": (0.0, 65535.0),
    "sensor.gamma": (0.2, 5.0),
}


def read_json(path: Path, most: int = MOST_BYTES) -> Any:
    """What a JSON file of at most so many bytes holds. Raises ValueError with a reason, or OSError."""
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
        raise ValueError(f"key {next(format_value(k) for k in keys if keys.count(k) > 1)} given twice")
    return table


def describe_unknown_keys(data: Mapping[str, Any]) -> Iterator[str]:
    """A line for each key of camera.json that nothing reads, with the key that may have been meant."""
    dotted = {key: f"{section}.{key}".lstrip(".") for section, keys in KEYS.items() for key in keys.split()}
    for section, keys in KEYS.items():
        table = data.get(section) if section else data
        for key in table if isinstance(table, Mapping) else ():
            if key not in keys.split():
                hint = did_you_mean(str(key), dotted)
                yield f"{format_value(f'{section}.{key}'.lstrip('.'), quoted=False)}: not a key of camera.json{hint}"


def did_you_mean(word: str, known: Mapping[str, str]) -> str:
    """What to put behind a message on an unknown word: the nearest of the known ones as they are shown, or nothing."""
    near = get_close_matches(word.lower(), known, n=1, cutoff=0.7)
    return f"; did you mean {known[near[0]]}?" if near else ""


def format_value(value: Any, quoted: bool = True) -> str:
    """A value in a message: one line, not too long, whatever it is."""
    try:
        text = repr(value) if quoted else str(value)
    except (ValueError, RecursionError):  # more digits than Python writes, or too deep
        text = f"a {type(value).__name__} too long to show"
    line = "".join(c if c.isprintable() else " " for c in text)
    return line if len(line) <= SHOWN else f"{line[: SHOWN - 3]}..."


def first_line(error: BaseException) -> str:
    """What an error says, in a line that is not too long."""
    return str(error).splitlines()[0][:120] if str(error) else type(error).__name__
