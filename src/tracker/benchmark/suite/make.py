"""Generation of a suite: films by the command `synthcam`, bounds of their positions, and the card."""

from __future__ import annotations

import os
import secrets
import shutil
import subprocess
import sys
from collections.abc import Mapping
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from synthcam_shared.errors import InputError
from synthcam_shared.jobs import Progress, run_all_jobs, use_one_thread
from synthcam_shared.outputs import open_resumable, write_atomically
from tracker.benchmark.suite.definition import (
    BOUNDS,
    DEFINITION,
    DIGEST_WITHOUT_CROWDS,
    FILMS,
    QUANTITY_BOUNDS,
    SUITE,
    TRUTH,
    Suite,
    SuiteDefinition,
    SuiteFilm,
    check_truth,
    open_suite,
    truth_digest,
)
from tracker.camera.recordings import RecordingSource, open_source
from tracker.detection.detect import detect, make_view
from tracker.results import load_json, write_json
from tracker.scoring.error_bars import compute_true_parameters, quantity_bounds
from tracker.scoring.localisation import MatchedDetections, match, position_bounds
from tracker.scoring.tracking_metrics import GATE_PX

CITATION = "The synthcam developers, synthcam: films of rolling balls with the truth about them, version {version}"


def make_suite(
    output: Path,
    definition: SuiteDefinition,
    withhold: Path | None = None,
    seed: int | None = None,
    workers: int = 0,
    progress: Progress = lambda done, of: None,
    scheduler: str = "",
) -> Suite:
    """Make a suite. The same call continues after an interruption.

    The films go to `output`, and the truth to `withhold`, apart from the films, or else to output/truth. The default
    seed is that of the definition, or a random one where the truth is withheld. 0 `workers`: one a core; a script
    without `if __name__ == "__main__"` needs 1. The workers of a Dask `scheduler` see the same folders. Raises
    InputError where a folder holds other files, or `synthcam` fails.
    """
    output = output.resolve()
    truth = withhold.resolve() if withhold else output / TRUTH
    if withhold and (output in truth.parents or truth in output.parents or truth == output):
        raise InputError(f"{truth}: is inside {output} or contains it; expected a separate folder for the truth")
    if (output / SUITE).is_file():
        return _reopen(output, truth, definition, seed)
    with open_resumable(output, "tracker benchmark make", "a new folder for the suite"):
        write_atomically(output / DEFINITION, definition.text)
        truth.mkdir(parents=True, exist_ok=True)
        chosen = _seed(truth, definition, seed, withhold is not None)
        steps = sum(2 + len(film.encoded) for film in definition.films)
        done = 0
        for number, film in enumerate(definition.films):
            _film(output, truth, film, chosen + number, scheduler)
            progress(done := done + 1, steps)
            for name, codec in film.encoded.items():
                folder, whole = output / FILMS / name, output / FILMS / film.name
                if not folder.exists():
                    asked = ["--format", codec, "--truth", str(truth / film.name), "-o", str(folder)]
                    _synthcam("export", str(whole), *asked)
                progress(done := done + 1, steps)
            write_bounds(output / FILMS / film.name, truth / film.name, workers, scheduler)
            progress(done := done + 1, steps)
        about = {
            "name": definition.data["name"],
            "version": definition.version,
            "size": definition.size,
            "split": "withheld" if withhold else "open",
            "seed": None if withhold else chosen,
            "licence": definition.data["licence"],
            "definition_sha256": definition.digest,
            "truth_sha256": truth_digest(truth, definition),
            **_digest_without_crowds(truth, definition),
            "parts": {name: {"film": part.film, "clips": list(part.clips)} for name, part in definition.parts.items()},
        }
        write_atomically(output / "README.md", make_card_text(about, definition))
        write_json(output / SUITE, about)
    return open_suite(output, truth)


def _digest_without_crowds(truth: Path, definition: SuiteDefinition) -> dict[str, str]:
    """The digest of the films of two balls, which suites without crowds may have too; nothing in such a suite."""
    films = {definition.parts[name].truth for name in definition.crowds}
    return {DIGEST_WITHOUT_CROWDS: truth_digest(truth, definition, films)} if films else {}


