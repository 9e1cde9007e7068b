"""The correction of the camera's map in tracks of others: no hit may correct itself."""

from types import SimpleNamespace

import numpy as np
import pandas as pd

from benchmarks.real import hits
from benchmarks.real.recordings import RecordedHit
from synthcam_shared.errors import InputError

CAMERA = {"size": [2000, 1000], "fps": 50.0, "scale": 1e-3, "exposure": 0.0, "ball_diameter": 0.06}


def make_hit(number):
    """Two bodies that move apart from a place that tells the hit."""
    time = np.arange(20) / CAMERA["fps"]
    rows = [
        pd.DataFrame({"frame": np.arange(20), "t_s": time, "particle": k, "x": 0.01 * number + sign * time, "y": 0.3})
        for k, sign in ((0, 0.5), (1, -0.5))
    ]
    return RecordedHit(str(number), pd.concat(rows, ignore_index=True), CAMERA)


def test_no_hit_corrects_itself(monkeypatch):
    fitted = []

    def fit_camera_warp(camera, stretches):
        fitted.append(sorted({float(one) for one in stretches}))
        if len(fitted) == 3:
            raise InputError("refused")
        return SimpleNamespace(summary=list, to_dict=lambda: {"warp": fitted[-1]})

    monkeypatch.setattr(hits, "find_free_stretches", lambda balls, diameter: np.round(balls[0].position[0, 0], 6))
    monkeypatch.setattr(hits, "fit_camera_warp", fit_camera_warp)
    given = [make_hit(k) for k in range(20)]
    starts = [round(0.01 * k, 6) for k in range(20)]
    found = hits.correct_map(given)
    assert [hit.name for hit in found] == [hit.name for hit in given]
    for number, hit in enumerate(found):
        if number % 8 == 2:
            assert "warp" not in hit.camera
        else:
            assert hit.camera["warp"] == [start for k, start in enumerate(starts) if k % 8 != number % 8]
