"""The time limit of a search."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar


class OutOfTime(Exception):
    """The time is over."""


_running: ContextVar[Deadline | None] = ContextVar("deadline", default=None)


def check_deadline() -> None:
    """Raise OutOfTime if an active deadline is over. Each prediction calls this, since some take a minute."""
    deadline = _running.get()
    if deadline is not None and deadline.over:
        raise OutOfTime


class Deadline:
    """A progress callback that raises OutOfTime inside `limited`, once `seconds` have passed since it was made."""

    def __init__(self, progress: Callable[[str], None], seconds: float = math.inf) -> None:
        self.progress, self.seconds = progress, seconds
        self.end, self.counts = time.monotonic() + seconds, False

    def __call__(self, stage: str) -> None:
        self.progress(stage)
        if self.counts and self.over:
            raise OutOfTime

    @property
    def over(self) -> bool:
        return time.monotonic() > self.end

    @contextmanager
    def limited(self) -> Iterator[None]:
        """The context in which the time limit is active; code outside it is never cut short."""
        self.counts, before = True, _running.set(self)
        try:
            yield
        finally:
            self.counts = False
            _running.reset(before)
