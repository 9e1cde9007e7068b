"""The base fit, with which a search begins, converges from a friction nine hundred times too large."""

import dataclasses

import numpy as np
import pytest
from discrepancy_clips import collisions, exact

from discrepancy.fitting.base_fit import check_clips, fit_base_model
from discrepancy.noise.model import estimate_noise
from discrepancy.time_left import showing_stages
from synthcam.model import Model
from synthcam_shared.errors import InputError


def slower(clip, factor):
    """The same tracks as if filmed at so many times fewer frames a second."""
    camera = dataclasses.replace(clip.camera, fps=clip.fps / factor, exposure=clip.exposure * factor)
    launch = clip.launch * np.array([1, 1, factor, 1 / factor, 1, 1])
    return dataclasses.replace(clip, camera=camera, launch=launch, slide_ends=clip.slide_ends * factor)


def test_a_clock_thirty_times_slower_is_friction_nine_hundred_times_less():
    """Lengths alone do not tell time: all laws of the base model but gravity scale, and fit as well as before."""
    clips = collisions(Model(), 8, 4, frames=250)
    noise, stages = estimate_noise(clips), []
    with showing_stages(stages.append):
        one, other = (fit_base_model(c, Model(), noise) for c in (clips, [slower(c, 30) for c in clips]))
    assert one.chi2 == pytest.approx(other.chi2, abs=0.01)
    by = {"restitution": 1, "sliding_friction": 900, "spin_transfer": 1, "rolling_drag": 30, "rolling_decel": 900}
    for name, factor in by.items():
        assert other.model.value(name) * factor == pytest.approx(one.model.value(name), abs=0.02 * one.std[name])
    assert set(stages) == {"fit"}


def test_friction_may_be_free_from_zero():
    """A model without any friction that asks for it to be fitted, and whose first fit is none."""
    clips = collisions(Model(), 8, 4)
    model = Model(sliding_friction=0.0, free=("sliding_friction",))
    base = fit_base_model(clips, model, estimate_noise(clips), poor=0.0)
    assert base.model.value("sliding_friction") == pytest.approx(0.232, abs=3.5 * base.std["sliding_friction"])


@pytest.mark.parametrize("off", [7e-4, -7e-4, 1.4e-3, -1.4e-3])
def test_balls_that_differ_by_a_thousandth_are_two(off):
    clips = exact(Model(), 6, 4)
    camera = dataclasses.replace(clips[0].camera, ball_diameter=2 * Model().ball.radius * (1 + off))
    clips = [dataclasses.replace(c, camera=camera) for c in clips]
    if abs(off) < 1e-3:
        check_clips(clips, Model())
    else:
        with pytest.raises(InputError, match=r"the ball of camera\.json is"):
            check_clips(clips, Model())


def test_six_collisions_are_enough_and_five_are_not():
    clips = exact(Model(), 6, 4)
    check_clips(clips, Model())
    with pytest.raises(InputError, match="5 measured collisions: expected 6 or more"):
        check_clips(clips[:5], Model())
