"""The time that a search may take."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar


class OutOfTime(Exception):
    """The time is over."""


_running: ContextVar[Deadline | None] = ContextVar("deadline", default=None)


def check() -> None:
    """Raises OutOfTime where a deadline counts that is over: asked at each forecast, of which some take a minute."""
    deadline = _running.get()
    if deadline is not None and deadline.over:
        raise OutOfTime


class Deadline:
    """Progress that raises OutOfTime within `limited`, so many seconds after it was made."""

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
        """Where the time counts: what is done with what there is by then is not cut short."""
        self.counts, before = True, _running.set(self)
        try:
            yield
        finally:
            self.counts = False
            _running.reset(before)
