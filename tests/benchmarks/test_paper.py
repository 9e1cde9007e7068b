"""The reproduction of the paper: closed forms, its analysis on motions written down by hand, a figure from video."""

import numpy as np
import pytest

from benchmarks.paper import experiment, kondic, make, readings
from benchmarks.paper.kondic import GRAVITY, Laws
from benchmarks.paper.models import candidates, contradictions, observed
from benchmarks.paper.published import OBSERVED
from benchmarks.paper.report import findings, page
from tracker.measurement.joint_fit import predict_quantities

FPS, DIAMETER, FRAMES = 250.0, 2.38e-3, 100
V0 = np.linspace(0.2, 0.6, 41)
LAWS = Laws(0.903, 0.347, 0.232)


def test_closed_forms_give_the_numbers_worked_out_by_hand():
    v1f, v2f, tau1, tau2 = kondic.head_on(np.array([0.2]), LAWS)[0]
    assert v1f / 0.2 == pytest.approx(0.5805, abs=5e-5)
    assert v2f / 0.2 == pytest.approx(0.2212, abs=5e-5)
    velocity = kondic.final(np.array([0.0]), LAWS)
    assert kondic.energy(velocity)[0] == pytest.approx(0.386, abs=5e-4)
    assert kondic.momentum(velocity, np.array([0.0]))[0] == pytest.approx(1 - 4 * 0.347 / 7, abs=1e-12)
    assert [1e3 * t / 2 for t in (tau1, tau2)] == pytest.approx([16.3, 7.6], abs=0.05)  # at 10 cm/s, not 60


def test_oblique_hits_agree_with_the_trackers_and_the_papers_formulas():
    b = np.linspace(-0.95, 0.95, 39)
    velocity = kondic.final(b, LAWS)
    fitted = predict_quantities(np.ones_like(b), b, np.array([LAWS.r, LAWS.mu, LAWS.C]))
    assert np.hypot(*velocity[0].T) == pytest.approx(fitted[:, 0], abs=1e-12)
    assert np.hypot(*velocity[1].T) == pytest.approx(fitted[:, 1], abs=1e-12)
    some = np.array([0.096, 0.25])
    assert np.degrees(kondic.paper_angle(some)) == pytest.approx([63.3, 79.4], abs=0.05)
    assert kondic.angle(kondic.free_space(some)) == pytest.approx(kondic.paper_angle(some), abs=1e-12)


def by_hand(v0, contact, laws=LAWS):
    """Head-on collisions as the paper has them: a kick, a parabola, a straight line; no rolling loss."""
    time = np.arange(FRAMES) / FPS - contact[:, None] / FPS
    v1f, v2f, tau1, tau2 = kondic.head_on(v0, laws).T
    push = laws.mu * GRAVITY

    def way(first, pull, tau, last):
        sliding = np.clip(time, 0, tau[:, None])
        return first[:, None] * sliding + pull * sliding**2 / 2 + last[:, None] * np.clip(time - tau[:, None], 0, None)

    struck = DIAMETER + way((1 + laws.r) / 2 * v0, -push, tau1, v1f)
    striker = v0[:, None] * np.clip(time, None, 0) + way((1 - laws.r) / 2 * v0, push, tau2, v2f)
    x = np.stack([struck, striker])
    return readings.Films(np.stack([x, np.zeros_like(x)], axis=-1), FPS, DIAMETER)


def test_the_analysis_gives_back_what_was_written_down():
    contact = 20 + np.linspace(-0.45, 0.45, len(V0))
    read = readings.read(by_hand(V0, contact))
    v1f, v2f, tau1, tau2 = kondic.head_on(V0, LAWS).T
    assert read["v0"].to_numpy() == pytest.approx(V0, rel=1e-9)
    assert read["contact"].to_numpy() == pytest.approx(contact, abs=1e-6)
    assert read["v1f"].to_numpy() == pytest.approx(v1f, rel=5e-3)
    assert read["v2f"].to_numpy() == pytest.approx(v2f, rel=1e-2)
    late = (read["contact"] - read["k"]).to_numpy() / FPS  # the paper counts from the frame of least separation
    assert read["tau1"].to_numpy() - late == pytest.approx(tau1, abs=1.2e-3)
    assert read["tau2"].to_numpy() - late == pytest.approx(tau2, abs=1.2e-3)
    fitted = kondic.fit(V0, read[observed.FINAL].to_numpy())
    assert [fitted.laws.r, fitted.laws.C] == pytest.approx([LAWS.r, LAWS.C], abs=2e-3)
    assert fitted.laws.mu == pytest.approx(LAWS.mu, abs=3e-3)


@pytest.mark.parametrize("window", [name for name in readings.WINDOWS if readings.WINDOWS[name]])
def test_a_late_reading_is_wrong_by_what_friction_did(window):
    """r - 2 mu g t/v0; C of the struck ball and of the striker 5/2 mu g t/v0 apart from the truth, their mean not."""
    contact = 20 + np.linspace(-0.45, 0.45, len(V0))
    films = by_hand(V0, contact)
    read = readings.read(films)
    first, last = readings.WINDOWS[window]
    t = (read["k"] + (first + last) / 2 - contact).to_numpy() / FPS
    shift = LAWS.mu * GRAVITY * t / V0
    slides = kondic.head_on(V0, LAWS)[:, 3] > t + (last - first) / 2 / FPS
    assert slides.sum() > 20
    assert read[f"r {window}"].to_numpy()[slides] == pytest.approx((LAWS.r - 2 * shift)[slides], abs=1e-6)
    assert read[f"C_target {window}"].to_numpy()[slides] == pytest.approx((LAWS.C - 2.5 * shift)[slides], abs=0.02)
    assert read[f"C_striker {window}"].to_numpy()[slides] == pytest.approx((LAWS.C + 2.5 * shift)[slides], abs=0.02)
    assert read[f"C_both {window}"].to_numpy()[slides] == pytest.approx(LAWS.C, abs=0.01)
    assert read[f"kept {window}"].to_numpy()[slides] == pytest.approx(1, abs=1e-9)


