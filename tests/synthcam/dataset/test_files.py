"""A dataset's files, written and held to their checksums."""

import json
import re

import numpy as np
import pandas as pd
import pytest
import tifffile

from synthcam.dataset.files import finish_dataset, hash_file, verify, write_clip
from synthcam.dataset.recorded_dataset import list_clip_folders
from synthcam.scene.scene import check_scene
from synthcam_shared.errors import InputError

SCENE = check_scene(
    {
        "name": "small",
        "launch": {"v0": {"uniform": [0.2, 0.5]}, "b": 0.2, "striker": "a"},
        "timing": {"frames": 12, "contact_frame": 5},
        "camera": {"size": [64, 48], "scale": 1.6e-3, "tilt": [0.01, 0]},
        "sensor": {"bits": 12},
        "effects": {"plate_tilt": {"x": 1e-4}},
    },
    "x",
)
ABOUT = {"version": "0", "seed": 3, "gl": {"renderer": "none"}}


def frames_of(clip, seed=0):
    rng = np.random.default_rng(seed)
    for _ in range(clip.frames):
        yield rng.integers(0, 4096, clip.camera.size[::-1], dtype=np.uint16)


@pytest.fixture
def dataset(tmp_path):
    for k in range(2):
        clip = SCENE.draw(k, 3)
        write_clip(tmp_path / "clips" / f"{k:06d}", clip, frames_of(clip))
    finish_dataset(tmp_path, ABOUT)
    return tmp_path


def test_the_files_of_the_contract(dataset):
    found = {p.relative_to(dataset).as_posix() for p in dataset.rglob("*") if p.is_file()}
    each = ["frames.tif", "camera.json", "truth/scene.json", "truth/tracks.parquet", "truth/events.parquet"]
    top = {"README.md", "SHA256SUMS", "truth/dataset.json", "truth/clips.parquet"}
    assert found == top | {f"clips/{k:06d}/{name}" for k in range(2) for name in each}


def test_all_truth_lies_under_truth(dataset):
    """Files that a tracker may open contain nothing that it has to find."""
    secret = set("v0 b r s mu_k C tau1 tau2 v1f v2f restitution heading plate_tilt glint_peak".split())
    camera = (dataset / "clips/000000/camera.json").read_text()
    assert not secret & set(re.findall(r'"(\w+)"', camera))
    with tifffile.TiffFile(dataset / "clips/000000/frames.tif") as tif:
        assert "plate_tilt" not in str(tif.imagej_metadata)
        assert "v0" not in (tif.imagej_metadata or {})


def test_camera_json(dataset):
    camera = json.loads((dataset / "clips/000000/camera.json").read_text())
    keys = "K dist R t size fps exposure scale ball_diameter striker lamp psf sensor"
    assert list(camera) == keys.split()
    assert np.shape(camera["K"]) == np.shape(camera["R"]) == (3, 3)
    assert (len(camera["dist"]), len(camera["t"]), camera["size"]) == (5, 3, [64, 48])
    assert camera["striker"] == "a"
    assert set(camera["sensor"]) == set("bits gain read_noise dark prnu dsnu full_well black_level".split())
    assert camera == json.loads(json.dumps(SCENE.draw(0, 3).camera_json))
    assert camera["K"][0][0] == pytest.approx((0.5 - 1.19e-3) / 1.6e-3)


def test_frames_come_back_bit_for_bit(dataset):
    stack = tifffile.imread(dataset / "clips/000001/frames.tif")
    assert stack.shape == (12, 48, 64)
    assert stack.dtype == np.uint16
    np.testing.assert_array_equal(stack, np.array(list(frames_of(SCENE.draw(1, 3)))))


@pytest.mark.parametrize("wrong", [lambda frames: frames[1:], lambda frames: [f.astype("u1") for f in frames]])
def test_frames_that_are_not_the_clips_are_refused(tmp_path, wrong):
    clip = SCENE.draw(0, 3)
    with pytest.raises(RuntimeError, match="expected 12 frames of uint16, 64 x 48"):
        write_clip(tmp_path / "0", clip, iter(wrong(list(frames_of(clip)))))


