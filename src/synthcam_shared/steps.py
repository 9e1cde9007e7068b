"""Report the steps within one long job, such as one clip, to the progress of the command."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

Progress = Callable[[int, int], None]  # takes the steps done and the steps in all
_shown: ContextVar[tuple[str, Progress] | None] = ContextVar("shown", default=None)


@contextmanager
def showing_steps(unit: str, progress: Progress) -> Iterator[None]:
    """Show the steps of this unit, such as "contacts", by a progress callback; those of other units are not shown."""
    before = _shown.set((unit, progress))
    try:
        yield
    finally:
        _shown.reset(before)


def report_step(unit: str, done: int, total: int) -> None:
    """Report the steps done of all that one job takes in this unit."""
    shown = _shown.get()
    if shown is not None and shown[0] == unit:
        shown[1](done, total)
