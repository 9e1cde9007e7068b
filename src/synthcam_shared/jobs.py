"""Run one job per number, such as one per clip, in processes of this machine or on the workers of a Dask cluster.

A worker that dies loses only the job at which it was: the caller receives a `LostJob` instead of a `JobValue`. The
work is sent once to each worker and may therefore be large. At no time does memory hold more than the numbers and the
answers that the caller has not taken yet.
"""

import ctypes
import multiprocessing
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any, Literal, TypeVar

from synthcam_shared.errors import InputError
from synthcam_shared.interruption import hold_ctrl_c, raise_if_interrupted
from synthcam_shared.job_result import JobValue, LostJob
from synthcam_shared.start import defer_garbage_collection, skip_teardown

T = TypeVar("T")
Progress = Callable[[int, int], None]  # takes the jobs done and the jobs in all


@dataclass(frozen=True)
class JobForecast:
    """A forecast from the first jobs for the others.

    numbers: the jobs done so far, by this process.
    seconds: wall time of one job on one worker, s; the first job counts for nothing, because it loads libraries.
    jobs_left, workers: jobs still to do, and the processes that will do them.
    """

    numbers: tuple[int, ...]
    seconds: float
    jobs_left: int
    workers: int


def run_jobs(
    work: Callable[[int], T],
    numbers: Sequence[int],
    workers: int = 0,
    scheduler: str = "",
    *,
    trials: int = 2,
    announce: Callable[[JobForecast], None] | None = None,
    fork: bool = False,
) -> Generator[JobValue[T] | LostJob, None, None]:
    """Do the work for each number, and yield the answers in the order in which the jobs end.

    A caller that may leave before the last answer closes the generator, as with `contextlib.closing`: the other
    processes then end before the next line of the caller.

    work: takes a number. It must pickle where there are several workers, and what it raises is raised here.
    numbers: rising.
    workers: processes, of which this one is one; 0: one for each core that this process may use, if the trial jobs show
    that this is quicker, else this one alone.
    scheduler: address of a Dask scheduler, whose workers do all jobs instead.
    trials: jobs, spread evenly over the numbers, that this process does first where the number of workers is open or
    `announce` is given.
    announce: takes a forecast after them if there is more to do.
    fork: let the other processes be copies of this one, made at once, where it has no other thread. They start in a few
    ms. Expected are libraries that survive it: OpenGL does not if it has been started.

    Raises InputError if three workers in a row are lost, or the scheduler cannot be used.
    """
    if scheduler:
        from synthcam_shared.dask_cluster import Cluster  # here alone: Dask is an optional dependency

        return Cluster(scheduler).run(work, numbers)
    ready = list[_Worker]()
    if fork and workers != 1 and _has_one_thread():
        packed = bytes(ForkingPickler.dumps(work))
        ready = [_Worker(packed, "fork") for _ in range(min(workers or count_cores(), len(numbers)) - 1)]
    jobs = _run_trials_first(work, numbers, workers, trials, announce, ready)
    next(jobs)  # from here on, closing it ends the processes that are ready, even if no answer was asked for
    return jobs


