"""The command line: exit statuses, one clear line, nothing half-written."""

import json
import sys

import pytest

from synthcam import cli

GOOD = "launch: {v0: 0.3}\ntiming: {frames: 5, contact_frame: 2}\n"
BAD_SCENES = {
    "launch.v00: unknown key": "launch: {v00: 1}",
    "ball.diameter: expected a number above 0, found -0.001": "ball: {diameter: -1e-3}",
    "launch.v0: expected a finite number, found nan": "launch: {v0: .nan}",
    "launch.v0: expected a finite number, found inf": "launch: {v0: .inf}",
    "expected keys and values, found list": "[1, 2]",
    "not plain YAML (aliases are not taken)": "a: &a [x]\nb: &b [*a, *a]\nc: [*b, *b]",
    "not plain YAML (nested too deeply)": "a: " + "[" * 5000,
    "launch.v0.uniform: expected two numbers": "launch: {v0: {uniform: [0.1, 1" + "0" * 400 + "]}}",
    "a\\nb: unknown key": '"a\\nb": 1',
    "clip 0: timing.frames: expected a whole number": "timing: {frames: {uniform: [5, 6]}}",
    "model.gravity: expected a number of 0.001 or more": "model: {gravity: 1.0e-300}",
    "expected 'upstream' or a number of 1000 or less": "launch: {contact: [1.0e+300, 0.0]}",
    "camera.height: expected more than two ball diameters": "camera: {height: 1.0e-3}",
}


def synthcam(capsys, monkeypatch, *args):
    """(exit status, stdout, stderr) of a command run in this process."""
    monkeypatch.setattr(sys, "argv", ["synthcam", *map(str, args)])
    with pytest.raises(SystemExit) as e:
        cli.main()
    out, err = capsys.readouterr()
    return e.value.code or 0, out, err


@pytest.fixture
def command(capsys, monkeypatch):
    return lambda *args: synthcam(capsys, monkeypatch, *args)


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_text(GOOD)
    return path


def one_line(err, *parts):
    assert err.count("\n") == 1, err
    assert err.startswith("synthcam: ")
    assert "Traceback" not in err
    for part in parts:
        assert str(part) in err


@pytest.mark.parametrize("message", BAD_SCENES)
def test_a_bad_scene(command, tmp_path, message):
    path = tmp_path / "bad.yaml"
    path.write_text(BAD_SCENES[message])
    status, out, err = command("generate", path, "-o", tmp_path / "d", "--no-video", "--workers", 1)
    assert (status, out) == (2, "")
    one_line(err, path, message)
    assert [p.name for p in tmp_path.iterdir()] == ["bad.yaml"]


def test_code_in_a_scene_does_not_run(command, tmp_path):
    trap = tmp_path / "trap"
    (tmp_path / "s.yaml").write_text(f"name: !!python/object/apply:pathlib.Path.touch [{trap}]\n")
    (tmp_path / "t.yaml").write_text(f"name: !!python/object/apply:os.system ['touch {trap}']\n")
    for name in ("s.yaml", "t.yaml"):
        status, _, err = command("generate", tmp_path / name, "-o", tmp_path / "d", "--no-video")
        assert status == 2
        one_line(err, name, "line 1: not plain YAML")
        assert not trap.exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("launch.v00=1", "launch.v00: unknown key"),
        ("nonsense", "--set nonsense: expected key=value"),
        ("launch.v0=[", "the value is not plain YAML"),
        ("launch.v0=2001-99-99", "the value is not plain YAML"),
        ("launch.v0=" + "[" * 3000, "the value is not plain YAML"),
        ("launch.v0=-1", "launch.v0: expected a number above 0"),
        ("launch.v0=.nan", "launch.v0: expected a finite number"),
        ("timing.frames=1e99", "timing.frames: expected a whole number"),
    ],
)
def test_a_bad_override(command, scene, tmp_path, text, message):
    status, _, err = command("generate", scene, "-o", tmp_path / "d", "--no-video", "--set", text)
    assert status == 2
    one_line(err, message)
    assert [p.name for p in tmp_path.iterdir()] == ["s.yaml"]


