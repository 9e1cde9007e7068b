"""find and measure from tables in memory: the same collisions as from files, and each clip under its number."""

import json

import numpy as np
import pandas as pd
import pytest
from tracker_noisy import without_local

import synthcam
import tracker
from discrepancy.data.launch import V0
from discrepancy.data.reading import read_collisions
from synthcam_shared.errors import InputError

NUMBERS = (2, 5, 9)
pytestmark = pytest.mark.usefixtures("not_local")


@pytest.fixture(scope="module")
def made():
    """A table of three clips, and their camera."""
    scene = synthcam.Scene.read("painter_behringer")
    clips = [scene.draw(number, seed=1) for number in NUMBERS]
    parts = [
        c.tracks.query("visible")[["frame", "particle"]].assign(
            clip=c.number, x=c.tracks["x_mean_px"], y=c.tracks["y_mean_px"]
        )
        for c in clips
    ]
    return pd.concat(parts, ignore_index=True), clips[0].camera_json, [c.truth["r"] for c in clips]


@pytest.fixture(scope="module")
def from_file(made, tmp_path_factory):
    """The collisions of the same table in a file, and the path of their camera."""
    table, camera, _ = made
    folder = tmp_path_factory.mktemp("file")
    (folder / "camera.json").write_text(json.dumps(camera))
    table.to_csv(folder / "tracks.csv", index=False)
    with without_local():
        return read_collisions(folder / "tracks.csv", folder / "camera.json")[0], folder / "camera.json"


def test_measure_all_keeps_the_numbers_of_clips(made):
    table, camera, true = made
    found = tracker.measure_all(table.sample(frac=1, random_state=0), camera)
    estimates = pd.concat([result.estimates for result in found], ignore_index=True)
    assert estimates["clip"].tolist() == list(NUMBERS)
    assert estimates["r"].to_numpy() == pytest.approx(true, abs=1e-3)


def test_measure_names_the_function_for_several(made):
    table, camera, _ = made
    with pytest.raises(InputError, match=r"3 clips \(2, 5, 9\), expected 1; tracker\.measure_all\(tracks, camera\)"):
        tracker.measure(table, camera)


@pytest.mark.parametrize("kind", ["keys", "camera", "path", "results", "one result"])
def test_collisions_of_a_table_in_memory(kind, made, from_file):
    table, camera, _ = made
    of_file, path = from_file
    given = {
        "keys": (table, camera),
        "camera": (table, tracker.Camera.from_dict(camera)),
        "path": (table, path),
        "results": (tracker.measure_all(table, camera), None),
        "one result": (tracker.measure(table[table["clip"] == NUMBERS[0]], camera), None),
    }[kind]
    found, _ = read_collisions(*given)
    expected = of_file[:1] if kind == "one result" else of_file
    assert [c.launch[V0] for c in found] == pytest.approx([c.launch[V0] for c in expected], rel=1e-3)


def test_a_table_without_a_camera_is_refused(made):
    with pytest.raises(InputError, match="camera: expected a camera, its keys or a path, beside a table of tracks"):
        read_collisions(made[0])


def test_a_table_of_many_particles_is_refused_at_once():
    """Repair and fits of so many take minutes, and a search uses two balls of a clip."""
    rows = {"frame": np.tile([0, 1], 2500), "particle": np.repeat(np.arange(2500), 2), "clip": 0}
    table = pd.DataFrame(rows).assign(x=lambda t: 40.0 * (t.particle % 50), y=lambda t: 40.0 * (t.particle // 50))
    camera = {"size": [2000, 2000], "fps": 250.0, "scale": 1e-3, "ball_diameter": 0.015}
    with pytest.raises(InputError, match=r"clip 0: 2500 particles, expected at most 2000; .* two balls of a collision"):
        read_collisions(table, camera)


def test_names_of_balls_say_who_strikes_as_a_column_does():
    """Ball a strikes in even clips; numbers alone leave it open, with a note."""
    parts = []
    for k in range(4):
        clip = synthcam.Scene.read("painter_behringer", launch={"striker": "ab"[k % 2]}).draw(k, seed=2)
        body = (1 + clip.tracks["particle"] + k) % 2  # ball a is body 0; particle 1 of the truth is the striker
        rows = pd.DataFrame({"clip": k, "frame": clip.tracks["frame"], "particle": body, "striker": "ab"[k % 2]})
        parts.append(rows.assign(x=clip.tracks["x_mean_px"], y=clip.tracks["y_mean_px"])[clip.tracks["visible"]])
    table = pd.concat(parts, ignore_index=True)
    camera = {key: value for key, value in clip.camera_json.items() if key != "striker"}
    named = table.drop(columns="striker").assign(particle=table["particle"].map({0: "a", 1: "b"}))
    (by_column, notes), (by_name, others) = (read_collisions(given, camera) for given in (table, named))
    assert notes == others == []
    assert [c.striker for c in by_column] == ["a", "b", "a", "b"]
    for one, other in zip(by_column, by_name, strict=True):  # so that a search, which sees these alone, is the same
        assert one.striker == other.striker
        for name in ("frame", "ball", "xy", "covariance", "launch"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    found, (note,) = read_collisions(table.drop(columns="striker"), camera)
    assert [c.striker for c in found] == ["b"] * 4
    assert "particle 0 strikes in 2 clips and particle 1 in 2" in str(note)