def _run_trials_first(
    work: Callable[[int], T],
    numbers: Sequence[int],
    workers: int,
    trials: int,
    announce: Callable[[JobForecast], None] | None,
    ready: list["_Worker"],
) -> Generator[Any, None, None]:
    """Run the jobs as `run_jobs` does, after a first None; `ready` are processes that have nothing to do yet."""
    worth_processes = 1.0 if ready else 3.0  # s of processor time to come: of a process, half goes into its start
    try:
        yield None
        if numbers and (announce or not workers):
            last = len(numbers) - 1
            first = sorted({numbers[-(-k * last // max(trials - 1, 1))] for k in range(trials)})
            ends = []
            for number in first:
                value = work(number)
                raise_if_interrupted()
                yield JobValue(number, value)
                ends.append((time.perf_counter(), time.process_time()))
            numbers = [number for number in numbers if number not in first]
            if numbers:
                wall, processor = ((b - a) / (len(ends) - 1) for a, b in zip(ends[0], ends[-1], strict=True))
                workers = workers or (count_cores() if processor * len(numbers) > worth_processes else 1)
                if announce:
                    announce(JobForecast(tuple(first), wall, len(numbers), workers))
        yield from _run_in_processes(work, numbers, max(min(workers, len(numbers)) - 1, 0), ready)
    finally:
        for worker in ready:
            worker.end()


def run_all_jobs(
    work: Callable[[int], T], numbers: Sequence[int], workers: int, where: Path | str, scheduler: str = ""
) -> Iterator[T]:
    """Do the work for each number as `run_jobs` does, and yield the values in the order in which the jobs end.

    Raises InputError, which names `where`, for the first job that is lost.
    """
    for result in run_jobs(work, numbers, workers, scheduler):
        if isinstance(result, LostJob):
            raise InputError(f"{where}: clip {result.number}: {result.reason}; is there enough memory for each worker?")
        yield result.value


def yield_in_order(given: Iterable[tuple[int, T]], numbers: Iterable[int]) -> Iterator[T]:
    """Yield the values of finished jobs, pairs (number, value), in the order of the numbers; early ones wait."""
    early: dict[int, T] = {}
    values = iter(given)
    for number in numbers:
        while number not in early:
            early |= [next(values)]
        yield early.pop(number)


def count_cores() -> int:
    """Count the processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def use_one_thread() -> None:
    """Prepare a process for one of many jobs: OpenCV in one thread, and glibc keeps the memory that is freed.

    By default glibc returns large arrays to the system at once, and taking them again costs page faults.
    """
    import cv2

    trim_threshold, mmap_threshold, kept_bytes = -1, -3, 32 << 20  # M_TRIM_THRESHOLD, M_MMAP_THRESHOLD of malloc.h
    cv2.setNumThreads(1)
    with suppress(AttributeError, OSError, TypeError):  # another C library
        for option in (trim_threshold, mmap_threshold):
            ctypes.CDLL(None).mallopt(option, kept_bytes)


def _has_one_thread() -> bool:
    """Tell whether this process has no other thread: a copy of it might wait for ever for what such a thread locks."""
    harmless = {"jemalloc_bg_thd"}  # of pyarrow's allocator, which prepares itself for a fork
    try:
        names = [(thread / "comm").read_text().strip() for thread in Path("/proc/self/task").iterdir()]
    except OSError:  # another system
        return False
    return len([name for name in names if name not in harmless]) == 1


class _Worker:
    """A process that does jobs. It is at the first of `numbers`; the next is ready, so that it never waits.

    method: "spawn", or "fork" for a copy of this process.
    """

    def __init__(self, work: bytes, method: Literal["spawn", "fork"] = "spawn") -> None:
        # llvmpipe and BLAS with threads of their own would compete for the same cores
        os.environ |= {"LP_NUM_THREADS": "0", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        context: Any = multiprocessing.get_context(method)
        self.numbers: deque[int] = deque()
        self.pipe, there = context.Pipe()
        self.process = context.Process(target=_serve, args=(there, method), daemon=True)
        if method == "spawn" and hasattr(signal, "pthread_sigmask"):
            resource_tracker.ensure_running()  # started with the first process, it would let Ctrl-C through again
        with hold_ctrl_c():  # a process that hears it while it imports prints a traceback
            self.process.start()
        there.close()  # the worker's end is then the only one, and its death is noticed
        with suppress(OSError):  # it died meanwhile, which the next wait notices
            self.pipe.send_bytes(work)  # not with its start: that would block, without Ctrl-C, if it died

    def take_from(self, queue: deque[int], ahead: int = 2) -> None:
        """Send numbers until the worker has `ahead` of them."""
        with suppress(OSError):  # it died meanwhile, which the next wait notices
            while queue and len(self.numbers) < ahead:
                self.numbers.append(queue.popleft())
                self.pipe.send(self.numbers[-1])

    def end(self) -> str:
        """Let an idle process end, wait for the end, and say how it ended."""
        with suppress(OSError):  # it ended before
            self.pipe.send(None)  # a forked process does not notice that the pipe is closed: others have copies of it
        self.pipe.close()
        self.process.join()
        code = self.process.exitcode or 0
        return f"worker was killed ({signal.Signals(-code).name})" if code < 0 else f"worker ended (status {code})"


def _run_in_processes(
    work: Callable[[int], T], numbers: Sequence[int], others: int, ready: list[_Worker], most_lost_in_a_row: int = 3
) -> Iterator[JobValue[T] | LostJob]:
    """Run the jobs in this process and so many others, first those that are `ready`."""
    queue, busy, lost_in_a_row = deque(numbers), dict[Connection, _Worker](), 0
    packed = bytes(ForkingPickler.dumps(work)) if others else b""

    def hand_out(worker: _Worker) -> None:
        worker.take_from(queue)
        if worker.numbers:
            busy[worker.pipe] = worker
        else:
            worker.end()

    try:
        for _ in range(others):
            hand_out(ready.pop() if ready else _Worker(packed))
        while busy or queue:
            if queue:
                number = queue.popleft()
                here = work(number)
                raise_if_interrupted()
                yield JobValue(number, here)
            for pipe in wait(list(busy), 0 if queue or not busy else None):
                assert isinstance(pipe, Connection)
                worker = busy.pop(pipe)
                number = worker.numbers.popleft()
                try:
                    value, error = pipe.recv()
                except (EOFError, OSError):
                    end = worker.end()
                    lost_in_a_row += 1
                    if lost_in_a_row == most_lost_in_a_row:
                        why = f"{end}, the third in a row; is there enough memory for each worker?"
                        raise InputError(f"clip {number}: {why}") from None
                    queue.extendleft(reversed(worker.numbers))
                    hand_out(_Worker(packed))
                    yield LostJob(number, f"its {end}")
                    continue
                if error is not None:
                    worker.end()
                    raise error
                lost_in_a_row = 0
                hand_out(worker)
                yield JobValue(number, value)
    finally:
        for worker in busy.values():
            worker.process.terminate()
            worker.end()


def _serve(pipe: Connection, method: str) -> None:
    """Take the work, then answer the numbers that come through the pipe, until there is none or the parent ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # a copy has what the parent does at it
    if method == "spawn":  # a copy has this from its parent, and has no teardown
        defer_garbage_collection()
    end_at_once = skip_teardown()
    # Without this, workers of a killed parent would wait for ever, or write into the folder of the next run.
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        work = pipe.recv()
        while (number := pipe.recv()) is not None:
            pipe.send((work(number), None))
    except (EOFError, BrokenPipeError):
        pass
    except Exception as error:
        pipe.send((None, error))
    end_at_once(0)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
