"""Strikers that spin about the vertical where the model has them roll: found, with the spin of each."""

import dataclasses

import numpy as np
import pytest
from discrepancy_clips import exact, noisy, only

from discrepancy.data.launch import SIDE
from discrepancy.fitting.predict import predict_tracks
from discrepancy.free_laws.library import free_laws_over
from discrepancy.search import search
from synthcam.model import LAUNCH_SPIN, Model

COUNT, SIZE = 16, 2e-3  # m/s: a four-hundredth of the speed
SPINS = SIZE * np.random.default_rng(3).normal(size=COUNT)


def clips(spins, seed=5):
    every = noisy(exact(Model(), COUNT, seed, spins=np.stack([0 * spins, 0 * spins, spins], axis=1)), seed)
    return [dataclasses.replace(c, launch=c.launch[:6]) for c in every]


@pytest.mark.gate
def test_it_is_found_and_its_model_leaves_nothing(monkeypatch):
    only(monkeypatch, free_laws=("side_spin_clip", "spin_transfer_clip", "restitution_clip"))
    hidden = clips(SPINS)
    found = search(hidden, Model())
    assert (found.verdict, found.free_law.law.name) == ("outside_library", "side_spin_clip")
    assert found.model_holds_law
    assert found.model.free == (LAUNCH_SPIN,)
    assert "model.yaml leaves launch.spin free" in found.sentence()
    fitted = [c.clip for c in found.data.clips]
    off = np.ravel(found.law_summary.curve) - SPINS[fitted]
    within = np.asarray(found.document()["outside"][0]["band"]).reshape(len(fitted), 2)
    assert np.std(off) < 0.1 * SIZE
    assert np.mean((SPINS[fitted] > within[:, 0]) & (SPINS[fitted] < within[:, 1])) > 0.7
    assert found.gap.after < 1.2 < 1.5 < found.gap.before
    again = search(hidden, found.model)
    assert again.verdict == "none"
    spun = np.array(again.base_fit.launches)[:, SIDE]
    assert np.std(spun - SPINS[[c.clip for c in again.data.clips]]) < 0.1 * SIZE


@pytest.mark.gate
def test_rolling_strikers_with_free_spins_leave_nothing(monkeypatch):
    only(monkeypatch, free_laws=("side_spin_clip", "spin_transfer_clip"))
    assert search(clips(0 * SPINS), Model()).verdict == "none"
    found = search(clips(0 * SPINS), dataclasses.replace(Model(), free=(LAUNCH_SPIN,)))
    assert found.verdict == "none"
    assert np.abs(np.array(found.base_fit.launches)[:, SIDE]).max() < SIZE


def test_derivatives_are_those_of_a_launch_that_spins():
    plain = exact(Model(), 4, 11)
    launches = np.array([c.launch for c in plain])
    (law,) = (s for s in free_laws_over(Model(), launches, plain) if s.name == "side_spin_clip")
    spins = np.array([1e-3, -2e-3, 3e-3, 1e-3])
    told = [m @ spins for m in law.derivatives(Model(), launches, plain)]
    true = predict_tracks(Model(), np.column_stack([launches, np.zeros((4, 2)), spins]), plain)
    for move, there, clip in zip(told, true, plain, strict=True):
        assert move == pytest.approx(there - clip.xy, abs=0.02 * np.abs(there - clip.xy).max())


def test_launches_that_have_a_spin_leave_no_such_law():
    plain = exact(Model(), 4, 11, spins=[[0.0, 0.0, 0.01]])
    launches = np.array([c.launch for c in plain])
    assert "side_spin_clip" not in [s.name for s in free_laws_over(Model(), launches, plain)]
