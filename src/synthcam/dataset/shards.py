"""Write a stream of labelled frames in shards, as tar files of WebDataset or as Zarr stores; a run can be continued."""

import importlib.util
import io
import json
import shutil
import tarfile
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from synthcam.dataset.generate import MAX_CLIPS
from synthcam.dataset.labelled_frames import MAX_FAILURES_IN_A_ROW, LabelledFrame, encode_png, make_clips
from synthcam.library import add_effects, hash_effect_files, list_added_folders
from synthcam.scene.clip import has_opengl_started
from synthcam.scene.scene import Scene
from synthcam_shared.errors import InputError
from synthcam_shared.job_result import LostJob
from synthcam_shared.jobs import Progress, count_cores, run_jobs
from synthcam_shared.outputs import name_temporary, open_resumable, write_atomically

PLAN = "stream.json"


@dataclass(frozen=True)
class ShardPlan:
    """The content of the shards of a stream.

    clips: numbered from 0; None: without end.
    clips_per_shard: the last shard may have fewer.
    every: every n-th frame of a clip only.
    kind: a key of `FORMATS`.
    """

    scene: Scene
    seed: int
    clips: int | None
    clips_per_shard: int
    every: int = 1
    kind: str = "webdataset"

    @property
    def shards(self) -> range:
        return range(-(-(self.clips or MAX_CLIPS) // self.clips_per_shard))

    def name(self, shard: int) -> str:
        return f"shard-{shard:06d}{FORMATS[self.kind][0]}"

    def clips_of(self, shard: int) -> range:
        first = shard * self.clips_per_shard
        return range(first, min(first + self.clips_per_shard, self.clips or MAX_CLIPS))

    def document(self) -> dict[str, Any]:
        """Everything that must agree for two runs to write the same shards; `clips` may grow."""
        files = hash_effect_files(self.scene.settings.get("effects") or ())
        shards = {"every": self.every, "clips_per_shard": self.clips_per_shard, "format": self.kind}
        made = {"version": version("synthcam"), "effect_files": files, "clips": self.clips}
        document = {"scene": self.scene.settings, "seed": self.seed} | shards | made
        plain: dict[str, Any] = json.loads(json.dumps(document))
        return plain


@dataclass(frozen=True)
class ShardOutcome:
    """The result of one run."""

    shards: int
    frames: int
    left_out: tuple[str, ...]  # a line for each clip that could not be made


def plan_shards(
    scene: Scene,
    seed: int,
    frames: int | None,
    clips: int | None,
    clips_per_shard: int | None,
    every: int,
    kind: str,
) -> ShardPlan:
    """Plan shards of so many clips, or of as many as have so many frames by the length of clip 0. Raises InputError."""
    usual_frames = 1000  # of a shard
    if kind not in FORMATS:
        raise InputError(f"--format {kind}: no such format; there are {', '.join(FORMATS)}")
    if kind == "zarr" and importlib.util.find_spec("zarr") is None:
        raise InputError("--format zarr: Zarr is not installed; type: pip install 'synthcam[zarr]'")
    if frames is not None and clips is not None:
        raise InputError(f"--clips {clips}: beside --frames; expected one of the two")
    frames_of_clip = -(-scene.draw(0, seed).frames // every)
    if frames is not None:
        clips = -(-frames // frames_of_clip)
    if clips is not None and clips > MAX_CLIPS:
        raise InputError(f"--clips {clips}: expected at most {MAX_CLIPS} clips in all")
    usual = max(1, usual_frames // frames_of_clip)
    return ShardPlan(scene, seed, clips, clips_per_shard or usual, every, kind)


def write_shards(plan: ShardPlan, folder: Path, workers: int, progress: Progress) -> ShardOutcome:
    """Write those shards that the folder lacks. Each appears when it is complete.

    workers: processes; 0: one for each core, where so many are quicker. progress: takes the clips done and the clips in
    all, 0 for a stream without end.

    Raises InputError if the folder holds something else, the disk is full or no clip can be made, and NoGL if OpenGL
    cannot draw.
    """
    with open_resumable(folder, "synthcam stream", "a new folder, or one that the same command began"):
        _take_up(plan, folder)
        there = {path.name for path in folder.iterdir()}
        todo = [shard for shard in plan.shards if plan.name(shard) not in there]
        done = sum(len(plan.clips_of(shard)) for shard in plan.shards if plan.name(shard) in there)
        frames, left_out = 0, list[str]()
        work = partial(_write_in_worker, plan, list_added_folders(), folder.absolute())
        endless = plan.clips is None  # then in order of their numbers, without a trial of the last ones
        workers = workers or (count_cores() if endless else 0)
        try:
            with closing(run_jobs(work, todo, workers, fork=not has_opengl_started())) as jobs:
                progress(done, plan.clips or 0)  # afterwards: a bar on a terminal has a thread
                for result in jobs:
                    if isinstance(result, LostJob):
                        raise InputError(f"{folder}: shard {result.number}: {result.reason}")
                    made, lines = result.value
                    frames, left_out = frames + made, left_out + lines
                    if not frames and len(left_out) >= MAX_FAILURES_IN_A_ROW:
                        break
                    done += len(plan.clips_of(result.number))
                    progress(done, plan.clips or 0)
        finally:
            for leftover in folder.glob("shard-*.tmp"):  # of workers that were killed, in this run or an earlier one
                _remove(leftover)
        if left_out and not frames:
            raise InputError(f"{folder}: no clip could be made; {left_out[-1]}")
        return ShardOutcome(len(todo), frames, tuple(left_out))


def _take_up(plan: ShardPlan, folder: Path) -> None:
    """Compare the plan with that of the folder, and note it there. Raises InputError if another stream is there."""
    file, wanted = folder / PLAN, plan.document()
    if file.is_file():
        try:
            found = json.loads(file.read_text(encoding="utf-8"))
        except ValueError:
            found = None
        if not isinstance(found, dict):
            raise InputError(f"{file}: not JSON; remove the folder to start again")
        for key in wanted.keys() - {"clips"}:
            if found.get(key) != wanted[key]:
                option = {"seed": "--seed", "every": "--every", "clips_per_shard": "--shards-of", "format": "--format"}
                what = option.get(key, key.replace("_", " "))
                raise InputError(f"{folder}: holds a stream made with another {what}; choose another folder")
        before = found.get("clips") or MAX_CLIPS
        if (plan.clips or MAX_CLIPS) <= before:
            wanted["clips"] = found.get("clips")
        elif before % plan.clips_per_shard:  # its last shard was not full
            _remove(folder / plan.name(before // plan.clips_per_shard))
    write_atomically(file, json.dumps(wanted, indent=1) + "\n")


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _write_in_worker(plan: ShardPlan, effects: tuple[Path, ...], folder: Path, shard: int) -> tuple[int, list[str]]:
    """Write one shard. Returns the number of its frames, and a line for each clip that is left out."""
    for known in effects:
        add_effects(known)
    left_out: list[str] = []
    final = folder / plan.name(shard)
    aside = name_temporary(final)
    count = 0

    def frames() -> Iterator[LabelledFrame]:
        nonlocal count
        for clip in make_clips(plan.scene, plan.seed, plan.clips_of(shard), plan.every, left_out.append):
            for frame in clip:
                count += 1
                yield frame

    try:
        FORMATS[plan.kind][1](frames(), aside)
        if count:
            aside.rename(final)
    finally:
        with suppress(OSError):
            _remove(aside)
    return count, left_out


def _describe(frame: LabelledFrame) -> dict[str, Any]:
    """The truth of a frame, and the camera, as JSON has it."""
    rows = zip(frame.ids.tolist(), frame.centres.tolist(), frame.boxes.tolist(), frame.visible.tolist(), strict=True)
    balls = [
        {"id": ball, "centre": [round(x, 6) for x in centre], "box": [round(x, 6) for x in box], "visible": whole}
        for ball, centre, box, whole in rows
    ]
    clip = frame.clip
    about = {"scene": clip.drawn["name"], "seed": clip.seed, "clip": clip.number, "frame": frame.frame}
    return about | {"balls": balls, "camera": clip.camera_json}


def _write_tar(frames: Iterator[LabelledFrame], path: Path) -> None:
    """A tar file of WebDataset: of each frame the picture, the labels of its pixels, and its truth."""
    with tarfile.open(path, "w", format=tarfile.USTAR_FORMAT) as tar:
        for frame in frames:
            if frame.image.dtype == np.uint8:
                end, image = "png", encode_png(frame.image)
            else:  # readers of PNG reduce it to 8 bits
                file = io.BytesIO()
                tifffile.imwrite(file, frame.image, photometric="rgb" if frame.image.ndim == 3 else "minisblack")
                end, image = "tif", file.getvalue()
            few = len(frame.clip.launch.bodies.radius) < 256
            labels = encode_png(frame.labels.astype(np.uint8) if few else frame.labels)
            truth = json.dumps(_describe(frame)).encode()
            for name, data in ((end, image), ("labels.png", labels), ("json", truth)):
                member = tarfile.TarInfo(f"{frame.clip.number:06d}-{frame.frame:06d}.{name}")
                member.size = len(data)
                tar.addfile(member, io.BytesIO(data))


def _write_zarr(frames: Iterator[LabelledFrame], path: Path) -> None:
    """A Zarr store: pictures and labels (sample, y, x), and the truth of all balls in one table of columns."""
    import zarr

    chunk_bytes = 4_000_000
    group = zarr.open_group(path, mode="w", zarr_format=3)
    balls = ("sample", "id", "centre", "box", "visible")
    columns: dict[str, list[Any]] = {name: [] for name in ("clip", "frame", *(f"balls/{c}" for c in balls))}
    cameras: dict[str, Any] = {}
    waiting: list[LabelledFrame] = []
    chunk = 1  # frames

    def flush() -> None:
        for name in ("image", "labels"):
            values = np.stack([getattr(frame, name) for frame in waiting])
            if name not in group:
                axes = ("sample", "y", "x", "channel")[: values.ndim]
                shape, chunks = (0, *values.shape[1:]), (chunk, *values.shape[1:])
                group.create_array(name, shape=shape, chunks=chunks, dtype=values.dtype, dimension_names=axes)
            group[name].append(values)
        waiting.clear()

    for number, frame in enumerate(frames):
        chunk = max(1, chunk_bytes // frame.image.nbytes)
        if "image" in group and group["image"].shape[1:] != frame.image.shape:
            raise InputError(f"clip {frame.clip.number}: frames of another size; expected one size for --format zarr")
        cameras[str(frame.clip.number)] = frame.clip.camera_json
        columns["clip"].append(frame.clip.number)
        columns["frame"].append(frame.frame)
        columns["balls/sample"] += [number] * len(frame.ids)
        for name, values in zip(balls[1:], (frame.ids, frame.centres, frame.boxes, frame.visible), strict=True):
            columns[f"balls/{name}"] += values.tolist()
        waiting.append(frame)
        if len(waiting) == chunk:
            flush()
    if waiting:
        flush()
    for name, found in columns.items():
        own, width = {"balls/centre": (["xy"], 2), "balls/box": (["edge"], 4)}.get(name, ([], 0))
        values = np.array(found) if found or not width else np.empty((0, width))
        axes = ["ball" if "/" in name else "sample", *own]
        group.create_array(name, data=values, dimension_names=axes)
    group.attrs["cameras"] = cameras


FORMATS: dict[str, tuple[str, Callable[[Iterator[LabelledFrame], Path], None]]] = {
    "webdataset": (".tar", _write_tar),
    "zarr": (".zarr", _write_zarr),
}
