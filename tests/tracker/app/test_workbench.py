"""What several threads do to one workbench at once: a film takes the place of another as a whole, or not at all."""

import json
import sys
import threading

import numpy as np
import pytest
import tifffile
from processes import until
from tracker_film import CAMERA

from synthcam_shared.errors import InputError
from tracker.app import workbench
from tracker.app.track_process import TrackProcess
from tracker.app.workbench import Workbench
from tracker.camera.recordings import open_source

PROGRAM = 'import sys; print(\'{"dataset": "x"}\')'


class Gate:
    """A function of the workbench that waits, in the thread that calls it, until the gate is open."""

    def __init__(self, monkeypatch, name):
        self.reached, self.go_on, function = threading.Event(), threading.Event(), getattr(workbench, name)

        def wait(*given):
            self.reached.set()
            assert self.go_on.wait(10)
            return function(*given)

        monkeypatch.setattr(workbench, name, wait)


def write_dataset(folder, width, clips=1):
    for number in range(clips):
        clip = folder / f"clips/{number:06d}"
        clip.mkdir(parents=True)
        tifffile.imwrite(clip / "frames.tif", np.zeros((5, 20, width), np.uint8), photometric="minisblack")
        (clip / "camera.json").write_text(json.dumps(CAMERA | {"size": [width, 20]}))


@pytest.fixture
def prepared(monkeypatch):
    """The widths of the films for which a detector was prepared, in their order."""
    widths = []
    monkeypatch.setattr(workbench, "prepare_detector", lambda clip, channel: widths.append(clip.frames.shape[2]))
    return widths


@pytest.fixture
def bench(tmp_path, prepared):
    write_dataset(tmp_path / "film", 30, clips=2)
    bench = Workbench(open_source(tmp_path / "film"))
    bench.process = TrackProcess(bench._note_change, (sys.executable, "-c", PROGRAM), bench._take_result)
    yield bench
    bench.close()


def end_generation(bench, number=1):
    """Let a run end that has made the dataset of this number."""
    bench.folder.mkdir(exist_ok=True)
    bench.process.start(number, ["synthcam", "generate"])


def test_a_made_dataset_is_opened_as_a_whole_before_its_run_is_done(bench, tmp_path, monkeypatch):
    before = bench.describe()
    write_dataset(bench.home / "made_1", 40)
    gate = Gate(monkeypatch, "FilmView")
    end_generation(bench)
    assert gate.reached.wait(10)
    now = bench.describe()  # while the new film is opened
    assert now["status"]["run"]["state"] == "running"
    assert {key: now[key] for key in ("film", "folder", "mark")} == {
        key: before[key] for key in ("film", "folder", "mark")
    }
    with pytest.raises(InputError, match="one is under way"):
        bench.start_run()
    gate.go_on.set()
    assert until(lambda: bench.process.status.state == "done")
    now = bench.describe()
    assert now["folder"] == f"{bench.home / 'made_1_workbench'}"
    assert (now["film"], now["size"]) == (f"{bench.home / 'made_1/clips/000000'}", (40, 20))


def test_a_run_that_starts_while_a_clip_is_opened_keeps_its_clip(bench, monkeypatch):
    gate, refusals = Gate(monkeypatch, "FilmView"), []

    def open_other():
        try:
            bench.open_clip(1)
        except InputError as error:
            refusals.append(f"{error}")

    opening = threading.Thread(target=open_other)
    opening.start()
    assert gate.reached.wait(10)
    bench.process._program = (sys.executable, "-c", "import time; time.sleep(60)")
    bench.start_run()
    gate.go_on.set()
    opening.join(10)
    assert "clips/000000" in (bench.folder / "command_1.txt").read_text()
    assert (bench.describe()["clip"], bench.view.number) == (0, 0)
    assert refusals == ["clip: a run is under way; wait for it, or cancel it"]


def test_a_dataset_that_cannot_be_opened_changes_nothing(bench):
    before = bench.describe()
    (bench.home / "made_1").mkdir(parents=True)
    end_generation(bench)
    assert until(lambda: not bench.process.is_running)
    status = bench.process.status
    assert status.state == "failed"
    assert f"{bench.home / 'made_1'}" in status.error
    after = bench.describe()
    assert [after[key] for key in ("film", "folder", "mark", "clips")] == [
        before[key] for key in ("film", "folder", "mark", "clips")
    ]
    bench.start_run()  # the page goes on
    assert until(lambda: not bench.process.is_running)


def test_two_datasets_of_one_camera_have_detectors_of_their_own(bench, prepared):
    for number in (1, 2):
        write_dataset(bench.home / f"made_{number}", 50)
        end_generation(bench, number)
        assert until(lambda n=number: bench.folder.name == f"made_{n}_workbench")
        assert until(lambda n=number: prepared[1:] == [50] * n)


def test_another_clip_is_opened_after_a_run_was_cancelled(bench):
    bench.process._program = (sys.executable, "-c", "import time; time.sleep(60)")
    bench.start_run()
    bench.process.cancel()
    assert until(lambda: bench.process.status.state == "cancelled")
    bench.open_clip(1)
    assert bench.view.number == 1
