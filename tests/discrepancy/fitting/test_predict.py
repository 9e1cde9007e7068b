"""Predicted tracks, against cases that are known without the model."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from discrepancy_clips import CAMERA, FPS, blank, exact

from discrepancy.data.launch import HEADING, T_C, V0, B
from discrepancy.data.stretches import cut_stretches
from discrepancy.fitting.predict import predict_tracks
from discrepancy.free_laws.library import free_laws_over
from synthcam.dataset.generate import GenerationPlan, generate_dataset
from synthcam.dynamics.batch import CollisionBatch
from synthcam.model import Model
from synthcam.scene.scene import read_scene
from tracker.camera.camera import Camera
from tracker.camera.warp import Warp


def pixels(clip, xy):
    return clip.camera.project(np.concatenate([xy, np.full((len(xy), 1), clip.camera.radius)], axis=1))


def test_a_tracker_that_takes_the_glint_for_the_centre_sees_the_glint():
    clip = exact(Model(), 1, 15)[0]
    glint = predict_tracks(Model().replace({"glint_parallax.share": 1.0}), clip.launch[None], [clip])[0]
    assert np.allclose(pixels(clip, glint), clip.camera.glint_of_centre(clip.xy), atol=1e-6)
    assert np.abs(pixels(clip, glint) - pixels(clip, clip.xy)).max() > 0.1


def test_of_a_lamp_that_nobody_told_of_it_sees_the_glint_too():
    clip = exact(Model(), 1, 15)[0]
    x, y, height = clip.camera.lamp.position
    lamp = Model().replace({"unknown_lamp.share": 1.0, "unknown_lamp.x": x, "unknown_lamp.y": y})
    lamp = lamp.replace({"unknown_lamp.height": height})
    dark = dataclasses.replace(clip, camera=dataclasses.replace(clip.camera, lamp=None))
    glint = predict_tracks(lamp, clip.launch[None], [dark])[0]
    assert np.allclose(pixels(clip, glint), clip.camera.glint_of_centre(clip.xy), atol=1e-6)
    assert np.allclose(predict_tracks(lamp, clip.launch[None], [clip])[0], clip.xy, rtol=0, atol=1e-12)


def test_a_lens_that_nobody_knows_moves_what_is_far_from_the_middle():
    clip = exact(Model(), 1, 15)[0]
    bent = predict_tracks(Model().replace({"lens_distortion.k1": 0.05}), clip.launch[None], [clip])[0]
    from_middle = np.hypot(*clip.xy.T)
    moved = np.hypot(*(bent - clip.xy).T)
    away = 0.5 - clip.camera.radius  # the camera's height over the balls' centres
    assert np.allclose(moved, 0.05 * from_middle**3 / away**2, rtol=0.02, atol=1e-12)


def test_without_sliding_friction_balls_slide_on_for_ever():
    clip = exact(Model(), 1, 15)[0]
    base = Model().replace({"sliding_friction": 0.0, "spin_transfer": 0.0})
    v0, heading, b = clip.launch[[V0, HEADING, B]]
    xy = predict_tracks(base, clip.launch[None], [clip])[0]
    late = (clip.ball == 0) & (clip.frame / FPS > clip.launch[T_C])
    steps = np.diff(xy[late], axis=0) * FPS
    n = np.sqrt(1 - b * b) * np.array([np.cos(heading), np.sin(heading)]) - b * np.array(
        [-np.sin(heading), np.cos(heading)]
    )
    expected = (1 + base.restitution) / 2 * v0 * np.sqrt(1 - b * b) * n
    assert np.allclose(steps, expected, atol=1e-5)


def test_an_exposure_without_length_is_an_instant():
    clip = exact(Model(), 1, 16)[0]
    times = [dataclasses.replace(clip, camera=dataclasses.replace(clip.camera, exposure=e)) for e in (0.0, 1e-7)]
    instant, short = (predict_tracks(Model(), clip.launch[None], [c])[0] for c in times)
    assert np.allclose(instant, short, atol=1e-7)


def test_a_ball_that_hops_is_seen_where_the_film_has_it(tmp_path):
    """Far from the middle of an oblique camera a ball nearer to it is seen some 0.05 px aside for a few frames."""
    launch = np.array([0.02, 0.015, 0.1, 0.5, 0.4, 0.2])
    scene = tmp_path / "scene.yaml"
    scene.write_text(
        "name: hop\neffects: {hop: {share: 0.5, bounce: 0.4}}\ncamera: {tilt: [0.2, 0.1]}\n"
        "launch: {kind: pair, v0: 0.5, b: 0.2, heading: 0.4, striker: b, contact: [0.02, 0.015]}\n"
        "timing: {fps: 250, frames: 60, exposure: 5.0e-4, contact_frame: 25}\n"
    )
    generate_dataset(GenerationPlan((read_scene(scene),), 1, 4, False), tmp_path / "set", 1, lambda done, of: None)
    folder = tmp_path / "set/clips/000000"
    true = pd.read_parquet(folder / "truth/tracks.parquet").sort_values(["particle", "frame"])
    camera, model = Camera.read(folder / "camera.json"), Model().replace({"hop.share": 0.5, "hop.bounce": 0.4})
    clip = dataclasses.replace(blank(0, launch, np.zeros(2), 60), camera=camera)
    (xy,) = predict_tracks(model, launch[None], [clip])
    assert np.abs(pixels(clip, xy) - true[["x_mean_px", "y_mean_px"]].to_numpy()).max() < 2e-3


def test_no_motion_is_an_error():
    clip = exact(Model(), 1, 16)[0]
    with pytest.raises(ValueError, match="rest"):
        predict_tracks(Model().replace({"plate_tilt.x": 0.05, "rolling_decel": 1e-6}), clip.launch[None], [clip])


def slower(clip, fps=110.0, exposure=2e-3):
    """The same collision as another frame rate sees it, without places."""
    camera = dataclasses.replace(clip.camera, fps=fps, exposure=exposure)
    count = int(len(clip.frame) // 2 * fps / FPS)
    other = blank(clip.clip, clip.launch, clip.slide_ends, count)
    return dataclasses.replace(other, camera=camera)


def test_clips_of_two_frame_rates_are_foretold_as_each_alone():
    plain = exact(Model(), 4, 12)
    clips = [slower(c) if k % 2 else c for k, c in enumerate(plain)]
    launches = np.array([c.launch for c in clips])
    every = predict_tracks(Model(), launches, clips)
    laws = [law for law in free_laws_over(Model(), launches, clips) if law.name in ("friction_speed", "force_place")]
    moves = {law.name: law.derivatives(Model(), launches, clips) for law in laws}
    assert len(moves) == 2
    for k, clip in enumerate(clips):
        assert every[k] == pytest.approx(predict_tracks(Model(), launches[k : k + 1], [clip])[0], abs=1e-12)
        for law in laws:
            (alone,) = law.derivatives(Model(), launches[k : k + 1], [clip])
            assert moves[law.name][k] == pytest.approx(alone, abs=1e-6 * np.abs(alone).max())
    wrong = predict_tracks(Model(), launches[1:2], [dataclasses.replace(clips[1], camera=plain[1].camera)])[0]
    assert np.abs(every[1] - wrong).max() > 1e-4


def test_a_correction_of_the_camera_file_does_not_move_what_another_effect_predicts():
    """Positions are those on the plate: a camera that needs a correction sees the same ones once they are corrected."""
    knots = np.linspace(-0.05, 0.05, 5)
    bend = 1e-4 * np.outer(np.ones(5), np.sin(40 * knots))
    warped = dataclasses.replace(CAMERA, warp=Warp(knots, knots, bend, 0.5 * bend.T))
    clip = exact(Model(), 1, 3)[0]
    for values in ({}, {"scale_error.e": 1e-12}):
        seen = [
            predict_tracks(Model().replace(values), clip.launch[None], [dataclasses.replace(clip, camera=c)])[0]
            for c in (CAMERA, warped)
        ]
        assert np.abs(seen[0] - seen[1]).max() < 1e-9


def test_stretches_of_a_long_film_are_predicted_in_their_own_frames_only(monkeypatch):
    """As each alone; a film of 2000 frames costs no more than the frames that are seen."""
    cut, late = cut_stretches(exact(Model(), 2, 3)), 2000
    last = cut[-1]
    launch = last.launch + np.eye(9)[T_C] * late / FPS
    clips = [*cut[:-1], dataclasses.replace(last, frame=last.frame + late, launch=launch)]
    launches, asked, average = np.array([c.launch for c in clips]), list[int](), CollisionBatch.average_centres

    def spy(batch, starts, exposure):
        asked.append(starts.shape[-1])
        return average(batch, starts, exposure)

    monkeypatch.setattr(CollisionBatch, "average_centres", spy)
    every = predict_tracks(Model(), launches, clips)
    assert asked == [max(len(c.frame) for c in clips)]
    for clip, xy in zip(clips, every, strict=True):
        assert xy == pytest.approx(predict_tracks(Model(), clip.launch[None], [clip])[0], abs=1e-12)
