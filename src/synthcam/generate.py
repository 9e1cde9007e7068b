"""Clips in parallel, resumable, the same bytes whatever the workers."""

from __future__ import annotations

import json
import multiprocessing
import os
import platform
import shutil
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd

from synthcam.dataset import Frames, clip_folders, finish, view_of, write_clip
from synthcam.scene import Clip, Scene, check_scene
from synthcam.sensor import Chip, Sensor
from synthcam.settings import InputError
from synthcam.view import View

PLAN = "plan.json"


@dataclass(frozen=True)
class Plan:
    """What a dataset is made of: scenes with `clips` clips each, numbered on from one to the next."""

    scenes: tuple[Scene, ...]
    clips: int
    seed: int
    video: bool = True

    @property
    def total(self) -> int:
        return self.clips * len(self.scenes)

    def clip(self, number: int) -> Clip:
        return self.scenes[number // self.clips].draw(number, self.seed)

    def document(self) -> dict[str, Any]:
        """What must agree for two runs to be the same dataset."""
        return {
            "scenes": [s.settings for s in self.scenes],
            "clips_per_scene": self.clips,
            "seed": self.seed,
            "video": self.video,
            "version": version("synthcam"),
        }

    def bytes(self) -> int:
        """Disk the frames will take, about."""
        sizes = []
        for k in range(len(self.scenes)):
            clip = self.clip(k * self.clips)
            width, height = clip.camera.size
            sizes.append(width * height * clip.frames * (1 if clip.sensor.bits == 8 else 2))
        return sum(sizes) * self.clips if self.video else 0


@dataclass(frozen=True)
class Outcome:
    """made: clips written by this run. failed: what went wrong, a line a clip. table: None while clips are missing."""

    made: int
    failed: tuple[str, ...]
    table: pd.DataFrame | None


def run(plan: Plan, output: Path, workers: int, tick: Callable[[int, int], None]) -> Outcome:
    """Make the dataset at `output`; `tick(done, total)` after each clip.

    All is made in a folder beside it, `output`.partial, and moved into place when complete, so that a killed run goes
    on where it was. Raises InputError when either folder holds something else, NoGL when nothing can draw.
    """
    partial = output.with_name(output.name + ".partial")
    if output.exists() and not _empty(output):
        _same_or_refuse(plan, output, output / "truth" / "dataset.json")
        tick(plan.total, plan.total)
        return Outcome(0, (), pd.read_parquet(output / "truth" / "clips.parquet"))
    # a run killed at its very end has left no plan any more, but a dataset.json
    about = partial / "truth" / "dataset.json"
    _same_or_refuse(plan, partial, about if about.is_file() and not (partial / PLAN).exists() else partial / PLAN)
    partial.mkdir(parents=True, exist_ok=True)
    aside = partial.with_name(partial.name + ".plan")
    aside.write_text(json.dumps(plan.document(), indent=1))
    aside.replace(partial / PLAN)
    (partial / "clips").mkdir(exist_ok=True)
    for leftover in (partial / "clips").glob("*.tmp"):
        shutil.rmtree(leftover)
    done = {int(c.name) for c in clip_folders(partial)}
    todo = [k for k in range(plan.total) if k not in done]
    tick(len(done), plan.total)
    failed = []
    for k, trouble in enumerate(_each(plan, partial, todo, workers), 1):
        failed += [trouble] if trouble else []
        tick(len(done) + k, plan.total)
    if failed:
        if not clip_folders(partial):
            shutil.rmtree(partial)
        return Outcome(len(todo) - len(failed), tuple(failed), None)
    about_all = plan.document() | {"gl": _gl() if plan.video else {}, "machine": _machine()}
    table = finish(partial, about_all, unlisted=PLAN)
    (partial / PLAN).unlink()
    partial.rename(output)
    return Outcome(len(todo), (), table)


def _empty(folder: Path) -> bool:
    return folder.is_dir() and not any(folder.iterdir())


def _same_or_refuse(plan: Plan, folder: Path, document: Path) -> None:
    if not folder.exists() or _empty(folder):
        return
    if not document.is_file():
        raise InputError(f"{folder}: holds something else; expected a dataset of this scene, or nothing")
    try:
        found = json.loads(document.read_text())
    except ValueError:
        raise InputError(f"{document}: not JSON; remove the folder to start anew") from None
    wanted = json.loads(json.dumps(plan.document()))
    for key, value in wanted.items():
        if not isinstance(found, dict) or found.get(key) != value:
            raise InputError(f"{folder}: holds a dataset with another {key}; choose another folder")


def _each(plan: Plan, folder: Path, todo: list[int], workers: int) -> Iterator[str]:
    """Make the clips; '' or what went wrong, in the order in which they end."""
    workers = min(workers, len(todo))
    if workers <= 1:
        for number in todo:
            yield make_clip(plan, number, folder)
        return
    # llvmpipe with its own threads, or BLAS with its own, would fight over the same cores
    os.environ |= {"LP_NUM_THREADS": "0", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_prepare, initargs=(plan.document(),))
    queue, running = iter(todo), dict[Future[str], int]()
    try:
        while True:
            for number in queue:
                running[pool.submit(_make_in_worker, number, str(folder))] = number
                if len(running) >= 3 * workers:
                    break
            if not running:
                break
            ended, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in ended:
                running.pop(future)
                yield future.result()
    except BrokenProcessPool:
        raise InputError("a worker was killed; run the same command again to go on where it stopped") from None
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


_PLAN: Plan | None = None


def _prepare(document: dict[str, Any]) -> None:
    """In a worker: the plan, once."""
    global _PLAN
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides
    threading.Thread(target=_leave_with_parent, daemon=True).start()
    scenes = tuple(check_scene(s, "scene") for s in document["scenes"])
    _PLAN = Plan(scenes, document["clips_per_scene"], document["seed"], document["video"])


def _leave_with_parent() -> None:
    """A killed parent tells nobody: its workers would wait for ever, and write into the folder of the next run."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _make_in_worker(number: int, folder: str) -> str:
    assert _PLAN is not None
    return make_clip(_PLAN, number, Path(folder))


def make_clip(plan: Plan, number: int, folder: Path) -> str:
    """Make one clip of a plan in `folder`/clips; '' or one line on why it could not be made."""
    final = folder / "clips" / f"{number:06d}"
    aside = final.with_suffix(".tmp")
    try:
        clip = plan.clip(number)
        view = view_of(clip)
        frames = film(clip, view, plan.seed) if plan.video else None
        write_clip(aside, clip, view, frames, {"seed": plan.seed})
        aside.rename(final)
    except (ValueError, OSError) as e:
        shutil.rmtree(aside, ignore_errors=True)
        return f"clip {number}: {e}"
    return ""


def film(clip: Clip, view: View, seed: int) -> Frames:
    """The clip's frames as the sensor gives them, one at a time."""
    from synthcam.render import Film  # here alone: everything else works without OpenGL

    chip = _chip(clip.sensor, clip.camera.size, clip.camera.exposure, seed)
    radii = clip.launch.bodies.radius.tolist()
    with Film(clip.camera, clip.lamp, radii, clip.room) as drawing:
        pictures = drawing.frames(
            lambda t: view.at(t)[:, :, :3].transpose(1, 0, 2),
            view.spans(clip.frames),
            view.breaks(),
        )
        for k, picture in enumerate(pictures):
            yield chip.expose(picture, clip.number, k)


@lru_cache(maxsize=2)
def _chip(sensor: Sensor, size: tuple[int, int], exposure: float, seed: int) -> Chip:
    """One chip serves all clips of a camera: its fixed pattern takes as long to draw as many frames."""
    return Chip(sensor, size, exposure, seed)


def _gl() -> dict[str, str]:
    from synthcam.render import gl_info

    return dict(gl_info())


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
