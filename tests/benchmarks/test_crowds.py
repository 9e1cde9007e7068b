"""The order of linkers in crowds: first those that finished all trays, then by HOTA."""

import pytest

pytest.importorskip("trackpy")
from benchmarks.tracker.crowds import rank_linkers


def scores(hota, swaps):
    return {"hota": hota, "idf1": hota / 2, "mota": 1 - swaps / 100, "swaps": swaps, "ms_per_frame": 10 * hota}


def test_a_linker_that_gave_up_a_tray_stands_behind_those_that_did_not():
    rows = [
        {"tracker": scores(0.8, 3), "trackpy": scores(0.99, 1), "laptrack": scores(0.9, 5)},
        {"tracker": scores(0.6, 4), "trackpy": None, "laptrack": scores(0.3, 20)},
    ]
    ranked = rank_linkers(rows)
    assert ranked["name"].tolist() == ["tracker", "laptrack", "trackpy"]
    assert ranked["trays"].tolist() == [2, 2, 1]
    assert ranked["hota"].tolist() == pytest.approx([0.7, 0.6, 0.99])
    assert ranked["idf1"].tolist() == pytest.approx([0.35, 0.3, 0.495])
    assert ranked["mota"].tolist() == pytest.approx([0.965, 0.875, 0.99])
    assert ranked["ms_per_frame"].tolist() == pytest.approx([7, 6, 9.9])
    assert ranked["swaps"].tolist() == [7, 25, 1]  # a sum, not a mean
