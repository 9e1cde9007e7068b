"""Two rolling balls that collide, by an independent integrator without any code of synthcam.

A ball's state is its position, the velocity q = (5 v + 2 R w x z)/7 with which it would roll, and the velocity u of its
lowest point. v = q + (2/7) u. A force F per mass at the lowest point and a push p on the centre give q' = (5/7) p and
u' = (7/2) F + p. Sliding ends where |u| falls under ENDED. A slower slip moves a ball by less than 1 nm in a second.

PHYSICS lists what it knows beside the base model, each law written from its formula.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]
Piece = tuple[float, float, Callable[[Array], Array]]  # from, to, places (2, n) at times (n,)

ENDED, STOPPED = 1e-7, 1e-6  # m/s
HOW: Any = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-13, "dense_output": True}
GAUSS = np.polynomial.legendre.leggauss(6)

PHYSICS = (
    "air_drag drag_mismatch friction_anisotropy friction_mismatch mass_mismatch plate_tilt plate_waviness "
    "rolling_mismatch rolling_quadratic spin_transfer_velocity stribeck velocity_restitution viscous_friction"
).split()


class Plate:
    """The numbers of a base model and of effects by dotted name, and the laws that they make for one of the balls."""

    def __init__(self, numbers: Mapping[str, float], is_a: bool = False) -> None:
        self.all, self.is_a = numbers, is_a
        unknown = {k.partition(".")[0] for k in numbers if "." in k} - set(PHYSICS)
        if unknown:
            raise ValueError(f"this integrator knows nothing of {', '.join(sorted(unknown))}")
        self.radius = numbers["diameter"] / 2
        self.mass = numbers["density"] * 4 / 3 * math.pi * self.radius**3

    def __getitem__(self, name: str) -> float:
        return self.all.get(name, 0.0)

    def under(self, is_a: bool) -> Plate:
        """The laws for the other ball, or for the same."""
        return Plate(self.all, is_a)

    def mass_of(self, is_a: bool) -> float:
        return self.mass * (1 + self["mass_mismatch.excess"] * is_a)

    def restitution(self, speed: float) -> float:
        bend = 5 * ((speed / 0.3) ** 0.2 - 1)
        return float(1 - (1 - self["restitution"]) * (1 + self["velocity_restitution.e"] * bend))

    def spin_transfer(self, v0: float) -> float:
        return self["spin_transfer"] * (1 + self["spin_transfer_velocity.c"] * (v0 / 0.3 - 1))

    def friction(self, u: Array) -> float:
        slip = math.hypot(*u)
        twice = 2 * math.atan2(u[1], u[0])
        grain = self["friction_anisotropy.c"] * math.cos(twice) + self["friction_anisotropy.s"] * math.sin(twice)
        weak = self["stribeck.rise"] and self["stribeck.rise"] * math.exp(-slip / self["stribeck.slip"])
        own = 1 + self["friction_mismatch.excess"] * self.is_a
        return self["sliding_friction"] * own * (1 + weak) * (1 + self["viscous_friction.k"] * slip) * (1 + grain)

    def wave(self, x: Array) -> tuple[Array, float, complex]:
        """Along which the plate's waves run, their number, and the height as a real part: each slope a factor of ik."""
        angle, k = self["plate_waviness.angle"], 2 * math.pi / self["plate_waviness.wavelength"]
        way = np.array([math.cos(angle), math.sin(angle)])
        crest = complex(self["plate_waviness.a"], -self["plate_waviness.b"])
        return way, k, crest * cmath.exp(1j * k * float(x @ way))

    def load(self, x: Array, v: Array) -> float:
        """On the plate, per mass: gravity, and what makes the ball rise and fall with it."""
        if not (self["plate_waviness.a"] or self["plate_waviness.b"]):
            return self["gravity"]
        way, k, wave = self.wave(x)
        return max(0.0, self["gravity"] + float(v @ way) ** 2 * ((1j * k) ** 2 * wave).real)

    def push(self, x: Array, v: Array, mass: float) -> Array:
        out = self["gravity"] * np.sin([self["plate_tilt.x"], self["plate_tilt.y"]])
        if self["plate_waviness.a"] or self["plate_waviness.b"]:
            way, k, wave = self.wave(x)
            out = out - self["gravity"] * (1j * k * wave).real * way
        speed = math.hypot(*v)
        if self["air_drag.share"] and speed > 0:
            reynolds = 2 * self.radius * speed / 1.516e-5
            coefficient = 24 / reynolds + 3.6 * reynolds**-0.313
            force = coefficient * 1.204 * speed**2 / 2 * math.pi * self.radius**2
            out = out - self["air_drag.share"] * force / mass * v / speed
        return np.asarray(out - self["drag_mismatch.a" if self.is_a else "drag_mismatch.b"] * v)

    def loss(self, speed: float) -> float:
        k = self["rolling_quadratic.K"]
        own = self.is_a * (self["rolling_mismatch.drag"] * speed + self["rolling_mismatch.decel"])
        return self["rolling_drag"] * speed + self["rolling_decel"] + k * speed**2 + own


