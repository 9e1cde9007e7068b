"""What bodies move on and between: the support of each body, and the walls."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from synthcam.dynamics.impact import ContactChange
from synthcam.dynamics.kinematics import State
from synthcam.dynamics.sliding_disc import make_leg
from synthcam.dynamics.trajectory import Glide, Leg, Rest
from synthcam.dynamics.walls import Wall

STOPPED_M_S = 1e-12


class Support(ABC):
    """What carries a body, where it is not the plate or cloth that the model's own laws describe."""

    @abstractmethod
    def leg(self, state: State, radius: float, t: float) -> Leg:
        """Return the leg of a body in this state at the time t, s, up to its own end."""


@dataclass(frozen=True)
class Air(Support):
    """A cushion of air under a disc: v' = -(decel + drag v) v/|v| + curl z x v, and a spin that decays.

    Attributes
    ----------
    decel : float
        d, m/s^2.
    drag : float
        gamma, 1/s.
    curl : float
        c, rad/s: the rate at which the path turns to the left.
    spin_drag : float
        Rate at which the spin decays, 1/s.
    """

    decel: float = 0.0
    drag: float = 0.0
    curl: float = 0.0
    spin_drag: float = 0.0

    def leg(self, state: State, radius: float, t: float) -> Leg:
        if math.hypot(state[3], state[4]) <= STOPPED_M_S:
            still: State = (*state[:2], radius, 0.0, 0.0, 0.0, 0.0, 0.0, state[8])
            if self.spin_drag == 0 or state[8] == 0:
                return Rest(t, math.inf, still)
            return Glide(t, math.inf, t, still, 0.0, 0.0, 0.0, self.spin_drag, motion="rest")
        return Glide.of(t, state, self.decel, self.drag, self.curl, self.spin_drag)


@dataclass(frozen=True)
class DryPlate(Support):
    """A plate on which a disc slides and turns, under an even pressure; see `sliding_disc`.

    Attributes
    ----------
    slowing : float
        Friction times gravity, m/s^2.
    """

    slowing: float

    def leg(self, state: State, radius: float, t: float) -> Leg:
        if max(math.hypot(state[3], state[4]), radius * abs(state[8])) <= STOPPED_M_S:
            return Rest(t, math.inf, (*state[:2], radius, *(0.0,) * 6))
        return make_leg(state, radius, self.slowing, t)


@dataclass(frozen=True)
class Scatter:
    """How contacts of bodies differ by chance, each drawn from a normal distribution.

    Attributes
    ----------
    restitution : float
        Standard deviation of r.
    friction : float
        Standard deviation of the factor on the tangential impulse.
    normal : float
        Standard deviation of the angle by which the normal is turned about the vertical, rad.
    seed : tuple of int
        Of the draws, which follow the order of the contacts.
    """

    restitution: float = 0.0
    friction: float = 0.0
    normal: float = 0.0
    seed: tuple[int, ...] = (0,)

    @property
    def active(self) -> bool:
        return bool(self.restitution or self.friction or self.normal)

    def draw(self, rng: np.random.Generator) -> ContactChange:
        """Draw what changes the next contact."""
        one, two, three = rng.standard_normal(3).tolist()
        return ContactChange(self.restitution * one, max(1 + self.friction * two, 0.0), self.normal * three)


@dataclass(frozen=True)
class Table:
    """What bodies move on and between.

    Attributes
    ----------
    walls : tuple of Wall
    supports : tuple of Support or None
        Of each body; None is the plate, with the model's own laws. Empty: the plate for all.
    contact_duration : float
        Bounds sequences of impacts without end, s; see `dynamics.solve.solve`.
    scatter : Scatter
        How contacts of bodies differ by chance.
    """

    walls: tuple[Wall, ...] = ()
    supports: tuple[Support | None, ...] = ()
    contact_duration: float = 0.0
    scatter: Scatter = Scatter()
