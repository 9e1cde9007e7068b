"""Derivatives by parameters and spins that hardly move the tracks are zero."""

import numpy as np
import pytest
from discrepancy_clips import exact

from discrepancy.data.launch import SLIP, V0
from discrepancy.data.stretches import cut_stretches
from discrepancy.fitting.gauss_newton import solve_step
from discrepancy.fitting.jacobian import linearise, zero_unidentifiable_shapes
from discrepancy.fitting.model_fit import WhitenedClips
from discrepancy.fitting.parameters import list_candidates
from discrepancy.noise.model import Noise, NoiseComponent
from synthcam.model import Model


@pytest.mark.parametrize(("seen", "silent"), [(0.9, True), (1.1, False)])
def test_a_positive_shape_that_its_whole_range_hardly_shows_is_silent(seen, silent):
    """Its range is of factors: the derivative by its logarithm is its value times that by itself."""
    model = Model().replace({"stribeck.rise": 1e-3, "stribeck.slip": 0.07})
    stribeck = next(s for s in list_candidates(Model(), ()) if s.name == "stribeck")
    tried = [shapes["stribeck.slip"] for shapes in stribeck.grid(Model())]
    slope = seen / (0.07 * np.log(max(tried) / min(tried)))
    (left,) = zero_unidentifiable_shapes(
        model, ["stribeck.rise", "stribeck.slip"], (np.array([[1e-9, 0.6 * slope], [0, 0.8 * slope]]),)
    )
    assert left[0, 0] == 1e-9  # a strength has no range
    assert left[:, 1].any() != silent


@pytest.mark.parametrize("turn", [0.1, 1.5, 2.5])
def test_a_slide_that_outlasts_its_track_shows_the_direction_of_its_slip_alone(turn):
    """The derivative by the size of the slip is a rounding error, which made steps of 10^8 m/s."""
    tilted, noise = Model().replace({"plate_tilt.x": 1e-9}), Noise(NoiseComponent(1e4))  # without closed form
    struck = [clip for clip in cut_stretches(exact(Model(), 3, 2)) if clip.launch[SLIP].any()][1::2]
    launches = np.array([clip.launch for clip in struck])
    launches[:, SLIP] = 10 * launches[:, [V0]] * [np.cos(turn), np.sin(turn)]
    fit = linearise(WhitenedClips.of(struck, noise), tilted, (), launches)
    larger = int(np.abs([np.cos(turn), np.sin(turn)]).argmax())
    for slopes in fit.launch_slopes:
        assert slopes[:, SLIP].any(axis=0).tolist() == [larger == 1, larger == 0]
    _, steps = solve_step(fit, 0.0, np.zeros(0), np.zeros(0))
    assert np.abs(steps[:, SLIP]).max() < 10
