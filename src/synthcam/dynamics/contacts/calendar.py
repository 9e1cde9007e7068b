"""The calendar of coming events: which contact, wall or end of a leg is next, with any number of balls.

Every ball has a leg, and a time up to which its coming contacts are known. For this it looks ahead along its leg, as
far as it comes near few other balls. When that time comes it looks ahead again. An event changes the legs of one or two
balls, and only their contacts are searched again. So the cost of an event hardly grows with the number of balls.
"""

import heapq
import math
from collections.abc import Iterable, Sequence
from typing import Literal

import numpy as np

from synthcam.dynamics.contacts.cells import Box, NeighbourCells
from synthcam.dynamics.contacts.contact_time import OVERLAP_TOLERANCE, find_contact_time, find_wall_contact
from synthcam.dynamics.contacts.walls import Wall
from synthcam.dynamics.kinematics import State
from synthcam.dynamics.trajectory import Leg, RestLeg, RollLeg, SlideLeg

WITHOUT_CELLS = 13  # balls: so few look at all others
MAX_LOOK_S = 10.0
Kind = Literal["contact", "wall", "end", "launch", "renewal", "look"]


# An event to come: its time, a rank, what it is, bodies i and j, and the versions of their legs that it holds for. A
# plain tuple is made and compared fastest. Contacts come first among events at one time, then walls, then ends of legs.
Due = tuple[float, int, Kind, int, int, int, int]


class EventQueue:
    """Coming events, soonest first. Those of a later span of time wait unsorted: many bodies have many of them.

    width: of a span of time, s.
    """

    def __init__(self, width: float = math.inf) -> None:
        self.width = width
        self.present = math.inf if width == math.inf else -math.inf  # number of the span whose events are sorted
        self.sorted: list[Due] = []
        self.later: dict[float, list[Due]] = {}  # by the numbers of spans
        self.numbers: list[float] = []

    def push(self, due: Due) -> None:
        number = due[0] // self.width
        if number <= self.present:
            heapq.heappush(self.sorted, due)
        elif number in self.later:
            self.later[number].append(due)
        else:
            self.later[number] = [due]
            heapq.heappush(self.numbers, number)

    def find_first(self) -> Due | None:
        while not self.sorted:
            if not self.numbers:
                return None
            self.present = heapq.heappop(self.numbers)
            self.sorted = self.later.pop(self.present)
            heapq.heapify(self.sorted)
        return self.sorted[0]

    def drop_first(self) -> None:
        heapq.heappop(self.sorted)


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


