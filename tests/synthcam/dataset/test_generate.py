"""Generating: the same bytes whatever the workers, the order, and the interruptions. Without video: no OpenGL."""

import functools
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest
from typer.testing import CliRunner

from synthcam.cli import app
from synthcam.dataset import generate
from synthcam.dataset.files import verify
from synthcam.dataset.generate import GenerationPlan, generate_dataset, make_clip
from synthcam.dataset.recorded_dataset import list_clip_folders
from synthcam.scene.scene import check_scene
from synthcam_shared.errors import InputError

TEXT = """
launch: {v0: {uniform: [0.1, 0.6]}, b: {uniform: [-0.3, 0.3]}, striker: {choice: [a, b]}}
timing: {frames: 30, contact_frame: {uniform: [5, 10]}}
"""
SCENE = {
    "launch": {"v0": {"uniform": [0.1, 0.6]}, "b": {"uniform": [-0.3, 0.3]}, "striker": {"choice": ["a", "b"]}},
    "timing": {"frames": 30, "contact_frame": {"uniform": [5, 10]}},
}
MANY = 8
HALTED = """
import time
from synthcam.cli import main
from synthcam.dataset import generate
left, write = [3], generate.write_clip
def write_three_clips(*clip):
    if not left[0]:
        time.sleep(60)
    left[0] -= 1
    write(*clip)
generate.write_clip = write_three_clips
main()
"""
COMMAND = [sys.executable, "-c", HALTED]


def plan(clips=6, seed=5, scene=SCENE):
    return GenerationPlan((check_scene(scene, "s.yaml"),), clips, seed, video=False)


def quiet(done, total):
    pass


def sums(folder):
    return (Path(folder) / "SHA256SUMS").read_text()


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    out = tmp_path_factory.mktemp("one") / "d"
    assert generate_dataset(plan(), out, 1, quiet).made == 6
    return out


def test_two_workers_make_the_same_bytes(one, tmp_path):
    assert generate_dataset(plan(), tmp_path / "d", 2, quiet).made == 6
    assert sums(tmp_path / "d") == sums(one)
    assert verify(tmp_path / "d").problems == ()
    assert not (tmp_path / "d.partial").exists()


def test_so_does_the_other_order(one, tmp_path):
    partial = tmp_path / "d.partial"
    (partial / "clips").mkdir(parents=True)
    (partial / "plan.json").write_text(json.dumps(plan().document()))
    for k in reversed(range(6)):
        assert make_clip(plan(), k, partial) is None
    assert generate_dataset(plan(), tmp_path / "d", 1, quiet).made == 0
    assert sums(tmp_path / "d") == sums(one)


def test_another_seed_is_another_dataset(one, tmp_path):
    generate_dataset(plan(seed=6), tmp_path / "d", 1, quiet)
    assert sums(tmp_path / "d") != sums(one)
    rows = [json.loads((c / "truth/scene.json").read_text())["row"]["v0"] for c in list_clip_folders(one)]
    assert len(set(rows)) == 6


def test_clips_do_not_lean_on_how_many_there_are(one, tmp_path):
    generate_dataset(plan(clips=2), tmp_path / "d", 1, quiet)
    for name in ("camera.json", "truth/tracks.parquet", "truth/scene.json"):
        assert (tmp_path / "d/clips/000001" / name).read_bytes() == (one / "clips/000001" / name).read_bytes()


def test_two_scenes_are_numbered_on(tmp_path):
    scenes = (check_scene(SCENE, "a"), check_scene({"name": "alone", "launch": {"kind": "single"}}, "b"))
    generate_dataset(GenerationPlan(scenes, 2, 0, video=False), tmp_path / "d", 1, quiet)
    table = pd.read_parquet(tmp_path / "d/truth/clips.parquet")
    assert table["clip"].tolist() == [0, 1, 2, 3]
    assert table.scene.tolist() == ["scene", "scene", "alone", "alone"]


def test_a_second_run_makes_nothing(one):
    before = {p: p.stat().st_mtime_ns for p in one.rglob("*")}
    ticks = []
    outcome = generate_dataset(plan(), one, 2, lambda *x: ticks.append(x))
    assert (outcome.made, ticks) == (0, [(6, 6)])
    assert len(pd.read_parquet(one / "truth/clips.parquet")) == 6
    assert {p: p.stat().st_mtime_ns for p in one.rglob("*")} == before


@pytest.mark.parametrize("change", [{"clips": 5}, {"seed": 6}, {"scene": {}}])
def test_another_dataset_is_not_overwritten(one, change):
    with pytest.raises(InputError, match=r"holds a dataset made with another (number of clips|seed|scene)"):
        generate_dataset(plan(**change), one, 1, quiet)


@pytest.mark.parametrize("name", ["d", "d.partial"])
def test_a_folder_that_holds_something_else_is_left_alone(tmp_path, name):
    (tmp_path / name).mkdir()
    (tmp_path / name / "thesis.txt").write_text("ten years")
    with pytest.raises(InputError, match="holds something else"):
        generate_dataset(plan(), tmp_path / "d", 1, quiet)
    assert [p.name for p in tmp_path.rglob("*")] == [name, "thesis.txt"]


