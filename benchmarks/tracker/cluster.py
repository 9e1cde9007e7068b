"""Films of many clips by Dask workers on this machine, tracked and scored; one worker is killed in each step.

cluster.py [--clips 10000] [--alone 500] [--workers 2] [--folder DIR] [-o out/cluster.json]

One process makes the first `--alone` clips again with the same commands (0: all, in twice the time). Every file is
compared byte by byte. The cost of a million clips is extrapolated from the processor time and the bytes of each step.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.harness import ONE_THREAD, program, save

SCENE = """
name: cluster
launch: {v0: {uniform: [0.1, 0.6]}, b: {uniform: [-0.3, 0.3]}, striker: {choice: [a, b]}}
timing: {frames: 20, contact_frame: {uniform: [5, 10]}}
camera: {size: [128, 64], scale: 3.0e-4}
"""
MILLION = 1_000_000
KILL_AT = 0.4  # of the clips of a step
MADE = {"generate": "films", "track": "tracks", "score": "score/score.json"}


def commands(folder: Path, scene: Path, clips: int) -> dict[str, list[str]]:
    """The three steps, in order."""
    films, tracks = str(folder / "films"), str(folder / "tracks")
    return {
        "generate": ["synthcam", "generate", str(scene), "-o", films, "--clips", str(clips), "--seed", "7"],
        "track": ["tracker", "track", films, "-o", tracks, "--no-pages"],
        "score": ["tracker", "score", tracks, "--truth", films, "-o", str(folder / "score")],
    }


def call(words: list[str]) -> None:
    done = subprocess.run(
        [program(words[0]), *words[1:]],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        env=os.environ | ONE_THREAD,
    )
    if done.returncode:
        sys.exit(f"{' '.join(words)} ended with status {done.returncode}:\n{done.stderr[-2000:]}")


@contextmanager
def cluster(workers: int, kill_after: int) -> Iterator[tuple[str, list[int]]]:
    """The address of a scheduler, and the process that was killed once its workers had done so many clips."""
    from distributed import LocalCluster, SchedulerPlugin  # an extra

    class Killer(SchedulerPlugin):  # type: ignore[misc]
        done = 0

        def transition(self, key: Any, start: str, finish: str, *args: Any, **more: Any) -> None:
            self.done += finish == "memory" and str(key).startswith("clip-")
            if self.done >= kill_after and not killed:
                killed.append(next(iter(made.workers.values())).pid)
                os.kill(killed[0], signal.SIGKILL)

    killed = list[int]()
    with LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None, silence_logs=60) as made:
        made.scheduler.add_plugin(Killer())
        yield made.scheduler_address, killed


def run_disturbed(words: list[str], clips: int, workers: int) -> dict[str, Any]:
    """Run a command on a cluster of its own, kill one of its workers on the way; what it took."""
    before = spent()
    with cluster(workers, max(1, int(KILL_AT * clips))) as (address, killed):
        started = time.perf_counter()
        call([*words, "--scheduler", address])
        seconds = time.perf_counter() - started
    return {"seconds": round(seconds, 1), "processor_s": round(spent() - before, 1), "killed": len(killed)}


def spent() -> float:
    """Processor time of all processes that this one has waited for, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def files(place: Path, clips: int | None) -> dict[str, bytes]:
    """Name and bytes of a file, of all files of a folder, or of those of its first clips."""
    if place.is_file():
        return {place.name: place.read_bytes()}
    found = {}
    for path in sorted(p for p in place.rglob("*") if p.is_file()):
        parts = path.relative_to(place).parts
        if clips is None or (parts[0] == "clips" and int(parts[1]) < clips):
            found["/".join(parts)] = path.read_bytes()
    return found


def compare_files(many: Path, one: Path, steps: list[str], clips: int | None) -> dict[str, dict[str, Any]]:
    """How many files of each step the undisturbed run made, and which are not the same."""
    out = {}
    for step in steps:
        true, other = (files(folder / MADE[step], clips) for folder in (one, many))
        wrong = sorted(name for name in true.keys() | other.keys() if true.get(name) != other.get(name))
        out[step] = {"files": len(true), "other_bytes": wrong[:20]}
    return out


