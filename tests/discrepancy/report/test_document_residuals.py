"""The table of residuals: every position that a search used, its residuals in metres, before and after the claim."""

import dataclasses

import numpy as np
import pytest
from discrepancy_clips import STD, searched
from discrepancy_outsiders import outsider

from discrepancy.fitting.predict import predict_tracks
from discrepancy.report.document import tabulate_residuals


def rms(table, model):
    return float(np.sqrt(np.mean(table[[f"x_{model}", f"y_{model}"]] ** 2)))


def test_residuals_are_what_the_models_do_not_predict():
    found = searched("velocity_restitution")
    table = tabulate_residuals(found)
    parts = {False: (found.data.clips, found.base_fit, found.best_fit)}
    parts[True] = (found.data.held_out, found.gap_fits.before, found.gap_fits.after)
    for held_out, (clips, base, best) in parts.items():
        rows = table[table["held_out"] == held_out]
        assert rows["clip"].unique().tolist() == [clip.clip for clip in clips]
        for name, fit in (("base", base), ("best", best)):
            left = [c.xy - xy for c, xy in zip(clips, predict_tracks(fit.model, fit.launches, clips), strict=True)]
            np.testing.assert_allclose(rows[[f"x_{name}", f"y_{name}"]], np.concatenate(left), atol=1e-12)
        np.testing.assert_array_equal(rows[["x", "y"]], np.concatenate([clip.xy for clip in clips]))
        assert set(rows["ball"]) == {1, 2}
    assert rms(table, "base") > 2 * STD
    assert rms(table, "best") == pytest.approx(STD, rel=0.1)  # the noise that was put in


@pytest.mark.gate
def test_a_free_law_leaves_noise_too():
    table = tabulate_residuals(outsider("restitution_speed"))
    assert rms(table, "best") < 0.7 * rms(table, "base")
    assert rms(table, "best") == pytest.approx(STD, rel=0.15)


def test_without_a_claim_there_is_no_second_model():
    found = searched("velocity_restitution")
    table = tabulate_residuals(dataclasses.replace(found, best_fit=found.base_fit, claims=()))
    assert table[["x_best", "y_best"]].isna().to_numpy().all()
    assert table[["x_base", "y_base"]].notna().to_numpy().all()