def test_the_errors_of_readings_make_the_papers_errors():
    rng, v0 = np.random.default_rng(3), np.linspace(*experiment.SPEEDS, 28)
    sigma = np.array([kondic.SPEED_ERROR, kondic.SPEED_ERROR, kondic.TIME_ERROR, kondic.TIME_ERROR])
    lines = kondic.head_on(v0, LAWS)
    found = [kondic.fit(v0, lines + rng.normal(0, 1, lines.shape) * sigma).laws for _ in range(300)]
    r, c, mu = (np.std([getattr(x, name) for x in found]) for name in ("r", "C", "mu"))
    assert [r, c, mu] == pytest.approx([0.008, 0.008, 0.023], rel=0.25)


def test_a_model_that_shows_what_is_printed_has_no_chi2():
    printed = {x.name: x.value for x in OBSERVED}
    assert observed.chi2(printed) == 0
    off = printed | {"C, spins": 0.347}
    assert observed.chi2(off) == pytest.approx((0.097 / 0.02) ** 2)


def test_every_effect_of_motion_is_a_candidate():
    effects = candidates.physical()
    assert {"hop", "ball_friction", "stribeck", "mass_mismatch"} <= set(effects)
    assert not {"scale_error", "rolling_shutter", "pixel_locking"} & set(effects)
    for effect in effects:
        assert {c.name for c in candidates.sizes_of(effect)} == {effect}


def test_the_score_averages_over_ways_and_charges_for_numbers():
    rows = [
        {"name": name, "words": "", "extra": extra, "window": w, "balls": b, "chi2": 4.0, "effects": {}}
        for name, extra in (("base", 0), ("hop", 2))
        for w, b in observed.WAYS
    ]
    table = contradictions.best_of(contradictions.pd.DataFrame(rows))
    assert dict(zip(table["name"], table["score"], strict=True)) == pytest.approx({"base": 4.0, "hop": 8.0})


def test_a_figure_from_video_which_is_not_filmed_twice(tmp_path, monkeypatch, capsys):
    arguments = ["--figure", "fig10_sketch", "--quick", "--workers", "1", "-o", str(tmp_path)]
    make.main(arguments)
    assert (tmp_path / "figures" / "fig10_sketch.svg").read_text().startswith("<?xml")
    kept = experiment.filmed("fast", tmp_path / "series")
    assert kept.estimates["v0"].iloc[0] == pytest.approx(0.37, abs=1e-4)
    monkeypatch.setattr(experiment, "_film_one", None)
    make.main(arguments)
    with pytest.raises(SystemExit) as stop:
        make.main(["--figure", "fig99"])
    assert stop.value.code == 2
    assert "expected one of fig01_acceleration" in capsys.readouterr().err


def test_every_figure_says_what_the_page_needs():
    names = page.figures()
    numbers = [page._module(name).NUMBER for name in names]
    assert numbers[:13] == [str(n) for n in range(1, 14)]  # all thirteen of the paper
    for name in names:
        assert set(page.needs(name)) <= set(experiment.SERIES)
        assert page._module(name).PAPER


def stepped(v0, until, step=2e-6):
    """A head-on collision by small steps of friction, no formula: velocities then and when both roll; slides' ends."""
    v = np.array([(1 + LAWS.r) / 2, (1 - LAWS.r) / 2]) * v0
    w = np.array([-LAWS.C, 1 - LAWS.C]) * v0  # R times the spins, struck ball and striker
    then, ends, time = v, [0.0, 0.0], 0.0
    while np.abs(v - w).max() > 0:
        slip = np.sign(v - w)
        left = np.minimum(LAWS.mu * GRAVITY * step, np.abs(v - w) / 3.5)
        v, w, time = v - slip * left, w + 2.5 * slip * left, time + step
        v, w = np.where(np.abs(v - w) < 1e-12, (v + w) / 2, v), np.where(np.abs(v - w) < 1e-12, (v + w) / 2, w)
        ends = [time if s else e for s, e in zip(slip, ends, strict=True)]
        then = v if time <= until else then
    return then, v, ends


def test_the_mean_of_both_spins_tells_c_while_both_slide_and_falls_later():
    for late, c in ((0.002, 0.347), (0.006, 0.347), (findings.read_for_mean(0.25)[0], 0.25)):
        then, last, ends = stepped(0.1, late)
        spins = (7 * last - 5 * then) / 2 / 0.1
        assert (1 - spins.sum()) / 2 == pytest.approx(c, abs=1e-3)
    assert (then[0] - then[1]) / 0.1 == pytest.approx(
        findings.read_for_mean(0.25)[1], abs=1e-3
    )  # r by differences: .48
    assert ends == pytest.approx([0.0163, 0.0076], abs=5e-5)


def test_printed_errors_make_errors_of_the_lines():
    found = kondic.head_on_errors(np.array([1.0]), errors=Laws(0.008, 0.0, 0.023))[0]
    assert found[0] == pytest.approx(2.5 * 0.008 / 7)
    assert found[2] == pytest.approx(kondic.head_on(np.array([1.0]))[0, 2] * np.hypot(0.091, 0.004 / 1.2985), rel=0.02)