class EventCalendar:
    """The coming events of balls of these radii, m, between these walls.

    Contacts are searched up to `end`, s, and beyond it once that time has come. distances: of contacts, where they are
    not the sums of the radii. Pairs in `joined` do not hit each other.
    """

    def __init__(
        self, radius: Sequence[float], walls: Sequence[Wall], end: float, distances: ContactDistances | None = None
    ) -> None:
        count = len(radius)
        self.balls: Sequence[int] = range(count)
        self.radius, self.walls, self.end, self.distances = radius, walls, end, distances
        self.margin = max(OVERLAP_TOLERANCE, distances.largest if distances else 0.0)  # of a radius
        self.joined: set[tuple[int, int]] = set()
        self.legs: list[Leg] = []
        self.queue = EventQueue()
        self.version, self.known, self.look = [0] * count, [0.0] * count, [MAX_LOOK_S] * count
        self.until, self.renewals = math.inf, 0
        self.cells: NeighbourCells | None = None  # few balls do without
        self.wall_boxes = [Box(*wall.box) for wall in walls]

    def renew(self, legs: list[Leg], changed: Iterable[int], t: float, until: float) -> None:
        """Take new legs of some balls at the time t, s; all legs are to be renewed at `until`."""
        if not self.legs and len(legs) > WITHOUT_CELLS:
            self.cells = self._make_cells(legs, t)
        self.legs, self.until, changed = legs, until, list(changed)
        if until < math.inf:
            self.renewals += 1
            self.queue.push((until, 3, "renewal", -1, -1, self.renewals, 0))
        for k in changed:
            self.version[k] += 1
        self._look_ahead(changed, t)

    def schedule(self, t: float, number: int) -> None:
        """Add the launch of this number at the time t, s."""
        self.queue.push((t, 2, "launch", number, -1, 0, 0))

    def pop(self, horizon: float) -> Due | None:
        """Return the next event up to the horizon, s."""
        queue, version = self.queue, self.version
        while (due := queue.find_first()) is not None:
            t, _, kind, i, j, version_i, version_j = due
            if t > horizon or (kind == "look" and t >= horizon):
                return None
            queue.drop_first()
            if kind == "renewal":
                current = version_i == self.renewals
            else:
                current = kind == "launch" or version_i == version[i]
                current = current and (kind != "contact" or version_j == version[j])
            if not current:
                continue
            if kind != "look":
                return due
            self._look_ahead([i], t)
        return None

    def _look_ahead(self, balls: Sequence[int], t: float) -> None:
        """Find the contacts of these balls with all others, as far ahead as each looks."""
        latest = min(self.until, self.end) if t < self.end else self.until
        version, legs, radii, known_until, queue = self.version, self.legs, self.radius, self.known, self.queue
        joined, distances = self.joined, self.distances
        waiting = set(balls)  # these will find the pairs that they make with those before them
        for k in balls:
            waiting.remove(k)
            leg, radius = legs[k], radii[k]
            still = type(leg) is RestLeg
            # the first state of a leg is known, but for the signs of zeros
            first = leg.state if isinstance(leg, (RollLeg, SlideLeg)) and leg.time == t else leg.now(t)
            if self.cells is None:
                horizon, near = leg.t1 if still or leg.t1 < t + MAX_LOOK_S else t + MAX_LOOK_S, self.balls
            else:
                horizon, near = self._choose_horizon(k, t, first, self.cells)
            known = known_until[k] = horizon if horizon < latest else latest
            for j in near:
                other = legs[j]
                if j == k or j in waiting or (still and type(other) is RestLeg):
                    continue
                if joined and (min(k, j), max(k, j)) in joined:
                    continue
                reach = radius + radii[j]
                if distances:
                    reach = min(reach * distances.draw(k, j), math.dist(first[:3], other.now(t)[:3]))
                when = find_contact_time(leg, other, t, min(known, known_until[j]), reach, first)
                if when is not None:
                    one, two = (k, j) if k < j else (j, k)
                    queue.push((when, 0, "contact", one, two, version[one], version[two]))
            if self.walls and not still:
                self._add_walls(k, leg, t, known)
            if known < leg.t1 and known < self.until:
                queue.push((known, 4, "look", k, -1, version[k], 0))
            elif leg.t1 < math.inf:
                queue.push((leg.t1, 2, "end", k, -1, version[k], 0))

    def _add_walls(self, k: int, leg: Leg, t: float, known: float) -> None:
        """Find the first wall that a ball touches."""
        first, number = known, -1
        box = self.cells and self.cells.box_of(k)
        for w, wall in enumerate(self.walls):
            if box and not box.meets(self.wall_boxes[w]):
                continue
            when = find_wall_contact(leg, wall, t, first, self.radius[k])
            if when is not None and (when < first or number < 0):
                first, number = when, w
        if number >= 0:
            self.queue.push((first, 1, "wall", k, number, self.version[k], 0))

    def _choose_horizon(self, k: int, t: float, first: State, cells: NeighbourCells) -> tuple[float, Sequence[int]]:
        """Choose how far a ball looks ahead, so that it comes near few others; also return which. first: its state."""
        leg, look = self.legs[k], self.look[k]
        if type(leg) is RestLeg:
            box, _ = self._bound_path(k, leg, t, t, first)
            covered = cells.cover(box)
            cells.put(k, box, covered)
            return leg.t1, cells.find_near(box, covered)
        max_neighbours, max_cells = 8, 16  # that it may come near
        while True:
            horizon = min(t + look, leg.t1)
            box, widens = self._bound_path(k, leg, t, horizon, first)
            small = widens < self.radius[k]  # to shrink it more would change little
            x0, y0, x1, y1 = covered = cells.cover(box)
            if small or (x1 - x0 + 1) * (y1 - y0 + 1) <= max_cells:
                near = cells.find_near(box, covered)
                if small or len(near) <= max_neighbours:
                    break
            look = (horizon - t) / 2
        few = 5  # neighbours, with which it looks twice as far the next time
        self.look[k] = min(2 * look, MAX_LOOK_S) if len(near) <= few else look
        cells.put(k, box, covered)
        return horizon, near

    def _bound_path(self, k: int, leg: Leg, t: float, horizon: float, first: State) -> tuple[Box, float]:
        """Return the box that a ball keeps within until the horizon, and by how much the path widens it, m."""
        x, y = first[:2]
        there_x, there_y, *_ = leg.now(horizon) if horizon > t else first
        wide = margin = self.radius[k] * (1 + self.margin)
        if not leg.is_straight:
            margin += leg.bound(t) * (horizon - t) ** 2 / 8
        low_x, high_x = (x, there_x) if x < there_x else (there_x, x)
        low_y, high_y = (y, there_y) if y < there_y else (there_y, y)
        box = Box(low_x - margin, low_y - margin, high_x + margin, high_y + margin)
        return box, max(high_x - low_x, high_y - low_y) + margin - wide

    def _make_cells(self, legs: Sequence[Leg], t: float) -> NeighbourCells:
        """Make cells as wide as balls are apart, with all balls where they are; guess how far they look at first."""
        from scipy.spatial import cKDTree  # here alone: slow to load

        states = np.array([leg.now(t)[:5] for leg in legs])
        nearest = np.asarray(cKDTree(states[:, :2]).query(states[:, :2], 2)[0])
        side = 2 * max(float(np.median(nearest[:, 1])), 2 * float(np.median(self.radius)))
        self.look = np.minimum(side / np.maximum(np.hypot(states[:, 3], states[:, 4]), 1e-9), MAX_LOOK_S).tolist()
        sorted_events = 64  # about so many at a time
        self.queue = EventQueue(sorted_events * float(np.median(self.look)) / len(legs))
        cells = NeighbourCells(side, len(legs))
        for k, (x, y) in enumerate(states[:, :2].tolist()):
            wide = self.radius[k] * (1 + self.margin)
            box = Box(x - wide, y - wide, x + wide, y + wide)
            cells.put(k, box, cells.cover(box))
        return cells
