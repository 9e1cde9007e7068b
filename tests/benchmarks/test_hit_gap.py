"""Models of hits agree with synthcam: the impact is the same, and only the right laws fit simulated hits."""

import numpy as np
import pandas as pd
import pytest

from benchmarks.real import simulated_hits
from benchmarks.real.hit_fits import (
    HitModel,
    fit_model,
    guess_numbers,
    make_errors,
    measure_near_noise,
    roll_throughout,
)
from benchmarks.real.hit_gap import START, list_lines
from benchmarks.real.hit_models import SCATTERS, SHARED, BallsAtContact, Common, HitLaws, HitPositions, collide
from benchmarks.real.recordings import BALL_M, FRAME_S, TABLE_M, RecordedHit
from benchmarks.real.simulated_hits import ContactTruth, HitDesign, draw_waves, simulate_hit
from synthcam.dynamics.kinematics import plate_state, rolling_state
from synthcam.model import as_model

CAMERA = {"size": [2840, 1420], "fps": 1 / FRAME_S, "scale": 1e-3, "exposure": 0.0, "ball_diameter": BALL_M}
BASE = ("cloth", "loss", "drag", "r", "friction")
FRICTION, CONTACT_S, HITS = 0.15, 0.407, 8


@pytest.fixture
def no_scatter(monkeypatch):
    """Simulated hits without scatter from hit to hit, warp, and extra noise beside the contact."""
    for name in ("SLIDING_FRICTION_SCATTER", "ROLLING_DECEL_SCATTER", "RESTITUTION_SCATTER", "WARP_M"):
        monkeypatch.setattr(simulated_hits, name, 0.0)
    monkeypatch.setattr(simulated_hits, "NOISE_BESIDE_CONTACT_M", simulated_hits.NOISE_M)


def draw_hits(truth, seed=1):
    """Hits of several speeds and impact parameters; the strikers of every second one slide at first."""
    rng, hits = np.random.default_rng(seed), []
    time = np.arange(44) * FRAME_S
    for k in range(HITS):
        rows = [pd.DataFrame({"t_s": time, "particle": j, "frame": np.arange(44)}) for j in (0, 1)]
        heading, turn = rng.uniform(0, 2 * np.pi), rng.uniform(0, 2 * np.pi)
        design = HitDesign(
            hit=RecordedHit(str(k), pd.concat(rows, ignore_index=True), CAMERA),
            contact_s=CONTACT_S,
            start_s=0.0,
            place=np.array(TABLE_M) / 2,
            velocity=rng.uniform(1.0, 2.5) * np.array([np.cos(heading), np.sin(heading)]),
            slide=np.array([np.cos(turn), np.sin(turn)]),
            slide_s=0.2 * (k % 2),
            slides_at_contact=False,
            impact_parameter=rng.choice([-1, 1]) * rng.uniform(0.2, 0.8),
        )
        hits.append(simulate_hit(design, truth, rng, draw_waves(rng)).hit)
    return HitPositions.of(hits, np.full(HITS, CONTACT_S))


def fit(hits, laws, shared=BASE, scatters=None, free=False):
    """Fit a model to hits with the usual noise."""
    model = HitModel(laws, shared, tuple(scatters or ()), free)
    starts = guess_numbers(hits)
    starts = roll_throughout(starts) if laws.striker == "rolls" else starts
    common = Common(START, scatters or {})
    return fit_model(hits, make_errors(hits), model, common, starts, np.ones(HITS, dtype=bool))


@pytest.mark.usefixtures("no_scatter")
def test_the_right_laws_leave_only_noise_and_wrong_ones_a_gap():
    hits = draw_hits(ContactTruth({"mu": FRICTION}))
    right = fit(hits, HitLaws())
    assert np.sum(right.cost) / np.sum(right.dof) == pytest.approx(1.0, abs=0.12)
    assert right.common.numbers["friction"] == pytest.approx(FRICTION, abs=0.01)
    assert right.common.numbers["r"] == pytest.approx(simulated_hits.RESTITUTION, abs=0.01)
    assert right.common.numbers["cloth"] == pytest.approx(simulated_hits.SLIDING_FRICTION, rel=0.02)
    free = fit(hits, HitLaws(), BASE[:3], free=True)
    assert np.sum(free.cost) / np.sum(free.dof) == pytest.approx(1.0, abs=0.12)
    share = fit(hits, HitLaws(coulomb=False))
    assert np.sum(share.cost) > 1.5 * np.sum(right.cost)
    assert np.median(fit(hits, HitLaws(striker="rolls")).ratio) > 10
    gain = right.log_densities(make_errors(hits)) - share.log_densities(make_errors(hits))
    assert gain.sum() > 20


