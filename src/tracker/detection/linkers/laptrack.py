"""laptrack (Fukai & Kawaguchi 2023, Bioinformatics 39, btac799): linear assignment, with gaps closed."""

import importlib
import warnings
from typing import Any

import numpy as np
import pandas as pd

from synthcam_shared.arrays import Ints
from synthcam_shared.errors import InputError
from tracker.camera.camera import Camera
from tracker.detection.glints import Glints
from tracker.detection.link import find_reach
from tracker.settings import LinkSettings


class Laptrack:
    """``LapTrack`` with squared distances, as far as a ball may roll in a frame; no splits, no merges."""

    def __init__(self, camera: Camera, settings: LinkSettings) -> None:
        try:
            package: Any = importlib.import_module("laptrack")
        except ImportError:
            raise InputError("linker laptrack: laptrack is not installed, expected pip install laptrack") from None
        reach = max(find_reach(camera, settings), camera.diameter_px)
        self.tracker = package.LapTrack(
            cutoff=reach**2, gap_closing_cutoff=(2 * reach) ** 2, gap_closing_max_frame_count=settings.max_gap_frames
        )

    def __call__(self, glints: Glints) -> Ints:
        """The particle (n,) of each detection; -1 for none."""
        if len(glints) == 0:
            return np.empty(0, np.int64)
        table = pd.DataFrame({"frame": glints.frame, "x": glints.x, "y": glints.y, "row": np.arange(len(glints))})
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of what pandas will drop
            given, _, _ = self.tracker.predict_dataframe(
                table, ["x", "y"], frame_col="frame", only_coordinate_cols=False
            )
        ids = np.full(len(glints), -1, dtype=np.int64)
        ids[given["row"].to_numpy(np.int64)] = given["track_id"].to_numpy(np.int64)
        return ids
