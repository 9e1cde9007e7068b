"""Contacts that take time, held to springs with dashpots that scipy integrates."""

from dataclasses import replace

import numpy as np
import pytest
from tracker_contacts import LAWS, SoftHit, draw_hit

import tracker
from tracker.measurement.collision import contact_frames
from tracker.measurement.collision.collision_model import FREE
from tracker.measurement.collision.contact_frames import find_frames_in_contact, leave_out_frames
from tracker.measurement.collision.contacts import find_contacts, prepare_contact
from tracker.measurement.collision.lasting_contact import fit_lasting_contact
from tracker.measurement.collision.lasting_motion import LastingResiduals
from tracker.measurement.messages import list_messages
from tracker.measurement.positions import BallTrack
from tracker.report.estimates_text import format_for_terminal
from tracker.settings import FitSettings

pytestmark = pytest.mark.usefixtures("not_local")


def measure(hit, seed=0):
    """The row of a hit, and the result."""
    result = tracker.measure(hit.tracks(np.random.default_rng(seed)), hit.camera, unit="m")
    return result.estimates.iloc[0], result


def z(row, name, true):
    return (row[name] - true) / row[f"{name}_std"]


@pytest.mark.parametrize(
    ("duration", "b", "r", "friction"),
    [
        *(
            pytest.param(*case, marks=pytest.mark.gate)
            for case in ((0.014, 0.2, 0.9, 0.0), (0.018, 0.4, 0.9, 0.0), (0.015, 0.0, 0.6, 0.0))
        ),
        (0.006, 0.3, 0.8, 0.0),
        (0.010, 0.0, 0.9, 0.2),
        (0.016, 0.3, 0.7, 0.1),
    ],
)
def test_rubber_keeps_its_restitution_and_gets_a_duration(duration, b, r, friction):
    hit = SoftHit(duration, r, b=b, friction=friction)
    row, _ = measure(hit)
    assert (row["status"], row["flags"]) == ("ok", "contact lasts")
    assert abs(z(row, "r", r)) < 4
    assert abs(z(row, "contact_duration_s", hit.time_within)) < 4  # longer than the force by friction
    assert row["r_std"] < 0.03
    assert row["contact_duration_s_std"] < 0.05 * duration
    assert row["noise_rho"] == 0
    if friction:
        assert abs(z(row, "mu_k", friction)) < 4


def test_finite_differences_show_nothing_after_a_contact_that_lasts():
    row, result = measure(SoftHit(0.014, b=0.2))
    assert np.isnan(row[["r_paper", "r_paper_std", "tau2_paper", "C_paper"]].astype(float)).all()
    assert abs(z(row, "v0_paper", 0.3)) < 4
    text = "\n".join(format_for_terminal(result.estimates))
    assert "straight lines of two equal bodies" in text
    assert "finite differences: the frames after a contact that lasts are too far" in text
    (note,) = list_messages(result.estimates)
    assert "contact_duration_s" not in str(note)
    frames = f"frames {row['contact_first']} to {row['contact_last']}"
    assert f"for {1e3 * row['contact_duration_s']:.3g} ms" in str(note)
    assert frames in str(note)


@pytest.mark.parametrize(("r", "v0", "b"), [(0.41, 0.44, 0.0), (0.8, 0.4, 0.2), (0.6, 0.2, -0.2)])
def test_finite_differences_after_an_instant_have_the_error_of_what_sliding_takes(r, v0, b):
    """Without friction they are right; with it their restitution is too low by far more than its noise."""
    for friction in (0.0, 0.15):
        row, _ = measure(SoftHit(0.0, r, v0=v0, b=b, friction=friction, fps=250.0, noise=1e-6))
        off = row["r_paper"] - r
        assert abs(off) < 1.5 * row["r_paper_std"] + 0.003
        assert (row["r_paper_std"] < 0.003) == (friction == 0)
        assert (off < -0.02) == (friction > 0)


def test_a_contact_between_two_frames_is_no_ok_but_keeps_r_free():
    """A diameter that is too large by .6 % would look the same."""
    row, result = measure(SoftHit(0.002, 0.9, friction=0.0, fps=250.0, b=0.2))
    assert (row["status"], row["flags"]) == ("misfit", "contact lasts or balls are smaller")
    assert np.isnan(row["r_std"])
    assert abs(z(row, "r_free", 0.9)) < 4
    assert "ball_diameter" in str(list_messages(result.estimates)[0])


def test_slides_that_end_with_the_contact_give_no_restitution():
    row, _ = measure(SoftHit(0.028, 0.4, v0=0.15, friction=0.2, fps=250.0))
    assert "hides how they part" in row["status"]
    assert np.isnan(row["r"])


