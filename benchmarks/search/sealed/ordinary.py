"""Ordinary faults that no free law of the search was made for: laws that mix speed, place, heading, ball and clip.

As `outsiders`, in nobody's library, and without a free law of their own. Some differ from clip to clip: `_in` gives
what such a fault is in one clip. SAME: an effect that holds exactly this law. If the library has the fault, it is no
longer drawn, and a box of it is judged as one of that effect. FREE_LAW: a free law of the search that holds it by now:
it is no longer drawn either.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam.effect import parameter
from synthcam.library import library

from .outsiders import Outsider, dice, step

Array = NDArray[np.float64]

CLIPS = 30  # of a box: what drifts from clip to clip is zero in the middle one
GRAVITY = 9.81


@dataclass(frozen=True)
class Ordinary(Outsider):
    """Base of all."""


def now() -> Any:
    """A number that `_in` sets for each clip."""
    return parameter("1", typical=1.0, fixed=True, given=True, default=0.0)


def speed_of(velocity: Any) -> Any:
    return np.hypot(velocity[..., 0], velocity[..., 1])


def quarter_turn(velocity: Any) -> Any:
    """A quarter turn on."""
    return np.stack([-velocity[..., 1], velocity[..., 0]], axis=-1)


def disc(position: Any, x: float, y: float, radius: float) -> Any:
    """1 within a disc, 0 outside, smooth over its edge."""
    far = ((position[..., 0] - x) ** 2 + (position[..., 1] - y) ** 2) / radius**2
    return np.exp(-(np.minimum(far, 30.0) ** 2))


def since(clip: int) -> float:
    """-.5 at the first clip, .5 at the last."""
    return clip / (CLIPS - 1) - 0.5


# one ball alone


@dataclass(frozen=True)
class BallRollsWorse(Ordinary):
    """Ball a rolls with another drag and another deceleration than ball b."""

    SAME = ("rolling_mismatch",)
    drag: float = parameter("1/s", typical=0.02, low=-0.1, high=0.5)
    decel: float = parameter("m/s^2", typical=0.002, low=-0.008, high=0.1)

    def rolling(self, loss: Any, speed: Any, of_a: Any) -> Any:
        return loss + of_a * (self.drag * speed + self.decel)


@dataclass(frozen=True)
class BallDragged(Ordinary):
    """Ball a is dragged against its motion, sliding or rolling."""

    SAME = ("drag_mismatch",)
    rate: float = parameter("1/s", typical=0.02, low=-0.5, high=0.5)

    def push(self, acceleration: Any, velocity: Any, of_a: Any) -> Any:
        return acceleration - np.asarray(self.rate * of_a)[..., None] * velocity


@dataclass(frozen=True)
class BallCurves(Ordinary):
    """Ball a runs in a curve, as a loaded bowl does."""

    FREE_LAW = "force_velocity_a"
    rate: float = parameter("1/s", typical=0.02, low=-0.5, high=0.5)

    def push(self, acceleration: Any, velocity: Any, of_a: Any) -> Any:
        return acceleration + np.asarray(self.rate * of_a)[..., None] * quarter_turn(velocity)


@dataclass(frozen=True)
class BallOutOfRound(Ordinary):
    """Ball a is oval: its roll ripples twice a turn, by the place on the plate."""

    size: float = parameter("m/s^2", typical=0.02, low=-1, high=1)

    def rolling(self, loss: Any, speed: Any, position: Any, velocity: Any, radius: Any, of_a: Any) -> Any:
        way = (position * velocity).sum(axis=-1) / np.maximum(speed, 1e-9)
        return loss + of_a * self.size * np.cos(2 * way / radius)


@dataclass(frozen=True)
class TransferByBall(Ordinary):
    """The spin transfer is another where ball a is the launched one: one ball is worn on one side."""

    size: float = parameter("1", typical=0.02, low=-0.3, high=0.3)
    launched: float = now()

    def spin_transfer(self, c: Any, contact_speed: Any) -> Any:
        return c + self.size * self.launched + 0 * contact_speed

    def _in(self, clip: int, a_strikes: bool, launch: Array) -> Outsider:
        return dataclasses.replace(self, launched=float(a_strikes))


@dataclass(frozen=True)
class SpotRides(Ordinary):
    """The tracker follows a scratch on ball a: what it calls the centre runs ahead and behind, once a turn."""

    VIDEO = False
    size: float = parameter("m", typical=3e-6, low=-1e-4, high=1e-4)

    def _moved(self, xy: Array, velocity: Array, of_a: Array) -> Array:
        speed = np.maximum(speed_of(velocity), 1e-9)
        way = (xy * velocity).sum(axis=-1) / speed
        turned = of_a * self.size * np.cos(way / 1.19e-3) * (speed > 1e-4) / speed
        return np.asarray(turned[..., None] * velocity)


# heading, place and speed at once


@dataclass(frozen=True)
class RollingHeading(Ordinary):
    """A nap on the plate: the rolling loss depends on the heading."""

    c: float = parameter("1", typical=0.1, low=-0.6, high=0.6)
    s: float = parameter("1", typical=0.1, low=-0.6, high=0.6)

    def rolling(self, loss: Any, speed: Any, velocity: Any) -> Any:
        along = self.c * velocity[..., 0] + self.s * velocity[..., 1]
        return loss * (1 + along / np.maximum(speed, 1e-9))


@dataclass(frozen=True)
class DirtyPatch(Ordinary):
    """A dirty disc: balls slide and roll worse on it."""

    mu: float = parameter("1", typical=0.02, low=0, high=0.5)
    loss: float = parameter("m/s^2", typical=0.01, low=0, high=0.5)
    x: float = parameter("m", typical=0.01, low=-0.1, high=0.1, fixed=True)
    y: float = parameter("m", typical=0.006, low=-0.1, high=0.1, fixed=True)
    radius: float = parameter("m", typical=0.01, low=0.001, high=0.1, fixed=True)

    def friction(self, mu: Any, position: Any) -> Any:
        return mu + self.mu * disc(position, self.x, self.y, self.radius)

    def rolling(self, loss: Any, position: Any) -> Any:
        return loss + self.loss * disc(position, self.x, self.y, self.radius)


@dataclass(frozen=True)
class DampSpot(Ordinary):
    """A damp disc, on which balls roll worse and slide as everywhere."""

    loss: float = parameter("1/s", typical=0.05, low=0, high=5)
    x: float = parameter("m", typical=0.008, low=-0.1, high=0.1, fixed=True)
    y: float = parameter("m", typical=0.008, low=-0.1, high=0.1, fixed=True)
    radius: float = parameter("m", typical=0.012, low=0.001, high=0.1, fixed=True)

    def rolling(self, loss: Any, speed: Any, position: Any) -> Any:
        return loss + self.loss * speed * disc(position, -self.x, self.y, self.radius)


@dataclass(frozen=True)
class HalfPolished(Ordinary):
    """Friction that rises at slow slip, on one half of the plate alone."""

    rise: float = parameter("1", typical=0.05, low=-0.5, high=1)
    slip: float = parameter("m/s", typical=0.08, low=0.01, high=1, fixed=True)

    def friction(self, mu: Any, slip_speed: Any, position: Any) -> Any:
        return mu * (1 + self.rise * np.exp(-slip_speed / self.slip) * step(position[..., 0], 0.0, 0.003))


@dataclass(frozen=True)
class FrictionPace(Ordinary):
    """Friction that depends on how fast the ball itself goes, not on its slip."""

    FREE_LAW = "friction_ball_speed"
    rise: float = parameter("1", typical=0.05, low=-0.4, high=1)

    def friction(self, mu: Any, velocity: Any) -> Any:
        return mu * (1 + self.rise * speed_of(velocity) / 0.3)


@dataclass(frozen=True)
class RestitutionWay(Ordinary):
    """Balls with a soft side that is always placed the same way: restitution depends on the heading."""

    size: float = parameter("1", typical=0.01, low=-0.04, high=0.04)

    def restitution(self, r: Any, normal_speed: Any, heading: Any) -> Any:
        return r + self.size * (normal_speed / 0.3) * (0.54 * heading[..., 0] + 0.84 * heading[..., 1])


@dataclass(frozen=True)
class TransferOblique(Ordinary):
    """Oblique hits, beyond b of about .35, transfer more or less spin than others."""

    size: float = parameter("1", typical=0.02, low=-0.3, high=0.3)
    beyond: float = parameter("1", typical=0.35, low=0.05, high=0.9, fixed=True)
    b: float = now()

    def spin_transfer(self, c: Any, contact_speed: Any) -> Any:
        return c + self.size * step(abs(self.b), self.beyond, 0.03) + 0 * contact_speed

    def _in(self, clip: int, a_strikes: bool, launch: Array) -> Outsider:
        return dataclasses.replace(self, b=float(launch[5]))


@dataclass(frozen=True)
class RestitutionSide(Ordinary):
    """Hits on the left restore more than hits on the right."""

    size: float = parameter("1", typical=0.01, low=-0.1, high=0.1)
    b: float = now()

    def restitution(self, r: Any, normal_speed: Any) -> Any:
        return r + self.size * self.b + 0 * normal_speed

    def _in(self, clip: int, a_strikes: bool, launch: Array) -> Outsider:
        return dataclasses.replace(self, b=float(launch[5]))


@dataclass(frozen=True)
class Draught(Ordinary):
    """A wind along x: a drag that is quadratic in the speed through moving air."""

    FREE_LAW = "force_velocity"
    size: float = parameter("1/m", typical=0.02, low=0, high=0.15)
    wind: float = parameter("m/s", typical=0.25, low=-1, high=1, fixed=True)

    def push(self, acceleration: Any, velocity: Any) -> Any:
        through = velocity - np.array([self.wind, 0.0])
        return acceleration - self.size * speed_of(through)[..., None] * through


@dataclass(frozen=True)
class DraughtAtWall(Ordinary):
    """The same wind on one side of the plate alone."""

    size: float = parameter("1/m", typical=0.02, low=0, high=0.3)
    wind: float = parameter("m/s", typical=0.25, low=-1, high=1, fixed=True)

    def push(self, acceleration: Any, position: Any, velocity: Any) -> Any:
        through = velocity - np.array([self.wind, 0.0])
        share = self.size * step(position[..., 1], 0.0, 0.003)
        return acceleration - (share * speed_of(through))[..., None] * through


@dataclass(frozen=True)
class FrictionWay(Ordinary):
    """Friction that depends on the angle between a ball's slip and its way: dust is swept off or rolled in."""

    size: float = parameter("1", typical=0.02, low=-0.5, high=0.5)

    def friction(self, mu: Any, slip: Any, velocity: Any) -> Any:
        cosine = (slip * velocity).sum(axis=-1) / np.maximum(speed_of(velocity), 1e-9)
        return mu * (1 + self.size * cosine)


