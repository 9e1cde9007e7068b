"""Failures while a dataset is made: full and read-only disks, kills, bugs, a second command at once."""

import errno
import functools
import json
import multiprocessing
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from synthcam_stub import make, plan, quiet, sums
from typer.testing import CliRunner

from synthcam.cli import app, main
from synthcam.dataset import generate, partial_dataset
from synthcam.dataset.files import verify
from synthcam.dataset.generate import generate_dataset
from synthcam.dataset.recorded_dataset import list_clip_folders
from synthcam_shared import outputs
from synthcam_shared.errors import InputError
from tracker.detection.detect import DEFAULT
from tracker.pipeline import run as tracked
from tracker.scoring.score import score

COMMAND = [sys.executable, "-c", "from synthcam.cli import main; main()"]
SCENE = "launch: {v0: {uniform: [0.1, 0.6]}}\ntiming: {frames: 20, contact_frame: 6}\n"
silent = functools.partial(plan, video=False)


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_text(SCENE)
    return path


def command(scene, output, clips, *more):
    return [*COMMAND, "generate", str(scene), "-o", str(output), "--no-video", "--clips", str(clips), *more]


def repeat(words):
    """Give the same command again, in this process; what it prints."""
    done = CliRunner().invoke(app, words[len(COMMAND) :])
    assert done.exit_code == 0, done.output
    return done.stdout


@pytest.fixture
def run(monkeypatch, capsys):
    """Run a command in this process; its exit status, what it prints, and its errors."""

    def run(words):
        monkeypatch.setattr(sys, "argv", ["synthcam", *words[len(COMMAND) :]])
        with pytest.raises(SystemExit) as left:
            main()
        return left.value.code, *capsys.readouterr()

    return run


def test_a_full_disk_stops_all_and_a_rerun_goes_on(tmp_path, monkeypatch):
    """Room for two clips: the third write fails as a full disk's does."""
    calls, write = [], generate.write_clip

    def full(folder, clip, *rest):
        calls.append(clip.number)
        write(folder, clip, *rest)
        if len(calls) == 3:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(generate, "write_clip", full)
    with pytest.raises(InputError, match=r"d\.partial: No space left on device; the same command continues"):
        generate_dataset(silent(6), tmp_path / "d", 1, quiet)
    assert calls == [0, 1, 2]
    assert [p.name for p in (tmp_path / "d.partial/clips").iterdir()] == ["000000", "000001"]
    assert generate_dataset(silent(6), tmp_path / "d", 1, quiet).made == 4
    generate_dataset(silent(6), tmp_path / "whole", 1, quiet)
    assert sums(tmp_path / "d") == sums(tmp_path / "whole")


def test_full_before_the_first_clip_it_leaves_nothing(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(generate, "write_clip", full)
    with pytest.raises(InputError, match="No space left"):
        generate_dataset(silent(6), tmp_path / "d", 1, quiet)
    assert not list(tmp_path.iterdir())


def test_a_disk_too_small_is_refused_before_the_start(tmp_path, monkeypatch):
    monkeypatch.setattr(generate.shutil, "disk_usage", lambda path: SimpleNamespace(free=100_000))
    with pytest.raises(InputError, match=r"4 clips take 1 MB, and 0 MB are free there"):
        generate_dataset(plan(), tmp_path / "d", 1, quiet)
    assert not list(tmp_path.iterdir())


def mounted(folder, options):
    """A file system of its own, where this user may mount one."""
    folder.mkdir()
    words = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)]
    try:
        if subprocess.run(words, capture_output=True).returncode:
            pytest.skip("mounting needs root")
    except FileNotFoundError:
        pytest.skip("there is no mount command")


@pytest.fixture
def small_disk(tmp_path):
    folder = tmp_path / "disk"
    mounted(folder, "size=200k")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def test_a_disk_that_is_really_full(scene, small_disk, run):
    status, _, said = run(command(scene, small_disk / "d", 16, "--workers", "2"))
    assert status == 2
    assert "No space left on device; the same command continues where it stopped" in said
    assert said.count("\n") == 1
    made = len(list_clip_folders(small_disk / "d.partial"))
    assert 0 < made < 16
    subprocess.run(["mount", "-o", "remount,size=20m", str(small_disk)], check=True)
    again = repeat(command(scene, small_disk / "d", 16, "--workers", "1", "--json"))
    assert json.loads(again)["made"] == 16 - made
    assert verify(small_disk / "d").problems == ()


def test_a_read_only_disk(scene, small_disk, run):
    subprocess.run(["mount", "-o", "remount,ro", str(small_disk)], check=True)
    said = f"synthcam: {small_disk / 'd.partial'}: Read-only file system\n"
    assert run(command(scene, small_disk / "d", 3)) == (2, "", said)


LIMITED = """
import os, resource, sys
gone = "pyrender", "trimesh", "OpenGL", "synthcam.camera.render", "scipy.optimize", "scipy.integrate", "scipy.fft"
gone += "pandas", "synthcam.effects.hop"
sys.modules.update(dict.fromkeys(gone))
from synthcam.cli import main
most = resource.getrlimit(resource.RLIMIT_FSIZE)
for room in (4000, most[0]):
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, most[1]))
    try:
        main()
    except SystemExit as end:
        print(end.code, os.listdir(), file=sys.stderr)
"""


