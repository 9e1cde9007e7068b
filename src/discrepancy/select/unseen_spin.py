"""Friction between balls whose strikers have a spin about the vertical that the tracks do not show.

A spin w about the vertical adds R w to the velocity of the striker's surface across the line of centres. The tracks of
a plain ball do not show it. So the likelihood of a contact is averaged over it. R w is normal about zero, with a width
in proportion to the speed. The width is fitted with the law: it is a random effect, beside the scatter of the friction.

Coulomb friction has the direction of the slip and a limited size. So an unseen spin of any size makes it scatter
between -mu and mu. A share of the slip has no limit. By this the likelihood distinguishes both laws.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from discrepancy.data.contacts import Contacts
from synthcam_shared.arrays import Array, Ints

SPINS = np.linspace(-4.0, 4.0, 81)  # in widths; so dense that they resolve a friction with a small error
STARTING_WIDTHS = (0.25, 0.7)  # R w over the speed
FOLDS = 4  # parts of the recordings, of which one at a time is left out
MAX_WIDTH = 3.0  # strikes of a cue give up to about 1.5
MIN_SCATTER = 1e-4
MIN_SHARED = 0.03  # of an error that contacts share, in standard errors of their mean


@dataclass(frozen=True)
class FrictionLaw:
    """A law of the friction between balls.

    strength: friction over the normal impulse, of contacts (n,), slips (n, k), m/s, and numbers of the law. starts: the
    numbers with which its fit starts, by the rms friction.
    """

    name: str
    strength: Callable[[Contacts, Array, Array], Array]
    starts: Callable[[float], tuple[tuple[float, ...], ...]] = lambda _: ((),)


def find_sticking_friction(contacts: Contacts, slip: Array) -> Array:
    """Find the friction over the normal impulse that ends a slip (n, k) of two solid balls."""
    return np.asarray(2 / 7 * slip / ((1 + contacts.restitution) * contacts.speed_n)[:, None])


def _fall_with_slip(contacts: Contacts, slip: Array, numbers: Array) -> Array:
    mu = numbers[0] - numbers[1] * np.log(slip / np.median(contacts.slip))
    return np.asarray(np.clip(mu, 0.0, find_sticking_friction(contacts, slip)))


COULOMB = FrictionLaw(
    "Coulomb friction",
    lambda contacts, slip, x: np.minimum(x[0], find_sticking_friction(contacts, slip)),
    lambda size: ((size,),),
)
FALLING = FrictionLaw(
    "Coulomb friction that falls with the slip speed",
    _fall_with_slip,
    lambda size: ((size, 0.0),),
)
SHARE = FrictionLaw(
    "a share of the tangential speed stops",
    lambda contacts, slip, x: 7 / 2 * x[0] * find_sticking_friction(contacts, slip),
    lambda _: ((0.1,),),
)


@dataclass(frozen=True, eq=False)
class FrictionFit:
    """The likeliest numbers of a law of friction.

    cost: -2 log likelihood, without the constant of normal errors. width: rms of R w over the speed; 0 without spin.
    common (k,): errors that contacts share, in their standard errors. std: of the numbers and the width.
    """

    law: FrictionLaw
    cost: float
    numbers: Array
    scatter: float
    width: float
    common: Array
    std: Array

    @classmethod
    def of(cls, law: FrictionLaw, contacts: Contacts, errors: tuple[Array, Array], *, spins: bool) -> FrictionFit:
        """Fit a law to contacts with a known friction.

        errors: the standard errors (n,) of each friction alone, and the effects (n, k) of errors that contacts share.
        spins: whether strikers may have an unseen spin.
        """
        size = float(np.sqrt(np.mean(contacts.friction**2 + errors[0] ** 2)))
        basis = _find_basis(*errors)
        count, common = len(law.starts(size)[0]), basis.shape[1]

        def read(x: Array, cost: float = np.nan) -> FrictionFit:
            numbers, own, sizes = np.split(x, [count, count + common])
            width = float(np.exp(sizes[1])) if spins else 0.0
            return cls(law, cost, numbers, float(np.exp(sizes[0])), width, basis @ own, np.full(count + spins, np.nan))

        def find_cost(x: Array) -> float:
            return read(x)._find_cost(contacts, errors)

        spin_starts = [[np.log(width)] for width in STARTING_WIDTHS] if spins else [[]]
        starts = [[*x, *np.zeros(common), np.log(size / 2), *spin] for x in law.starts(size) for spin in spin_starts]
        free = [(None, None)] * (count + common)
        limits = [*free, (np.log(MIN_SCATTER), 0.0), *[(None, np.log(MAX_WIDTH))] * spins]
        found = (minimize(find_cost, x, method="L-BFGS-B", bounds=limits) for x in starts)
        best = min(found, key=lambda one: float(one.fun))
        fit = read(best.x, float(best.fun))
        of_x = _find_errors(find_cost, best.x)
        of_width = [fit.width * of_x[-1]] if spins else []
        return cls(**vars(fit) | {"std": np.array([*of_x[:count], *of_width])})

    def _find_cost(self, contacts: Contacts, errors: tuple[Array, Array]) -> float:
        """-2 log likelihood, averaged over the errors that contacts share, by Laplace's method."""
        log_density, curvature = self._find_densities(contacts, errors)
        shared = errors[1]
        information = np.eye(len(self.common)) + (shared.T * curvature) @ shared
        common = float(self.common @ self.common) + float(np.linalg.slogdet(information)[1])
        return float(-2 * log_density.sum()) + common

    def find_log_densities(self, contacts: Contacts, errors: tuple[Array, Array]) -> Array:
        """Find the log density (n,) of the friction of each contact, without the constant of normal errors."""
        return self._find_densities(contacts, errors)[0]

    def _find_densities(self, contacts: Contacts, errors: tuple[Array, Array]) -> tuple[Array, Array]:
        """The log density (n,) of the friction of each contact, and its negative second derivative by the friction."""
        (std, shared), (weights, _, across) = errors, self.spread(contacts)
        variance = std**2 + self.scatter**2
        off = (contacts.friction - shared @ self.common)[:, None] - across
        square = off**2 / variance[:, None]
        least = square.min(axis=1)
        density = np.exp(-(square - least[:, None]) / 2) * weights
        total = density.sum(axis=1)
        mean = (density * off).sum(axis=1) / total
        spread = (density * off**2).sum(axis=1) / total - mean**2
        curvature = np.maximum(1 / variance - spread / variance**2, 0.0)
        return np.asarray(np.log(total) - (least + np.log(variance)) / 2), np.asarray(curvature)

    def spread(self, contacts: Contacts) -> tuple[Array, Array, Array]:
        """The weights (k,) of spins, and with each the vertical friction and that in the plane (n, k)."""
        spins = SPINS if self.width else np.zeros(1)
        weights = np.exp(-(spins**2) / 2)
        slip_t = contacts.slip_t[:, None] + self.width * contacts.speed[:, None] * spins
        slip = np.maximum(np.hypot(slip_t, contacts.slip_down[:, None]), 1e-6)
        strength = self.law.strength(contacts, slip, self.numbers)
        return weights / weights.sum(), strength * contacts.slip_down[:, None] / slip, strength * slip_t / slip


