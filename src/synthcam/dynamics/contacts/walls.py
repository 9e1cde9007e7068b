"""Walls: straight segments and circular rims, and when a ball reaches them."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal

from synthcam.dynamics.kinematics import State


@dataclass(frozen=True)
class Wall(ABC):
    """A wall that does not move, as high as anything that meets it."""

    restitution: float = 1.0  # e: a ball that comes at v_n along the normal leaves at e v_n
    friction: float = 0.0  # Coulomb's coefficient
    tangential_restitution: float = 0.0  # beta: where the contact sticks, the surface that came at u leaves at -beta u
    height: float | None = None  # above the plate, m, at which it touches balls, as a cushion's nose; None: centrally
    # The law of the impact: in one step, or with directions of slip that change, and without tangential_restitution.
    cushion: Literal["han", "mathavan"] = "han"

    @property
    @abstractmethod
    def box(self) -> tuple[float, float, float, float]:
        """Low x, low y, high x and high y, m, of a rectangle that a body must touch to touch the wall."""

    @abstractmethod
    def distance(self, x: float, y: float) -> tuple[float, float, float]:
        """Return how far a point is from the wall, m, and the unit vector (nx, ny) from the wall to it."""

    def rise(self, radius: float) -> float:
        """Return by how much the wall touches a ball above its centre, over its radius."""
        return 0.0 if self.height is None else self.height / radius - 1

    def reach(self, radius: float) -> float:
        """Return how far the centre of a ball is from the wall when they touch, seen from above, m."""
        return radius * math.sqrt(1 - self.rise(radius) ** 2)

    def time_to_close(self, ball: State, gap: float, rate: float, steepest: float) -> float:
        """Return a time, s, in which a gap, m, that changes at a rate, m/s, cannot close. steepest: see `Leg.bound`."""
        return time_to_close(gap, rate, steepest)


@dataclass(frozen=True)
class WallImpact:
    """The outcome of an impact on a wall."""

    after: State
    n: tuple[float, float]  # unit vector from the wall to the ball, seen from above
    impulse_n: float  # along the normal, N s
    impulse_t: float  # along z x n, N s


@dataclass(frozen=True)
class StraightWall(Wall):
    """A straight wall between two points, m. A ball may touch either side, or an end."""

    start: tuple[float, float] = (0.0, 0.0)
    end: tuple[float, float] = (1.0, 0.0)

    @property
    def box(self) -> tuple[float, float, float, float]:
        (ax, ay), (bx, by) = self.start, self.end
        return min(ax, bx), min(ay, by), max(ax, bx), max(ay, by)

    def distance(self, x: float, y: float) -> tuple[float, float, float]:
        (ax, ay), (bx, by) = self.start, self.end
        dx, dy = bx - ax, by - ay
        along = ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy)
        along = min(max(along, 0.0), 1.0)
        return _from_point(x - ax - along * dx, y - ay - along * dy)


@dataclass(frozen=True)
class Rim(Wall):
    """A circular wall about a point, m, with the balls inside, or outside as those about a post."""

    centre: tuple[float, float] = (0.0, 0.0)
    radius: float = 1.0
    inside: bool = True

    @property
    def box(self) -> tuple[float, float, float, float]:
        (x, y), far = self.centre, math.inf if self.inside else self.radius
        return x - far, y - far, x + far, y + far

    def distance(self, x: float, y: float) -> tuple[float, float, float]:
        far, nx, ny = _from_point(x - self.centre[0], y - self.centre[1])
        return (self.radius - far, -nx, -ny) if self.inside else (far - self.radius, nx, ny)

    def time_to_close(self, ball: State, gap: float, rate: float, steepest: float) -> float:
        """See `Wall.time_to_close`: inside, a straight path comes ever faster to the rim, so the gap is not convex."""
        if not self.inside:
            return time_to_close(gap, rate, steepest)
        speed2 = float(ball[3] ** 2 + ball[4] ** 2)
        x, y = ball[0] - self.centre[0], ball[1] - self.centre[1]
        outward, far2 = float(x * ball[3] + y * ball[4]), float(x * x + y * y)
        top2 = (math.sqrt(far2) + gap) ** 2  # of the circle on which the centre is when they touch
        if speed2 == 0:
            return math.sqrt(2 * gap / steepest) if steepest > 0 else math.inf
        root = math.sqrt(outward * outward + speed2 * max(top2 - far2, 0.0))
        step = (root - outward) / speed2 if outward <= 0 else max(top2 - far2, 0.0) / (root + outward)
        while steepest > 0:  # until the path stays inside although it bends
            there2 = far2 + step * (2 * outward + step * speed2)
            if math.sqrt(max(there2, 0.0)) + steepest * step * step / 2 <= math.sqrt(top2) or step < 1e-15:
                break
            step *= 0.5
        return step


def _from_point(x: float, y: float) -> tuple[float, float, float]:
    far = math.sqrt(x * x + y * y)
    return (far, x / far, y / far) if far > 0 else (0.0, 1.0, 0.0)


def time_to_close(gap: float, rate: float, steepest: float) -> float:
    """Find the least time to reach a wall: the positive root s of gap + rate s - steepest s^2/2 = 0."""
    if steepest == 0:
        return gap / -rate if rate < 0 else math.inf
    root = math.sqrt(rate * rate + 2 * steepest * gap)
    return (rate + root) / steepest if rate > 0 else 2 * gap / (root - rate)
