"""The files of a dataset, written and read. docs/format.md tells what each holds."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import tifffile
from numpy.typing import NDArray

from synthcam import truth
from synthcam.scene import Clip
from synthcam.settings import InputError
from synthcam.view import View

Frames = Iterator[NDArray[np.uint8] | NDArray[np.uint16]]
SUMS = "SHA256SUMS"


def camera_json(clip: Clip) -> dict[str, Any]:
    """What the experimenter knows: the nominal camera, lamp and sensor, and which ball was launched."""
    camera, sensor = clip.nominal, clip.drawn["sensor"]
    return {
        "K": camera.K.tolist(),
        "dist": camera.dist.tolist(),
        "R": camera.R.tolist(),
        "t": camera.t.tolist(),
        "size": list(camera.size),
        "fps": camera.fps,
        "exposure": camera.exposure,
        "scale": camera.scale,
        "ball_diameter": clip.model.ball.diameter,
        "striker": clip.drawn["launch"]["striker"],
        "lamp": {"position": list(clip.drawn["lamp"]["position"]), "radius": clip.drawn["lamp"]["radius"]},
        "psf": {"sigma_px": camera.psf_sigma_px},
        "sensor": {k: v for k, v in sensor.items() if k != "glint_peak"},
    }


def view_of(clip: Clip) -> View:
    """The clip's motion, over all its frames and to the last slide's end, as its camera takes it."""
    return View.of(clip.model, clip.launch, clip.camera, clip.frames)


def write_clip(folder: Path, clip: Clip, view: View, frames: Frames | None, meta: dict[str, Any]) -> None:
    """Write one clip's folder; `frames` None: no video. `meta` goes into its scene.json."""
    (folder / "truth").mkdir(parents=True)
    _write_json(folder / "camera.json", camera_json(clip))
    pixels, file = "", ""
    if frames is not None:
        pixels = _write_tiff(folder / "frames.tif", clip, frames)
        file = sha256(folder / "frames.tif")
    row = {"clip": clip.number, "seed_key": f"{meta['seed']}/{clip.number}", "scene": clip.drawn["name"]}
    row |= truth.scalars(clip.model, clip.launch, view.motion)
    row |= {
        "striker": clip.drawn["launch"]["striker"],
        "effects": json.dumps(clip.drawn["effects"], sort_keys=True),
        "frames_sha256": file,
        "pixels_sha256": pixels,
    }
    _write_json(folder / "truth" / "scene.json", {**meta, "clip": clip.number, "drawn": clip.drawn, "row": row})
    tables = {
        "tracks": truth.tracks(clip.launch.bodies, view, clip.lamp, clip.frames),
        "events": truth.events(view.motion, clip.camera.fps),
    }
    for name, table in tables.items():
        table.to_parquet(folder / "truth" / f"{name}.parquet", index=False)


def _write_tiff(path: Path, clip: Clip, frames: Frames) -> str:
    """Write an uncompressed ImageJ stack, frame by frame; the hash of its pixels."""
    width, height = clip.camera.size
    dtype = np.uint8 if clip.sensor.bits == 8 else np.uint16
    digest = hashlib.sha256()

    def hashed() -> Frames:
        for frame in frames:
            digest.update(frame.tobytes())
            yield frame

    tifffile.imwrite(
        path,
        hashed(),
        shape=(clip.frames, height, width),
        dtype=dtype,
        imagej=True,
        metadata={"axes": "TYX", "finterval": 1 / clip.camera.fps, "fps": clip.camera.fps},
    )
    return digest.hexdigest()


def finish(folder: Path, about: dict[str, Any], unlisted: str = "") -> pd.DataFrame:
    """Write what covers all clips: clips.parquet, dataset.json, the card, the checksums (without the file `unlisted`).

    Returns the scalars.
    """
    rows = [json.loads((c / "truth" / "scene.json").read_text())["row"] for c in clip_folders(folder)]
    table = pd.DataFrame(rows)
    table[truth.COLLISION] = table[truth.COLLISION].astype(float)
    (folder / "truth").mkdir(exist_ok=True)
    table.to_parquet(folder / "truth" / "clips.parquet", index=False)
    _write_json(folder / "truth" / "dataset.json", about)
    (folder / "README.md").write_text(_card(about, table))
    files = sorted(p for p in folder.rglob("*") if p.is_file() and p.name not in (SUMS, unlisted))
    (folder / SUMS).write_text("".join(f"{sha256(p)}  {p.relative_to(folder).as_posix()}\n" for p in files))
    return table


