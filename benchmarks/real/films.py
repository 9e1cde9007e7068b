"""Films of others beside marks by colour: positions found, missed and false, and the time.

python -m benchmarks.real.films CLONE [CLONE ...] [--only WORD] [-o out/real_films.json]
make bench-films CLONES="CLONE ..."

Each CLONE is a clone of one of the repositories of `FILMS`; its folder's name must contain that of the repository.
docs/real_films.md describes the films. `tracker track` follows each of them without a hint, unless `options` say so. A
position within 8 px of a mark counts as found.

The marks are centres of pixels by colour. They use no code of the tracker, and leave out what colour cannot tell:
frames that repeat the one before, and discs of a plot whose pictures touch.
"""

from __future__ import annotations

import argparse
import re
import resource
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import av
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.cluster.vq import kmeans2
from scipy.ndimage import binary_closing, find_objects, label, maximum_filter1d
from scipy.optimize import linear_sum_assignment

from benchmarks.harness import add_clones, program, save

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Ints = NDArray[np.int64]
Frames = NDArray[np.int16]
REACH_PX = 8.0


@dataclass(frozen=True)
class Marks:
    """Marks of one frame: the centres, px, and the pixels of balls that have no mark."""

    centres: Floats
    unmarked: Mask


@dataclass(frozen=True)
class MarkedFilm:
    """A film, how it is tracked, and how it is marked.

    `mark` takes all frames (n, height, width, 3) as signed integers, and gives the marks of each.
    """

    name: str
    repository: str
    path: str
    mark: Callable[[Frames], Iterator[Marks]]
    options: str = ""
    frames: int | None = None


def find_regions(mask: Mask) -> list[tuple[Mask, Floats]]:
    """Find connected regions, the largest first: each as a mask, and its pixels (n, 2) as x, y."""
    labels, _ = label(mask)
    out = []
    for number, box in enumerate(find_objects(labels), start=1):
        rows, columns = np.nonzero(labels[box] == number)
        pixels = np.column_stack([columns + box[1].start, rows + box[0].start]).astype(float)
        region = np.zeros_like(mask)
        region[box] = labels[box] == number
        out.append((region, pixels))
    return sorted(out, key=lambda one: -len(one[1]))


def find_repeated(frames: Frames) -> Mask:
    """Find frames (n,) that change by less than a fifth of the largest change of their ten neighbours."""
    change = np.array([np.abs(later - frame).mean() for frame, later in pairwise(frames)])
    return np.array([False, *(change < 0.2 * maximum_filter1d(change, 11))])


def mark_largest(
    colour: Callable[[Frames], Mask], least: int, repeats: bool = False
) -> Callable[[Frames], Iterator[Marks]]:
    """Mark the largest region of a colour, if it has at least so many pixels.

    repeats: whether frames of the film repeat others. These have no mark.
    """

    def mark(frames: Frames) -> Iterator[Marks]:
        repeated = find_repeated(frames) if repeats else np.zeros(len(frames), bool)
        for frame, again in zip(frames, repeated, strict=True):
            mask = colour(frame)
            regions = [] if again else [pixels for _, pixels in find_regions(mask)[:1] if len(pixels) >= least]
            centres = np.array([pixels.mean(axis=0) for pixels in regions]).reshape(-1, 2)
            yield Marks(centres, np.full(mask.shape, bool(again)))

    return mark


