"""Folders of results: full and read-only disks, and two commands at once."""

import ast
import errno
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from tracker_film import CAMERA, collision
from tracker_noisy import without_fits, without_local

from synthcam_shared import outputs
from synthcam_shared.errors import InputError
from tracker import cli, pipeline

NOWHERE = Path("/proc/nowhere")  # nobody may write there, root neither
SRC = Path(cli.__file__).parent
pytestmark = pytest.mark.usefixtures("not_local")


def three_clips(folder):
    """A table of tracks of three hits; its camera stands beside it."""
    rng = np.random.default_rng(3)
    rows = []
    for clip in range(3):
        paths = collision(40, contact=18.4 + clip, speed=2.5, angle=0.4 + clip)
        positions = paths + 0.01 * rng.standard_normal(paths.shape)
        rows += [f"{clip},{k},{n},{x:.4f},{y:.4f},.01,.01" for k in range(40) for n, (x, y) in enumerate(positions[k])]
    (folder / "in").mkdir()
    (folder / "in/camera.json").write_text(json.dumps(CAMERA))
    (folder / "in/tracks.csv").write_text("\n".join(["clip,frame,particle,x,y,x_std,y_std", *rows]) + "\n")
    return folder / "in/tracks.csv"


@pytest.fixture
def table(tmp_path):
    return three_clips(tmp_path)


def measure(table, output):
    return pipeline.measure_tables(table, output, table.with_name("camera.json"))