def study(folder: Path, clips: int, alone: int, workers: int) -> dict[str, Any]:
    """All steps on clusters, the same alone, and the comparison."""
    scene = folder / "cluster.yaml"
    scene.write_text(SCENE)
    many, one = folder / "many", folder / "one"
    many.mkdir()
    one.mkdir()
    result: dict[str, Any] = {"clips": clips, "workers": workers, "alone": alone, "steps": {}}
    for step, words in commands(many, scene, clips).items():
        result["steps"][step] = run_disturbed(words, clips, workers)
        print(step, result["steps"][step], file=sys.stderr, flush=True)
    result["largest_process_mb"] = round(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e3)
    for step, words in commands(one, scene, alone).items():
        call([*words, "--workers", "1"] if step != "score" else words)
    if alone == clips:
        result["same"] = compare_files(many, one, list(MADE), None)
    else:  # a score covers all clips: that of these clips is made by a cluster too
        result["same"] = compare_files(many, one, ["generate", "track"], alone)
        again = folder / "again"
        words = commands(one, scene, alone)["score"][:-1]
        result["score_again"] = run_disturbed([*words, str(again / "score")], alone, workers)
        result["same"] |= compare_files(again, one, ["score"], None)
    for step, name in MADE.items():
        size = sum(len(data) for data in files(many / name, None).values()) if step == "score" else weight(many / name)
        result["steps"][step]["bytes"] = size
    result["million"] = million(result["steps"], clips)
    return result


def weight(folder: Path) -> int:
    """Bytes of all files."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def million(steps: dict[str, dict[str, Any]], clips: int) -> dict[str, Any]:
    """The cost of a million clips at the measured rate."""
    hours = {step: round(found["processor_s"] / clips * MILLION / 3600, 1) for step, found in steps.items()}
    return {
        "core_hours": hours | {"all": round(sum(hours.values()), 1)},
        "gigabytes": {step: round(found["bytes"] / clips * MILLION / 1e9, 1) for step, found in steps.items()},
    }


def show(result: dict[str, Any]) -> None:
    table = Table("", "s", "processor, s", "killed", "files compared", "other bytes", "10⁶ clips: core hours", "GB")
    for step, found in result["steps"].items():
        same, far = result["same"][step], result["million"]
        numbers = (found["seconds"], found["processor_s"], found["killed"], same["files"], len(same["other_bytes"]))
        table.add_row(step, *map(str, numbers), str(far["core_hours"][step]), str(far["gigabytes"][step]))
    title = f"{result['clips']} clips, {result['workers']} Dask workers; {result['alone']} of them again by one process"
    Console().print(title, table, f"largest process: {result['largest_process_mb']} MB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=int, default=10_000)
    parser.add_argument("--alone", type=int, default=500)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument(
        "--folder", type=Path, help="Folder in which clips are made and kept; default: a temporary one."
    )
    parser.add_argument("-o", "--output", type=Path, default=Path("out/cluster.json"))
    arguments = parser.parse_args()
    alone = min(arguments.alone or arguments.clips, arguments.clips)
    folder = arguments.folder or Path(tempfile.mkdtemp(prefix="cluster-"))
    folder.mkdir(parents=True, exist_ok=True)
    os.environ.update(ONE_THREAD)
    try:
        result = study(folder.resolve(), arguments.clips, alone, arguments.workers)
    finally:
        if arguments.folder is None:
            shutil.rmtree(folder)
    save(arguments.output, result)
    show(result)
    steps = [*result["steps"].values(), *([result["score_again"]] if "score_again" in result else [])]
    if any(found["other_bytes"] for found in result["same"].values()) or not all(step["killed"] for step in steps):
        sys.exit(1)


if __name__ == "__main__":
    main()
