"""Shards put together: the bytes of one process, and no other."""

import errno
import hashlib
import json
import shutil

import pytest
from synthcam_stub import make, plan, quiet, sums, with_dots

from synthcam.dataset.files import verify
from synthcam.dataset.generate import generate_dataset
from synthcam.dataset.merge import merge
from synthcam.dataset.recorded_dataset import list_clip_folders
from synthcam_shared.errors import InputError


@pytest.fixture(scope="module")
def shards(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shards")
    with pytest.MonkeyPatch.context() as patch:
        for k in (1, 2, 3):
            make(folder / f"part{k}", patch, clips=5, shard=(k, 3))
    return folder


@pytest.fixture
def parts(shards, tmp_path, monkeypatch):
    """Copies of three shards, which a test may damage, and the pictures of the others that it makes."""
    with_dots(monkeypatch)
    return [shutil.copytree(shards / f"part{k}", tmp_path / f"part{k}") for k in (1, 2, 3)]


def test_shards_share_the_clips(parts):
    found = [[int(c.name) for c in list_clip_folders(p)] for p in parts]
    assert found == [[0, 3], [1, 4], [2]]
    for part in parts:
        assert verify(part).problems == ()
        assert not (part / "truth/clips.parquet").exists()


def test_merged_they_are_the_whole(parts, tmp_path, monkeypatch):
    whole = make(tmp_path / "whole", monkeypatch, clips=5)
    assert merge([parts[2], parts[0], parts[1]], tmp_path / "d", quiet) == 5
    assert sums(tmp_path / "d") == sums(whole)
    assert verify(tmp_path / "d").problems == ()
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "d").rglob("*")}
    merge(parts, tmp_path / "d", quiet)
    assert {p: p.stat().st_mtime_ns for p in (tmp_path / "d").rglob("*")} == before


def test_stopped_it_goes_on(parts, tmp_path, monkeypatch):
    whole = make(tmp_path / "whole", monkeypatch, clips=5)

    def stop(done, total):
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        merge(parts, tmp_path / "d", stop)
    assert not (tmp_path / "d").exists()
    ticks = []
    merge(parts, tmp_path / "d", lambda done, total: ticks.append(done))
    assert ticks == [3, 4, 5]
    assert sums(tmp_path / "d") == sums(whole)


def test_truth_is_withheld_on_the_way(parts, tmp_path, monkeypatch):
    whole = make(tmp_path / "whole", monkeypatch, withheld=tmp_path / "truth", clips=5)
    merge(parts, tmp_path / "d", quiet, tmp_path / "t")
    assert sums(tmp_path / "d") == sums(whole)
    assert sums(tmp_path / "t") == sums(tmp_path / "truth")


def test_a_shard_is_missing_or_there_twice(parts, tmp_path):
    with pytest.raises(InputError, match="shard 2/3 is missing among the 2 given"):
        merge([parts[0], parts[2]], tmp_path / "d", quiet)
    with pytest.raises(InputError, match="shard 1/3 is given twice"):
        merge([*parts, parts[0]], tmp_path / "d", quiet)
    assert not list(tmp_path.glob("d*"))


def test_shards_of_different_datasets(parts, tmp_path, monkeypatch):
    other = make(tmp_path / "other", monkeypatch, clips=5, seed=6, shard=(3, 3))
    with pytest.raises(InputError, match=r"other: a shard of another dataset than .*part1 \(another seed\)"):
        merge([*parts[:2], other], tmp_path / "d", quiet)
    other = make(tmp_path / "half", monkeypatch, clips=5, shard=(2, 2))
    with pytest.raises(InputError, match=r"half: shard 2/2, expected one of 3"):
        merge([*parts[:2], other], tmp_path / "d", quiet)


def test_what_is_no_finished_shard(parts, tmp_path, monkeypatch):
    whole = make(tmp_path / "whole", monkeypatch)
    for folder in (whole, tmp_path, tmp_path / "none"):
        with pytest.raises(InputError, match="not a finished shard"):
            merge([folder], tmp_path / "d", quiet)
    (parts[0] / "truth/shard.json").write_text("{")
    with pytest.raises(InputError, match=r"shard\.json: damaged"):
        merge(parts, tmp_path / "d", quiet)


