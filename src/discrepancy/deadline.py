"""The time that a search may take."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


class OutOfTime(Exception):
    """The time is over."""


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
        self.counts = True
        try:
            yield
        finally:
            self.counts = False
