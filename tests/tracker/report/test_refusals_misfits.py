"""The picture of a clip whose collisions are all misfits: where the residuals are large, and what helps."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pandas as pd
import pytest
from tracker_noisy import noisy

import synthcam
from tracker import pipeline
from tracker.camera.camera import Camera
from tracker.camera.film_in_memory import wrap_frames
from tracker.recording import Result, measure_tracks
from tracker.report.collision_figures import CollisionView, view_collision
from tracker.report.refusals import MISFITS, draw_misfit, is_misfit_clip


@pytest.fixture(scope="module")
def clip():
    return synthcam.Scene.read("painter_behringer", timing={"frames": 60, "contact_frame": 20}).draw(seed=1)


@pytest.fixture(scope="module")
def found(clip):
    """A collision whose fit is right; the tests call it a misfit, which would take seconds to fit."""
    result = measure_tracks(noisy(clip.tracks, np.random.default_rng(0), 0.02), Camera.of(clip), 0, "centre")
    assert not is_misfit_clip(result.rows)
    return replace(result, rows=(result.rows[0] | {"status": "misfit"},))


@pytest.mark.parametrize(
    ("bend", "where"),
    [
        (lambda k: 1e-3 * k.clip(0) ** 2, "after the contact"),
        (lambda k: 3e-3 * k.clip(None, 0) ** 2, "before the contact"),
        (lambda k: 1.0 * (np.abs(k) < 2), "at the contact"),
    ],
)
def test_the_note_says_where_residuals_are_largest(clip, found, bend, where):
    tracks, camera = found.found, found.camera
    bent = replace(tracks, y=tracks.y + bend(tracks.frame - clip.truth["t_c"] * camera.fps))
    assert is_misfit_clip(found.rows)
    for frames in (None, wrap_frames(np.full((60, *camera.size[::-1]), 9, np.uint8))):
        drawn = draw_misfit(bent, camera, found.rows, 0, frames)
        assert f"largest {where}" in str(drawn.note)
        assert ("--frames A:B" in str(drawn.note), "shows frame 20" in str(drawn.note)) == (frames is not None,) * 2
        picture = cv2.imdecode(np.frombuffer(drawn.png, np.uint8), cv2.IMREAD_COLOR)
        for blue_green_red in ((60, 160, 255), (255, 190, 90)):
            assert (np.abs(picture.astype(int) - blue_green_red).sum(axis=2) < 30).sum() > 200


def test_a_contact_that_lasts_shows_no_residuals(found):
    """Its row does not have by how much the paths after it are shifted."""
    row = found.rows[0] | {"contact_first": 19, "contact_last": 21}
    assert not CollisionView.of(pd.Series(row), found.found, found.camera).is_instantaneous
    assert "shows no residuals" in str(draw_misfit(found.found, found.camera, [row], 0).note)


@pytest.mark.parametrize(("name", "value"), [("b", -1.002), ("mu_k", -0.1)])
def test_a_mean_of_fits_that_is_no_value_of_the_model_shows_no_residuals(found, name, value):
    assert view_collision(found.rows[0], found.found, found.camera)
    assert view_collision(found.rows[0] | {name: value}, found.found, found.camera) is None


def test_measure_writes_one_for_each_clip_and_one_note(clip, found, tmp_path, monkeypatch):
    tracks = found.found
    one = pd.DataFrame({"frame": tracks.frame, "particle": tracks.particle, "x": tracks.x, "y": tracks.y})
    pd.concat([one.assign(clip=k) for k in range(2)]).to_csv(tmp_path / "bent.csv", index=False)
    (tmp_path / "camera.json").write_text(json.dumps(clip.camera_json))
    monkeypatch.setattr(
        pipeline, "measure_tracks", lambda t, c, number, *_: Result(number, c, t, found.rows, found.motion)
    )
    outcome = pipeline.measure_tables(tmp_path / "bent.csv", tmp_path / "out", tmp_path / "camera.json")
    assert [count for note, count in outcome.notes.items() if "beside the tracks of a misfit" in str(note)] == [2]
    assert len(list((tmp_path / "out").glob(f"clips/*/{MISFITS}"))) == 2


@pytest.mark.parametrize(("states", "known"), [
    (["misfit"], True), (["misfit", "no frames"], True), (["ok", "misfit"], False), (["no_collision"], False),
])  # fmt: skip
def test_a_clip_with_a_good_collision_is_none(states, known):
    assert is_misfit_clip([{"status": state} for state in states]) == known
