"""Processor time and memory of detection and linking against the number of balls, of frames, and of pixels.

python -m benchmarks.tracker.crowd_scaling [-o out/crowd_scaling.json] [--figure PNG]   # or make bench-crowd-scaling

The films are drawn: spots of width 1 px on noise, each on a circle of its own about a point of a lattice. A film
repeats after PERIOD frames, so that 10,000 frames need no more memory than its period. Each film is tracked in a
process of its own. Memory is the peak of that process, less that before tracking.

The film of 100 balls is also tracked by trackpy, which knows number, width and brightness of the spots, and linked by
laptrack. Numba's compilation does not count.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from numpy.typing import NDArray

from benchmarks.harness import ROOT, save
from benchmarks.tracker.crowds import make_linkers, trackpy
from tracker.camera.camera import Camera
from tracker.camera.frames import Frames
from tracker.camera.recordings import Recording, make_recording
from tracker.detection.choose import choose_detector
from tracker.detection.detect import detect, make_view
from tracker.detection.link import assign_track_numbers
from tracker.settings import DetectionSettings, TrackerSettings

PERIOD = 40  # frames
SPOT_PX = 7  # width of a spot for trackpy, odd
SIZES = {  # balls, frames, side of a picture in px
    "balls": [(n, 40, 1024) for n in (10, 30, 100, 300, 1000)],
    "frames": [(30, n, 512) for n in (100, 300, 1000, 3000, 10000)],
    "pixels": [(100, 40, side) for side in (256, 512, 1024, 2048, 4096)],
}


def draw_period(balls: int, side: int) -> NDArray[np.uint8]:
    """Draw the frames of one period."""
    rng, across = np.random.default_rng(1), int(np.ceil(np.sqrt(balls)))
    spacing = side / across
    lattice = (np.stack(np.divmod(np.arange(balls), across), axis=1) + 0.5) * spacing
    phase, window = rng.uniform(0, 2 * np.pi, balls), np.arange(-5, 6)
    noise = rng.normal(10.0, 1.5, (side, side))
    film = np.empty((PERIOD, side, side), dtype=np.uint8)
    for k in range(PERIOD):
        picture, angle = np.roll(noise, (7 * k, 13 * k), axis=(0, 1)), phase + 2 * np.pi * k / PERIOD
        for x, y in lattice + 0.2 * spacing * np.column_stack([np.cos(angle), np.sin(angle)]):
            column, row = round(x), round(y)
            spot = np.exp(-((window - (y - row)) ** 2)[:, None] / 2 - (window - (x - column)) ** 2 / 2)
            picture[row - 5 : row + 6, column - 5 : column + 6] += 180 * spot
        film[k] = np.clip(np.rint(picture), 0, 255)
    return film


def measure(balls: int, frames: int, side: int) -> dict[str, Any]:
    """Track one film: processor time of its steps, peak of the memory, and how many tracks there are."""
    recording = make_film(balls, frames, side)
    settings, before = make_settings(balls), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    began = time.process_time()
    name, _ = choose_detector(recording.frames, recording.camera)
    view = make_view(recording, name, settings)
    chosen = time.process_time()
    glints = detect(recording, view, name).glints
    found = time.process_time()
    ids = assign_track_numbers(glints, view.camera)
    linked = time.process_time()
    return {
        "balls": balls,
        "frames": frames,
        "pixels": side**2,
        "detector": name,
        "start_s": chosen - began,
        "detect_ms": 1e3 * (found - chosen) / frames,
        "link_ms": 1e3 * (linked - found) / frames,
        "memory_mb": (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024,
        "found": len(glints) / frames,
        "tracks": int(np.unique(ids[ids >= 0]).size),
    }


def make_film(balls: int, frames: int, side: int) -> Recording:
    """Repeat the period of a film."""
    period = draw_period(balls, side)
    film = Frames(frames, period.shape[1:], period.dtype, lambda k: period[k % PERIOD])
    return make_recording(0, film, Camera.unknown((side, side), 8))


def make_settings(balls: int) -> TrackerSettings:
    """Settings that allow for so many balls."""
    return TrackerSettings(detection=DetectionSettings(max_candidates_per_frame=max(balls + 50, 100)))


def compare_peers(balls: int = 100, frames: int = PERIOD, side: int = 1024) -> dict[str, dict[str, float]]:
    """Processor time of a frame, ms, by program: that of detection, and that of the linkers on the same positions."""
    film = make_film(balls, frames, side)
    name, _ = choose_detector(film.frames, film.camera)
    view = make_view(film, name, make_settings(balls))
    longest = 0.2 * side / np.ceil(np.sqrt(balls)) * 2 * np.pi / PERIOD  # of the steps, px
    linkers = make_linkers(replace(view.camera, fps=1.0, scale=1.0), longest)
    glints = detect(film, view, name).glints
    trackpy.locate(film.frames[0], SPOT_PX, topn=balls, percentile=99.5)
    parts: dict[str, Callable[[], Any]] = {
        "this tracker, detection": lambda: detect(film, view, name),
        "trackpy, detection": lambda: [
            trackpy.locate(film.frames[k], SPOT_PX, topn=balls, percentile=99.5) for k in range(frames)
        ],
        **{f"{key}, linking": partial(link, glints) for key, link in linkers.items()},
    }
    out: dict[str, dict[str, float]] = {}
    for key, run in parts.items():
        began = time.process_time()
        done = run()
        out[key] = {"ms": 1e3 * (time.process_time() - began) / frames}
        if key.endswith("linking"):
            out[key]["tracks"] = int(np.unique(done[done >= 0]).size)
    return out


def draw(figures: dict[str, list[dict[str, Any]]], path: Path) -> None:
    """Time of a frame, above, and memory, below, against each size; legible in print without colours."""
    labels = {"balls": "balls", "frames": "frames", "pixels": "pixels of a frame"}
    titles = {"balls": "40 frames of 1024² px", "frames": "30 balls, 512² px", "pixels": "100 balls, 40 frames"}
    figure, axes = plt.subplots(2, 3, figsize=(9, 5), layout="constrained", sharex="col", sharey="row")
    for (over, rows), (above, below) in zip(figures.items(), axes.T, strict=True):
        size = np.array([row[over] for row in rows], dtype=float)
        above.loglog(size, [row["detect_ms"] for row in rows], "o-", color="0.1", label="detection")
        above.loglog(size, [row["link_ms"] for row in rows], "s--", color="C1", mfc="white", label="linking")
        below.loglog(size, [max(row["memory_mb"], 1.0) for row in rows], "^-", color="C0")
        if over != "frames":
            above.loglog(size, rows[-1]["detect_ms"] * size / size[-1], ":", color="0.5", label="proportional")
            above.set_ylim(bottom=0.1)
        above.set_title(titles[over], fontsize=11)
        below.set_xlabel(labels[over])
        for each in (above, below):
            each.grid(color="0.9", lw=0.6)
    axes[0, 0].set_ylabel("processor time, ms a frame")
    axes[1, 0].set_ylabel("peak memory, MB")
    axes[0, 0].legend(frameon=False, fontsize=9)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)


def main() -> None:
    """Measure all films, each in a process of its own, and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out/crowd_scaling.json")
    parser.add_argument("--figure", type=Path, default=ROOT / "out/crowd_scaling.png")
    parser.add_argument("--one", type=int, nargs=3, metavar=("BALLS", "FRAMES", "SIDE"), help="measure one film alone")
    given = parser.parse_args()
    if given.one:
        print(json.dumps(measure(*given.one)))
        return
    figures: dict[str, list[dict[str, Any]]] = {}
    for over, sizes in SIZES.items():
        for size in sizes:
            command = [sys.executable, "-m", "benchmarks.tracker.crowd_scaling", "--one", *map(str, size)]
            row = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
            figures.setdefault(over, []).append(row)
            print(over, row, flush=True)
    peers = compare_peers()
    print(peers, flush=True)
    save(given.output, figures | {"peers": peers})
    draw(figures, given.figure)


if __name__ == "__main__":
    main()
