"""A fit as a value: what it says of itself."""

import dataclasses

import numpy as np
import pytest
from discrepancy_clips import exact

from discrepancy.fitting.jacobian import linearise
from discrepancy.fitting.model_fit import WhitenedClips
from discrepancy.fitting.parameters import BASE_PARAMETERS
from discrepancy.noise.model import Noise, NoiseComponent
from synthcam.model import Model

CLIPS = exact(Model(), 2, 3)
EVIDENCE = WhitenedClips.of(CLIPS, Noise(NoiseComponent(1.0)))
FIT = linearise(EVIDENCE, Model(), BASE_PARAMETERS, np.array([c.launch for c in CLIPS]))
COLUMNS = [np.ones((len(r), 1)) for r in FIT.residuals]


def test_derivatives_are_of_the_place_where_they_were_taken():
    """Another launch, model or parameter makes them those of somewhere near."""
    assert FIT.is_linearised_here
    assert not dataclasses.replace(FIT, launches=FIT.launches + 1e-9).is_linearised_here
    assert not dataclasses.replace(FIT, model=Model().replace({"restitution": 0.8})).is_linearised_here
    assert not FIT.extend(Model(), ["velocity_restitution.e"], COLUMNS).is_linearised_here


def test_parameters_are_found_by_name():
    assert FIT.columns_of(["spin_transfer", "restitution"]) == [
        BASE_PARAMETERS.index("spin_transfer"),
        BASE_PARAMETERS.index("restitution"),
    ]
    assert FIT.values(["restitution"]) == pytest.approx([Model().restitution])
    less, more = FIT.step_bounds()
    where = BASE_PARAMETERS.index("restitution")
    assert (less[where], more[where]) == pytest.approx((-Model().restitution, 1 - Model().restitution))


def test_what_is_fitted_beside_the_base_is_given_by_effect():
    every = FIT.extend(Model(), ["plate_tilt.x", "gravity", "plate_tilt.y"], [np.ones((len(c), 3)) for c in COLUMNS])
    assert every.added_names(FIT) == {"plate_tilt": ["plate_tilt.x", "plate_tilt.y"], "gravity": ["gravity"]}
    assert every.drop(Model(), ["gravity", "plate_tilt.x", "plate_tilt.y"]).names == FIT.names


def test_no_step_takes_all_sliding_friction_away():
    """From 0 no later step would bring it back, since no launch could slide."""
    less, _ = FIT.step_bounds()
    assert less[BASE_PARAMETERS.index("sliding_friction")] == pytest.approx(-Model().sliding_friction / 2)
