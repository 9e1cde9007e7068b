"""Calibration by the balance of momentum, on hits drawn with known errors."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad
from scipy.special import hyperu
from tracker_film import CAMERA
from tracker_local import AT, draw_rows, draw_unequal_rows

from tracker.camera.camera import Camera
from tracker.measurement.camera_errors import shared_effects
from tracker.measurement.estimate import make_empty_row
from tracker.measurement.local.local_columns import (
    COMMON_SHARE,
    LocalErrors,
    _find_common_error,
    apply_errors,
    calibrate_rows,
    calibrate_set,
    find_covariance,
    make_empty_columns,
)
from tracker.measurement.local.recommendation import recommend
from tracker.measurement.messages import list_messages
from tracker.sets.combined_quantity import combine_quantity
from tracker.settings import FitSettings

SCALE_OF_RATIO = [("scale", "mass_ratio", 0.1)]  # an error of the camera file, key, of what, and by which share


def test_the_balance_of_momentum_shows_errors_beyond_the_residuals():
    rows = draw_rows(120, 0.012, 0.006, -0.02)
    errors = calibrate_rows(rows)
    assert errors.error_n == pytest.approx(0.012, rel=0.25)
    assert errors.error_t == pytest.approx(0.006, rel=0.25)
    assert errors.bias_n == pytest.approx(-0.02, abs=0.006)
    held_out = [row | apply_errors(row, errors) for row in draw_rows(200, 0.012, 0.006, -0.02, seed=1)]
    for name in ("balance_n", "balance_t"):
        z = np.array([row[f"{name}_local"] / row[f"{name}_local_std"] for row in held_out])
        assert 0.55 < np.mean(np.abs(z) < 1) < 0.8
        assert np.mean(np.abs(z) < 1.96) > 0.88
    z = np.array([(row["r_local"] - 0.8) / row["r_local_std"] for row in held_out])
    assert 0.55 < np.mean(np.abs(z) < 1) < 0.85


def test_a_contact_that_a_third_ball_disturbed_says_nothing_about_the_errors_of_a_crowd():
    """A wall between two frames takes three times the momentum that the contact has."""
    rows = [row | {"status": "crowd", "misfit_local": False} for row in draw_rows(12, 0.003, 0.003, 0.0)]
    raw = json.loads(rows[0]["local"])
    raw["value"][AT["balance_n"]] = -3.0 * raw["v0"]
    disturbed = rows[0] | {"local": json.dumps(raw), "misfit_local": True}
    assert calibrate_rows([*rows, disturbed]) == calibrate_rows(rows)
    assert calibrate_rows([*rows, disturbed | {"misfit_local": False}]) != calibrate_rows(rows)


def test_one_contact_with_a_fast_third_ball_does_not_widen_the_errors_of_a_crowd():
    """It brings ten times the momentum of a slow contact, and free motion describes the paths of both balls."""
    rows = [row | {"status": "crowd", "misfit_local": False} for row in draw_rows(48, 0.003, 0.003, 0.0)]
    raw = json.loads(rows[0]["local"])
    slow = dict.fromkeys(("v0", "vn"), 0.1 * raw["v0"])
    raw["value"][AT["balance_n"]] = -10 * slow["v0"]
    disturbed = rows[0] | {"local": json.dumps(raw | slow)}
    alone, errors = calibrate_rows(rows), calibrate_rows([disturbed, *rows[1:]])
    assert abs(errors.bias_n) < 3 * errors.bias_std < 0.01
    assert errors.error_n == pytest.approx(alone.error_n, rel=0.2)
    assert errors.factor < 1.3 * alone.factor


def draw_rows_of_small_claims(times, hits, seed=0):
    """Half of the hits are measured less well, by 0.002 and 0.02 m/s, and all have so many times that error."""
    drawn = (draw_rows(hits // 2, 1e-5, 1e-5, 0.0, seed=seed + k, residual=0.002 * k * times) for k in (1, 10))
    for row in (rows := [row for half in drawn for row in half]):
        raw = json.loads(row["local"])
        small = {key: [s and s / times for s in raw[key]] for key in ("std", "velocity_std")}
        row["local"] = json.dumps(raw | small | {"prior": 1e-3})
    return rows


@pytest.mark.parametrize("times", [1.0, 3.0])
def test_the_balance_shows_errors_of_residuals_that_are_too_small(times):
    rows = draw_rows_of_small_claims(times, 100)
    errors = calibrate_rows(rows)
    assert errors.factor == pytest.approx(times, rel=0.25)
    wide = [(row | apply_errors(row, errors))["balance_t_local_std"] / row["balance_t_local_std"] for row in rows[50:]]
    assert np.array(wide) * times == pytest.approx(errors.factor, rel=0.05)


def test_few_hits_do_not_make_errors_too_small():
    """The likeliest factor of eight hits is 1.5 on average where the true one is 2."""
    factors = [calibrate_rows(draw_rows_of_small_claims(2.0, 8, seed)).factor for seed in range(0, 800, 100)]
    assert 1.8 < np.mean(factors) < 2.4


@pytest.mark.parametrize(("factor", "allowances"), [(1.0, 1.0), (3.0, 1.0), (2.0, 0.3)])
def test_the_covariance_has_the_errors_of_the_columns(factor, allowances):
    row = draw_rows(1, 1e-4, 1e-4, 0.0, shared=[("scale", "v0", 0.002)], allowed=0.003)[0]
    row |= apply_errors(row, LocalErrors(error_n=1e-4, error_t=1e-4, factor=factor, allowances=allowances))
    std = [row["v0_local_std"], row["r_local_std"]]
    np.testing.assert_allclose(np.sqrt(np.diag(find_covariance(row)))[[0, 2]], std, rtol=1e-6)


def test_a_bias_changes_no_value_and_counts_as_an_error():
    """Unknown masses that differ look like a bias; r does not depend on them, and must not move."""
    rows = draw_rows(40, 0.003, 0.003, -0.1)
    for before, after in zip(rows, calibrate_set(rows), strict=True):
        assert after["local_bias"] == pytest.approx(-0.1, abs=0.01)
        for name in ("r_local", "v0_local", "mass_ratio", "balance_n_local"):
            assert after[name] == before[name]
        assert after["balance_n_local_std"] > abs(after["balance_n_local"]) / 3
        assert after["r_local_std"] > 0.05


@pytest.mark.parametrize(("bias", "said"), [(-0.09, 1), (0.09, 1), (-0.02, 0)])
def test_a_bias_beyond_errors_of_velocities_asks_for_the_masses(bias, said):
    empty = make_empty_row(Camera.from_dict(CAMERA), "misfit")
    table = pd.DataFrame([empty | row for row in calibrate_set(draw_rows(40, 0.003, 0.003, bias))])
    notes = [str(note) for note in list_messages(table) if "of the normal speed. Errors of velocities" in str(note)]
    assert len(notes) == said


@pytest.mark.parametrize("bias", [0.0, 0.002, 0.01])
def test_a_bias_below_its_error_is_still_a_common_error(bias):
    """Head-on hits show the mean of the balance to the mean error of one, 0.006 sqrt(3), over sqrt(n)."""
    errors = calibrate_rows(rows := draw_rows(30, 0.006, 0.003, bias, residual=1e-5))
    assert errors.bias_std == pytest.approx(0.006 * np.sqrt(3 / 30), rel=0.3)
    table = pd.DataFrame(calibrate_set(rows)).assign(fit="local")
    effect = shared_effects(table, ("balance_n",))[:, 0] / table["v0_local"].to_numpy()[:, None]
    np.testing.assert_allclose(np.linalg.norm(effect, axis=1), np.hypot(errors.bias_n, errors.bias_std), rtol=0.05)


def find_rms_z_of_r(rows):
    return np.sqrt(np.mean([((row["r_local"] - 0.8) / row["r_local_std"]) ** 2 for row in rows]))


@pytest.mark.parametrize(("size", "residual"), [(0.0, 0.02), (0.006, 1e-5)])
def test_what_all_contacts_of_a_crowd_share_is_as_large_as_it_is(size, residual):
    """Twelve films of 12 contacts, whose velocities err by 0.003 each, and by a bias that all contacts of a film share.

    Noise of 0.02 hides what they share. Then it counts as no larger than what a single contact may err by, instead of
    the bias that the noise makes, and its error.
    """
    biases, claims, noise = size * np.random.default_rng(8).standard_normal(12), [], []
    for seed, bias in enumerate(biases):
        rows = [row | {"status": "crowd"} for row in draw_rows(12, 0.003, 0.003, bias, seed=seed, residual=residual)]
        errors = calibrate_rows(rows)
        shared = json.loads(apply_errors(rows[0], errors)["local_shared"])
        parts = [block["effect"]["balance_n"] for key, block in shared.items() if key.startswith("bias_")]
        claims.append(np.linalg.norm(parts) / json.loads(rows[0]["local"])["vn"])
        noise.append(np.hypot(errors.bias_n, errors.bias_std))
    claim = np.sqrt(np.mean(np.square(claims)))
    if size:
        assert 0.7 < claim / np.sqrt(np.mean(np.square(biases))) < 1.4
    else:
        assert claim < 0.006
        assert claim < 0.6 * np.sqrt(np.mean(np.square(noise)))


@pytest.mark.parametrize("bias_over_error", [0.0, 1.0, 2.5, 4.0])
def test_what_contacts_of_a_crowd_share_is_the_second_moment_of_a_horseshoe(bias_over_error):
    """By the density of the prior, exp(x) E1(x) with x half of the square: Carvalho, Polson and Scott (2010)."""
    error, size = 0.003, COMMON_SHARE * 2 * 0.004

    def weigh(bias, power):
        x = (bias / size) ** 2 / 2
        return bias**power * np.exp(-(((bias_over_error - bias / error) ** 2) / 2)) * hyperu(1, 1, x)

    points = size * np.array([-3, -1, -0.1, -1e-3, 0, 1e-3, 0.1, 1, 3])
    moment, chance = (
        quad(weigh, -12 * error, 12 * error, args=(power,), points=points, limit=500)[0] for power in (2, 0)
    )
    found = _find_common_error(LocalErrors(bias_n=bias_over_error * error, bias_std=error, error_n=0.004))
    assert found == pytest.approx(np.sqrt(moment / chance), rel=0.01)


@pytest.mark.parametrize("bias_over_error", [0.0, 1.0])
def test_noise_of_the_balances_of_a_crowd_is_hardly_shared(bias_over_error):
    """A film of fourteen contacts knows its balances to 0.0035; its mean r is known as well, and no worse."""
    errors = LocalErrors(bias_n=bias_over_error * 0.0035, bias_std=0.0035, error_n=0.0016)
    assert _find_common_error(errors) < 0.4 * errors.bias_std


@pytest.mark.parametrize("bias", [-0.02, 0.02])
def test_a_bias_that_the_balances_of_a_crowd_prove_counts_whole(bias):
    """It is ten times what the velocities of a single contact err by, as where the map is bent."""
    rows = [row | {"status": "crowd"} for row in draw_rows(30, 0.001, 0.001, bias, residual=1e-5)]
    errors = calibrate_rows(rows)
    assert abs(errors.bias_n) > 10 * errors.bias_std
    assert errors.common_n == pytest.approx(abs(bias), rel=0.1)


def test_many_balances_show_that_a_crowd_needs_no_allowance_for_its_motions():
    """Noise makes errors of 0.02 m/s. Motions may make 0.03 m/s, and make none: r would have 1.8 of its error."""
    rows = calibrate_set(draw_rows(120, 1e-5, 1e-5, 0.0, residual=0.02, allowed=0.03))
    assert rows[0]["local_allowances"] < 0.3
    assert find_rms_z_of_r(rows) == pytest.approx(1.0, abs=0.15)
    assert calibrate_rows(draw_rows(20, 1e-5, 1e-5, 0.0, residual=0.02)).allowances == 1.0


@pytest.mark.parametrize(("sets", "hits"), [(1, 120), (12, 8)])
def test_balances_as_large_as_the_allowance_keep_the_errors(sets, hits):
    """Motions make the errors of 0.03 m/s that are allowed for."""
    both, scores = float(np.hypot(0.02, 0.03)), []
    for seed in range(sets):
        rows = draw_rows(hits, 1e-5, 1e-5, 0.0, seed, residual=both)
        for row in rows:
            raw = json.loads(row["local"])
            raw |= {f"known_{key}": [v and 0.03 / both * v for v in raw[key]] for key in ("std", "velocity_std")}
            row["local"] = json.dumps(raw)
        scores.append(find_rms_z_of_r(calibrate_set(rows)))
    assert np.sqrt(np.mean(np.square(scores))) == pytest.approx(1.0, abs=0.15)


def test_a_hit_whose_momentum_is_off_is_not_recommended():
    odd, *rest = calibrate_set(draw_rows(1, 0.005, 0.005, 0.15) + draw_rows(40, 0.005, 0.005, 0.0))
    assert "momentum is not conserved within the errors of its set" in odd["why"]
    assert sum(row["recommended"] == "local" for row in rest) == 40


def test_a_few_odd_hits_do_not_widen_the_errors():
    rows = draw_rows(60, 0.005, 0.005, 0.0)
    odd = draw_rows(3, 0.5, 0.5, 0.0, seed=2)
    assert calibrate_rows(rows + odd).error_n == pytest.approx(calibrate_rows(rows).error_n, rel=0.15)


def test_a_second_calibration_changes_nothing():
    rows = draw_rows(30, 0.01, 0.01, 0.03)
    once = calibrate_set(rows)
    assert once[0]["local_hits"] == 30
    assert once[0]["r_local_std"] > 1.5 * rows[0]["r_local_std"]
    assert json.dumps(calibrate_set(once)) == json.dumps(once)


def test_the_mass_ratio_of_two_bodies_is_fitted_from_recoil_on_either_side():
    heavier = np.log(1.5)
    rows = draw_unequal_rows(heavier)
    errors = calibrate_rows(rows)
    assert errors.log_ratio == pytest.approx(heavier, abs=4 * errors.log_ratio_std)
    assert errors.log_ratio_std < 0.002
    assert abs(errors.bias_n) < 3 * errors.bias_std
    one, other = (row["mass_ratio"] for row in calibrate_set(rows)[:2])
    assert other == pytest.approx(np.exp(errors.log_ratio))
    assert one == pytest.approx(1 / other)
    table = pd.DataFrame([make_empty_row(Camera.from_dict(CAMERA), "misfit") | row for row in calibrate_set(rows)])
    said = [str(note) for note in list_messages(table)]
    assert any("This takes a number for the same body in all clips" in text for text in said)
    crowd = calibrate_set([row | {"status": "crowd"} for row in draw_unequal_rows(heavier, shared=SCALE_OF_RATIO)])
    table = pd.DataFrame([make_empty_row(Camera.from_dict(CAMERA), "crowd") | row for row in crowd])
    assert not any("of the mass of particle" in str(note) for note in list_messages(table))


def test_a_mass_ratio_of_a_set_is_one_value():
    """Each row repeats it, so that its error is shared, and has no part of the bias or of the camera file."""
    rows = draw_unequal_rows(np.log(1.5), shared=SCALE_OF_RATIO)
    table = pd.DataFrame(calibrate_set(rows)).iloc[::2].assign(fit="local")
    std = table["mass_ratio_std"].to_numpy()
    effects = shared_effects(table, ("mass_ratio",))
    np.testing.assert_allclose(np.abs(effects[:, 0]).max(axis=1), std)
    np.testing.assert_allclose(np.linalg.norm(effects[:, 0], axis=1), std)
    assert combine_quantity(
        "mass_ratio", table.assign(value=table["mass_ratio"], std=std, v_n=0.5, result="a"), effects
    ).mean.std[0] == pytest.approx(std[0], rel=0.01)


@pytest.mark.parametrize("wrong", [0.1, 0.0])
def test_given_masses_that_recoil_contradicts_are_no_errors_of_velocities(wrong):
    """Wrong masses would widen the errors of all velocities, and so hide themselves."""
    rows = draw_unequal_rows(wrong)
    for row in rows:
        row["local"] = row["local"].replace('"masses_known": false', '"masses_known": true')
    errors, right = calibrate_rows(rows), calibrate_rows(draw_unequal_rows(0.0))
    assert errors.log_ratio == errors.log_ratio_std == 0
    assert errors.mass_excess == pytest.approx(wrong, abs=0.003)
    assert errors.error_n == pytest.approx(right.error_n, rel=0.1)
    found = calibrate_set(rows)
    assert [row["mass_ratio"] for row in found] == [row["mass_ratio"] for row in rows]
    assert all(row["recommended"] == "local" for row in found)
    table = pd.DataFrame([make_empty_row(Camera.from_dict(CAMERA), "misfit") | row for row in found])
    said = [str(note) for note in list_messages(table) if "contradicts the masses of the camera file" in str(note)]
    assert len(said) == (wrong > 0)
    assert all("particle 7 has 1.1" in text for text in said)
    assert all(('"ball_masses"' in row["local_shared"]) == (wrong > 0) for row in found)


@pytest.mark.parametrize(("share", "said"), [(0.5, True), (0.1, False)])
def test_unknown_masses_that_differ_from_hit_to_hit_are_no_errors_of_velocities(share, said):
    """As errors they would be 20 % of v0, and all estimates would be lost. A few odd hits keep the calibration."""
    rows = draw_rows(40, 0.003, 0.003, 0.0)
    for k in range(int(share * len(rows))):
        raw = json.loads(rows[k]["local"])
        heavier = 1.5 if k % 2 else -1.5  # logarithm of the mass ratio
        raw["value"][AT["mass_ratio"]] = float(np.exp(heavier))
        raw["value"][AT["balance_n"]] -= 2 * np.tanh(heavier / 2) * 0.9 * raw["v0"]
        raw["response"][AT["mass_ratio"]] = [0.0] * len(raw["response"][AT["mass_ratio"]])
        raw["std"][AT["mass_ratio"]] = 0.01
        rows[k] |= {"local": json.dumps(raw), "mass_ratio": float(np.exp(heavier)), "mass_ratio_std": 0.01}
    assert (calibrate_rows(rows) is None) == said
    empty = make_empty_row(Camera.from_dict(CAMERA), "misfit")
    found = [empty | row | recommend(row) for row in calibrate_set(rows)]
    assert sum(row["recommended"] == "local" for row in found) >= 36
    notes = [str(note) for note in list_messages(pd.DataFrame(found)) if "contradicts equal masses" in str(note)]
    assert len(notes) == said
    assert all("in 20 collisions, with ratios from 0.223 to 4.48" in text for text in notes)


def test_few_hits_keep_the_prior():
    rows = draw_rows(5, 0.01, 0.01, 0.0)
    assert calibrate_rows(rows) is None
    assert calibrate_set(rows)[0]["local_hits"] == 0


def test_settings_reach_the_columns_and_a_later_calibration():
    """A recording alone whose residuals match the claims keeps the least error that real tracks show."""
    assert draw_rows(1, 0.0, 0.0, 0.0)[0]["local_error_n"] == FitSettings().min_local_velocity_error == 0.003
    strict = FitSettings(max_relative_error=1e-6, min_local_velocity_error=0.0, rejection_level=1e-3)
    rows = draw_rows(9, 0.01, 0.01, 0.0, settings=strict, adequate=1e-4)
    assert rows[0]["local_error_n"] == 0
    assert rows[0]["misfit_local"]
    assert not draw_rows(1, 0.0, 0.0, 0.0, adequate=1e-4)[0]["misfit_local"]
    assert np.isfinite(draw_rows(1, 0.01, 0.01, 0.0)[0]["v0_local"])
    assert all(np.isnan(row["v0_local"]) and row["local_hits"] == 9 for row in calibrate_set(rows))


def test_no_estimate_has_no_columns_to_change():
    assert apply_errors(make_empty_columns(), LocalErrors(error_n=0.1)) == {}


def test_bodies_whose_names_mean_nothing_get_no_ratio():
    """Ids of a film are arbitrary: the ratio of one clip may be the inverse of another's."""
    rows = draw_rows(40, 0.003, 0.003, 0.0)
    for k, row in enumerate(rows):
        raw = json.loads(row["local"])
        raw["response"][AT["balance_n"]][8] = 0.9 * raw["v0"]
        raw["value"][AT["balance_n"]] -= (1 if k % 4 < 2 else -1) * 0.2 * 0.9 * raw["v0"]
        row |= {"particle1": 7 if k % 2 else 9, "particle2": 9 if k % 2 else 7, "local": json.dumps(raw)}
    assert calibrate_rows(rows).log_ratio_std == 0