def contents(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def limited(patch, room):
    """A disk on which `room` bytes more have a position: a file that does not fit is cut short, as a full disk does."""
    left, write = [room], Path.write_bytes

    def write_bytes(path, data):
        probe = ".room." in path.name  # it is taken away again
        room = len(data) if probe else left[0]
        write(path, data[:room])
        if len(data) > room:
            raise OSError(errno.ENOSPC, "No space left on device")
        left[0] -= 0 if probe else len(data)

    patch.setattr(Path, "write_bytes", write_bytes)


@pytest.mark.usefixtures("unfitted")
def test_a_full_disk_is_named_and_the_same_command_goes_on(table, tmp_path, monkeypatch):
    measure(table, tmp_path / "whole")
    first = sum(map(len, contents(tmp_path / "whole/clips/000000").values()))
    with monkeypatch.context() as patch:
        limited(patch, first * 3 // 2)
        with pytest.raises(InputError, match=r"d\.partial: No space left on device; the same command continues"):
            measure(table, tmp_path / "d")
    done = contents(tmp_path / "d.partial")
    assert 0 < len(list((tmp_path / "d.partial/clips").iterdir())) < 3
    whole = contents(tmp_path / "whole")
    assert all(whole[name] == data for name, data in done.items())  # nothing cut short
    assert measure(table, tmp_path / "d").fresh < 3
    assert contents(tmp_path / "d") == whole


@pytest.mark.usefixtures("unfitted")
def test_full_at_the_end_it_goes_on_too(table, tmp_path, monkeypatch):
    measure(table, tmp_path / "whole")
    put = outputs.write_atomically

    def full(path, data):
        if path.name == "fit.json":
            raise OSError(errno.ENOSPC, "No space left on device")
        put(path, data)

    with monkeypatch.context() as patch:
        patch.setattr("tracker.results.write_atomically", full)
        with pytest.raises(InputError, match="No space left on device"):
            measure(table, tmp_path / "d")
    assert not (tmp_path / "d").exists()
    assert measure(table, tmp_path / "d").fresh == 0
    assert contents(tmp_path / "d") == contents(tmp_path / "whole")


def test_full_before_the_first_clip_it_leaves_nothing(table, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        limited(patch, 1 << 16)
        patch.setattr(
            pipeline.results, "write_clip_results", lambda *_: (tmp_path / "d.partial/x").write_bytes(bytes(10**6))
        )
        with pytest.raises(InputError, match="No space left"):
            measure(table, tmp_path / "d")
    assert [p.name for p in tmp_path.iterdir()] == ["in"]


def test_what_was_there_before_stays(tmp_path, monkeypatch):
    path = tmp_path / "report.html"
    outputs.write_atomically(path, "old")
    limited(monkeypatch, 2)
    with pytest.raises(OSError, match="No space left"):
        outputs.write_atomically(path, "new and longer")
    assert contents(tmp_path) == {"report.html": b"old"}


@pytest.mark.skipif(not NOWHERE.parent.is_dir(), reason="/proc is Linux's")
@pytest.mark.parametrize(
    "words",
    [
        ["measure", "{table}", "--camera", "{camera}", "-o", "{out}"],
        ["track", "{folder}", "--camera", "{camera}", "-o", "{out}"],
        ["score", "{table}", "--truth", "{folder}", "-o", "{out}"],
        ["calibrate", "{folder}", "--diameter", "2e-3", "--fps", "250", "-o", "{out}"],
    ],
)
def test_a_folder_where_nothing_can_be_written_is_named_at_once(table, words, monkeypatch, capsys):
    """Before anything else is done: there are no pictures here, and no truth."""
    (table.parent / "clips/000000").mkdir(parents=True)
    (table.parent / "clips/000000/frames.tif").write_bytes(b"")
    names = {"table": table, "camera": table.with_name("camera.json"), "folder": table.parent, "out": NOWHERE}
    monkeypatch.setattr(sys, "argv", ["tracker", *(w.format(**names) for w in words)])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    err = capsys.readouterr().err
    assert stop.value.code == 2
    assert err.startswith(f"tracker: {NOWHERE}: ")
    assert err.endswith("; nothing can be written there\n")
    assert err.count("\n") == 1


@pytest.mark.usefixtures("unfitted")
def test_two_commands_do_not_make_the_same_results(table, tmp_path, monkeypatch):
    """The second is refused while the first is at work, and takes nothing of it away."""
    write, refused, inside = pipeline.results.write_clip_results, [], []

    def write_clip(folder, number, *rest):
        assert not inside, "the second command is at work too"
        inside.append(number)
        (folder / "clips" / "000009.tmp").mkdir()  # a clip that another worker of the first is writing
        with pytest.raises(InputError, match=r"d\.partial: another process is at work there"):
            measure(table, tmp_path / "d")
        (folder / "clips" / "000009.tmp").rmdir()
        refused.append(inside.pop())
        write(folder, number, *rest)

    monkeypatch.setattr(pipeline.results, "write_clip_results", write_clip)
    assert measure(table, tmp_path / "d").fresh == 3
    assert refused == [0, 1, 2]


def test_a_lock_taken_too_late_is_none(tmp_path, monkeypatch):
    """Between the opening of the folder and the lock, its owner has moved it into its place."""
    fcntl = pytest.importorskip("fcntl")
    take = fcntl.flock

    def slow(handle, how):
        (tmp_path / "d.partial").rename(tmp_path / "d")
        take(handle, how)

    monkeypatch.setattr(fcntl, "flock", slow)
    with pytest.raises(InputError, match="another process"), outputs.lock_folder(tmp_path / "d.partial"):
        pass


def test_all_that_the_tracker_writes_goes_by_way_of_one_function():
    writers = {"write_text", "write_bytes", "savefig", "write_table", "write_csv", "copyfile", "imwrite"}
    for path in SRC.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in writers:
                target = ast.unparse(node.args[-1] if node.func.attr == "write_table" else node)
                assert path.name == "outputs.py" or "stream" in target or "text" in target, f"{path}:{node.lineno}"


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("run.json", "[" * 200_000),
        ("run.json", "{"),
        ("clips/000001/estimates.json", "5"),
        ("clips/000001/estimates.json", "[5]"),
        ("clips/000001/estimates.json", "[" * 200_000),
    ],
)
def test_damaged_results_are_one_line(results_of, table, file, text):
    path = results_of / file
    before = path.read_text()
    path.write_text(text)
    with pytest.raises(InputError, match=r"\.json: damaged, expected") as error:
        measure(table, results_of)
    assert "\n" not in str(error.value)
    path.write_text(before)


@pytest.fixture(scope="module")
def results_of(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results")
    with without_fits(), without_local():
        measure(three_clips(folder), folder / "d")
    return folder / "d"


def test_a_file_in_a_folder_that_is_not_there_yet_makes_the_folder(tmp_path):
    outputs.write_atomically(tmp_path / "new/deep/file.txt", "text")
    assert contents(tmp_path) == {"new/deep/file.txt": b"text"}
