"""Where the disagreement lies, before any effect is named."""

import dataclasses

import numpy as np
import pytest

from discrepancy.fit import Whitener
from discrepancy.locate import AXES, BALLS, PHASES, locate
from discrepancy_clips import searched


def test_noise_alone_points_nowhere():
    for rho in (0.0, 0.5, 0.9):
        assert searched("nothing", rho).where[0].sigma < 4


@pytest.mark.parametrize("phase", range(3))
@pytest.mark.parametrize("ball", range(2))
def test_a_disturbed_phase_is_found(phase, ball):
    found = searched("nothing")
    base, residuals = found.search.base, []
    for clip, left in zip(found.clips, base.residuals, strict=True):
        push = np.zeros_like(clip.xy)
        push[(clip.phase() == phase) & (clip.ball == ball)] = 5e-6
        residuals.append(left + Whitener.of(clip, found.noise)(push))
    places = locate(found.clips, dataclasses.replace(base, residuals=tuple(residuals)), found.noise)
    assert {(p.phase, p.ball) for p in places[:2]} == {(PHASES[phase], BALLS[ball])}
    assert places[1].sigma > 6
    assert [p.sigma for p in places] == sorted((p.sigma for p in places), reverse=True)


def test_every_look_has_a_name_of_the_contract():
    for p in searched("velocity_restitution").where:
        assert (p.phase in PHASES, p.ball in BALLS, p.observable in AXES) == (True, True, True)
    assert searched("velocity_restitution").where[0].sigma > 5
    assert searched("velocity_restitution").left[0].sigma < 4