def predict_left_out(contacts: Contacts, recordings: Ints, predict: Callable[[Contacts, Contacts], Array]) -> Array:
    """Predict contacts by the others, FOLDS times for as many parts of the recordings (n,): log densities (n,)."""
    part, out = recordings % FOLDS, np.zeros(len(contacts))
    for k in np.unique(part):
        out[part == k] = predict(contacts.select(part != k), contacts.select(part == k))
    return out


def _find_basis(std: Array, shared: Array) -> Array:
    """The combinations (k, r) of errors that contacts share which change their friction noticeably."""
    _, size, directions = np.linalg.svd(shared / std[:, None], full_matrices=False)
    return np.asarray(directions[size > MIN_SHARED].T)


def _find_errors(cost: Callable[[Array], float], best: Array) -> Array:
    """The standard errors of parameters whose cost, -2 log likelihood, is least; NaN where the data do not limit them.

    A scatter or a width at its limit is taken as known.
    """
    n, least = len(best), cost(best)
    steps = np.array([1e-2] * n)
    for k in range(n):  # so that each step costs about 0.1
        moved = sum(cost(best + s * steps[k] * np.eye(n)[k]) - least for s in (-1, 1)) / 2
        steps[k] *= (0.1 / max(moved, 1e-4)) ** 0.5
    free = steps < 1.0
    basis = np.diag(steps)[free]
    hessian = np.empty((len(basis), len(basis)))
    for i, one in enumerate(basis):
        for j, other in enumerate(basis[: i + 1]):
            values = [s * t * cost(best + s * one + t * other) for s in (-1, 1) for t in (-1, 1)]
            hessian[i, j] = hessian[j, i] = sum(values) / 4
    std = np.full(n, np.nan)
    covariance = 2 * np.linalg.pinv(hessian)
    std[free] = steps[free] * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return std
