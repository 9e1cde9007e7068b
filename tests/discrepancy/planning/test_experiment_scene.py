"""The experiment of a scene, against the truth that synthcam gives of the same clips."""

import numpy as np
import pytest
from discrepancy_plans import scene, small

from discrepancy.planning.experiment import design_experiment
from synthcam_shared.errors import InputError


def test_places_and_rows_are_those_of_the_clips_of_that_seed():
    given = scene("painter_behringer", timing={"frames": 90, "contact_frame": 20.0})
    found = design_experiment(given, 8, seed=3).experiment
    assert len(found.clips) == 6
    for clip in found.clips:
        truth = given.draw(clip.clip, 3).tracks
        rows = truth.set_index(["particle", "frame"]).loc[list(zip(clip.ball, clip.frame, strict=True))]
        pixels = rows[["x_mean_px", "y_mean_px"]].to_numpy()
        assert np.abs(clip.camera.unproject(pixels)[0] - clip.xy).max() < 1e-9
        assert abs(len(clip.frame) - truth["visible"].sum()) <= 2  # places are means over exposures there


def test_errors_are_those_that_the_readme_gives_for_this_camera():
    """Measured from film: .0087 px, 1.005 times the bound."""
    assert small().error_px == pytest.approx(0.0088, rel=0.02)


def test_a_stated_error_is_taken():
    assert small(0.05).error_px == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (scene("single_roller"), "launch.kind: expected pair, found single"),
        (scene("benchmark"), "model or effects differ from clip to clip"),
        (scene(camera={"scale": {"uniform": [1e-4, 2e-4]}}), "the camera's K differs from clip to clip"),
        (scene(timing={"frames": 60, "contact_frame": 80.0}), "before and after the contact in 0 of 8 clips"),
        (scene(surface={"ball": "matte"}), "give them .--noise PX."),
    ],
)
def test_what_is_no_experiment_is_said(given, message):
    with pytest.raises(InputError, match=message):
        design_experiment(given, 8)


@pytest.mark.parametrize(("count", "noise"), [(0, None), (5, None), (8, 0.0), (8, float("nan"))])
def test_numbers_that_make_no_plan_are_refused(count, noise):
    with pytest.raises(InputError, match="expected"):
        design_experiment(scene(), count, noise)
