"""The glTF export, opened by trimesh's reader and, for what that does not read, by the format's own description."""

import json
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from synthcam_stub import SCENE, make

from synthcam.camera.glints import find_glints
from synthcam.camera.render import MirrorRenderer
from synthcam.dataset.export import export
from synthcam.scene.scene import check_scene

TYPES = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Tilted, so that heights show in the picture; so fast that a ball turns by more than half between frames."""
    scene = SCENE | {"launch": {"v0": 0.9, "b": 0.2}, "camera": SCENE["camera"] | {"tilt": [0.2, -0.1]}}
    with pytest.MonkeyPatch.context() as patch:
        return make(tmp_path_factory.mktemp("gltf") / "d", patch, clips=2, scene=scene)


@pytest.fixture(scope="module")
def exported(dataset, tmp_path_factory):
    out = tmp_path_factory.mktemp("gltf") / "out"
    assert export(dataset, "gltf", out, lambda done, total: None) == 2
    assert sorted(p.name for p in out.iterdir()) == ["000000.glb", "000001.glb"]
    return out / "000001.glb"


@pytest.fixture(scope="module")
def truth(dataset):
    folder = dataset / "clips/000001"
    tracks = pd.read_parquet(folder / "truth/tracks.parquet")
    return tracks, pd.read_parquet(folder / "truth/events.parquet"), json.loads((folder / "camera.json").read_text())


def contents(path):
    """JSON and buffer of a glb file: glTF 2.0, section 4.4."""
    data = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON"
    size_b, kind_b = struct.unpack_from("<I4s", data, 20 + size)
    assert (kind_b, 28 + size + size_b) == (b"BIN\x00", len(data))
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def values(tree, buffer, number):
    """An accessor's numbers, its bounds checked."""
    about = tree["accessors"][number]
    assert about["componentType"] == 5126
    view = tree["bufferViews"][about["bufferView"]]
    start = view.get("byteOffset", 0) + about.get("byteOffset", 0)
    assert start % 4 == 0
    assert view["byteLength"] >= 4 * about["count"] * TYPES[about["type"]]
    table = np.frombuffer(buffer, "<f4", about["count"] * TYPES[about["type"]], start).reshape(about["count"], -1)
    np.testing.assert_array_equal(table.min(axis=0), about["min"])
    np.testing.assert_array_equal(table.max(axis=0), about["max"])
    return table.astype(float)


def channels(path):
    """{(node's name, path): (times, values)} of a file's one animation."""
    tree, buffer = contents(path)
    (motion,) = tree["animations"]
    out = {}
    for channel in motion["channels"]:
        node = tree["nodes"][channel["target"]["node"]]
        assert "matrix" not in node  # forbidden where something moves
        sampler = motion["samplers"][channel["sampler"]]
        times, table = (values(tree, buffer, sampler[end]) for end in ("input", "output"))
        assert (np.diff(times[:, 0]) > 0).all()
        out[node["name"], channel["target"]["path"]] = times[:, 0], table
    return out


def test_trimesh_opens_it(exported, truth):
    scene = trimesh.load_scene(exported)
    _, _, camera = truth
    assert set(scene.geometry) == {"plate", "ball0", "ball1", "lamp"}
    for name in ("ball0", "ball1"):
        ball = scene.geometry[name]
        assert ball.is_watertight
        np.testing.assert_allclose(np.linalg.norm(ball.vertices, axis=1), camera["ball_diameter"] / 2, rtol=1e-6)
        assert ball.volume == pytest.approx(np.pi / 6 * camera["ball_diameter"] ** 3, rel=5e-3)
        assert (ball.visual.material.metallicFactor, ball.visual.material.name) == (1.0, "steel")
    top = scene.geometry["plate"].bounds[1, 2] + scene.graph.get("plate", "table")[0][2, 3]
    assert top == pytest.approx(0, abs=1e-9)
    x, y, z = camera["lamp"]["position"]
    np.testing.assert_allclose(scene.graph.get("lamp")[0][:3, 3], [x, z, -y], atol=1e-7)  # glTF's y points up


