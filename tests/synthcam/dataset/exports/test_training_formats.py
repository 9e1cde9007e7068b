"""COCO, YOLO and the Cell Tracking Challenge, read back by readers of their own, written after each description.

The strings of COCO's masks were compared with those of pycocotools, and the tracks checked with ctc_validate, by hand.
"""

import json

import cv2
import numpy as np
import pytest
import tifffile
import yaml
from synthcam_stub import film, make

import synthcam
from synthcam.dataset.export import export
from synthcam.scene.clip import Clip
from synthcam.scene.scene import check_scene

# One ball leaves the picture and comes back, one is partly hidden behind another, as the camera is tilted.
SCENE = {
    "name": "trio",
    "launches": [
        {"position": [0.014, 0.004], "velocity": [0.5, {"uniform": [0.0, 0.02]}]},
        {"position": [-0.01, 0.0]},
        {"position": [-0.0095, 0.0024]},
    ],
    "walls": [{"start": [0.03, -0.1], "end": [0.03, 0.1], "restitution": 0.9, "friction": 0.1}],
    "camera": {"size": [128, 64], "scale": 3e-4, "tilt": [1.0, 0.0]},
    "timing": {"frames": 40},
    "sensor": {"bits": 12},
}


@pytest.fixture(scope="module")
def frames():
    """The labelled frames of each clip, as a stream makes them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Clip, "pictures", film)
        return list(synthcam.stream(check_scene(SCENE, "s"), seed=5, stop=2, by="clip"))


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """A folder with each format."""
    folder = tmp_path_factory.mktemp("training")
    with pytest.MonkeyPatch.context() as patch:
        dataset = make(folder / "d", patch, clips=2, scene=SCENE)
    for kind in ("coco", "yolo", "ctc"):
        assert export(dataset, kind, folder / kind, lambda done, total: None) == 2
    return folder


def test_there_is_a_ball_that_comes_back_and_one_that_is_hidden(frames):
    shown = [0 in frame.ids for frame in frames[0]]
    assert (shown[0], shown[10], shown[-1]) == (True, False, True)
    sizes = (frames[0][0].masks.sum(axis=(1, 2))[1:]).tolist()
    assert min(sizes) < 0.9 * max(sizes)


def decoded(segmentation):
    """A mask from compressed run lengths: the digits of COCO's maskApi.c."""
    runs, text = [], segmentation["counts"].encode()
    while text:
        run = shift = 0
        more = True
        while more:
            digit, text = text[0] - 48, text[1:]
            run |= (digit & 31) << shift
            more, shift = bool(digit & 32), shift + 5
        if digit & 16:
            run -= 1 << shift
        runs.append(run + (runs[-2] if len(runs) > 2 else 0))
    height, width = segmentation["size"]
    assert sum(runs) == height * width
    return np.repeat(np.arange(len(runs)) % 2, runs).reshape(width, height).T == 1


