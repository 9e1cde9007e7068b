"""Scenes of matte and coloured balls: what is written, what is refused, and that the rest stays as it was."""

import json

import cv2
import numpy as np
import pandas as pd
import pytest
import tifffile
from scipy.spatial.transform import Rotation

from synthcam.dataset import generate
from synthcam.dataset.export import export
from synthcam.dataset.files import verify
from synthcam.dataset.generate import GenerationPlan, generate_dataset
from synthcam.scene.scene import check_scene
from synthcam_shared.errors import InputError

SNOOKER = {
    "name": "small",
    "ball": {"diameter": 0.0525},
    "launch": {"v0": 0.8, "b": 0.3, "heading": 0.4, "contact": [0.0, 0.0]},
    "timing": {"fps": 60, "frames": 4, "exposure": 2e-3, "contact_frame": 1.5},
    "camera": {"size": [96, 72], "scale": 4e-3, "height": 2.4, "colour": True},
    "lamp": {"position": [0.9, 0.3, 2.2], "radius": 0.2},
    "surface": {"ball": "matte", "colour": "red", "b": {"colour": "white", "pattern": "half"}, "plate": "cloth"},
}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("snooker") / "d"
    scene = SNOOKER | {"video": {"codec": "ffv1"}}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(generate, "describe_machine", lambda video: {"gl": {"renderer": "none"}, "machine": {}})
        assert (
            generate_dataset(
                GenerationPlan((check_scene(scene, "s"),), 1, 3), folder, 1, lambda done, total: None
            ).failed
            == ()
        )
    return folder


def test_frames_in_colour_for_every_reader(dataset):
    assert not verify(dataset).problems
    path = dataset / "clips/000000/frames.tif"
    frames = tifffile.imread(path)
    assert (frames.shape, frames.dtype) == ((4, 72, 96, 3), np.uint8)
    again = np.array(cv2.imreadmulti(str(path), flags=cv2.IMREAD_UNCHANGED)[1])[..., ::-1]
    np.testing.assert_array_equal(frames, again)
    red, green, blue = np.median(frames.astype(float), axis=(0, 1, 2))
    assert green > 1.5 * red
    assert green > 1.5 * blue


def test_the_film_beside_is_the_same(dataset):
    frames = tifffile.imread(dataset / "clips/000000/frames.tif")
    reader = cv2.VideoCapture(str(dataset / "clips/000000/frames.avi"))
    for frame in frames:
        np.testing.assert_array_equal(reader.read()[1][..., ::-1], frame)
    assert not reader.read()[0]


def test_colours_stand_where_the_truth_says(dataset):
    frames = tifffile.imread(dataset / "clips/000000/frames.tif").astype(float)
    tracks = pd.read_parquet(dataset / "clips/000000/truth/tracks.parquet")
    target = tracks[tracks.particle == 0]  # ball a, red; ball b is launched
    for _, row in target.iterrows():
        red, green, _ = frames[int(row.frame), round(row.y_px), round(row.x_px)]
        assert red > 3 * green


def test_the_truth_says_how_a_pattern_is_turned(dataset):
    """The half that looks up shows its colour at the ball's middle."""
    frames = tifffile.imread(dataset / "clips/000000/frames.tif").astype(float)
    tracks = pd.read_parquet(dataset / "clips/000000/truth/tracks.parquet")
    striker = tracks[tracks.particle == 1]
    axes = Rotation.from_quat(striker[["qx", "qy", "qz", "qw"]].to_numpy()).as_matrix()[:, :, 2]
    for (_, row), axis in zip(striker.iterrows(), axes, strict=True):
        for sign in (-1, 1):  # a place a third of the radius towards the axis, one away from it
            aside = sign * axis[:2] / np.linalg.norm(axis[:2]) * 0.6
            up = np.array([*aside, np.sqrt(1 - aside @ aside)])
            x, y = row.x_px + up[0] * 6.56, row.y_px - up[1] * 6.56
            red, green, _ = frames[int(row.frame), round(y), round(x)]
            if abs(up @ axis) > 0.3:
                assert (red > 2 * green) == (up @ axis > 0)