def test_slides_are_hidden_by_a_contact_whatever_the_friction():
    """Precise tracks exclude frictions a tenth off: only that of these balls shows that they slid."""
    hit = SoftHit(0.0123, 0.32, v0=0.29, b=0.3, friction=0.235, after=175, noise=1.26e-5, law="viscous")
    row, _ = measure(hit, 1)
    assert row["status"].startswith("the contact lasts as long as the balls may slide")
    assert np.isnan(row["r_free"])  # straight lines give .081 +- .002


def test_too_few_frames_after_a_contact_are_named():
    row, _ = measure(SoftHit(0.02, 0.9, after=14))
    assert "too few frames" in row["status"]


@pytest.mark.parametrize("b", [0.0, 0.3])
def test_a_hit_without_friction_gives_r_by_straight_lines(b):
    row, result = measure(SoftHit(0.0, 0.8, b=b))
    assert row["status"] == "ok"
    assert abs(z(row, "r", 0.8)) < 4
    assert abs(z(row, "r_free", 0.8)) < 4
    assert np.isnan(row[["mu_k", "tau1", "energy_fraction"]].astype(float)).all()
    text = "\n".join(format_for_terminal(result.estimates))
    assert "straight lines of two equal bodies" in text
    assert "finite differences" in text
    assert np.isnan(row[["tau2_paper", "C_paper", "energy_fraction_paper"]].astype(float)).all()


def test_a_slow_hit_without_friction_may_be_one_of_balls_that_roll_at_once():
    """r of .3 without friction is the motion of r = .82 whose slides end within a frame."""
    row, _ = measure(SoftHit(0.0, 0.3, v0=0.06, fps=250.0, before=60))
    assert row["status"].startswith("the balls move straight after the hit")


def test_an_instantaneous_hit_is_not_said_to_last():
    row, result = measure(SoftHit(0.0, 0.9, friction=0.2, b=0.2))
    assert (row["status"], row["flags"]) == ("ok", "")
    assert np.isnan(row["contact_duration_s"])
    assert row["contact_first"] == -1
    assert "lasts" not in "\n".join(format_for_terminal(result.estimates))


def test_noise_hides_a_contact_from_frame_to_frame_but_not_from_many():
    row, _ = measure(SoftHit(0.02, 0.7, v0=0.36, fps=1000.0, noise=1.1e-4, before=80, after=350))
    assert row["status"] == "ok"
    assert abs(z(row, "r", 0.7)) < 4


@pytest.mark.gate
def test_errors_of_the_scale_move_the_duration_with_the_diameter():
    hit = SoftHit(0.014, b=0.2)
    tracks = hit.tracks(np.random.default_rng(0))
    stds = []
    for share in (0.0, 0.005):
        camera = hit.camera | ({"ball_diameter_std": share * hit.diameter} if share else {})
        row = tracker.measure(tracks, camera, unit="m").estimates.iloc[0]
        stds.append(row["contact_duration_s_std"])
    # T = (D - d)(1 + r)/(r v), so that dT/dD = (1 + r)/(r v)
    assert np.hypot(stds[0], 0.005 * 0.05 * 1.9 / (0.9 * 0.3 * np.cos(np.arcsin(0.2)))) == pytest.approx(
        stds[1], rel=0.1
    )


def test_the_laws_of_a_slide_hold_where_the_line_of_centres_turns():
    """Without the turn of its impulse, this contact is a misfit."""
    hit = SoftHit(0.02, 0.7, v0=0.35, b=0.45, friction=0.15, law="hertz", fps=1000.0, noise=8e-6, before=60, after=200)
    row, _ = measure(hit)
    assert row["status"] == "ok"
    assert abs(z(row, "contact_duration_s", hit.time_within)) < 4
    assert abs(z(row, "mu_k", 0.15)) < 4


@pytest.mark.gate
@pytest.mark.parametrize(("r", "friction", "duration", "b"), [(0.8, 0.1, 0.015, 0.0), (0.9, 0.08, 0.025, 0.0)])
def test_errors_by_the_law_of_the_force_are_as_large_as_its_spread(r, friction, duration, b):
    """By five laws, the tied fit gives values about the true ones, which scatter by their errors.

    Each law has two clips with opposite noise, which leaves the mean to the laws.
    """
    offs = []
    for law in LAWS:
        hit = SoftHit(duration, r, b=b, friction=friction, law=law, fps=1000.0, noise=1e-5, before=80, after=350)
        noisy, exact = (replace(hit, noise=noise).tracks(np.random.default_rng(0)) for noise in (hit.noise, 0.0))
        mirrored = noisy.assign(x=2 * exact["x"] - noisy["x"], y=2 * exact["y"] - noisy["y"])
        rows = [tracker.measure(each, hit.camera, unit="m").estimates.iloc[0] for each in (noisy, mirrored)]
        offs.append([[z(row, "r", r), z(row, "mu_k", friction)] for row in rows])
    by_law = np.mean(offs, axis=1)
    assert np.abs(by_law.mean(axis=0)).max() < 0.7
    assert np.abs(by_law).max() < 2.5
    assert np.std(offs, axis=(0, 1)).min() > 0.5


