"""No command overwrites a file that it has not made, or one that it reads."""

import json
import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import tifffile
from tracker_film import CAMERA, write_dataset

import discrepancy.cli
import synthcam.cli
import tracker.cli
from synthcam.model import read_model
from synthcam_shared.errors import InputError
from synthcam_shared.outputs import (
    UNFINISHED,
    check_not_read,
    check_replaceable,
    open_scratch_folder,
    replace_folder,
    write_atomically,
)
from tracker.pipeline import run as track

MAINS = {"synthcam": synthcam.cli.main, "tracker": tracker.cli.main, "discrepancy": discrepancy.cli.main}
SCENE = "timing: {frames: 4, contact_frame: 2}\ncamera: {size: [64, 48]}\n"


def refused(*words):
    """Run a command that must end with status 2, and return its line."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [str(w) for w in words])
        with pytest.raises(SystemExit) as left:
            MAINS[words[0]]()
    assert left.value.code == 2


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results")
    write_dataset(folder / "dataset", np.random.default_rng(0), clips=1)
    track(folder / "dataset", folder / "results", "centroid", 1)
    return folder / "results"


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A folder with a user's own files."""
    monkeypatch.chdir(tmp_path)
    for name in ("model.yaml", "scene.yaml", "noise.yaml"):
        Path(name).write_text(SCENE if name == "scene.yaml" else "model: {}\n")
    Path("camera.json").write_text(json.dumps(CAMERA))
    table = pd.DataFrame({"clip": 0, "frame": [0, 1], "particle": 0, "x": [1.0, 2.0], "y": 3.0})
    table.to_csv("tracks.csv", index=False)
    return tmp_path


@pytest.mark.parametrize("target", ["tracks.csv", "camera.json", "model.yaml", "noise.yaml"])
def test_add_replaces_neither_its_inputs_nor_other_files(own, target, capsys):
    before = {p.name: p.read_bytes() for p in own.iterdir()}
    words = "--model", "model.yaml", "--fit", "tracks.csv", "--camera", "camera.json"
    refused("discrepancy", "add", "hop", *words, "-o", target)
    err = capsys.readouterr().err
    assert ("the command reads it" if target != "noise.yaml" else "was not made by `discrepancy add`") in err
    assert err.count("\n") == 1
    assert {p.name: p.read_bytes() for p in own.iterdir()} == before


def test_add_replaces_a_model_that_it_made(tmp_path):
    file = tmp_path / "new.yaml"
    write_atomically(file, f"{discrepancy.cli.ADDED} hop\nmodel: {{r: 0.5}}\n")
    assert read_model(file).restitution == 0.5
    check_replaceable(file, discrepancy.cli.ADDED.encode(), "discrepancy add")


@pytest.mark.parametrize("name", ["holiday.png", "holiday.gif", "holiday.mp4"])
def test_preview_keeps_a_foreign_picture(own, name, capsys):
    Path(name).write_bytes(b"a picture of mine")
    refused("synthcam", "preview", "scene.yaml", "-o", name)
    assert "exists and was not made by `synthcam preview`; expected a new file" in capsys.readouterr().err
    assert Path(name).read_bytes() == b"a picture of mine"


def test_preview_replaces_its_own_picture(tmp_path, monkeypatch):
    from synthcam.dataset import preview
    from synthcam.scene.scene import check_scene

    clip = check_scene({"timing": {"frames": 3, "contact_frame": 1}, "camera": {"size": [64, 48]}}, "s").draw()
    monkeypatch.setattr(type(clip), "pictures", lambda self, every=1: iter(np.zeros((3, 48, 64), np.uint8)[::every]))
    first = (
        ("p.png", lambda path: preview.write_preview(clip, path, 0, 0)),
        ("p.gif", lambda path: preview.write_animation(clip, path)),
        ("p.mp4", lambda path: preview.write_animation(clip, path)),
    )
    maps = (
        ("p.png", lambda path: preview.write_motion_map(clip, path)),
        ("p.gif", lambda path: preview.write_motion_map(clip, path)),
    )
    for name, write in (*first, *maps, *first):
        write(tmp_path / name)
        assert (tmp_path / name).stat().st_size > 50


def test_a_drawing_of_an_effect_keeps_a_foreign_picture(own, capsys):
    Path("mine.png").write_bytes(b"mine")
    refused("synthcam", "effects", "hop", "-o", "mine.png")
    assert "mine.png: exists and was not made by `synthcam effects`" in capsys.readouterr().err
    assert Path("mine.png").read_bytes() == b"mine"


@pytest.mark.parametrize("text", ['"calibration"', '["calibration"]', '{"calibration": "mine"}'])
def test_calibrate_knows_its_own_file_by_more_than_a_word(own, text, capsys):
    tifffile.imwrite("film.tif", np.zeros((5, 48, 64), np.uint8))
    Path("notes.json").write_text(text)
    refused("tracker", "calibrate", "film.tif", "--diameter", 2e-3, "--fps", 250, "-o", "notes.json")
    assert "was not made by tracker calibrate" in capsys.readouterr().err
    assert Path("notes.json").read_text() == text