def test_camera_json_tells_what_one_sees(dataset):
    known = json.loads((dataset / "clips/000000/camera.json").read_text())
    assert known["ball"] == {"finish": "matte", "colour": "red"}
    assert "ambient" not in known["lamp"]
    assert "surface" not in known


@pytest.mark.parametrize("kind", ["mot", "ffv1", "zarr"])
def test_exports_in_colour(dataset, tmp_path, kind):
    if kind == "zarr":
        pytest.importorskip("zarr", reason="zarr is not installed: synthcam[zarr]")
    export(dataset, kind, tmp_path / "out", lambda done, total: None)
    frames = tifffile.imread(dataset / "clips/000000/frames.tif")
    if kind == "mot":
        seen = cv2.imread(str(tmp_path / "out/clip-000000/img1/000002.png"))[..., ::-1]
    elif kind == "ffv1":
        seen = cv2.VideoCapture(str(tmp_path / "out/000000/frames.mkv"))
        seen.read()
        seen = seen.read()[1][..., ::-1]
    else:
        import zarr

        seen = zarr.open_group(tmp_path / "out", mode="r")["small/frames"][0, 1]
    np.testing.assert_array_equal(seen, frames[1])


def test_a_grey_camera_sees_the_same_scene(dataset):
    grey = check_scene(SNOOKER | {"camera": SNOOKER["camera"] | {"colour": False}}, "s").draw(0, 3).film()
    frames = tifffile.imread(dataset / "clips/000000/frames.tif")
    assert grey.shape == (4, 72, 96)
    mixed = (frames - 8.0) @ [0.299, 0.587, 0.114] + 8
    assert np.abs(np.median(mixed - grey)) < 1
    smooth = [cv2.blur(frame.astype(float), (5, 5)).ravel() for frame in (mixed[1], grey[1])]
    assert np.corrcoef(smooth)[0, 1] > 0.97


def test_steel_in_colour_is_grey_with_noise_of_its_own():
    small = {"camera": {"size": [64, 48], "colour": True}, "timing": {"frames": 2, "contact_frame": 1}}
    film = check_scene(small, "s").draw().film().astype(float)
    plain = check_scene(small | {"camera": {"size": [64, 48]}}, "s").draw().film()
    assert film.shape == (2, 48, 64, 3)
    np.testing.assert_array_equal(film[..., 0], plain)
    assert 0.5 < (film[..., 0] - film[..., 1]).std() < 3


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"surface": {"ball": "glass"}}, "surface.ball: expected 'steel' or 'matte'"),
        ({"surface": {"colour": "red"}}, "surface.colour: expected together with surface.ball or surface.plate"),
        ({"lamp": {"ambient": 0.5}}, "expected together with surface.ball or surface.plate"),
        ({"sensor": {"white": 99}}, "expected together with surface.ball or surface.plate"),
        ({"surface": {"ball": "matte", "colour": "mauve"}}, "surface.colour: "),
        ({"surface": {"ball": "matte", "colour": [1, 2, 0]}}, "surface.colour"),
        ({"surface": {"ball": "matte", "b": {"pattern": "tartan"}}}, "surface.b.pattern: "),
        (
            {"surface": {"ball": "matte", "plate_gloss": 0.1}},
            "surface.plate_gloss: has no effect together with surface.ball",
        ),
        ({"surface": {"plate": "ice"}}, "surface.plate: expected "),
        ({"surface": {"ball": "matte", "albedo": 1.5}}, "surface.albedo: expected a number of 1 or less"),
        ({"surface": {"plate": "wood"}, "lamp": {"ambient": -1}}, "lamp.ambient: "),
        ({"surface": {"plate": "wood"}, "sensor": {"white": 0}}, "sensor.white: "),
        ({"camera": {"colour": "yes"}}, "camera.colour: "),
    ],
)
def test_what_no_scene_has(change, said):
    with pytest.raises(InputError, match=said) as error:
        check_scene(change, "s.yaml")
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 300