def mark_single_discs(colour: Callable[[Frames], Mask]) -> Callable[[Frames], Iterator[Marks]]:
    """Mark regions with the usual number of pixels, to a fifth.

    Discs that touch make larger ones, and those that the rim cuts are not whole: both have no mark. A line of a grid
    does not divide a disc.
    """

    def mark(frames: Frames) -> Iterator[Marks]:
        for frame in frames:
            mask = binary_closing(np.pad(colour(frame), 2), iterations=2)[2:-2, 2:-2]
            regions = [(region, pixels) for region, pixels in find_regions(mask) if len(pixels) > 30]
            usual = np.median([len(pixels) for _, pixels in regions])
            centres, unmarked = [], np.zeros(mask.shape, bool)
            for region, pixels in regions:
                inside = pixels.min() > 0 and (pixels.max(axis=0) < np.array(mask.shape[::-1]) - 1).all()
                if inside and abs(len(pixels) / usual - 1) < 0.2:
                    centres.append(pixels.mean(axis=0))
                else:
                    unmarked |= region
            yield Marks(np.array(centres).reshape(-1, 2), unmarked)

    return mark


def mark_by_background(frames: Frames) -> Iterator[Marks]:
    """Mark what differs from the median picture by 45 counts: 500 to 1500 px are a ball, and more are two."""
    background = np.median(frames[::4], axis=0)
    for frame in frames:
        mask = np.abs(frame - background).max(axis=-1) > 45
        centres: list[Floats] = []
        for _, pixels in find_regions(mask):
            if len(pixels) > 1500:
                centres.extend(kmeans2(pixels, 2, minit="++", seed=1)[0])
            elif len(pixels) >= 500:
                centres.append(pixels.mean(axis=0))
        yield Marks(np.array(centres).reshape(-1, 2), np.zeros(mask.shape, bool))


def is_orange(frame: Frames) -> Mask:
    """Red 60 counts above blue."""
    return frame[..., 0] - frame[..., 2] > 60


def is_red(frame: Frames) -> Mask:
    """Red 60 counts above green."""
    return frame[..., 0] - frame[..., 1] > 60


def is_blue(frame: Frames) -> Mask:
    """Blue 100 counts above red."""
    return frame[..., 2] - frame[..., 0] > 100


def is_dark(frame: Frames) -> Mask:
    """Red under 200 counts."""
    return frame[..., 0] < 200


def is_bright(frame: Frames) -> Mask:
    """Red over 128 counts."""
    return frame[..., 0] > 128


BILLIARDS = "2D-Billiard-Ball-Tracking-Using-Kalman-Filter"
FILMS = (
    MarkedFilm("ball3", BILLIARDS, "videos/ball3.mov", mark_largest(is_orange, 150)),
    MarkedFilm("ball5", BILLIARDS, "videos/ball5.mov", mark_largest(is_orange, 150)),
    MarkedFilm("four balls", "self-assembly", "open_cv/SampleVideos/4Ball-short1.mp4", mark_by_background, frames=200),
    MarkedFilm("pendulum", "Pendulum_Oscillatory_Motion", "pendulum.mp4", mark_largest(is_red, 300)),
    MarkedFilm(
        "pendulum, its colour given",
        "Pendulum_Oscillatory_Motion",
        "pendulum.mp4",
        mark_largest(is_red, 300),
        "--colour red",
    ),
    MarkedFilm("20 discs", "phys5730", "collisions.mp4", mark_single_discs(is_blue), frames=100),
    MarkedFilm("10 discs", "yupi_examples", "resources/videos/demo.avi", mark_single_discs(is_dark), frames=100),
    MarkedFilm("rolling basketball", "Speed-of-object", "ball.mov", mark_largest(is_orange, 1000, repeats=True)),
    MarkedFilm("bouncing ball", "Kalman-filter-from-scratch", "ball.mp4", mark_largest(is_bright, 300, repeats=True)),
)


def read_film(film: MarkedFilm, clone: Path, folder: Path) -> tuple[Path, Frames, Ints]:
    """Copy a film out of its repository and decode it; the frames, and their numbers by the time stamps."""
    copy = folder / Path(film.path).name
    blob = subprocess.run(["git", "-C", clone, "show", f"HEAD:{film.path}"], capture_output=True, check=True)
    copy.write_bytes(blob.stdout)
    frames: list[Frames] = []
    times: list[float] = []
    with av.open(str(copy)) as container:
        for picture in container.decode(video=0):
            if film.frames is not None and len(frames) == film.frames:
                break
            frames.append(picture.to_ndarray(format="rgb24").astype(np.int16))
            times.append(float(picture.time))
    return copy, np.array(frames), number_frames(np.array(times))