def test_files_that_may_not_grow_and_no_video_needs_no_opengl(scene, tmp_path):
    """Each clip is reported; without the limit the same command makes all.

    The importers of OpenGL are out of reach, and what is slow to load and only cushions, discs and tables need.
    """
    words = [sys.executable, "-c", LIMITED, *command(scene, "d", 3, "--workers", "1")[len(COMMAND) :]]
    said = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path)
    assert said.stderr.splitlines() == [
        *(f"synthcam: clip {k}: File too large" for k in range(3)),
        "synthcam: d: 3 of 3 clips could not be made",
        "2 ['s.yaml']",
        "0 ['s.yaml', 'd']",
    ]
    assert verify(tmp_path / "d").problems == ()


def test_a_worker_that_is_killed_loses_one_clip(scene, tmp_path, run, monkeypatch):
    """When this process has written a clip, it kills the worker."""
    out, write = tmp_path / "d", generate.write_clip
    words = command(scene, out, 8, "--workers", "2", "--json")

    def write_and_kill(*rest):
        write(*rest)
        monkeypatch.setattr(generate, "write_clip", write)
        (worker,) = multiprocessing.active_children()
        worker.kill()

    monkeypatch.setattr(generate, "write_clip", write_and_kill)
    status, printed, said = run(words)
    assert status == 2
    summary = json.loads(printed)
    assert (summary["made"], summary["failed"]) == (7, 1)
    assert summary["failures"][0].endswith("its worker was killed (SIGKILL)")
    assert f"synthcam: {summary['failures'][0]}" in said.splitlines()
    assert "1 of 8 clips could not be made; the rest are kept in" in said
    assert not list(tmp_path.glob("d.partial/clips/*.tmp"))
    assert json.loads(repeat([*words, "--workers", "1"]))["made"] == 1
    assert verify(out).problems == ()


def test_a_bug_in_one_clip_is_reported_with_its_kind(tmp_path, monkeypatch):
    written = generate.write_clip

    def buggy(folder, clip, *rest):
        if clip.number == 2:
            raise ZeroDivisionError("float division\nby zero")
        written(folder, clip, *rest)

    with monkeypatch.context() as patch:
        patch.setattr(generate, "write_clip", buggy)
        outcome = generate_dataset(silent(), tmp_path / "d", 1, quiet)
    assert outcome.failed == ("clip 2: ZeroDivisionError: float division by zero",)
    assert (outcome.made, (tmp_path / "d").exists()) == (3, False)
    assert generate_dataset(silent(), tmp_path / "d", 1, quiet).made == 1


def test_two_commands_do_not_make_one_dataset(tmp_path):
    seen = []

    def tick(done, total):
        if done == 1:
            with pytest.raises(InputError, match=r"d\.partial: another process is at work there"):
                generate_dataset(silent(), tmp_path / "d", 1, quiet)
            seen.append(done)

    assert generate_dataset(silent(), tmp_path / "d", 1, tick).made == 4
    assert seen == [1]


def test_an_estimate_from_the_first_clips(tmp_path):
    heard = []
    outcome = generate_dataset(silent(8), tmp_path / "d", 1, quiet, announce=heard.append)
    assert outcome.made == 8
    assert len(heard) == 1
    said = re.fullmatch(r"5 clips to come: about \d+ s, ([\d.]+) MB of [\d,]+ MB free", heard[0])
    size = sum(p.stat().st_size for p in (tmp_path / "d/clips").rglob("*") if p.is_file()) / 8e6
    assert float(said[1]) == pytest.approx(5 * size, rel=0.1, abs=0.05)
    generate_dataset(silent(8), tmp_path / "plain", 1, quiet)
    assert sums(tmp_path / "d") == sums(tmp_path / "plain")


def files(folder):
    return {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}


def test_truth_is_withheld(tmp_path, monkeypatch):
    whole = make(tmp_path / "whole", monkeypatch)
    out, secret = make(tmp_path / "d", monkeypatch, tmp_path / "t"), tmp_path / "t"
    top = {"README.md", "SHA256SUMS"}
    assert files(out) | files(secret) == files(whole)
    assert files(out) & files(secret) == top
    assert not list(out.rglob("truth"))
    assert all("truth/" in name for name in files(secret) - top)
    for name in files(whole) - top:
        assert (whole / name).read_bytes() == ((out if name in files(out) else secret) / name).read_bytes()
    assert verify(out).problems == verify(secret).problems == ()
    assert generate_dataset(plan(), out, 1, quiet, secret).made == 0


