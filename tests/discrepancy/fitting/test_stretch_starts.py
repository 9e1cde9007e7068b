"""Starts of free stretches: slides of any length are found, bodies on air never slide, and kinks are left out."""

import dataclasses

import numpy as np
import pytest
from discrepancy_clips import STD, exact, noisy

from discrepancy.data.launch import SLIP
from discrepancy.data.notes import SearchNoteKind
from discrepancy.data.stretches import cut_stretches
from discrepancy.fitting import gauss_newton, stretch_starts
from discrepancy.fitting.base_fit import CLAIMED_NOISE, fit_base_model
from discrepancy.fitting.gauss_newton import fit_model
from discrepancy.fitting.model_fit import WhitenedClips
from discrepancy.fitting.stretch_starts import choose_starts, fit_launches, leave_local_minima
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


def chi2_of_worst(fit):
    return max(float(r @ r) / len(r) for r in fit.residuals)


def stretches_with_wrong_starts():
    """Nine stretches; three of the six that slide have starts that roll."""
    cut = cut_stretches(noisy(exact(Model(), 3, 2), 2))
    return [spoil(clip, 0.0) if k % 3 == 1 else clip for k, clip in enumerate(cut)]


def test_a_fit_of_launches_leaves_the_minimum_of_balls_that_roll_from_the_start():
    cut = stretches_with_wrong_starts()
    assert chi2_of_worst(fit_model(cut, Model(), (), CLAIMED_NOISE)) > 100
    assert chi2_of_worst(fit_launches(cut, Model(), CLAIMED_NOISE)) < 2


@pytest.mark.gate
def test_a_fit_of_launches_soon_ends_where_the_model_is_hopeless(monkeypatch):
    """A friction four times too large: half of the steps lead as far, to 2000 chi^2 per point."""
    wrong, cut = Model().replace({"sliding_friction": 0.8}), cut_stretches(noisy(exact(Model(), 4, 2), 2))
    cut, _ = choose_starts(cut, Model())
    relinearise, steps = gauss_newton._relinearise, {0.0: 0, stretch_starts.LEAST_SHARE: 0}
    chi2 = []
    for share in steps:

        def count(*given, share=share):
            steps[share] += 1
            return relinearise(*given)

        monkeypatch.setattr(gauss_newton, "_relinearise", count)
        monkeypatch.setattr(stretch_starts, "LEAST_SHARE", share)
        chi2.append(fit_launches(cut, wrong, CLAIMED_NOISE).chi2)
    to_the_end, soon = steps.values()
    assert soon < 0.7 * to_the_end
    assert chi2[1] == pytest.approx(chi2[0], rel=0.01)


def test_a_base_fit_leaves_the_minimum_of_balls_that_roll_from_the_start():
    wrong = Model().replace({"sliding_friction": 0.8 * Model().sliding_friction})
    cut = stretches_with_wrong_starts()
    assert chi2_of_worst(fit_base_model(cut, wrong, CLAIMED_NOISE, first_starts=True)) > 100
    base = fit_base_model(cut, wrong, CLAIMED_NOISE)
    assert chi2_of_worst(base) < 2
    assert base.model.sliding_friction == pytest.approx(Model().sliding_friction, rel=0.01)


def move(clip):
    """The clip with errors that no start explains."""
    return dataclasses.replace(clip, xy=clip.xy + 20 * STD * np.sin(clip.frame)[:, None])


GLIDING = Model().replace({"sliding_friction": 0.0})


@pytest.mark.parametrize(
    ("kind", "model", "moved", "tries_again"),
    [
        ("stretches", Model(), 1, True),
        ("whole collisions", Model(), 1, False),
        ("stretches", GLIDING, 1, False),
        ("stretches", Model(), 9, False),  # all are poor
    ],
)
def test_only_stretches_that_may_slide_and_stand_out_are_fitted_again(monkeypatch, kind, model, moved, tries_again):
    """Whole collisions and bodies that glide have no several minima; if all are poor, starts are not at fault."""
    clips = noisy(exact(model, 3, 2), 2)
    if kind == "stretches":
        clips = choose_starts(cut_stretches(clips), model)[0]
    clips = [move(clip) if k < moved else clip for k, clip in enumerate(clips)]
    whitened, fit, tried = WhitenedClips.of(clips, CLAIMED_NOISE), fit_model(clips, model, (), CLAIMED_NOISE), []
    assert chi2_of_worst(fit) > 4
    monkeypatch.setattr(stretch_starts, "minimise_chi2", lambda some, start, **_: tried.append(some) or start)
    leave_local_minima(whitened, fit)
    assert {len(some.clips) for some in tried} == ({1} if tries_again else set())


def test_without_friction_nothing_slides():
    chosen, _ = choose_starts(cut_stretches(noisy(exact(Model(), 4, 2), 2)), Model().replace({"sliding_friction": 0.0}))
    assert not any(clip.launch[SLIP].any() for clip in chosen)


@pytest.mark.gate
def test_one_note_lists_the_stretches_of_a_clip_that_have_a_kink():
    cut = cut_stretches(noisy(exact(Model(), 3, 2), 2))
    for k in (1, 2, 7):
        late = np.arange(len(cut[k].frame)) > 15
        cut[k] = dataclasses.replace(cut[k], xy=cut[k].xy + late[:, None] * [200 * STD, 0.0])
    chosen, notes = choose_starts(cut, Model())
    assert len(chosen) == len(cut) - 3
    assert {note.kind for note in notes} == {SearchNoteKind.NO_FREE_MOTION}
    assert [note.clip for note in notes] == [cut[1].clip, cut[7].clip]
    assert notes[0].frames == tuple(sorted(int(cut[k].frame[0]) for k in (1, 2)))
    assert "in 2 of 3 stretches" in str(notes[0])
    assert "in 1 of 3 stretches" in str(notes[1])


def test_stretches_that_contradict_the_friction_of_the_model_stay():
    wrong = Model().replace({"sliding_friction": 1.5 * Model().sliding_friction})
    _, left_out = choose_starts(cut_stretches(noisy(exact(Model(), 2, 2), 2)), wrong)
    assert not left_out
