"""Discs on a dry plate, one alone or several that move as one: friction force and torque depend on each other.

The pressure under each disc is even. Its centre has the velocity v; let y = R |w| and e = v/y. Then friction gives the
force -mu m g F(e) along v and the torque -mu m g R T(e). F and T are integrals over the disc (Voyenli & Eriksen, Am. J.
Phys. 53 (1985) 1149). See also Farkas, Bartels, Unger & Wolf, Phys. Rev. Lett. 90 (2003) 248302. The forces and torques
on discs that move as one add up. One alone moves on a straight line; its sliding and turning end at the same moment,
with e near 0.653.

V is the velocity of the centre of mass and l the radius of gyration. The motion is solved in s = ln(r0/r), where (V, l
w) = r d. There the direction d is smooth to the end, where r falls to nothing in a finite time.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from scipy.special import ellipe, ellipk

from synthcam.dynamics.trajectory import Leg, NumericLeg, RestLeg
from synthcam_shared.arrays import Array

STOPPED_M_S = 1e-12
LAST_LOG = 36.0  # of s: r is then 2e-16 of its first value
GRID = np.concatenate([np.linspace(0, 6, 301), np.linspace(6.1, LAST_LOG, 300)])
DISC_INERTIA = 0.5  # k


class DryDisc(NamedTuple):
    """A disc, the offset of its centre from that of mass at the beginning, m, and its height, m."""

    x: float
    y: float
    z: float
    mass: float
    radius: float


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


@dataclass(frozen=True)
class DryBody:
    """Discs that move as one. slowing: friction times gravity, m/s^2."""

    discs: Sequence[DryDisc]
    slowing: float

    @cached_property
    def mass(self) -> float:
        return sum(disc.mass for disc in self.discs)

    @cached_property
    def gyration(self) -> float:
        """The radius of gyration about the centre of mass, m."""
        turning = sum(d.mass * (d.x**2 + d.y**2 + DISC_INERTIA * d.radius**2) for d in self.discs)
        return math.sqrt(turning / self.mass)

    def rub(self, direction: Sequence[float], angle: float) -> tuple[float, float, float]:
        """Return the rates of change of V and of l w by friction, over `slowing`, for a direction of (V, l w).

        angle: by which the discs have turned, rad.
        """
        mass, gyration, c, s = self.mass, self.gyration, math.cos(angle), math.sin(angle)
        vx, vy, spin = direction[0], direction[1], direction[2] / gyration
        out = [0.0, 0.0, 0.0]
        for disc in self.discs:
            x, y = c * disc.x - s * disc.y, s * disc.x + c * disc.y
            ux, uy, turn = vx - spin * y, vy + spin * x, disc.radius * abs(spin)
            speed, share = math.hypot(ux, uy), disc.mass / mass
            force, torque = friction_of_disc(math.atan2(turn, speed))
            along = share * force / max(speed, 1e-300)
            out[0] -= along * ux
            out[1] -= along * uy
            out[2] -= (along * (x * uy - y * ux) + math.copysign(share * disc.radius * torque, spin)) / gyration
        return out[0], out[1], out[2]

    def legs(self, centre: tuple[float, ...], t: float) -> list[Leg]:
        """Return the legs of the discs from the time t, s, until they stop.

        centre: x, y, vx, vy of the centre of mass, and the spin.
        """
        (x, y, vx, vy, spin), gyration = centre, self.gyration
        first = math.hypot(vx, vy, gyration * spin)
        if first <= STOPPED_M_S:
            return [RestLeg(t, math.inf, (x + disc.x, y + disc.y, disc.z, *(0.0,) * 6)) for disc in self.discs]
        turns = first * first / (self.slowing * gyration)

        def law(s: float, now: Array) -> list[float]:
            """Return the changes of direction, angle, time over r0/slowing, and path over r0^2/slowing."""
            direction, r = now[:3].tolist(), math.exp(-s)
            rates = self.rub(direction, float(now[3]))
            size2 = sum(d * d for d in direction)  # 1 but for rounding, which is not to grow
            loss = -sum(a * d for a, d in zip(rates, direction, strict=True)) / size2
            change = [a / loss + d for a, d in zip(rates, direction, strict=True)]
            vx, vy, turning = (r * r * d / loss for d in direction)
            return [*change, turns * turning, r / loss, vx, vy]

        from scipy.integrate import solve_ivp  # here alone: slow to load

        start = [vx / first, vy / first, gyration * spin / first, 0.0, 0.0, 0.0, 0.0]
        done = solve_ivp(law, (0.0, LAST_LOG), start, method="DOP853", rtol=1e-12, atol=1e-15, dense_output=True)
        ends = done.sol(GRID)[4]  # type: ignore[misc]
        rates = np.maximum(np.gradient(ends, GRID), 1e-300)

        def place(disc: DryDisc, times: Array) -> Array:
            """Return the states (m, 9) of a disc."""
            elapsed = np.clip((times - t) * self.slowing / first, 0.0, ends[-1])
            s = np.interp(elapsed, ends, GRID)
            for _ in range(5):  # each makes the error a thousand times smaller
                s = np.clip(s + (elapsed - done.sol(s)[4]) / np.interp(s, GRID, rates), 0.0, LAST_LOG)  # type: ignore[misc]
            *direction, angle, _, along, across = done.sol(s)  # type: ignore[misc]
            r, path = first * np.exp(-s), first**2 / self.slowing
            vx, vy, turning = (r * d for d in direction)
            spins, cos, sin = turning / gyration, np.cos(angle), np.sin(angle)
            dx, dy = cos * disc.x - sin * disc.y, sin * disc.x + cos * disc.y
            at_x, at_y = x + path * along + dx, y + path * across + dy
            out = np.zeros((len(times), 9))
            out[:, [0, 1, 3, 4, 8]] = np.stack([at_x, at_y, vx - spins * dy, vy + spins * dx, spins], axis=1)
            out[:, 2] = disc.z
            return out

        reach = sum(d.mass * (math.hypot(d.x, d.y) + d.radius) for d in self.discs) / self.mass
        whirl = self.slowing * reach / gyration**2 + (first / gyration) ** 2
        lasts = float(ends[-1]) * first / self.slowing
        legs = list[Leg]()
        for disc in self.discs:
            steepest = self.slowing + whirl * math.hypot(disc.x, disc.y)
            legs.append(NumericLeg(t, t + lasts, partial(place, disc), steepest, motion="glide"))
        return legs
