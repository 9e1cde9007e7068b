"""Write the card of a dataset: its README.md, for people who have never seen the dataset."""

from __future__ import annotations

import html
import re
from collections.abc import Iterator
from typing import Any


def write_card(about: dict[str, Any], clips: int, names: list[str], holds: str = "all") -> str:
    """Write the card of a dataset.

    holds: "all"; "frames" of a challenge, whose card tells nothing of the truth; or its "truth".
    """
    video, plain = about.get("video", bool(about["gl"])), about.get("compression", "none") == "none"
    matte = any(scene.get("surface", {}).get("ball", "steel") != "steel" for scene in about.get("scenes", ()))
    title = f"{clips} clips of rolling {'' if matte else 'steel '}balls"
    if holds == "frames":
        title = f"A challenge: {title}"
    else:
        title = f"{', '.join(map(_plain, names))}: {'truth of ' if holds == 'truth' else ''}{title}"
    readers = _readers(video and holds != "truth", plain, holds != "truth", holds != "frames")
    return "\n".join(
        [
            f"# {title}",
            "",
            *_provenance(about, holds),
            "SI units; x right and y down in the image, (0, 0) the centre of the top-left pixel.",
            "Licence: CC0 1.0.",
            "",
            "| for | in one line |",
            "|---|---|",
            *(f"| {what} | {code} |" for what, code in readers),
            "",
            *(["Frames are compressed with Zstandard: tifffile then needs `imagecodecs`.", ""] if not plain else []),
            "`synthcam verify DATASET` compares every file with SHA256SUMS.",
            "",
        ]
    )


def _readers(frames: bool, plain: bool, camera: bool, truth: bool) -> Iterator[tuple[str, str]]:
    """Yield (program or purpose, code that reads the file). plain: frames that every library can unpack."""
    tiff = "clips/000000/frames.tif"
    if frames:
        yield "NumPy", f'`import tifffile; frames = tifffile.imread("{tiff}")`'
        yield "trackpy, pims", f'`import pims; frames = pims.open("{tiff}")`'
    if frames and plain:
        yield "OpenCV", f'`import cv2; frames = cv2.imreadmulti("{tiff}", flags=cv2.IMREAD_UNCHANGED)[1]`'
        yield "ImageJ, Fiji (macro)", f'`open("{tiff}");`'
    if camera:
        yield "the camera", '`import json; camera = json.load(open("clips/000000/camera.json"))`'
    if truth:
        yield "pandas, a row a clip", '`import pandas; clips = pandas.read_parquet("truth/clips.parquet")`'
        yield (
            "the balls' true positions, in trackpy's columns",
            '`import pandas; tracks = pandas.read_parquet("clips/000000/truth/tracks.parquet", '
            'columns=["frame", "particle", "x_mean_px", "y_mean_px"])'
            '.rename(columns={"x_mean_px": "x", "y_mean_px": "y"})`',
        )
        read_events = 'events = pandas.read_parquet("clips/000000/truth/events.parquet")'
        yield "contacts, slide ends", f"`import pandas; {read_events}`"


def _plain(text: Any) -> str:
    """Make a name plain text: on one line, without HTML, links or other marks of Markdown."""
    line = "".join(c if c.isprintable() else " " for c in str(text))[:200]
    return re.sub(r"([\\`*\[\]!|#])", r"\\\1", html.escape(line, quote=False))


def _provenance(about: dict[str, Any], holds: str) -> list[str]:
    drawn = f"drawn by {_plain(about['gl']['renderer'])}" if about["gl"] else "without video"
    if holds == "frames":
        return [
            f"Made by synthcam {about['version']}, {drawn}. Every position, spin and event is known,",
            "and kept by the author of this challenge; `tracker score RESULTS --truth TRUTH` compares results with it.",
        ]
    made = f"Made by synthcam {about['version']}, seed {about['seed']}, {drawn}."
    if holds == "truth":
        return [made, "The withheld truth: `tracker score RESULTS --truth` this folder."]
    return [
        made,
        "Synthetic: `truth/` holds every position, spin and event. A tracker may open the frames and camera.json only.",
    ]
