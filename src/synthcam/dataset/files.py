"""Write, read and verify the files of a dataset, which docs/format.md describes; README.md is its card for people."""

import hashlib
import html
import json
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import tifffile
from numpy.typing import NDArray

from synthcam.dataset.parquet import build_array, encode_table
from synthcam.dataset.recorded_dataset import list_clip_folders
from synthcam.scene import ground_truth
from synthcam.scene.clip import Clip, list_energy_columns, list_track_columns
from synthcam_shared.errors import InputError
from synthcam_shared.json_values import replace_non_finite

Frames = Iterator[NDArray[np.uint8] | NDArray[np.uint16]]
SUMS = "SHA256SUMS"
VIDEO = "frames.tif"
_IN_NUMPY = {pa.int64(): np.int64, pa.float64(): np.float64, pa.string(): np.str_}


def write_clip(
    folder: Path, clip: Clip, frames: Frames | None, secret: Path | None = None, compression: str = "none"
) -> None:
    """Write the folder of one clip of a dataset.

    frames: None: no video.
    secret: another folder, for the truth.
    compression: "none" or "zstd"; both are lossless.
    """
    folder.mkdir(parents=True, exist_ok=True)
    secret = secret or folder / "truth"
    secret.mkdir(parents=True)
    _write_json(folder / "camera.json", clip.camera_json)
    pixels, file = "", ""
    if frames is not None:
        how, film = clip.drawn.get("video"), None
        if how:
            from synthcam.dataset.video import VideoWriter  # here alone: FFmpeg's libraries are slow to load

            film = VideoWriter(folder, how, clip.camera.fps, clip.camera.size, clip.sensor.bits)
            frames = film.tee(frames)
        pixels, file = _write_tiff(folder / VIDEO, clip, frames, compression)
        if film:
            film.close()
    row = {
        "clip": clip.number,
        "seed_key": f"{clip.seed}/{clip.number}",
        "scene": clip.drawn["name"],
        **clip.truth,
        "striker": clip.drawn["launch"]["striker"],
        "effects": json.dumps(clip.drawn["effects"], sort_keys=True),
        "frames_sha256": file,
        "pixels_sha256": pixels,
    }
    _write_json(secret / "scene.json", {"seed": clip.seed, "clip": clip.number, "drawn": clip.drawn, "row": row})
    events = ground_truth.list_true_events(clip.view.motion, clip.camera.fps)
    tables = {"tracks": list_track_columns(clip), "events": events}
    if clip.drawn.get("launches"):
        tables["energy"] = list_energy_columns(clip)
    for name, table in tables.items():
        # by way of memory, so that a full disk is the same error as for other files
        (secret / f"{name}.parquet").write_bytes(encode_table(table))


def _write_tiff(path: Path, clip: Clip, frames: Frames, compression: str) -> tuple[str, str]:
    """Write a stack frame by frame, uncompressed in ImageJ's format. Returns SHA-256 of its pixels and of the file."""
    width, height = clip.camera.size
    dtype = np.uint8 if clip.sensor.bits == 8 else np.uint16
    pixels, whole = hashlib.sha256(), hashlib.sha256()

    def hash_frames() -> Frames:
        for frame in frames:
            pixels.update(frame.data)
            yield frame

    colour = bool(clip.drawn["camera"].get("colour"))
    size = clip.frames * width * height * dtype().itemsize * (3 if colour else 1)
    imagej_limit = 4_000_000_000  # bytes; a longer stack is a plain BigTIFF
    plain = compression == "none" and size < imagej_limit and not (colour and clip.sensor.bits > 8)
    about = {"axes": "TYX", "fps": clip.camera.fps} | ({"finterval": 1 / clip.camera.fps} if plain else {})
    shape: tuple[int, ...] = (clip.frames, height, width)
    photometric = "minisblack"
    if colour:
        shape, photometric, about["axes"] = (*shape, 3), "rgb", "TYXS"
    write = partial(tifffile.imwrite, path, shape=shape, dtype=dtype, metadata=about)
    if compression != "none":
        write(data=hash_frames(), photometric=photometric, compression=compression)
        return pixels.hexdigest(), hash_file(path)
    kind: dict[str, Any] = {"imagej": True} if plain else {"photometric": photometric}
    placed = write(data=None, returnoffset=True, **kind)
    assert placed is not None
    # Written into the space left for them and hashed on the way: reading the file again takes as long as writing it.
    with path.open("r+b") as file:
        whole.update(file.read(placed[0]))
        for frame in hash_frames():
            whole.update(frame.data)
            file.write(frame.data)
        if file.tell() != placed[0] + size:
            raise RuntimeError(f"{path}: expected {clip.frames} frames of {dtype.__name__}, {width} x {height}")
        whole.update(file.read())
    return pixels.hexdigest(), whole.hexdigest()