@pytest.mark.usefixtures("no_scatter")
def test_a_hop_has_the_size_that_it_was_given():
    hits = draw_hits(ContactTruth({"mu": FRICTION}, hops=True))
    without, hop = fit(hits, HitLaws()), fit(hits, HitLaws(), (*BASE, "hop"))
    assert hop.common.numbers["hop"] == pytest.approx(1.0, abs=0.3)
    assert np.sum(without.cost) > 1.2 * np.sum(hop.cost)


@pytest.mark.usefixtures("no_scatter")
def test_a_scatter_and_the_noise_beside_the_contact_are_measured(monkeypatch):
    monkeypatch.setattr(simulated_hits, "RESTITUTION_SCATTER", 0.06)
    monkeypatch.setattr(simulated_hits, "NOISE_BESIDE_CONTACT_M", 1.2e-3)
    monkeypatch.setattr(simulated_hits, "RESTITUTION", 0.85)
    hits = draw_hits(ContactTruth({"mu": FRICTION}))
    near, size, counted = hits.tell_near(1.5), 6e-4, np.ones(HITS, dtype=bool)
    free = HitModel(HitLaws(), BASE[:3], free=True)
    starts = guess_numbers(hits)
    for _ in range(6):
        errors = make_errors(hits, near, size)
        found = fit_model(hits, errors, free, Common(START), starts, counted)
        size, starts = measure_near_noise(hits, found, errors, near, counted), found.own[:, None]
    assert size == pytest.approx(1.2e-3, rel=0.3)
    model, common = HitModel(HitLaws(), BASE, ("r",)), Common(START, {"r": 0.02})
    scattered = fit_model(hits, make_errors(hits, near, size), model, common, guess_numbers(hits), counted, turns=60)
    assert 0.03 < scattered.common.scatters["r"] < 0.12
    assert np.sum(scattered.cost) / np.sum(scattered.dof) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("impact_parameter", [-0.8, 0.3, 0.9])
@pytest.mark.parametrize(
    ("laws", "friction", "same_law"),
    [
        (HitLaws(), 0.08, {"effects": {"ball_friction": {"mu": 0.08}}}),
        (HitLaws(), 1.0, {"effects": {"ball_friction": {"mu": 1.0}}}),
        (HitLaws(coulomb=False), 0.3, {"spin_transfer": 0.3}),
        (HitLaws(coulomb=False), 0.6, {"effects": {"ball_friction": {"mu": 1.0}}}),
    ],
    ids=["weak Coulomb friction", "strong Coulomb friction", "a share", "too large a share"],
)
def test_the_impact_is_that_of_synthcam_and_never_reverses_the_slip(laws, friction, same_law, impact_parameter):
    velocity, slip, spin_speed, restitution = np.array([[2.0, 0.0]]), np.array([[0.3, 0.4]]), 1.0, 0.9
    angle = np.arcsin(impact_parameter)
    normal, tangent = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])

    shared = dict.fromkeys(SHARED, 0.0) | {"r": restitution, "friction": friction}
    effects = {name: np.zeros((1, count)) for name, count in SCATTERS.items()} | {"spin": np.array([[0.5]])}
    before = BallsAtContact(np.zeros((1, 2)), velocity, slip, np.ones(1))
    struck, striker = collide(before, np.array([angle]), effects, shared, laws)

    numbers = {"restitution": restitution, "spin_transfer": same_law.get("spin_transfer", 0.0)}
    model = as_model({"ball": {"diameter": BALL_M}, "model": numbers, "effects": same_law.get("effects", {})})
    radius = BALL_M / 2
    striker_state = plate_state(np.zeros((1, 2)), velocity - 2 / 7 * slip, slip, spin_speed / radius, radius)
    target_state = rolling_state(BALL_M * normal[None], np.zeros((1, 2)), 0.0, radius)
    states = simulated_hits.collide(model, target_state, striker_state)
    lowest = states[:, 3:5] + radius * np.stack([-states[:, 7], states[:, 6]], axis=1)
    np.testing.assert_allclose(np.concatenate([struck.velocity, striker.velocity]), states[:, 3:5], atol=1e-9)
    np.testing.assert_allclose(np.concatenate([struck.slip, striker.slip]), lowest, atol=1e-9)

    slip_before = velocity[0] @ tangent + spin_speed
    slip_after = slip_before - 7 * struck.velocity[0] @ tangent
    assert slip_after * slip_before >= -1e-9
    if friction >= 0.6:
        assert slip_after == pytest.approx(0.0, abs=1e-9)


def test_each_line_adds_to_an_earlier_one():
    lines = list_lines()
    names = [line.name for line in lines]
    assert len(set(names)) == len(names)
    for k, line in enumerate(lines[1:], start=1):
        assert line.adds_to in names[:k]
