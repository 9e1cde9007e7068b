"""Films of balls that are faster than the linker expects, and specks that no speed explains."""

from dataclasses import replace

import numpy as np
import pytest
from tracker_film import CAMERA

import synthcam
from tracker.camera.camera import Camera
from tracker.camera.film_in_memory import wrap_frames
from tracker.camera.recordings import Recording
from tracker.detection.detect import detect, make_view
from tracker.detection.fast_balls import allow_fast_balls, may_be_fast, raise_speed_limit, set_link_settings
from tracker.detection.glints import Glints
from tracker.detection.likelihood.patches import GlintGeometry
from tracker.detection.link import find_reach, link_into_tracks
from tracker.recording import measure_clip, track_clip
from tracker.settings import LinkSettings, TrackerSettings

METRIC = Camera.from_dict({**CAMERA, "size": [640, 480]})
BARE = Camera.unknown((640, 480), 8)


def follow_lines(step, specks=0, frames=12):
    """Glints of two balls on straight lines, px a frame, with slight noise, and specks at random."""
    rng = np.random.default_rng(4)
    parts = []
    for frame in range(frames):
        balls = np.array([[20.0 + step * frame, 100.0], [600.0 - 0.7 * step * frame, 300.0]])
        at = np.concatenate([balls[balls[:, 0] < 639], rng.uniform(0, [640, 480], (specks, 2))])
        at += 0.02 * rng.standard_normal(at.shape)
        found = Glints.at(at[:, 0], at[:, 1], 0.02, 1000.0)
        found.frame[:] = frame
        parts.append(found)
    return Glints.join(parts)


@pytest.mark.parametrize("camera", [METRIC, BARE])
@pytest.mark.parametrize(("step", "specks"), [(90.0, 0), (120.0, 0), (90.0, 3)])
def test_the_limit_rises_above_the_fastest_ball_of_a_film(camera, step, specks):
    settings = LinkSettings()
    raised = raise_speed_limit(follow_lines(step, specks, 5), camera, settings)
    assert step < find_reach(camera, raised) < 2 * step
    assert find_reach(camera, settings) < step / 2


@pytest.mark.parametrize(("step", "specks"), [(12.0, 0), (12.0, 6), (0.0, 12)])
def test_slow_balls_and_specks_raise_no_limit(step, specks):
    settings = LinkSettings()
    assert raise_speed_limit(follow_lines(step, specks), METRIC, settings) is settings


def test_the_frames_with_fast_balls_decide_in_a_film_of_many_slow_ones():
    """Two are fast in ten of seventy frames; of 3,500 detections 1,500 are linked."""
    fast = follow_lines(70.0, frames=10)
    fast.frame[:] += 50
    frame, x, y = np.meshgrid(np.arange(70), np.arange(40, 640, 60), np.arange(20, 480, 100), indexing="ij")
    slow = Glints.at(x.ravel() + 0.2 * frame.ravel(), y.ravel() + 15.0, 0.02, 1000.0)
    slow.frame[:] = frame.ravel()
    settings = LinkSettings()
    assert find_reach(BARE, raise_speed_limit(slow, BARE, settings)) == find_reach(BARE, settings)
    assert 70 < find_reach(BARE, raise_speed_limit(Glints.join([slow, fast]), BARE, settings)) < 140


def test_a_limit_that_the_user_gave_holds():
    glints = follow_lines(90.0, frames=5)
    for settings, fast in ((LinkSettings(), True), (LinkSettings(max_speed_m_s=1.0), False)):
        assert may_be_fast(glints, link_into_tracks(glints, METRIC, settings=settings), settings) is fast


def test_glints_are_cut_out_large_enough_for_fast_balls():
    rng = np.random.default_rng(1)
    clip = Recording(0, METRIC, wrap_frames(rng.normal(9.0, 1.0, (9, 480, 640)).clip(0, 255).astype(np.uint8)))
    view = make_view(clip)
    fast = set_link_settings(view, allow_fast_balls(view.camera, view.settings.link))
    smear_px = 8.0 * METRIC.exposure / METRIC.scale  # of a ball at 8 m/s
    assert GlintGeometry(view).reach < GlintGeometry(view).half + smear_px / 2 < GlintGeometry(fast).reach


def draw_collision(v0):
    scene = synthcam.Scene.read(
        "painter_behringer",
        launch={"v0": v0, "heading": 0.0, "contact": [0.0, 0.0]},
        timing={"frames": 24, "contact_frame": 10},
        camera={"size": [640, 240]},
    )
    clip = scene.draw(0, seed=5)
    return Recording(0, Camera.from_dict(clip.camera_json), wrap_frames(np.array(list(clip.pictures()))))


@pytest.mark.parametrize("v0", [1.6, 2.4])
def test_a_collision_at_several_metres_a_second_is_measured(v0):
    film = draw_collision(v0)
    tracked = track_clip(film)
    assert any("faster than 1 m/s" in str(note) for note in tracked.notes)
    (row,), _ = measure_clip(tracked.tracks, tracked.camera)
    assert row["status"] == "ok"
    assert abs(row["v0"] - v0) < 4 * row["v0_std"] < 0.002 * v0
    slow = track_clip(film, settings=TrackerSettings(link=LinkSettings(max_speed_m_s=1.0)))
    rows, _ = measure_clip(slow.tracks, slow.camera)
    assert rows[0]["status"] != "ok"


def test_an_exposure_that_slow_links_have_shown_does_not_stay(monkeypatch):
    def mistake(clip, view, name):
        assert view.camera.exposure_from_blur is None
        found = detect(clip, view, name)
        if view.settings.link.max_speed_m_s is None:
            view = replace(view, camera=replace(view.camera, exposure_from_blur=3e-3))
        return found, view

    monkeypatch.setattr("tracker.recording.detect_until_blur_converges", mistake)
    tracked = track_clip(draw_collision(1.6))
    assert any("faster than 1 m/s" in str(note) for note in tracked.notes)
    assert tracked.camera.exposure_from_blur is None
