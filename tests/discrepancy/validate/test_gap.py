"""The gap is shown on collisions that no fit has seen."""

import dataclasses

import numpy as np
import pytest
from discrepancy_clips import exact, searched

from discrepancy.data.launch import V0, B
from discrepancy.data.study_design import split_held_out
from discrepancy.fitting.gauss_newton import fit_model
from discrepancy.noise.model import Noise, NoiseComponent
from discrepancy.noise.whitening import ClipWhitener
from discrepancy.validate.claim_tests import HeldOutTest
from discrepancy.validate.gap import measure_gap
from synthcam.model import Model

EFFECTS = ("velocity_restitution", "rolling_quadratic")


def test_clips_kept_out_are_in_no_fit():
    found = searched("velocity_restitution")
    fitted, kept = ({c.clip for c in clips} for clips in (found.data.clips, found.data.held_out))
    assert not fitted & kept
    assert (len(fitted), len(kept)) == (6, 2)
    for fit, clips in ((found.best_fit, found.data.clips), (found.gap_fits.after, found.data.held_out)):
        assert [len(r) for r in fit.residuals] == [2 * len(c.frame) for c in clips]
    for shown, model in ((found.gap_fits.before, found.base_fit.model), (found.gap_fits.after, found.model)):
        assert shown.names == ()
        assert shown.model == model


@pytest.mark.parametrize(("count", "out"), [(6, 1), (8, 2), (12, 3), (30, 7)])
def test_kept_out_clips_cover_the_speeds_and_the_extremes(count, out):
    clips = exact(Model(), count, 7)
    fitted, kept = split_held_out(clips)
    assert (len(fitted), len(kept)) == (count - out, out)
    assert {c.clip for c in fitted + kept} == set(range(count))
    by_speed = sorted(clips, key=lambda c: c.launch[V0])
    if count >= 8:
        fastest, numbers = by_speed[-1].clip, {c.clip for c in kept}
        slower = sorted(by_speed[:-1], key=lambda c: abs(c.launch[B]))
        assert {fastest, slower[-1].clip} <= numbers
    if count == 30:
        assert all(any(c.clip in numbers for c in by_speed[k : k + 10]) for k in (0, 10, 20))


@pytest.mark.parametrize("hidden", [EFFECTS[0], pytest.param(EFFECTS[1], marks=pytest.mark.gate)])
def test_the_gap_closes(hidden):
    shown = searched(hidden).gap_fits
    gap, points = shown.gap, shown.after.points
    scatter = np.sqrt(2 / points) + np.sqrt(2 / 2000)  # of chi^2 a point, and of the noise that was read off
    assert gap.before > gap.floor + 20 * scatter
    assert abs(gap.after - gap.floor) < 4 * scatter
    assert gap.closure == pytest.approx((gap.before - gap.after) / (gap.before - gap.floor))
    assert abs(gap.closure - 1) < 4 * scatter / (gap.before - gap.floor)
    assert gap.before_um > gap.after_um == pytest.approx(gap.floor_um, rel=0.05)


@pytest.mark.parametrize("rho", [0.0, pytest.param(0.5, marks=pytest.mark.gate)])
def test_with_nothing_hidden_there_is_no_gap(rho):
    gap = searched("nothing", rho).gap
    assert gap.before == gap.after
    assert gap.after == pytest.approx(gap.floor, rel=0.12)
    assert gap.floor_um == pytest.approx(1.6, rel=0.1)
    assert np.isnan(gap.closure)  # a share of chance


def test_the_floor_is_what_six_numbers_a_clip_leave_of_noise():
    found = searched("nothing")
    assert found.gap.floor == pytest.approx(1 - 6 / np.mean([2 * len(c.frame) for c in found.data.held_out]))


@pytest.mark.parametrize("rho", [0.0, pytest.param(0.5, marks=pytest.mark.gate)])
def test_the_floor_of_each_phase_is_what_drawn_noise_leaves(rho):
    found, rng = searched("nothing", rho), np.random.default_rng(8)
    before, gap = found.gap_fits.before, found.gap
    left, metres = [], []
    for clip, launch in zip(found.data.held_out, before.launch_slopes, strict=True):
        drawn = rng.standard_normal((len(launch), 2000))
        rest = drawn - launch @ np.linalg.lstsq(launch, drawn, rcond=None)[0]
        left.append((rest.reshape(-1, 2, 2000) ** 2).mean(axis=(1, 2)))
        metres.append((ClipWhitener.of(clip, found.data.noise).undo(rest) ** 2).mean(axis=(1, 2)))
    phase = np.concatenate([c.phases() for c in found.data.held_out])
    assert set(gap.by_phase) == {"before", "sliding", "rolling"}
    for k, part in enumerate(gap.by_phase.values()):
        assert part.floor == pytest.approx(np.concatenate(left)[phase == k].mean(), rel=0.01)
        assert part.floor_um == pytest.approx(1e6 * np.sqrt(np.concatenate(metres)[phase == k].mean()), rel=0.02)


def test_the_gap_lies_in_the_phases_of_what_is_hidden():
    parts = searched("velocity_restitution").gap.by_phase
    for name in ("sliding", "rolling"):
        assert parts[name].before > 3 * parts[name].floor
        assert parts[name].before_um > parts[name].after_um
    for part in parts.values():
        assert part.after == pytest.approx(part.floor, rel=0.25)


def test_the_gap_counts_a_clip_that_no_model_predicts_as_the_tests_of_claims_do():
    """One of five clips is shaken by 1 mm, so both models miss it; the true model predicts the others."""
    rng, white = np.random.default_rng(4), Noise(NoiseComponent(1e-5))
    true = Model().replace({"rolling_quadratic.K": 0.3})
    clips = [dataclasses.replace(c, xy=c.xy + 1e-5 * rng.standard_normal(c.xy.shape)) for c in exact(true, 5, 5)]
    plain = fit_model(clips, Model(), (), white)
    clean = measure_gap(clips, plain, dataclasses.replace(plain, model=true), white).gap
    clips[3].xy[::2] += 1e-3
    shown = measure_gap(clips, plain, dataclasses.replace(plain, model=true), white)
    held = HeldOutTest.of(shown.before.residuals, shown.after.residuals, np.inf)
    assert (clean.outliers, shown.gap.outliers) == (0, 1)
    assert held.gap == pytest.approx((shown.gap.before, shown.gap.after))
    assert shown.gap.after < 0.1 * shown.after.chi2 / shown.after.points


def test_a_model_without_a_motion_closes_nothing():
    clips, white = exact(Model(), 2, 5), Noise(NoiseComponent(1.0))
    base = fit_model(clips, Model(), (), white)
    steep = dataclasses.replace(base, model=Model().replace({"plate_tilt.x": 5e-3}))
    shown = measure_gap(clips, base, steep, white)
    assert shown.gap.after == shown.gap.before
