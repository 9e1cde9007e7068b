"""The result of an integration: states at any time, and mean positions over exposures.

The solution is a set of Chebyshev series in w, a root of the share of time left. For a slip that turns it is the cube
root. Towards the end such a slip turns as ln w, and the position has only terms as small as w^6 ln w. A mean is
the difference of two integrals over time, which are series in w again, since dt ~ w^2 dw.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from synthcam.dynamics.collocation import evaluate_series, make_matrices, multiply_on_nodes, resample_on_nodes
from synthcam.dynamics.kinematics import fly, plate_state
from synthcam.model import Bodies
from synthcam_shared.arrays import Array, Flags, Index, list_gauss_nodes

Pieces = Sequence[tuple[Array, Array]]


@dataclass(frozen=True)
class IntegratedMotion:
    """Motion of m balls from the times `begins` (m,) for `durations` (m,), s, which may be negative.

    pieces: times since `begins` (m, n), smooth images of n Chebyshev nodes, and y (c, m, n) there. y holds x, y, qx, qy
    and, where a ball slides, ux, uy, wz.
    """

    begins: Array
    durations: Array
    states: Array  # (m, 9), at the beginning
    bodies: Bodies
    gravity: float
    pieces: Pieces
    power: int  # of the root in w; 0 where the nodes are even in time
    airborne: Flags

    def __getitem__(self, rows: Index) -> Self:
        pieces = [(times[rows], y[:, rows]) for times, y in self.pieces]
        of = {f: getattr(self, f)[rows] for f in ("begins", "durations", "states", "bodies", "airborne")}
        return replace(self, pieces=pieces, **of)

    def shift(self, by: Array) -> Self:
        return replace(self, begins=self.begins + by)

    def split_pieces(self) -> tuple[Array, list[Self]]:
        """Return the times (p + 1, m) between pieces, and each piece as a motion where nodes are even in time."""
        if self.power or self.airborne.any() or len(self.pieces) == 1:
            return self.begins + np.array([0 * self.durations, self.durations]), [self]
        knots = self.begins + np.array([0 * self.durations, *(times[:, -1] for times, _ in self.pieces)])
        each = zip(knots[:-1], np.diff(knots, axis=0), self.pieces, strict=True)
        return knots, [replace(self, begins=t, durations=d, pieces=[(p[0] - p[0][:, :1], p[1])]) for t, d, p in each]

    def at(self, times: Array) -> Array:
        """Return states (m, k, 9) at times (m, k) within the motion."""
        elapsed = times - self.begins[:, None]
        return self._assemble_states(self._evaluate(self._series, elapsed), elapsed)

    def final_states(self) -> Array:
        """Return states (m, 9) at the end."""
        return self._assemble_states(self.pieces[-1][1][..., -1:], self.durations[:, None])[:, 0]

    def _assemble_states(self, y: Array, elapsed: Array) -> Array:
        x, q = np.moveaxis(y[:2], 0, -1), np.moveaxis(y[2:4], 0, -1)
        u, wz = (np.moveaxis(y[4:6], 0, -1), y[6]) if len(y) > 4 else (np.zeros(2), self.states[:, 8:])
        out = plate_state(x, q, u, wz, self.bodies.radius[:, None], self.bodies.inertia[:, None])
        if self.airborne.any():
            aloft = fly(self.states[self.airborne], self.gravity, elapsed[self.airborne])
            aloft[..., 0:2], aloft[..., 3:5] = x[self.airborne], q[self.airborne]
            out[self.airborne] = aloft
        return out

    def average_centres(self, middle: Array, wide: Any) -> Array:
        """Average the centres, (2, m, k), over spans of the width `wide`, a number or (m, k), about times (m, k)."""
        elapsed = middle - self.begins[:, None]
        if self.power == 0 and np.ndim(wide) == 0 and len(self.pieces) == 1:
            return self._average_even(elapsed, wide)
        if self.power == 0:
            return average_by_quadrature(lambda times: self._evaluate(self._position_series, times), elapsed, wide)
        # over so short a span a parabola is as good, and a difference of integrals would lose digits
        narrow = wide < 3e-4 * self.durations[:, None] + 0 * middle
        out = np.zeros((2, *middle.shape))
        if not narrow.all():
            a, b = (self._evaluate(self._time_integrals, elapsed + side * wide / 2) for side in (-1, 1))
            out = (b - a) * (self.durations[:, None] / np.where(narrow, 1.0, wide)) + self._midpoint
        if narrow.any():
            a, b = (self._evaluate(self._position_series, elapsed + side * wide / np.sqrt(12)) for side in (-1, 1))
            out = np.where(narrow, (a + b) / 2, out)
        return np.asarray(out)

    def _average_even(self, elapsed: Array, wide: float) -> Array:
        """Average by the Taylor series: the mean of f over x +- h is the sum of h^(2j)/(2j+1)! f^(2j)(x)."""
        c, negligible = self._position_series[0], 1e-16  # m; coefficients that for all balls together are smaller
        half = np.minimum(np.abs(wide / self.durations), 1.0)[:, None]  # a longer span would leave the motion
        worth = np.flatnonzero(_norms(c) > negligible).max(initial=1)
        term = mean = c[:, :, : worth + 1]
        curvature = make_matrices(term.shape[-1]).curvature
        for j in range(1, (term.shape[-1] + 1) // 2):
            term = multiply_on_nodes(term, curvature) * (half * half / (2 * j * (2 * j + 1)))
            mean = mean + term
            if _norms(term).max() < negligible:
                break
        return evaluate_series(mean, 2 * elapsed / self.durations[:, None] - 1)

    @cached_property
    def _knots(self) -> Array:
        """w where pieces end, (p + 1, m), falling from 1 to 0."""
        ends = (self._root_of_time_left(times[:, -1:])[:, 0] for times, _ in self.pieces)
        return np.array([1 + 0 * self.durations, *ends])

    @cached_property
    def _series(self) -> list[Array]:
        return self._fit_series(slice(None))

    @cached_property
    def _position_series(self) -> list[Array]:
        return self._fit_series(slice(0, 2))

    def _fit_series(self, part: slice) -> list[Array]:
        """Fit the coefficients in w of each piece, as many as its accuracy needs."""
        node_counts = 10, 16, 24, 40, 64  # tried in this order; the first piece begins with the second
        out: list[Array] = []
        for (times, y), first, last in zip(self.pieces, self._knots[:-1], self._knots[1:], strict=True):
            if self.power == 0:
                out.append(multiply_on_nodes(y[part], make_matrices(y.shape[-1]).coefficients))
                continue
            here = 2 * (first[:, None] - self._root_of_time_left(times)) / (first - last)[:, None] - 1
            limit = 3e-15 + 3e-16 * np.abs(y[part][:6]).max()
            for size in node_counts[len(out) == 0 :]:
                c = multiply_on_nodes(resample_on_nodes(y[part], here, size), make_matrices(size).coefficients)
                if np.abs(c[:6, :, -2:]).max() < limit:
                    break
            out.append(c)
        return out

    @property
    def _midpoint(self) -> Array:
        """Return the middle position, (2, m, 1): without it the integrals are smaller and lose fewer digits."""
        return np.asarray((self.pieces[0][1][:2, :, :1] + self.pieces[-1][1][:2, :, -1:]) / 2)

    @cached_property
    def _time_integrals(self) -> list[Array]:
        """Integrate position minus `_midpoint` over the share of time; coefficients of each piece."""
        sofar, out, knots = np.zeros_like(self._midpoint), [], self._knots[..., None]
        for c, first, last in zip(self._position_series, knots[:-1], knots[1:], strict=True):
            size, wide = c.shape[-1], first - last
            on = make_matrices(size + self.power)
            w = first - wide / 2 * (1 + on.nodes)
            place = multiply_on_nodes(c, on.values[:size]) - self._midpoint
            total = multiply_on_nodes(place * (self.power * w ** (self.power - 1) * wide / 2), on.integral) + sofar
            out.append(multiply_on_nodes(total, on.coefficients))
            sofar = total[..., -1:]
        return out

    def _evaluate(self, coefficients: Sequence[Array], elapsed: Array) -> Array:
        """Evaluate series at times (m, k) within the motion: (c, m, k)."""
        w = self._root_of_time_left(elapsed)
        out = np.empty((len(coefficients[0]), *w.shape))
        for k, c in enumerate(coefficients):
            a, b = self._knots[k, :, None], self._knots[k + 1, :, None]
            here = (w < a) | (k == 0)
            columns = np.flatnonzero(here.any(axis=0))
            if len(columns):
                part = slice(columns[0], columns[-1] + 1)
                found = evaluate_series(c, np.clip((a + b - 2 * w[:, part]) / (a - b), -1.0, 1.0))
                np.copyto(out[..., part], found, where=here[:, part])
        return out

    def _root_of_time_left(self, elapsed: Array) -> Array:
        left = 1 - np.clip(elapsed / self.durations[:, None], 0.0, 1.0)
        return np.asarray(np.cbrt(left) if self.power == 3 else left)


def _norms(coefficients: Array) -> Array:
    """Return roots of sums of squares, (c, m, n) to (n,), which bound every entry; a maximum takes numpy longer."""
    return np.asarray(np.sqrt(np.einsum("cmn,cmn->n", coefficients, coefficients)))


def average_by_quadrature(places: Callable[[Array], Array], middle: Array, wide: Any) -> Array:
    """Average integrated positions (2, m, times) over spans of the width `wide` about `middle`: (2, m, k)."""
    nodes, weights = list_gauss_nodes(4)  # exact for a parabola, 1e-15 m for a roll
    if np.ndim(wide) == 0 and wide == 0:
        return places(middle)
    times = middle[:, None] + nodes[:, None] * (np.asarray(wide) / 2 + 0 * middle)[:, None]
    found = places(times.reshape(len(middle), -1)).reshape(2, *times.shape)
    return np.asarray(np.tensordot(found, weights / 2, axes=(2, 0)))


def snap_to_goal(now: Array, goal: Array | float) -> Array:
    """Snap the end of an integrated motion to its goal where only rounding separates them."""
    return np.where(np.abs(now - goal) <= 1e-15 * (1 + np.abs(goal)), goal, now)
