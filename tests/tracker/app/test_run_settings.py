"""Settings of the page: the camera file and the command line that they make."""

from pathlib import Path

import numpy as np
import pytest
import tifffile
import typer
from tracker_film import CAMERA

import tracker.cli
from synthcam_shared.errors import InputError
from synthcam_shared.settings import build_settings
from tracker.app.film_view import FilmView
from tracker.app.run_settings import RunSettings, join_words, make_plan, name_as_argument
from tracker.camera.camera import Camera
from tracker.camera.recordings import open_source

SIZE = (200, 160)
GIVEN = {**CAMERA, "scale_std": 1e-7, "assumed": ["exposure", "K"]}


@pytest.fixture(scope="module")
def view(tmp_path_factory):
    path = tmp_path_factory.mktemp("film") / "film.tif"
    tifffile.imwrite(path, np.zeros((12, 160, 200), np.uint8), imagej=True)
    return FilmView(open_source(path), 0)


def test_nothing_set_changes_nothing(view):
    assert RunSettings().camera_keys(None, SIZE) is None
    assert RunSettings().camera_keys(GIVEN, SIZE) == GIVEN
    assert not make_plan(RunSettings(), view, GIVEN).needs_file


def test_another_scale_leaves_out_the_geometry_of_the_file():
    keys = RunSettings(scale=2e-4, exposure=1e-3).camera_keys(GIVEN, SIZE)
    assert not {"K", "R", "t", "dist", "scale_std"} & set(keys)
    assert (keys["scale"], keys["exposure"], keys["assumed"]) == (2e-4, 1e-3, ["K"])
    assert keys["lamp"] == GIVEN["lamp"]
    assert Camera.of(keys).scale == 2e-4
    kept = RunSettings(fps=500.0, exposure=1e-3).camera_keys(GIVEN, SIZE)
    assert (kept["K"], kept["fps"]) == (GIVEN["K"], 500.0)


def test_the_command_line_says_what_is_set(view):
    given = {"scale": 1.6e-4, "fps": 250, "balls": ["10,20@3", "30,40,7.5@5"], "region": "0,0,150,90", "frames": "2:9"}
    plan = make_plan(build_settings(given, RunSettings, "settings"), view, None)
    assert plan.needs_file
    assert plan.recording.frames.shape[0] == 7
    words = plan.write_command("a film.mp4", "out/camera.json", "out/results")
    assert join_words(words).startswith("tracker track 'a film.mp4' -o out/results --camera out/camera.json --ball")
    command = typer.main.get_command(tracker.cli.app).commands["track"]
    read = command.make_context("track", words[2:]).params
    assert f"{read['source']} {read['output']} {read['camera']}" == "a film.mp4 out/results out/camera.json"
    assert list(read["ball"]) == given["balls"]
    assert (read["region"], read["frames"], read["channel"]) == ("0,0,150,90", "2:9", None)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"scale": 1.6e-4}, "set the frames a second, too; or clear scale, to track in pixels"),
        ({"fps": 250.0}, r"set a scale .* too; or clear frames a second, to track in pixels"),
        ({"ball_diameter": 2e-3}, "a scale (.*) and the frames a second"),
        ({"scale": -1.0, "fps": 250.0}, "camera.json: scale: expected"),
        ({"scale": 1.6e-4, "fps": 250.0, "ball_diameter": 2.38}, "did you mean 0.00238"),
        ({"scale": "1"}, "settings: scale"),
        ({"scal": 1.0}, "settings: .*scal"),
        ({"fps": float("inf")}, "settings: fps"),
        ({"balls": ["here"]}, "--ball 'here'"),
        ({"balls": ["10,20@99"]}, "--ball 10,20@99: expected a place in 200x160 px and a frame from 0 to 11"),
        ({"balls": ["1,1@1"] * 101}, "settings: balls"),
        ({"region": "9,9,3,3"}, "--region"),
        ({"frames": "5:6"}, "--frames: 1 frames"),
        ({"channel": "red"}, "the film is in grey"),
        ([], "settings"),
    ],
)
def test_wrong_settings_are_refused_in_one_line(view, given, message):
    with pytest.raises(InputError, match=message) as error:
        make_plan(build_settings(given, RunSettings, "settings"), view, None)
    assert "\n" not in f"{error.value}"


def test_a_name_that_no_terminal_shows_is_refused():
    with pytest.raises(InputError, match="rename the file"):
        join_words(["tracker", "track", "a\x1b[2Jb"])


@pytest.mark.parametrize(("film", "word"), [("-film.gif", "./-film.gif"), ("film.gif", "film.gif")])
def test_a_film_is_no_option(film, word):
    assert name_as_argument(Path(film)) == word
