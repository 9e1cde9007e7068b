"""Laws that are in nobody's library, hidden in measured collisions, for the tests of the free laws."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from discrepancy_clips import collisions, only

from discrepancy.free_laws.library import list_free_laws as free_laws
from discrepancy.search import search
from discrepancy.select import free_law_contest
from synthcam.effect import Effect, parameter
from synthcam.library import library
from synthcam.model import Model

FEW = ("velocity_restitution", "rolling_quadratic", "stribeck", "spin_transfer_velocity", "friction_anisotropy")


@dataclasses.dataclass(frozen=True)
class Streak(Effect):
    """Sliding friction in waves along x."""

    depth: float = parameter("1", typical=0.02)

    def friction(self, mu, position):
        return mu + self._law(position[..., 0], position[..., 1]) - Model().sliding_friction

    def _law(self, x, y):
        return Model().sliding_friction * (1 + self.depth * np.sin(x / 3e-3))


@dataclasses.dataclass(frozen=True)
class Step(Effect):
    """Restitution that drops at 0.2 m/s."""

    drop: float = parameter("1", typical=0.004)

    def restitution(self, r, normal_speed):
        return r + self._law(normal_speed) - Model().restitution

    def _law(self, v):
        return Model().restitution - self.drop * (1 + np.tanh((v - 0.2) / 0.03)) / 2


@dataclasses.dataclass(frozen=True)
class Resonance(Effect):
    """Spin transfer with a resonance at 0.3 m/s."""

    size: float = parameter("1", typical=0.01)

    def spin_transfer(self, c, contact_speed):
        return c + self._law(contact_speed) - Model().spin_transfer

    def _law(self, v):
        return Model().spin_transfer + self.size * np.exp(-(((v - 0.3) / 0.06) ** 2) / 2)


@dataclasses.dataclass(frozen=True)
class RootDrag(Effect):
    """A force against the motion that grows with the root of the speed."""

    size: float = parameter("m^.5/s^1.5", typical=0.01)

    def push(self, acceleration, velocity):
        speed = np.maximum(np.hypot(velocity[..., 0], velocity[..., 1]), 1e-9)
        return acceleration + (self._law(speed) / speed)[..., None] * velocity

    def _law(self, v):
        return -self.size * np.sqrt(v)


OUTSIDERS = {
    "friction_place": Streak(0.02),
    "restitution_speed": Step(0.004),
    "spin_transfer_speed": Resonance(0.01),
    "force_speed": RootDrag(0.015),
}

CLIPS = {"friction_place": 10, "restitution_speed": 18, "spin_transfer_speed": 12, "force_speed": 12}
# the free laws of a search: the hidden one and its nearest rivals, for spin_transfer_speed all that there are
RIVALS = {
    "friction_place": ("friction_place", "friction_speed", "friction_heading"),
    "restitution_speed": ("restitution_speed", "restitution_heading", "spin_transfer_speed"),
    "spin_transfer_speed": tuple(law.base_name for law in free_laws()),
    "force_speed": ("force_speed", "rolling_speed", "friction_speed"),
}


BEGUN_AGAIN = list[str]()  # laws whose search looked for other first effects

# one search is enough to see that all stages fit together
each_outsider = pytest.mark.parametrize(
    "law", [pytest.param(law, marks=[pytest.mark.gate] * (law != "restitution_speed")) for law in OUTSIDERS]
)


@cache
def outsider(law):
    """A search of collisions in which the outsider of this free law is hidden, with a small library.

    An impact tells its law at one speed only, and a weak force little: there must be more of them.
    """
    hidden, begin_again = (
        dataclasses.replace(Model(), effects=(OUTSIDERS[law],)),
        free_law_contest.search_from_other_effects,
    )

    def count_and_begin(library, state):
        BEGUN_AGAIN.append(law)
        return begin_again(library, state)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(free_law_contest, "search_from_other_effects", count_and_begin)
        only(patch, RIVALS[law], **{name: library()[name] for name in FEW})
        return search(collisions(hidden, CLIPS[law], 3), Model())