def collision(plate: Plate, launch: Array, striker_is_a: bool, end: float) -> list[list[Piece]]:
    """Paths of target and striker from 0 to `end`. launch: x, y of the contact, t_c, v0, heading, b; as everywhere."""
    x, y, t_c, v0, heading, b = (float(f) for f in launch)
    radius, where = plate.radius, np.array([x, y])
    ahead = np.array([math.cos(heading), math.sin(heading), 0.0])
    left = np.array([-ahead[1], ahead[0], 0.0])
    n = math.sqrt(1 - b * b) * ahead - b * left
    up = np.array([0.0, 0.0, 1.0])
    masses = plate.mass_of(not striker_is_a), plate.mass_of(striker_is_a)
    reduced = masses[0] * masses[1] / sum(masses)

    v = v0 * ahead
    w = np.cross(up, v) / radius
    normal = float(v @ n)
    surface = v - normal * n + radius * np.cross(w, n)
    j_n = (1 + plate.restitution(normal)) * normal * reduced * n
    j_t = 0.4 * plate.spin_transfer(v0) * 2 * reduced * surface
    turn = -2.5 / radius * np.cross(n, j_t)
    before = np.array([*(where - radius * n[:2]), *v[:2], 0.0, 0.0])
    rest = where + radius * n[:2]
    paths: list[list[Piece]] = [
        [(0.0, t_c, partial(_still, rest))],
        [_rolling(plate.under(striker_is_a), before, t_c, 0.0, masses[1])[0]],
    ]
    for ball, (mass, sign, place, came, span) in enumerate(
        ((masses[0], 1, rest, 0 * v, 0 * w), (masses[1], -1, before[:2], v, w))
    ):
        flat = came + sign * (j_n + j_t * np.array([1, 1, 0])) / mass
        spin = span + turn / mass
        u = (flat - radius * np.cross(spin, up))[:2]
        q = flat[:2] - 2 / 7 * u
        own = plate.under(striker_is_a == bool(ball))
        paths[ball] += _after(own, np.array([*place, *q, *u]), t_c, end, mass)
    return paths


def _still(place: Array, t: Array) -> Array:
    return np.repeat(place[:, None], len(t), axis=1)


def _first_two(solution: Any, t: Array) -> Array:
    return np.asarray(solution(t)[:2])


def _after(plate: Plate, state: Array, begin: float, end: float, mass: float) -> list[Piece]:
    """Sliding, if there is slip, then rolling, then rest."""
    pieces: list[Piece] = []
    if math.hypot(*state[4:]) > ENDED:

        def rates(t: float, s: Array) -> Array:
            u, v = s[4:], s[2:4] + 2 / 7 * s[4:]
            p = plate.push(s[:2], v, mass)
            rub = plate.friction(u) * plate.load(s[:2], v) / math.hypot(*u)
            return np.array([*v, *(5 / 7 * p), *(p - 3.5 * rub * u)])

        def over(t: float, s: Array) -> float:
            return math.hypot(*s[4:]) - ENDED

        over.terminal = True  # type: ignore[attr-defined]
        found = solve_ivp(rates, (begin, end), state, events=over, **HOW)
        pieces.append((begin, float(found.t[-1]), partial(_first_two, found.sol)))
        begin, state = float(found.t[-1]), found.y[:, -1]
    while begin < end:
        piece, state = _rolling(plate, state, begin, end, mass)
        pieces.append(piece)
        begin = piece[1]
        if begin < end:
            held = state[:2].copy()
            pieces.append((begin, end, partial(_still, held)))
            break
    return pieces


def _rolling(plate: Plate, state: Array, begin: float, end: float, mass: float) -> tuple[Piece, Array]:
    """A roll to `end`, which may lie before `begin`, or to the stop; and the last state."""

    def rates(t: float, s: Array) -> Array:
        speed = math.hypot(*s[2:])
        push = plate.push(s[:2], s[2:], mass)
        return np.array([*s[2:], *(5 / 7 * push - plate.loss(speed) / speed * s[2:])])

    def over(t: float, s: Array) -> float:
        return math.hypot(*s[2:]) - STOPPED

    over.terminal = True  # type: ignore[attr-defined]
    found = solve_ivp(rates, (begin, end), state[:4], events=over, **HOW)
    last = float(found.t[-1])
    piece: Piece = (min(begin, last), max(begin, last), partial(_first_two, found.sol))
    return piece, np.array([*found.y[:, -1], 0.0, 0.0])


def means(paths: list[list[Piece]], opens: Array, exposure: float) -> Array:
    """Places (2, frames, 2), m, averaged over exposures that open at these times, split at every kink."""
    nodes, weights = (GAUSS[0] + 1) / 2, GAUSS[1] / 2
    out = np.empty((2, len(opens), 2))
    for ball, pieces in enumerate(paths):
        kinks = np.array([p[1] for p in pieces[:-1]])
        times = opens[:, None] + exposure * nodes
        out[ball] = np.einsum("cfg,g->fc", _at(pieces, times), weights)
        for k in np.flatnonzero(((kinks > opens[:, None]) & (kinks < opens[:, None] + exposure)).any(axis=1)):
            inside = kinks[(kinks > opens[k]) & (kinks < opens[k] + exposure)]
            edges = np.array([opens[k], *inside, opens[k] + exposure])
            width = np.diff(edges)
            parts = _at(pieces, edges[:-1, None] + width[:, None] * nodes)
            out[ball, k] = np.einsum("csg,s,g->c", parts, width / exposure, weights)
    return out


def _at(pieces: list[Piece], times: Array) -> Array:
    flat = times.ravel()
    which = np.searchsorted([p[1] for p in pieces[:-1]], flat, side="left")
    out = np.empty((2, len(flat)))
    for k, (begin, end, places) in enumerate(pieces):
        here = which == k
        if here.any():
            out[:, here] = places(np.clip(flat[here], begin, end))
    return out.reshape(2, *times.shape)