def _reopen(output: Path, truth: Path, definition: SuiteDefinition, seed: int | None) -> Suite:
    """Open a complete suite. Raises InputError where it is another one."""
    suite = open_suite(output, truth)
    there = (suite.about["size"], suite.about["definition_sha256"])
    if there != (definition.size, definition.digest) or (seed is not None and suite.about["seed"] not in (None, seed)):
        raise InputError(f"{output}: holds another suite (version {suite.about['version']}), expected a new folder")
    return check_truth(suite)


def _seed(truth: Path, definition: SuiteDefinition, seed: int | None, withheld: bool) -> int:
    """Choose the seed and keep it with the truth, for the same call after an interruption."""
    seed_file = "seed.json"  # with the truth
    known = truth / seed_file
    if known.is_file():
        return int(load_json(known)["seed"])
    chosen = seed if seed is not None else secrets.randbits(48) if withheld else int(definition.data["seed"])
    write_json(known, {"seed": chosen})
    return chosen


def _film(output: Path, truth: Path, film: SuiteFilm, seed: int, scheduler: str) -> None:
    """Generate the clips of a film, with the truth in its own folder."""
    scenes = output / "scenes"
    files = {scenes / f"{name}.yaml": {**scene, "name": name} for name, scene in film.scenes.items()}
    for path, scene in files.items():
        write_atomically(path, yaml.safe_dump(scene, sort_keys=False))
    (output / FILMS).mkdir(exist_ok=True)
    asked = ["--clips", str(film.clips), "--seed", str(seed), "--withhold-truth", str(truth / film.name)]
    asked += ["--scheduler", scheduler] if scheduler else []
    _synthcam("generate", *map(str, files), "-o", str(output / FILMS / film.name), *asked)
    shutil.rmtree(scenes)


def _synthcam(*words: str) -> None:
    """Run the command `synthcam`. Raises InputError with its last message."""
    command = [sys.executable, "-m", "synthcam", *words]
    env = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, check=False, env=env)
    if done.returncode:
        said = [line for line in done.stderr.splitlines() if line.strip()]
        raise InputError(f"synthcam {words[0]} ended with status {done.returncode}: {said[-1] if said else ''}")


def make_card_text(about: Mapping[str, Any], definition: SuiteDefinition) -> str:
    """Write the card of a suite: the text of its README.md."""
    clips = sum(len(part["clips"]) for part in about["parts"].values())
    open_split = about["split"] == "open"
    seed = about["seed"] if open_split else "withheld"
    where = (
        "in `truth/`, for developers of trackers; no tracker gets it"
        if open_split
        else "withheld; its SHA-256 is given above, and is checked before scoring"
    )
    rows = "\n".join(
        f"| {name} | films/{part['film']} | {part['clips'][0]:06d} to {part['clips'][-1]:06d} |"
        for name, part in about["parts"].items()
    )
    return f"""---
pretty_name: {about["name"]}, a benchmark of particle trackers
license: cc0-1.0
task_categories: [object-detection, other]
tags: [particle tracking, sub-pixel localisation, collisions, synthetic]
size_categories: [n<1K]
version: {about["version"]}
---

# {about["name"]}: a benchmark of particle trackers

| | |
|---|---|
| version | {about["version"]} ({about["size"]}); definition SHA-256 {about["definition_sha256"]} |
| made by | synthcam {version("synthcam")}, `tracker benchmark make` |
| seed | {seed} |
| split | {about["split"]}; truth SHA-256 {about["truth_sha256"]} |
| licence | {about["licence"]} |
| cite | {CITATION.format(version=version("synthcam"))}; benchmark version {about["version"]} |

{clips} clips of two balls that collide. `films/FILM/clips/NNNNNN` has frames.tif (or frames.mp4, frames.avi) and
camera.json: the input of a tracker. The truth is {where}.
A tracker has to find the centre of each ball in each frame: its mean over the exposure, in px, where (0, 0) is the
centre of the top-left pixel.

## To submit

A folder with `submission.json`, which needs only the name,

    {{"name": "...", "authors": "...", "url": "...", "point": "centre", "ms_per_frame": 2.5}}

and for each film a table: `FILM.csv` (or .parquet) with the columns clip, frame, particle, x, y, and x_std, y_std,
cov_xy where they are known; or `FILM/NNNNNN.EXT`, one file per clip in any format of docs/format.md. Then run

    tracker benchmark submit SUITE FOLDER -o REPORT

The balls of a clip without a table count as not found. `"point": "glint"` means that x, y are positions of the bright
spot; the camera file then converts them to centres. For a withheld split, the holder of the truth adds `--truth TRUTH`.

## Parts

| part | film | clips |
|---|---|---|
{rows}
"""


