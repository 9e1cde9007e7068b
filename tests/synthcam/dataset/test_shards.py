"""Shards of a stream: what they hold, and the same bytes however a run was interrupted or made longer."""

import json
import tarfile

import cv2
import numpy as np
import pytest
import tifffile
from synthcam_stub import SCENE, film

import synthcam
from synthcam.dataset.shards import ShardPlan, plan_shards, write_shards
from synthcam.scene.clip import Clip
from synthcam.scene.scene import check_scene
from synthcam_shared.errors import InputError
from synthcam_shared.job_result import LostJob


@pytest.fixture(autouse=True)
def dots(monkeypatch):
    monkeypatch.setattr(Clip, "pictures", film)


def quiet(done, total):
    pass


def plan(clips=5, kind="webdataset", **more):
    return ShardPlan(check_scene(SCENE | more, "s.yaml"), 3, clips, 2, 5, kind)


def write(plan, folder, progress=quiet):
    return write_shards(plan, folder, 1, progress)


def contents(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def frames(plan):
    return list(synthcam.stream(plan.scene, plan.seed, stop=plan.clips, every=plan.every))


@pytest.mark.parametrize("bits", [8, 12])
def test_tar_files_as_webdataset_reads_them(tmp_path, bits):
    """Files of one sample follow each other, and have one name up to the first dot."""
    wanted = plan(sensor={"bits": bits})
    done = []
    assert write(wanted, tmp_path / "s", lambda *counts: done.append(counts)).frames == 20
    assert done == [(0, 5), (2, 5), (4, 5), (5, 5)]
    assert sorted(p.name for p in tmp_path.glob("s/*.tar")) == [f"shard-{k:06d}.tar" for k in range(3)]
    samples = []
    for path in sorted(tmp_path.glob("s/*.tar")):
        with tarfile.open(path) as tar:
            for member in tar:
                key, _, end = member.name.partition(".")
                if not samples or samples[-1]["key"] != key:
                    samples.append({"key": key})
                samples[-1][end] = tar.extractfile(member).read()
    image = "png" if bits == 8 else "tif"
    for sample, frame in zip(samples, frames(wanted), strict=True):
        assert sample.keys() == {"key", image, "labels.png", "json"}
        assert sample["key"] == f"{frame.clip.number:06d}-{frame.frame:06d}"
        labels = cv2.imdecode(np.frombuffer(sample["labels.png"], np.uint8), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(labels, frame.labels)
        (tmp_path / "image").write_bytes(sample[image])
        read = cv2.imread(str(tmp_path / "image"), -1) if bits == 8 else tifffile.imread(tmp_path / "image")
        np.testing.assert_array_equal(read, frame.image)
        truth = json.loads(sample["json"])
        assert (truth["scene"], truth["seed"], truth["clip"], truth["frame"]) == (
            "stub",
            3,
            frame.clip.number,
            frame.frame,
        )
        assert truth["camera"] == frame.clip.camera_json
        assert [ball["id"] for ball in truth["balls"]] == frame.ids.tolist()
        assert [ball["visible"] for ball in truth["balls"]] == frame.visible.tolist()
        np.testing.assert_allclose([ball["centre"] for ball in truth["balls"]], frame.centres, atol=1e-6)
        np.testing.assert_allclose([ball["box"] for ball in truth["balls"]], frame.boxes, atol=1e-6)


def test_zarr_stores(tmp_path):
    zarr = pytest.importorskip("zarr", reason="zarr is not installed: synthcam[zarr]")
    wanted = plan(kind="zarr")
    write(wanted, tmp_path / "s")
    every = iter(frames(wanted))
    for shard in range(3):
        group = zarr.open_group(tmp_path / f"s/shard-{shard:06d}.zarr", mode="r")
        balls = {name: array[:] for name, array in group["balls"].arrays()}
        assert group["image"].metadata.dimension_names == ("sample", "y", "x")
        for k in range(len(group["clip"][:])):
            frame, own = next(every), balls["sample"] == k
            assert (group["clip"][k], group["frame"][k]) == (frame.clip.number, frame.frame)
            for name, value in (("image", group["image"][k]), ("labels", group["labels"][k])):
                np.testing.assert_array_equal(value, getattr(frame, name))
            for name, field in (("id", "ids"), ("centre", "centres"), ("box", "boxes"), ("visible", "visible")):
                np.testing.assert_array_equal(balls[name][own], getattr(frame, field))
            assert group.attrs["cameras"][str(frame.clip.number)] == frame.clip.camera_json
    assert next(every, None) is None


@pytest.mark.parametrize("kind", ["webdataset", "zarr"])
def test_a_run_continues_and_goes_further(tmp_path, kind):
    if kind == "zarr":
        pytest.importorskip("zarr", reason="zarr is not installed: synthcam[zarr]")
    write(plan(5, kind), tmp_path / "once")

    def stop(done, total):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write(plan(3, kind), tmp_path / "s", stop)
    ending = "tar" if kind == "webdataset" else "zarr"
    assert sorted(p.name for p in (tmp_path / "s").iterdir()) == [".made_by", f"shard-000000.{ending}", "stream.json"]
    (tmp_path / "s" / f"shard-000001.{ending}-0123456789ab.tmp").touch()  # of a killed run
    assert write(plan(3, kind), tmp_path / "s").shards == 1
    assert write(plan(3, kind), tmp_path / "s").shards == 0
    assert write(plan(5, kind), tmp_path / "s").shards == 2  # the second had one clip of two
    assert contents(tmp_path / "s") == contents(tmp_path / "once")
    assert write(plan(1, kind), tmp_path / "s").shards == 0
    assert contents(tmp_path / "s") == contents(tmp_path / "once")


def test_a_stream_without_end_is_the_beginning_of_no_other(tmp_path):
    def stop(done, total):
        assert total == 0
        if done == 6:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write(plan(None), tmp_path / "s", stop)
    assert len(list(tmp_path.glob("s/*.tar"))) == 3
    write(plan(6), tmp_path / "six")
    for path in tmp_path.glob("six/*.tar"):
        assert (tmp_path / "s" / path.name).read_bytes() == path.read_bytes()


@pytest.mark.parametrize(
    ("other", "what"),
    [({"launch": {"v0": 0.2}}, "scene"), ({"seed": 4}, "--seed"), ({"every": 2}, "--every")],
)
def test_another_stream_has_another_folder(tmp_path, other, what):
    write(plan(1), tmp_path / "s")
    scene = check_scene(SCENE | {k: v for k, v in other.items() if k == "launch"}, "s.yaml")
    wrong = ShardPlan(scene, other.get("seed", 3), 1, 2, other.get("every", 5))
    with pytest.raises(InputError, match=f"holds a stream made with another {what}; choose another folder"):
        write(wrong, tmp_path / "s")


def test_the_number_of_clips_follows_from_that_of_frames():
    scene = check_scene(SCENE, "s.yaml")
    made = plan_shards(scene, 0, 41, None, None, 5, "webdataset")
    assert (made.clips, made.clips_per_shard) == (11, 250)  # 4 frames of each clip
    assert plan_shards(scene, 0, None, None, None, 1, "webdataset").clips is None


def test_clips_that_cannot_be_made_are_listed(tmp_path, monkeypatch):
    bad = {0, 1, 4}

    def draw(clip, every):
        if clip.number in bad:
            raise ValueError("no motion")
        return film(clip, every)

    monkeypatch.setattr(Clip, "pictures", draw)
    outcome = write(plan(), tmp_path / "s")
    assert outcome.left_out == tuple(f"clip {k} is left out: no motion" for k in (0, 1, 4))
    assert [p.name for p in tmp_path.glob("s/*.tar")] == ["shard-000001.tar"]
    bad |= set(range(30))
    with pytest.raises(InputError, match=r"no clip could be made; clip 9 is left out: no motion$"):
        write(plan(30), tmp_path / "none")


def test_a_lost_shard_leaves_nothing_that_workers_were_at(tmp_path, monkeypatch):
    def lose_first(*asked, **options):
        try:
            yield LostJob(0, "its worker was killed")
        finally:  # what another worker has written until it is ended
            (tmp_path / "s" / "shard-000001.tar-0123456789ab.tmp").touch()

    monkeypatch.setattr("synthcam.dataset.shards.run_jobs", lose_first)
    with pytest.raises(InputError, match=r"shard 0: its worker was killed$"):
        write(plan(), tmp_path / "s")
    assert not list(tmp_path.glob("s/*.tmp"))
