"""The map of the disagreement, before any effect is named."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from discrepancy_clips import collisions, exact, unabsorbed
from scipy.stats import chi2 as chi2_law
from scipy.stats import kstest

from discrepancy.data.launch import HEADING
from discrepancy.fitting.gauss_newton import fit_model
from discrepancy.fitting.parameters import BASE_PARAMETERS
from discrepancy.noise.model import Noise, NoiseComponent
from discrepancy.validate.residual_map import PHASE_TESTS, ClipSolution, find_disagreements, find_disagreements_by_phase
from discrepancy.wording import describe_disagreement
from synthcam.model import Model

CLAIMED = Noise(NoiseComponent(1.0))


@cache
def seen(name, value, held="", count=16):
    """Tests of a base fit when `name` has a value that the model does not know; `held`: a parameter not fitted."""
    clips = collisions(Model().replace({"plate_waviness.wavelength": 0.04} | {name: value}), count, 4)
    names = tuple(n for n in BASE_PARAMETERS if n != held)
    return find_disagreements(clips, fit_model(clips, Model(), names, CLAIMED), CLAIMED)


def most(places, **wanted):
    """The largest sigma among the tests that have these attributes."""
    return max(p.sigma for p in places if all(getattr(p, k) == v for k, v in wanted.items()))


@pytest.mark.gate
def test_noise_alone_draws_uniform_chances():
    clips = exact(Model(), 6, 5)
    fit = fit_model(clips, Model(), BASE_PARAMETERS, CLAIMED, np.array([c.launch for c in clips]))
    rng, chances = np.random.default_rng(1), {}
    for _ in range(25):
        drawn = tuple(rng.standard_normal(len(r)) for r in fit.residuals)
        left = np.split(unabsorbed(fit, np.concatenate(drawn)), np.cumsum([len(r) for r in drawn])[:-1])
        for look, (against, chi2, dof, _) in find_disagreements_by_phase(
            clips, dataclasses.replace(fit, residuals=tuple(left)), CLAIMED
        ):
            chances.setdefault((look, against), []).append(chi2_law.sf(chi2, dof))
    assert {look for look, _ in chances} == {(p, b, a) for p in PHASE_TESTS for b in range(2) for a in range(2)}
    worst = min(kstest(each, "uniform").pvalue for each in chances.values())
    assert worst > 1e-3 / len(chances)


def test_a_wrong_restitution_shows_at_the_contact_and_nowhere_else():
    places = seen("restitution", 0.9, "restitution")
    assert places[0].phase == "contact"
    assert places[0].sigma > 20
    assert max(most(places, phase=p) for p in ("before", "sliding", "rolling")) < 4


def test_a_wrong_friction_shows_in_sliding_and_nowhere_else():
    places = seen("sliding_friction", 0.234, "sliding_friction")
    assert (places[0].phase, places[0].observable) == ("sliding", "along")
    assert places[0].sigma > 20
    assert max(most(places, phase=p) for p in ("before", "contact", "rolling")) < 4


def test_a_loss_with_the_square_of_the_speed_shows_in_rolling():
    places = seen("rolling_quadratic.K", 0.2)
    assert (places[0].phase, places[0].observable) == ("rolling", "along")
    assert most(places, phase="rolling") > 2 * most(places, phase="contact") > 0
    assert most(places, phase="sliding") < 4


@pytest.mark.parametrize(
    ("effect", "value", "phase", "against"),
    [
        ("velocity_restitution.e", 0.02, "contact", "speed"),
        ("friction_anisotropy.c", 0.01, "sliding", "heading"),
        ("plate_waviness.a", 2e-6, "rolling", "position"),
    ],
)
def test_what_a_disagreement_changes_with_is_told(effect, value, phase, against):
    changing = [p for p in seen(effect, value, count=30) if p.against]
    assert (changing[0].phase, changing[0].against) == (phase, against)
    assert changing[0].sigma > 6


def test_a_bent_roll_has_the_size_of_its_bend():
    clips, sizes = [], []
    for k, c in enumerate(exact(Model(), 12, 4)):
        late = np.maximum(c.frame / c.fps - c.slide_ends[c.ball], 0) * (c.ball == 0)
        bend = (-1) ** k * 1e-3 * late**2
        way = np.array([-np.sin(c.launch[HEADING]), np.cos(c.launch[HEADING])])
        rows = late > 0
        line = np.polyval(np.polyfit(late[rows], bend[rows], 1), late[rows])
        sizes.append((bend[rows] - line) ** 2)
        clips.append(dataclasses.replace(c, xy=c.xy + bend[:, None] * way))
    places = [
        p
        for p in find_disagreements(clips, fit_model(clips, Model(), BASE_PARAMETERS, CLAIMED), CLAIMED)
        if not p.against
    ]
    assert (places[0].phase, places[0].ball, places[0].observable) == ("rolling", "ball 1", "across")
    assert places[0].size == pytest.approx(1e6 * np.sqrt(np.mean(np.concatenate(sizes))), rel=0.15)


def test_noise_has_no_size():
    nothing = [p for p in seen("restitution", Model().restitution) if not p.against]
    assert 3 <= sum(p.size == 0 for p in nothing) <= 13  # half of them, but for chance: noise alone is subtracted


def test_looks_are_corrected_and_in_order():
    places = seen("velocity_restitution.e", 0.05, count=30)
    assert [p.sigma for p in places] == sorted((p.sigma for p in places), reverse=True)
    for p in places:
        assert p.phase in (*PHASE_TESTS, "once a turn", "twice a turn")
        assert (p.ball in ("ball 1", "ball 2"), p.observable in ("along", "across")) == (True, True)
        assert p.against in ("", "speed", "impact parameter", "heading", "position")
        assert p.size >= 0
    assert "ball 1 at the contact, along its motion, changing with the speed" in {
        describe_disagreement(p, Model()) for p in places
    }


def test_too_few_clips_are_held_against_nothing():
    assert {p.against for p in seen("rolling_quadratic.K", 0.2, count=5)} == {""}


@pytest.mark.parametrize(("count", "trends"), [(5, False), (6, True)])
def test_six_clips_are_held_against_speed_and_place(count, trends):
    clips = collisions(Model(), count, 5)
    found = find_disagreements_by_phase(clips, fit_model(clips, Model(), BASE_PARAMETERS, CLAIMED), CLAIMED)
    assert any(against for _, (against, *_) in found) is trends


@pytest.mark.parametrize("apart", [0.1, 2e-5])
def test_pulls_have_unit_variance_however_similar_the_terms_are(apart):
    """The pulls of unit residuals are rows of a projection, whose product with themselves is the unit matrix."""
    rng = np.random.default_rng(1)
    launch, terms = rng.standard_normal((40, 4)), rng.standard_normal((40, 5))
    terms[:, 3], terms[:, 4] = terms[:, 2] + apart * terms[:, 3], terms[:, 3] + apart * terms[:, 4]
    solved = [ClipSolution.of(launch, terms, unit, np.zeros((40, 0))) for unit in np.eye(40)]
    assert solved[0].kept.all()
    rows, nothing = [1, 2, 3, 4], np.zeros((0, 2))
    pulls = np.array([one.amplitudes(rows, rows, np.eye(4), nothing, {}).pulls for one in solved])
    assert pulls.T @ pulls == pytest.approx(np.eye(4), abs=1e-3)
