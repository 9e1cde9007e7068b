"""The score test: N(0, 1) when nothing is hidden, as large as it should be when something is."""

import numpy as np
import pytest
from scipy.stats import chi2 as chi2_law
from scipy.stats import kstest, norm

from discrepancy.name import CLAIM, likeness, sigmas
from discrepancy_clips import EFFECTS, design, exact, noise_of_pair, searched
from synthcam.model import Model


def test_sigmas_are_those_of_a_normal_variable():
    assert sigmas(9.0, 1) == 3.0
    assert sigmas(0.0, 2) == 0.0
    for dof in (2, 5, 45):
        for z in (1.0, 4.0, 8.0):
            assert sigmas(chi2_law.isf(2 * norm.sf(z), dof), dof) == pytest.approx(z, rel=1e-6)


@pytest.mark.parametrize("dof", [2, 5, 45])
def test_sigmas_do_not_jump_where_probabilities_underflow(dof):
    chi2 = np.geomspace(500, 1e6, 400)
    z = np.array([sigmas(x, dof) for x in chi2])
    ratio = z / np.sqrt(chi2)  # tends to 1 from below: more freedom never makes a chi^2 less likely
    assert np.all(np.diff(ratio) > 0)
    assert ratio[-1] == pytest.approx(1, abs=1e-3)
    assert ratio.max() <= 1
    fine = [sigmas(x, dof) for x in np.linspace(1150, 1450, 600)]  # 1e-300 lies here
    assert np.abs(np.diff(fine, 2)).max() < 1e-3


@pytest.mark.parametrize("effect", EFFECTS)
@pytest.mark.parametrize("rho", [0.0, 0.5])
def test_with_nothing_hidden_the_score_is_a_standard_normal(effect, rho):
    z = design().nulls(60, rho, effect)
    assert kstest(z, "norm").pvalue > 1e-3
    assert np.abs(z).max() < CLAIM
    low, high = chi2_law.ppf([1e-3, 1 - 1e-3], len(z))
    assert low < z @ z < 1.2 * high  # the noise itself is estimated too


def test_noise_that_remembers_raises_no_false_alarm_but_would_without_whitening():
    z = design(16).nulls(20, 0.9)  # so slow a noise is hard to read off: its scale is known to 20 %
    assert np.mean(np.abs(z) > CLAIM) <= 0.05
    assert z @ z < 1.5 * chi2_law.ppf(1 - 1e-3, len(z))
    wolf = np.abs(design().nulls(20, 0.9, whitened=False))
    assert np.mean(wolf > CLAIM) > 0.2


@pytest.mark.parametrize("effect", EFFECTS)
@pytest.mark.parametrize("expected", [2.0, 5.0, 20.0])
def test_a_hidden_effect_scores_what_its_strength_is_worth(effect, expected):
    clean = design()
    rng = np.random.default_rng(3)
    errors = [noise_of_pair(rng, 0.0) for _ in clean.clips]
    signature = np.linalg.norm(clean.scores(errors)[effect][0])
    name = {"velocity_restitution": "velocity_restitution.e", "rolling_quadratic": "rolling_quadratic.K"}[effect]
    bent = exact(Model().replace({name: expected / signature}), 8, 5)
    moved = [e + b.xy - c.xy for e, b, c in zip(errors, bent, clean.clips, strict=True)]
    gained = clean.z(moved, effect) - clean.z(errors, effect)
    assert gained == pytest.approx(expected, rel=0.05)
    assert clean.z(moved, effect) == pytest.approx(expected, abs=3.5)


def test_likeness_is_a_cosine():
    rng = np.random.default_rng(4)
    one, other = np.linalg.qr(rng.standard_normal((50, 2)))[0].T
    assert likeness(one[:, None], 3 * one[:, None]) == pytest.approx(1)
    assert likeness(one[:, None], other[:, None]) == pytest.approx(0, abs=1e-12)
    assert likeness(one[:, None], (0.6 * one + 0.8 * other)[:, None]) == pytest.approx(0.6)


def test_signatures_of_the_library_can_be_told_apart():
    ranking = {c.effect: c.signature for c in searched("nothing").search.ranking}
    assert likeness(ranking["velocity_restitution"], ranking["rolling_quadratic"]) < 0.9
