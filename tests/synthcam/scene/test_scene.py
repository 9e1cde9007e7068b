"""Scenes: checked, drawn, and described."""

import numpy as np
import pytest
from repository import ROOT

from synthcam.dynamics.solve import solve
from synthcam.model import Model
from synthcam.scene.scene import Scene, check_scene, read_scene, schema
from synthcam_shared.errors import InputError

SHIPPED = sorted((ROOT / "scenes").glob("*.yaml"))
WRONG = {
    "launch.v00: unknown key": {"launch": {"v00": 1}},
    "lunch: unknown key": {"lunch": {}},
    r"effects\.plate_tlit: unknown key": {"effects": {"plate_tlit": {"x": 0}}},
    r"effects\.plate_tilt\.z: unknown key": {"effects": {"plate_tilt": {"z": 0}}},
    r"ball\.diameter: expected a number above 0, found -1": {"ball": {"diameter": -1}},
    r"launch\.v0: expected a finite number, found nan": {"launch": {"v0": float("nan")}},
    r"launch\.v0: expected a finite number, found inf": {"launch": {"v0": float("inf")}},
    r"launch\.v0: expected a number, found '0\.3'": {"launch": {"v0": "0.3"}},
    r"launch\.v0: expected a number, found True": {"launch": {"v0": True}},
    r"launch\.v0: expected a number, found 1000": {"launch": {"v0": 10**400}},
    r"launch\.v0: expected a number above 0, found -0\.1": {"launch": {"v0": {"uniform": [-0.1, 0.1]}}},
    r"launch\.v0: expected a number above 0, found -2": {"launch": {"v0": {"choice": [0.1, -2, 0.3]}}},
    r"launch\.v0: expected a number above 0, found -0\.5": {"launch": {"v0": {"normal": [0.3, 0.2]}}},
    r"launch\.v0\.uniform: expected two numbers": {"launch": {"v0": {"uniform": [1, 2, 3]}}},
    r"launch\.b: expected a number below 1, found 1": {"launch": {"b": 1}},
    r"launch\.contact: .*'upstream' or .*list.*found 'middle'": {"launch": {"contact": "middle"}},
    r"launch\.striker: expected 'a' or 'b', found 'c'": {"launch": {"striker": "c"}},
    r"timing\.frames: expected a number of 1000000 or less, found 1000000000": {"timing": {"frames": 10**9}},
    r"timing\.frames: expected a whole number, found 9\.5": {"timing": {"frames": 9.5}},
    r"timing\.exposure: expected at most 1/fps, 0\.004 s": {"timing": {"exposure": 5e-3}},
    r"timing\.exposure: expected at most 1/fps": {"timing": {"exposure": {"uniform": [1e-4, 5e-3]}}},
    r"camera\.height: expected more than two ball diameters": {"camera": {"height": 1e-3}},
    r"camera\.size: expected 2 or more values": {"camera": {"size": [640]}},
    r"lamp\.position: expected z above the balls": {"lamp": {"position": [0, 0, 0]}},
    r"sensor\.bits: expected a number of 16 or less": {"sensor": {"bits": 32}},
    r"launch: expected keys and values": {"launch": None},
    r"free: bounce is no parameter": {"free": ["bounce"]},
    r"1: keys should be strings": {1: 2},
    r"a\\nb: unknown key": {"a\nb": 2},
}


@pytest.mark.parametrize("message", WRONG)
def test_a_wrong_scene_is_one_line_with_file_and_key(message):
    with pytest.raises(InputError, match=r"^dir/s\.yaml: " + message) as e:
        check_scene(WRONG[message], "dir/s.yaml").draw(0, 0)
    assert "\n" not in str(e.value)


@pytest.mark.parametrize("path", SHIPPED, ids=lambda p: p.stem)
def test_the_shipped_scenes_draw(path):
    scene = read_scene(path)
    for number in range(5):
        clip = scene.draw(number, 1)
        if "launches" in clip.drawn:  # see test_bodies.py
            continue
        hit = solve(clip.model, clip.launch, 0.0, clip.frames / clip.camera.fps).first("contact")
        assert (hit is None) == (clip.drawn["launch"]["kind"] == "single")
        if hit:
            assert 20 <= hit.t * clip.camera.fps <= 30
            assert 0.1 <= clip.drawn["launch"]["v0"] <= (0.6 if clip.drawn["ball"]["diameter"] < 5e-3 else 1.2)


def test_the_scenes_the_issue_asks_for():
    asked = "painter_behringer head_on oblique single_roller dim saturated benchmark".split()
    assert set(asked) <= {p.stem for p in SHIPPED}
    drawn = [read_scene(next(p for p in SHIPPED if p.stem == "benchmark")).draw(k, 0).model for k in range(200)]
    for name, low, high in (
        ("restitution", 0.75, 0.98),
        ("spin_transfer", 0.1, 0.36),
        ("sliding_friction", 0.12, 0.35),
        ("rolling_drag", 0.135 / 2, 0.135 * 2),
        ("rolling_decel", 0.0103 / 2, 0.0103 * 2),
    ):
        values = np.array([m.value(name) for m in drawn])
        assert low <= values.min() < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < values.max() <= high


def test_an_empty_scene_is_the_papers_experiment():
    clip = check_scene({}, "x").draw(0, 0)
    assert clip.model == Model()
    assert (clip.camera.size, clip.camera.fps, clip.camera.exposure, clip.frames) == ((640, 480), 250, 5e-4, 100)
    assert clip.camera.scale == 1.6e-4
    assert clip.launch.time == 0.1