def test_positions_are_the_truths(exported, truth):
    tracks, events, _ = truth
    (hit,) = events.loc[events.kind == "contact", "t_s"]
    moved = channels(exported)
    for ball, own in tracks.groupby("particle"):
        times, positions = moved[f"ball{ball}", "translation"]
        at = np.array([np.abs(times - t).argmin() for t in own.t_s])
        np.testing.assert_allclose(times[at], own.t_s, atol=1e-7)
        np.testing.assert_allclose(positions[at], own[["x", "y", "z"]], atol=1e-8)
        assert np.abs(times - hit).min() < 1e-7
    meet = [moved[f"ball{k}", "translation"] for k in (0, 1)]
    one, two = (positions[np.abs(times - hit).argmin()] for times, positions in meet)
    assert np.linalg.norm(two - one) == pytest.approx(2.38e-3, rel=2e-3)  # they touch where they hit


def test_a_rolling_ball_turns_as_far_as_it_goes(exported, truth):
    """Without slip the way is the radius times the turn, about the axis across it: nothing of the spin is read."""
    tracks, events, _ = truth
    moved, seen = channels(exported), 0
    for ball, own in tracks.groupby("particle"):
        times, turns = moved[f"ball{ball}", "rotation"]
        np.testing.assert_allclose(np.linalg.norm(turns, axis=1), 1, atol=1e-6)
        own = own.reset_index(drop=True)
        for k in range(len(own) - 1):
            start, end = own.t_s[k], own.t_s[k + 1]
            if set(own.state[k : k + 2]) != {"roll"} or events.t_s.between(start, end).any():
                continue
            inside = np.flatnonzero((times > start - 1e-6) & (times < end + 1e-6))
            steps = Rotation.from_quat(turns[inside])
            turn = (steps[1:] * steps[:-1].inv()).as_rotvec()
            assert np.linalg.norm(turn, axis=1).max() < 1.01
            way = np.array([own.x[k + 1] - own.x[k], own.y[k + 1] - own.y[k], 0])
            np.testing.assert_allclose(turn.sum(axis=0), np.cross([0, 0, 1], way) / 1.19e-3, atol=2e-3)
            seen += np.linalg.norm(way) > 1e-3
    assert seen >= 4


def test_the_camera_sees_balls_where_ours_does(exported, truth):
    tracks, _, camera = truth
    tree, _ = contents(exported)
    nodes = {node["name"]: node for node in tree["nodes"]}
    positions = [tree["nodes"][k]["name"] for k in nodes["table"]["children"]]
    assert {"ball0", "ball1", "camera", "light"} <= set(positions)  # so that one frame serves all
    lens = tree["cameras"][nodes["camera"]["camera"]]["perspective"]
    width, height = camera["size"]
    to_camera = np.linalg.inv(np.reshape(nodes["camera"]["matrix"], (4, 4)).T)
    points = tracks[["x", "y", "z"]].to_numpy()
    seen = np.c_[points, np.ones(len(points))] @ to_camera.T
    up = seen[:, 1] / -seen[:, 2] / np.tan(lens["yfov"] / 2)  # -1 to 1 over the picture: glTF 2.0, section 3.10
    right = seen[:, 0] / -seen[:, 2] / (lens["aspectRatio"] * np.tan(lens["yfov"] / 2))
    columns, rows = (1 + right) * width / 2 - 0.5, (1 - up) * height / 2 - 0.5
    np.testing.assert_allclose(np.c_[columns, rows], tracks[["x_px", "y_px"]], atol=1e-3)


LAMPS = {  # under a room so bright that the 255ths to which trimesh rounds colours do not count
    "the paper's": {"room": 0.2},
    "small, beside": {"position": [0.1, -0.05, 0.3], "radius": 0.004, "room": 0.2},
    "two": {"room": 0.2, "second": {"position": [-0.2, 0.1, 0.4], "radius": 0.02, "radiance": 0.5}},
}


