"""Balls that cling to the plate."""

from dataclasses import dataclass
from typing import Any

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class Adhesion(Effect):
    """A load of (1 + pull) m g while in contact with the plate: an attraction of `pull` weights.

    In flight it is gone. Of a magnet under the plate, a film of water, or static charge. Newton's second law: friction
    is mu times the load.
    """

    pull: float = parameter("1", typical=0.1, low=-0.5, high=5)

    def normal_load(self, load: Any, gravity: float) -> Any:
        return load + self.pull * gravity
