"""The process that draws scenes: it stays, it is started again, and its end is said in a sentence."""

import json
import sys

import numpy as np
import pytest
import tifffile
from processes import until

from synthcam_shared.errors import InputError
from tracker.app import workbench
from tracker.app.scene_previews import ScenePreviews
from tracker.app.track_process import TrackProcess
from tracker.app.workbench import Workbench
from tracker.camera.recordings import open_source

ECHO = """
import json, os, sys
for line in sys.stdin:
    asked = json.loads(line)
    if asked == 0:
        os._exit(3)
    answer = {"asked": asked, "process": os.getpid(), "yaml": "a: 1"}
    print(json.dumps({"error": "no such scene"} if asked == 1 else answer), flush=True)
"""
MAKER = """
import pathlib, sys
folder = pathlib.Path(sys.argv[sys.argv.index("-o") + 1])
import numpy, tifffile
(folder / "clips/000000").mkdir(parents=True)
tifffile.imwrite(folder / "clips/000000/frames.tif", numpy.zeros((5, 20, 30), numpy.uint8), photometric="minisblack")
print('{"dataset": "x"}')
"""


@pytest.fixture
def previews():
    previews = ScenePreviews((sys.executable, "-c", ECHO))
    yield previews
    previews.close()


def test_one_process_answers_all_requests_and_a_new_one_those_after_its_end(previews):
    first, second = previews.ask({"n": 1}), previews.ask("x\n")
    assert (first["asked"], second["asked"]) == ({"n": 1}, "x\n")
    assert first["process"] == second["process"]
    with pytest.raises(InputError, match=r"^no such scene$"):
        previews.ask(1)
    with pytest.raises(InputError, match=r"synthcam serve has ended \(no message\)"):
        previews.ask(0)
    assert previews.ask(2)["process"] != first["process"]
    previews.close()
    with pytest.raises(InputError, match="closed"):
        previews.ask(2)


def test_a_picture_that_takes_too_long_ends_the_process():
    slow = ScenePreviews((sys.executable, "-c", "import time; time.sleep(60)"), patience_s=0.1)
    with pytest.raises(InputError, match=r"after 0\.1 s for one picture"):
        slow.ask({})


def test_without_synthcam_that_is_said():
    with pytest.raises(InputError, match="is not installed here; type: pip install synthcam"):
        ScenePreviews((sys.executable, "-m", "synthcam_of_nobody")).ask({})


def test_a_dataset_that_is_made_is_opened_with_a_folder_of_its_own(previews, tmp_path, monkeypatch):
    monkeypatch.setattr(workbench, "prepare_detector", lambda *given: None)
    tifffile.imwrite(tmp_path / "film.tif", np.zeros((5, 20, 20), np.uint8), photometric="minisblack")
    bench = Workbench(open_source(tmp_path / "film.tif"))
    try:
        bench.previews = previews
        bench.process = TrackProcess(bench._note_change, (sys.executable, "-c", MAKER), bench._take_result)
        for wrong in ({"scene": "x", "clips": 0}, {"scene": "x", "clips": True}, {"scene": "x", "clips": 10**9}):
            with pytest.raises(InputError, match="expected 1 to 1000 clips"):
                bench.start_generation(wrong)
        bench.start_generation({"scene": "x", "clips": 2, "seed": 7})
        home = tmp_path / "film_workbench"
        assert until(lambda: bench.process.status.state == "done")
        assert (bench.folder, bench.describe()["size"]) == (home / "made_1_workbench", (30, 20))
        assert (home / "scene_1.yaml").read_text() == "a: 1"
        assert (home / "command_1.txt").read_text().split()[-4:] == ["--clips", "2", "--seed", "7"]
        about = json.loads(json.dumps(bench.describe()))
        assert (about["film"], about["size"]) == (f"{home / 'made_1/clips/000000'}", [30, 20])
        with pytest.raises(InputError, match=r"seed: expected a whole number, 0 or more, not 5\.0"):
            bench.start_generation({"scene": "x", "seed": 5.0})
        broken = (
            "import pathlib, sys; pathlib.Path(sys.argv[sys.argv.index('-o') + 1] + '.partial').mkdir(); sys.exit(3)"
        )
        bench.process = TrackProcess(bench._note_change, (sys.executable, "-c", broken), bench._take_result)
        bench.start_generation({"scene": "x"})
        assert until(lambda: bench.process.status.state == "failed")
        assert (home / "scene_2.yaml").exists()
        assert not (home / "made_2.partial").exists()
    finally:
        bench.close()
