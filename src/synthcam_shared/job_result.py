"""The result of one job: a value, or the loss of the worker that was at it."""

from dataclasses import dataclass
from typing import Generic, TypeVar

T = TypeVar("T")


@dataclass(frozen=True)
class JobValue(Generic[T]):
    """A number, and the value that the work returned for it."""

    number: int
    value: T


@dataclass(frozen=True)
class LostJob:
    """A number whose worker ended before it answered, and how the worker ended."""

    number: int
    reason: str