def clip_folders(folder: Path) -> list[Path]:
    """The complete clips of a dataset, in order."""
    return sorted(p for p in (folder / "clips").glob("[0-9]*") if p.is_dir() and p.name.isdigit())


def sha256(path: Path) -> str:
    with path.open("rb") as f:
        return hashlib.file_digest(f, "sha256").hexdigest()


def _write_json(path: Path, value: Any) -> None:
    path.write_text(json.dumps(_finite(value), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _finite(value: Any) -> Any:
    """NaN as null, for JSON has none."""
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


@dataclass(frozen=True)
class Check:
    """Outcome of `verify`: files looked at, and what is wrong, one line each."""

    files: int
    problems: tuple[str, ...]


def verify(folder: Path) -> Check:
    """Hold a dataset to its checksums and its counts. Raises InputError when it is no finished dataset."""
    if not (folder / SUMS).is_file():
        raise InputError(f"{folder}: not a finished dataset (no {SUMS})")
    problems, listed = [], {}
    for number, line in enumerate((folder / SUMS).read_text(errors="replace").splitlines(), 1):
        digest, gap, name = line.partition("  ")
        path = folder / name
        if not gap or len(digest) != 64 or os.path.isabs(name) or ".." in Path(name).parts:
            raise InputError(f"{folder / SUMS}, line {number}: expected a SHA-256 and a path inside the dataset")
        listed[name] = digest
        if not path.is_file():
            problems.append(f"{name}: missing")
        elif sha256(path) != digest:
            problems.append(f"{name}: changed (its SHA-256 is not the one recorded)")
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and name != SUMS and name not in listed:
            problems.append(f"{name}: not listed in {SUMS}")
    if not problems:
        problems += _counts(folder)
    return Check(len(listed), tuple(problems))


def _counts(folder: Path) -> list[str]:
    if not (folder / "truth" / "clips.parquet").is_file():
        return []
    table, problems = pd.read_parquet(folder / "truth" / "clips.parquet"), []
    clips = clip_folders(folder)
    if [int(c.name) for c in clips] != table["clip"].tolist():
        problems.append(f"clips/: {len(clips)} folders for {len(table)} rows of truth/clips.parquet")
    for path, digest in zip(clips, table["frames_sha256"], strict=False):
        if digest and digest != sha256(path / "frames.tif"):
            problems.append(f"clips/{path.name}/frames.tif: not the frames of truth/clips.parquet")
    return problems


def _card(about: dict[str, Any], table: pd.DataFrame) -> str:
    names = ", ".join(dict.fromkeys(table["scene"]))
    video = bool((table["frames_sha256"] != "").all())
    reading = [
        "| file | in one line |",
        "|---|---|",
        *(
            ['| `clips/000000/frames.tif` | `tifffile.imread("clips/000000/frames.tif")`, (frames, height, width) |']
            if video
            else []
        ),
        '| `clips/000000/camera.json` | `json.load(open("clips/000000/camera.json"))` |',
        '| `truth/clips.parquet` | `pandas.read_parquet("truth/clips.parquet")`, a row a clip |',
        '| `clips/000000/truth/tracks.parquet` | `pandas.read_parquet("clips/000000/truth/tracks.parquet")` |',
        '| `clips/000000/truth/events.parquet` | `pandas.read_parquet("clips/000000/truth/events.parquet")` |',
    ]
    return "\n".join(
        [
            f"# {names}: {len(table)} clips of rolling steel balls",
            "",
            f"Made by synthcam {about['version']}, seed {about['seed']}"
            + (f", drawn by {about['gl']['renderer']}." if about["gl"] else ", without video."),
            "Synthetic: every position, spin and event is known and lies under `truth/`; a tracker may open the frames",
            "and camera.json only. SI units; x right and y down in the image, (0, 0) the centre of the top-left pixel.",
            "Licence: CC0 1.0.",
            "",
            *reading,
            "",
            "`synthcam verify DATASET` holds every file to SHA256SUMS.",
            "",
        ]
    )
