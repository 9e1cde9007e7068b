"""Simulated hits of the benchmark of local estimates: clips that are cut about the contact."""

import numpy as np
import pandas as pd

from benchmarks.tracker.local_estimates import keep_nearest


def test_a_short_clip_has_as_many_positions_of_each_body_on_either_side_of_the_hit():
    frames = np.arange(-20, 31)
    gap = -0.05 - 0.01 * np.abs(frames - 0.4)  # they touch between frames 0 and 1
    parts = [
        pd.DataFrame({"frame": frames + 40, "particle": particle, "x": x, "y": 0.0})
        for particle, x in ((0, 0.0 * frames), (1, gap))
    ]
    kept = keep_nearest(pd.concat(parts, ignore_index=True), 4)
    for _, part in kept.groupby("particle"):
        assert part["frame"].tolist() == [37, 38, 39, 40, 41, 42, 43, 44]
