"""Slips of the contacts of a crowd, from the spins that all contacts of a film leave.

A plain ball does not show its spin on film. But what happens to it does:

- Each contact shows the tangential impulse J. It changes the spin of both balls by J / (2/5 m R) against the slip. The
  plate hardly changes the spin about the vertical, which is zero at the start.
- A straight wall is a line on which centres lie at their hits. The part of a kick along that line is the friction of
  the wall. Other walls, and contacts without a local estimate, change the spin by an unknown amount.
- A kick does not change the rotation about horizontal axes. So the lowest point of the ball slides until friction with
  the plate makes the ball roll again. Until then the surface does not move down as fast as that of a rolling ball.

Friction can at most stop the surfaces. A larger impulse comes from a third body. Then the spins are not known either.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from synthcam_shared.arrays import Array, Flags
from tracker.gas.hidden_slides import USUAL_FRICTION as USUAL_DECELERATION

PER_IMPULSE, PER_IMPULSE_OF_DISC = 2.5, 2.0  # change of R times the spin, over J/m
USUAL_FRICTION = 0.15  # of steel, glass and plastic, on one another and on a wall
USUAL_RESTITUTION = 0.8  # of a wall
MAX_FRICTION = 2 * USUAL_FRICTION  # of a wall; beyond it a third body is more likely
MIN_CONTACTS = 8  # that show how large the friction of the others is
MIN_HITS_OF_A_WALL = 4
WALL_TOLERANCE = 0.02  # of the diameter: distance of a hit from the line of a wall
AXES = ("1i", "2i", "1o", "2o")  # struck and striking ball, before and after the contact
GRAVITY = 9.81


@dataclass(frozen=True)
class Slip:
    """The slip of a contact just before it, and the impulse that followed, both with the sign of the velocity across.

    across: m/s, of the surfaces along the tangent in the plane.
    down: m/s, along the vertical.
    friction: tangential over normal impulse.

    NAME_std are standard errors.
    """

    across: float
    across_std: float
    down: float
    down_std: float
    friction: float
    friction_std: float

    @property
    def size(self) -> float:
        """With both parts, m/s."""
        return float(np.hypot(self.across, self.down))


@dataclass
class _Ball:
    """The rotation of a ball, as far as it is known.

    turning: R times the spin about the vertical, m/s. errors: of it, by the event that they come from.
    sliding: (2,) velocity of the lowest point, m/s, and the standard error of a component, at a time in s.
    """

    turning: float = 0.0
    errors: dict[int, float] = field(default_factory=dict)
    sliding: Array = field(default_factory=lambda: np.zeros(2))
    sliding_std: float = 0.0
    time: float = 0.0

    def roll(self, time: float, deceleration: float) -> None:
        """Let it slide on the plate until a time: its lowest point slows down by 7/2 of the deceleration."""
        size, slower = float(np.hypot(*self.sliding)), 3.5 * deceleration * (time - self.time)
        if slower >= size + self.sliding_std:
            self.sliding_std = 0.0
        self.sliding = self.sliding * (max(size - slower, 0.0) / max(size, 1e-12))
        self.time = time

    def turn(self, event: int, change: float, std: float) -> None:
        """Change the spin about the vertical."""
        self.turning += change
        self.errors[event] = std

    def push(self, kick: Array, std: float) -> None:
        """Change the velocity (2,) of the lowest point."""
        self.sliding = self.sliding + kick
        self.sliding_std = float(np.hypot(self.sliding_std, std))


@dataclass(frozen=True)
class _Impact:
    """A measured contact: velocities (4, 2) as in AXES, and what follows from them and the line of centres.

    normal: (2,) from the striking to the struck ball. across: with its sign, m/s. along, along_impulse: m/s.
    impulse: along the tangent, over m, on the struck ball. Each has its standard error as name_std.
    """

    velocities: Array
    velocity_std: float
    normal: Array
    across: float
    across_std: float
    along_impulse: float
    impulse: float
    impulse_std: float
    friction: float
    friction_std: float
    sign: float

    @classmethod
    def of(cls, row: Mapping[Any, Any]) -> _Impact:
        v0, b, r = (float(row[f"{name}_local"]) for name in ("v0", "b", "r"))
        v0_std, b_std, r_std = (float(row[f"{name}_local_std"]) for name in ("v0", "b", "r"))
        velocities = np.array([[float(row[f"v{k}{axis}_local"]) for axis in "xy"] for k in AXES])
        errors = np.array([[float(row[f"v{k}{axis}_local_std"]) for axis in "xy"] for k in AXES])
        into1, into2, out1, out2 = velocities
        heading = (into2 - into1) / np.hypot(*(into2 - into1))
        cosine = float(np.sqrt(max(1 - b * b, 1e-6)))
        normal = cosine * heading + b * np.array([heading[1], -heading[0]])
        impulse = float(np.array([-normal[1], normal[0]]) @ ((out1 - into1) - (out2 - into2))) / 2
        noise = float(np.sqrt((errors**2).sum() / 2)) / 2
        along_impulse = (1 + r) / 2 * v0 * cosine
        impulse_std = float(np.hypot(noise, (1 + r) / 2 * v0 * b_std))
        return cls(
            velocities=velocities,
            velocity_std=float(np.sqrt((errors[:2] ** 2).sum() / 2)),
            normal=normal,
            across=v0 * b,
            across_std=float(np.hypot(v0_std * b, v0 * b_std)),
            along_impulse=along_impulse,
            impulse=impulse,
            impulse_std=impulse_std,
            friction=impulse / along_impulse,
            friction_std=float(np.hypot(impulse_std, impulse * r_std / (1 + r)) / along_impulse),
            sign=1.0 if b >= 0 else -1.0,
        )


def trace_slips(
    rows: Iterable[Mapping[Any, Any]], contacts: pd.DataFrame, diameter: float | None = None
) -> dict[int, Slip]:
    """Trace the slips of the contacts of one film of a crowd by the number of their collision.

    Both balls share the error of their impulse, so it counts twice if they meet again.

    rows: the estimates of the film. contacts: the columns of contacts.parquet. diameter: m, None if it is not known.
    """
    return _Trace(rows, contacts, diameter).follow()


class _Trace:
    """The rotation of all balls of a film, event by event."""

    def __init__(self, rows: Iterable[Mapping[Any, Any]], contacts: pd.DataFrame, diameter: float | None) -> None:
        by_number = {int(row["collision"]): row for row in rows}
        self.events = contacts.sort_values("t_s").to_dict("records")
        self.impacts = {number: _Impact.of(row) for number, row in by_number.items() if _is_measured(row)}
        self.misfits = {number for number, row in by_number.items() if bool(row.get("misfit_local", False))}
        self.struck = {number: row.get("particle1") for number, row in by_number.items()}
        self.glides = any(row.get("motion_local") == "glide" for row in by_number.values())
        self.per_impulse = PER_IMPULSE_OF_DISC if self.glides else PER_IMPULSE
        self.normals = find_wall_normals(contacts, diameter) if diameter else {}
        friction = contacts["mu_k"].median() if "mu_k" in contacts else np.nan
        self.deceleration = GRAVITY * float(friction) if np.isfinite(friction) else USUAL_DECELERATION
        usual = [each.friction for each in self.impacts.values() if abs(each.friction) < MAX_FRICTION]
        self.friction = float(np.sqrt(np.mean(np.square(usual)))) if len(usual) >= MIN_CONTACTS else USUAL_FRICTION
        self.balls = dict[int, _Ball]()
        self.slips = dict[int, Slip]()

    def follow(self) -> dict[int, Slip]:
        """Follow all events in turn."""
        for number, event in enumerate(self.events):
            names = [int(event[name]) for name in ("particle1", "particle2") if int(event[name]) >= 0]
            balls = [self.balls.setdefault(name, _Ball()) for name in names]
            for ball in balls:
                ball.roll(float(event["t_s"]), self.deceleration)
            collision = int(event["collision"])
            if len(balls) == 1:
                self._hit_wall(number, event, balls[0])
            elif collision in self.impacts:
                first = self.struck[collision] in (None, names[0])
                self._meet(number, collision, balls if first else balls[::-1])
            else:
                kick = float(event["kick"]) * np.array([event["nx"], event["ny"]])
                self._leave_unknown(number, balls, kick, self.friction)
        return self.slips

    def _hit_wall(self, number: int, event: Mapping[Any, Any], ball: _Ball) -> None:
        size, along = float(event["kick"]), np.array([event["nx"], event["ny"]], dtype=np.float64)
        normal, angle = self.normals.get(number, (along, USUAL_FRICTION))
        share = float(along @ np.array([-normal[1], normal[0]]))  # of the kick that is friction
        if number in self.normals and abs(share) < MAX_FRICTION:
            std = float(np.hypot(float(event["kick_std"]), size * angle))
            ball.turn(number, -self.per_impulse * size * share, self.per_impulse * std)
        else:
            ball.turn(number, 0.0, self.per_impulse * size * USUAL_FRICTION)
        down = -size / (1 + USUAL_RESTITUTION) - float(ball.sliding @ normal)
        self._rub_down(ball, size * along, down * normal, 2 / 7 * abs(down), USUAL_FRICTION * size)

    def _rub_down(self, ball: _Ball, kick: Array, down: Array, sticks: float, slips: float) -> None:
        """Push a ball whose surface moves down; friction against that has at most either impulse over m."""
        size = float(np.hypot(*down))
        change = 0.0 if self.glides else PER_IMPULSE * min(sticks, slips)
        ball.push(kick + change / max(size, 1e-12) * down, change / 2)

    def _leave_unknown(self, number: int, balls: list[_Ball], kick: Array, friction: float) -> None:
        std = friction * float(np.hypot(*kick))
        for ball, sign in zip(balls, (1, -1), strict=True):
            ball.turn(number, 0.0, self.per_impulse * std)
            ball.push(sign * kick, PER_IMPULSE * std)

    def _meet(self, number: int, collision: int, balls: list[_Ball]) -> None:
        """Let the struck and the striking ball meet."""
        impact = self.impacts[collision]
        into1, into2, out1, out2 = impact.velocities
        shared = set().union(*(ball.errors for ball in balls))
        variance = sum(sum(ball.errors.get(k, 0.0) for ball in balls) ** 2 for k in shared)
        rolled = into1 + into2 - balls[0].sliding - balls[1].sliding
        down = 0.0 if self.glides else float(rolled @ impact.normal)
        down_std = float(np.linalg.norm([impact.velocity_std, *(ball.sliding_std for ball in balls)]))
        self.slips[collision] = Slip(
            across=impact.sign * (impact.across + sum(ball.turning for ball in balls)),
            across_std=float(np.hypot(np.sqrt(variance), impact.across_std)),
            down=down,
            down_std=0.0 if self.glides else down_std,
            friction=impact.sign * impact.friction,
            friction_std=impact.friction_std,
        )
        if collision in self.misfits or self._stops_more(impact, self.slips[collision]):
            self._leave_unknown(number, balls, out1 - into1, USUAL_FRICTION)
            return
        usual = USUAL_FRICTION * impact.along_impulse
        known = usual**2 / (usual**2 + impact.impulse_std**2)  # the friction is usual where the tracks hardly show it
        for ball, kick in zip(balls, (out1 - into1, out2 - into2), strict=True):
            std = self.per_impulse * impact.impulse_std * float(np.sqrt(known))
            ball.turn(number, -self.per_impulse * impact.impulse * known, std)
            self._rub_down(ball, kick, down * impact.normal, abs(down) / 7, self.friction * impact.along_impulse)

    def _stops_more(self, impact: _Impact, slip: Slip) -> bool:
        """Decide whether friction would have to stop more than the slip, which shows a third body."""
        sticks = (abs(slip.across) + 3 * slip.across_std) / (2 * (1 + self.per_impulse))
        return abs(impact.impulse) > sticks + 3 * impact.impulse_std


def find_wall_normals(contacts: pd.DataFrame, diameter: float) -> dict[int, tuple[Array, float]]:
    """Find the walls on which at least four hits lie in a line: the normal (2,) into the tray and its error, rad.

    The keys are the numbers of hits in the order of time.
    """
    sorted_ = contacts.sort_values("t_s")
    numbers = np.flatnonzero(sorted_["particle2"].to_numpy() < 0)
    place, kick = (sorted_[list(names)].to_numpy(dtype=np.float64)[numbers] for names in (("x", "y"), ("nx", "ny")))
    found = dict[int, tuple[Array, float]]()
    for k, number in enumerate(numbers.tolist()):
        lines = [_find_hits(place, kick, k, j, diameter) for j in range(len(numbers)) if j != k]
        best = max(lines, key=np.count_nonzero, default=np.zeros(0, dtype=bool))
        if np.count_nonzero(best) >= MIN_HITS_OF_A_WALL:
            found[number] = _fit_wall(place[best], kick[k], diameter)
    return found


def _find_hits(place: Array, kick: Array, first: int, second: int, diameter: float) -> Flags:
    """Find the hits (n,) on the line through two of them, along which the kick of the first is small."""
    min_distance, min_cosine = 4 * diameter, 0.9  # nearer hits on a round wall lie in a line too
    line = place[second] - place[first]
    normal = np.array([-line[1], line[0]]) / max(float(np.hypot(*line)), 1e-12)
    normal = normal * (1.0 if normal @ kick[first] >= 0 else -1.0)
    if np.hypot(*line) < min_distance or normal @ kick[first] < min_cosine:
        return np.zeros(len(place), dtype=bool)
    near = np.abs((place - place[first]) @ normal) < WALL_TOLERANCE * diameter
    return np.asarray(near & (kick @ normal > min_cosine))


def _fit_wall(place: Array, kick: Array, diameter: float) -> tuple[Array, float]:
    _, (length, width), axes = np.linalg.svd(place - place.mean(axis=0))
    normal = axes[1] * (1.0 if axes[1] @ kick >= 0 else -1.0)
    off = max(float(width) / np.sqrt(len(place) - 2), 0.1 * WALL_TOLERANCE * diameter)
    return normal, off / float(length)


def _is_measured(row: Mapping[Any, Any]) -> bool:
    names = ("v0_local", "b_local", "r_local", *(f"v{k}{axis}_local" for k in AXES for axis in "xy"))
    return all(np.isfinite([row[name], row[f"{name}_std"]]).all() for name in names)