def finish_dataset(folder: Path, about: dict[str, Any], unlisted: str = "", secret: Path | None = None) -> None:
    """Write the files that cover all clips: clips.parquet, dataset.json, the card, the checksums.

    Memory does not grow with the number of clips. unlisted: a file without a checksum. secret: the folder with the
    truth, if it is another one.
    """
    root = secret or folder
    (root / "truth").mkdir(exist_ok=True)
    count, names = _write_rows(root)
    _write_json(root / "truth" / "dataset.json", about)
    holds = ("frames", "truth") if secret else ("all", "all")
    for where, what in {folder: holds[0], root: holds[1]}.items():
        (where / "README.md").write_text(write_card(about, count, names, what), encoding="utf-8")
        write_checksums(where, root, unlisted)


def finish_shard(folder: Path, about: dict[str, Any], unlisted: str = "") -> None:
    """Write the files that complete a shard of a dataset: shard.json and the checksums."""
    (folder / "truth").mkdir(exist_ok=True)
    _write_json(folder / "truth" / "shard.json", about)
    write_checksums(folder, folder, unlisted)


def _write_rows(root: Path) -> tuple[int, list[str]]:
    """Gather the clips' rows into truth/clips.parquet. Returns their number and the names of their scenes."""
    columns = {"clip": pa.int64(), "seed_key": pa.string(), "scene": pa.string()}
    columns |= dict.fromkeys(ground_truth.COLLISION_COLUMNS, pa.float64())
    columns |= dict.fromkeys(("striker", "effects", "frames_sha256", "pixels_sha256"), pa.string())
    schema = pa.schema(columns)
    clips, names = list_clip_folders(root), dict[str, None]()
    with (root / "truth" / "clips.parquet").open("wb") as file, pq.ParquetWriter(file, schema) as writer:
        for start in range(0, len(clips), 1024):  # rows in memory at a time
            batch = clips[start : start + 1024]
            rows = [json.loads((c / "truth" / "scene.json").read_text())["row"] for c in batch]
            names |= dict.fromkeys(row["scene"] for row in rows)
            arrays = [  # with NaN for None
                build_array(np.array([row[name] for row in rows], _IN_NUMPY[kind]), kind, nan_is_null=False)
                for name, kind in columns.items()
            ]
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
    return len(clips), list(names)


def write_checksums(folder: Path, root: Path, unlisted: str = "") -> None:
    """Write SHA256SUMS of all files of a dataset but itself and `unlisted`. root: the folder with the truth."""
    with (folder / SUMS).open("w", encoding="utf-8") as sums:
        for path in _files(folder):
            if path.name not in (SUMS, unlisted):
                # The truth has the SHA-256 of the video that was written. Hashing it again would take a tenth of the
                # whole time, and miss changes since.
                scene = root / "clips" / path.parent.name / "truth" / "scene.json"
                recorded = json.loads(scene.read_text())["row"]["frames_sha256"] if path.name == VIDEO else None
                sums.write(f"{recorded or hash_file(path)}  {path.relative_to(folder).as_posix()}\n")


def _files(folder: Path) -> Iterator[Path]:
    """Yield all files below a folder in order, one folder at a time."""
    for path in sorted(folder.iterdir()):
        if path.is_dir():
            yield from _files(path)
        else:
            yield path


def hash_file(path: Path) -> str:
    with path.open("rb") as f:
        return hashlib.file_digest(f, "sha256").hexdigest()


def _write_json(path: Path, value: Any) -> None:
    path.write_text(json.dumps(replace_non_finite(value), indent=1, allow_nan=False) + "\n", encoding="utf-8")