def test_a_report_does_not_replace_a_page_of_the_user(tmp_path):
    """A folder with nothing but an index.html may be anybody's."""
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "index.html").write_text("mine")
    with (
        pytest.raises(InputError, match="holds something else"),
        replace_folder(tmp_path / "site", ("plan.json", "index.html"), "an earlier plan"),
    ):
        pass
    assert (tmp_path / "site" / "index.html").read_text() == "mine"


@pytest.mark.parametrize("command", ["find", "plan"])
def test_a_report_does_not_replace_the_folder_of_its_model(own, results, command, capsys):
    """`discrepancy find --model REPORT/model.yaml -o REPORT` would remove the model that it reads."""
    first = {"find": "discrepancy.json", "plan": "plan.json"}[command]
    Path("report").mkdir()
    Path("report/model.yaml").write_text("")
    Path("report", first).write_text("{}")
    given = results if command == "find" else "scene.yaml"
    refused("discrepancy", command, given, "--model", "report/model.yaml", "-o", "report")
    assert "report: the command reads report/model.yaml in it, and would overwrite it" in capsys.readouterr().err
    assert Path("report", first).read_text() == "{}"


@pytest.mark.parametrize("words", ["tracker export {} --format mot -o new", "synthcam export {} --format mot -o new"])
def test_an_export_keeps_a_foreign_folder_beside_it(own, results, words, capsys):
    Path("new.tmp").mkdir()
    Path("new.tmp/notes.txt").write_text("mine")
    given = results if words.startswith("tracker") else own / "dataset"
    for part in ("dataset/clips", "dataset/truth"):
        Path(part).mkdir(parents=True)
    Path("dataset/truth/clips.parquet").touch()
    refused(*words.format(given).split())
    assert "new.tmp: holds something else; new is made there" in capsys.readouterr().err
    assert Path("new.tmp/notes.txt").read_text() == "mine"


def test_what_a_killed_process_left_is_cleared(tmp_path):
    (tmp_path / "new.tmp" / "part").mkdir(parents=True)
    (tmp_path / "new.tmp" / UNFINISHED).touch()
    with open_scratch_folder(tmp_path / "new") as folder:
        assert [p.name for p in folder.iterdir()] == [UNFINISHED]
    assert not list(tmp_path.iterdir())


def test_links_do_not_hide_that_a_file_is_read(tmp_path):
    file = tmp_path / "tracks.csv"
    file.write_text("mine")
    (tmp_path / "link.csv").symlink_to(file)
    os.link(file, tmp_path / "hard.csv")
    for other in ("link.csv", "hard.csv"):
        with pytest.raises(InputError, match="the command reads it"):
            check_not_read(tmp_path / other, None, file)
    check_not_read(tmp_path / "new.csv", file, tmp_path / "missing")
    shutil.copy(file, tmp_path / "copy.csv")
    check_not_read(tmp_path / "copy.csv", file)


@pytest.mark.parametrize(
    ("words", "files"),
    [
        ("tracker score results --truth dataset -o mine", ("score.json",)),
        ("tracker score tracks.csv --truth tracks.csv -o mine", ("score.json", "index.html")),
        ("tracker compare dataset --detectors centroid -o mine", ("results/notes.txt", "index.html")),
        ("tracker benchmark run --size small -o mine", ("suite/notes.txt",)),
        ("tracker benchmark make --size small -o mine", ("definition.yaml",)),
    ],
)
def test_a_folder_with_names_like_a_report_is_not_one(own, results, words, files, capsys):
    """A file or folder that has such a name may be anybody's."""
    for name in files:
        path = Path("mine", name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("mine")
    Path("results").symlink_to(results)
    Path("dataset/truth").mkdir(parents=True)
    Path("dataset/truth/clips.parquet").touch()
    refused(*words.split())
    err = capsys.readouterr().err
    assert "mine: exists and holds something else, expected a new folder" in err
    assert err.count("\n") == 1
    assert sorted(str(p.relative_to("mine")) for p in Path("mine").rglob("*") if p.is_file()) == sorted(files)
    assert all(Path("mine", name).read_text() == "mine" for name in files)


def test_a_report_is_replaced_by_the_same_command_alone(own, monkeypatch, capsys):
    words = ["tracker", "score", "tracks.csv", "--truth", "tracks.csv", "-o", "report"]
    for _ in range(2):
        monkeypatch.setattr(sys, "argv", words)
        with pytest.raises(SystemExit) as left:
            tracker.cli.main()
        assert left.value.code in (0, None)
    refused("tracker", "benchmark", "run", "--size", "small", "-o", "report")
    assert "report: exists and holds something else" in capsys.readouterr().err
