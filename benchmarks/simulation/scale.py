"""Datasets at scale: the same bytes however they are made, and memory over thousands of clips.

scale.py [--clips 10000] [--equal 60] [-o out/scale.json]     --clips 0 or --equal 0 leaves that part out
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.harness import save

SCENE = """
name: scale
launch: {v0: {uniform: [0.1, 0.6]}, b: {uniform: [-0.3, 0.3]}, striker: {choice: [a, b]}}
timing: {frames: 20, contact_frame: {uniform: [5, 10]}}
camera: {size: [128, 64], scale: 3.0e-4}
"""
PROGRAM = [sys.executable, "-c", "from synthcam.cli import main; main()"]
CLUSTER = """
import subprocess, sys
from distributed import LocalCluster
from benchmarks.harness import save
if __name__ == "__main__":
    with LocalCluster(n_workers=2, threads_per_worker=2, dashboard_address=None) as cluster:
        sys.exit(subprocess.run([*sys.argv[1:], "--scheduler", cluster.scheduler_address]).returncode)
"""
KILLS = 5
PAGE = os.sysconf("SC_PAGE_SIZE")


def generate(scene: Path, output: Path, clips: int, *more: str) -> list[str]:
    return [*PROGRAM, "generate", str(scene), "-o", str(output), "--clips", str(clips), "--seed", "7", *more]


def call(words: list[str]) -> None:
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)


def shards(scene: Path, output: Path, clips: int) -> None:
    parts = [output.with_name(f"part{k}") for k in (1, 2, 3)]
    for k, part in enumerate(parts, 1):
        call(generate(scene, part, clips, "--shard", f"{k}/3", "--workers", "2"))
    call([*PROGRAM, "merge", *map(str, parts), "-o", str(output)])


def dask(scene: Path, output: Path, clips: int) -> None:
    script = scene.with_name("cluster.py")
    script.write_text(CLUSTER)
    call([sys.executable, str(script), *generate(scene, output, clips)])


def killed(scene: Path, output: Path, clips: int, seconds: float, seed: int) -> list[int]:
    """Kill the command five times, every other time with its workers, then let it end.

    The first instant is anywhere in its start, the others anywhere after its first new clip. Returns how many clips
    there were at each kill.
    """
    rng, found = random.Random(seed), list[int]()
    for k in range(KILLS):
        before = count(output)
        run = subprocess.Popen(
            generate(scene, output, clips, "--workers", "2"), stdout=subprocess.DEVNULL, start_new_session=True
        )
        while k and run.poll() is None and count(output) == before:
            time.sleep(0.01)
        time.sleep(rng.uniform(0, seconds / (6 * KILLS)))
        if run.poll() is not None:
            raise SystemExit("generate ended before it was killed: more clips are needed")
        os.killpg(run.pid, signal.SIGKILL) if k % 2 else run.kill()
        run.wait()
        found.append(count(output))
    call(generate(scene, output, clips, "--workers", "2"))
    return found


def count(output: Path) -> int:
    """Complete clips so far."""
    for folder in (output, output.with_name(output.name + ".partial")):
        if (folder / "clips").is_dir():
            return sum(e.name.isdigit() for e in os.scandir(folder / "clips"))
    return 0


def equal(clips: int, folder: Path) -> dict[str, Any]:
    """Make one dataset in five ways and compare the lists of checksums."""
    scene = folder / "scale.yaml"
    scene.write_text(SCENE)
    kills: list[int] = []
    ways: dict[str, Callable[[Path], Any]] = {
        "1 worker": lambda out: call(generate(scene, out, clips, "--workers", "1")),
        "2 workers": lambda out: call(generate(scene, out, clips, "--workers", "2")),
        "3 shards, merged": lambda out: shards(scene, out, clips),
        f"killed {KILLS} times": lambda out: kills.extend(killed(scene, out, clips, seconds["2 workers"], 1)),
    }
    if importlib.util.find_spec("distributed"):
        ways["Dask, 2 workers of 2 threads"] = lambda out: dask(scene, out, clips)
    seconds: dict[str, float] = {}
    sums: dict[str, str] = {}
    for k, (way, make) in enumerate(ways.items()):
        started = time.perf_counter()
        make(folder / f"way{k}")
        seconds[way] = time.perf_counter() - started
        sums[way] = (folder / f"way{k}" / "SHA256SUMS").read_text()
        call([*PROGRAM, "verify", str(folder / f"way{k}")])
    first = sums["1 worker"]
    return {
        "clips": clips,
        "files": len(first.splitlines()),
        "same_bytes": {way: text == first for way, text in sums.items()},
        "seconds": {way: round(s, 1) for way, s in seconds.items()},
        "clips_at_each_kill": kills,
        "dask": "as above" if importlib.util.find_spec("distributed") else "not installed",
    }


def rss(pid: int) -> float:
    """Resident memory of a process, MB; nan when it is gone."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * PAGE / 1e6
    except (OSError, IndexError):
        return float("nan")


