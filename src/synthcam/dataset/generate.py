"""Clips in parallel, resumable, the same bytes whatever the workers."""

from __future__ import annotations

import errno
import json
import os
import platform
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from synthcam.dataset.files import finish, finish_shard, write_clip
from synthcam.dataset.staging import PLAN, PartialDataset, move_into_place, name_temporary, open_partial
from synthcam.dataset.workers import each
from synthcam.library import add_effects, digest, list_added_folders
from synthcam.scene.clip import Clip
from synthcam.scene.scene import Scene, check_scene
from synthcam_shared.errors import InputError

FULL = {errno.ENOSPC, errno.EDQUOT, errno.EROFS}  # what will happen to the next clip as well
STARTING = 3.0  # s of a processor: for less work it does not pay to start processes, which load for half as long


@dataclass(frozen=True)
class GenerationPlan:
    """What a dataset is made of: scenes with `clips` clips each, numbered on from one to the next.

    shard (I, N): only every N-th clip, from the I-th, so that each shard has its share of each scene.
    """

    scenes: tuple[Scene, ...]
    clips: int
    seed: int
    video: bool = True
    compression: str = "none"
    shard: tuple[int, int] | None = None

    @property
    def numbers(self) -> range:
        first, step = self.shard or (1, 1)
        return range(first - 1, self.clips * len(self.scenes), step)

    @property
    def total(self) -> int:
        return len(self.numbers)

    def clip(self, number: int) -> Clip:
        return self.scenes[number // self.clips].draw(number, self.seed)

    def document(self) -> dict[str, Any]:
        """What must agree for two runs to be the same dataset, or the same shard of it."""
        return {
            "scenes": [s.settings for s in self.scenes],
            "clips_per_scene": self.clips,
            "seed": self.seed,
            "video": self.video,
            "version": version("synthcam"),
            **({"compression": self.compression} if self.compression != "none" else {}),
            **({"shard": list(self.shard)} if self.shard else {}),
            **({"effect_files": files} if (files := self._effect_files()) else {}),
        }

    def _effect_files(self) -> dict[str, str]:
        """SHA-256 of the files of those effects in the scenes that no package brings."""
        used = sorted({name for s in self.scenes for name in s.settings.get("effects") or {}})
        return {name: found for name in used if (found := digest(name))}

    @classmethod
    def from_document(cls, document: dict[str, Any]) -> GenerationPlan:
        """The plan of a document, shards aside."""
        scenes = tuple(check_scene(s, "scene") for s in document["scenes"])
        wanted = {"clips_per_scene", "seed", "video"}
        clips, seed, video = (document[k] for k in sorted(wanted))
        return cls(scenes, clips, seed, video, document.get("compression", "none"))

    def estimate_bytes(self, clips: int) -> int:
        """Disk the frames of so many clips will take, before compression."""
        sizes = []
        for k in range(len(self.scenes)):
            clip = self.clip(k * self.clips)
            width, height = clip.camera.size
            channels = 3 if clip.drawn["camera"].get("colour") else 1
            sizes.append(width * height * clip.frames * channels * (1 if clip.sensor.bits == 8 else 2))
        return int(np.mean(sizes) * clips) if self.video else 0


@dataclass(frozen=True)
class GenerationOutcome:
    """made: clips written by this run. failed: what went wrong, a line a clip. root: of the truth, if complete."""

    made: int
    failed: tuple[str, ...]
    root: Path | None

    @property
    def table(self) -> pd.DataFrame | None:
        """The scalars, a row a clip; None while clips are missing."""
        return None if self.root is None else pd.read_parquet(self.root / "truth" / "clips.parquet")


def generate_dataset(
    plan: GenerationPlan,
    output: Path,
    workers: int,
    progress: Callable[[int, int], None],
    withheld: Path | None = None,
    scheduler: str = "",
    announce: Callable[[str], None] | None = None,
) -> GenerationOutcome:
    """Make a dataset.

    All is made in a folder beside it, `output`.partial, and moved into place when complete, so that a killed run goes
    on where it was.

    Parameters
    ----------
    plan : Plan
    output : Path
        Folder to make.
    workers : int
        Processes; 0: one a core, where so many are quicker.
    progress : callable
        Takes clips done and clips in all, after each clip.
    withheld : Path, optional
        Another folder, for the truth.
    scheduler : str
        Address of a Dask scheduler, whose workers see the same folders.
    announce : callable, optional
        Takes an estimate of time and disk, as text, after the first clips.

    Returns
    -------
    Outcome

    Raises
    ------
    InputError
        Where a folder holds something else, or the disk is full.
    NoGL
        Where nothing can draw.
    """
    made = open_partial(output, plan.document(), withheld)
    if made is None:
        progress(plan.total, plan.total)
        return GenerationOutcome(0, (), withheld or output)
    try:
        return _make(plan, made, workers, progress, scheduler, announce)
    except Exception as e:
        if not made.list_done():
            made.discard()
        if isinstance(e, OSError):
            where = e.filename or made.folder
            raise InputError(f"{where}: {_why(e)}; the same command goes on where it stopped") from None
        raise
    finally:
        made.close()


def _make(
    plan: GenerationPlan,
    made: PartialDataset,
    workers: int,
    progress: Callable[[int, int], None],
    scheduler: str,
    announce: Callable[[str], None] | None,
) -> GenerationOutcome:
    done = made.list_done()
    todo = [k for k in plan.numbers if k not in done]
    _check_disk(plan, made.folder, len(todo))
    drawn_by: list[dict[str, Any]] = []
    if scheduler:
        from synthcam_shared.dask_workers import Cluster  # here alone: Dask is an extra

        cluster = Cluster(scheduler)
        drawn_by = cluster.everywhere(partial(describe_machine, plan.video))
        results = cluster.each(todo, partial(_make_anywhere, *_worker_arguments(plan), *_folders(made)))
    else:
        results = _here(plan, made, todo, workers, announce)
    progress(len(done), plan.total)
    failed = []
    for k, (number, trouble) in enumerate(results, 1):
        failed += [f"clip {number}: {trouble}"] if trouble else []
        progress(len(done) + k, plan.total)
    made.tidy()
    if failed:
        if not made.list_done():
            made.discard()
        return GenerationOutcome(len(todo) - len(failed), tuple(failed), None)
    complete_dataset(plan, made, drawn_by or [describe_machine(plan.video)])
    return GenerationOutcome(len(todo), (), made.withheld or made.output)


def complete_dataset(plan: GenerationPlan, made: PartialDataset, drawn_by: list[dict[str, Any]]) -> None:
    """Write what covers all clips and move the dataset into its place. drawn_by: each kind of machine once."""
    about = plan.document() | drawn_by[0] | ({"drawn_by": drawn_by} if len(drawn_by) > 1 else {})
    if plan.shard:
        finish_shard(made.folder, about | {"clips": list(plan.numbers)}, unlisted=PLAN)
    else:
        finish(made.folder, about, unlisted=PLAN, secret=made.truth if made.withheld else None)
    made.publish()


def _here(
    plan: GenerationPlan, made: PartialDataset, todo: list[int], workers: int, announce: Callable[[str], None] | None
) -> Iterator[tuple[int, str]]:
    """Make the clips on this machine: (number, '' or what went wrong), in the order in which they end."""
    folders = _folders(made)
    if todo and (announce or not workers):
        trials = sorted({todo[0], todo[len(todo) // 2], todo[-1]})  # of several scenes, where there are several
        ends = []
        for number in trials:  # the first loads libraries, draws the chip and starts OpenGL
            yield number, make_clip(plan, number, *folders)
            ends.append((time.perf_counter(), time.process_time()))
        todo = [k for k in todo if k not in trials]
        if todo:
            seconds, work = ((late - early) / (len(ends) - 1) for early, late in zip(ends[0], ends[-1], strict=True))
            workers = workers or ((os.cpu_count() or 1) if work * len(todo) > STARTING else 1)
            if announce:
                announce(_estimate(made, trials, seconds, len(todo), workers))
    others = max(min(workers, len(todo)) - 1, 0)
    yield from each(
        todo, others, partial(_ready, *_worker_arguments(plan), *folders), lambda k: make_clip(plan, k, *folders)
    )


def _estimate(made: PartialDataset, trials: list[int], seconds: float, clips: int, workers: int) -> str:
    """What so many clips will take. seconds: of one on one worker."""
    left = seconds * clips / min(workers, clips)
    unit = f"{left / 60:.0f} min" if left > 90 else f"{left:.0f} s"
    folders = {folder for number in trials for folder in made.clip(number)}
    size = sum(file.stat().st_size for folder in folders for file in folder.glob("*") if file.is_file())
    need, free = size / len(trials) * clips / 1e6, shutil.disk_usage(made.folder).free / 1e6
    return f"{clips} clips to come: about {unit}, {need:,.1f} MB of {free:,.0f} MB free"


def _check_disk(plan: GenerationPlan, folder: Path, clips: int) -> None:
    need, free = plan.estimate_bytes(clips), shutil.disk_usage(folder).free
    if need > free and plan.compression == "none":
        raise InputError(f"{folder}: {clips} clips take {need / 1e6:,.0f} MB, and {free / 1e6:,.0f} MB are free there")


def _folders(made: PartialDataset) -> tuple[Path, Path]:
    return made.folder.absolute(), made.truth.absolute()


def _worker_arguments(plan: GenerationPlan) -> tuple[str, tuple[Path, ...]]:
    """What a worker must know: the plan's document, and the folders with effects."""
    return json.dumps(plan.document()), list_added_folders()


def _ready(document: str, effects: tuple[Path, ...], folder: Path, secret: Path) -> Callable[[int], str]:
    """In a worker: what makes a clip."""
    return partial(_make_anywhere, document, effects, folder, secret)


@lru_cache(maxsize=2)
def _plan(document: str) -> GenerationPlan:
    return GenerationPlan.from_document(json.loads(document))


def _make_anywhere(document: str, effects: tuple[Path, ...], folder: Path, secret: Path, number: int) -> str:
    """In a worker, perhaps on another machine: make one clip of the plan of `document`."""
    wanted = json.loads(document)["version"]
    if version("synthcam") != wanted:
        return f"its worker has synthcam {version('synthcam')}, expected {wanted}"
    for known in effects:
        add_effects(known)
    if not (folder / "clips").is_dir():
        return f"{folder}: no such folder on {platform.node()}; workers must see the dataset's folder at the same path"
    return make_clip(_plan(document), number, folder, secret)


def make_clip(plan: GenerationPlan, number: int, folder: Path, secret: Path | None = None) -> str:
    """Make one clip of a plan in `folder`/clips; '' or one line on why it could not be made.

    secret: another folder for the truth. A full disk is raised, for no clip would fare better.
    """
    name = f"{number:06d}"
    final, secret = folder / "clips" / name, secret or folder
    hidden = None if secret == folder else secret / "clips" / name / "truth"
    made, kept = name_temporary(final), name_temporary(hidden) if hidden else None
    try:
        clip = plan.clip(number)
        frames = clip.pictures() if plan.video else None
        write_clip(made, clip, frames, {"seed": plan.seed}, kept, plan.compression)
        if kept and hidden:
            move_into_place(kept, hidden)
        move_into_place(made, final)
    except Exception as e:
        for leftover in (made, kept):
            if leftover:
                shutil.rmtree(leftover, ignore_errors=True)
        if type(e).__name__ == "NoGL" or (isinstance(e, OSError) and e.errno in FULL):
            raise
        return _why(e)
    return ""


def _why(error: Exception) -> str:
    """One line; an unexpected error keeps its name."""
    if isinstance(error, OSError):
        return f"{error.strerror or error}"
    said = " ".join(str(error).split())
    return said if isinstance(error, ValueError) else f"{type(error).__name__}: {said}"


def describe_machine(video: bool) -> dict[str, Any]:
    """What, beside the plan, decides the pixels: OpenGL's renderer and this machine."""
    gl: dict[str, str] = {}
    if video:
        from synthcam.camera.render import gl_info

        gl = {k: v for k, v in gl_info().items() if k != "why"}  # asked for or found, the pixels are the same
    return {"gl": gl, "machine": _machine()}


def _machine() -> dict[str, str]:
    vendor = platform.processor() or platform.machine()
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("vendor_id"):
                vendor = line.partition(":")[2].strip()
                break
    except OSError:
        pass
    return {"cpu_vendor": vendor, "architecture": platform.machine()}
