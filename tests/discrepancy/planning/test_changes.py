"""The changes that are tried: what they change, and that they are possible."""

import dataclasses

import numpy as np
import pytest
from discrepancy_plans import scene, small

from discrepancy.data.launch import V0
from discrepancy.planning.changes import CHANGES, TOGETHER, apply_change
from discrepancy.planning.experiment import design_experiment

CHANGE = {c.name: c for c in (*CHANGES, TOGETHER)}


def made(name, experiment=None):
    found = apply_change(CHANGE[name], experiment or small())
    return found and found[1]


@pytest.mark.parametrize("name", CHANGE)
def test_every_change_is_one_that_a_camera_and_a_plate_can_make(name):
    changed = made(name)
    assert 0 < changed.camera.exposure <= 1 / changed.camera.fps
    assert 5 / 7 * changed.model.gravity * np.sin(changed.model.value("plate_tilt.x")) < changed.model.rolling_decel
    for clip in changed.clips:
        seen = clip.camera.project(np.column_stack([clip.xy, np.full(len(clip.xy), clip.camera.radius)]))
        assert np.all((seen > 0) & (seen < np.array(clip.camera.size)))


def test_twice_the_frame_rate_sees_the_same_motion_twice_as_often():
    before, after = small(), made("frame_rate")
    assert after.camera.fps == 2 * before.camera.fps
    one, other = before.clips[0], after.clips[0]
    shared = other.frame % 2 == 0
    assert abs(shared.sum() - len(one.frame)) <= 1
    assert np.abs(other.xy[shared][:20] - one.xy[:20]).max() < 1e-9


def test_a_frame_rate_that_would_cut_exposures_cuts_the_light_too():
    whole = design_experiment(scene(timing={"frames": 60, "contact_frame": 20.0, "exposure": 0.004}), 8).experiment
    after = made("frame_rate", whole)
    assert after.camera.exposure == 1 / after.camera.fps
    assert after.errors.peak == pytest.approx(whole.errors.peak / 2)
    assert apply_change(CHANGE["exposure_longer"], whole) is None


def test_what_light_does_to_stated_errors_is_not_guessed():
    stated = small(0.02)
    assert apply_change(CHANGE["exposure_longer"], stated) is None
    assert apply_change(CHANGE["exposure_shorter"], stated) is None
    assert made("frame_rate", stated).error_px == pytest.approx(0.02)


def test_a_wider_field_makes_errors_in_metres_larger():
    one, two = (e.error_px * e.camera.scale for e in (small(0.02), made("field_wider", small(0.02))))
    assert two == pytest.approx(2 * one)


def test_a_plate_without_rolling_loss_cannot_be_tilted():
    flat = dataclasses.replace(small(), model=small().model.replace({"rolling_decel": 0.0}))
    assert apply_change(CHANGE["tilted"], flat) is None


def test_speeds_change_as_the_words_say():
    words, changed = apply_change(CHANGE["faster"], small())
    assert words == "balls twice as fast"
    before = dict(zip((c.clip for c in small().clips), small().launches[:, V0], strict=True))
    speeds = [before[c.clip] for c in changed.clips]
    assert changed.launches[:, V0] == pytest.approx(2 * np.array(speeds))


def test_strikers_that_spin_keep_their_share_of_it():
    spinning = design_experiment(scene(launch={"slip_along": 0.05, "side": 0.1}), 8).experiment
    assert spinning.launches.shape[1] == 9
    assert len(made("speeds", spinning).clips) >= 4
    faster = made("faster", spinning)
    assert faster.launches[:, 6:] == pytest.approx(np.tile([0.1, 0.0, 0.2], (len(faster.clips), 1)))
