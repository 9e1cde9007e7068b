"""The time of a search: its limit, and an estimate of what is left from the time that its stages have taken."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field

Progress = Callable[[str], None]  # takes the name of the stage that runs
ONLY_LAWS = "only free laws"  # the stage "free laws" where no effect of the library is significant
LIMITED_STAGES = ("search", "free laws", ONLY_LAWS)  # --minutes limits these; the others take seconds
FAR_LONGER = 3.0  # than in the level before, which usually takes half the time: the end of such a stage is not known


@dataclass
class SearchClock:
    """The stages of a search as they begin, with an estimate of the time left.

    A search goes through levels. Each has a stage "search", in which it adds an effect, or only tests all of them, and
    a stage "free laws". It ends at the level whose effects leave nothing significant; no one knows before which level
    that is. The estimate takes the rest of the level from the level before, and half a level more. If no effect is
    significant at all, the first level is the last, and its stage is "only free laws". A round that repeats the search
    is taken to be as long as the round before. So the estimate approaches the truth as the levels pass.

    Attributes
    ----------
    limit_s : float
        Of the whole search, s.
    began : float
        When the search began, s, by any clock.
    """

    limit_s: float = math.inf
    began: float = 0.0
    spells: list[tuple[str, float]] = field(default_factory=list)  # stages of this round, and when each began
    previous: list[tuple[str, float]] = field(default_factory=list)  # stages of the round before, and how long each was

    def enter(self, stage: str, now: float) -> None:
        """Note that the search is in a stage at the time `now`, s."""
        if stage == "fit" and any(name in LIMITED_STAGES for name, _ in self.spells):
            self.previous, self.spells = self._durations(now), []
        if not self.spells or self.spells[-1][0] != stage:
            self.spells.append((stage, now))

    def estimate_left(self, now: float) -> float:
        """Estimate the time left at the time `now`, s; NaN where nothing shows it, and in stages of seconds."""
        if not self.spells or self.spells[-1][0] not in LIMITED_STAGES:
            return math.nan
        *done, (stage, spent) = self._durations(now)
        at_most = max(self.limit_s - (now - self.began), 0.0)
        if len(done) < len(self.previous) and [name for name, _ in done] == [n for n, _ in self.previous[: len(done)]]:
            rest = [seconds for _, seconds in self.previous[len(done) :]]
            return min(_remaining(rest[0], spent) + sum(rest[1:]), at_most)
        lengths = {name: seconds for name, seconds in done if name in LIMITED_STAGES}  # the latest of each
        if not lengths or spent > FAR_LONGER * lengths.get(stage, math.inf):
            return math.nan
        searching = max(lengths.get("search", 0.0), spent if stage == "search" else 0.0)
        if stage == ONLY_LAWS:  # tests of laws take .6 to 1.1 of the time that those of effects take
            return min(_remaining(searching, spent), at_most)
        laws = lengths.get("free laws", 1.5 * searching)
        left = _remaining(searching if stage == "search" else laws, spent)
        left += laws * (stage == "search") + 0.5 * (searching + laws)
        return min(left, at_most)

    def _durations(self, now: float) -> list[tuple[str, float]]:
        ends = [begin for _, begin in self.spells[1:]] + [now]
        return [(name, end - begin) for (name, begin), end in zip(self.spells, ends, strict=True)]


def _remaining(length: float, spent: float) -> float:
    """The time left of a stage that took `length` the last time; one that takes longer ends at no known time."""
    return max(length - spent, 0.2 * spent)


class OutOfTime(Exception):
    """The time is over."""


@dataclass(frozen=True)
class Deadline:
    """The end of the time of a search, `seconds` after this is made."""

    seconds: float = math.inf
    began: float = field(default_factory=time.monotonic)

    @contextmanager
    def limited(self) -> Iterator[None]:
        """The context in which the time limit is active; code outside it is never cut short."""
        before = _deadline.set(self)
        try:
            yield
        finally:
            _deadline.reset(before)


_deadline: ContextVar[Deadline | None] = ContextVar("deadline", default=None)
_shown: ContextVar[tuple[Progress, str]] = ContextVar("shown", default=(lambda stage: None, ""))


@contextmanager
def showing_stages(progress: Progress) -> Iterator[None]:
    """The context in which the stages of a search, an added effect or a plan are shown by this function."""
    before = _shown.set((progress, ""))
    try:
        yield
    finally:
        _shown.reset(before)


@contextmanager
def in_stage(name: str) -> Iterator[None]:
    """The context, or the function as a decorator, that belongs to a stage; the stage around it goes on after it.

    It is shown from its first prediction on: a fit that is known already shows nothing.
    """
    progress, _ = _shown.get()
    before = _shown.set((progress, name))
    try:
        yield
    finally:
        _shown.reset(before)


def report_progress() -> None:
    """Show that the stage goes on; raise OutOfTime past an active deadline. Each prediction calls this."""
    progress, name = _shown.get()
    if name:
        progress(name)
    deadline = _deadline.get()
    if deadline is not None and time.monotonic() > deadline.began + deadline.seconds:
        raise OutOfTime
