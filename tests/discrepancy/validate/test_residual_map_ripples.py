"""Residuals that go with a ball's turns."""

import dataclasses

import numpy as np
import pytest
from discrepancy_clips import CAMERA, collisions, exact, unabsorbed
from scipy.stats import chi2 as chi2_law
from scipy.stats import kstest

from discrepancy.fitting.gauss_newton import fit_model
from discrepancy.fitting.parameters import BASE_PARAMETERS
from discrepancy.noise.model import Noise, NoiseComponent
from discrepancy.validate.residual_map import (
    ClipAmplitudes,
    combine_clips,
    find_disagreements,
    find_ripples,
)
from synthcam.model import Model

CLAIMED = Noise(NoiseComponent(1.0))
SIZE = 1.5e-6  # m


def marked(times, ball=0, axis=0, count=16):
    """Clips in which a mark on a ball is followed: off the centre by SIZE, so many times a turn, rolling or not."""
    out = []
    for k, (noisy, c) in enumerate(zip(collisions(Model(), count, 5), exact(Model(), count, 5), strict=True)):
        off = np.zeros_like(c.xy)
        rows = np.flatnonzero(c.ball == ball)
        step = np.diff(c.xy[rows], axis=0, prepend=c.xy[rows[:1]])
        way = np.cumsum(np.hypot(*step.T))
        along = step / np.maximum(np.hypot(*step.T), 1e-12)[:, None]
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        phase = times * way / (CAMERA.ball_diameter / 2) + 2.4 * k
        off[rows] = SIZE * np.cos(phase)[:, None] * (along, across)[axis]
        out.append(dataclasses.replace(noisy, xy=noisy.xy + off))
    return out


@pytest.mark.parametrize(("times", "ball", "axis"), [(1, 1, 0), (2, 0, 1)])
def test_a_mark_that_turns_with_a_ball_is_told(times, ball, axis):
    clips = marked(times, ball, axis)
    worst = find_disagreements(clips, fit_model(clips, Model(), BASE_PARAMETERS, CLAIMED), CLAIMED)[0]
    said = ("once a turn", "twice a turn")[times - 1]
    assert (worst.phase, worst.ball, worst.observable) == (said, f"ball {ball + 1}", ("along", "across")[axis])
    assert worst.sigma > 10
    assert worst.size == pytest.approx(1e6 * SIZE / np.sqrt(2), rel=0.2)


@pytest.mark.gate
def test_noise_alone_draws_uniform_chances():
    clips = exact(Model(), 6, 5)
    fit = fit_model(clips, Model(), BASE_PARAMETERS, CLAIMED, np.array([c.launch for c in clips]))
    rng, chances = np.random.default_rng(2), {}
    for _ in range(25):
        drawn = tuple(rng.standard_normal(len(r)) for r in fit.residuals)
        left = np.split(unabsorbed(fit, np.concatenate(drawn)), np.cumsum([len(r) for r in drawn])[:-1])
        for where, (_, chi2, dof, _) in find_ripples(clips, dataclasses.replace(fit, residuals=tuple(left)), CLAIMED):
            chances.setdefault(where, []).append(chi2_law.sf(chi2, dof))
    assert len(chances) == 8
    assert min(kstest(each, "uniform").pvalue for each in chances.values()) > 1e-3 / len(chances)


def test_a_ripple_that_shared_parameters_can_make_tells_nothing(monkeypatch):
    """Real pucks, of which few turn once in view, ended a search with a traceback."""
    absorbed = ClipAmplitudes(np.ones(2), np.eye(2), np.eye(2), np.zeros((2, 2)), np.zeros(2), np.eye(2), 4, 1.0, {})
    assert list(combine_clips([absorbed])) == []
    clips = marked(1, count=6)
    monkeypatch.setattr("discrepancy.validate.residual_map.combine_clips", lambda parts: combine_clips([absorbed]))
    assert list(find_ripples(clips, fit_model(clips, Model(), BASE_PARAMETERS, CLAIMED), CLAIMED)) == []
