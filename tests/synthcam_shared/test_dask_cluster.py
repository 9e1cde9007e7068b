"""The clips made by a Dask cluster: the same bytes."""

import functools
import importlib.util
import json
import subprocess
import sys

import pytest
from synthcam_stub import quiet, sums

from synthcam.dataset.generate import GenerationPlan, generate_dataset
from synthcam.scene.scene import check_scene
from synthcam_shared.dask_cluster import Cluster
from synthcam_shared.errors import InputError

needs_dask = pytest.mark.skipif(
    not importlib.util.find_spec("distributed"), reason="Dask is not installed: pip install 'synthcam[dask]'"
)
SCENE = {"launch": {"v0": {"uniform": [0.1, 0.6]}}, "timing": {"frames": 20, "contact_frame": 6}}
SCRIPT = """
import json, operator, os, signal, sys
from pathlib import Path
from distributed import LocalCluster
from synthcam.dataset.generate import GenerationPlan, generate_dataset
from synthcam.scene.scene import check_scene
from synthcam_shared.dask_cluster import Cluster
class Counted:
    sent = 0
    def __reduce__(self):
        Counted.sent += 1
        return operator.methodcaller, ("bit_length",)
if __name__ == "__main__":
    plan = GenerationPlan((check_scene(json.loads(sys.argv[1]), "s.yaml"),), int(sys.argv[3]), 5, video=False)
    killed = []
    with LocalCluster(n_workers=2, threads_per_worker=2, dashboard_address=None, silence_logs=60) as cluster:
        def tick(done, total):
            if done >= 3 and not killed:
                nanny = next(iter(cluster.workers.values()))
                killed.append(nanny.pid)
                nanny.close_gracefully()  # else it starts another worker, which takes seconds
                os.kill(killed[0], signal.SIGKILL)
        said = {r.number: r.value for r in Cluster(cluster.scheduler_address).run(Counted(), range(60))}
        outcome = generate_dataset(plan, Path(sys.argv[2]), 1, tick, scheduler=cluster.scheduler_address)
    assert said == {n: n.bit_length() for n in range(60)}, said
    print(Counted.sent, outcome.made, len(outcome.failed), len(killed))
"""


def plan(clips):
    return GenerationPlan((check_scene(SCENE, "s.yaml"),), clips, 5, video=False)


def on_cluster(folder, clips):
    """Run both on one cluster, which takes seconds to start."""
    path = folder.parent / "script.py"
    path.write_text(SCRIPT)
    words = [sys.executable, str(path), json.dumps(SCENE), str(folder), str(clips)]
    said = subprocess.run(words, capture_output=True, text=True, timeout=120)
    assert said.returncode == 0, said.stderr
    return [int(k) for k in said.stdout.split()]


@needs_dask
@pytest.mark.gate
def test_a_cluster_makes_the_same_bytes_and_is_sent_its_work_once(tmp_path):
    """One of its workers is killed on the way; another does its clips.

    Ten thousand clips have ten thousand file names, which the scheduler would hold for each clip.
    """
    generate_dataset(plan(24), tmp_path / "one", 1, quiet)
    sent, *made = on_cluster(tmp_path / "many", 24)
    assert sent <= 2
    assert made == [24, 0, 1]
    assert sums(tmp_path / "many") == sums(tmp_path / "one")


@needs_dask
@pytest.mark.parametrize(
    "address", ["tcp://127.0.0.1:1", "nonsense", "tls://127.0.0.1:8786", "ucx://h:1", "tcp://", "h:99999"]
)
def test_an_address_without_a_scheduler(tmp_path, monkeypatch, address):
    monkeypatch.setattr(Cluster, "__init__", functools.partialmethod(Cluster.__init__, timeout=0.5))
    with pytest.raises(InputError, match=f"--scheduler {address}: expected a Dask scheduler's address"):
        generate_dataset(plan(1), tmp_path / "d", 1, quiet, scheduler=address)
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(bool(importlib.util.find_spec("distributed")), reason="Dask is installed")
def test_without_dask_it_says_so(tmp_path):
    with pytest.raises(InputError, match=r"Dask is not installed; type: pip install 'synthcam\[dask\]'"):
        generate_dataset(plan(1), tmp_path / "d", 1, quiet, scheduler="tcp://127.0.0.1:1")
    assert not list(tmp_path.iterdir())
