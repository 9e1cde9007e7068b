"""Simulated hits of the benchmark of local estimates: clips that are cut about the contact, and short slides."""

import numpy as np
import pandas as pd

from benchmarks.tracker.local_estimates import keep_nearest, measure_one


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


def test_a_slide_of_a_few_frames_does_not_pass_for_a_roll():
    """A struck ball that seems to roll at once has 5/7 of its velocity, and r is 0.5 where 0.95 is true."""
    rows = [measure_one("small balls", number, 705, 0.0, claimed=True) for number in range(40)]
    z = np.array([(row["r_local"] - row["r_true"]) / row["r_local_std"] for row in rows])
    known = z[np.isfinite(z)]
    assert len(known) > 30
    assert np.sqrt(np.mean(known**2)) < 1.1
    assert np.abs(known).max() < 3
