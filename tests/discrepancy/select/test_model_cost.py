"""The cost of a model's freedom, in closed form."""

import numpy as np
import pytest
from discrepancy_clips import collisions

from discrepancy.fitting.gauss_newton import fit_model
from discrepancy.fitting.jacobian import linearise
from discrepancy.fitting.model_fit import WhitenedClips
from discrepancy.fitting.parameters import BASE_PARAMETERS, find_parameter
from discrepancy.noise.model import Noise, NoiseComponent
from discrepancy.select.model_cost import compute_cost
from synthcam.library import library
from synthcam.model import Model

NOISE = Noise(NoiseComponent(1.0))


def test_a_strength_is_paid_for_and_a_shape_by_how_well_it_is_known():
    truth = Model().replace({"stribeck.rise": 0.1, "stribeck.slip": 0.1})
    clips = collisions(truth, 6, 7)
    base = fit_model(clips, Model(), BASE_PARAMETERS, NOISE)
    fit = fit_model(clips, truth, (*BASE_PARAMETERS, "stribeck.rise", "stribeck.slip"), NOISE)
    alone = fit_model(clips, fit.model, (*BASE_PARAMETERS, "stribeck.rise"), NOISE)  # where the shape is known
    z, known = (f.model.value(n) / f.std[n] for f, n in ((alone, "stribeck.rise"), (fit, "stribeck.slip")))
    shape = 2 * np.log(np.log(25) * known / np.sqrt(2 * np.pi))  # of a range 1 : 25
    wanted = 2 * np.log(len(library())) + 1 + np.log(z**2) + shape
    assert compute_cost(fit, base) - fit.chi2 == pytest.approx(wanted, abs=0.05)
    assert compute_cost(base, base) == base.chi2


def test_what_no_data_tell_apart_is_paid_for_once():
    """If all contacts slip, a share and a friction between the balls act as their product."""
    truth = Model().replace({"ball_friction.share": 0.1, "ball_friction.mu": 0.03})
    clips = collisions(truth, 6, 7)
    base = fit_model(clips, Model(), BASE_PARAMETERS, NOISE)
    held, free = (
        (*BASE_PARAMETERS, "ball_friction.share"),
        (*BASE_PARAMETERS, "ball_friction.share", "ball_friction.mu"),
    )
    one = fit_model(clips, truth, held, NOISE)
    both = linearise(WhitenedClips.of(clips, NOISE), one.model, free, one.launches)
    assert both.std["ball_friction.share"] > 5 * one.std["ball_friction.share"]
    span = np.ptp(find_parameter(truth, "ball_friction.mu").tries)
    hardly = np.log1p(span**2 / (2 * np.pi * both.std["ball_friction.mu"] ** 2))
    assert hardly < 0.2
    assert compute_cost(both, base) - compute_cost(one, base) == pytest.approx(hardly, abs=0.05)
