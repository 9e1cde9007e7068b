"""Scatter from stretch to stretch: the sizes with which stretches were drawn are recovered."""

import dataclasses

import numpy as np
import pytest
from discrepancy_clips import STD, exact, noisy

from discrepancy.data.stretches import cut_stretches
from discrepancy.fitting.base_fit import CLAIMED_NOISE, fit_base_model
from discrepancy.fitting.stretch_scatter import fit_scatter
from synthcam.model import Model

COUNT = 6
WAY = 4e-3  # m, over which the displacements below change


def draw(scatter=0.0, warp=0.0, same=True):
    """Stretches of collisions, each with a friction and a rolling loss of its own, and displaced by a smooth map."""
    rng, clips = np.random.default_rng(5), []
    for k, clip in enumerate(exact(Model(), COUNT, 4)):
        friction = Model().sliding_friction * (1 + scatter * rng.standard_normal())
        own = exact(Model().replace({"sliding_friction": friction}), COUNT, 4)[k] if scatter else clip
        clips.append(dataclasses.replace(clip, xy=own.xy, slide_ends=own.slide_ends))
    waves, phases = rng.normal(size=(12, 2)) / WAY, rng.uniform(0, 2 * np.pi, (12, 2))
    cut = []
    for clip in cut_stretches(noisy(clips, 3)):
        if not same:
            phases = rng.uniform(0, 2 * np.pi, (12, 2))
        shift = np.cos((clip.xy @ waves.T)[..., None] + phases).sum(axis=1) / np.sqrt(6)
        cut.append(dataclasses.replace(clip, xy=clip.xy + warp * shift))
    return cut, fit_base_model(cut, Model(), CLAIMED_NOISE)


def test_none_where_nothing_differs():
    assert fit_scatter(*draw(), CLAIMED_NOISE).is_none


def test_the_scatter_of_friction_is_found():
    found = fit_scatter(*draw(scatter=0.05), CLAIMED_NOISE)
    assert found.friction == pytest.approx(0.05, rel=0.4)
    assert found.displacement_m < STD


@pytest.mark.parametrize("same", [True, False])
def test_a_smooth_displacement_is_found_and_whether_it_is_a_map(same):
    found = fit_scatter(*draw(warp=3 * STD, same=same), CLAIMED_NOISE)
    assert found.displacement_m == pytest.approx(3 * STD, rel=0.5)
    assert found.reach_m == pytest.approx(WAY, rel=0.5)
    assert found.map_log_ratio > 12 if same else found.map_log_ratio < -3
