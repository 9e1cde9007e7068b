"""The first guess of a launch: its spin, and what the balls do after a hit tells where tracks begin at it."""

import dataclasses
import json

import numpy as np
import pandas as pd
import pytest
from discrepancy_clips import only
from discrepancy_files import NOISE, SCENE
from repository import ROOT

from discrepancy.data.first_guess import guess_hit_from_outgoing, guess_spin
from discrepancy.data.reading import read_collisions
from discrepancy.policy import current_policy
from discrepancy.search import search
from synthcam.dataset.generate import GenerationPlan, generate_dataset
from synthcam.library import library
from synthcam.model import Model
from synthcam.scene.scene import read_scene
from tracker.tables.read import read_tracks

CLIPS = 16
HIDDEN = {"plate_tilt.x": 8e-4}


@pytest.fixture(scope="module")
def filmed(tmp_path_factory):
    """True tracks with noise on a tilted plate, 250 frames a second, and the truth about each hit."""
    folder = tmp_path_factory.mktemp("late")
    scene = read_scene(ROOT / SCENE, ["effects={plate_tilt: {x: 8.0e-4}}", "launch.v0={uniform: [0.3, 0.6]}"])
    generate_dataset(GenerationPlan((scene,), CLIPS, 3, False), folder / "data", 1, lambda done, of: None)
    rng, parts = np.random.default_rng(2), []
    for clip in sorted((folder / "data/clips").iterdir()):
        true = pd.read_parquet(clip / "truth/tracks.parquet").query("visible")
        off = NOISE * rng.standard_normal((2, len(true)))
        place = {"x": true["x_mean_px"] + off[0], "y": true["y_mean_px"] + off[1]}
        parts.append(true.assign(clip=int(clip.name), x_std=NOISE, y_std=NOISE, cov_xy=0.0, **place))
    camera = json.loads((folder / "data/clips/000000/camera.json").read_text())
    (folder / "camera.json").write_text(json.dumps(camera))
    columns = ["clip", "frame", "particle", "x", "y", "x_std", "y_std", "cov_xy"]
    return folder, pd.concat(parts)[columns], pd.read_parquet(folder / "data/truth/clips.parquet"), camera["fps"]


def cut(filmed, late):
    """A table of the tracks from `late` frames after the hit on, and its camera."""
    folder, rows, truth, fps = filmed
    contact = fps * truth.set_index("clip")["t_c"].reindex(rows["clip"]).to_numpy()
    rows[rows["frame"] >= contact + late].to_csv(folder / "t.csv", index=False)
    return folder / "t.csv", folder / "camera.json"


@pytest.mark.parametrize(("late", "speed"), [(-0.9, 0.05), (0.0, 0.05), (1.0, 0.1)])
def test_what_the_balls_do_after_the_hit_tells_the_launch(filmed, late, speed):
    """The speed within so much of itself: slow balls roll already within the frames that are looked at."""
    truth, (table, camera) = filmed[2], cut(filmed, late)
    given = read_tracks(table, camera)
    found = [guess_hit_from_outgoing(given.clips[k][0], given.camera) for k in range(CLIPS)]
    assert all(hit.names == (0, 1) for hit in found)
    table = np.array([[hit.t_c, hit.v0, hit.b, *(hit.slide_ends - hit.t_c)] for hit in found])
    off = table - truth[["t_c", "v0", "b", "tau1", "tau2"]].to_numpy()
    assert np.abs(off[:, 0]).max() < 0.25 / filmed[3]
    assert np.abs(off[:, 1] / truth["v0"]).max() < speed
    assert np.abs(off[:, 2]).max() < 0.05
    assert np.abs(np.median(off[:, 3:], axis=0)).max() < 2 / filmed[3]


@pytest.mark.gate
def test_a_search_names_what_tracks_from_the_hit_on_hide(filmed, monkeypatch):
    few = {name: library()[name] for name in ("plate_tilt", "camera_tilt", "rolling_quadratic")}
    only(monkeypatch, ("force_place",), **few)
    clips, left_out = read_collisions(*cut(filmed, 0.0))
    assert (len(clips), left_out) == (CLIPS, [])
    assert all((clip.phases() != 0).all() for clip in clips)
    (named,) = search(clips[:8], Model()).named
    off = (named.values["plate_tilt.x"] - HIDDEN["plate_tilt.x"]) / named.std["plate_tilt.x"]
    assert named.effect == "plate_tilt"
    assert abs(off) < 4


def test_balls_that_part_without_a_hit_have_none(filmed):
    table, camera = cut(filmed, 0.0)
    given = read_tracks(table, camera)
    tracks = given.clips[0][0]
    far = dataclasses.replace(tracks, x=tracks.x + (tracks.particle == 1) * 9 * given.camera.diameter_px)
    assert guess_hit_from_outgoing(tracks, given.camera) is not None
    assert guess_hit_from_outgoing(far, given.camera) is None
    assert guess_hit_from_outgoing(tracks, given.camera, since=1.0) is None


def test_frames_that_are_missing_after_the_hit_are_few(filmed):
    given = read_tracks(*cut(filmed, 2.0 * current_policy().max_unseen_frames_after_hit))
    fast = [k for k in range(CLIPS) if filmed[2]["v0"][k] > 0.4]
    assert len(fast) > 3
    assert all(guess_hit_from_outgoing(given.clips[k][0], given.camera) is None for k in fast)


def test_a_spin_is_that_of_the_estimates_along_the_heading():
    row = {"status": "ok", "u2ix": 0.3, "u2iy": 0.1, "side2i": -0.2}
    assert guess_spin(row, np.pi / 2, 0.5, np.zeros(2)) == pytest.approx([0.1, -0.3, -0.2])
    assert not guess_spin({"status": "ok"}, 0.3, 0.5, np.array([5.0, 0.0])).any()


def test_of_a_misfit_only_a_ball_that_slows_down_slides():
    row = {"status": "misfit", "u2ix": 0.3, "u2iy": 0.1, "side2i": -0.2}
    assert not guess_spin(row, 0.0, 0.5, np.array([-0.1, 0.0])).any()
    assert guess_spin(row, 0.0, 0.5, np.array([-2.0, 0.0])) == pytest.approx([0.3, 0.1, -0.2])
    unseen = guess_spin({"status": "misfit"}, 0.0, 0.5, np.array([-2.0, 0.0]))
    assert unseen[0] > 0  # friction is against the slip
    assert unseen[1] == 0


@pytest.mark.parametrize(("chi2", "believed"), [(602.0, True), (700.0, False)])
def test_a_spin_is_believed_where_only_the_errors_are_claimed_too_small(chi2, believed):
    """The tied fit agrees with the free one, both at 1.6 a degree of freedom; or it does not."""
    row = {"status": "misfit", "u2ix": 0.0, "u2iy": 0.0, "side2i": -0.2, "chi2": chi2, "dof": 376}
    said = guess_spin(row | {"chi2_free": 592.0, "dof_free": 370}, 0.0, 0.5, np.array([-0.1, 0.0]))
    assert said.tolist() == [0.0, 0.0, -0.2 if believed else 0.0]
