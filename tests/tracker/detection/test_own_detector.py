"""Detectors of users: functions, classes, files and modules, in Python and on the command line."""

import json
import os
import sys

import numpy as np
import pytest
from tracker_film import CAMERA, collision, film, write_dataset

import tracker
from synthcam_shared.errors import InputError, PluginError
from tracker import cli
from tracker.detection.detect import detector_name, load_detector

pytestmark = pytest.mark.usefixtures("unfitted", "not_local")
PATHS = collision(24, contact=9.3, speed=4.0)

CENTROID = '''
import numpy as np

def brightest(frame):
    """Centroids of the two brightest spots above 60 counts."""
    rest, found = frame.astype(float), []
    for _ in range(2):
        y, x = np.unravel_index(rest.argmax(), rest.shape)
        if rest[y, x] < 60:
            break
        rows, columns = slice(max(y - 4, 0), y + 5), slice(max(x - 4, 0), x + 5)
        light = np.clip(rest[rows, columns] - 12.0, 0, None)
        ys, xs = np.mgrid[rows, columns][:, : light.shape[0], : light.shape[1]]
        found.append(((light * xs).sum() / light.sum(), (light * ys).sum() / light.sum()))
        rest[rows, columns] = 0
    return found
'''


@pytest.fixture(scope="module")
def frames():
    return film(np.random.default_rng(0), PATHS)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my.py").write_text(CENTROID)
    (tmp_path / "two.py").write_text("def one(frame):\n    return []\n\ndef other(frame):\n    return []\n")
    (tmp_path / "broken.py").write_text("x = 1\ny = x / 0\n")
    (tmp_path / "leaves.py").write_text("import sys\nsys.exit(0)\n")
    (tmp_path / "own_module_of_a_test.py").write_text(
        CENTROID + "\nclass Blind:\n    def __init__(self, view): ...\n    def __call__(self, frame):\n"
        "        from tracker.detection.glints import Glints\n        return Glints.none()\n"
    )
    return tmp_path


def brightest(frame):
    space = {}
    exec(CENTROID, space)
    return space["brightest"](frame)


def errors_of(result):
    """Distances of the found glints from the true ones, px."""
    seen = result.tracks[["glint_x", "glint_y"]].to_numpy()
    true = PATHS[result.tracks["frame"].to_numpy()]
    return np.hypot(*(true - seen[:, None]).transpose(2, 0, 1)).min(axis=1)


@pytest.mark.parametrize("kind", ["function", "lambda", "object", "with errors", "file", "file and name", "module"])
def test_a_users_detector_finds_the_balls(kind, frames, folder):
    class Finder:
        def __call__(self, frame):
            return brightest(frame)

    detector = {
        "function": brightest,
        "lambda": lambda frame: brightest(frame),
        "object": Finder(),
        "with errors": lambda frame: [(x, y, 0.05) for x, y in brightest(frame)],
        "file": "my.py",
        "file and name": str(folder / "my.py:brightest"),
        "module": "own_module_of_a_test:brightest",
    }[kind]
    result = tracker.track(frames, CAMERA, detector=detector)
    apart = errors_of(result)
    assert len(apart) == 2 * len(frames)
    assert np.median(apart) < 0.1
    if kind == "with errors":
        assert np.median(result.tracks["x_std"]) == pytest.approx(0.05, rel=0.5)


@pytest.mark.parametrize("name", ["my.py", "own_module_of_a_test:Blind"])
def test_on_the_command_line(name, folder, monkeypatch, capsys):
    write_dataset(folder / "dataset", np.random.default_rng(0), clips=1)
    monkeypatch.setattr(sys, "argv", ["tracker", "track", "dataset", "-o", "out", "--detector", name, "--no-pages"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 0, capsys.readouterr().err
    run = json.loads((folder / "out/run.json").read_text())
    assert run["detector"] == detector_name(name) == ("my" if name == "my.py" else "Blind")
    rows = len((folder / "out/clips/000000/tracks.csv").read_text().splitlines())
    assert rows > 50 if name == "my.py" else rows == 1


@pytest.mark.gate
def test_other_processes_find_the_same(folder, monkeypatch, capsys):
    """The other process loads the file itself. It begins with both clips, whose balls do not meet yet."""
    write_dataset(folder / "dataset", np.random.default_rng(0), frames=12)
    found = []
    for workers in ("1", "2"):
        words = ["track", "dataset", "-o", workers, "--detector", "my.py", "--no-pages", "--workers", workers]
        monkeypatch.setattr(sys, "argv", ["tracker", *words])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        assert ended.value.code == 0, capsys.readouterr().err
        found.append([(folder / workers / f"clips/00000{clip}/tracks.csv").read_text() for clip in (0, 1)])
    assert found[0] == found[1]
    assert all(len(text.splitlines()) > 20 for text in found[0])


def test_a_changed_file_is_another_run(folder, monkeypatch, capsys):
    write_dataset(folder / "dataset", np.random.default_rng(0), clips=1)
    monkeypatch.setattr(sys, "argv", ["tracker", "track", "dataset", "-o", "out", "--detector", "my.py", "--no-pages"])
    for change, status in (("", 0), ("\n# another\n", 2)):
        (folder / "my.py").write_text(CENTROID + change)
        with pytest.raises(SystemExit) as ended:
            cli.main()
        assert ended.value.code == status
    assert "holds the results of another run (detector_file)" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "line"),
    [
        ("none.py", "argument detector none.py: no such file; expected FILE.py, FILE.py:NAME or MODULE:NAME"),
        ("two.py", "expected one class or function in it, found one, other; say two.py:NAME"),
        ("my.py:darkest", "argument detector my.py:darkest: no darkest in it; there are brightest"),
        ("broken.py", "broken.py: line 2: ZeroDivisionError: division by zero"),
        ("leaves.py", "leaves.py: line 2: SystemExit: 0"),
        ("no_such_module:Class", "argument detector no_such_module:Class: ModuleNotFoundError"),
        (3, "detector: of type int, expected a name, a function or a class"),
        (dict, "detector dict: expected a method __call__(frame) or detect(frames)"),
        (lambda frame: "here", "returned str, expected positions (n, 2): x and y in px"),
        (lambda frame: np.zeros((3, 7)), "returned an array (3, 7), expected positions (n, 2)"),
        (lambda frame: frame[10_000], "frame 0: "),
        (lambda frame: [(np.nan, 1.0)], "frame 0: x holds NaN or infinity, expected finite numbers"),
    ],
)
def test_a_wrong_one_is_one_line(given, line, frames, folder):
    with pytest.raises(InputError) as error:
        tracker.track(frames[:12], CAMERA, detector=given)
    assert line in str(error.value)
    assert "\n" not in str(error.value)


def test_the_fault_of_a_users_function_names_its_line(frames):
    def off(frame):
        return frame[10_000]

    with pytest.raises(InputError, match=r"detector off, frame 0: .*test_own_detector\.py, line \d+: IndexError"):
        tracker.track(frames[:12], CAMERA, detector=off)


def test_a_class_may_inherit_its_call():
    class Base:
        def __init__(self, view): ...
        def __call__(self, frame): ...

    class Child(Base): ...

    assert load_detector(Child) is Child
    with pytest.raises(PluginError):
        load_detector(type("Empty", (), {}))


def test_a_plus_in_a_path_is_no_linker(tmp_path):
    (tmp_path / "a+b").mkdir()
    (tmp_path / "a+b" / "my.py").write_text(CENTROID)
    assert load_detector(os.fspath(tmp_path / "a+b" / "my.py")).__name__ == "brightest"
