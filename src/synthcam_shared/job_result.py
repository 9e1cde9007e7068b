"""The result of one job: a value, or the loss of the worker that was at it."""

from dataclasses import dataclass
from typing import Generic, TypeVar

T = TypeVar("T")


@dataclass(frozen=True)
class JobValue(Generic[T]):
    """What the work returned for one number."""

    number: int
    value: T


@dataclass(frozen=True)
class LostJob:
    """A number whose worker ended before it answered, and how the worker ended."""

    number: int
    reason: str