def number_frames(times: Floats) -> Ints:
    """Number frames by their time stamps (n,), s, perhaps whole milliseconds. After a gap, numbers are left out."""
    steps = np.diff(times)
    return np.concatenate([[0], np.cumsum(np.rint(steps / np.median(steps)).astype(np.int64))])


def compare(tracks: pd.DataFrame, film: MarkedFilm, frames: Frames, numbers: Ints) -> dict[str, Any]:
    """Count the positions that lie on a mark, the marks without one, and the positions without a mark."""
    found = missed = false = 0
    squares = 0.0
    by_frame = {number: rows[["x", "y"]].to_numpy() for number, rows in tracks.groupby("frame")}
    for number, marks in zip(numbers.tolist(), film.mark(frames), strict=True):
        places = by_frame.get(number, np.empty((0, 2)))
        distance = np.linalg.norm(marks.centres[:, None] - places, axis=-1)
        row, column = linear_sum_assignment(np.minimum(distance, REACH_PX))
        near = distance[row, column] < REACH_PX
        others = np.delete(places, column[near], axis=0)
        x, y = (np.clip(np.rint(others[:, k]).astype(int), 0, frames.shape[2 - k] - 1) for k in (0, 1))
        found += int(near.sum())
        missed += len(marks.centres) - int(near.sum())
        false += int((~marks.unmarked[y, x]).sum())
        squares += float((distance[row, column][near] ** 2).sum())
    rms = (squares / max(found, 1)) ** 0.5
    return {"marks": found + missed, "found": found, "missed": missed, "false": false, "rms_px": rms}


def measure(film: MarkedFilm, clone: Path) -> dict[str, Any]:
    """Track one film by the command, and compare the result with the marks."""
    with tempfile.TemporaryDirectory() as scratch:
        copy, frames, numbers = read_film(film, clone, Path(scratch))
        cut = [] if film.frames is None else ["--frames", f"0:{film.frames}"]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        words = ["track", str(copy), "-o", f"{scratch}/results", *film.options.split(), *cut]
        done = subprocess.run([program("tracker"), *words], capture_output=True, text=True, check=False)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        if done.returncode:
            return {"status": done.stderr.strip()[-200:]}
        (table,) = (Path(scratch) / "results").rglob("tracks.parquet")
        tracks = pd.read_parquet(table)
        figures = compare(tracks, film, frames, numbers)
        used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        return figures | {"tracks": int(tracks["particle"].nunique()), "seconds": used}


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_clones(parser)
    parser.add_argument("--only", default="", help="films whose name contains this word")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/real_films.json"))
    given = parser.parse_args()
    clones = {
        film.name: next((c for c in given.clones if re.search(rf"(^|[/+]){re.escape(film.repository)}", str(c))), None)
        for film in FILMS
    }
    chosen = [film for film in FILMS if clones[film.name] is not None and given.only in film.name]
    if not chosen:
        raise SystemExit(f"expected paths to clones of {', '.join(sorted({film.repository for film in FILMS}))}")
    columns = ("marks", "found", "missed", "false", "rms_px", "tracks", "seconds")
    table = Table("film", *columns, title="Films of others")
    out = {}
    for film in chosen:
        clone = clones[film.name]
        assert clone is not None
        out[film.name] = figures = measure(film, clone)
        cells = [
            f"{figures[c]:.3g}" if isinstance(figures.get(c), float) else str(figures.get(c, "-")) for c in columns
        ]
        table.add_row(f"{film.name} {film.options}".strip(), *cells)
        print(film.name, figures, flush=True)
    Console(width=140).print(table)
    save(given.output, out)


if __name__ == "__main__":
    main()
