"""The card of a suite, as hosts of data sets expect it: README.md with its front matter."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

from tracker.benchmark.suite.definition import SuiteDefinition

CITATION = "The synthcam developers, synthcam: films of rolling balls with the truth about them, version {version}"


def card(about: Mapping[str, Any], definition: SuiteDefinition) -> str:
    """README.md of a suite."""
    clips = sum(len(part["clips"]) for part in about["parts"].values())
    open_split = about["split"] == "open"
    seed = about["seed"] if open_split else "withheld"
    where = (
        "in `truth/`, for whoever works on a tracker; no tracker is given it"
        if open_split
        else "withheld; it is the one whose SHA-256 stands above, which whoever scores checks first"
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
camera.json: what a tracker may see. The truth lies {where}.
What is to be found: the centre of each ball in each frame, px, its mean over the exposure, (0, 0) being the centre of
the top-left pixel.

## To submit

A folder with `submission.json`, of which only the name is needed,

    {{"name": "...", "authors": "...", "url": "...", "point": "centre", "ms_per_frame": 2.5}}

and for each film `FILM.csv` (or .parquet) with the columns clip, frame, particle, x, y, and, where they are known,
x_std, y_std, cov_xy; or `FILM/NNNNNN.EXT`, a file a clip in any format of docs/format.md. Then

    tracker benchmark submit SUITE FOLDER -o REPORT

A clip without a table counts as not found. `"point": "glint"` says that x, y are those of the bright spot; the camera
file then takes them to the centre. Of a withheld split, whoever holds the truth types this with `--truth TRUTH`.

## Parts

| part | film | clips |
|---|---|---|
{rows}
"""
