"""Pictures of scenes on request: what each slider moves, what stays, and a picture that is that of the film."""

import base64
import io
import json

import cv2
import numpy as np
import pytest

from synthcam import Scene
from synthcam.dataset.live_preview import _draw_moved_scene, answer_request, answer_requests, list_sliders, move_sliders
from synthcam.scene.clip import Clip, _make_renderer
from synthcam.scene.film_time import FilmedMotion
from synthcam.scene.scene import check_scene, read_scene
from synthcam.settings import SCENES
from synthcam_shared.errors import InputError
from synthcam_shared.settings import parse_yaml

PLACES = {  # of what a slider moves, and units in SI
    "offset": ("launch", "b", 1),
    "restitution": ("model", "restitution", 1),
    "friction": ("model", "sliding_friction", 1),
    "exposure": ("timing", "exposure", 1e-3),
    "noise": ("sensor", "read_noise", 1),
}


@pytest.mark.parametrize("path", sorted(SCENES.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_slider_of_every_scene_moves_its_number_and_no_other(path):
    scene = read_scene(path)
    start = scene.draw().drawn
    for slider in list_sliders(scene, start):
        value = (slider.low + slider.high) / 2
        if slider.name == "balls":
            value = min(3, slider.high)
        moved = check_scene(move_sliders(scene, start, {slider.name: value}), "moved").draw().drawn
        if slider.name in PLACES:
            section, key, factor = PLACES[slider.name]
            assert moved[section].pop(key) == pytest.approx(factor * value, rel=1e-5)
            assert moved == {**start, section: {k: v for k, v in start[section].items() if k != key}}
        elif slider.name == "lamp":
            assert moved["lamp"]["position"] == pytest.approx([1e-3 * value, *start["lamp"]["position"][1:]], abs=1e-9)


@pytest.mark.parametrize(
    ("name", "balls", "launched"),
    [("oblique", 1, 1), ("oblique", 2, 2), ("oblique", 5, 5), ("tray", 4, 4), ("crowd", 7, 7), ("break", 3, 4)],
)
def test_the_number_of_balls(name, balls, launched):
    scene = Scene.read(name)
    settings = move_sliders(scene, scene.draw().drawn, {"balls": balls, "speed": 0.4 if name != "tray" else 2})
    clip = check_scene(settings, name).draw()
    assert len(clip.launch.bodies.radius) == launched
    if name == "oblique" and balls == 5:
        speeds = np.array([launch["velocity"] for launch in clip.drawn["launches"]])
        assert np.sqrt((speeds**2).sum(axis=1).mean()) == pytest.approx(0.4)
    if name == "tray":  # all velocities are twice as large
        before = np.array([launch["velocity"] for launch in scene.draw().drawn["launches"]])[:4]
        np.testing.assert_allclose([launch["velocity"] for launch in clip.drawn["launches"]], 2 * before)


def test_a_sketch_is_the_frame_of_the_film_with_noise_of_the_same_size():
    small = {"size": [96, 64], "scale": 3.7e-3, "colour": None}
    even = {"surface": {"plate": "plain"}, "lamp": {"ambient": 1.0}}  # one table of noise is enough
    clip = Scene.read("matte_white", camera=small, sensor={"dsnu": 0.0, "prnu": 0.0}, **even).draw()
    film, seen = next(clip.pictures(every=clip.frames)).astype(float), clip.sketch(0).astype(float)
    noise = np.sqrt(2 * (film.mean() * clip.sensor.gain + clip.sensor.read_noise**2)) / clip.sensor.gain
    off = film - seen
    assert abs(off.mean()) < 5 * noise / np.sqrt(off.size)
    assert off.std() == pytest.approx(noise, rel=0.1)


def test_a_request_is_answered_in_a_line_and_a_wrong_one_by_a_sentence(monkeypatch):
    monkeypatch.setattr(Clip, "sketch", lambda clip, k, quick: np.full(clip.camera.size[::-1], 8 + k, np.uint8))
    asked = [{}, {"scene": "oblique", "values": {"offset": 0.5}, "frame": 3}, {"scene": "none"}, {"scene": "../x"}]
    asked += [{"scene": "oblique", "values": {"offset": 2}}, {"scene": "oblique", "values": {"mass": 2}}, 3]
    lines, out = [*map(json.dumps, asked), "{", "[" * 100_000], io.StringIO()
    answer_requests(lines, lambda text: print(text, file=out))
    names, drawn, *refused = map(json.loads, out.getvalue().splitlines())
    assert {"oblique", "tray"} < set(names["scenes"])
    picture = cv2.imdecode(np.frombuffer(base64.b64decode(drawn["picture"]), np.uint8), cv2.IMREAD_GRAYSCALE)
    assert [*picture.shape[::-1]] == drawn["size"]
    assert parse_yaml(drawn["yaml"])["launch"]["b"] == 0.5
    assert parse_yaml(drawn["yaml"])["launch"]["v0"] == {"uniform": [0.1, 0.6]}  # not moved
    at = check_scene(parse_yaml(drawn["yaml"]), "copied").draw()
    np.testing.assert_allclose(drawn["paths"][1][0], at.camera.project(at.view.at(np.zeros(1))[1, 0, :3]), atol=0.06)
    said = [
        "none: no such file",
        "scene",
        "Offset b: expected -0.95 to 0.95, not 2",
        "expected one of speed, offset",
        "preview",
    ]
    for answer, words in zip(refused, [*said, "", "nested too deeply"], strict=True):
        assert [*answer] == ["error"]
        assert words in answer["error"]


def test_a_matte_scene_is_drawn_small_and_sharp_on_demand(monkeypatch, tmp_path):
    sizes = []
    monkeypatch.setattr(
        Clip,
        "sketch",
        lambda clip, k, quick: sizes.append((*clip.camera.size, quick)) or np.zeros(clip.camera.size[::-1], np.uint8),
    )
    small, sharp = (answer_request({"scene": "matte_white", "sharp": sharp}) for sharp in (False, True))
    assert sizes == [(160, 120, True), (640, 480, False)]
    assert small["paths"] == sharp["paths"]
    assert small["size"] == sharp["size"] == [640, 480]
    (tmp_path / "elsewhere").write_text("launch: {v0: secret}")  # only scenes of the package are read
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="elsewhere: no such file among"):
        answer_request({"scene": "elsewhere"})


@pytest.mark.parametrize("name", ["tray", "break"])  # of mirrors; of matte balls, which are drawn small at first
def test_pictures_of_several_frames_need_one_solution_of_the_motion(monkeypatch, name):
    """The frames of a film that is drawn quickly show the balls where those of the whole film do."""
    monkeypatch.setattr(Clip, "sketch", lambda clip, k, quick: shown.append(clip.view) or np.zeros((2, 2), np.uint8))
    shown, solved = list[FilmedMotion](), list[int]()
    solve = FilmedMotion.solve
    monkeypatch.setattr(FilmedMotion, "solve", lambda *given: solved.append(1) or solve(*given))
    _draw_moved_scene.cache_clear()
    for frame in (3, 5):
        answer_request({"scene": name, "values": {"restitution": 0.6}, "frame": frame})
    answer_request({"scene": name, "values": {"restitution": 0.6}, "sharp": True})
    assert len(solved) == 1
    answer_request({"scene": name, "values": {"restitution": 0.7}})
    assert len(solved) == 2
    quick, sharp = (view.camera.project(view.at(np.array([0.1]))[:, 0, :3]) for view in shown[1:3])
    factor = sharp.max() / quick.max()
    np.testing.assert_allclose((quick + 0.5) * round(factor) - 0.5, sharp, atol=1e-6)


STILL = {"launches": [{"position": [-0.0012, 0.0]}, {"position": [0.0012, 0.0]}]}  # two balls that touch
CLOSE = {"size": [64, 48], "scale": 1e-4}


def test_a_quick_sketch_keeps_its_renderer():
    surface, found = {"ball": "matte"}, []
    for noise in (0.0, 40.0):
        sections = {"camera": CLOSE, "surface": surface, "sensor": {"read_noise": noise}}
        check_scene(STILL | sections, "scene").draw().sketch(0, quick=True)
        found.append(_make_renderer.cache_info().misses)
    assert found[0] == found[1]


@pytest.mark.parametrize(
    "surface", [{"ball": "matte", "gloss": 0.0}, {"plate": "plain", "plate_albedo": 0.3}], ids=["dull", "metal"]
)
def test_a_quick_sketch_leaves_out_what_balls_reflect_to_each_other(surface):
    """White balls are darker where they face each other. Metal ones lack the image of the other, and that of its glint.

    The plate is the same.
    """
    sections = {"camera": CLOSE, "surface": surface, "sensor": {"read_noise": 0.0, "full_well": 1e7}}
    clip = check_scene(STILL | sections | {"lamp": {"ambient": 0.3}}, "scene").draw()
    change = clip.sketch(0).astype(float) - clip.sketch(0, quick=True)
    places = clip.camera.project(clip.view.at(np.array([0.0]))[:, 0, :3])
    left, right = (round(x) for x in sorted(places[:, 0].tolist()))
    row, inside = round(float(places[0, 1])), slice(left + 4, right - 3)
    assert abs(change[:, :2].mean()) < 0.5
    if "gloss" in surface:
        assert change[row, inside].max() > 5
        assert change[row, inside].mean() > 3 * np.abs(change[row, left - 9 : left - 4]).mean()
    else:
        assert change[row, inside].max() > 20
        assert np.mean([change[row + k, inside].mean() for k in (-4, -3, 4, 5)]) < -1.5