def test_a_missing_scene_and_a_folder_for_one(command, tmp_path):
    for path, message in ((tmp_path / "none.yaml", "no such file"), (tmp_path, "a folder, expected a YAML file")):
        status, _, err = command("generate", path, "-o", tmp_path / "d", "--no-video")
        assert status == 2
        one_line(err, path, message)


def test_an_output_that_holds_something_else(command, scene, tmp_path):
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "thesis.txt").write_text("ten years")
    for output in (folder, scene):
        status, _, err = command("generate", scene, "-o", output, "--no-video", "--workers", 1)
        assert status == 2
        one_line(err, output, "holds something else")
    assert [p.name for p in folder.iterdir()] == ["thesis.txt"]
    assert scene.read_text() == GOOD


def test_an_output_below_a_file(command, scene):
    status, _, err = command("generate", scene, "-o", scene / "d", "--no-video", "--workers", 1)
    assert status == 2
    one_line(err)


def test_physics_that_cannot_be(command, scene, tmp_path):
    status, _, err = command(
        "generate", scene, "-o", tmp_path / "d", "--no-video", "--set", "effects.plate_tilt.x=2e-3"
    )
    assert status == 2
    assert "clip 0: a ball cannot rest" in err
    assert "1 of 1 clips could not be made" in err
    assert "Traceback" not in err
    assert [p.name for p in tmp_path.iterdir()] == ["s.yaml"]


def test_generate_twice_and_verify(command, scene, tmp_path):
    out = tmp_path / "deep" / "d"
    arguments = ("generate", scene, "-o", out, "--no-video", "--clips", 3, "--workers", 1, "--json")
    status, printed, err = command(*arguments)
    first = json.loads(printed)
    assert (status, err, first["clips"], first["made"], first["failed"]) == (0, "", 3, 3, 0)
    assert not list(out.rglob("frames.tif"))
    status, printed, _ = command(*arguments)
    assert (status, json.loads(printed)["made"]) == (0, 0)
    status, printed, err = command("verify", out)
    assert (status, err) == (0, "")
    assert "all unchanged" in printed
    status, printed, _ = command("verify", out, "--json")
    assert json.loads(printed) == {"dataset": str(out), "files": 15, "problems": []}

    (out / "new.txt").write_text("")
    (out / "README.md").write_text("changed")
    (out / "clips/000001/camera.json").unlink()
    status, printed, err = command("verify", out)
    assert status == 1
    assert err.splitlines() == [
        "README.md: changed (its SHA-256 is not the one recorded)",
        "clips/000001/camera.json: missing",
        "new.txt: not listed in SHA256SUMS",
    ]


def test_verify_of_no_dataset(command, tmp_path):
    for folder in (tmp_path, tmp_path / "none"):
        status, _, err = command("verify", folder)
        assert status == 2
        one_line(err, folder, "not a finished dataset")


def test_effects_and_schema(command):
    status, out, _ = command("effects")
    assert status == 0
    assert "plate_tilt: " in out
    status, out, _ = command("effects", "plate_tilt")
    assert "x: strength, rad, typically 0.001, from -0.1 to 0.1" in out
    assert all(line == line.rstrip() for line in out.splitlines())
    assert "    x, y: slopes, positive where the plate falls" in out
    assert out.endswith("to draw what it does to the tracks: synthcam effects plate_tilt -o plate_tilt.png\n")
    status, out, _ = command("effects", "--json")
    found = {effect["effect"]: effect for effect in map(json.loads, out.splitlines())}
    assert found.keys() >= {"plate_tilt", "rolling_quadratic"}
    (knee,) = (p for p in found["stribeck"]["parameters"] if p["name"] == "slip")
    assert (knee["scale"], knee["unit"], knee["high"], knee["fixed"]) == (0.1, "m/s", 3, True)
    status, _, err = command("effects", "plate_tlit")
    assert status == 2
    one_line(err, "plate_tlit: no such effect; did you mean plate_tilt?")
    status, out, _ = command("schema")
    assert status == 0
    assert json.loads(out)["properties"]["launch"]


