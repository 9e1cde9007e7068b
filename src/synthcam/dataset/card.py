"""A dataset's card: its README.md, for people who have never seen the dataset."""

from __future__ import annotations

import html
import re
from typing import Any

LONGEST = 200  # characters of a name
TIFF = "clips/000000/frames.tif"
FRAMES = (
    ("NumPy", f'`import tifffile; frames = tifffile.imread("{TIFF}")`'),
    ("trackpy, pims", f'`import pims; frames = pims.open("{TIFF}")`'),
)
PLAIN = (  # what not every library can unpack
    ("OpenCV", f'`import cv2; frames = cv2.imreadmulti("{TIFF}", flags=cv2.IMREAD_UNCHANGED)[1]`'),
    ("ImageJ, Fiji (macro)", f'`open("{TIFF}");`'),
)
CAMERA = (("the camera", '`import json; camera = json.load(open("clips/000000/camera.json"))`'),)
TRUTH = (
    ("pandas, a row a clip", '`import pandas; clips = pandas.read_parquet("truth/clips.parquet")`'),
    (
        "where the balls were, in trackpy's columns",
        '`import pandas; tracks = pandas.read_parquet("clips/000000/truth/tracks.parquet", '
        'columns=["frame", "particle", "x_mean_px", "y_mean_px"])'
        '.rename(columns={"x_mean_px": "x", "y_mean_px": "y"})`',
    ),
    ("contacts, slide ends", '`import pandas; events = pandas.read_parquet("clips/000000/truth/events.parquet")`'),
)


def write_card(about: dict[str, Any], clips: int, names: list[str], holds: str = "all") -> str:
    """The card of a dataset. holds: "all", "frames" of a challenge, whose card gives nothing away, or its "truth"."""
    video, plain = about.get("video", bool(about["gl"])), about.get("compression", "none") == "none"
    matte = any(scene.get("surface", {}).get("ball", "steel") != "steel" for scene in about.get("scenes", ()))
    made_of = "" if matte else "steel "
    readers: list[tuple[str, str]] = []
    if holds != "truth":
        readers += [*FRAMES, *(PLAIN if plain else ())] if video else []
        readers += CAMERA
    if holds != "frames":
        readers += TRUTH
    return "\n".join(
        [
            f"# {_title(clips, names, holds, made_of)}",
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
            "`synthcam verify DATASET` holds every file to SHA256SUMS.",
            "",
        ]
    )


def _title(clips: int, names: list[str], holds: str, made_of: str) -> str:
    if holds == "frames":
        return f"A challenge: {clips} clips of rolling {made_of}balls"
    what = "truth of " if holds == "truth" else ""
    return f"{', '.join(map(_plain, names))}: {what}{clips} clips of rolling {made_of}balls"


def _plain(text: Any) -> str:
    """A name as it stands: on one line, without HTML, links or other marks of Markdown."""
    line = "".join(c if c.isprintable() else " " for c in str(text))[:LONGEST]
    return re.sub(r"([\\`*\[\]!|#])", r"\\\1", html.escape(line, quote=False))


def _provenance(about: dict[str, Any], holds: str) -> list[str]:
    drawn = f"drawn by {_plain(about['gl']['renderer'])}" if about["gl"] else "without video"
    if holds == "frames":
        return [
            f"Made by synthcam {about['version']}, {drawn}. Every position, spin and event is known,",
            "and kept by whoever made this; `tracker score RESULTS --truth TRUTH` holds results to it.",
        ]
    made = f"Made by synthcam {about['version']}, seed {about['seed']}, {drawn}."
    if holds == "truth":
        return [made, "The truth that was withheld: `tracker score RESULTS --truth` this folder."]
    return [
        made,
        "Synthetic: every position, spin and event is known and lies under `truth/`; a tracker may open the frames",
        "and camera.json only.",
    ]
