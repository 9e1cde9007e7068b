"""A defect alone in true tracks: none moves nothing, one of known size is read and put back."""

import numpy as np
import pytest
from benchmark_suite import Given, noisy, simulated, suite

from tracker.benchmark.judging.defects import measure_shifts_by_defects
from tracker.benchmark.judging.position_errors import match_positions


@pytest.fixture(scope="module")
def base():
    return {clip: simulated("bright", clip) for clip in suite().parts["bright"].clips}


def judged(base, change):
    made = suite()
    part = made.parts["bright"]
    return measure_shifts_by_defects(match_positions(made, Given(made, change), part), base)


def test_a_tracker_without_defects_moves_nothing(base):
    found = judged(base, lambda table, rng: table)
    assert found["size"] == {"locking": 0.0, "glint": pytest.approx(0, abs=1e-9), "lost": 0.0}
    for name in ("locking", "glint", "lost"):
        assert found[name]["clips"] == 2
        assert found[name]["r"]["rms"] == pytest.approx(0.0, abs=1e-9)


def test_locking_moves_r_as_the_same_wave_put_in_by_hand_does(base):
    from tracker.benchmark.judging.defects import measure_collision

    def wave(table):
        by = {a: 0.06 * np.sin(2 * np.pi * table[f"glint_{a}_px"]) for a in "xy"}
        return table.assign(x=table["x"] + by["x"], y=table["y"] + by["y"])

    found = judged(base, lambda table, rng: wave(table))
    by_hand = [measure_collision(wave(table), camera)["r"] - row["r"] for table, camera, row in base.values()]
    assert found["size"]["locking"] == pytest.approx(0.12, rel=0.03)
    assert found["locking"]["r"]["bias"] == pytest.approx(np.mean(by_hand), rel=0.1)
    assert found["locking"]["r"]["in_errors"] > 1


def test_frames_lost_about_the_contact_leave_nothing_to_measure(base):
    found = judged(base, lambda table, rng: noisy(table, rng)[table["frame"] < 14])
    assert found["lost"]["unmeasured"] == found["lost"]["clips"] == 2
    assert found["size"]["lost"] > 0.5