def as_motions(rows, glide):
    """The rows with a friction each; the first `glide` of them glide, the others slide and roll."""
    names = ["glide"] * glide + ["slide and roll"] * (len(rows) - glide)
    return [
        make_empty_columns() | row | {"motion_local": name, "mu_k_local": 0.1, "mu_k_local_std": 0.01}
        for row, name in zip(rows, names, strict=True)
    ]


@pytest.mark.parametrize("hits", [6, 20])
def test_no_hit_of_bodies_that_glide_has_a_friction(hits):
    rows = as_motions(draw_rows(hits, 0.003, 0.003, 0.0), hits // 2)
    for before, after in zip(rows, calibrate_set(rows), strict=True):
        assert np.isnan(after["mu_k_local"])
        assert np.isnan(after["mu_k_local_std"])
        assert np.isfinite(after["r_local"])
        assert after["motion_local"] == before["motion_local"]
    assert json.dumps(calibrate_set(calibrate_set(rows))) == json.dumps(calibrate_set(rows))


@pytest.mark.parametrize("glide", [0, 2, 5])
def test_few_disturbed_hits_of_balls_that_roll_leave_the_friction_of_the_others(glide):
    raw = [json.loads(row["local"]) for row in draw_rows(20, 0.003, 0.003, 0.0)]
    rows = as_motions([{"local": json.dumps(one | {"unseen": []})} for one in raw], glide)
    assert all("mu_k" not in json.loads(row["local"])["unseen"] for row in calibrate_set(rows))


@pytest.mark.parametrize(("bias", "said"), [(0.0, False), (0.2, True)])
def test_a_note_names_given_masses_that_one_hit_contradicts(bias, said):
    """A fifth of the momentum is too much for errors of velocities of 1.2 %."""
    (row,) = draw_rows(1, 0.003, 0.003, bias)
    raw = json.loads(row["local"]) | {"masses_known": True}
    changed = row | {"local": json.dumps(raw, separators=(",", ":")), "recommended": "local"}
    table = pd.DataFrame([make_empty_row(Camera.from_dict(CAMERA), "misfit") | changed])
    notes = [str(note) for note in list_messages(table)]
    assert any("check which ball is which" in note for note in notes) == said
