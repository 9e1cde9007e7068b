"""Velocities just after contacts whose slides are too short to be seen, by the friction that all paths of a film show.

A contact makes the lowest point of a ball slide, and the friction of the plate acts against that slip until the ball
rolls. The slip follows from the change of the velocity and from one more number: the share of the relative speed of the
surfaces that a contact gives to the spins. All paths of a film together show this share and the friction.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import OptimizeResult, minimize

from synthcam_shared.arrays import Array, Flags

ROWS = 10  # of a path, which are fitted
MAX_CHI2_PER_DOF = 4.0  # of a path on which nothing else happens
USUAL_FRICTION = 2.0  # m/s^2, deceleration of a ball that slides
_SPIN_TRANSFER, _SPIN_TRANSFER_STD = 0.25, 0.1  # before the film shows it; surfaces that stick have 5/14
_ROLLING_ACCELERATION = 0.1  # m/s^2, rms of a component


class PathStarts(NamedTuple):
    """The first positions of m free paths after contacts, and what is known of these contacts."""

    time: Array  # (m, n) s since the contact
    position: Array  # (m, n, 2) m
    used: Flags  # (m, n) which are positions; the others only fill the array
    time_std: Array  # (m,) s, of the contact
    before: Array  # (m, 2) m/s, velocity of the ball just before the contact
    before_std: Array  # (m,) m/s, of a component
    left: Array  # (m, 2) m/s, what is left of the slip of an earlier contact
    rolled: Array  # (m, 2) m/s, sum of the velocities of both balls before; at a wall twice that of the ball
    normal: Array  # (m, 2) unit vector along which the ball is pushed; NaN if unknown

    def skip(self, rows: int) -> PathStarts:
        """Do not use the first rows."""
        return self._replace(used=self.used & (np.cumsum(self.used, axis=1) > rows))


class PlateFriction(NamedTuple):
    """What slides after contacts depend on in one film."""

    decel: float  # m/s^2, of a ball that slides
    decel_std: float  # relative
    spin_transfer: float  # share of the relative speed of the surfaces that goes to each spin


class SlideFits(NamedTuple):
    """Paths after contacts: m slides with friction, and then straight lines."""

    start: Array  # (m, 2) m/s, velocity just after the contact
    gain: Array  # (m,) 1/s^2: variance of a component of `start` over that of a position
    bend: Array  # (m, 2) m/s^2, acceleration besides that of the slide
    slip: Array  # (m, 2) m/s, of the lowest point just after the contact
    slip_std: Array  # (m,) relative
    slid: Array  # (m,) s, mean time for which it slid before the positions
    until: Array  # (m,) s since the contact, middle of the positions
    chi2_per_dof: Array  # (m,)
    decel: float  # m/s^2, of the slides

    @property
    def duration(self) -> Array:
        """(m,) s, of the slides."""
        return np.asarray(2 * np.hypot(*self.slip.T) / (7 * self.decel))

    def replace_where(self, holds: Flags, other: SlideFits) -> SlideFits:
        """The other fits where a condition (m,) holds."""
        pairs = {name: (getattr(self, name), getattr(other, name)) for name in self._fields if name != "decel"}
        return self._replace(
            **{n: np.where(holds.reshape(-1, *[1] * (a.ndim - 1)), b, a) for n, (a, b) in pairs.items()}
        )

    def find_velocities(self, row: int, since: Array) -> Array:
        """Velocities (k, 2) on one path at times (k,) since its contact."""
        size = max(float(np.hypot(*self.slip[row])), 1e-12)
        slid = np.clip(since, 0.0, self.duration[row])[:, None]
        return np.asarray(self.start[row] + self.bend[row] * since[:, None] - self.decel * slid * self.slip[row] / size)

    def find_left(self, row: int, since: float) -> Array:
        """The slip (2,) on one path, m/s, at a time since its contact."""
        share = 1 - since / max(float(self.duration[row]), 1e-12)
        return np.asarray(self.slip[row] * max(share, 0.0))


def fit_slides(starts: PathStarts, friction: PlateFriction, noise: float) -> SlideFits:
    """Fit a slide and a straight path to each start of a path; noise: of a coordinate, m."""
    turns = 6  # the slip and the velocity after the contact depend on one another
    time, used = starts.time, starts.used
    design = np.stack([np.ones_like(time), time, time**2 / 2], axis=-1) * used[..., None]
    square = np.swapaxes(design, 1, 2) @ design
    square[:, 2, 2] += (noise / _ROLLING_ACCELERATION) ** 2
    few = np.count_nonzero(used, axis=1) < 2  # a path that has no fit, and is not used
    square[:, 0, 0] += few
    square[:, 1, 1] += few * 1e-6
    inverse = np.linalg.inv(square)
    solver = inverse @ np.swapaxes(design, 1, 2)
    moved = starts.position
    for _ in range(turns):
        value = solver @ moved
        kick = value[:, 1] - starts.before
        along = np.where(np.isfinite(starts.normal), starts.normal, kick)
        along = along / np.maximum(np.hypot(*along.T), 1e-12)[:, None]
        drag = (starts.rolled * along).sum(axis=1)[:, None] * along
        slip = kick + starts.left + friction.spin_transfer * drag
        size = np.maximum(np.hypot(*slip.T), 1e-12)
        slid = np.clip(time, 0.0, 2 * size[:, None] / (7 * friction.decel))
        way = friction.decel * slid * (time - slid / 2)
        moved = starts.position + way[..., None] * (slip / size[:, None])[:, None]
    value = solver @ moved
    residual = (moved - design @ value) * used[..., None]
    chi2 = (residual**2).sum(axis=(1, 2)) / noise**2 + (value[:, 2] ** 2).sum(axis=1) / _ROLLING_ACCELERATION**2
    dof = np.maximum(2.0 * np.count_nonzero(used, axis=1) - 4, 1)
    gain = inverse[:, 1, 1]
    errors = starts.before_std**2 + noise**2 * gain + (0.05 * np.hypot(*drag.T)) ** 2
    count = np.maximum(np.count_nonzero(used, axis=1), 1)
    mean_slid, mean_time = ((values * used).sum(axis=1) / count for values in (slid, time))
    slip_std = np.sqrt(errors) / size
    return SlideFits(value[:, 1], gain, value[:, 2], slip, slip_std, mean_slid, mean_time, chi2 / dof, friction.decel)


def measure_friction(starts: PathStarts, noise: float, *, min_paths: int = 20) -> PlateFriction | None:
    """Measure the friction of the plate by all paths of a film; None if they do not show it. noise: of a coordinate, m.

    The cost has heavy tails, because some contacts are missed.
    """
    max_error = 0.1  # relative
    dof = np.maximum(2.0 * np.count_nonzero(starts.used, axis=1) - 4, 1)
    if np.count_nonzero(dof >= ROWS) < min_paths:
        return None

    def price(x: Array) -> float:
        fits = fit_slides(starts, PlateFriction(USUAL_FRICTION * float(np.exp(x[0])), 0.0, float(x[1])), noise)
        unusual = float(x[1] - _SPIN_TRANSFER) / _SPIN_TRANSFER_STD
        return float((dof / 2 * np.log1p(fits.chi2_per_dof)).sum()) + unusual**2 / 2

    def descend(log: float) -> OptimizeResult:
        first = np.array(
            [[log, _SPIN_TRANSFER], [log + 0.3, _SPIN_TRANSFER], [log, _SPIN_TRANSFER - _SPIN_TRANSFER_STD]]
        )
        return minimize(
            price,
            first[0],
            method="Nelder-Mead",
            options={"xatol": 3e-3, "fatol": 0.1, "maxfev": 120, "initial_simplex": first},
        )

    best = min((descend(log) for log in (-1.0, 0.0, 1.0)), key=lambda found: float(found.fun))  # of several minima
    step = np.array([0.05, 0.0])
    bend = (price(best.x + step) + price(best.x - step) - 2 * price(best.x)) / step[0] ** 2
    error = 1 / np.sqrt(bend) if bend > 0 else np.inf
    friction = PlateFriction(USUAL_FRICTION * float(np.exp(best.x[0])), max(float(error), 0.01), float(best.x[1]))
    fits = fit_slides(starts, friction, noise)  # of bodies that do not roll it is poor
    return friction if error < max_error and np.median(fits.chi2_per_dof) < MAX_CHI2_PER_DOF else None