def test_clips_parquet(dataset):
    table = pd.read_parquet(dataset / "truth/clips.parquet")
    columns = (
        "clip seed_key scene v0 b u2ix u2iy side2i t_c r s mu_k C drag decel tau1 tau2 v1f v2f energy_fraction "
        "momentum_fraction final_angle w1n w1t w2n w2t striker effects frames_sha256 pixels_sha256"
    )
    assert list(table) == columns.split()
    assert table["clip"].tolist() == [0, 1]
    assert table.seed_key.tolist() == ["3/0", "3/1"]
    assert json.loads(table.effects[0]) == {"plate_tilt": {"x": 1e-4, "y": 0.0}}
    assert table.frames_sha256[0] == hash_file(dataset / "clips/000000/frames.tif")
    assert table.pixels_sha256.nunique() == 1  # the same noise twice
    assert table.v0.between(0.2, 0.5).all()


def test_scene_json_makes_the_clip_again(dataset):
    drawn = json.loads((dataset / "clips/000001/truth/scene.json").read_text())["drawn"]
    again = check_scene(drawn, "again").draw(0, 99)
    tracks = pd.read_parquet(dataset / "clips/000001/truth/tracks.parquet")
    np.testing.assert_array_equal(
        again.view.motion.at(tracks.t_s[:12].to_numpy())[0, :, 0], tracks.x[tracks.particle == 0]
    )


def test_one_ball_alone_has_gaps_not_zeros(tmp_path):
    clip = check_scene({"launch": {"kind": "single"}, "timing": {"frames": 3, "contact_frame": 1}}, "x").draw(0, 0)
    write_clip(tmp_path / "clips" / "000000", clip, None)
    finish_dataset(tmp_path, ABOUT | {"gl": {}})
    table = pd.read_parquet(tmp_path / "truth/clips.parquet")
    assert table.r.isna().all()
    assert table.r.dtype == float
    assert table.v0[0] == pytest.approx(0.3)
    assert len(pd.read_parquet(tmp_path / "clips/000000/truth/events.parquet")) == 0
    assert "NaN" not in (tmp_path / "clips/000000/truth/scene.json").read_text()
    assert verify(tmp_path).problems == ()


def test_verify_as_written(dataset):
    found = verify(dataset)
    assert found.problems == ()
    assert found.files == 13
    for line in (dataset / "SHA256SUMS").read_text().splitlines():
        assert re.fullmatch(r"[0-9a-f]{64}  [\w./]+", line)  # what sha256sum -c reads


def flip(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


@pytest.mark.parametrize(
    "name", ["clips/000001/frames.tif", "clips/000000/camera.json", "truth/clips.parquet", "README.md"]
)
def test_verify_finds_a_flipped_bit_and_a_missing_file(dataset, name):
    flip(dataset / name)
    assert verify(dataset).problems == (f"{name}: changed (its SHA-256 is not the one recorded)",)
    (dataset / name).unlink()
    assert verify(dataset).problems == (f"{name}: missing",)


def test_verify_finds_a_bit_that_flipped_before_the_checksums_were_written(dataset):
    flip(dataset / "clips/000001/frames.tif")
    finish_dataset(dataset, ABOUT)
    assert verify(dataset).problems == ("clips/000001/frames.tif: changed (its SHA-256 is not the one recorded)",)


def test_verify_finds_what_is_new(dataset):
    (dataset / "clips/000001/notes.txt").write_text("mine")
    assert verify(dataset).problems == ("clips/000001/notes.txt: not listed in SHA256SUMS",)


def test_verify_finds_a_whole_clip_gone_from_the_list_too(dataset):
    sums = dataset / "SHA256SUMS"
    sums.write_text("".join(x for x in sums.read_text().splitlines(True) if "clips/000001" not in x))
    for p in sorted((dataset / "clips/000001").rglob("*"), reverse=True):
        p.rmdir() if p.is_dir() else p.unlink()
    (dataset / "clips/000001").rmdir()
    assert verify(dataset).problems == ("clips/: 1 folders for 2 rows of truth/clips.parquet",)


@pytest.mark.parametrize("line", ["nonsense", f"{'0' * 64}  ../escape", f"{'0' * 64}  /etc/hostname"])
def test_verify_refuses_a_list_that_leads_elsewhere(dataset, line):
    (dataset / "SHA256SUMS").write_text(line + "\n")
    with pytest.raises(InputError, match="line 1: expected a SHA-256 and a path inside the dataset"):
        verify(dataset)


def test_verify_of_what_is_none(tmp_path):
    with pytest.raises(InputError, match="not a finished dataset"):
        verify(tmp_path)
    (tmp_path / "clips" / "000000.tmp").mkdir(parents=True)
    (tmp_path / "clips" / "000001").mkdir()
    assert [p.name for p in list_clip_folders(tmp_path)] == ["000001"]
