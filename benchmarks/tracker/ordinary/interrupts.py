"""Cases of Ctrl-C at several moments, and of the time left that a search shows on a terminal."""

from __future__ import annotations

import json
import os
import pty
import re
import select
import signal
import subprocess
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd
import tifffile

from benchmarks.tracker.ordinary.case import (
    CLOCKS,
    LIMIT_S,
    Case,
    Outcome,
    Program,
    Verdict,
    Words,
    end_group,
    read_processor_time,
    read_time_of,
)
from benchmarks.tracker.ordinary.judges import describe_end
from benchmarks.tracker.ordinary.sources import PLAIN, film_glints, write_camera
from synthcam.scene.scene import Scene

MOMENTS_S = (0.08, 0.15, 0.25, 0.4, 0.6, 0.9, 1.3, 2.0)  # of processor time of the command's first process
COLLISIONS = 7
FILMS = 40  # so many that the last interrupt comes before their end
LEFT = re.compile(r"about \d+ s[^a-z]*(?:, at most [\d.]+ min)? left")


class EachInterrupted:
    """Each interrupt ends with status 130 and one line."""

    right = f"{len(MOMENTS_S)} of {len(MOMENTS_S)} with status 130 and one line"

    def __call__(self, outcome: Outcome) -> Verdict:
        return Verdict(outcome.out, outcome.out == self.right)


class ShowsTimeLeft:
    """A line with the time left appears while a search runs."""

    right = "about N s left"

    def __call__(self, outcome: Outcome) -> Verdict:
        found = LEFT.search(outcome.out)
        return Verdict(found[0] if found else describe_end(outcome), bool(found))


def interrupt(program: Program, folder: Path, words: Words) -> Outcome:
    """Run a command once for each moment, press Ctrl-C then, and count how the commands end."""
    used, ends = read_processor_time(), Counter[str]()
    for number, moment in enumerate(MOMENTS_S):
        with (folder / "err").open("w+b") as err:
            process = program.start([*words, "-o", f"new{number}"], folder, stdin=subprocess.DEVNULL,
                                    stdout=subprocess.DEVNULL, stderr=err)  # fmt: skip
            while process.poll() is None and read_time_of(process.pid) < moment:
                time.sleep(0.005)
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGINT)
            try:
                process.wait(LIMIT_S)
            except subprocess.TimeoutExpired:
                ends["ignored"] += 1
            finally:
                end_group(process)
            err.seek(0)
            lines = err.read().decode(errors="replace").splitlines()
        kind = "one line" if len(lines) == 1 else f"{len(lines)} lines, the last {lines[-1:]}"
        ends[f"with status {process.returncode} and {kind}"] += 1
    out = "; ".join(f"{count} of {len(MOMENTS_S)} {end}" for end, count in ends.most_common())
    return Outcome(status=0, out=out, err="", folder=folder, seconds=read_processor_time() - used)


def watch_terminal(program: Program, folder: Path, words: Words) -> Outcome:
    """Run a command on a pseudo-terminal until it shows the time left, then end it; what it showed."""
    used, begun, shown = read_processor_time(), time.monotonic(), b""
    ours, theirs = pty.openpty()
    process = program.start(words, folder, stdin=theirs, stdout=theirs, stderr=theirs)
    os.close(theirs)
    try:
        while time.monotonic() - begun < CLOCKS * LIMIT_S and not LEFT.search(plain_text(shown)):
            if not select.select([ours], [], [], 0.5)[0]:
                continue
            try:
                shown += os.read(ours, 65536)
            except OSError:  # the command has ended
                break
    finally:
        end_group(process)
        os.close(ours)
    return Outcome(
        status=process.returncode, out=plain_text(shown), err="", folder=folder, seconds=read_processor_time() - used
    )


def plain_text(shown: bytes) -> str:
    """The text of a terminal without its control sequences."""
    return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", shown.decode(errors="replace"))


def write_collisions(folder: Path) -> None:
    """A table of collisions whose restitution falls with speed, as true centres with noise."""
    scene = Scene.read("painter_behringer", effects={"velocity_restitution": {"e": 0.1}})
    parts = []
    for k in range(COLLISIONS):
        true = scene.draw(k, seed=4).tracks.query("visible")
        xy = true[["x_mean_px", "y_mean_px"]].to_numpy() + 0.01 * np.random.default_rng(k).standard_normal(
            (len(true), 2)
        )
        rows = {"clip": k, "frame": true["frame"], "particle": true["particle"], "x": xy[:, 0], "y": xy[:, 1]}
        parts.append(pd.DataFrame(rows).assign(striker="b"))
    pd.concat(parts).to_csv(folder / "t.csv", index=False)
    camera = scene.draw(0, seed=4).camera_json
    write_camera(folder, {name: camera[name] for name in PLAIN})


def search(folder: Path) -> Words:
    """A search in a table, without its output."""
    write_collisions(folder)
    return ["discrepancy", "find", "t.csv", "--camera", "camera.json", "--model", "painter_behringer"]


def generate(folder: Path) -> Words:
    """A dataset of many clips with a video of each."""
    return ["synthcam", "generate", "painter_behringer", "--clips", "60", "--encode", "h264"]


def track_films(folder: Path) -> Words:
    """A dataset of many films of glints, tracked by two processes."""
    for k in range(FILMS):
        clip = folder / f"dataset/clips/{k:06d}"
        clip.mkdir(parents=True)
        tifffile.imwrite(clip / "frames.tif", film_glints().frames)
        (clip / "camera.json").write_text(json.dumps(film_glints().camera))
    return ["tracker", "track", "dataset", "--workers", "2"]


def list_cases() -> list[Case]:
    """Cases of Ctrl-C and of the time left."""
    return [
        Case("interrupts", "generate --encode", generate, EachInterrupted(), run=interrupt),
        Case("interrupts", "find", search, EachInterrupted(), run=interrupt),
        Case("interrupts", "track --workers 2", track_films, EachInterrupted(), run=interrupt),
        Case("users", "find shows the time left on a terminal", lambda folder: [*search(folder), "-o", "new"],
             ShowsTimeLeft(), run=watch_terminal),
    ]  # fmt: skip