@dataclass(frozen=True)
class BallRollsAskew(Ordinary):
    """Ball a has a flat band: it rolls worse one way than the other, the faster the more."""

    size: float = parameter("1/s", typical=0.02, low=-0.3, high=0.3)

    def rolling(self, loss: Any, velocity: Any, of_a: Any) -> Any:
        return loss + of_a * self.size * (0.8 * velocity[..., 0] - 0.6 * velocity[..., 1])


@dataclass(frozen=True)
class Sag(Ordinary):
    """A plate that sags in its middle, more along x, and is rougher there."""

    curve: float = parameter("1/m", typical=1e-3, low=-0.02, high=0.02)
    mu: float = parameter("1", typical=0.01, low=-0.1, high=0.1)

    def push(self, acceleration: Any, position: Any) -> Any:
        return acceleration - GRAVITY * self.curve * position * np.array([1.0, 0.5])

    def friction(self, mu: Any, position: Any) -> Any:
        return mu + self.mu * disc(position, 0.0, 0.0, 0.02)


# another in each clip


@dataclass(frozen=True)
class FrictionDrift(Ordinary):
    """The plate warms up: friction falls from clip to clip."""

    rise: float = parameter("1", typical=0.02, low=-0.5, high=0.5)
    late: float = now()

    def friction(self, mu: Any) -> Any:
        return mu * (1 + self.rise * self.late)

    def _in(self, clip: int, a_strikes: bool, launch: Array) -> Outsider:
        return dataclasses.replace(self, late=since(clip))


