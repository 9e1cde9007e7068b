"""Effects of one's own: from a folder, and from a package."""

import json
import sys

import pytest
from sticky_effect import STICKY

import synthcam.library as module
from synthcam.cli import app
from synthcam.dataset import generate, preview
from synthcam.dataset.generate import GenerationPlan, generate_dataset, make_clip
from synthcam.library import add_effects, hash_effect_files, library
from synthcam.model import Model, read_model, write_model
from synthcam.scene.scene import check_scene, schema
from synthcam_shared.errors import InputError


def test_an_effect_of_a_folder_is_one_of_the_library(own):
    (own / "sticky_fingers.py").write_text(STICKY)
    (own / "_notes.py").write_text("1 / 0")
    add_effects(own)
    add_effects(str(own))  # again: nothing
    model = Model().replace({"sticky_fingers.k": 0.1})
    write_model(model, own / "m.yaml")
    assert read_model(own / "m.yaml") == model
    assert "sticky_fingers" in schema()["$defs"]["EffectSettings"]["properties"]
    with pytest.raises(InputError, match=r"sticky_fingers\.k: expected a number of 0 or more"):
        check_scene({"effects": {"sticky_fingers": {"k": -1}}}, "x")


def test_workers_know_the_folder_and_the_dataset_which_file_it_was(own, tmp_path, monkeypatch):
    (own / "sticky_fingers.py").write_text(STICKY)
    add_effects(own)
    scene = check_scene({"effects": {"sticky_fingers": {"k": 0.5}}, "timing": {"frames": 5}}, "x")
    plan = GenerationPlan((scene,), 4, 1, video=False)
    outcome = generate_dataset(plan, tmp_path / "d", 2, lambda done, of: None)
    assert (outcome.made, outcome.failed) == (4, ())
    about = json.loads((tmp_path / "d/truth/dataset.json").read_text())
    assert about["effect_files"] == hash_effect_files(["sticky_fingers"])
    truth = json.loads((tmp_path / "d/clips/000003/truth/scene.json").read_text())
    assert truth["drawn"]["effects"] == {"sticky_fingers": {"k": 0.5}}
    (own / "sticky_fingers.py").write_text(STICKY + "# changed\n")
    with pytest.raises(InputError, match="another effect file"):
        generate_dataset(plan, tmp_path / "d", 1, lambda done, of: None)
    monkeypatch.setattr(generate, "hash_effect_files", lambda names: {})  # a package brings it now
    with pytest.raises(InputError, match="another effect file"):
        generate_dataset(plan, tmp_path / "d", 1, lambda done, of: None)
    assert make_clip(plan, 0, tmp_path) is None


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a", "def (", "line 1: invalid syntax"),
        ("a", "\n1 / 0", "ZeroDivisionError: division by zero"),
        ("a", "import nothing_of_this_name", "ModuleNotFoundError: No module"),
        ("a", "x = 1", "expected one Effect in the file, found 0"),
        ("a", STICKY.replace("friction(", "fiction("), "StickyFingers.fiction: no such law; there are mass, "),
        ("a", STICKY.replace("slip_speed", "speed"), "asks for speed; friction may ask for slip_speed"),
        ("a", STICKY.replace("@dataclass(frozen=True)", ""), r"expected @dataclass\(frozen=True\) before class"),
        (
            "a",
            STICKY.replace('parameter("s/m", typical=0.05, low=0)', "0.1"),
            "k: expected a parameter, such as k: float = ",
        ),
        ("a", STICKY.replace("low=0)", "low=0, fixed=True)"), "expected a parameter that is not fixed"),
        ("a", STICKY.replace("low=0)", "low=1)"), r"a\.k = 0: expected a number from 1"),
        ("a", STICKY.replace("def friction", "def _friction"), "changes no law; expected a method"),
        ("stribeck", STICKY, "an effect of this name exists already"),
        ("friction_speed", STICKY, "this is the name of a law"),
        ("Sticky", STICKY, "expected a name of lower-case letters, digits and _"),
    ],
)
def test_a_file_that_is_no_effect_is_one_line(own, name, text, said):
    (own / f"{name}.py").write_text(text)
    before = set(library())
    with pytest.raises(InputError, match=rf"{name}\.py: .*{said}") as error:
        add_effects(own)
    assert "\n" not in str(error.value)
    assert set(library()) == before
    assert not [m for m in sys.modules if m.startswith("synthcam_effects_of_a_folder")]


