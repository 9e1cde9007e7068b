"""How fast, and where the time goes. Whole commands by their margin (more clips, same start-up), stages in one process.

python -m benchmarks.simulation.speed [--clips 32] [-o out/speed.json]
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.harness import ROOT, run, save
from benchmarks.simulation.collisions import figures as collisions

SCENE = ROOT / "scenes" / "painter_behringer.yaml"


def timed(work: Callable[[], Any], repeat: int = 3) -> float:
    """Seconds of the fastest of a few runs."""
    best = np.inf
    for _ in range(repeat):
        started = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - started)
    return float(best)


def command(*words: str, output: Path) -> float:
    """Seconds of a command, the fastest of a few runs: the first one reads programs and libraries from the disk."""

    def once() -> None:
        shutil.rmtree(output, ignore_errors=True)
        run(*words, "-o", str(output), quiet=True)

    return timed(once)


def commands(clips: int, folder: Path) -> dict[str, float]:
    """Start-up and margin of the whole commands, all cores."""
    out, few = {}, 2
    seconds: dict[str, list[float]] = {"generate": [], "track": []}
    for n in (few, clips):
        film, tracked = folder / f"film{n}", folder / f"tracked{n}"
        seconds["generate"].append(command("synthcam", "generate", str(SCENE), "--clips", str(n), output=film))
        seconds["track"].append(command("tracker", "track", str(film), output=tracked))
    for name, (short, long) in seconds.items():
        a_frame = (long - short) / (clips - few) / 100
        out[f"{name}: frames a second, at the margin"] = 1 / a_frame
        out[f"{name}: ms a frame, at the margin"] = 1e3 * a_frame
        out[f"{name}: start-up, s"] = short - few * 100 * a_frame
    return out


def stages(folder: Path) -> dict[str, float]:
    """Seconds a clip of 100 frames in each stage, one process."""
    from synthcam.dataset.files import write_clip
    from synthcam.scene.film_time import FilmedMotion
    from synthcam.scene.scene import read_scene
    from tracker.camera.recordings import open_source
    from tracker.detection.detect import DEFAULT, detect, make_view
    from tracker.detection.link import link_into_tracks
    from tracker.recording import measure_clip

    clip = read_scene(SCENE).draw(0, 0)
    frames = list(clip.pictures())

    def exhaust(items: Iterable[Any]) -> None:
        for _ in items:
            pass

    def write() -> None:
        shutil.rmtree(folder / "one", ignore_errors=True)
        write_clip(folder / "one" / "clips" / "000000", clip, iter(frames))

    out = {
        "simulate": timed(lambda: FilmedMotion.solve(clip.model, clip.launch, clip.camera, clip.frames), 20),
        "truth tables": timed(lambda: clip.tracks),
        "draw and expose": timed(lambda: exhaust(clip.pictures())),
        "write and hash": timed(write),
    }
    source = open_source(folder / "one")
    video = source.open_clip(0)
    view = make_view(video)
    glints = detect(video, view, DEFAULT).glints
    tracks = link_into_tracks(glints, view.camera)
    out |= {
        "read": timed(lambda: exhaust(source.open_clip(0).frames)),
        "background, noise": timed(lambda: make_view(video)),
        "detect": timed(lambda: detect(video, view, DEFAULT)),
        "link": timed(lambda: link_into_tracks(glints, view.camera)),
        "fits": timed(lambda: measure_clip(tracks, view.camera)),
    }
    return out


def rates() -> dict[str, float]:
    """Collisions solved a second."""
    found = collisions(2000)
    return {f"collisions a second, {name}, {k}": v for name, both in found.items() for k, v in both.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description="Speed of simulation, filming and tracking.")
    parser.add_argument("--clips", type=int, default=32)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "speed.json")
    options = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="speed-"))
    try:
        figures = {"cores": os.cpu_count(), **rates(), **commands(options.clips, folder)}
        spent = stages(folder)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    table = Table("figure", "value", title="640 x 480, two balls, 250 fps")
    for name, value in figures.items():
        table.add_row(name, f"{value:.3g}")
    for name, seconds in spent.items():
        table.add_row(f"{name}, ms a clip of 100 frames, one process", f"{1e3 * seconds:.1f}")
    Console(width=100).print(table)
    save(options.output, figures | {"stages": spent})


if __name__ == "__main__":
    main()