@pytest.mark.parametrize(
    "lamp", [pytest.param(v, id=k, marks=[pytest.mark.gate] * (k != "two")) for k, v in LAMPS.items()]
)
def test_a_plain_renderer_shows_plate_and_glint_as_our_film_does(tmp_path, monkeypatch, lamp):
    scene = SCENE | {"lamp": lamp, "launch": {"v0": 0.3}, "camera": {"size": [128, 96]}}
    dataset = make(tmp_path / "d", monkeypatch, clips=1, scene=scene)
    export(dataset, "gltf", tmp_path / "out", lambda done, total: None)
    clip = check_scene(scene, "s.yaml").draw(0, 5)
    film = MirrorRenderer(clip.camera, clip.lamp, [clip.model.ball.radius], clip.room, clip.surface)
    full = clip.sensor.glint_peak / (2**clip.sensor.bits - 1)
    viewer = Path(__file__).with_name("plain_viewer.py")  # a process of its own: pyrender ends OpenGL for all in its
    told = subprocess.run(
        [sys.executable, viewer, tmp_path / "out/000000.glb", *map(str, clip.camera.size)],
        capture_output=True,
        text=True,
        check=True,
    )
    shown, ours = json.loads(told.stdout), film.plate * full
    for (row, column), grey in zip(shown["at"], shown["plate"], strict=True):
        assert grey == pytest.approx(ours[row, column], rel=0.1)
    flux = full * 2 * np.pi * clip.camera.psf_sigma_px**2  # px^2: of a spot that peaks at `full`
    rest = np.array([[[0, 0, clip.model.ball.radius]]]), np.array([clip.model.ball.radius]), np.ones((1, 1), bool)
    lit = [find_glints(clip.camera, each, *rest).flux.sum() for each in clip.lamp.all]
    flux *= sum(lit) / lit[0]
    assert shown["flux"] == pytest.approx(flux, rel=0.1)
    assert shown["brightest"] > 100 * ours.max()


def test_matte_balls_keep_their_colours_and_turns(tmp_path, monkeypatch):
    surface = {"ball": "matte", "colour": "red", "b": {"colour": [0.2, 0.4, 0.8], "pattern": "half"}, "plate": "cloth"}
    scene = SCENE | {"surface": surface, "camera": SCENE["camera"] | {"colour": True}, "launch": {"striker": "b"}}
    data = make(tmp_path / "d", monkeypatch, clips=1, video=False, scene=scene)
    export(data, "gltf", tmp_path / "out", lambda done, total: None)
    tree, buffer = contents(tmp_path / "out/000000.glb")
    tracks = pd.read_parquet(data / "clips/000000/truth/tracks.parquet")
    nodes = {node["name"]: node for node in tree["nodes"]}
    found = []
    for k in (0, 1):
        primitive = tree["meshes"][nodes[f"ball{k}"]["mesh"]]["primitives"][0]
        assert tree["materials"][primitive["material"]]["pbrMetallicRoughness"]["metallicFactor"] == 0
        view = tree["accessors"][primitive["attributes"]["COLOR_0"]]
        start = tree["bufferViews"][view["bufferView"]]["byteOffset"]
        colours = np.frombuffer(buffer, np.uint8, 4 * view["count"], start).reshape(-1, 4)[:, :3] / 255
        found.append(np.unique(colours, axis=0))
    np.testing.assert_allclose(found[0], [[0.85 * 0.75, 0.85 * 0.05, 0.85 * 0.05]], atol=3e-3)
    for colour in ([0.17, 0.34, 0.68], [0.85 * 0.75, 0.85 * 0.05, 0.85 * 0.05]):
        assert np.abs(found[1] - colour).max(axis=1).min() < 3e-3
    first = tracks[tracks.particle == 1].iloc[0]
    np.testing.assert_allclose(nodes["ball1"]["rotation"], first[["qx", "qy", "qz", "qw"]].to_numpy(float), atol=1e-6)
    (plate,) = (m for m in tree["materials"] if m["name"] == "plate")
    assert plate["pbrMetallicRoughness"]["baseColorFactor"] == pytest.approx([0.039, 0.3, 0.105, 1.0])
