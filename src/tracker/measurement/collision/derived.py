"""Quantities of a fitted motion: r, mu_k, C, slide times, energies, spins, each with its standard error.

Everything is a function of the free parameters of `collision_model`, so that both fits share one definition. Errors
follow from the covariance of the parameters to first order.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace

import numpy as np

from synthcam_shared.arrays import Array
from tracker.measurement.collision.collision_model import AFTER, GRAVITY, TIED, compute_unit_vectors, tied_to_free

QUANTITY_NAMES = (
    *("v0", "b", "t_c", "r", "s", "mu_k", "C", "tau1", "tau2", "v1f", "v2f"),
    *("energy_fraction", "momentum_fraction", "final_angle", "drag", "decel", "w1n", "w1t", "w2n", "w2t"),
)
# where in the columns of `derive_from_each_ball` these have a value from ball 1, and behind it one from ball 2
ONCE_FROM_EACH_BALL = {"mu_k": QUANTITY_NAMES.index("mu_k"), "C": QUANTITY_NAMES.index("C") + 1}
_UNTURNED = QUANTITY_NAMES.index("w1n")  # nothing turns a resting ball about n: zero by the model, not by measurement


@dataclass(frozen=True)
class DerivedValues:
    """Quantities in the order of QUANTITY_NAMES: value (20,) and covariance (20, 20).

    shared (20, k) is the effect of one standard error of each of k keys of the camera file; it is part of `cov`.
    """

    value: Array
    cov: Array
    shared: Array = field(default_factory=lambda: np.zeros((len(QUANTITY_NAMES), 0)))

    @property
    def std(self) -> Array:
        """(20,) standard errors."""
        return np.sqrt(np.diag(self.cov))

    def without_errors(self, names: Collection[str]) -> DerivedValues:
        """The same, but of these names the values alone."""
        lost, cov, shared = [QUANTITY_NAMES.index(name) for name in names], self.cov.copy(), self.shared.copy()
        cov[lost, :] = cov[:, lost] = shared[lost] = np.nan
        return DerivedValues(self.value, cov, shared)

    def with_shared(self, shared: Array) -> DerivedValues:
        """The same with further errors, (20, k), each of which moves all quantities together."""
        return replace(self, cov=self.cov + shared @ shared.T, shared=shared)


def derive_from_free(free: Array, cov: Array, diameter: float, shift: Array | None = None) -> DerivedValues:
    """Derive the quantities of a free motion from the parameters (22,) and their covariance; diameter in m.

    Friction and spin transfer follow from either ball; the two are averaged with weights from their errors. If they
    differ by more than five standard errors, there is no one value, and its covariance is NaN. A quantity that is
    undefined at these parameters (s of a head-on hit) is NaN with its covariance. Further errors of the parameters,
    `shift` (22, k), count in those weights but not in the covariance.
    """
    twice, slope = _with_slope(lambda p: derive_from_each_ball(p, diameter), free, cov)
    unknown = ~(np.isfinite(twice) & np.isfinite(slope).all(axis=1))  # s at b = 0 exactly is 0 / 0
    slope[unknown] = 0.0
    spread = slope @ cov @ slope.T
    further = slope @ (np.zeros((len(free), 0)) if shift is None else shift)
    wide = spread + further @ further.T
    merge, apart = make_ball_average(wide), list[str]()
    for name, column in ONCE_FROM_EACH_BALL.items():
        pair = slice(column, column + 2)
        if abs(twice[column] - twice[column + 1]) > 5.0 * np.sqrt(_of_difference(wide[pair, pair])):
            apart.append(name)
    value = merge @ np.where(unknown, 0.0, twice)
    value[merge[:, unknown].any(axis=1)] = np.nan
    lost = [name for name, known in zip(QUANTITY_NAMES, np.isfinite(value), strict=True) if not known]
    return DerivedValues(value, merge @ spread @ merge.T).without_errors([*apart, *lost])


def make_ball_average(cov: Array) -> Array:
    """Build the matrix (n - 2, n) that averages mu_k and C over both balls, with weights from their covariance (n, n).

    The first 22 rows of `cov` are those of `derive_from_each_ball`; further ones are kept.
    """
    merge = np.delete(np.eye(len(cov)), [column + 1 for column in ONCE_FROM_EACH_BALL.values()], axis=0)
    for k, column in enumerate(ONCE_FROM_EACH_BALL.values()):
        own = cov[column : column + 2, column : column + 2]
        with np.errstate(invalid="ignore", divide="ignore"):  # NaN where neither is known
            first = (own[1, 1] - own[0, 1]) / np.float64(_of_difference(own))
        merge[column - k, column : column + 2] = first, 1 - first
    return merge


def derive_from_tied(tied: Array, cov: Array, diameter: float, spin: float = 0.0) -> DerivedValues:
    """Derive the quantities of a tied motion from the parameters (16,) and their covariance.

    diameter in m; spin in m/s, see `tied_to_free`.
    """
    value, slope = _with_slope(lambda p: derive_values_from_tied(p, diameter, spin), tied, cov)
    if not tied[-2:].any():
        value[_UNTURNED] = slope[_UNTURNED] = 0.0
    return DerivedValues(value, slope @ cov @ slope.T)


def derive_values_from_tied(tied: Array, diameter: float, spin: float = 0.0) -> Array:
    """Derive the quantities (..., 20) of `derive_from_tied` without their covariance, which takes most of its time."""
    slip = tied[..., TIED.index("ux") : TIED.index("uy") + 1]
    both = derive_from_each_ball(np.asarray(tied_to_free(tied, spin), dtype=np.float64), diameter, slip)
    value = np.delete(both, [QUANTITY_NAMES.index("mu_k") + 1, QUANTITY_NAMES.index("C") + 2], axis=-1)
    value[~tied[..., -2:].any(axis=-1), _UNTURNED] = 0.0
    return value


def _with_slope(function, at: Array, cov: Array) -> tuple[Array, Array]:  # type: ignore[no-untyped-def]
    # of a standard error: second-order terms cancel, and rounding stays below 1e-6
    size = 0.01 * np.sqrt(np.diag(cov))
    steps = np.diag(size)
    values = function(np.concatenate([at + steps, at - steps, at[None]]))  # at once: most of the time is that of calls
    high, low = values[: len(at)], values[len(at) : -1]
    with np.errstate(invalid="ignore"):
        slope = (high - low) / (2 * size[:, None])
    slope[size == 0] = 0.0  # held
    return values[-1], slope.T


def _of_difference(cov: Array) -> float:
    """Variance of the difference of two measurements."""
    return float(cov[0, 0] + cov[1, 1] - 2 * cov[0, 1])


def derive_from_each_ball(
    free: Array, diameter: float, slip: Array | float = 0.0, masses: tuple[float, float] = (1.0, 1.0)
) -> Array:
    """Derive QUANTITY_NAMES, with mu_k and C from each ball: (..., 22).

    slip (..., 2): of ball 2 before the hit, m/s. masses: of both balls, in any unit.
    """
    radius = diameter / 2
    beta, v0 = free[..., 4], free[..., 5]
    d, n, t = (np.asarray(a, dtype=np.float64) for a in compute_unit_vectors(free[..., 3], beta))
    v, f, tau, spin = {}, {}, {}, {}
    for ball, at in AFTER.items():
        v[ball], f[ball] = free[..., at : at + 2], free[..., at + 2 : at + 4]
        tau[ball] = np.exp(free[..., at + 4])
        carried = (7 * f[ball] - 5 * v[ball]) / 2  # R w x z just after the impact: (5v + 2R w x z)/7 is kept
        spin[ball] = (-dot(carried, t), dot(carried, n))  # R w along n and t
    first = free[..., -2:]
    second = first + v0[..., None] * d
    along, across = v0 * np.cos(beta), v0 * np.sin(beta)
    rolls = dot(first, n), dot(second - slip, n)  # R w_t before: a rolling ball's spin along t is its speed along n
    one, two = masses
    total, start = one * dot(first, first) + two * dot(second, second), one * first + two * second
    with np.errstate(divide="ignore", invalid="ignore"):
        columns = [
            v0, np.sin(beta), free[..., 0],
            dot(v[1] - v[2], n) / along, dot(v[2] - v[1], t) / across,
            *(_norm(f[i] - v[i]) / (GRAVITY * tau[i]) for i in (1, 2)),
            *((rolls[i - 1] - spin[i][1]) / (rolls[0] + rolls[1]) for i in (1, 2)),
            tau[1], tau[2], _norm(f[1]), _norm(f[2]),
            (one * dot(f[1], f[1]) + two * dot(f[2], f[2])) / total,
            dot(one * f[1] + two * f[2], start) / dot(start, start),
            np.arctan2(np.abs(cross(f[1], f[2])), dot(f[1], f[2])),
            free[..., 6], free[..., 7],
            *(spin[i][axis] / radius for i in (1, 2) for axis in (0, 1)),
        ]  # fmt: skip
    return np.stack(columns, -1)


def dot(a: Array, b: Array) -> Array:
    """Compute the scalar product of vectors (..., 2), for derived quantities."""
    product = a * b
    return np.asarray(product[..., 0] + product[..., 1])


def cross(a: Array, b: Array) -> Array:
    """Compute z . (a x b) of vectors (..., 2), for derived quantities."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _norm(a: Array) -> Array:
    return np.asarray(np.hypot(a[..., 0], a[..., 1]))
