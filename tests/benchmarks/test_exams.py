"""Exams on tracks of others, on discs whose answer is known."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmarks.real import exams
from benchmarks.real.recordings import PUCK_HZ, RecordedHit

RADIUS, CONTACT_S = 0.025, 0.4


def make_hit(rng, factor):
    """A hit whose rims rub: its row, and the angles of both discs, by the impulse along n and t."""
    b, along, across = rng.uniform(-0.6, 0.6), 0.45, rng.uniform(-0.1, 0.1)
    n = np.array([np.sqrt(1 - b**2), b])
    t = np.array([-n[1], n[0]])
    striker = np.array([1.0, 0.0])
    v = {"1i": np.zeros(2), "2i": striker, "1o": along * n + across * t, "2o": striker - along * n - across * t}
    row = {f"v{key}{axis}_local": v[key][i] for key in v for i, axis in enumerate("xy")}
    row |= {f"v{key}{axis}_local_std": 1e-3 for key in v for axis in "xy"}
    row |= {"b_local": n[0] * striker[1] - n[1] * striker[0], "r_local_std": 0.01, "t_c_local": CONTACT_S}
    row |= {"particle1": 0, "particle2": 1}
    since = np.arange(400) / PUCK_HZ - CONTACT_S
    turned = -across / (factor * RADIUS) * np.maximum(since, 0)  # both: torque -R n x J of disc 1, R n x -J of disc 2
    return row, (turned + 0.3, turned + 2.0 * since)


@pytest.mark.parametrize("factor", [0.4, 0.5])
def test_the_inertia_of_discs_follows_from_spins_and_velocities(monkeypatch, factor):
    rng = np.random.default_rng(1)
    rows, angles = zip(*(make_hit(rng, factor) for _ in range(12)), strict=True)
    hits = [RecordedHit(str(k), pd.DataFrame(), {"ball_diameter": 2 * RADIUS}) for k in range(12)]
    monkeypatch.setattr(exams, "read_puck_angles", lambda clone: {str(k): each for k, each in enumerate(angles)})
    found = exams.measure_inertia(exams.MeasuredHits(Path(), hits, rows))
    assert found.coefficients[0] == pytest.approx(factor, rel=1e-3)