@dataclass(frozen=True)
class Wear(Ordinary):
    """Balls wear out from clip to clip: they restore less and roll worse."""

    soft: float = parameter("1", typical=0.01, low=-0.1, high=0.1)
    rough: float = parameter("1", typical=0.1, low=-0.8, high=0.8)
    late: float = now()

    def restitution(self, r: Any, normal_speed: Any) -> Any:
        return r - self.soft * self.late + 0 * normal_speed

    def rolling(self, loss: Any) -> Any:
        return loss * (1 + self.rough * self.late)

    def _in(self, clip: int, a_strikes: bool, launch: Array) -> Outsider:
        return dataclasses.replace(self, late=since(clip))


@dataclass(frozen=True)
class LeaningTable(Ordinary):
    """Somebody leans on the table: a tilt of the same size another way in each clip."""

    size: float = parameter("1", typical=1e-4, low=-1e-3, high=1e-3)
    way: float = now()

    def push(self, acceleration: Any, velocity: Any) -> Any:
        return acceleration + GRAVITY * self.size * np.array([np.cos(self.way), np.sin(self.way)]) + 0 * velocity

    def _in(self, clip: int, a_strikes: bool, launch: Array) -> Outsider:
        return dataclasses.replace(self, way=2.4 * clip)


@dataclass(frozen=True)
class ClockScatter(Ordinary):
    """A camera whose frame rate is a little another in each clip."""

    size: float = parameter("1", typical=1e-3, low=0, high=0.1)
    off: float = now()

    def clock(self, t: Any) -> Any:
        return t * (1 + self.size * self.off)

    def _in(self, clip: int, a_strikes: bool, launch: Array) -> Outsider:
        return dataclasses.replace(self, off=float(dice(clip)))


ORDINARY = {kind.name(): kind for kind in Ordinary.__subclasses__()}
UNKNOWN = [n for n, kind in ORDINARY.items() if not kind.FREE_LAW and not set(kind.SAME) & set(library())]
