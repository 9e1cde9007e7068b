"""Balls that stick to the plate."""

from dataclasses import dataclass
from typing import Any

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class Adhesion(Effect):
    """While in contact with the plate, a ball presses on it with the load (1 + pull) m g.

    The attraction `pull` is in units of the weight: a magnet under the plate, a film of water, static charge. It is
    gone in flight. Friction is mu times the load (Coulomb).
    """

    pull: float = parameter(
        "1",
        typical=0.1,
        low=-0.5,
        high=5,
        meaning=(
            "the plate attracts a ball with {} of its weight",
            "the load of a ball is smaller by {} of its weight",
        ),
    )

    def normal_load(self, load: Any, gravity: float) -> Any:
        return load + self.pull * gravity
