"""Laws of the friction between balls, fitted to contacts whose strikers have an unseen spin about the vertical.

A spin w about the vertical adds R w to the velocity of the surface across the line of centres. The tracks of a ball do
not show it. So the likelihood of a contact is averaged over it: w is normal about zero, with a width in proportion to
the speed that is fitted with the law. Width zero: no spin. Each friction has a random effect of its contact, and all
share the error of the diameter over the scale, which turns the line of centres.

The vertical part of the friction lifts the striker and presses the struck ball on the plate, if the plate does not hold
it back. So friction of the plate takes more momentum of the struck ball, and gives less to a striker that rolled.
`HopFit` has the loss over the friction of the plate times that vertical impulse.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from scipy.optimize import minimize

from benchmarks.real.simulated_hits import PUBLISHED_FALL, SLIDING_FRICTION
from discrepancy.data.contacts import Contacts
from discrepancy.select.contact_effects import ContactLaw
from synthcam_shared.arrays import Array, Ints
from tracker.measurement.random_effects import RandomEffects, fit_random_effects

DIAMETER_ERROR = 0.005  # of the diameter over the scale of the tracks: 0.3 mm of a ball
USUAL_SLIP_M_S = 2.5
NODES = 41  # of the average over the spin
FOLDS = 4  # of the test on contacts that are kept out
STARTING_WIDTHS = (0.25, 0.7)  # of the spin, R w over the speed
MAX_WIDTH, MIN_SCATTER = 3.0, 1e-4


@dataclass(frozen=True)
class FrictionLaw:
    """A law of the friction.

    strength: friction over the normal impulse, of contacts (n,), slips (n, k), m/s, and numbers of the law. starts: of
    its fit.
    """

    name: str
    strength: Callable[[Contacts, Array, Array], Array]
    starts: tuple[tuple[float, ...], ...] = ((),)


def _stick(contacts: Contacts, slip: Array) -> Array:
    """The friction that ends the slip of two solid balls."""
    return np.asarray(2 / 7 * slip / ((1 + contacts.restitution) * contacts.speed_n)[:, None])


def _follow_published(slip: Array) -> Array:
    known = PUBLISHED_FALL
    return np.asarray(known["mu"] + known["rise"] * np.exp(-slip / known["fall"]))


COULOMB = FrictionLaw("Coulomb", lambda c, slip, x: np.minimum(x[0], _stick(c, slip)), ((0.02,), (0.08,)))
CHANGING = FrictionLaw(
    "Coulomb that changes with ln(slip)",
    lambda c, slip, x: np.clip(x[0] - x[1] * np.log(slip / USUAL_SLIP_M_S), 0.0, _stick(c, slip)),
    ((0.02, 0.0), (0.08, 0.0)),
)
LAWS = (
    FrictionLaw("none", lambda contacts, slip, _: np.zeros_like(slip)),
    FrictionLaw("a share of the slip stops", lambda c, slip, x: 7 / 2 * x[0] * _stick(c, slip), ((0.08,),)),
    COULOMB,
    CHANGING,
    FrictionLaw("published curve", lambda c, slip, _: np.minimum(_follow_published(slip), _stick(c, slip))),
    FrictionLaw(
        "published curve, any size",
        lambda c, slip, x: np.minimum(x[0] * _follow_published(slip), _stick(c, slip)),
        ((1.0,), (4.0,)),
    ),
)


@dataclass(frozen=True)
class FrictionFit:
    """The likeliest numbers of a law; cost: -2 log likelihood. width: of the spin, R w over the speed.

    turn: error of the diameter over the scale, in DIAMETER_ERROR.
    """

    law: FrictionLaw
    cost: float
    numbers: Array
    scatter: float
    width: float
    turn: float

    @classmethod
    def of(cls, law: FrictionLaw, contacts: Contacts, spins: bool) -> FrictionFit:
        """Fit a law to contacts with a known friction; spins: whether strikers may spin about the vertical."""

        count = len(law.starts[0])

        def read(x: Array, cost: float = np.nan) -> FrictionFit:
            numbers, (turn, log_scatter, *log_width) = np.split(x, [count])
            width = float(np.exp(log_width[0])) if log_width else 0.0
            return cls(law, cost, numbers, float(np.exp(log_scatter)), width, float(turn))

        def cost(x: Array) -> float:
            fit = read(x)
            return float(-2 * fit.log_densities(contacts).sum() + fit.turn**2)

        spin_starts = [[np.log(width)] for width in STARTING_WIDTHS] if spins else [[]]
        starts = [[*numbers, 0.0, np.log(0.03), *spin] for numbers in law.starts for spin in spin_starts]
        limits = [*[(None, None)] * (count + 1), (np.log(MIN_SCATTER), 0.0), *[(None, np.log(MAX_WIDTH))] * spins]
        found = (minimize(cost, x, method="L-BFGS-B", bounds=limits) for x in starts)
        best = min(found, key=lambda one: float(one.fun))
        return read(best.x, float(best.fun))

    def log_densities(self, contacts: Contacts) -> Array:
        """Log density (n,) of the friction of each contact."""
        weights, _, across = self._spread(contacts)
        variance = contacts.friction_std**2 + self.scatter**2
        square = (contacts.friction[:, None] - across) ** 2 / variance[:, None]
        density = np.exp(-square / 2) @ weights
        return np.asarray(np.log(np.maximum(density, 1e-300)) - np.log(2 * np.pi * variance) / 2)

    def predict_vertical(self, contacts: Contacts) -> Array:
        """The vertical friction over the normal impulse (n,) that follows from that in the plane."""
        weights, down, across = self._spread(contacts)
        variance = (contacts.friction_std**2 + self.scatter**2)[:, None]
        density = np.exp(-((contacts.friction[:, None] - across) ** 2) / variance / 2) * weights
        return np.asarray((density * down).sum(axis=1) / np.maximum(density.sum(axis=1), 1e-300))

    def _spread(self, contacts: Contacts) -> tuple[Array, Array, Array]:
        """Weights (k,) of spins, and with each the vertical friction and that in the plane (n, k)."""
        points, weights = hermegauss(NODES) if self.width else (np.zeros(1), np.ones(1))
        slip_t = contacts.speed_t[:, None] + self.width * contacts.speed[:, None] * points
        slip = np.maximum(np.hypot(slip_t, contacts.speed_n[:, None]), 1e-6)
        strength = self.law.strength(contacts, slip, self.numbers)
        turned = self.turn * DIAMETER_ERROR * (contacts.speed_t / contacts.speed_n)[:, None]
        return weights / weights.sum(), strength * contacts.speed_n[:, None] / slip, strength * slip_t / slip + turned


def predict_held_out(law: FrictionLaw, contacts: Contacts, spins: bool, seed: int = 0) -> float:
    """-2 log density of contacts that are kept out of the fit, one of FOLDS parts after the other."""
    part = np.random.default_rng(seed).permutation(len(contacts)) % FOLDS
    fits = ((FrictionFit.of(law, contacts.select(part != k), spins), part == k) for k in range(FOLDS))
    return float(sum(-2 * fit.log_densities(contacts.select(rows)).sum() for fit, rows in fits))


@dataclass(frozen=True)
class HopFit:
    """A loss of momentum along the line of centres in proportion to the vertical impulse.

    size, std: the loss over the friction of the plate times that impulse, and its error. gain: over no loss, in -2 log
    likelihood. left_out_sigma: of the gain on contacts that are left out.
    """

    size: float
    std: float
    gain: float
    left_out_sigma: float

    @classmethod
    def of(cls, contacts: Contacts, vertical: Array, *, shared: bool) -> HopFit:
        """Fit it to the recoil of contacts with a vertical friction (n,); shared: with the errors that all share."""
        std, effects = contacts.split_errors("recoil")
        effects = effects if shared else effects[:, :0]
        loss = (SLIDING_FRICTION * vertical)[:, None]
        price = np.full(len(contacts), np.inf)
        none = ContactLaw("none", lambda _: loss[:, :0], ()).fit(contacts, contacts.recoil, (std, effects), price)
        hop = ContactLaw("hop", lambda _: loss, ()).fit(contacts, contacts.recoil, (std, effects), price)
        number = fit_random_effects(contacts.recoil, std, effects, loss)
        return cls(
            size=float(number.coefficients[0]),
            std=float(number.std[0]),
            gain=none.cost - hop.cost,
            left_out_sigma=none.compare(hop, np.arange(len(contacts))),
        )


def fit_loss_beside_masses(contacts: Contacts, balls: Ints) -> RandomEffects:
    """Fit the recoil as a loss of the struck ball and the masses of all balls.

    Errors that all contacts share are left out. balls (n, 2): the struck and the striking ball. The first number is the
    loss, over the momentum. The others are the logarithms of masses over that of the first ball.
    """
    std, _ = contacts.split_errors("recoil")
    masses = [(balls[:, 0] == ball).astype(float) - (balls[:, 1] == ball) for ball in np.unique(balls)[1:]]
    return fit_random_effects(contacts.recoil, std, None, np.column_stack([np.ones(len(contacts)), *masses]))
