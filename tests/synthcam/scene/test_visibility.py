"""A scene whose balls the film hardly shows is named, with the cause; a scene that shows them is not."""

import re

import numpy as np
import pytest

import synthcam
from synthcam import cli
from synthcam.scene.visibility import describe_unseen_balls
from synthcam.settings import SCENES
from synthcam_shared.errors import InputError


@pytest.mark.parametrize(
    ("sections", "said"),
    [
        ({"launch": {"v0": 30.0}}, "ball 1 is in the picture in 0 of 100 frames"),
        ({"launch": {"v0": 30.0}}, "launch.v0 30 m/s is 0.12 m a frame, in a picture of 0.102 m: lower launch.v0"),
        # it crosses 0.102 m in 2.6 frames
        ({"launch": {"v0": 10.0, "kind": "single"}}, "the ball is in the picture in [23] of 100 frames"),
        ({"launch": {"contact": [0.3, 0.0]}}, "in 0 of 100 frames.*: check timing and launch"),
    ],
)
def test_a_ball_that_the_film_hardly_shows_is_named(sections, said):
    assert re.search(said, describe_unseen_balls(synthcam.Scene.build("fast", **sections)))


GROUPS = [{"count": 3, "size": [0.02, 0.02]}, {"count": 2, "size": [0.01, 0.01]}]


@pytest.mark.parametrize(
    ("sections", "said"),
    [
        (
            {"launches": [{"position": [0.0, 0.0]}, {"position": [0.0, 0.01], "velocity": [30.0, 40.0]}]},
            r"ball 2 .*\. launches\.1\.velocity 50 m/s is 0\.2 m a frame.*: lower launches\.1\.velocity, or raise",
        ),
        (
            {"launches": [{"position": [0.0, 0.0]}, {"position": [0.0, 0.2]}]},
            r"ball 2 .*: check timing and launches\.1\.position$",
        ),
        ({"groups": [GROUPS[0], GROUPS[1] | {"rms_speed": 20.0}]}, r"ball 4 .*: lower groups\.1\.rms_speed, or"),
        ({"groups": [GROUPS[0] | {"velocity": [20.0, 0.0]}, GROUPS[1]]}, r"ball 1 .*: lower groups\.0\.velocity, or"),
        (
            {"groups": [GROUPS[0], GROUPS[1] | {"centre": [0.3, 0.0]}]},
            r"ball 4 .*: check timing and groups\.1\.centre$",
        ),
        (
            {"launches": [{"position": [0.3, 0.0]}], "groups": [GROUPS[0] | {"centre": [0.0, 0.02]}]},
            r"ball 1 .*: check timing and launches\.0\.position$",
        ),
    ],
)
def test_the_key_of_a_scene_of_many_bodies_is_named(sections, said):
    found = describe_unseen_balls(synthcam.Scene.build("many", **sections))
    assert re.search(said, found)
    assert "launch.v0" not in found


SLOW = {"dense": pytest.mark.gate}


@pytest.mark.parametrize(
    "path",
    [pytest.param(path, id=path.stem, marks=SLOW.get(path.stem, ())) for path in sorted(SCENES.glob("*.yaml"))],
)
def test_scenes_that_come_with_the_program_show_their_balls(path):
    assert describe_unseen_balls(synthcam.Scene.read(path), 3, 1) == ""


@pytest.mark.parametrize("frames", [1, 2, 4, 8])
def test_short_films_are_no_fault(frames):
    scene = synthcam.Scene.build(timing={"frames": frames, "contact_frame": 1})
    assert describe_unseen_balls(scene) == ""


def test_commands_print_it(tmp_path, capsys, monkeypatch):
    scene = tmp_path / "fast.yaml"
    scene.write_text("launch: {v0: 30}\n")
    monkeypatch.setattr("sys.argv", ["synthcam", "generate", str(scene), "-o", str(tmp_path / "d"), "--no-video"])
    with pytest.raises(SystemExit) as left:
        cli.main()
    assert left.value.code in (0, None)
    assert "fast.yaml, clip 0: ball 1 is in the picture in 0 of 100 frames" in capsys.readouterr().err


def test_a_scene_is_built_from_values():
    scene = synthcam.Scene.build("mine", launch={"v0": np.float64(0.4), "b": 0.2}, effects={"plate_tilt": {"x": 1e-3}})
    clip = scene.draw()
    assert (scene.name, clip.drawn["effects"]) == ("mine", {"plate_tilt": {"x": 1e-3, "y": 0.0}})
    assert clip.truth["v0"] == pytest.approx(0.4, abs=1e-12)
    assert synthcam.Scene.build().draw(seed=1).truth["r"] == synthcam.Scene.build().draw(seed=2).truth["r"]
    with pytest.raises(InputError, match=r"^mine: launch\.v: .*did you mean"):
        synthcam.Scene.build("mine", launch={"v": 1})
    with pytest.raises(InputError, match=r"^scene: lunch: "):
        synthcam.Scene.build(lunch={})