def children(pid: int) -> list[int]:
    """Worker processes of a process, and not the resource tracker beside them."""
    try:
        found = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        return [int(c) for c in found if b"spawn_main" in Path(f"/proc/{c}/cmdline").read_bytes()]
    except OSError:
        return []


def memory(clips: int, folder: Path) -> dict[str, Any]:
    """Make very many small clips and watch the memory of the command and of its workers."""
    scene, output = folder / "scale.yaml", folder / "many"
    scene.write_text(SCENE)
    started, samples = time.perf_counter(), []
    run = subprocess.Popen(generate(scene, output, clips, "--workers", "2"), stdout=subprocess.DEVNULL)
    while run.poll() is None:
        time.sleep(1)
        workers = [rss(c) for c in children(run.pid)]
        samples.append((count(output), rss(run.pid), max(workers, default=float("nan"))))
    if run.returncode:
        raise SystemExit(f"generate ended with status {run.returncode}")
    seconds = time.perf_counter() - started
    table = np.array(samples)
    size = sum(p.stat().st_size for p in output.rglob("*") if p.is_file())
    return {
        "clips": clips,
        "seconds": round(seconds, 1),
        "disk_mb": round(size / 1e6, 1),
        "clips_a_second": round(clips / seconds, 1),
        "deciles": [_level(table, clips, k) for k in range(10)],
        "highest_mb": {"command": _top(table[:, 1]), "worker": _top(table[:, 2])},
    }


def _level(table: np.ndarray, clips: int, tenth: int) -> dict[str, Any]:
    """Median memory while that tenth of the clips was made."""
    inside = table[(table[:, 0] > clips * tenth / 10) & (table[:, 0] <= clips * (tenth + 1) / 10)]
    middle = [round(float(np.nanmedian(inside[:, k])), 1) if len(inside) else None for k in (1, 2)]
    return {"clips": clips * (tenth + 1) // 10, "command_mb": middle[0], "worker_mb": middle[1]}


def _top(values: np.ndarray) -> float:
    return round(float(np.nanmax(values)), 1)


def show(result: dict[str, Any]) -> None:
    console = Console()
    if "equal" in result:
        found = result["equal"]
        table = Table("made by", "same bytes", "s", title=f"{found['clips']} clips, {found['files']} files")
        for way, same in found["same_bytes"].items():
            table.add_row(way, "yes" if same else "NO", f"{found['seconds'][way]}")
        console.print(table, f"clips at each kill: {found['clips_at_each_kill']}; Dask: {found['dask']}")
    if "memory" in result:
        found = result["memory"]
        title = f"{found['clips']} clips in {found['seconds']} s, {found['disk_mb']} MB"
        table = Table("clips made", "command, MB", "worker, MB", title=title)
        for level in found["deciles"]:
            table.add_row(*(f"{level[k]}" for k in ("clips", "command_mb", "worker_mb")))
        console.print(table, f"at most: {found['highest_mb']}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=int, default=10_000)
    parser.add_argument("--equal", type=int, default=60)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/scale.json"))
    arguments = parser.parse_args()
    folder, result = Path(tempfile.mkdtemp(prefix="scale-")), dict[str, Any]()
    try:
        if arguments.equal:
            result["equal"] = equal(arguments.equal, folder)
        if arguments.clips:
            result["memory"] = memory(arguments.clips, folder)
    finally:
        shutil.rmtree(folder)
    show(result)
    save(arguments.output, result)
    if not all(result.get("equal", {}).get("same_bytes", {}).values()):
        sys.exit(1)


if __name__ == "__main__":
    main()
