"""Effects outside every library: the search must name none of its own, and find the right free law.

Each bends a law as an effect of the library does, but lives here, where the search cannot see it. FREE_LAW: the
search's own word for the freedom that describes it. `_curve`: what it adds to that law, of the law's arguments. Two are
no laws of motion but defects of a picture, and move the tracks after the fact: see `moved`.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from synthcam.effect import Effect, parameter
from synthcam.model import Model

Array = NDArray[np.float64]


def step(x: Any, where: float, width: float) -> Any:
    return (1 + np.tanh((x - where) / width)) / 2


def bump(x: Any, where: float, width: float) -> Any:
    return np.exp(-(((x - where) / width) ** 2) / 2)


def dice(x: Any) -> Any:
    """Numbers of mean 0 and variance 1 that look random: another for each clip, the same for each run of one."""
    return np.sqrt(2) * np.cos(1e6 * np.asarray(x))


@dataclass(frozen=True)
class Outsider(Effect):
    """Base of all; named after its class."""

    FREE_LAW: ClassVar[str] = ""
    VIDEO: ClassVar[bool] = True  # can it be filmed?
    SAME: ClassVar[tuple[str, ...]] = ()  # effects that hold exactly this law, should the library have them

    @classmethod
    def name(cls) -> str:
        return "".join("_" + c.lower() if c.isupper() else c for c in cls.__name__).lstrip("_")

    def _in(self, clip: int, a_strikes: bool, launch: Array) -> Outsider:
        """Return the effect in one clip, from its number, whether ball a is launched, and x, y, t_c, v0, heading, b."""
        return self


@dataclass(frozen=True)
class FrictionStreaks(Outsider):
    """Sliding friction in streaks along y."""

    FREE_LAW: ClassVar[str] = "friction_place"
    depth: float = parameter("1", typical=0.01, low=-0.2, high=0.2)
    wavelength: float = parameter("m", typical=0.015, low=0.001, high=1, fixed=True)

    def friction(self, mu: Any, position: Any) -> Any:
        return mu + self._curve(position[..., 0], position[..., 1])

    def _curve(self, x: Any, y: Any) -> Any:
        return self.depth * np.sin(2 * np.pi * x / self.wavelength)


@dataclass(frozen=True)
class FrictionStep(Outsider):
    """Sliding friction that is another beyond a speed of slip."""

    FREE_LAW: ClassVar[str] = "friction_speed"
    rise: float = parameter("1", typical=0.01, low=-0.2, high=0.2)
    at: float = parameter("m/s", typical=0.2, low=0.01, high=1, fixed=True)

    def friction(self, mu: Any, slip_speed: Any) -> Any:
        return mu + self._curve(slip_speed)

    def _curve(self, x: Any) -> Any:
        return self.rise * step(x, self.at, 0.02)


@dataclass(frozen=True)
class RestitutionStep(Outsider):
    """Balls that yield beyond a speed of impact."""

    FREE_LAW: ClassVar[str] = "restitution_speed"
    drop: float = parameter("1", typical=0.02, low=-0.3, high=0.3)
    at: float = parameter("m/s", typical=0.3, low=0.01, high=1, fixed=True)

    def restitution(self, r: Any, normal_speed: Any) -> Any:
        return r + self._curve(normal_speed)

    def _curve(self, x: Any) -> Any:
        return -self.drop * step(x, self.at, 0.01)


@dataclass(frozen=True)
class RestitutionHeading(Outsider):
    """Restitution that depends on the heading, threefold."""

    FREE_LAW: ClassVar[str] = "restitution_heading"
    size: float = parameter("1", typical=0.02, low=-0.3, high=0.3)

    def restitution(self, r: Any, heading: Any) -> Any:
        return r + self._curve(np.arctan2(heading[..., 1], heading[..., 0]))

    def _curve(self, x: Any) -> Any:
        return self.size * np.cos(3 * x)


@dataclass(frozen=True)
class RestitutionScatter(Outsider):
    """Restitution that is another from clip to clip."""

    FREE_LAW: ClassVar[str] = "restitution_clip"
    size: float = parameter("1", typical=0.01, low=0, high=0.3)

    def restitution(self, r: Any, heading: Any) -> Any:
        return r + self.size * dice(heading[..., 0] + 0.618 * heading[..., 1])


@dataclass(frozen=True)
class TransferScatter(Outsider):
    """Spin transfer that is another from clip to clip."""

    FREE_LAW: ClassVar[str] = "spin_transfer_clip"
    size: float = parameter("1", typical=0.02, low=0, high=0.3)

    def spin_transfer(self, c: Any, approach_speed: Any) -> Any:
        return c + self.size * dice(approach_speed)


@dataclass(frozen=True)
class TransferBump(Outsider):
    """Spin transfer with a resonance in the contact speed."""

    FREE_LAW: ClassVar[str] = "spin_transfer_speed"
    size: float = parameter("1", typical=0.05, low=-0.3, high=0.3)
    at: float = parameter("m/s", typical=0.35, low=0.01, high=1, fixed=True)

    def spin_transfer(self, c: Any, contact_speed: Any) -> Any:
        return c + self._curve(contact_speed)

    def _curve(self, x: Any) -> Any:
        return self.size * bump(x, self.at, 0.05)


@dataclass(frozen=True)
class RootDrag(Outsider):
    """A force against the motion that grows with the root of the speed, sliding or rolling."""

    FREE_LAW: ClassVar[str] = "force_speed"
    size: float = parameter("m^.5 s^-1.5", typical=0.01, low=-1, high=1)

    def push(self, acceleration: Any, velocity: Any) -> Any:
        speed = np.hypot(velocity[..., 0], velocity[..., 1])
        return acceleration - (self.size / np.sqrt(np.maximum(speed, 1e-9)))[..., None] * velocity

    def _curve(self, x: Any) -> Any:
        return -self.size * np.sqrt(x)


@dataclass(frozen=True)
class GrainDrag(Outsider):
    """A drag on the x component of the velocity alone, sliding or rolling."""

    FREE_LAW: ClassVar[str] = "force_heading"
    rate: float = parameter("1/s", typical=0.05, low=-1, high=1)

    def push(self, acceleration: Any, velocity: Any) -> Any:
        return acceleration - self.rate * velocity * np.array([1.0, 0.0])

    def _curve(self, x: Any) -> Any:
        """Along the motion and across it, over the speed."""
        return -self.rate * np.stack([np.cos(x), -np.sin(x)], axis=-1) * np.cos(x)[..., None]


@dataclass(frozen=True)
class Dent(Outsider):
    """A bump in the plate, 6 mm wide, off its middle."""

    FREE_LAW: ClassVar[str] = "force_place"
    height: float = parameter("m", typical=1e-6, low=-5e-6, high=5e-6)
    x: float = parameter("m", typical=0.012, low=-0.1, high=0.1, fixed=True)
    y: float = parameter("m", typical=0.008, low=-0.1, high=0.1, fixed=True)

    def push(self, acceleration: Any, position: Any) -> Any:
        return acceleration + self._curve(position[..., 0], position[..., 1])

    def _curve(self, x: Any, y: Any) -> Any:
        off = np.stack([x - self.x, y - self.y], axis=-1) / 6e-3
        hill = self.height * np.exp(-(off * off).sum(axis=-1) / 2)
        return 9.81 * hill[..., None] * off / 6e-3


@dataclass(frozen=True)
class RollingResonance(Outsider):
    """A loss while rolling at one speed."""

    FREE_LAW: ClassVar[str] = "rolling_speed"
    size: float = parameter("m/s^2", typical=0.01, low=0, high=1)
    at: float = parameter("m/s", typical=0.2, low=0.01, high=1, fixed=True)

    def rolling(self, loss: Any, speed: Any) -> Any:
        return loss + self._curve(speed)

    def _curve(self, x: Any) -> Any:
        return self.size * bump(x, self.at, 0.03)


@dataclass(frozen=True)
class SpeedDelay(Outsider):
    """A picture that lags behind a fast ball by a time that grows as the square of its speed."""

    FREE_LAW: ClassVar[str] = "lag_speed"
    VIDEO: ClassVar[bool] = False
    late: float = parameter("s", typical=1e-4, low=-2e-3, high=2e-3)

    def _moved(self, xy: Array, velocity: Array, of_a: Array) -> Array:
        return np.asarray(-self._curve(np.hypot(velocity[..., 0], velocity[..., 1]))[..., None] * velocity)

    def _curve(self, x: Any) -> Any:
        return self.late * (x / 0.3) ** 2


@dataclass(frozen=True)
class QuarticWarp(Outsider):
    """A picture bent along x by the fourth power of the place."""

    FREE_LAW: ClassVar[str] = "warp_place"
    VIDEO: ClassVar[bool] = False
    size: float = parameter("m", typical=2e-5, low=-1e-3, high=1e-3)

    def _moved(self, xy: Array, velocity: Array, of_a: Array) -> Array:
        return np.stack([self.size * (xy[..., 0] / 0.05) ** 4, 0 * xy[..., 1]], axis=-1)

    def _curve(self, x: Any, y: Any) -> Any:
        """In px, at px of a picture 640 wide."""
        place = (x - 319.5) * 1.6e-4
        return np.stack([self.size / 1.6e-4 * (place / 0.05) ** 4, 0 * y], axis=-1)


OUTSIDERS = {kind.name(): kind for kind in Outsider.__subclasses__() if kind.FREE_LAW}


def in_clip(model: Model, clip: int, a_strikes: bool, launch: Array) -> Model:
    """Return the model of one clip: some outsiders differ from clip to clip."""
    own = tuple(e._in(clip, a_strikes, launch) if isinstance(e, Outsider) else e for e in model.effects)
    return model if own == model.effects else dataclasses.replace(model, effects=own)


def moved(effects: Any, xy: Array, velocity: Array, of_a: Any) -> Array:
    """How far, m, defects of the picture move balls at xy (..., 2), m, with these velocities. of_a: 1 of ball a."""
    out = np.zeros_like(xy)
    for effect in effects:
        if hasattr(effect, "_moved"):
            out = out + effect._moved(xy, velocity, of_a)
    return out
