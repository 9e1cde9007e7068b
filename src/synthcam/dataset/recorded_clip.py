"""One recorded clip of a dataset with its truth, which the export formats write."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import tifffile
from numpy.typing import NDArray

from synthcam_shared.errors import InputError
from synthcam_shared.track_formats import split_by_particle


@dataclass(frozen=True)
class RecordedClip:
    """One clip of a dataset, read from its files. of: the number of clips of its scene."""

    number: int
    scene: str
    of: int
    camera: dict[str, Any]
    drawn: dict[str, Any]
    scalars: dict[str, Any]
    tracks: pd.DataFrame
    events: pd.DataFrame
    stack: Path

    def check(self) -> None:
        """Raise KeyError, TypeError or ValueError if something is missing that every format needs."""
        numbers = [*self.camera["size"], self.camera["fps"], self.bits, self.diameter_px, self.frames]
        largest = 1e9  # of any number that describes a camera or a stack
        if not all(0 < float(x) < largest for x in numbers):
            raise ValueError("camera.json or tracks.parquet without size, rate, bits, ball or frames")

    @property
    def frames(self) -> int:
        return int(self.tracks["frame"].max()) + 1

    @property
    def bits(self) -> int:
        return int(self.camera["sensor"]["bits"])

    @property
    def video(self) -> bool:
        return self.stack.is_file()

    @property
    def diameter_px(self) -> float:
        return float(self.camera["ball_diameter"] / self.camera["scale"])

    def pictures(self) -> Iterator[NDArray[Any]]:
        """The frames, one at a time, (h, w) uint8 or uint16."""
        try:
            with tifffile.TiffFile(self.stack) as tif:
                for page in tif.pages:
                    yield page.asarray()
        except Exception as error:  # decoders raise their own kinds
            raise InputError(f"{self.stack}: damaged ({first_line(error)}); `synthcam verify` lists more") from None

    def visible_tracks(self) -> list[list[tuple[Any, Any, Any]]]:
        """(frame, x, y) of each ball where its centre lies in the picture, px."""
        width, height = self.camera["size"]
        x, y = self.tracks["x_mean_px"], self.tracks["y_mean_px"]
        rows = self.tracks[(x > -0.5) & (x < width - 0.5) & (y > -0.5) & (y < height - 0.5)]
        return split_by_particle(*(rows[name] for name in ("particle", "frame", "x_mean_px", "y_mean_px")))


def first_line(error: Exception) -> str:
    """The message of an error in one line."""
    return " ".join(str(error).split())[:100] or type(error).__name__