@pytest.mark.parametrize("moment", ["truth in place", "between the last moves"])
def test_withheld_it_goes_on_too(tmp_path, monkeypatch, moment):
    whole = make(tmp_path / "whole", monkeypatch, tmp_path / "whole_truth")
    rename, settle, calls = Path.rename, partial_dataset.move_into_place, []

    def stop_rename(path, target):
        calls.append(path) if path.suffix == ".partial" else None
        if len(calls) == 2:
            raise KeyboardInterrupt
        return rename(path, target)

    def stop_settle(aside, final):
        calls.append(final)
        if len(calls) == 6:  # truth, clip; truth, clip; truth, and now the third clip
            raise KeyboardInterrupt
        settle(aside, final)

    with monkeypatch.context() as patch:
        if moment == "truth in place":
            patch.setattr(partial_dataset, "move_into_place", stop_settle)
        else:
            patch.setattr(Path, "rename", stop_rename)
        with pytest.raises(KeyboardInterrupt):
            generate_dataset(plan(), tmp_path / "d", 1, quiet, tmp_path / "t")
    assert not (tmp_path / "d").exists()
    made = generate_dataset(plan(), tmp_path / "d", 1, quiet, tmp_path / "t").made
    assert made == (2 if moment == "truth in place" else 0)
    assert sums(tmp_path / "d") == sums(whole)
    assert sums(tmp_path / "t") == sums(tmp_path / "whole_truth")


def test_withheld_truth_goes_nowhere_else(tmp_path, monkeypatch):
    make(tmp_path / "d", monkeypatch, tmp_path / "t")
    with pytest.raises(InputError, match="t: holds the truth of a dataset that is not at"):
        generate_dataset(plan(), tmp_path / "other", 1, quiet, tmp_path / "t")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/thesis.txt").write_text("ten years")
    with pytest.raises(InputError, match="mine: holds something else"):
        generate_dataset(plan(), tmp_path / "new", 1, quiet, tmp_path / "mine")
    assert files(tmp_path / "mine") == {"thesis.txt"}


def test_verify_sees_a_gap_in_a_challenge(tmp_path, monkeypatch):
    out = make(tmp_path / "d", monkeypatch, tmp_path / "t")
    for name in ("frames.tif", "camera.json"):
        (out / "clips/000001" / name).unlink()
    (out / "clips/000001").rmdir()
    (out / "SHA256SUMS").write_text("".join(x for x in sums(out).splitlines(True) if "000001" not in x))
    assert verify(out).problems == ("clips/: 3 folders, with gaps between them",)


def test_the_tracker_is_held_to_withheld_truth(tmp_path, monkeypatch):
    whole = make(tmp_path / "whole", monkeypatch, clips=1)
    out = make(tmp_path / "d", monkeypatch, tmp_path / "t", clips=1)
    tracked(out, tmp_path / "r", DEFAULT, 1)
    apart, together = (score(tmp_path / "r", position).to_dict() for position in (tmp_path / "t", whole))
    assert apart == together
    assert apart["detectors"]["default"]["localisation"]["n"] > 10


@pytest.mark.parametrize("wide", [False, True])
def test_zstd_holds_the_same_pixels(tmp_path, monkeypatch, wide):
    pytest.importorskip("imagecodecs", reason="imagecodecs is not installed: synthcam[zstd]")
    import tifffile

    sensor = {"sensor": {"bits": 12}} if wide else {}
    scene = plan().scenes[0].settings | sensor
    plain = make(tmp_path / "plain", monkeypatch, scene=scene)
    small = make(tmp_path / "small", monkeypatch, scene=scene, compression="zstd")
    name = "clips/000002/frames.tif"
    assert (tifffile.imread(plain / name) == tifffile.imread(small / name)).all()
    assert (small / name).stat().st_size < 0.9 * (plain / name).stat().st_size
    assert generate_dataset(plan(scene=scene, compression="zstd"), small, 1, quiet).made == 0
    with pytest.raises(InputError, match="another --compression"):
        generate_dataset(plan(scene=scene), small, 1, quiet)
    card = (small / "README.md").read_text()
    assert "cv2" not in card
    assert "imagecodecs" in card


def test_a_name_that_nobody_else_uses(tmp_path):
    assert outputs.name_temporary(tmp_path / "000001") != outputs.name_temporary(tmp_path / "000001")


@pytest.mark.parametrize(
    "withheld", ["d/../d/secret", "link/secret", "d.partial/secret", "link.partial", "gone/secret", ".", "d/../dw/../d"]
)
def test_the_truth_never_comes_to_lie_in_the_dataset(tmp_path, monkeypatch, withheld):
    """By whatever name: two dots, links, links to what is not there yet, the folder in which the dataset is made."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "dw").mkdir()
    for link, to in (("link", "d"), ("link.partial", "d.partial"), ("gone", "d/below")):
        Path(link).symlink_to(to)
    (tmp_path / "d").mkdir()
    with pytest.raises(InputError, match="expected a folder apart from"):
        generate_dataset(silent(), Path("d"), 1, quiet, Path(withheld))
    assert not list(tmp_path.rglob("*.json"))


def test_two_dots_lead_to_where_they_lead(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "d").mkdir()
    (tmp_path / "dw").mkdir()
    generate_dataset(silent(1), Path("d"), 1, quiet, Path("d/../dw/secret"))
    assert files(tmp_path / "d") == {"README.md", "SHA256SUMS", "clips/000000/camera.json"}
    assert "truth/clips.parquet" in files(tmp_path / "dw/secret")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["d", "dw"]
