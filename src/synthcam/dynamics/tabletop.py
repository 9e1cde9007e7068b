"""A tabletop: the support of each body, the walls, and the scatter of contacts."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from synthcam.dynamics.contacts.impact import ImpactChange
from synthcam.dynamics.contacts.lasting import ContactSpring
from synthcam.dynamics.contacts.walls import Wall
from synthcam.dynamics.supports import Support


@dataclass(frozen=True)
class ContactScatter:
    """How contacts of bodies differ by chance, each drawn from a normal distribution.

    Attributes
    ----------
    restitution : float
        Standard deviation of r.
    friction : float
        Standard deviation of the factor on the tangential impulse.
    normal : float
        Standard deviation of the angle by which the normal is turned about the vertical, rad.
    distance : float
        Standard deviation of the distance of the centres, over the sum of the radii.
    seed : tuple of int
        Of the draws, which follow the order of the contacts.
    """

    restitution: float = 0.0
    friction: float = 0.0
    normal: float = 0.0
    distance: float = 0.0
    seed: tuple[int, ...] = (0,)

    @property
    def active(self) -> bool:
        return bool(self.restitution or self.friction or self.normal or self.distance)

    def draw(self, rng: np.random.Generator, further: float) -> ImpactChange:
        """Draw what changes the next contact. further: distance of the centres less the radii, m."""
        one, two, three = rng.standard_normal(3).tolist()
        shift, factor, turn = self.restitution * one, max(1 + self.friction * two, 0.0), self.normal * three
        drawn = {"restitution_shift": shift, "friction_factor": factor, "normal_turn": turn}
        if self.distance:
            drawn["distance_shift"] = further
        return ImpactChange(shift, factor, turn, drawn=drawn)


@dataclass(frozen=True)
class Table:
    """A tabletop on which, and between whose walls, bodies move.

    Attributes
    ----------
    walls : tuple of Wall
    supports : tuple of Support or None
        Of each body; None is the plate, with the model's own laws. Empty: the plate for all.
    contact_duration : float
        Bounds sequences of impacts without end, s; see `dynamics.solve.solve`.
    scatter : Scatter
        How contacts of bodies differ by chance.
    sticks : tuple of float
        Of each body, the impulse that parts it from a body that it has hit, N s; 0: it does not stick. Empty: none
        does.
    spring : ContactSpring, optional
        Of contacts that last; None: all are impacts in an instant.
    plate_share : float
        Share of the momentum of two bodies that the plate takes when they hit, a reading of Dutt et al. (1999): both
        lose this share of the velocity of their centre of mass.
    """

    walls: tuple[Wall, ...] = ()
    supports: tuple[Support | None, ...] = ()
    contact_duration: float = 0.0
    scatter: ContactScatter = ContactScatter()
    sticks: tuple[float, ...] = ()
    spring: ContactSpring | None = None
    plate_share: float = 0.0


class ImpactChanges:
    """The influences on the contacts of one run: chance, a contact duration, and the plate. gravity: m/s^2."""

    def __init__(self, table: Table, gravity: float) -> None:
        self.table, self.last_hit = table, dict[int, float]()  # of each body, s
        self.chance = np.random.default_rng(table.scatter.seed) if table.scatter.active else None
        self.slowest = gravity * table.contact_duration / 2

    def draw(self, t: float, balls: tuple[int, ...], further: float = 0.0, spring: bool = False) -> ImpactChange:
        """Draw what changes an impact of two bodies, or of one on a wall, at the time t, s.

        further: distance of two centres less the radii, m. spring: the contact lasts, so no impact follows another.
        """
        change, duration = ImpactChange(), self.table.contact_duration
        if len(balls) == 2:
            if self.chance:
                change = self.table.scatter.draw(self.chance, further)
            change = replace(change, plate_share=self.table.plate_share)
        if duration and not spring:
            recent = any(t - self.last_hit.get(k, -math.inf) < duration for k in balls)
            change = replace(change, elastic=recent, slowest=self.slowest)
            self.last_hit |= dict.fromkeys(balls, t)
        return change
