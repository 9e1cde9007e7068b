"""Laws of the friction between balls, with and without an unseen spin of the striker, and the hop that they predict.

`discrepancy.select.unseen_spin` has the fits. Here all contacts also share the error of the diameter over the scale,
which turns the line of centres. The published curve of billiard balls is compared too.

The vertical part of the friction lifts the striker and presses the struck ball on the plate, if the plate does not hold
it back. So friction of the plate takes more momentum of the struck ball, and gives less to a striker that rolled.
`HopFit` has the loss over the friction of the plate times that vertical impulse.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.real.simulated_hits import PUBLISHED_FALL, SLIDING_FRICTION
from discrepancy.data.contacts import Contacts
from discrepancy.select.impact_laws import ContactLaw
from discrepancy.select.unseen_spin import (
    COULOMB,
    FALLING,
    SHARE,
    FrictionFit,
    FrictionLaw,
    find_sticking_friction,
    predict_left_out,
)
from synthcam_shared.arrays import Array, Ints
from tracker.measurement.random_effects import RandomEffects, fit_random_effects

DIAMETER_ERROR = 0.005  # of the diameter over the scale of the tracks: 0.3 mm of a ball


def _follow_published(slip: Array) -> Array:
    known = PUBLISHED_FALL
    return np.asarray(known["mu"] + known["rise"] * np.exp(-slip / known["fall"]))


LAWS = (
    FrictionLaw("none", lambda contacts, slip, _: np.zeros_like(slip)),
    SHARE,
    COULOMB,
    FALLING,
    FrictionLaw(
        "published curve", lambda c, slip, _: np.minimum(_follow_published(slip), find_sticking_friction(c, slip))
    ),
    FrictionLaw(
        "published curve, any size",
        lambda c, slip, x: np.minimum(x[0] * _follow_published(slip), find_sticking_friction(c, slip)),
        lambda _: ((1.0,), (4.0,)),
    ),
)


def fit_friction(law: FrictionLaw, contacts: Contacts, spins: bool) -> FrictionFit:
    """Fit a law to contacts with a known friction; spins: whether strikers may spin about the vertical."""
    return FrictionFit.of(law, contacts, _find_errors(contacts), spins=spins)


def _find_errors(contacts: Contacts) -> tuple[Array, Array]:
    """The errors (n,) of each friction, and the effect (n, 1) of that of the diameter over the scale."""
    return contacts.friction_std, DIAMETER_ERROR * (contacts.speed_t / contacts.speed_n)[:, None]


def predict_held_out(law: FrictionLaw, contacts: Contacts, spins: bool, seed: int = 0) -> float:
    """-2 log density of contacts that are kept out of the fit, a quarter after the other."""

    def predict(fitted: Contacts, others: Contacts) -> Array:
        return fit_friction(law, fitted, spins).find_log_densities(others, _find_errors(others))

    order = np.random.default_rng(seed).permutation(len(contacts))
    return float(-2 * predict_left_out(contacts, order, predict).sum())


def predict_vertical(fit: FrictionFit, contacts: Contacts) -> Array:
    """The vertical friction over the normal impulse (n,) that follows from that in the plane."""
    weights, down, across = fit.spread(contacts)
    variance = (contacts.friction_std**2 + fit.scatter**2)[:, None]
    density = np.exp(-((contacts.friction[:, None] - across) ** 2) / variance / 2) * weights
    return np.asarray((density * down).sum(axis=1) / np.maximum(density.sum(axis=1), 1e-300))


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