def test_coco(exported, frames):
    found = json.loads((exported / "coco/annotations/instances.json").read_text())
    assert {"info", "licenses", "images", "categories", "annotations"} == set(found)
    assert [c["name"] for c in found["categories"]] == ["ball"]
    images, annotations = {each["id"]: each for each in found["images"]}, found["annotations"]
    assert len({a["id"] for a in annotations}) == len(annotations)
    assert [(i["clip"], i["frame"]) for i in found["images"]] == [(c, f) for c in (0, 1) for f in range(40)]
    seen = set()
    for each in annotations:
        image = images[each["image_id"]]
        frame = frames[image["clip"]][image["frame"]]
        mask = decoded(each["segmentation"])
        np.testing.assert_array_equal(mask, frame.labels == each["track_id"] + 1)
        assert (each["area"], each["iscrowd"], each["category_id"]) == (mask.sum(), 0, 1)
        left, top, width, height = each["bbox"]
        rows, columns = np.nonzero(mask)  # the middles of pixels lie half a pixel further
        assert left <= columns.min() + 0.5 <= columns.max() + 0.5 <= left + width
        assert top <= rows.min() + 0.5 <= rows.max() + 0.5 <= top + height
        assert max(left, top) >= 0
        assert (left + width <= 128.0001) & (top + height <= 64.0001)
        seen.add((image["clip"], image["frame"], each["track_id"]))
    assert seen == {
        (c, f.frame, int(n) - 1) for c in (0, 1) for f in frames[c] for n in np.unique(f.labels) if n
    }  # one annotation of each
    for image in found["images"][::7]:
        picture = cv2.imread(str(exported / "coco/images" / image["file_name"]), cv2.IMREAD_UNCHANGED)
        assert picture.shape == (image["height"], image["width"])
        np.testing.assert_array_equal(picture, frames[image["clip"]][image["frame"]].image // 16)


def test_yolo(exported, frames):
    """As Ultralytics reads it: labels/ for images/ in the path of a picture, .txt for its ending."""
    about = yaml.safe_load((exported / "yolo/data.yaml").read_text())
    assert "path" not in about  # trainers join it to a folder of their own; without it they take that of data.yaml
    assert about["names"] == {0: "ball"}
    for part, clip in (("train", 0), ("val", 1)):
        pictures = sorted((exported / "yolo" / about[part]).iterdir())
        assert len(pictures) == 40
        for path, frame in zip(pictures, frames[clip], strict=True):
            np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), frame.image // 16)
            text = (exported / "yolo/labels" / part / f"{path.stem}.txt").read_text()
            rows = np.array([line.split() for line in text.splitlines()], float)
            assert set(rows[:, 0]) == {0}
            middle, size = rows[:, 1:3] * (128, 64), rows[:, 3:] * (128, 64)
            corners = np.concatenate([middle - size / 2, middle + size / 2], axis=1) - 0.5
            np.testing.assert_allclose(corners, frame.boxes, atol=1e-4)


def test_cell_tracking_challenge(exported, frames):
    """Labels are there in each frame from first to last, and in no other; a parent ends before its child begins."""
    assert sorted(p.name for p in (exported / "ctc").iterdir()) == ["01", "01_GT", "02", "02_GT"]
    for number, clip in enumerate(frames, 1):
        folder = exported / "ctc" / f"{number:02d}_GT"
        rows = np.loadtxt(folder / "TRA/man_track.txt", dtype=int)
        tracks = {label: (first, last, parent) for label, first, last, parent in rows.tolist()}
        assert len(tracks) == len(rows) == 4
        assert sum(parent > 0 for _, _, parent in tracks.values()) == 1
        for first, _, parent in tracks.values():
            assert not parent or tracks[parent][1] < first
        ball_of = {}
        for k, frame in enumerate(clip):
            labels = tifffile.imread(folder / f"TRA/man_track{k:03d}.tif")
            assert labels.dtype == np.uint16
            np.testing.assert_array_equal(labels, tifffile.imread(folder / f"SEG/man_seg{k:03d}.tif"))
            np.testing.assert_array_equal(labels > 0, frame.labels > 0)
            there = {label for label, (first, last, _) in tracks.items() if first <= k <= last}
            assert set(np.unique(labels)) - {0} == there
            for label in there:
                (ball,) = set(frame.labels[labels == label])
                assert ball_of.setdefault(label, ball) == ball
            film = tifffile.imread(exported / "ctc" / f"{number:02d}" / f"t{k:03d}.tif")
            np.testing.assert_array_equal(film, frame.image)
        assert all(ball_of[label] == ball_of[parent] for label, (_, _, parent) in tracks.items() if parent)


def test_a_single_clip_is_for_training_and_for_validation(tmp_path, monkeypatch):
    colour = SCENE | {"camera": SCENE["camera"] | {"colour": True}, "timing": {"frames": 2}}
    dataset = make(tmp_path / "d", monkeypatch, clips=1, scene=colour | {"sensor": {"bits": 8}})
    for kind in ("yolo", "ctc", "gltf"):
        export(dataset, kind, tmp_path / kind, lambda done, total: None)
    assert yaml.safe_load((tmp_path / "yolo/data.yaml").read_text())["val"] == "images/train"
    assert tifffile.imread(tmp_path / "ctc/01/t001.tif").shape == (64, 128)
