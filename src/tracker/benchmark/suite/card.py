"""The card of a suite: README.md with the front matter that hosts of data sets expect."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

from tracker.benchmark.suite.definition import SuiteDefinition

CITATION = "The synthcam developers, synthcam: films of rolling balls with the truth about them, version {version}"


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
