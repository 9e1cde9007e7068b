"""What a clip gives in memory is what a dataset of the same scene and seed holds, to the last bit."""

import json

import numpy as np
import pandas as pd
import pytest
import tifffile

import synthcam
from synthcam.dataset.generate import Plan, run
from synthcam.scene.scene import Scene

SMALL = {
    "camera": {"size": [160, 120], "scale": 3e-4},
    "timing": {"frames": 30, "contact_frame": {"uniform": [12, 14]}},
}


@pytest.fixture(scope="module")
def scene():
    return Scene.read("oblique", **SMALL)


@pytest.fixture(scope="module")
def dataset(scene, tmp_path_factory):
    folder = tmp_path_factory.mktemp("clip") / "data"
    assert run(Plan((scene,), 2, 7), folder, 1, lambda done, of: None).failed == ()
    return folder


@pytest.mark.parametrize("number", [0, 1])
def test_film_and_camera_are_those_of_the_dataset(scene, dataset, number):
    clip, place = scene.draw(number, seed=7), dataset / f"clips/{number:06d}"
    stored = tifffile.imread(place / "frames.tif")
    film = clip.film()
    assert film.dtype == stored.dtype == np.uint8
    np.testing.assert_array_equal(film, stored)
    np.testing.assert_array_equal(next(clip.pictures()), stored[0])
    assert clip.camera_json == json.loads((place / "camera.json").read_text())


def test_another_seed_is_another_film(scene):
    one, other = (next(scene.draw(0, seed).pictures()) for seed in (7, 8))
    assert (one != other).any()


def test_truth_is_that_of_the_dataset(scene, dataset):
    clip = scene.draw(1, seed=7)
    row = pd.read_parquet(dataset / "truth/clips.parquet").loc[1]
    for name, value in clip.truth.items():
        assert value == row[name] or (np.isnan(value) and np.isnan(row[name])), name
    pd.testing.assert_frame_equal(clip.tracks, pd.read_parquet(dataset / "clips/000001/truth/tracks.parquet"))
    events = pd.read_parquet(dataset / "clips/000001/truth/events.parquet")
    pd.testing.assert_frame_equal(clip.solve().events, events)


def test_sixteen_bits(scene):
    clip = Scene.read("oblique", **SMALL, sensor={"bits": 12, "full_well": 6000.0, "gain": 1.5}).draw()
    film = clip.film()
    assert (film.shape, film.dtype) == ((30, 120, 160), np.uint16)


def test_its_repr_says_what_was_drawn(scene):
    clip = scene.draw(1, seed=7)
    assert repr(clip).startswith(f"Clip 1 of oblique: 2 balls, v0 {clip.truth['v0']:.3g} m/s, b {clip.truth['b']:.3g};")
    assert repr(clip).endswith("30 frames of 160 x 120 px at 250 a second")
    assert repr(synthcam.Scene.read("single_roller").draw()).startswith("Clip 0 of single-roller: 1 ball, v0")
