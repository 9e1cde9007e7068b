"""A smooth correction of the camera's map: displacements of positions on the plate, by their place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from synthcam_shared.arrays import Array

if TYPE_CHECKING:
    from scipy.interpolate import RectBivariateSpline


@dataclass(frozen=True, eq=False)
class Warp:
    """Displacements that turn the positions that K, dist, R and t give into those on the plate.

    x (m,) and y (n,) are knots, m, in increasing order; dx and dy (n, m) displacements at them, m. Between the knots
    splines of third order interpolate. Beyond them the displacement is that at the nearest point of their rectangle.
    errors: displacements (k, 2, n, m) at the knots by each of k independent standard errors, m. They are the same in
    all recordings.
    std: standard error of a displacement along either axis beside these, m.
    length: the way over which such an error lasts, m.
    """

    x: Array
    y: Array
    dx: Array
    dy: Array
    std: float = 0.0
    length: float = 0.0
    errors: Array = field(default_factory=lambda: np.zeros((0, 2, 0, 0)))

    @staticmethod
    def of(given: Any) -> Warp:
        """Read the key `warp` of camera.json. Raises ValueError, which says what was expected."""
        needed, errors = {"x", "y", "dx", "dy"}, {"std", "length"}
        if not isinstance(given, Mapping) or set(given) - errors - {"errors"} != needed:
            raise ValueError("a table with x, y, dx and dy")
        if set(given) & (errors | {"errors"}):
            known = [given.get(key) for key in sorted(errors)]
            if not all(isinstance(v, int | float) and not isinstance(v, bool) and 0 < v < np.inf for v in known):
                raise ValueError("std and length above 0, m, or none of them")
        try:
            x, y, dx, dy = (np.array(given[key], dtype=np.float64) for key in ("x", "y", "dx", "dy"))
        except (ValueError, TypeError):
            raise ValueError("numbers in x, y, dx and dy") from None
        min_knots, max_knots = 4, 64  # along an axis
        for name, knots in (("x", x), ("y", y)):
            if not (knots.ndim == 1 and min_knots <= len(knots) <= max_knots and (np.diff(knots) > 0).all()):
                raise ValueError(f"{min_knots} to {max_knots} knots {name} in increasing order, m")
        if not (dx.shape == dy.shape == (len(y), len(x)) and np.isfinite([dx, dy]).all()):
            raise ValueError(f"dx and dy of {len(y)} rows of {len(x)} numbers, one for each knot")
        maps = _read_maps(given.get("errors", []), (len(y), len(x)))
        warp = Warp(x, y, dx, dy, float(given.get("std", 0.0)), float(given.get("length", 0.0)), maps)
        at = np.stack(np.meshgrid(np.linspace(x[0], x[-1], 4 * len(x)), np.linspace(y[0], y[-1], 4 * len(y))), axis=-1)
        max_slope = 0.2  # change of a displacement along a way, over this way
        if not np.abs(warp.displace(at)[1]).max() < max_slope:
            raise ValueError(f"displacements that change by less than {max_slope:g} m over a metre")
        return warp

    def to_dict(self) -> dict[str, Any]:
        """The key of camera.json."""
        table = {"x": self.x.tolist(), "y": self.y.tolist(), "dx": self.dx.tolist(), "dy": self.dy.tolist()}
        errors = [{"dx": dx.tolist(), "dy": dy.tolist()} for dx, dy in self.errors]
        table |= {"std": self.std, "length": self.length} if self.std else {}
        return table | ({"errors": errors} if errors else {})

    @cached_property
    def error_maps(self) -> tuple[Warp, ...]:
        """The displacements by each of `errors`."""
        return tuple(Warp(self.x, self.y, dx, dy) for dx, dy in self.errors)

    @cached_property
    def _splines(self) -> tuple[RectBivariateSpline, RectBivariateSpline]:
        from scipy.interpolate import RectBivariateSpline  # takes a tenth of a second to import; few cameras need it

        one, other = (RectBivariateSpline(self.x, self.y, shift.T) for shift in (self.dx, self.dy))
        return one, other

    def displace(self, at: Array) -> tuple[Array, Array]:
        """Displacements (..., 2) of positions (..., 2), and their derivatives (..., 2, 2) by the positions."""
        x = np.clip(at[..., 0], self.x[0], self.x[-1])
        y = np.clip(at[..., 1], self.y[0], self.y[-1])
        inside = np.stack([x == at[..., 0], y == at[..., 1]], axis=-1)
        shift = np.stack([spline.ev(x, y) for spline in self._splines], axis=-1)
        slope = np.stack(
            [np.stack([spline.ev(x, y, dx=1), spline.ev(x, y, dy=1)], axis=-1) for spline in self._splines], axis=-2
        )
        return shift, np.asarray(slope * inside[..., None, :])

    def undo(self, at: Array) -> Array:
        """Find the positions that are displaced to `at` (..., 2)."""
        before = at.copy()
        for _ in range(60):  # contracts by the largest slope or better
            fresh = at - self.displace(before)[0]
            moved = float(np.max(np.abs(fresh - before), initial=0.0))
            before = fresh
            if moved < 1e-15:
                break
        return before


def _read_maps(given: Any, shape: tuple[int, int], most: int = 16) -> Array:
    """Read the key `errors` of a warp: (k, 2, n, m). Raises ValueError."""
    keys = {"dx", "dy"}
    rows = given if isinstance(given, list) else [None]
    if len(rows) > most or not all(isinstance(one, Mapping) and set(one) == keys for one in rows):
        raise ValueError(f"errors that are a list of at most {most} tables, each with dx and dy")
    try:
        maps = np.array([[one[key] for key in ("dx", "dy")] for one in rows if one], dtype=np.float64)
    except (ValueError, TypeError):
        maps = np.zeros(0)
    if rows and not (maps.shape == (len(rows), 2, *shape) and np.isfinite(maps).all()):
        raise ValueError(f"dx and dy of {shape[0]} rows of {shape[1]} numbers in each of errors, one for each knot")
    return maps if rows else np.zeros((0, 2, *shape))
