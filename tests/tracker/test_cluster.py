"""A whole suite made, tracked and scored by a Dask cluster: the same bytes. Workers are killed in the test of clips."""

import functools
import importlib.util
import json
import shutil
import subprocess
import sys

import numpy as np
import pytest
import tifffile
from benchmark_suite import TINY, suite

from synthcam_shared.dask_cluster import Cluster
from synthcam_shared.errors import InputError
from tracker.benchmark.contest import run_contest
from tracker.pipeline import run
from tracker.scoring.score import score

needs_dask = pytest.mark.skipif(
    not importlib.util.find_spec("distributed"), reason="Dask is not installed: pip install 'synthcam[dask]'"
)
SCRIPT = """
import sys
from pathlib import Path
from distributed import LocalCluster, SchedulerPlugin
from tracker.benchmark.contest import run_contest
from tracker.benchmark.suite.definition import parse_definition
from tracker.benchmark.suite.make import make_suite
from tracker.scoring.score import score
class Count(SchedulerPlugin):
    done = set()
    def transition(self, key, start, finish, *args, **more):
        self.done |= {key} if finish == "memory" and str(key).startswith("clip-") else set()
if __name__ == "__main__":
    # a thread starts at once
    options = {"processes": False, "protocol": "tcp://", "dashboard_address": None, "silence_logs": 60}
    with LocalCluster(n_workers=1, threads_per_worker=1, **options) as cluster:
        cluster.scheduler.add_plugin(Count())
        address, text = cluster.scheduler_address, Path(sys.argv[1]).read_text()
        made = make_suite(Path("suite"), parse_definition(text, "full", "tiny.yaml"), scheduler=address)
        run_contest(made, Path("report"), "centroid", scheduler=address)
        score(Path("report/results/centroid/axes"), Path("whole"), scheduler=address).write("score")
    print(len(Count.done))
"""


def same_files(one, other):
    """Count the files that are the same in both folders."""
    names = [path.relative_to(one) for path in one.rglob("*") if path.is_file()]
    for path in names:
        assert (other / path).read_bytes() == (one / path).read_bytes(), path
    return len(names)


def by_cluster(folder, *words):
    """Run a script, which has a cluster of its own, and return what it prints."""
    (folder / "script.py").write_text(SCRIPT)
    said = subprocess.run(
        [sys.executable, "script.py", *words], capture_output=True, text=True, timeout=240, cwd=folder, check=False
    )
    assert said.returncode == 0, said.stderr
    return said.stdout


@pytest.mark.gate
@needs_dask
def test_a_suite_made_run_and_scored_by_a_cluster_is_the_same(tmp_path, monkeypatch):
    monkeypatch.setattr("tracker.benchmark.contest.write_report", lambda *words: None)
    made, whole = suite(), tmp_path / "whole"  # films and truth in one folder, as `tracker score` takes them
    shutil.copytree(made.film("axes"), whole)
    shutil.copytree(made.truth / "axes", whole, dirs_exist_ok=True)
    (tmp_path / "tiny.yaml").write_text(TINY)
    assert int(by_cluster(tmp_path, "tiny.yaml")) == 4 + 4 + 4 + 1 + 4  # films, bounds, tracks, entry, score
    assert same_files(made.path, tmp_path / "suite") > 30
    (here,), _ = run_contest(made, tmp_path / "here", "centroid")
    results = tmp_path / "here" / "results" / "centroid" / "axes"
    assert same_files(results, tmp_path / "report" / "results" / "centroid" / "axes") > 4 * 4
    there = json.loads((tmp_path / "report" / "entries" / "centroid.json").read_text())
    assert {**there, "tracker": None} == {**here, "tracker": None}
    score(results, whole).write(tmp_path / "score_here")
    assert same_files(tmp_path / "score_here", tmp_path / "score") == 1


@needs_dask
def test_an_address_without_a_scheduler(tmp_path, monkeypatch):
    monkeypatch.setattr(Cluster, "__init__", functools.partialmethod(Cluster.__init__, timeout=0.5))
    film = tmp_path / "film.tif"
    tifffile.imwrite(film, np.zeros((3, 40, 50), np.uint8), imagej=True)
    with pytest.raises(InputError, match="--scheduler nonsense: expected a Dask scheduler's address"):
        run(film, tmp_path / "d", "centroid", 0, scheduler="nonsense")
    assert list(tmp_path.iterdir()) == [film]