def test_upstream_is_15_mm_at_60_cm_a_second():
    clip = check_scene({"launch": {"v0": 0.3, "heading": np.pi / 2, "b": 0.4}}, "x").draw(0, 0)
    np.testing.assert_allclose(clip.launch.states[:, :2].mean(axis=0), [0, -7.5e-3], rtol=0, atol=1e-12)
    fixed = check_scene({"launch": {"contact": [0.01, 0]}}, "x").draw(0, 0)
    np.testing.assert_allclose(fixed.launch.states[:, :2].mean(axis=0), [0.01, 0], rtol=0, atol=1e-15)


def test_whole_numbers_do_for_real_ones():
    assert check_scene({"launch": {"b": 0, "v0": 1}}, "x").draw(0, 0).drawn["launch"]["v0"] == 1.0


def test_adding_a_distribution_moves_no_other():
    plain = {"launch": {"v0": {"uniform": [0.1, 0.6]}}}
    more = {
        "launch": {"v0": {"uniform": [0.1, 0.6]}, "b": {"uniform": [-0.1, 0.1]}},
        "ball": {"density": {"normal": [7800, 9]}},
    }
    for k in (4, 0, 2):
        a, b = (check_scene(s, "x").draw(k, 9).drawn["launch"]["v0"] for s in (plain, more))
        assert a == b


def test_overrides(tmp_path):
    (tmp_path / "s.yaml").write_text("launch: {v0: 0.1}")
    scene = read_scene(
        tmp_path / "s.yaml", ("launch.v0=0.2", "effects.plate_tilt.x=1e-3", "launch.b={uniform: [0, 0.5]}")
    )
    drawn = scene.draw(0, 0).drawn
    assert drawn["launch"]["v0"] == 0.2
    assert drawn["effects"]["plate_tilt"]["x"] == 1e-3
    assert 0 < drawn["launch"]["b"] < 0.5


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("launch.v0", "expected key=value"),
        ("=3", "expected key=value"),
        ("launch.v0=[", "not plain YAML"),
        ("launch.v0=2001-99-99", "not plain YAML"),
        ("launch.v0=" + "[" * 3000, "not plain YAML"),
        ("launch.v0=!!python/name:os.system", "not plain YAML"),
        ("launch.v0.x=1", r"launch\.v0"),
        ("launch.=1", "unknown key"),
        ("name.x.y=1", "name"),
        ("launch=5", "launch: expected keys and values"),
    ],
)
def test_a_wrong_override(tmp_path, text, message):
    (tmp_path / "s.yaml").write_text("name: a")
    with pytest.raises(InputError, match=message):
        read_scene(tmp_path / "s.yaml", (text,))


def test_the_schema_knows_every_key_and_distribution():
    found = schema()
    assert set(found["properties"]) >= {
        "name",
        "ball",
        "model",
        "effects",
        "launch",
        "timing",
        "camera",
        "lamp",
        "sensor",
    }
    v0 = found["$defs"]["LaunchSettings"]["properties"]["v0"]
    assert {"$ref": "#/$defs/Distribution"} in v0["anyOf"]
    assert v0["default"] == 0.3
    assert found["$defs"]["LaunchSettings"]["additionalProperties"] is False


def test_sections_override_the_files_own():
    scene = Scene.read("scenes/oblique.yaml", launch={"v0": np.float64(0.3), "b": 0.2}, camera={"size": (128, 96)})
    plain = read_scene(next(p for p in SHIPPED if p.stem == "oblique")).settings
    assert scene.settings["launch"] == plain["launch"] | {"v0": 0.3, "b": 0.2}
    assert type(scene.settings["launch"]["v0"]) is float
    assert scene.settings["camera"] == plain.get("camera", {}) | {"size": [128, 96]}
    clip = scene.draw(seed=1)
    assert (clip.number, clip.seed, clip.truth["b"]) == (0, 1, pytest.approx(0.2))
    assert Scene.read("oblique", name="mine", effects={"plate_tilt": {"x": 1e-3}}).draw().model.effects[0].x == 1e-3


def test_a_shipped_scene_is_found_by_name_from_anywhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert Scene.read("benchmark").settings == Scene.read("scenes/benchmark.yaml").settings
    (tmp_path / "benchmark").write_text("name: own")
    assert Scene.read("benchmark").name == "own"
    for name in ("benchmark.yaml", "somewhere/benchmark", "no_such"):
        with pytest.raises(InputError, match=f"{name}: no such file"):
            Scene.read(name)


@pytest.mark.parametrize(
    ("sections", "said"),
    [
        ({"lunch": {"v0": 1}}, "oblique: lunch: unknown key"),
        ({"launch": {"speed": 1}}, "oblique: launch.speed: unknown key"),
        ({"launch": 3}, "oblique: launch: "),
        ({"launch": {"v0": "fast"}}, "oblique: launch.v0: "),
        ({"launch": {"b": np.array([0.1, 0.2])}}, "oblique: launch.b: "),
    ],
)
def test_a_section_that_is_none_is_one_line(sections, said):
    with pytest.raises(InputError, match=said) as error:
        Scene.read("oblique", **sections)
    assert "\n" not in str(error.value)


def test_the_repr_says_what_varies():
    assert repr(Scene.read("benchmark")).startswith("Scene benchmark: model.restitution uniform [0.75, 0.98], ")
    assert repr(Scene.read("benchmark")).endswith(", 5 more")
    assert "all clips are the same" in repr(check_scene({}, "x"))
