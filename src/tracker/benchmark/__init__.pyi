"""The public names, listed once."""

from .library import Trial as Trial
from .library import run as run

__all__ = ["Trial", "run"]
