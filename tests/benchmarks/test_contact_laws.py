"""Simulated contacts of billiard balls by known laws, and the fits of these laws beside an unseen spin."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from benchmarks.real.contact_laws import LAWS, HopFit, fit_friction, fit_loss_beside_masses, predict_vertical
from benchmarks.real.recordings import FRAME_S, RecordedHit, _order_by_start
from benchmarks.real.simulated_hits import (
    GRAVITY,
    NOISE_BESIDE_CONTACT_M,
    PUBLISHED_FALL,
    SLIDING_FRICTION,
    WARP_M,
    ContactTruth,
    collide,
    draw_waves,
    read_design,
    simulate_hit,
)
from discrepancy.data.contacts import Contacts
from synthcam.dynamics.kinematics import rolling_state
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.model import Bodies

RADIUS, SPEED, SINE, RESTITUTION = 0.03075, 2.0, 0.5, 0.96
COSINE = np.sqrt(1 - SINE**2)
NORMAL = np.array([COSINE, -SINE])  # from the striker, which moves along x, to the target
LAW = {law.name: law for law in LAWS}


def hit(truth, side_spin=0.0):
    """The model, and the states (2, 9) just after a striker that rolls met a target."""
    model = truth.make_model(2 * RADIUS, RESTITUTION)
    striker = rolling_state(np.zeros((1, 2)), np.array([[SPEED, 0.0]]), side_spin * SPEED / RADIUS, RADIUS)
    target = rolling_state(2 * RADIUS * NORMAL[None], np.zeros((1, 2)), 0.0, RADIUS)
    return model, collide(model, target, striker)


@pytest.mark.parametrize("side_spin", [0.0, -1.0, 0.7])
@pytest.mark.parametrize("law", [{"mu": 0.06}, PUBLISHED_FALL])
def test_the_friction_opposes_the_slip_of_the_surfaces(law, side_spin):
    _, (target, _) = hit(ContactTruth(law), side_spin)
    across = SPEED * (SINE + side_spin)
    slip = np.hypot(across, SPEED * COSINE)
    mu = 0.06 if law == {"mu": 0.06} else 0.01 + 0.108 * np.exp(-1.088 * slip)
    tangent = np.array([SINE, COSINE])  # along which the striker passes
    assert target[3:5] @ NORMAL == pytest.approx((1 + RESTITUTION) / 2 * SPEED * COSINE)
    assert target[3:5] @ tangent / (target[3:5] @ NORMAL) == pytest.approx(mu * across / slip, rel=1e-6)


def test_a_hop_takes_the_friction_of_the_vertical_impulse_from_both_balls():
    """The plate presses the target by J more, and the striker by J less; friction is along or against the normal."""
    kept = {}
    for hops in (False, True):
        model, states = hit(ContactTruth({"mu": 0.06}, hops))
        bodies = Bodies(*(np.full(1, x) for x in (RADIUS, 0.2, 0.0, 0.4)))
        late = (solve(model, Launch(0.0, s[None], bodies), end=0.08, finish_slides=False) for s in states)
        kept[hops] = [each.at_one(0, np.array([0.08]))[0, 3:5] @ NORMAL for each in late]
    vertical = 0.06 * COSINE * (1 + RESTITUTION) / 2 * SPEED * COSINE
    lost = np.subtract(kept[False], kept[True])
    np.testing.assert_allclose(lost, SLIDING_FRICTION * vertical, rtol=0.15)


def make_design():
    """The design of a hit whose striker slides for 0.15 s and then rolls."""
    time = np.arange(30) * FRAME_S
    slides = np.minimum(time, 0.15)
    way = 2.5 * time - SLIDING_FRICTION * GRAVITY * (slides * time - slides**2 / 2)
    rows = [
        {"t_s": t, "particle": 1, "x": x, "y": 0.0, "frame": k} for k, (t, x) in enumerate(zip(time, way, strict=True))
    ]
    rows += [{"t_s": t, "particle": 0, "x": 1.0, "y": 0.0, "frame": k} for k, t in enumerate(time)]
    recorded = RecordedHit("one", pd.DataFrame(rows), {"ball_diameter": 2 * RADIUS})
    return read_design(recorded, {"t_c_local": 0.4, "b_local": 0.5})


def test_a_simulated_hit_has_the_design_of_the_recorded_one():
    design = make_design()
    rng = np.random.default_rng(1)
    tracks = simulate_hit(design, ContactTruth(), rng, draw_waves(rng)).hit.tracks
    recorded = design.hit.tracks
    assert tracks[["t_s", "particle"]].equals(recorded[["t_s", "particle"]])
    early = (tracks["particle"] == 1) & (tracks["t_s"] < 0.35)
    off = np.hypot(tracks["x"] - recorded["x"], tracks["y"] - recorded["y"])[early]
    assert off.max() < 0.02
    assert off.max() > WARP_M / 3
    one, two = (tracks[tracks["particle"] == k].set_index("frame") for k in (0, 1))
    apart = np.hypot(one["x"] - two["x"], one["y"] - two["y"])
    assert abs(apart[19:22].min() - 2 * RADIUS) < 0.03
    assert one.loc[:19, "x"].std() < NOISE_BESIDE_CONTACT_M / 10


def test_the_truth_of_a_hit_without_friction_is_the_textbook_s():
    """Of the energy, (1 - r^2) / 2 of the part along the line of centres is lost; the rest does not change."""
    rng = np.random.default_rng(2)
    truth = simulate_hit(make_design(), ContactTruth({"mu": 0.0}), rng, draw_waves(rng)).find_truth()
    assert truth["s"] == pytest.approx(1.0)
    assert truth["impact_energy"] == pytest.approx(1 - (1 - truth["r"] ** 2) / 2 * (1 - 0.5**2))
    out = np.array([[truth[f"v{k}o{axis}"] for axis in "xy"] for k in (1, 2)])
    assert np.hypot(*out.sum(axis=0)) == pytest.approx(truth["v0"])
    assert np.hypot(*out[0]) == pytest.approx((1 + truth["r"]) / 2 * truth["v0"] * np.sqrt(1 - 0.5**2))


def test_the_order_of_starts_names_the_striker_first():
    rows = np.column_stack([np.arange(10.0), np.zeros(10), np.zeros(10)])
    balls = {k: rows + (rows[:, :1] > start) * [0, 0.1, 0] for k, start in ((1, 6), (2, 2), (3, 9))}
    assert _order_by_start(balls) == [2, 1, 3]


def draw_contacts(width, mu=lambda slip: 0.08, loss=0.0, count=150, seed=1):
    """Contacts with errors of 0.01 whose strikers have an unseen spin about the vertical."""
    rng = np.random.default_rng(seed)
    speed, sine = rng.uniform(1.0, 4.0, count), rng.uniform(0.1, 0.8, count)
    normal, across = speed * np.sqrt(1 - sine**2), speed * sine
    surface = across + width * speed * rng.standard_normal(count)
    slip = np.hypot(surface, normal)
    down = mu(slip) * normal / slip
    nothing = dict.fromkeys(("turn", "turn_std", "slip_t_std", "slip_down_std"), np.zeros(count))
    return Contacts(
        clip=np.arange(count),
        bodies=np.full((count, 2), -1),
        levers=np.tile([1.0, -1.0], (count, 1)),
        share=np.ones(count),
        a_strikes=np.zeros(count, dtype=bool),
        glides=np.zeros(count, dtype=bool),
        speed_n=normal,
        speed_t=across,
        slip_t=across,
        slip_down=normal,
        slip=speed,
        restitution=np.full(count, 0.96),
        restitution_std=np.full(count, 0.02),
        friction=mu(slip) * surface / slip + rng.normal(0, 0.01, count),
        friction_std=np.full(count, 0.01),
        recoil=loss * SLIDING_FRICTION * down + rng.normal(0, 0.01, count),
        recoil_std=np.full(count, 0.01),
        shared=np.zeros((count, 3, 0)),
        shared_of_recoil=np.zeros((count, 0)),
        **nothing,
    )


def test_an_unseen_spin_scatters_the_friction_and_is_found():
    contacts = draw_contacts(0.7)
    with_spin, without = (fit_friction(LAW["Coulomb friction"], contacts, spins) for spins in (True, False))
    assert with_spin.numbers[0] == pytest.approx(0.08, abs=0.01)
    assert with_spin.width == pytest.approx(0.7, abs=0.15)
    assert without.scatter > 0.03 > 0.012 > with_spin.scatter
    assert without.cost - with_spin.cost > 25


def test_a_friction_that_falls_is_distinguished_if_the_contacts_show_it():
    contacts = draw_contacts(0.5, lambda slip: 0.08 - 0.04 * np.log(slip / 2.5))
    fall, constant = (
        fit_friction(LAW[name], contacts, True)
        for name in ("Coulomb friction that falls with the slip speed", "Coulomb friction")
    )
    assert constant.cost - fall.cost > 25
    assert fall.numbers[1] == pytest.approx(0.04, abs=0.015)


@pytest.mark.parametrize("loss", [0.0, 2.0])
def test_the_loss_of_a_hop_is_found_beside_the_friction(loss):
    contacts = draw_contacts(0.5, loss=loss)
    vertical = predict_vertical(fit_friction(LAW["Coulomb friction"], contacts, True), contacts)
    found = HopFit.of(contacts, vertical, shared=False)
    assert found.size == pytest.approx(loss, abs=3 * found.std)
    assert (found.gain > 16) == (loss > 0)


def test_masses_of_the_balls_are_no_loss():
    contacts = draw_contacts(0.0, count=90)
    rng, mass = np.random.default_rng(3), {1: 0.0, 2: 0.03, 3: -0.02}
    balls = np.array([rng.permutation([1, 2, 3])[:2] for _ in range(90)])
    recoil = 0.02 + np.array([mass[one] - mass[two] for one, two in balls]) + rng.normal(0, 0.01, 90)
    found = fit_loss_beside_masses(replace(contacts, recoil=recoil), balls)
    np.testing.assert_allclose(found.coefficients, [0.02, 0.03, -0.02], atol=4e-3)