def test_a_file_that_changed_is_not_merged(parts, tmp_path):
    file = parts[1] / "clips/000004/camera.json"
    file.write_text(file.read_text() + " ")
    with pytest.raises(InputError, match=r"000004/camera\.json: changed since its shard was made"):
        merge(parts, tmp_path / "d", quiet)
    file.unlink()
    with pytest.raises(InputError, match=r"000004/camera\.json: missing"):
        merge(parts, tmp_path / "d", quiet)
    assert not (tmp_path / "d").exists()
    assert not list(tmp_path.glob("d.partial/clips/*.tmp"))


def test_verify_counts_a_shards_clips(parts):
    shutil.rmtree(parts[0] / "clips/000003")
    lines = [x for x in sums(parts[0]).splitlines(True) if "000003" not in x]
    (parts[0] / "SHA256SUMS").write_text("".join(lines))
    assert verify(parts[0]).problems == ("clips/: 1 folders for 2 clips of the shard",)


def test_machines_that_draw_otherwise_are_named(parts, tmp_path):
    path = parts[1] / "truth/shard.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"gl": {"renderer": "another"}}))
    merge(parts, tmp_path / "d", quiet)
    about = json.loads((tmp_path / "d/truth/dataset.json").read_text())
    assert [d["gl"]["renderer"] for d in about["drawn_by"]] == ["dots", "another"]


def test_a_shard_does_not_go_on_as_the_whole(parts, tmp_path):
    with pytest.raises(InputError, match="holds a dataset made with another shard"):
        generate_dataset(plan(clips=5), parts[0], 1, quiet)
    with pytest.raises(InputError, match="holds a dataset made with another shard"):
        generate_dataset(plan(clips=5, shard=(2, 3)), parts[0], 1, quiet)


HOSTILE = [
    {"clips": 5},
    {"clips": ["../../x"]},
    {"clips": [0, 3, 6]},
    {"shard": 5},
    {"shard": [0, 3]},
    {"shard": ["1", "3"]},
    {"clips_per_scene": 10**30},
    {"clips_per_scene": "5"},
    {"scenes": 5},
    {"scenes": [5]},
    {"scenes": [{"name": 5}]},
    {"gl": "a renderer"},
    {"drawn_by": [1]},
    {"seed": -1},
    {"video": "yes"},
    {"version": 5},
]


def test_a_hostile_shard_is_one_line(parts, tmp_path):
    path = parts[0] / "truth/shard.json"
    about = json.loads(path.read_text())
    for text in (*(json.dumps(about | hostile) for hostile in HOSTILE), "[" * 200_000, "5", "[]", "1" * 5000):
        path.write_text(text)
        with pytest.raises(InputError, match=r"part1|shard\.json: damaged") as error:
            merge(parts, tmp_path / "d", quiet)
        assert "\n" not in str(error.value)
    assert not list(tmp_path.glob("d*"))


def test_a_link_out_of_a_shard_is_not_followed(parts, tmp_path):
    for what in ("camera.json", "truth", ""):
        inside, outside = parts[1] / "clips/000004" / what, tmp_path / "secret"
        inside.rename(outside)
        inside.symlink_to(outside)
        with pytest.raises(InputError, match=r"000004/.*: leads out of its place by a link"):
            merge(parts, tmp_path / "d", quiet)
        inside.unlink()
        outside.rename(inside)
    assert not (tmp_path / "d").exists()


def test_a_list_that_leads_elsewhere(parts, tmp_path):
    """Two slashes made the rest of the name an absolute path, to which the file was copied."""
    out, before = tmp_path / "stolen", sums(parts[1])
    for name in (f"clips/000004/{out}/x", f"clips/000004//{out}/x", "clips/000004/x"):
        source = parts[1] / "clips/000004" / name.removeprefix("clips/000004").lstrip("/")
        source.parent.mkdir(parents=True, exist_ok=True)
        source.write_bytes(b"payload")
        (parts[1] / "SHA256SUMS").write_text(f"{before}{hashlib.sha256(b'payload').hexdigest()}  {name}\n")
        with pytest.raises(InputError, match=r"expected a SHA-256 and a path inside the dataset|not a file of a clip"):
            merge(parts, tmp_path / "d", quiet)
        assert not out.exists()


def test_shards_stay_as_they_are(parts):
    with pytest.raises(InputError, match="expected a folder outside the shard"):
        merge(parts, parts[0] / "whole", quiet)


def test_a_full_disk_while_merging(parts, tmp_path, monkeypatch):
    def full(source, target, digest):
        target.write_bytes(b"half")
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("synthcam.dataset.merge._copy", full)
        with pytest.raises(InputError, match=r"d\.partial: No space left on device; the same command continues"):
            merge(parts, tmp_path / "d", quiet)
    assert not list(tmp_path.glob("d*"))
