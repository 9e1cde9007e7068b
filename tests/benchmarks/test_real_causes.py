"""Causes put into tracks of others: a cause has to reach the measurement."""

import pandas as pd
import pytest
from tracker_local import draw_rows

from benchmarks.real.recordings import RecordedHit
from benchmarks.search import real_causes
from tracker.measurement.local.local_columns import calibrate_set


@pytest.mark.parametrize(("count", "lines"), [(12, 5), (4, 0)])
def test_hits_are_measured_with_the_other_mass(monkeypatch, count, lines):
    """Few contacts give no line, and no error."""
    hits = [RecordedHit(str(k), pd.DataFrame(), {}) for k in range(count)]
    rows, masses = draw_rows(count, 0.003, 0.003, 0.0), []

    def measure(hit, support):
        masses.append(hit.camera["ball_masses"])
        return rows[int(hit.name)]

    def calibrate(given):
        return [row | {"b_local": 0.01, "b_local_std": 0.01} for row in calibrate_set(given)]

    monkeypatch.setattr(real_causes, "calibrate_set", calibrate)
    monkeypatch.setattr(real_causes, "measure_hit", measure)
    found = list(real_causes.relabel_masses("TIF083A", hits))
    assert [line["strength"] for line in found] == [0.0, 0.1, -0.1, 0.2, -0.2][:lines]
    if lines:
        assert sorted({one / two for one, two in masses}) == pytest.approx([0.8, 0.9, 1.0, 1.1, 1.2])
