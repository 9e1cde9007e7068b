"""Clips side by side, each in a process."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

import cv2

from commandline.errors import InputError

T = TypeVar("T")
MALLOPT = (-1, -3)  # M_TRIM_THRESHOLD, M_MMAP_THRESHOLD of malloc.h
KEPT = 32 << 20  # bytes
STARTING = 5.0  # s of a processor: for less work it does not pay to start processes
Progress = Callable[[int, int], None]


def in_parallel(task: Callable[[int], T], todo: Sequence[int], workers: int, where: Path) -> Iterator[T]:
    """What task gives for each number, in whatever order, by so many processes. where: what an error names.

    workers 0: this process begins; others join it where the time of the second shows that it has much to do.
    """
    if workers == 0:
        seconds = 0.0
        for index in todo[:2]:  # the first loads libraries
            started = time.process_time()
            given = task(index)
            seconds = time.process_time() - started
            yield given
        todo = todo[2:]
        workers = _cores() if seconds * len(todo) > STARTING else 1
    if workers <= 1 or len(todo) <= 1:
        yield from map(task, todo)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(workers, len(todo)), mp_context=context) as pool:
        waiting = {pool.submit(task, index) for index in todo}
        try:
            while waiting:
                done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                for future in done:
                    yield future.result()
        except BrokenProcessPool:
            raise InputError(f"{where}: a worker was killed; is there enough memory for each of them?") from None
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def alone() -> None:
    """Lets a process be one of many: OpenCV in one thread; glibc keeps freed memory, which costs much to take anew."""
    cv2.setNumThreads(1)
    with suppress(AttributeError, OSError, TypeError):  # another C library
        for option in MALLOPT:
            ctypes.CDLL(None).mallopt(option, KEPT)


def _cores() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
