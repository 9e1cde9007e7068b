"""Supports of a body other than the plate: a cushion of air, or a dry plate under a disc.

A disc that slides and turns on a dry plate: friction force and torque depend on each other.

The pressure is even. With the speed v, y = R |w|, their ratio e = v/y and k = I/(m R^2) = 1/2:

    v' = -mu g F(e),   y' = -(mu g/k) T(e)

F and T are integrals over the disc (Voyenli & Eriksen, Am. J. Phys. 53 (1985) 1149; Farkas, Bartels, Unger &
Wolf, Phys. Rev. Lett. 90 (2003) 248302). The path is straight. Sliding and turning end at the same moment, with e near
0.653.

The motion is solved in s = ln(r0/r), with v = r cos(phi), y = r sin(phi). There phi is smooth to the end, where r falls
to nothing in a finite time.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.special import ellipe, ellipk

from synthcam.dynamics.kinematics import Array, State
from synthcam.dynamics.trajectory import Glide, Leg, Numeric, Rest

STOPPED_M_S = 1e-12
FADING_M_S = 1e-6  # friction in a contact that lasts fades at speeds below it
LAST_LOG = 36.0  # of s: r is then 2e-16 of its first value
DISC = 0.5  # k


class Support(ABC):
    """Carries a body in place of the plate that the model's own laws describe."""

    @abstractmethod
    def leg(self, state: State, radius: float, t: float) -> Leg:
        """Return the leg of a body in this state at the time t, s, up to its own end."""

    @abstractmethod
    def accelerate(self, state: State, radius: float) -> tuple[float, float, float]:
        """Return the rates of change of vx, vy and wz of a body in this state."""

    def draw_stretch(self, rng: np.random.Generator) -> tuple[Support, dict[str, float]]:
        """Draw what the support is until the next hit; also the draws, by name."""
        return self, {}


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
    decel_range, curl_range : tuple of float, optional
        Limits between which `decel` and `curl` are drawn, evenly, for each stretch of motion between two hits.
    """

    decel: float = 0.0
    drag: float = 0.0
    curl: float = 0.0
    spin_drag: float = 0.0
    decel_range: tuple[float, float] | None = None
    curl_range: tuple[float, float] | None = None

    def leg(self, state: State, radius: float, t: float) -> Leg:
        if math.hypot(state[3], state[4]) <= STOPPED_M_S:
            still: State = (*state[:3], 0.0, 0.0, 0.0, 0.0, 0.0, state[8])
            if self.spin_drag == 0 or state[8] == 0:
                return Rest(t, math.inf, still)
            return Glide(t, math.inf, t, still, 0.0, 0.0, 0.0, self.spin_drag, motion="rest")
        return Glide.of(t, state, self.decel, self.drag, self.curl, self.spin_drag)

    def accelerate(self, state: State, radius: float) -> tuple[float, float, float]:
        vx, vy = state[3], state[4]
        loss = self.drag + self.decel / math.hypot(vx, vy, FADING_M_S)
        return -loss * vx - self.curl * vy, -loss * vy + self.curl * vx, -self.spin_drag * state[8]

    def draw_stretch(self, rng: np.random.Generator) -> tuple[Support, dict[str, float]]:
        ranges = {"decel": self.decel_range, "curl": self.curl_range}
        drawn = {name: float(rng.uniform(*limits)) for name, limits in ranges.items() if limits}
        return replace(self, decel=drawn.get("decel", self.decel), curl=drawn.get("curl", self.curl)), drawn


@dataclass(frozen=True)
class DryPlate(Support):
    """A plate on which a disc slides and turns, under an even pressure.

    Attributes
    ----------
    slowing : float
        Friction times gravity, m/s^2.
    """

    slowing: float

    def leg(self, state: State, radius: float, t: float) -> Leg:
        if max(math.hypot(state[3], state[4]), radius * abs(state[8])) <= STOPPED_M_S:
            return Rest(t, math.inf, (*state[:3], *(0.0,) * 6))
        return _slide_and_turn(state, radius, self.slowing, t)

    def accelerate(self, state: State, radius: float) -> tuple[float, float, float]:
        vx, vy, turn = state[3], state[4], radius * state[8]
        speed = math.hypot(vx, vy)
        force, torque = friction_of_disc(math.atan2(abs(turn), speed))
        fading = self.slowing / math.hypot(speed, turn, FADING_M_S) * math.hypot(speed, turn)
        along = fading * force / max(speed, FADING_M_S)
        return -along * vx, -along * vy, -math.copysign(fading * torque / DISC / radius, turn)


def friction_of_disc(phi: float) -> tuple[float, float]:
    """Return force over mu m g, and torque over mu m g R, of a disc with v = r cos(phi), R w = r sin(phi)."""
    v, y = math.cos(phi), math.sin(phi)
    if y < 1e-9:
        return 1.0, y / v / 4
    if v < 1e-9:
        return v / y, 2 / 3
    e = v / y
    m = e * e if e <= 1 else 1 / (e * e)
    first, second = float(ellipk(m)), float(ellipe(m))
    if e > 30:  # the closed form would lose digits to cancellation
        return 1 - m / 8 - m * m / 64, (1 + m / 12 + 3 * m * m / 128) / (4 * e)
    if e <= 1:
        force = 4 / (3 * math.pi * e) * ((m + 1) * second + (m - 1) * first)
        return force, 4 / (9 * math.pi) * ((4 - 2 * m) * second + (m - 1) * first)
    square = e * e
    force = 4 / (3 * math.pi) * ((square + 1) * second - (square - 1) * first)
    return force, 4 / (9 * math.pi) * e * ((4 - 2 * square) * second + (2 * square - 5 + 3 * m) * first)


@lru_cache(maxsize=256)
def _solve_disc(phi: float) -> Callable[[Array], Array]:
    """Solve from the angle phi at s = 0: phi, time times mu g/r0, and path times mu g/r0^2, as a function of s."""

    def law(s: float, now: NDArray[np.float64]) -> list[float]:
        angle, r = float(np.clip(now[0], 0.0, math.pi / 2)), math.exp(-s)
        force, torque = friction_of_disc(angle)
        v, y = math.cos(angle), math.sin(angle)
        loss = v * force + y * torque / DISC
        return [(y * force - v * torque / DISC) / loss, r / loss, r * r * v / loss]

    found = solve_ivp(law, (0.0, LAST_LOG), [phi, 0.0, 0.0], method="DOP853", rtol=1e-12, atol=1e-15, dense_output=True)
    assert found.sol is not None
    return found.sol


def _slide_and_turn(state: State, radius: float, slowing: float, t: float) -> Numeric:
    """Return the leg of a sliding disc from the time t, s, until it stops; slowing: mu g, m/s^2."""
    speed, turn = math.hypot(state[3], state[4]), radius * abs(state[8])
    first = math.hypot(speed, turn)
    solution = _solve_disc(math.atan2(turn, speed))
    grid = np.concatenate([np.linspace(0, 6, 301), np.linspace(6.1, LAST_LOG, 300)])
    ends = solution(grid)[1]
    lasts = float(ends[-1]) * first / slowing
    hat = np.array(state[3:5]) / speed if speed > 0 else np.zeros(2)

    def states(times: Array) -> Array:
        share = np.clip((np.asarray(times) - t) * slowing / first, 0.0, ends[-1])
        s = np.interp(share, ends, grid)
        for _ in range(4):  # Newton's method; dt/ds = r/loss
            phi, sofar, _ = solution(s)
            rate = np.array([_time_rate(a, b) for a, b in zip(phi, s, strict=True)])
            s = np.clip(s + (share - sofar) / np.maximum(rate, 1e-300), 0.0, LAST_LOG)
        phi, _, path = solution(s)
        out, r = np.zeros((len(share), 9)), first * np.exp(-s)
        out[:, :2] = np.array(state[:2]) + (path * first**2 / slowing)[:, None] * hat
        out[:, 2] = state[2]
        out[:, 3:5] = (r * np.cos(phi))[:, None] * hat
        out[:, 8] = math.copysign(1.0, state[8]) * r * np.sin(phi) / radius
        return out

    return Numeric(t, t + lasts, states, slowing, motion="glide")


def _time_rate(phi: float, s: float) -> float:
    force, torque = friction_of_disc(float(np.clip(phi, 0.0, math.pi / 2)))
    return math.exp(-s) / (math.cos(phi) * force + math.sin(phi) * torque / DISC)
