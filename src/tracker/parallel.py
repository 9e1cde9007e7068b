"""Clips side by side, each in a process."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

import cv2

from synthcam_shared.errors import InputError
from synthcam_shared.workers import leave_with_parent

T = TypeVar("T")
MALLOPT = (-1, -3)  # M_TRIM_THRESHOLD, M_MMAP_THRESHOLD of malloc.h
KEPT = 32 << 20  # bytes
STARTING = 3.0  # s of a processor: for less work it does not pay to start processes, which load for half as long
AHEAD = 2  # numbers that each of the others has, so that none waits for this process
Progress = Callable[[int, int], None]


def in_parallel(
    task: Callable[[int], T], todo: Sequence[int], workers: int, where: Path, scheduler: str = ""
) -> Iterator[T]:
    """What task gives for each number, in whatever order, by so many processes, this one among them.

    workers 0: others join this one where the time of its second number shows that it has much to do. where: what an
    error names. scheduler: of Dask, whose workers do it in place of processes here.
    """
    if scheduler:
        yield from _on_cluster(task, todo, where, scheduler)
        return
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
    context, others = multiprocessing.get_context("spawn"), min(workers, len(todo)) - 1
    with ProcessPoolExecutor(others, mp_context=context, initializer=_hold, initargs=(task,)) as pool:
        queue, waiting = deque(todo), set[Future[T]]()
        try:
            while queue or waiting:
                while queue and len(waiting) < AHEAD * others:
                    waiting.add(pool.submit(_held, queue.popleft()))
                if queue:
                    yield task(queue.popleft())
                done, waiting = wait(waiting, 0 if queue else None, FIRST_COMPLETED)
                for future in done:
                    yield future.result()
        except BrokenProcessPool:
            raise InputError(f"{where}: a worker was killed; is there enough memory for each of them?") from None
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def in_order(given: Iterable[tuple[int, T]], numbers: Iterable[int]) -> Iterator[T]:
    """What tasks gave, (number, value) in whatever order, in that of the numbers; early ones are kept till then."""
    early: dict[int, T] = {}
    values = iter(given)
    for number in numbers:
        while number not in early:
            early |= [next(values)]
        yield early.pop(number)


_TASK: dict[str, Callable[[int], Any]] = {}  # of a process here; it may know of a million clips, and is sent once


def _hold(task: Callable[[int], Any]) -> None:
    leave_with_parent()
    _TASK["task"] = task


def _held(number: int) -> Any:
    return _TASK["task"](number)


def _on_cluster(task: Callable[[int], T], todo: Sequence[int], where: Path, address: str) -> Iterator[T]:
    from synthcam_shared.dask_workers import Cluster  # here alone: Dask is an extra

    for number, given in Cluster(address).values(todo, task):
        if given is None:
            raise InputError(f"{where}: the Dask workers that had its number {number} were lost, three times")
        yield given


def alone() -> None:
    """Lets a process be one of many: OpenCV in one thread; glibc keeps freed memory, which costs much to take anew."""
    cv2.setNumThreads(1)
    with suppress(AttributeError, OSError, TypeError):  # another C library
        for option in MALLOPT:
            ctypes.CDLL(None).mallopt(option, KEPT)


def _cores() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