def test_a_folder_without_any(own):
    with pytest.raises(InputError, match="holds no effect; expected files"):
        add_effects(own)
    with pytest.raises(InputError, match="no such folder"):
        add_effects(own / "none")


class Point:
    def __init__(self, name, load):
        self.name, self.load = name, load


def test_a_package_brings_an_effect_as_an_entry_point(own, monkeypatch):
    (own / "sticky_fingers.py").write_text(STICKY)
    add_effects(own)
    kind = library()["sticky_fingers"]
    module._folders.clear()

    def brought(*points):
        monkeypatch.setattr(module, "entry_points", lambda group: points if group == "synthcam.effects" else ())
        library.cache_clear()
        return library()

    assert brought(Point("sticky_fingers", lambda: kind))["sticky_fingers"] is kind
    for point, said in (
        (Point("sticky", lambda: kind), "expected the name of the effect's file, sticky_fingers"),
        (Point("sticky_fingers", lambda: 3), "expected a class of Effect, found int"),
        (Point("sticky_fingers", lambda: 1 / 0), "ZeroDivisionError"),
        (Point("hop", lambda: kind), "an effect of this name exists already"),
    ):
        with pytest.raises(InputError, match=f"entry point {point.name} of synthcam.effects: .*{said}"):
            brought(point)


SCENE = "effects: {sticky_fingers: {k: 0.1}}\ntiming: {frames: 5}\n"


@pytest.mark.parametrize(
    "words",
    [
        ["effects", "sticky_fingers"],
        ["schema"],
        ["generate", "scene.yaml", "-o", "d", "--no-video"],
        ["preview", "scene.yaml", "-o", "frame.png"],
    ],
    ids=lambda words: words[0],
)
def test_the_commands_take_a_folder(own, monkeypatch, capsys, words):
    (own / "mine").mkdir()
    (own / "mine/sticky_fingers.py").write_text(STICKY)
    (own / "scene.yaml").write_text(SCENE)
    monkeypatch.chdir(own)
    monkeypatch.setattr(preview, "write_preview", lambda clip, output, frame, magnify: output.write_text("drawn"))
    app([*words, "--effects", "mine"], standalone_mode=False)
    if "-o" in words:
        assert (own / words[-1 if words[0] == "preview" else 3]).exists()
    else:
        assert "sticky_fingers" in capsys.readouterr().out


def test_a_scene_takes_its_physics_from_a_model_file(own, monkeypatch):
    """Ball, base model, effects and tables of the model; the launch of the scene."""
    (own / "scene.yaml").write_text(
        "ball: {diameter: 3.0e-3}\neffects: {plate_tilt: {x: 1.0e-3}}\nlaunch: {v0: 0.4}\ntiming: {frames: 5}\n"
        "free: [spin_transfer]\n"
    )
    (own / "model.yaml").write_text(
        "model: {spin_transfer: 0.2}\nfree_laws: {restitution_speed: {x: [0, 1], y: [0.5, 0.9]}}\n"
    )
    monkeypatch.chdir(own)
    app(["generate", "scene.yaml", "--model", "model.yaml", "-o", "d", "--no-video"], standalone_mode=False)
    truth = json.loads((own / "d/clips/000000/truth/scene.json").read_text())
    assert truth["row"]["r"] == pytest.approx(0.66, abs=1e-9)  # at 0.4 m/s
    assert truth["row"]["v0"] == pytest.approx(0.4)
    assert truth["drawn"]["ball"]["diameter"] == Model().ball.diameter
    assert truth["drawn"]["model"]["spin_transfer"] == 0.2
    assert (truth["drawn"]["effects"], truth["drawn"]["free"]) == ({}, [])
