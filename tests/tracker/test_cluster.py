"""Clips tracked by a Dask cluster: the same bytes, one of whose workers is killed on the way."""

import importlib.util
import subprocess
import sys

import pytest
from benchmark_suite import suite

from commandline.errors import InputError
from tracker.pipeline import run

needs_dask = pytest.mark.skipif(
    not importlib.util.find_spec("distributed"), reason="Dask is not installed: pip install 'synthcam[dask]'"
)
SCRIPT = """
import os, signal, sys
from pathlib import Path
from distributed import LocalCluster
from tracker.pipeline import run
if __name__ == "__main__":
    killed = []
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=60) as cluster:
        def tick(done, total):
            if done >= 1 and not killed:
                killed.append(next(iter(cluster.workers.values())).pid)
                os.kill(killed[0], signal.SIGKILL)
        address = cluster.scheduler_address
        outcome = run(Path(sys.argv[1]), Path(sys.argv[2]), None, "centroid", 0, tick, scheduler=address)
    print(outcome.clips, len(killed))
"""


@needs_dask
def test_a_cluster_gives_the_same_bytes(tmp_path):
    film = suite().film("axes")
    run(film, tmp_path / "one", None, "centroid", 1)
    (tmp_path / "script.py").write_text(SCRIPT)
    words = [sys.executable, "script.py", str(film), "many"]
    said = subprocess.run(words, capture_output=True, text=True, timeout=120, cwd=tmp_path, check=False)
    assert (said.returncode, said.stdout) == (0, "4 1\n"), said.stderr
    files = [path.relative_to(tmp_path / "one") for path in (tmp_path / "one").rglob("*") if path.is_file()]
    assert len(files) > 4 * 4
    for path in files:
        assert (tmp_path / "many" / path).read_bytes() == (tmp_path / "one" / path).read_bytes()


@needs_dask
def test_an_address_without_a_scheduler(tmp_path, monkeypatch):
    monkeypatch.setattr("commandline.dask_workers.PATIENCE", 0.5)
    with pytest.raises(InputError, match="--scheduler nonsense: expected a Dask scheduler's address"):
        run(suite().film("axes"), tmp_path / "d", None, "centroid", 0, scheduler="nonsense")
    assert not list(tmp_path.iterdir())