@dataclass(frozen=True)
class VerifyOutcome:
    """Outcome of `verify`."""

    files: int  # number of those checked
    problems: tuple[str, ...]  # a line each


def verify(folder: Path, progress: Callable[[int, int], None] = lambda done, total: None) -> VerifyOutcome:
    """Verify the files of a dataset by its checksums and counts. Raises InputError if it is not a finished dataset."""
    listed = read_checksums(folder)
    problems = []
    for k, (name, digest) in enumerate(listed.items(), 1):
        path = folder / name
        if not path.is_file():
            problems.append(f"{name}: missing")
        elif hash_file(path) != digest:
            problems.append(f"{name}: changed (its SHA-256 is not the one recorded)")
        progress(k, len(listed))
    for path in _files(folder):
        name = path.relative_to(folder).as_posix()
        if name != SUMS and name not in listed:
            problems.append(f"{name}: not listed in {SUMS}")
    if not problems:
        problems += _counts(folder)
    return VerifyOutcome(len(listed), tuple(problems))


def read_checksums(folder: Path) -> dict[str, str]:
    """Read SHA-256 by file. Raises InputError if the dataset is not finished, or a path leads out of it."""
    if not (folder / SUMS).is_file():
        raise InputError(f"{folder}: not a finished dataset (no {SUMS})")
    listed = {}
    for number, line in enumerate((folder / SUMS).read_text(errors="replace").splitlines(), 1):
        digest, gap, name = line.partition("  ")
        inside = Path(name).as_posix() == name and not os.path.isabs(name) and ".." not in Path(name).parts
        if not gap or len(digest) != 64 or not inside:
            raise InputError(f"{folder / SUMS}, line {number}: expected a SHA-256 and a path inside the dataset")
        listed[name] = digest
    return listed


def _counts(folder: Path) -> list[str]:
    """Compare the number of clips with the tables: a list of checksums may have been shortened with its files."""
    clips, problems = list_clip_folders(folder), []
    numbers = [int(c.name) for c in clips]
    shard = folder / "truth" / "shard.json"
    if shard.is_file():
        wanted = json.loads(shard.read_text())["clips"]
        return [] if numbers == wanted else [f"clips/: {len(numbers)} folders for {len(wanted)} clips of the shard"]
    if not (folder / "truth" / "clips.parquet").is_file():
        return [] if numbers == list(range(len(clips))) else [f"clips/: {len(clips)} folders, with gaps between them"]
    with (folder / "truth" / "clips.parquet").open("rb") as file:
        table = pq.read_table(file, columns=["clip", "frames_sha256"]).to_pydict()
    listed, digests = table["clip"], table["frames_sha256"]
    if numbers != listed:
        problems.append(f"clips/: {len(clips)} folders for {len(listed)} rows of truth/clips.parquet")
    for path, digest in zip(clips, digests, strict=False):
        withheld = not (path / "camera.json").exists()
        if digest and not withheld and digest != hash_file(path / VIDEO):
            problems.append(f"clips/{path.name}/{VIDEO}: not the frames of truth/clips.parquet")
    return problems


def write_card(about: dict[str, Any], clips: int, names: list[str], holds: str = "all") -> str:
    """Write the card of a dataset.

    holds: "all"; "frames" of a challenge, whose card tells nothing of the truth; or its "truth".
    """
    import jinja2  # here alone: the other commands do not need it

    environment = jinja2.Environment(trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True)
    environment.filters["plain"] = _make_plain
    return environment.from_string(Path(__file__).with_name("card.md").read_text(encoding="utf-8")).render(
        about=about,
        clips=clips,
        names=names,
        holds=holds,
        video=about.get("video", bool(about["gl"])),
        compressed=about.get("compression", "none") != "none",
        matte=any(scene.get("surface", {}).get("ball", "steel") != "steel" for scene in about.get("scenes", ())),
    )


def _make_plain(text: Any) -> str:
    """Make a name plain text: on one line, without HTML, links or other marks of Markdown."""
    line = "".join(c if c.isprintable() else " " for c in str(text))[:200]
    return re.sub(r"([\\`*\[\]!|#])", r"\\\1", html.escape(line, quote=False))
