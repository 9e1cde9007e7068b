"""Make a dataset: clips side by side in several processes, with the same bytes however many there are."""

import errno
import platform
import shutil
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

import numpy as np

from synthcam.dataset.files import finish_dataset, finish_shard, write_clip
from synthcam.dataset.partial_dataset import PLAN, PartialDataset, open_partial, place_clip
from synthcam.library import add_effects, hash_effect_files, list_added_folders
from synthcam.scene.clip import Clip, has_opengl_started
from synthcam.scene.scene import Scene, check_scene
from synthcam_shared.errors import InputError, NoGL
from synthcam_shared.interruption import raise_if_interrupted
from synthcam_shared.job_result import LostJob
from synthcam_shared.jobs import JobForecast, Progress, run_jobs

MAX_CLIPS = 1_000_000  # of one folder: six digits number them


@dataclass(frozen=True)
class GenerationPlan:
    """The plan of a dataset: scenes with `clips` clips each, numbered through.

    shard (I, N): only every N-th clip from the I-th on, so that each shard has its share of each scene.
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
        """Everything that must agree for two runs to make the same dataset, or the same shard of it."""
        files = hash_effect_files({name for scene in self.scenes for name in scene.settings.get("effects") or ()})
        return {
            "scenes": [s.settings for s in self.scenes],
            "clips_per_scene": self.clips,
            "seed": self.seed,
            "video": self.video,
            "version": version("synthcam"),
            **({"compression": self.compression} if self.compression != "none" else {}),
            **({"shard": list(self.shard)} if self.shard else {}),
            **({"effect_files": files} if files else {}),
        }

    @classmethod
    def from_document(cls, document: dict[str, Any]) -> Self:
        """Make the plan of a document without its shard."""
        scenes = tuple(check_scene(s, "scene") for s in document["scenes"])
        numbers = document["clips_per_scene"], document["seed"], document["video"]
        return cls(scenes, *numbers, document.get("compression", "none"))

    def estimate_bytes(self, clips: int) -> int:
        """Estimate the disk space of the frames of so many clips before compression, bytes."""
        sizes = []
        for k in range(len(self.scenes)):
            clip = self.clip(k * self.clips)
            width, height = clip.camera.size
            channels = 3 if clip.drawn["camera"].get("colour") else 1
            sizes.append(width * height * clip.frames * channels * (1 if clip.sensor.bits == 8 else 2))
        return int(np.mean(sizes) * clips) if self.video else 0


@dataclass(frozen=True)
class GenerationOutcome:
    """The result of one run."""

    made: int  # clips written by this run
    failed: tuple[str, ...]  # a line for each clip that could not be made: its number and the reason


def generate_dataset(
    plan: GenerationPlan,
    output: Path,
    workers: int,
    progress: Progress,
    withheld: Path | None = None,
    scheduler: str = "",
    announce: Callable[[str], None] | None = None,
) -> GenerationOutcome:
    """Make a dataset in the folder `output`, with its truth in another folder, `withheld`, if that is given.

    The dataset is made in a folder beside `output`, `output`.partial, and moved into place when it is complete. A run
    that was killed continues where it stopped.

    workers: processes; 0: one for each core, where so many are quicker.
    progress: takes the clips done and the clips in all, after each clip.
    scheduler: address of a Dask scheduler, whose workers see the same folders.
    announce: takes an estimate of time and disk, as text, after the first clips.

    Raises InputError if a folder holds something else or the disk is full, NoGL if OpenGL cannot draw.
    """
    with open_partial(output, plan.document(), withheld) as made:
        if made is None:
            progress(plan.total, plan.total)
            return GenerationOutcome(0, ())
        done = made.list_done()
        todo = [k for k in plan.numbers if k not in done]
        need, free = plan.estimate_bytes(len(todo)), shutil.disk_usage(made.folder).free
        if need > free and plan.compression == "none":
            room = f"{len(todo)} clips take {need / 1e6:,.0f} MB, and {free / 1e6:,.0f} MB are free there"
            raise InputError(f"{made.folder}: {room}")
        machines: list[dict[str, Any]] = []
        if scheduler:
            from synthcam_shared.dask_cluster import Cluster  # here alone: Dask is an optional dependency

            machines = Cluster(scheduler).ask_all(partial(describe_machine, plan.video))
        folders = made.folder.absolute(), made.truth.absolute()
        work = partial(_make_in_worker, plan, version("synthcam"), list_added_folders(), *folders)
        tell = None if announce is None else lambda trial: announce(_estimate(made, trial))
        fork = not has_opengl_started()
        failed = []
        with closing(run_jobs(work, todo, workers, scheduler, trials=3, announce=tell, fork=fork)) as jobs:
            progress(len(done), plan.total)  # afterwards: a bar on a terminal has a thread
            for count, result in enumerate(jobs, 1):
                problem = result.reason if isinstance(result, LostJob) else result.value
                failed += [f"clip {result.number}: {problem}"] if problem is not None else []
                progress(len(done) + count, plan.total)
        made.tidy()
        if failed:
            if not made.list_done():
                made.discard()
        else:
            complete_dataset(plan, made, machines or [describe_machine(plan.video)])
        return GenerationOutcome(len(todo) - len(failed), tuple(failed))


def complete_dataset(plan: GenerationPlan, made: PartialDataset, machines: list[dict[str, Any]]) -> None:
    """Complete the dataset that was generated: write what covers all clips, and move it into its place."""
    about = plan.document() | machines[0] | ({"drawn_by": machines} if len(machines) > 1 else {})
    if plan.shard:
        finish_shard(made.folder, about | {"clips": list(plan.numbers)}, unlisted=PLAN)
    else:
        finish_dataset(made.folder, about, unlisted=PLAN, secret=made.truth if made.withheld else None)
    made.publish()


def _estimate(made: PartialDataset, trial: JobForecast) -> str:
    """Describe the time and the disk that the remaining clips will take."""
    clips = trial.jobs_left
    seconds = trial.seconds * clips / min(trial.workers, clips)
    duration = f"{seconds / 60:.0f} min" if seconds > 90 else f"{seconds:.0f} s"
    folders = {folder for number in trial.numbers for folder in made.clip(number)}
    size = sum(file.stat().st_size for folder in folders for file in folder.glob("*") if file.is_file())
    need, free = size / len(trial.numbers) * clips / 1e6, shutil.disk_usage(made.folder).free / 1e6
    return f"{clips} clips to come: about {duration}, {need:,.1f} MB of {free:,.0f} MB free"


def _make_in_worker(
    plan: GenerationPlan, wanted: str, effects: tuple[Path, ...], folder: Path, secret: Path, number: int
) -> str | None:
    """Make a clip in a worker, perhaps on another machine. wanted: version of synthcam; effects: folders with them."""
    if version("synthcam") != wanted:
        return f"its worker has synthcam {version('synthcam')}, expected {wanted}"
    for known in effects:
        add_effects(known)
    if not (folder / "clips").is_dir():
        return f"{folder}: no such folder on {platform.node()}; workers must see the dataset's folder at the same path"
    return make_clip(plan, number, folder, secret)


def make_clip(plan: GenerationPlan, number: int, folder: Path, secret: Path | None = None) -> str | None:
    """Make one clip of a plan in `folder`/clips. secret: another folder, for the truth.

    Returns, in one line, why the clip could not be made; None if it was made. Raises OSError if the disk is full or
    read-only, for then no other clip can be made either, and NoGL if OpenGL cannot draw.
    """
    inside = Path("clips", f"{number:06d}")
    truth = None if secret in (None, folder) else secret / inside / "truth"
    try:
        with place_clip(folder / inside, truth) as (aside, truth_aside):
            clip = plan.clip(number)
            write_clip(aside, clip, clip.pictures() if plan.video else None, truth_aside, plan.compression)
    except Exception as error:
        raise_if_interrupted()  # a library has turned Ctrl-C into this error
        no_clip_can_be_made = isinstance(error, OSError) and error.errno in {errno.ENOSPC, errno.EDQUOT, errno.EROFS}
        if no_clip_can_be_made or isinstance(error, NoGL):
            raise
        if isinstance(error, OSError):
            return f"{error.strerror or error}"
        reason = " ".join(str(error).split())
        return reason if isinstance(error, ValueError) else f"{type(error).__name__}: {reason}"
    return None


def describe_machine(video: bool) -> dict[str, Any]:
    """Describe OpenGL's renderer and this machine, which decide the pixels of a dataset together with its plan."""
    gl: dict[str, str] = {}
    if video:
        from synthcam.camera.render import gl_info

        gl = {k: v for k, v in gl_info().items() if k != "why"}  # asked for or found, the pixels are the same
    cpu = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").is_file() else []
    vendors = (line.partition(":")[2].strip() for line in cpu if line.startswith("vendor_id"))
    vendor = next(vendors, platform.processor() or platform.machine())
    return {"gl": gl, "machine": {"cpu_vendor": vendor, "architecture": platform.machine()}}
