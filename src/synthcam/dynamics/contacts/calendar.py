"""The calendar of coming events: which contact, wall or end of a leg is next, with any number of balls.

Every ball has a leg, and a time up to which its coming contacts are known. For this it looks ahead along its leg, as
far as it comes near few other balls. When that time comes it looks ahead again. An event changes the legs of one or two
balls, and only their contacts are searched again. So the cost of an event hardly grows with the number of balls.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable, Sequence
from typing import Literal, NamedTuple

import numpy as np

from synthcam.dynamics.contacts.contact_time import OVERLAP_TOLERANCE, find_contact, find_wall_contact
from synthcam.dynamics.contacts.walls import Wall
from synthcam.dynamics.trajectory import Leg, Rest, Roll

MAX_NEIGHBOURS = 12  # that a ball may come near while it looks ahead
MAX_LOOK_S = 10.0
Kind = Literal["contact", "wall", "end", "launch", "renewal", "look"]


class Due(NamedTuple):
    """An event to come. Entries at one time are sorted by `order`: contacts, walls, then ends of legs."""

    t: float
    order: int
    kind: Kind
    i: int
    j: int
    versions: tuple[int, int]  # of the legs that it holds for


class ContactDistances:
    """How far apart two bodies are when they hit, over the sum of their radii: drawn for each contact.

    width: the standard deviation. The draws depend on the seed, the bodies and how often they have hit. They do not
    depend on the order of searches.
    """

    CUT_SIGMA = 4.0

    def __init__(self, width: float, seed: tuple[int, ...]) -> None:
        self.width, self.seed, self.largest = width, seed, self.CUT_SIGMA * width
        self.hits: dict[tuple[int, int], int] = {}
        self.drawn: dict[tuple[int, int], float] = {}

    def draw(self, i: int, j: int) -> float:
        pair = (min(i, j), max(i, j))
        if pair not in self.drawn:
            rng = np.random.default_rng((*self.seed, *pair, self.hits.get(pair, 0)))
            shift = float(np.clip(rng.standard_normal(), -self.CUT_SIGMA, self.CUT_SIGMA))
            self.drawn[pair] = 1 + self.width * shift
        return self.drawn[pair]

    def renew(self, i: int, j: int) -> None:
        """Forget the draw of two bodies that have hit."""
        pair = (min(i, j), max(i, j))
        self.hits[pair] = self.hits.get(pair, 0) + 1
        self.drawn.pop(pair, None)


class Calendar:
    """The coming events of balls of these radii, m, between these walls.

    Contacts are searched up to `end`, s, and beyond it once that time has come. distances: of contacts, where they are
    not the sums of the radii. Pairs in `joined` do not hit each other.
    """

    def __init__(
        self, radius: Sequence[float], walls: Sequence[Wall], end: float, distances: ContactDistances | None = None
    ) -> None:
        count = len(radius)
        self.radius, self.walls, self.end, self.distances = radius, walls, end, distances
        self.margin = max(OVERLAP_TOLERANCE, distances.largest if distances else 0.0)  # of a radius
        self.joined = set[tuple[int, int]]()
        self.legs: list[Leg] = []
        self.heap: list[Due] = []
        self.version, self.known, self.look = [0] * count, [0.0] * count, [MAX_LOOK_S] * count
        self.until, self.renewals = math.inf, 0
        self.sparse = count <= MAX_NEIGHBOURS + 1
        self.low, self.high = np.full((2, count), np.inf), np.full((2, count), -np.inf)  # of the balls' boxes, m

    def renew(self, legs: list[Leg], changed: Iterable[int], t: float, until: float) -> None:
        """Take new legs of some balls at the time t, s; all legs are to be renewed at `until`."""
        if not self.legs and not self.sparse:
            self._guess_looks(legs, t)
        self.legs, self.until, changed = legs, until, list(changed)
        if until < math.inf:
            self.renewals += 1
            heapq.heappush(self.heap, Due(until, 3, "renewal", -1, -1, (self.renewals, 0)))
        for k in changed:
            self.version[k] += 1
            if legs[k].t1 < math.inf:
                self._add(legs[k].t1, 2, "end", k)
        self._look_ahead(changed, t)

    def schedule(self, t: float, number: int) -> None:
        """Add the launch of this number at the time t, s."""
        self._add(t, 2, "launch", number)

    def forget_distance(self, i: int, j: int) -> None:
        """Let the next contact of two balls that have hit be at another distance."""
        if self.distances:
            self.distances.renew(i, j)

    def pop(self, horizon: float) -> Due | None:
        """Return the next event up to the horizon, s."""
        while self.heap and self.heap[0].t <= horizon:
            due = self.heap[0]
            if due.kind == "look" and due.t >= horizon:
                return None
            heapq.heappop(self.heap)
            if due.versions != self._versions(due.kind, due.i, due.j):
                continue
            if due.kind != "look":
                return due
            self._look_ahead([due.i], due.t)
        return None

    def _versions(self, kind: Kind, i: int, j: int) -> tuple[int, int]:
        if kind == "renewal":
            return self.renewals, 0
        if kind == "launch":
            return 0, 0
        return self.version[i], self.version[j] if kind == "contact" else 0

    def _add(self, t: float, order: int, kind: Kind, i: int, j: int = -1) -> None:
        heapq.heappush(self.heap, Due(t, order, kind, i, j, self._versions(kind, i, j)))

    def _look_ahead(self, balls: Sequence[int], t: float) -> None:
        """Find the contacts of these balls with all others, as far ahead as each looks."""
        latest = min(self.until, self.end if t < self.end else math.inf)
        for k in balls:
            self.known[k] = min(self._choose_horizon(k, t), latest)
        done = set[int]()
        for k in balls:
            leg, known = self.legs[k], self.known[k]
            still, first = isinstance(leg, Rest), leg.now(t)
            for j in self._neighbours(k):
                other = self.legs[j]
                if j == k or j in done or (still and isinstance(other, Rest)):
                    continue
                if self.joined and (min(k, j), max(k, j)) in self.joined:
                    continue
                horizon, reach = min(known, self.known[j]), self.radius[k] + self.radius[j]
                if self.distances:
                    reach = min(reach * self.distances.draw(k, j), math.dist(first[:3], other.now(t)[:3]))
                when = find_contact(leg, other, t, horizon, reach, first)
                if when is not None:
                    self._add(when, 0, "contact", min(k, j), max(k, j))
            done.add(k)
            if not still:
                self._add_walls(k, leg, t, known)
            if known < min(leg.t1, self.until):
                self._add(known, 4, "look", k)

    def _add_walls(self, k: int, leg: Leg, t: float, known: float) -> None:
        """Find the first wall that a ball touches."""
        first, number = known, -1
        for w, wall in enumerate(self.walls):
            when = find_wall_contact(leg, wall, t, first, self.radius[k])
            if when is not None and (when < first or number < 0):
                first, number = when, w
        if number >= 0:
            self._add(first, 1, "wall", k, number)

    def _choose_horizon(self, k: int, t: float) -> float:
        """Choose how far a ball looks ahead, so that it comes near few others; sets the box that it keeps within."""
        leg, look = self.legs[k], min(2 * self.look[k], MAX_LOOK_S)
        if self.sparse:
            return min(t + MAX_LOOK_S, leg.t1) if not isinstance(leg, Rest) else leg.t1
        while True:
            horizon = leg.t1 if isinstance(leg, Rest) else min(t + look, leg.t1)
            small = self._set_box(k, leg, t, horizon) < self.radius[k]  # to shrink it more would change little
            if small or isinstance(leg, Rest) or len(self._neighbours(k)) <= MAX_NEIGHBOURS:
                break
            look = (horizon - t) / 2
        self.look[k] = look
        return horizon

    def _set_box(self, k: int, leg: Leg, t: float, horizon: float) -> float:
        """Set the box that a ball keeps within until the horizon; returns by how much the path widens it, m."""
        one, two = leg.now(t), leg.now(horizon) if horizon < math.inf else leg.now(t)
        margin = self.radius[k] * (1 + self.margin)
        if not isinstance(leg, Rest | Roll):  # these paths are straight
            margin += leg.bound(t) * (horizon - t) ** 2 / 8
        for axis in (0, 1):
            self.low[axis, k] = min(one[axis], two[axis]) - margin
            self.high[axis, k] = max(one[axis], two[axis]) + margin
        return float(max(abs(one[0] - two[0]), abs(one[1] - two[1])) + margin - self.radius[k])

    def _neighbours(self, k: int) -> Sequence[int]:
        """Return the balls whose boxes overlap with that of ball k, itself among them."""
        if self.sparse:
            return range(len(self.radius))
        (lx, ly), (hx, hy) = self.low, self.high
        near = (lx <= hx[k]) & (hx >= lx[k]) & (ly <= hy[k]) & (hy >= ly[k])
        return [int(j) for j in np.flatnonzero(near)]

    def _guess_looks(self, legs: Sequence[Leg], t: float) -> None:
        """Guess how far balls look ahead at first: twice their mean distance."""
        states = np.array([leg.now(t)[:5] for leg in legs])
        wide = np.ptp(states[:, :2], axis=0) + 2 * max(self.radius)
        apart = 2 * math.sqrt(wide[0] * wide[1] / len(legs))
        self.look = np.minimum(apart / np.maximum(np.hypot(states[:, 3], states[:, 4]), 1e-9), MAX_LOOK_S).tolist()
