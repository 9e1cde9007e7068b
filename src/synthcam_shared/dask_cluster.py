"""Run jobs on the workers of a Dask scheduler. Needs the optional dependency `synthcam[dask]`."""

import re
import uuid
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache
from itertools import islice
from typing import Any, TypeVar

from synthcam_shared.errors import InputError
from synthcam_shared.job_result import JobValue, LostJob

try:
    from distributed import Client, KilledWorker, as_completed
    from distributed.client import FutureCancelledError
except ImportError:
    Client = None
T = TypeVar("T")


class Cluster:
    """A connection to a scheduler that answers and has workers. One call of `ask_all` or `run` closes it.

    `address` is as in tcp://10.0.0.1:8786; the scheduler has `timeout` s to answer. Raises InputError if Dask is not
    installed, no scheduler answers at the address, or it has no workers.
    """

    def __init__(self, address: str, timeout: float = 10.0) -> None:
        if Client is None:
            raise InputError("--scheduler: Dask is not installed; type: pip install 'synthcam[dask]'")
        well_formed = re.fullmatch(r"((tcp|tls|ws|wss)://)?[^/\s]+:([0-9]{1,5})", address)
        if not well_formed or int(well_formed[3]) > 65535:
            raise InputError(f"--scheduler {address}: expected a Dask scheduler's address, as in tcp://10.0.0.1:8786")
        try:
            self.client = Client(address, timeout=timeout, set_as_default=False)
        except Exception as error:  # for a wrong address Dask raises what each of its protocols raises
            reason = " ".join(str(error).split())[:120]
            raise InputError(f"--scheduler {address}: expected a Dask scheduler's address ({reason})") from None
        self.address = address
        if not self.client.nthreads():
            self.client.close()
            raise InputError(f"--scheduler {address}: the scheduler has no workers")

    def ask_all(self, question: Callable[[], dict[str, Any]]) -> list[dict[str, Any]]:
        """Ask every worker; return each different answer once."""
        answers: list[dict[str, Any]] = []
        with self.client:
            for answer in dict(sorted(self.client.run(_call_in_one_thread, question).items())).values():
                answers += [answer] if answer not in answers else []
        return answers

    def run(
        self, work: Callable[[int], T], numbers: Sequence[int], ahead: int = 3
    ) -> Generator[JobValue[T] | LostJob, None, None]:
        """Do the work for each number, and yield the answers in the order in which the jobs end.

        Another worker does the jobs of a worker that is lost. Dask gives up a job that loses three workers. Each thread
        of a worker has `ahead` numbers, so that none waits.
        """
        queue, run = iter(numbers), uuid.uuid4().hex
        submitted: dict[str, int] = {}

        def submit(number: int) -> Any:
            future = self.client.submit(_call_in_one_thread, sent, number, key=f"clip-{number}-{run}", pure=False)
            submitted[future.key] = number
            return future

        with self.client:
            # one future, which Dask keeps on each worker: work may name a million clips
            sent = self.client.submit(_take, work, key=f"work-{run}", pure=False)
            threads = max(sum(self.client.nthreads().values()), 1)
            running = as_completed([submit(k) for k in islice(queue, ahead * threads)], loop=self.client.loop)
            for future in running:
                number, result = submitted.pop(future.key), None
                with suppress(KilledWorker, FutureCancelledError):
                    result = JobValue(number, future.result())
                yield result or LostJob(number, "its workers were lost")
                for k in islice(queue, 1):
                    running.add(submit(k))


def _take(work: Callable[[int], Any]) -> Callable[[int], Any]:
    return work


@cache
def _thread() -> ThreadPoolExecutor:
    """The one thread of a worker that does jobs: an OpenGL context belongs to one thread."""
    return ThreadPoolExecutor(1)


def _call_in_one_thread(work: Callable[..., Any], *arguments: Any) -> Any:
    return _thread().submit(work, *arguments).result()
