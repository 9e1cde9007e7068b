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


@pytest.mark.parametrize("path", sorted(SCENES.glob("*.yaml")), ids=lambda p: p.stem)
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
