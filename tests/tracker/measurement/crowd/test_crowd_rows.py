"""Which positions of the balls of a crowd count for a contact, and what a contact shows of the plate's friction."""

import numpy as np
import pytest

from tracker.measurement.collision.contacts import ContactCandidate, prepare_contact
from tracker.measurement.crowd import crowd_rows
from tracker.measurement.crowd.crowd_rows import MU_K, _keep_moving, _share_friction
from tracker.measurement.crowd.track_contacts import TrackContact
from tracker.measurement.local.local_columns import LocalErrors, apply_errors, make_local_columns
from tracker.measurement.local.local_estimate import LOCAL_NAMES, LocalEstimate
from tracker.measurement.positions import BallTrack
from tracker.settings import FitSettings

DIAMETER, NOISE, FPS, CONTACT = 0.00238, 5e-6, 1000.0, 50.3


@pytest.mark.parametrize("speed", [0.0, 0.004])
def test_a_ball_that_rolls_slowly_up_to_its_contact_does_not_rest(speed):
    """At 4 mm/s eight positions show no motion, but all fifty do."""
    frame, rng = np.arange(100), np.random.default_rng(1)
    since = (frame - CONTACT) / FPS
    slow = np.where(since < 0, speed, 0.09) * since
    fast = np.where(since < 0, 0.1, 0.01) * since - DIAMETER
    tracks = []
    for particle, x in enumerate((slow, fast)):
        position = np.column_stack([x, 0 * x]) + rng.normal(0, NOISE, (100, 2))
        cov = np.tile(np.eye(2) * NOISE**2, (100, 1, 1))
        tracks.append(BallTrack(particle, frame, frame / FPS, position, cov, exposure=0.0))
    prepared = prepare_contact(ContactCandidate(*tracks, round(CONTACT)), DIAMETER, {}, FitSettings())
    assert not prepared.pair.target_moves
    nothing, none = np.zeros(2), np.zeros((2, 2))
    contact = TrackContact(CONTACT / FPS, 1e-5, 0, 1, nothing, nothing, 0.09, 1e-3, 99, 1, none, (0.3, 0.1), 0.1)
    kept = _keep_moving(prepared, tracks, contact).pair
    assert kept.target_moves == (speed > 0)
    assert kept.struck.particle == 0
    assert len(kept.struck) == 100


@pytest.mark.parametrize("frames_before", [5, 40])
def test_few_positions_do_not_show_that_a_ball_rests(frames_before):
    """Five of them, at 4,000 frames a second, allow half the speed of the hit."""
    frame, rng, fps = np.arange(frames_before + 30), np.random.default_rng(3), 4000.0
    since, tracks = (frame - frames_before + 0.5) / fps, []
    for particle, (before, after) in enumerate(((0.0, 0.09), (0.1, 0.01))):
        x = np.where(since < 0, before, after) * since - particle * DIAMETER
        position = np.column_stack([x, 0 * x]) + rng.normal(0, NOISE, (len(x), 2))
        cov = np.tile(np.eye(2) * NOISE**2, (len(x), 1, 1))
        tracks.append(BallTrack(particle, frame, frame / fps, position, cov, exposure=0.0))
    prepared = prepare_contact(ContactCandidate(*tracks, frames_before), DIAMETER, {}, FitSettings())
    assert not prepared.pair.target_moves
    nothing, none = np.zeros(2), np.zeros((2, 2))
    at = (frames_before - 0.5) / fps
    contact = TrackContact(at, 1e-5, 0, 1, nothing, nothing, 0.09, 1e-3, 99, 1, none, (0.3, 0.1), 0.1)
    assert _keep_moving(prepared, tracks, contact).pair.target_moves == (frames_before == 5)


def test_the_friction_that_a_contact_shows_alone_has_an_error():
    """The balances of momentum do not show that of friction. Allowances of 0.3 of another fit left an error of 0."""
    n = len(LOCAL_NAMES)
    cov, response = np.diag(np.full(n, 0.02**2)), np.zeros((n, 9))
    common = (0.1, 10.0, 10.0, 0.5, False, frozenset[str](), True)
    of_film = LocalEstimate(np.full(n, 0.2), cov, response, *common, cov_of_known=0.9 * cov)
    alone = LocalEstimate(np.full(n, 0.21), 0.6 * cov, response, *common, cov_of_known=0.1 * cov)
    shared = _share_friction(of_film, alone, FitSettings(), 0.05)
    assert not shared.cov_of_known[MU_K].any()
    row = make_local_columns(shared)
    found = apply_errors(row, LocalErrors(allowances=0.3))["mu_k_local_std"]
    assert found == pytest.approx(0.02 * np.sqrt(0.6), rel=1e-6)


def test_allowances_reduce_no_error_by_more_than_their_share():
    """A descent that ended early left a part of 0.11 of an error of 0.04, which fell to 0.005."""
    n = len(LOCAL_NAMES)
    cov, response = np.diag(np.full(n, 0.04**2)), np.zeros((n, 9))
    of_known = np.diag(np.full(n, 0.11**2))
    common = (0.1, 10.0, 10.0, 0.5, False, frozenset[str](), True)
    row = make_local_columns(LocalEstimate(np.full(n, 0.9), cov, response, *common, cov_of_known=of_known))
    assert apply_errors(row, LocalErrors(allowances=0.5))["r_local_std"] == pytest.approx(0.02, rel=1e-6)


@pytest.mark.parametrize(("gliding", "of", "glides"), [(3, 9, False), (4, 12, True), (1, 1, False), (0, 20, False)])
def test_a_few_disturbed_contacts_of_balls_that_roll_do_not_make_them_glide(monkeypatch, gliding, of, glides):
    """One contact in ten may be disturbed: three of nine then have a probability of 5 %, and four of twelve 2.6 %."""
    empty = np.zeros(len(LOCAL_NAMES))
    numbers = (empty, np.diag(empty), np.zeros((len(empty), 9)), 1.0, 1.0, 1.0, 1.0)
    shown = [LocalEstimate(*numbers, k < gliding, frozenset(), True) for k in range(of)]
    nothing, none = np.zeros(2), np.zeros((2, 2))
    contact = TrackContact(CONTACT / FPS, 1e-5, 0, 1, nothing, nothing, 0.09, 1e-3, 99, 1, none, (0.3, 0.1), 0.1)
    monkeypatch.setattr(crowd_rows, "_would_end_slide", lambda *given: True)
    monkeypatch.setattr(crowd_rows, "_sort_by_slide", lambda pairs, *given: list(range(len(pairs))))
    monkeypatch.setattr(crowd_rows, "run_together", lambda fits: [(None, each) for each in shown])
    assert crowd_rows.shows_gliding([contact] * of, [], None, FitSettings()) == glides
