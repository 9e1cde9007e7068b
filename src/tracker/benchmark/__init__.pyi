"""The public names, listed once."""

from .library import TrackerRun as TrackerRun
from .library import run as run

__all__ = ["TrackerRun", "run"]
