"""Examines the frames of one film in several processes: each takes a stretch of them at a time."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from synthcam_shared.errors import InputError
from synthcam_shared.job_result import JobValue, LostJob
from synthcam_shared.jobs import count_cores, run_jobs, use_one_thread, yield_in_order
from tracker.camera.frames import Frames
from tracker.camera.recordings import HelperProcesses, Recording
from tracker.detection.detector import SharedDetector

Examined: TypeAlias = tuple[int, Any]  # the number of a frame, and what a detector says of it
STRETCH_FRAMES = 32  # that a process takes at a time: few enough that all end at about the same time


@dataclass
class _Examiner:
    """Examines a stretch of frames. In another process it opens the film again."""

    detector: SharedDetector
    numbers: Sequence[int]  # of all frames
    helpers: HelperProcesses
    frames: Frames | None

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"frames": None}

    def __call__(self, stretch: int) -> list[Examined]:
        return list(self.examine(stretch))

    def examine(self, stretch: int) -> Iterator[Examined]:
        """The frames of a stretch, one after the other."""
        if self.frames is None:
            use_one_thread()
            self.frames = self.helpers.open_frames()
        first = stretch * STRETCH_FRAMES
        for k, number in enumerate(self.numbers[first : first + STRETCH_FRAMES], first):
            yield number, self.detector.examine(number, self.frames[k])


def share_frames(clip: Recording, detector: SharedDetector, numbers: Sequence[int]) -> Iterator[Examined]:
    """Examine all frames of a recording in its helper processes and in this one, and yield them in their order.

    The result of a frame does not depend on the process that examines it. Raises InputError if a process is lost.
    """
    for done, examined in enumerate(_examine_all(clip, detector, numbers), 1):
        yield examined
        if clip.progress is not None:
            clip.progress(done, len(numbers))


def _examine_all(clip: Recording, detector: SharedDetector, numbers: Sequence[int]) -> Iterator[Examined]:
    worth_processes = 6.0  # s of processor time of the remaining frames
    assert clip.helpers is not None
    examiner, workers = _Examiner(detector, numbers, clip.helpers, clip.frames), clip.helpers.workers
    stretches = range(-(-len(numbers) // STRETCH_FRAMES))
    for _ in range(0 if workers else 2):  # the first one loads libraries
        began = time.process_time()
        for stretch in stretches[:1]:
            yield from examiner.examine(stretch)
        stretches = stretches[1:]
        rest = (time.process_time() - began) * len(stretches)
    workers = workers or (count_cores() if rest > worth_processes else 1)
    if workers == 1:
        for stretch in stretches:
            yield from examiner.examine(stretch)
        return
    answers = (_check(answer) for answer in run_jobs(examiner, stretches, workers))
    for examined in yield_in_order(answers, stretches):
        yield from examined


def _check(answer: JobValue[list[Examined]] | LostJob) -> tuple[int, list[Examined]]:
    if isinstance(answer, LostJob):
        first = answer.number * STRETCH_FRAMES
        raise InputError(
            f"frames {first} to {first + STRETCH_FRAMES - 1}: {answer.reason}; is there enough memory for each worker? "
            "--workers 1 needs the least"
        )
    return answer.number, answer.value
