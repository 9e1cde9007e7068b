"""The same work on the workers of a Dask scheduler. Needs the extra `synthcam[dask]`."""

from __future__ import annotations

import re
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache
from itertools import islice
from typing import Any, TypeVar

from synthcam_shared.errors import InputError

try:
    from distributed import Client, KilledWorker, WorkerPlugin, as_completed
    from distributed.client import FutureCancelledError
except ImportError:
    Client, WorkerPlugin = None, object
T = TypeVar("T")
AHEAD = 3  # clips handed out for each thread of a worker
ADDRESS = re.compile(r"((tcp|tls|ws|wss)://)?[^/\s]+:[0-9]{1,5}")
LAST_PORT = 65535
PATIENCE = 10.0  # s, for the scheduler to answer
TRIES, PAUSE = 5, 1.0  # s, in which a scheduler notices that a worker is lost


class Cluster:
    """A scheduler that answers and has workers. Raises InputError when it does not."""

    def __init__(self, address: str) -> None:
        if Client is None:
            raise InputError("--scheduler: Dask is not installed; type: pip install 'synthcam[dask]'")
        if not ADDRESS.fullmatch(address) or int(address.rpartition(":")[2]) > LAST_PORT:
            raise InputError(f"--scheduler {address}: expected a Dask scheduler's address, as in tcp://10.0.0.1:8786")
        try:
            self.client = Client(address, timeout=PATIENCE, set_as_default=False)
        except Exception as e:  # of a wrong address Dask raises what each of its ways to connect raises
            said = " ".join(str(e).split())[:120]
            raise InputError(f"--scheduler {address}: expected a Dask scheduler's address ({said})") from None
        self.address = address
        if not self.client.nthreads():
            self.client.close()
            raise InputError(f"--scheduler {address}: the scheduler has no workers")

    def everywhere(self, question: Callable[[], dict[str, Any]]) -> list[dict[str, Any]]:
        """The workers' answers, each different one once."""
        answers: list[dict[str, Any]] = []
        for answer in dict(sorted(self.client.run(_in_lane, question).items())).values():
            answers += [answer] if answer not in answers else []
        return answers

    def each(self, todo: list[int], work: Callable[[int], str]) -> Iterator[tuple[int, str]]:
        """Do the work of each number: (number, '' or what went wrong), in the order in which they end."""
        for number, said in self.values(todo, work):
            yield number, "its workers were lost" if said is None else said

    def values(self, todo: Sequence[int], work: Callable[[int], T]) -> Iterator[tuple[int, T | None]]:
        """What the work gives for each number, in the order in which they end.

        A worker that is lost has its numbers done by others; a number that loses three workers is given up: None.
        """
        queue, run = iter(todo), uuid.uuid4().hex
        numbers: dict[str, int] = {}

        def submit(number: int) -> Any:
            future = self.client.submit(_held, run, number, key=f"clip-{number}-{run}", pure=False)
            numbers[future.key] = number
            return future

        with self.client:
            self._send(run, work)
            try:
                threads = max(sum(self.client.nthreads().values()), 1)
                running = as_completed([submit(k) for k in islice(queue, AHEAD * threads)], loop=self.client.loop)
                for future in running:
                    number = numbers.pop(future.key)
                    given: T | None
                    try:
                        given = future.result()
                    except (KilledWorker, FutureCancelledError):
                        given = None
                    yield number, given
                    for k in islice(queue, 1):
                        running.add(submit(k))
            finally:
                with suppress(OSError):  # the scheduler may be gone
                    self.client.unregister_worker_plugin(run)

    def _send(self, run: str, work: Callable[[int], Any]) -> None:
        """Let the workers know a run's work; a worker that is lost on the way is left out."""
        for left in reversed(range(TRIES)):
            try:
                self.client.register_plugin(_Work(run, work), name=run)
                return
            except OSError as error:
                if not left:
                    said = " ".join(str(error).split())[:120]
                    raise InputError(f"--scheduler {self.address}: its workers cannot be reached ({said})") from None
                time.sleep(PAUSE)


_WORK: dict[str, Callable[[int], Any]] = {}  # of this worker, by run


class _Work(WorkerPlugin):  # type: ignore[misc]
    """A run's work, which may know of a million clips: sent once to each worker, and to those that join later."""

    def __init__(self, run: str, work: Callable[[int], Any]) -> None:
        self.run, self.work = run, work

    def setup(self, worker: Any) -> None:
        _WORK[self.run] = self.work

    def teardown(self, worker: Any) -> None:
        _WORK.pop(self.run, None)


def _held(run: str, number: int) -> Any:
    return _in_lane(_WORK[run], number)


@cache
def _lane() -> ThreadPoolExecutor:
    """An OpenGL context belongs to one thread, and a Dask worker has several."""
    return ThreadPoolExecutor(1)


def _in_lane(work: Callable[..., Any], *arguments: Any) -> Any:
    return _lane().submit(work, *arguments).result()
