"""Starts of free stretches: slides of any length are found, bodies on air never slide, and kinks are left out."""

import dataclasses

import numpy as np
import pytest
from discrepancy_clips import STD, exact, noisy

from discrepancy.data.launch import SLIP
from discrepancy.data.notes import SearchNoteKind
from discrepancy.data.stretches import cut_stretches
from discrepancy.fitting.base_fit import CLAIMED_NOISE
from discrepancy.fitting.gauss_newton import fit_model
from discrepancy.fitting.stretch_starts import choose_starts
from synthcam.model import Model


def spoil(clip, share):
    """A first guess whose slide is over at once, or has not been."""
    launch = clip.launch.copy()
    launch[SLIP] *= share
    return dataclasses.replace(clip, launch=launch)


@pytest.mark.parametrize("share", [0.05, 0.0])
def test_a_slide_is_found_from_a_guess_that_is_far_too_short(share):
    cut = [spoil(clip, share) for clip in cut_stretches(noisy(exact(Model(), 3, 2), 2))]
    chosen, left_out = choose_starts(cut, Model())
    assert not left_out
    fit = fit_model(chosen, Model(), (), CLAIMED_NOISE)
    assert max(r @ r / len(r) for r in fit.residuals) < 2


def test_without_friction_nothing_slides():
    chosen, _ = choose_starts(cut_stretches(noisy(exact(Model(), 4, 2), 2)), Model().replace({"sliding_friction": 0.0}))
    assert not any(clip.launch[SLIP].any() for clip in chosen)


def test_a_stretch_with_a_kink_is_left_out_with_a_note():
    cut = cut_stretches(noisy(exact(Model(), 2, 2), 2))
    late = np.arange(len(cut[2].frame)) > 15
    cut[2] = dataclasses.replace(cut[2], xy=cut[2].xy + late[:, None] * [200 * STD, 0.0])
    chosen, (note,) = choose_starts(cut, Model())
    assert len(chosen) == len(cut) - 1
    assert note.kind is SearchNoteKind.NO_FREE_MOTION
    assert note.clip == cut[2].clip


def test_stretches_that_contradict_the_friction_of_the_model_stay():
    wrong = Model().replace({"sliding_friction": 1.5 * Model().sliding_friction})
    _, left_out = choose_starts(cut_stretches(noisy(exact(Model(), 2, 2), 2)), wrong)
    assert not left_out
