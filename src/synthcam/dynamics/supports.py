"""The supports that a body may have instead of the plate: a cushion of air, or a dry plate under a disc."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from synthcam.dynamics.dry_discs import DISC_INERTIA, STOPPED_M_S, DryBody, DryDisc, friction_of_disc
from synthcam.dynamics.kinematics import State
from synthcam.dynamics.trajectory import GlideLeg, Leg, RestLeg

FADING_M_S = 1e-6  # friction in a contact that lasts fades at speeds below it


class Support(ABC):
    """Carries a body instead of the plate that the model's own laws describe."""

    @abstractmethod
    def leg(self, state: State, radius: float, t: float) -> Leg:
        """Return the leg of a body in this state at the time t, s, up to its own end."""

    @abstractmethod
    def accelerate(self, state: State, radius: float) -> tuple[float, float, float]:
        """Return the rates of change of vx, vy and wz of a body in this state."""

    def draw_stretch(self, rng: np.random.Generator) -> tuple[Self, dict[str, float]]:
        """Draw what the support is until the next hit; also the draws, by name."""
        return self, {}


@dataclass(frozen=True)
class Air(Support):
    """A cushion of air under a disc: v' = -(decel + drag v) v/|v| + curl z x v, and a spin that decays."""

    decel: float = 0.0  # m/s^2
    drag: float = 0.0  # 1/s
    curl: float = 0.0  # rad/s: the rate at which the path turns to the left
    spin_drag: float = 0.0  # 1/s: the rate at which the spin decays
    decel_range: tuple[float, float] | None = None  # in which it is drawn, evenly, for each stretch between two hits
    curl_range: tuple[float, float] | None = None

    def leg(self, state: State, radius: float, t: float) -> Leg:
        if math.hypot(state[3], state[4]) <= STOPPED_M_S:
            still: State = (*state[:3], 0.0, 0.0, 0.0, 0.0, 0.0, state[8])
            if self.spin_drag == 0 or state[8] == 0:
                return RestLeg(t, math.inf, still)
            return GlideLeg(t, math.inf, t, still, 0.0, 0.0, 0.0, self.spin_drag, motion="rest")
        return GlideLeg.of(t, state, self.decel, self.drag, self.curl, self.spin_drag)

    def accelerate(self, state: State, radius: float) -> tuple[float, float, float]:
        vx, vy = state[3], state[4]
        loss = self.drag + self.decel / math.hypot(vx, vy, FADING_M_S)
        return -loss * vx - self.curl * vy, -loss * vy + self.curl * vx, -self.spin_drag * state[8]

    def draw_stretch(self, rng: np.random.Generator) -> tuple[Self, dict[str, float]]:
        ranges = {"decel": self.decel_range, "curl": self.curl_range}
        drawn = {name: float(rng.uniform(*limits)) for name, limits in ranges.items() if limits}
        return replace(self, decel=drawn.get("decel", self.decel), curl=drawn.get("curl", self.curl)), drawn


@dataclass(frozen=True)
class DryPlate(Support):
    """A plate on which a disc slides and turns, under an even pressure."""

    slowing: float  # friction times gravity, m/s^2

    def leg(self, state: State, radius: float, t: float) -> Leg:
        x, y, z, vx, vy, *_, spin = state
        return DryBody((DryDisc(0.0, 0.0, z, 1.0, radius),), self.slowing).legs((x, y, vx, vy, spin), t)[0]

    def accelerate(self, state: State, radius: float) -> tuple[float, float, float]:
        vx, vy, turn = state[3], state[4], radius * state[8]
        speed = math.hypot(vx, vy)
        force, torque = friction_of_disc(math.atan2(abs(turn), speed))
        fading = self.slowing / math.hypot(speed, turn, FADING_M_S) * math.hypot(speed, turn)
        along = fading * force / max(speed, FADING_M_S)
        return -along * vx, -along * vy, -math.copysign(fading * torque / DISC_INERTIA / radius, turn)
