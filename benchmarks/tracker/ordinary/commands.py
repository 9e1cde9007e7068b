"""Cases of commands: outputs that would overwrite, tables too large, names and files that are refused in one line."""

from __future__ import annotations

import importlib
import json
import shlex
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import tifffile

from benchmarks.tracker.ordinary.case import Case, Judge, Words
from benchmarks.tracker.ordinary.judges import Measured, Refused, Said, Unchanged
from benchmarks.tracker.ordinary.sources import film_glints, know_table, list_rows, track, write_camera

refused: Any = importlib.import_module("refused_inputs")
OWN = {
    "tracks.csv": b"clip,frame,particle,x,y\n0,0,0,1.0,3.0\n0,1,0,2.0,3.0\n",
    "camera.json": json.dumps(refused.CAMERA).encode(),
    "model.yaml": b"model: {}\n",
    "scene.yaml": b"timing: {frames: 4, contact_frame: 2}\ncamera: {size: [64, 48]}\n",
    "mine.png": b"a picture of mine",
    "mine.gif": b"a film of mine",
    "noise.yaml": b"model: {r: 0.5}\n",
    "report/model.yaml": b"model: {}\n",
    "report/discrepancy.json": b"{}",
}
ADD = "discrepancy add hop --model model.yaml --fit tracks.csv --camera camera.json -o"
OVERWRITING = {  # commands, and what they say
    f"{ADD} tracks.csv": "the command reads it",
    f"{ADD} camera.json": "the command reads it",
    f"{ADD} model.yaml": "the command reads it",
    f"{ADD} noise.yaml": "was not made by `discrepancy add`",
    "synthcam preview scene.yaml -o mine.png": "was not made by `synthcam preview`",
    "synthcam preview scene.yaml -o mine.gif": "was not made by `synthcam preview`",
    "synthcam effects hop -o mine.png": "was not made by `synthcam effects`",
    "discrepancy find tracks.csv --camera camera.json --model report/model.yaml -o report": "would overwrite it",
}
FAULTS = {  # of `refused_inputs.REFUSED`: a name of the case, by the beginning of the command
    "tracker measure blank.csv --camera camera.json -o gr": "an output whose name is not UTF-8",
    "synthcam preview s.yaml -o gr": "a picture whose name is not UTF-8",
    "synthcam generate s.yaml -o loop": "an output that is a symlink loop",
    "discrepancy find blank.csv --camera camera.json --model s.yaml -o loop": "a report that is a symlink loop",
    "synthcam generate surrogate.yaml": "a lone surrogate in a scene",
    "synthcam generate s.yaml -o new --set name=": "a lone surrogate in --set",
    "synthcam generate s.yaml -o new --set a.a": "a --set key 5,000 levels deep",
    "synthcam generate s.yaml -o new --set timing=": "a --set value 5,000 levels deep",
    "synthcam effects --effects leaving": "an effect file that raises SystemExit",
    "synthcam preview s.yaml -o new.png --frame": "--frame 99999999999",
    "discrepancy adopt report --name class": "adopt --name class",
    "discrepancy find blank.csv --camera camera.json --model empty.yaml": "find with an empty model",
    "discrepancy find blank.csv --camera camera.json --model huge.yaml": "sliding_friction: 1e300",
    "discrepancy find blank.csv --camera camera.json --model twice.yaml": "a duplicate in free",
    "tracker measure blank.csv --camera camera.json -o new": "tracks that are all NaN",
}


def name_overwriting(typed: str) -> str:
    """The name of a case: the file and the command."""
    words = typed.split()
    return f"{words[-1]} by {words[0]} {words[1]}"


def write_own(typed: str) -> Callable[[Path], Words]:
    """A folder with files of the user, and a command that would overwrite one."""

    def make(folder: Path) -> Words:
        for name, data in OWN.items():
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_bytes(data)
        return shlex.split(typed)

    return make


def write_faulty(typed: str) -> Callable[[Path], Words]:
    """The folder of `refused_inputs`, and one of its commands."""

    def make(folder: Path) -> Words:
        refused.write_refused_inputs(folder)
        return typed.split()

    return make


