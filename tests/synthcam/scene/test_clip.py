"""A clip in memory equals that of a dataset of the same scene and seed, to the last bit."""

import json
import sys
from types import ModuleType

import numpy as np
import pandas as pd
import pytest
import tifffile

import synthcam
from synthcam.dataset.generate import GenerationPlan, generate_dataset
from synthcam.scene.clip import has_opengl_started
from synthcam.scene.scene import Scene
from synthcam_shared.errors import InputError

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
    assert generate_dataset(GenerationPlan((scene,), 2, 7), folder, 1, lambda done, of: None).failed == ()
    return folder


@pytest.mark.parametrize("number", [0, 1])
def test_film_and_camera_are_those_of_the_dataset(scene, dataset, number):
    clip, position = scene.draw(number, seed=7), dataset / f"clips/{number:06d}"
    stored = tifffile.imread(position / "frames.tif")
    film = clip.film()
    assert film.dtype == stored.dtype == np.uint8
    np.testing.assert_array_equal(film, stored)
    np.testing.assert_array_equal(next(clip.pictures()), stored[0])
    assert clip.camera_json == json.loads((position / "camera.json").read_text())


def test_seed_and_number_are_those_of_the_noise():
    """Clips in which only the sensor's noise is drawn."""
    launch, timing = {"v0": 0.3, "b": 0.2, "heading": 0.0}, {"frames": 2, "contact_frame": 1.0}
    scene = Scene.read("painter_behringer", launch=launch, timing=timing, camera=SMALL["camera"])
    plain, seed, number = (scene.draw(k, s) for k, s in ((0, 7), (0, 8), (1, 7)))
    assert plain.truth == seed.truth == number.truth
    film = plain.film()
    np.testing.assert_array_equal(film, scene.draw(0, 7).film())
    read, rounding, pattern = 1.0, 1 / 12, 0.2**2  # counts^2: 20 and 4 e- at 20 e- a count; the pattern is the seed's
    for other, noise in ((seed, read + rounding + pattern), (number, read + rounding)):
        apart = other.film().astype(float) - film
        assert apart.std() == pytest.approx(np.sqrt(2 * noise), rel=0.02)


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


def test_the_striker_comes_as_the_scene_says():
    """Its lowest point slips along and across the heading, and it spins: in truth, by the axes of the world."""
    launch = {"heading": np.pi / 2, "v0": 0.3, "slip_along": 0.1, "slip_across": -0.05, "side": 0.2}
    truth = Scene.read("oblique", launch=launch).draw(seed=1).truth
    assert [truth[k] for k in ("u2ix", "u2iy", "side2i")] == pytest.approx([0.05, 0.1, 0.2])
    with pytest.raises(InputError, match=r"launch.side: of a pair's striker; expected 0"):
        Scene.read("oblique", launch={"kind": "single", "side": 0.2}).draw(seed=1)


def test_opengl_that_another_library_loads_may_have_started(monkeypatch):
    for name in ("synthcam.camera.render", "OpenGL"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    assert not has_opengl_started()
    monkeypatch.setitem(sys.modules, "OpenGL", ModuleType("OpenGL"))
    assert has_opengl_started()
