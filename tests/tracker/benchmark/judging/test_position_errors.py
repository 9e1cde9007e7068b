"""Errors put into true tracks come out as the figures say: sizes known by construction."""

import numpy as np
import pytest
from benchmark_suite import Given, noisy, suite

from tracker.benchmark.judging.defects import glint_share
from tracker.benchmark.judging.entry import compute_overall_score
from tracker.benchmark.judging.position_errors import (
    compute_efficiency,
    compute_gap_curve,
    compute_phase_curve,
    fit_pixel_locking,
    match_positions,
)
from tracker.benchmark.judging.tracker_results import ClipSample


def held(change, part="bright", **more):
    made = suite()
    return match_positions(made, Given(made, change, **more), made.parts[part])


def test_the_noise_of_the_bound_is_at_the_bound():
    found = held(noisy)
    n = found.statistics["n"]
    assert n == 2 * 2 * 36
    assert found.statistics["ratio"] == pytest.approx(1.0, abs=4 / np.sqrt(4 * n))
    assert found.statistics["z"] == pytest.approx(1.0, abs=4 / np.sqrt(4 * n))
    assert (found.statistics["found"], found.statistics["jaccard"], found.statistics["hota"]) == (
        1.0,
        1.0,
        pytest.approx(1, abs=1e-3),
    )
    assert found.statistics["efficiency"] == pytest.approx(1.0, abs=0.2)


def test_a_wave_within_the_pixel_is_read_back():
    def wave(table, rng):
        return table.assign(x=table["x"] + 0.05 * np.sin(2 * np.pi * table["glint_x_px"]))

    found = held(wave)
    waves, peak = fit_pixel_locking(found.pairs)
    assert peak == pytest.approx(0.1, rel=0.02)
    assert waves[0] == pytest.approx([0, 0.05, 0, 0], abs=1e-3)
    curve = np.array(compute_phase_curve(found.pairs))
    assert curve[:, 1].max() > 0.01 > curve[:, 1].min()


def test_a_glint_taken_for_the_centre_is_read_back_as_a_share():
    def part_of_the_way(table, rng):
        return table.assign(
            x=table["x"] + 0.7 * (table["glint_x_px"] - table["x_px"]),
            y=table["y"] + 0.7 * (table["glint_y_px"] - table["y_px"]),
        )

    assert glint_share(held(part_of_the_way).pairs) == pytest.approx(0.7, abs=1e-6)
    assert glint_share(held(noisy).pairs) == pytest.approx(0.0, abs=0.01)


def test_what_it_found_itself_counts_where_the_camera_file_took_it_to_the_centre():
    def corrected(table, rng):
        return table.assign(glint_x=table["glint_x_px"], glint_y=table["glint_y_px"])

    assert glint_share(held(corrected, own="glint").pairs) == pytest.approx(1.0, abs=0.01)
    assert glint_share(held(corrected, own="centre").pairs) == pytest.approx(0.0, abs=0.01)


def test_missed_and_false_lower_the_efficiency():
    def worse(table, rng):
        more = table.iloc[:36].assign(y=table["y"].iloc[:36] + 40, particle=7)
        return table.iloc[18:].merge(more, how="outer")

    figures = held(worse).statistics
    n = 2 * 2 * 36
    assert (figures["missed"], figures["false"]) == (2 * 18, 2 * 36)
    assert figures["jaccard"] == pytest.approx((n - 36) / (n + 72))
    assert compute_efficiency(figures) == pytest.approx(figures["jaccard"])  # no error: at the bound at least


def test_towards_the_other_ball_near_the_contact():
    def attracted(table, rng):
        place = table.set_index(["frame", "particle"])[["x", "y"]]
        other = place.reindex([(f, 1 - p) for f, p in zip(table["frame"], table["particle"], strict=True)]).to_numpy()
        way = other - table[["x", "y"]].to_numpy()
        unit = way / np.hypot(*way.T)[:, None]
        return table.assign(x=table["x"] + 0.02 * unit[:, 0], y=table["y"] + 0.02 * unit[:, 1])

    curve = compute_gap_curve(held(attracted).pairs)
    assert len(curve) > 1
    for point in curve:
        assert point["towards_px"] == pytest.approx(0.02, rel=0.02)
        assert point["rmse_px"] == pytest.approx(0.02 / np.sqrt(2), rel=0.02)


def test_only_the_clips_of_a_sample_count():
    found = held(noisy, sample=ClipSample(1))
    assert (found.statistics["clips"], found.statistics["n"]) == (1, 2 * 36)


def test_a_part_that_was_not_run_counts_nothing():
    assert compute_overall_score({"a": {"efficiency": 0.8}}, ["a", "b"]) == pytest.approx(40)
    assert np.isnan(compute_overall_score({}, []))