def write_latin_table(folder: Path) -> Words:
    """A table whose name is not UTF-8."""
    name = f"{refused.LATIN}.csv"
    write_camera(folder, know_table())
    pd.DataFrame(list_rows(), columns=["frame", "particle", "x", "y"]).to_csv(folder / name, index=False)
    return ["tracker", "measure", name, "--camera", "camera.json", "-o", "new", "--no-pages"]


def write_corrupt(folder: Path) -> Path:
    """A compressed TIFF stack, of which the data of some pages are overwritten."""
    path = folder / "film.tif"
    tifffile.imwrite(path, film_glints().frames, compression="zlib")
    with tifffile.TiffFile(path) as film:
        spots = [(page.dataoffsets[0], page.databytecounts[0]) for page in film.pages[30:33]]
    data = bytearray(path.read_bytes())
    for offset, count in spots:
        data[offset : offset + count] = bytes(count)
    path.write_bytes(data)
    return path


def write_crowd(count: int, frames: int) -> Callable[[Path], Words]:
    """A table of so many balls that roll side by side, 24 px apart."""

    def make(folder: Path) -> Words:
        side = int(np.ceil(np.sqrt(count)))
        ball, frame = np.tile(np.arange(count), frames), np.repeat(np.arange(frames), count)
        write_camera(folder, {**know_table(), "size": [24 * side + 40] * 2})
        rng = np.random.default_rng(0)
        speed = rng.normal(0, 1.0, (count, 2))
        x, y = 20 + 24.0 * (ball % side), 20 + 24.0 * (ball // side)
        table = {"frame": frame, "particle": ball, "x": x + speed[ball, 0] * frame, "y": y + speed[ball, 1] * frame}
        pd.DataFrame(table).to_csv(folder / "t.csv", index=False, float_format="%.3f")
        return ["tracker", "measure", "t.csv", "--camera", "camera.json", "-o", "new"]

    return make


def write_long(count: int, frames: int) -> Callable[[Path], Words]:
    """A table of balls that roll slowly, each by itself, in many frames."""

    def make(folder: Path) -> Words:
        write_camera(folder, {**know_table(), "size": [400, 400]})
        frame, ball = np.repeat(np.arange(frames), count), np.tile(np.arange(count), frames)
        x = 60 + 280 * frame / frames + np.random.default_rng(0).normal(0, 0.02, len(frame))
        table = pd.DataFrame({"frame": frame, "particle": ball, "x": x, "y": 30.0 + 60 * ball})
        table.to_csv(folder / "t.csv", index=False, float_format="%.4f")
        return ["tracker", "measure", "t.csv", "--camera", "camera.json", "-o", "new"]

    return make


def list_cases() -> list[Case]:
    """Cases of commands."""
    every: dict[str, str] = refused.REFUSED
    faults = []
    for begin, kind in FAULTS.items():
        typed = next(typed for typed in every if typed.encode("utf-8", "replace").decode().startswith(begin))
        faults.append(Case("commands", kind, write_faulty(typed), Refused((every[typed],))))
    limits: dict[str, tuple[Callable[[Path], Words], Judge]] = {
        "1,000 balls in 10 frames": (write_crowd(1000, 10), Said(("No two balls touch",))),
        "10^5 particles in 10^6 rows": (
            write_crowd(100_000, 10), Refused(("100000 particles, expected at most", "max_particles", "--settings")),
        ),
        "500,000 positions": (write_long(2, 250_000), Said(("--pages writes it",))),
    }  # fmt: skip
    kept = partial(Unchanged, files=OWN)
    return [
        *(Case("commands", name_overwriting(typed), write_own(typed), kept((says,)))
          for typed, says in OVERWRITING.items()),
        *faults,
        Case("commands", "a table whose name is not UTF-8", write_latin_table, Measured(film_glints().truth)),
        Case("commands", "corrupt data in a TIFF", track(write_corrupt),
             Refused(("film.tif: frame 30 cannot be read",))),
        *(Case("limits", kind, make, judge) for kind, (make, judge) in limits.items()),
    ]  # fmt: skip