def list_balls(hit):
    """The tracks of both balls of a hit, with the errors that they have."""
    table = hit.tracks(np.random.default_rng(1))
    balls = []
    for particle, part in table.groupby("particle"):
        cov = np.tile(np.eye(2) * hit.noise**2, (len(part), 1, 1))
        frame, position = part.frame.to_numpy(), part[["x", "y"]].to_numpy()
        balls.append(BallTrack(particle, frame, frame / hit.fps, position, cov, 1e-3))
    return balls


@pytest.mark.parametrize("kind", ["free", "tied", "straight"])
def test_derivatives_are_those_of_the_residuals(kind):
    hit = SoftHit(0.014, b=0.2, friction=0.2)
    balls = list_balls(hit)
    (candidate,) = find_contacts(balls, hit.diameter)
    fits = fit_lasting_contact(candidate, hit.diameter, {}, FitSettings())
    problem = LastingResiduals(fits.pair, kind)
    names = {"free": fits.free.problem.names, "tied": fits.tied.problem.names}.get(kind)
    if kind == "straight":
        names = problem.names
        free = dict(zip(FREE, fits.free.free, strict=True))
        x = np.array([*(free[name] for name in names), 1e-5, fits.free.x[-1]])
    else:
        x = getattr(fits, kind).x
    assert names == problem.names
    _, slope = problem(x)
    for k, size in enumerate(np.maximum(np.abs(x), 1e-2) * 1e-5):
        step = size * np.eye(len(x))[k]
        high, low = (LastingResiduals(fits.pair, kind).residual(x + sign * step) for sign in (1, -1))
        numeric = (high - low) / (2 * size)
        assert numeric == pytest.approx(slope[:, k], abs=0.01 * np.abs(slope[:, k]).max() + 1e-6)


@pytest.mark.gate
def test_scores_of_contacts_of_all_kinds():
    """8 clips: rms z of what is claimed as ok, and no wild claim."""
    found = []
    for k in range(8):
        rng = np.random.default_rng([1, k])
        hit = draw_hit(rng)
        row = tracker.measure(hit.tracks(rng), hit.camera, unit="m").estimates.iloc[0]
        found += [z(row, name, hit.r) for name in ("r", "r_free") if np.isfinite(row[f"{name}_std"])]
    assert len(found) > 4
    assert np.abs(found).max() < 4
    assert np.sqrt(np.mean(np.square(found))) < 1 + 4 / np.sqrt(2 * len(found))


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.gate), pytest.param(3, marks=pytest.mark.gate)])
def test_a_contact_of_two_frames_whose_slides_end_in_a_second_touch_gives_no_wrong_restitution(seed):
    """The balls touch at less than a diameter, but positions before the second touch suit straight lines as well."""
    hit = SoftHit(0.0073, 0.28, v0=0.36, b=0.12, friction=0.21, fps=250.0, before=20, after=87, noise=1.06e-4)
    hit = replace(hit, law="viscous")
    row = tracker.measure(hit.tracks(np.random.default_rng(seed)), hit.camera, unit="m").estimates.iloc[0]
    assert row["status"] != "ok" or abs(row["r"] - hit.r) < 4 * row["r_std"]


@pytest.mark.gate
def test_a_contact_whose_first_fits_end_in_a_false_friction_is_fitted_again():
    """Balls of r .25 touch again soon. From the friction of the free fit, half of the true one fits far worse."""
    rng = np.random.default_rng([71, 98])
    hit = draw_hit(rng)
    row = tracker.measure(hit.tracks(rng), hit.camera, unit="m").estimates.iloc[0]
    assert row["status"] == "ok"
    assert abs(z(row, "mu_k", hit.friction)) < 3
    assert abs(z(row, "contact_duration_s", hit.time_within)) < 3


def test_straight_paths_hold_where_no_sliding_ones_lead_back_to_the_contact(monkeypatch):
    """So it is in a graze, once the frames beside the contact are left out."""
    hit = SoftHit(0.014, b=0.2)
    (candidate,) = find_contacts(list_balls(hit), hit.diameter)
    pair = prepare_contact(candidate, hit.diameter, {}, FitSettings()).pair
    straight, window = find_frames_in_contact(pair, (candidate.frame, candidate.frame))
    assert straight.problem.kind == "straight"
    monkeypatch.setattr(contact_frames, "guess_free_motions", lambda *_: [])
    again = contact_frames._fit_outside(leave_out_frames(pair, *window), window, straight)
    assert again.problem.kind == "straight"
