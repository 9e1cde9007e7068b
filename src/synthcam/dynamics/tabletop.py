"""A tabletop: the support of each body, the walls, and the scatter of contacts."""

import math
from dataclasses import dataclass, replace

import numpy as np

from synthcam.dynamics.contacts.impact import ImpactChange
from synthcam.dynamics.contacts.lasting import ContactSpring
from synthcam.dynamics.contacts.walls import Wall
from synthcam.dynamics.supports import Support


@dataclass(frozen=True)
class ContactScatter:
    """How contacts of bodies differ by chance: standard deviations of normal distributions."""

    restitution: float = 0.0  # of r
    friction: float = 0.0  # of the factor on the tangential impulse
    normal: float = 0.0  # of the angle by which the normal is turned about the vertical, rad
    distance: float = 0.0  # of the distance of the centres, over the sum of the radii
    seed: tuple[int, ...] = (0,)  # of the draws, which follow the order of the contacts

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
    """A tabletop on which, and between whose walls, bodies move."""

    walls: tuple[Wall, ...] = ()
    supports: tuple[Support | None, ...] = ()  # of each body; None: the plate, with the model's own laws; (): for all
    contact_duration: float = 0.0  # s; bounds sequences of impacts without end, see `dynamics.solve.solve`
    scatter: ContactScatter = ContactScatter()
    sticks: tuple[float, ...] = ()  # of each body: the impulse, N s, that parts it from one that it has hit; 0: never
    spring: ContactSpring | None = None  # of contacts that last; None: all are impacts in an instant
    # Share of the velocity of their centre of mass that two bodies which hit lose to the plate, a reading of Dutt et
    # al. (1999).
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