@pytest.mark.parametrize(
    "name", ["generate", "merge", "verify", "preview", "serve", "export", "effects", "schema", "doctor"]
)
def test_every_command_has_help_with_an_example(command, name):
    status, out, _ = command(name, "--help")
    assert status == 0
    assert f"Example: synthcam {name}" in out


@pytest.mark.parametrize("arguments", [["generate"], ["nonsense"], ["generate", "s", "-o", "d", "--clips", "0"]])
def test_wrong_usage_is_status_2(command, arguments):
    status, _, err = command(*arguments)
    assert status == 2
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--shard", "0/3"], "--shard 0/3: expected I/N with I from 1 to N"),
        (["--shard", "4/3"], "--shard 4/3: expected I/N"),
        (["--shard", "x"], "--shard x: expected I/N"),
        (["--clips", "9" * 30], "expected at most 1000000 clips in all"),
        (["--compression", "lzma"], "--compression lzma: expected none or zstd"),
        (["--withhold-truth", "{out}", "--seed", "1"], "expected a folder apart from"),
        (["--withhold-truth", "{out}/truth", "--seed", "1"], "expected a folder apart from"),
        (["--withhold-truth", "{out}_truth"], "expected --seed too"),
        (["--withhold-truth", "{out}_truth", "--seed", "1", "--shard", "1/2"], "a shard keeps its truth"),
    ],
)
def test_options_that_contradict(command, scene, tmp_path, options, message):
    out = tmp_path / "d"
    options = [option.format(out=out) for option in options]
    status, printed, err = command("generate", scene, "-o", out, "--no-video", "--workers", 1, *options)
    assert (status, printed) == (2, "")
    one_line(err, message)
    assert [p.name for p in tmp_path.iterdir()] == ["s.yaml"]


def test_shards_merged_by_commands(command, scene, tmp_path):
    common = ("--no-video", "--clips", 5, "--workers", 1, "--json")
    command("generate", scene, "-o", tmp_path / "whole", *common)
    parts = [tmp_path / f"p{k}" for k in (1, 2)]
    for k, part in enumerate(parts, 1):
        status, printed, _ = command("generate", scene, "-o", part, "--shard", f"{k}/2", *common)
        assert (status, json.loads(printed)["clips"]) == (0, 4 - k)
    status, _, err = command("merge", parts[1], "-o", tmp_path / "d")
    assert status == 2
    one_line(err, "shard 1/2 is missing among the 1 given")
    status, printed, err = command("merge", *parts, "-o", tmp_path / "d", "--json")
    assert (status, err, json.loads(printed)["clips"]) == (0, "", 5)
    assert (tmp_path / "d/SHA256SUMS").read_text() == (tmp_path / "whole/SHA256SUMS").read_text()


def test_a_challenge_by_commands(command, scene, tmp_path):
    out, secret = tmp_path / "d", tmp_path / "t"
    options = ("--withhold-truth", secret, "--seed", 99, "--no-video", "--clips", 2, "--workers", 1)
    assert command("generate", scene, "-o", out, *options)[0] == 0
    assert not list(out.rglob("truth"))
    for folder in (out, secret):
        assert command("verify", folder)[0] == 0
    status, printed, _ = command("export", out, "--format", "ptc", "--truth", secret, "-o", tmp_path / "x", "--json")
    assert (status, json.loads(printed)["clips"]) == (0, 2)
    status, _, err = command("export", out, "--format", "ptc", "-o", tmp_path / "y")
    assert status == 2
    one_line(err, "truth/clips.parquet: no such file")


def test_a_film_of_another_kind(command, scene, tmp_path):
    status, _, err = command("preview", scene, "-o", tmp_path / "f.avi")
    assert status == 2
    one_line(err, tmp_path / "f.avi", "expected a name that ends in .png, .gif or .mp4")
