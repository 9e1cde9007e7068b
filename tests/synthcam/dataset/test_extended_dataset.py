"""A dataset that gets more clips keeps those that it has, byte for byte, and is whole at every moment."""

import shutil

import pytest
from synthcam_stub import plan, sums

from synthcam.dataset import generate, partial_dataset
from synthcam.dataset.files import SUMS, verify
from synthcam.dataset.generate import GenerationPlan, generate_dataset
from synthcam.dataset.recorded_dataset import list_clip_folders
from synthcam.scene.scene import Scene
from synthcam_shared.errors import InputError


def quiet(done, of):
    pass


def made(folder, clips, withheld=None, **more):
    return generate_dataset(plan(clips, video=False, **more), folder, 1, quiet, withheld).made


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    made(folder / "d", 5)
    made(folder / "open", 5, folder / "secret")
    return folder


def test_more_clips_are_added_to_those_that_are_there(tmp_path, whole, monkeypatch):
    drawn, write = [], generate.write_clip
    made(tmp_path / "d", 3)
    monkeypatch.setattr(
        generate, "write_clip", lambda folder, clip, *a: (drawn.append(clip.number), write(folder, clip, *a))
    )
    assert made(tmp_path / "d", 5) == 2
    assert drawn == [3, 4]
    assert sums(tmp_path / "d") == sums(whole / "d")
    assert verify(tmp_path / "d").problems == ()
    assert [p.name for p in tmp_path.iterdir()] == ["d"]
    assert made(tmp_path / "d", 5) == 0


def test_withheld_truth_grows_with_its_dataset(tmp_path, whole):
    made(tmp_path / "open", 2, tmp_path / "secret")
    assert made(tmp_path / "open", 5, tmp_path / "secret") == 3
    for name in ("open", "secret"):
        assert sums(tmp_path / name) == sums(whole / name)
        assert verify(tmp_path / name).problems == ()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["open", "secret"]


def test_the_old_dataset_stays_until_the_new_one_is_complete(tmp_path, whole, monkeypatch):
    made(tmp_path / "d", 2)
    before, write = sums(tmp_path / "d"), generate.write_clip

    def stop(folder, clip, *rest):
        if clip.number == 4:
            raise KeyboardInterrupt
        write(folder, clip, *rest)

    monkeypatch.setattr(generate, "write_clip", stop)
    with pytest.raises(KeyboardInterrupt):
        made(tmp_path / "d", 5)
    assert sums(tmp_path / "d") == before
    assert verify(tmp_path / "d").problems == ()
    monkeypatch.setattr(generate, "write_clip", write)
    assert made(tmp_path / "d", 5) == 1
    assert sums(tmp_path / "d") == sums(whole / "d")


@pytest.mark.parametrize("at", [0, 1, 2, 3])
def test_a_kill_between_two_moves_loses_nothing(tmp_path, whole, monkeypatch, at):
    """Four moves put truth and dataset in place of smaller ones."""
    made(tmp_path / "open", 2, tmp_path / "secret")
    moves, rename = [], type(tmp_path).rename

    def killed(path, target):
        if path.name.partition(".")[0] in ("open", "secret"):
            if len(moves) == at:
                raise KeyboardInterrupt
            moves.append(path.name)
        return rename(path, target)

    monkeypatch.setattr(type(tmp_path), "rename", killed)
    with pytest.raises(KeyboardInterrupt):
        made(tmp_path / "open", 5, tmp_path / "secret")
    monkeypatch.setattr(type(tmp_path), "rename", rename)
    assert made(tmp_path / "open", 5, tmp_path / "secret") == 0
    for name in ("open", "secret"):
        assert sums(tmp_path / name) == sums(whole / name)
        assert verify(tmp_path / name).problems == ()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["open", "secret"]


def test_an_interrupted_dataset_may_end_with_more_clips(tmp_path, whole, monkeypatch):
    monkeypatch.setattr(partial_dataset.PartialDataset, "publish", lambda self: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        made(tmp_path / "d", 2)
    monkeypatch.undo()
    assert made(tmp_path / "d", 5) == 3
    assert sums(tmp_path / "d") == sums(whole / "d")


def test_a_file_system_without_links_copies(tmp_path, whole, monkeypatch):
    made(tmp_path / "d", 2)
    monkeypatch.setattr(partial_dataset.os, "link", lambda *a: (_ for _ in ()).throw(OSError("no links")))
    made(tmp_path / "d", 5)
    assert sums(tmp_path / "d") == sums(whole / "d")


def test_fewer_clips_another_seed_and_several_scenes_are_refused(tmp_path, whole):
    shutil.copytree(whole / "d", tmp_path / "d")
    with pytest.raises(InputError, match=r"another number of clips \(5\); only more clips of a single scene"):
        made(tmp_path / "d", 4)
    with pytest.raises(InputError, match="another seed"):
        made(tmp_path / "d", 6, seed=9)
    two = Scene.build("one", timing={"frames": 5}), Scene.build("two", timing={"frames": 5})
    generate_dataset(GenerationPlan(two, 1, 0, False), tmp_path / "two", 1, quiet)
    with pytest.raises(InputError, match="only more clips of a single scene"):
        generate_dataset(GenerationPlan(two, 2, 0, False), tmp_path / "two", 1, quiet)
    assert len(list_clip_folders(tmp_path / "two")) == 2
    assert (tmp_path / "two" / SUMS).is_file()
