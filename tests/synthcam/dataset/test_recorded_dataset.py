"""Reading a dataset in Python: lengths, frames one at a time, camera and truth, and what is refused."""

import dataclasses
import json
import shutil

import numpy as np
import pandas as pd
import pytest
import tifffile
from synthcam_stub import film, make, plan

import synthcam
import tracker
from synthcam.dataset.generate import GenerationPlan, generate_dataset
from synthcam_shared.errors import InputError


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("data")
    with pytest.MonkeyPatch.context() as patch:
        make(out / "d", patch)
        make(out / "zstd", patch, compression="zstd")
        make(out / "open", patch, out / "secret")
    return out


def test_its_clips_have_film_camera_and_truth(folder):
    dataset = synthcam.open_dataset(folder / "d")
    assert len(dataset) == 4
    assert [clip.number for clip in dataset] == [0, 1, 2, 3]
    for k, clip in enumerate(dataset):
        drawn = plan().clip(k)
        assert clip.truth["r"] == drawn.truth["r"]
        assert clip.camera_json == json.loads(json.dumps(drawn.camera_json))
        pd.testing.assert_frame_equal(clip.tracks, drawn.tracks)
        np.testing.assert_array_equal(np.asarray(clip.film()), np.stack(list(film(drawn))))
        assert clip.events["kind"].tolist() == drawn.solve().events["kind"].tolist()
    assert dataset.truth["clip"].tolist() == [0, 1, 2, 3]
    assert dataset.about["seed"] == 5
    assert "4 clips" in repr(dataset)
    assert "20 frames" in repr(dataset[0])


@pytest.mark.parametrize("name", ["d", "zstd"])
def test_frames_are_read_when_they_are_asked_for(folder, name, monkeypatch):
    expected, read = np.stack(list(film(plan().clip(1)))), []
    stack = synthcam.open_dataset(folder / name)[1].film()
    asarray = tifffile.TiffPage.asarray
    frame = tifffile.TiffFrame.asarray
    monkeypatch.setattr(tifffile.TiffPage, "asarray", lambda page: (read.append(page.index), asarray(page))[1])
    monkeypatch.setattr(tifffile.TiffFrame, "asarray", lambda page: (read.append(page.index), frame(page))[1])
    assert len(stack) == 20
    np.testing.assert_array_equal(stack[7], expected[7])
    np.testing.assert_array_equal(stack[-1], expected[-1])
    assert set(read) == {7, 19}
    np.testing.assert_array_equal(np.stack(stack[3:9:2]), expected[3:9:2])
    with pytest.raises(IndexError):
        _ = stack[20]


def test_indices_and_slices_are_those_of_a_list(folder):
    dataset = synthcam.open_dataset(str(folder / "d"))
    assert dataset[-1].number == 3
    assert [clip.number for clip in dataset[1:3]] == [1, 2]
    with pytest.raises(IndexError):
        _ = dataset[4]


def test_a_clip_goes_straight_into_the_tracker(folder):
    """A dot is where each ball is, so that positions agree with the truth within a pixel."""
    clip = synthcam.open_dataset(folder / "d")[2]
    found = tracker.track(clip.film(), clip.camera_json, detector="centroid", number=clip.number).tracks
    assert found["frame"].max() == 19
    true = clip.tracks[clip.tracks["frame"] == 5][["x_px", "y_px"]].to_numpy()
    near = np.hypot(*(found[found["frame"] == 5][["glint_x", "glint_y"]].to_numpy()[:, None] - true).T).min(axis=1)
    assert (near < 1).all()


def test_many_bodies_have_energies_and_two_have_none(folder, tmp_path):
    clip = synthcam.open_dataset(folder / "d")[0]
    with pytest.raises(InputError, match=r"energy\.parquet: missing"):
        _ = clip.energy
    table = pd.DataFrame({"frame": [0, 1], "energy": [2.0, 1.0]})
    table.to_parquet(tmp_path / "energy.parquet")
    pd.testing.assert_frame_equal(dataclasses.replace(clip, secret=tmp_path).energy, table)


def test_withheld_truth_is_asked_for(folder):
    blind = synthcam.open_dataset(folder / "open")
    assert (len(blind), blind[1].frames, len(blind[1].film())) == (4, 20, 20)
    assert blind[1].truth == {}
    for asked in (lambda: blind.truth, lambda: blind[1].tracks, lambda: blind[1].events):
        with pytest.raises(InputError, match="truth is withheld; open_dataset takes the folder"):
            asked()
    seen = synthcam.open_dataset(folder / "open", folder / "secret")
    assert seen[3].truth["b"] == plan().clip(3).truth["b"]


def test_what_is_no_dataset_is_refused(folder, tmp_path):
    with pytest.raises(InputError, match="nowhere: no such folder"):
        synthcam.open_dataset(tmp_path / "nowhere")
    with pytest.raises(InputError, match="with a folder `clips`"):
        synthcam.open_dataset(tmp_path)
    with pytest.raises(InputError, match=r"no truth/clips\.parquet in it"):
        synthcam.open_dataset(folder / "open", tmp_path)
    shard = GenerationPlan(plan().scenes, 4, 5, False, shard=(1, 2))
    generate_dataset(shard, tmp_path / "shard", 1, lambda done, of: None)
    with pytest.raises(InputError, match="one shard, expected a dataset; `synthcam merge`"):
        synthcam.open_dataset(tmp_path / "shard")


def test_damage_is_one_line_with_its_file(folder, tmp_path):
    shutil.copytree(folder / "d", tmp_path / "d")
    dataset, clip = synthcam.open_dataset(tmp_path / "d"), tmp_path / "d/clips/000001"
    (clip / "camera.json").write_text("{")
    (clip / "truth/tracks.parquet").unlink()
    (clip / "frames.tif").write_bytes(b"II*\0nothing")
    for asked, said in (
        (lambda: dataset[1].camera_json, "000001: damaged"),
        (lambda: dataset[1].tracks, "tracks.parquet: missing; `synthcam verify`"),
        (lambda: dataset[1].film()[0], "frames.tif: damaged"),
    ):
        with pytest.raises(InputError, match=said) as error:
            asked()
        assert "\n" not in str(error.value)
    (clip / "frames.tif").unlink()
    with pytest.raises(InputError, match="expected a dataset with video"):
        dataset[1].film()
    shutil.rmtree(clip)
    with pytest.raises(InputError, match="3 clips for 4 rows of its truth"):
        len(synthcam.open_dataset(tmp_path / "d"))
