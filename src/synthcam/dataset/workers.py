"""Numbered work in processes; a worker that is killed loses only its own number."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess

from synthcam_shared.errors import InputError
from synthcam_shared.workers import leave_with_parent

Work = Callable[[int], str]
Worker = tuple[BaseProcess, deque[int]]  # and the numbers that it was given, the first of which it is at
IN_A_ROW = 3  # workers lost one after the other, with nothing done in between, before all is given up


def each(
    todo: Iterable[int], workers: int, prepare: Callable[[], Work], here: Work | None = None
) -> Iterator[tuple[int, str]]:
    """Do numbered work in processes.

    Parameters
    ----------
    todo : iterable of int
    workers : int
        Processes to start.
    prepare : callable
        Called once in each worker; gives the work, which takes a number and returns what went wrong, or ''. Must
        pickle.
    here : callable, optional
        The same work, that this process does beside them; workers are then given a number ahead.

    Yields
    ------
    tuple of int and str
        A number and what went wrong, in the order in which they end. What the work raises is raised here.

    Raises
    ------
    InputError
        Where no worker lives long enough to do anything.
    """
    queue, busy, lost = deque(todo), dict[Connection, Worker](), 0
    ahead = 1 if here is None else 2
    try:
        for _ in range(workers):
            _hand_out(queue, busy, *_start(prepare), ahead)
        while busy or queue:
            if here is not None and queue:
                number = queue.popleft()
                yield number, here(number)
            for pipe in wait(list(busy), 0 if here is not None and (queue or not busy) else None):
                assert isinstance(pipe, Connection)
                process, given = busy.pop(pipe)
                said, number = _hear(pipe, process), given.popleft()
                lost = 0 if said is not None else lost + 1
                if said is not None:
                    _hand_out(queue, busy, pipe, (process, given), ahead)
                elif lost < IN_A_ROW:
                    pipe.close()
                    queue.extendleft(reversed(given))
                    _hand_out(queue, busy, *_start(prepare), ahead)
                else:
                    raise InputError(f"clip {number}: {_end(process)}, the {lost}th in a row; is there enough memory?")
                yield number, said if said is not None else f"its {_end(process)}"
    finally:
        for pipe, (process, _) in busy.items():
            process.terminate()
            process.join()
            pipe.close()


def _start(prepare: Callable[[], Work]) -> tuple[Connection, Worker]:
    # llvmpipe with its own threads, or BLAS with its own, would fight over the same cores
    os.environ |= {"LP_NUM_THREADS": "0", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=_serve, args=(there, prepare), daemon=True)
    with _deaf():
        process.start()
    there.close()  # so that the worker's end is the only one, and its death is heard
    return here, (process, deque())


@contextmanager
def _deaf() -> Iterator[None]:
    """Hold back Ctrl-C, and start processes without it: in its imports one would end with a traceback."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # as the first process starts, this would let Ctrl-C through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _hand_out(queue: deque[int], busy: dict[Connection, Worker], pipe: Connection, worker: Worker, ahead: int) -> None:
    """Give a worker numbers until it has `ahead` of them; without any it ends."""
    process, given = worker
    with suppress(OSError):  # died meanwhile: heard as soon as one listens
        while queue and len(given) < ahead:
            given.append(queue.popleft())
            pipe.send(given[-1])
        if not given:
            pipe.send(None)
    if given:
        busy[pipe] = worker
    else:
        process.join()
        pipe.close()


def _hear(pipe: Connection, process: BaseProcess) -> str | None:
    """What a worker says of its number; None: it is dead."""
    try:
        said = pipe.recv()
    except (EOFError, OSError):
        process.join()
        return None
    if isinstance(said, BaseException):
        raise said
    return str(said)


def _end(process: BaseProcess) -> str:
    code = process.exitcode or 0
    return f"worker was killed ({signal.Signals(-code).name})" if code < 0 else f"worker ended (status {code})"


def _serve(pipe: Connection, prepare: Callable[[], Work]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides
    leave_with_parent()
    try:
        work = prepare()
        while (number := pipe.recv()) is not None:
            pipe.send(work(number))
    except (EOFError, BrokenPipeError):
        return
    except Exception as error:
        pipe.send(error)
