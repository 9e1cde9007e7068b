"""Neighbour cells: which bodies come near a body, found without a look at all the others."""

import math
from array import array
from typing import NamedTuple, Self


class Box(NamedTuple):
    """A rectangle along the axes, m."""

    low_x: float
    low_y: float
    high_x: float
    high_y: float

    def meets(self, other: Self) -> bool:
        ax, ay, bx, by = other
        return self.low_x <= bx and self.high_x >= ax and self.low_y <= by and self.high_y >= ay


Cells = tuple[int, int, int, int]  # numbers of the first and the last, along x and y


class NeighbourCells:
    """Boxes of `count` bodies, each listed in all square cells of a grid that it covers. side: of a cell, m."""

    def __init__(self, side: float, count: int) -> None:
        self.side = side
        self.boxes = array("d", bytes(32 * count))  # of body k from 4 k on: side by side, they are in memory's reach
        self.covered: dict[int, Cells] = {}
        self.bodies: dict[tuple[int, int], set[int]] = {}  # in each cell

    def box_of(self, k: int) -> Box:
        return Box(*self.boxes[4 * k : 4 * k + 4])

    def cover(self, box: Box) -> Cells:
        """Return the cells that a box covers."""
        side = self.side
        low_x, low_y, high_x, high_y = box
        return math.floor(low_x / side), math.floor(low_y / side), math.floor(high_x / side), math.floor(high_y / side)

    def find_near(self, box: Box, cells: Cells) -> list[int]:
        """Return the bodies whose boxes meet a box. cells: those that it covers."""
        near, boxes = set[int](), self.boxes
        for cell in _list_cells(cells):
            if cell in self.bodies:
                near |= self.bodies[cell]
        low_x, low_y, high_x, high_y = box
        return [
            k
            for k in near
            if boxes[at := 4 * k] <= high_x
            and boxes[at + 2] >= low_x
            and boxes[at + 1] <= high_y
            and boxes[at + 3] >= low_y
        ]

    def put(self, k: int, box: Box, cells: Cells) -> None:
        """Put a body into the cells that its new box covers."""
        before = self.covered.get(k)
        self.boxes[4 * k : 4 * k + 4] = array("d", box)
        if cells == before:
            return
        for cell in _list_cells(before) if before else ():
            self.bodies[cell].remove(k)
            if not self.bodies[cell]:
                del self.bodies[cell]
        for cell in _list_cells(cells):
            self.bodies.setdefault(cell, set()).add(k)
        self.covered[k] = cells


def _list_cells(cells: Cells) -> list[tuple[int, int]]:
    x0, y0, x1, y1 = cells
    if x0 == x1 and y0 == y1:
        return [(x0, y0)]
    return [(x, y) for x in range(x0, x1 + 1) for y in range(y0, y1 + 1)]