@pytest.mark.parametrize("text", ["{", "[]", "3"])
def test_a_plan_that_is_none(tmp_path, text):
    (tmp_path / "d.partial").mkdir()
    (tmp_path / "d.partial/plan.json").write_text(text)
    with pytest.raises(InputError, match=r"not JSON|holds a dataset made with another"):
        generate_dataset(plan(), tmp_path / "d", 1, quiet)


def test_an_empty_folder_is_as_good_as_none(one, tmp_path):
    (tmp_path / "d").mkdir()
    generate_dataset(plan(), tmp_path / "d", 1, quiet)
    assert sums(tmp_path / "d") == sums(one)


@pytest.mark.parametrize("moment", ["make_clip", "finish_dataset", "sums", "rename"])
def test_stopped_at_any_moment_it_goes_on(one, tmp_path, monkeypatch, moment):
    """As by a signal: at the third clip, before the tables, after the tables, before the last move."""
    calls = []

    def stop(real, when):
        def wrapped(*args, **kwargs):
            calls.append(moment)
            if len(calls) == when:
                raise KeyboardInterrupt
            return real(*args, **kwargs)

        return wrapped

    with monkeypatch.context() as m:
        if moment == "sums":

            def after(*args, **kwargs):
                finish(*args, **kwargs)
                raise KeyboardInterrupt

            finish = generate.finish_dataset
            m.setattr(generate, "finish_dataset", after)
        elif moment == "rename":
            rename = Path.rename
            m.setattr(Path, "rename", lambda p, to: stop(rename, 1)(p, to) if p.name == "d.partial" else rename(p, to))
        else:
            m.setattr(generate, moment, stop(getattr(generate, moment), 3 if moment == "make_clip" else 1))
        with pytest.raises(KeyboardInterrupt):
            generate_dataset(plan(), tmp_path / "d", 1, quiet)
    assert not (tmp_path / "d").exists()
    (tmp_path / "d.partial/clips/000005.tmp/truth").mkdir(parents=True)
    assert generate_dataset(plan(), tmp_path / "d", 1, quiet).made == (4 if moment == "make_clip" else 0)
    assert sums(tmp_path / "d") == sums(one)
    assert verify(tmp_path / "d").problems == ()


def test_a_clip_that_cannot_be_made_spares_the_rest(tmp_path):
    """A tilt that some balls cannot rest on."""
    scene = SCENE | {"effects": {"plate_tilt": {"x": {"uniform": [0.0, 2.9e-3]}}}}
    outcome = generate_dataset(plan(scene=scene, clips=12), tmp_path / "d", 1, quiet)
    assert 0 < len(outcome.failed) < 12
    assert outcome.made + len(outcome.failed) == 12
    assert all("cannot rest" in line and line.startswith("clip ") for line in outcome.failed)
    assert not (tmp_path / "d").exists()
    assert len(list_clip_folders(tmp_path / "d.partial")) == outcome.made
    assert not list((tmp_path / "d.partial/clips").glob("*.tmp"))


def test_when_no_clip_can_be_made_nothing_is_left(tmp_path):
    scene = SCENE | {"effects": {"plate_tilt": {"x": 0.05}}}
    assert len(generate_dataset(plan(scene=scene), tmp_path / "d", 1, quiet).failed) == 6
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def many(tmp_path_factory):
    out = tmp_path_factory.mktemp("many") / "d"
    generate_dataset(plan(clips=MANY), out, 1, quiet)
    return out


@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize(
    ("how", "workers"),
    [(signal.SIGKILL, 1), (signal.SIGINT, 1), pytest.param(signal.SIGINT, 2, marks=pytest.mark.gate)],
)
def test_killed_or_interrupted_it_goes_on(many, tmp_path, how, workers):
    """While it is at its fourth clip, at which it halts."""
    (tmp_path / "s.yaml").write_text(TEXT)
    out, partial = tmp_path / "d", tmp_path / "d.partial"
    options = ["-o", str(out), "--no-video", "--clips", str(MANY), "--seed", "5", "--workers", str(workers)]
    command = [*COMMAND, "generate", str(tmp_path / "s.yaml"), *options]
    # A shell's background job ignores it, and what it starts would.
    heard = functools.partial(signal.signal, signal.SIGINT, signal.default_int_handler)
    first = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True, preexec_fn=heard)
    while first.poll() is None and len(list(partial.glob("clips/[0-9]*[0-9]"))) < 3:
        time.sleep(0.002)
    os.killpg(first.pid, how) if how == signal.SIGINT else first.send_signal(how)  # Ctrl-C reaches all
    said = first.communicate(timeout=20)[1]
    assert first.returncode == (130 if how == signal.SIGINT else -9)
    assert not out.exists()
    made = len(list_clip_folders(partial))
    assert 3 <= made < MANY
    if how == signal.SIGINT:
        assert "Traceback" not in said
        assert "synthcam: interrupted; the same command continues where it stopped" in said.splitlines()
    again = CliRunner().invoke(app, [*command[len(COMMAND) :], "--workers", "1", "--json"])
    assert again.exit_code == 0, again.output
    assert json.loads(again.stdout)["made"] == MANY - made
    assert sums(out) == sums(many)