def write_bounds(film: Path, truth: Path, workers: int = 0, scheduler: str = "") -> None:
    """Write the bounds of all positions and quantities of a film beside its truth, unless they exist.

    A bound needs the light of the glint. The maximum-likelihood detector measures it once, as the median over the clip
    for each ball. All trackers are compared with the same bounds. Processes here do the work, or workers of Dask.
    """
    if (truth / BOUNDS).is_file() and (truth / QUANTITY_BOUNDS).is_file():
        return
    source = open_source(film)
    found = run_all_jobs(partial(_of_clip, source, truth), range(len(source)), workers, film, scheduler)
    rows, quantities = zip(*sorted(found, key=lambda one: one[1]["clip"]), strict=True)
    for name, table in ((QUANTITY_BOUNDS, pd.DataFrame(quantities)), (BOUNDS, pd.concat(rows, ignore_index=True))):
        write_atomically(truth / name, table.to_parquet(index=False))


def _of_clip(source: RecordingSource, truth: Path, index: int) -> tuple[pd.DataFrame, dict[str, float]]:
    """Bound xx, xy, yy (px^2) of each true position, with frame and particle; bounds of the quantities of the clip."""
    use_one_thread()
    clip = source.open_clip(index)
    folder = truth / "clips" / f"{clip.number:06d}" / "truth"
    true = pd.read_parquet(folder / "tracks.parquet")
    table = true[["frame", "particle"]].assign(clip=clip.number, xx=np.nan, xy=np.nan, yy=np.nan)
    quantities: dict[str, Any] = {"clip": clip.number}
    if clip.camera.matte:
        return table, quantities  # whole balls in room light have no bound here
    seen = detect(clip, make_view(clip)).glints
    place, _ = clip.camera.centre_of_glint(seen.xy)
    found = pd.DataFrame({"frame": seen.frame, "x": place[:, 0], "y": place[:, 1], "flux": seen.flux})
    near = match(true, found, GATE_PX, clip.camera.diameter_px)
    flux = true.iloc[near.pairs[:, 0]].assign(flux=found["flux"].to_numpy()[near.pairs[:, 1]])
    bright = true["particle"].map(flux.groupby("particle")["flux"].median())
    perfect = _perfect(true, bright)
    cov = position_bounds(perfect, clip.camera)
    for name, (i, j) in {"xx": (0, 0), "xy": (0, 1), "yy": (1, 1)}.items():
        values = np.full(len(table), np.nan)
        values[perfect.pairs[:, 0]] = cov[:, i, j]
        table[name] = values
    if true["particle"].nunique() > 2:
        return table, quantities  # a bound of a quantity is that of a film of one collision
    scalars = pd.read_parquet(truth / "truth" / "clips.parquet")
    tied = compute_true_parameters(true, scalars[scalars["clip"] == clip.number].iloc[0])
    return table, quantities | quantity_bounds(perfect, cov, tied, clip.camera)


def _perfect(true: pd.DataFrame, flux: pd.Series[float]) -> MatchedDetections:
    """The result of a tracker without errors: all balls that are wholly in view."""
    whole = np.flatnonzero(true["visible"].to_numpy(bool) & np.isfinite(flux.to_numpy(float)))
    found = true.iloc[whole].assign(x=true["x_mean_px"], y=true["y_mean_px"], flux=flux)
    pairs = np.stack([whole, np.arange(len(whole))], axis=1)
    return MatchedDetections(true, found.reset_index(drop=True), pairs, np.ones(len(whole), bool), 0, 0)
