"""Laws of the impact that contacts are compared with: of restitution, friction and recoil, the simplest first."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from discrepancy.data.contacts import Contacts
from discrepancy.data.slips import USUAL_FRICTION
from discrepancy.select.contact_regression import Regression
from discrepancy.select.unseen_spin import (
    COULOMB,
    FALLING,
    MAX_WIDTH,
    SHARE,
    FrictionFit,
    FrictionLaw,
)
from synthcam_shared.arrays import Array

MIN_EFFECT_SIGMA = 2.0  # of the effect of a ball's mass on a contact that counts as one that shows it


@dataclass(frozen=True)
class ContactLaw:
    """A law of a quantity: its design (n, p) for n contacts, and the names of its numbers with their units.

    causes: the effects that make this law. causes_if_negative: those that make it with a negative number; default all.
    trials: how many laws of this kind are tried, of which one at most holds.
    """

    name: str
    design: Callable[[Contacts], Array]
    numbers: tuple[tuple[str, str], ...]
    causes: tuple[str, ...] = ()
    trials: int = 0
    limit: Callable[[Contacts], Array] | None = None  # (n, 1) of the quantity, where surfaces of balls stick
    contains: str | None = None  # the law that it is without its last number
    causes_if_negative: tuple[str, ...] | None = None
    of_slip: bool = False  # whether the design depends on slips, which have errors in a crowd

    def fit(self, contacts: Contacts, value: Array, errors: tuple[Array, Array], price: Array) -> Regression:
        """Fit the law to values (n,) with their own errors (n,) and shared ones (n, k); price: of odd contacts (n,).

        In a crowd, a law is averaged over the slips that the errors allow. Its scatter over them is one more error.
        Contacts beyond the limit may have that value instead, if the law fits better so.
        """
        if not (self.of_slip and contacts.of_crowd.all()):
            return Regression.of(value, *errors, self.design(contacts), price)
        weights, spread = contacts.spread_slips()
        designs = np.stack([self.design(one) for one in spread])
        found = [self._fit_over_slips(value, errors, price, weights, designs, np.full(designs.shape[:2], np.inf))]
        if self.limit is not None:
            most = np.stack([self.limit(one)[:, 0] for one in spread])
            found.append(self._fit_over_slips(value, errors, price, weights, designs, most))
        return min(found, key=lambda fit: fit.cost)

    def fit_and_predict(self, fitted: Contacts, others: Contacts) -> Array:
        """Fit the friction of two-ball contacts, and find the log density of that of others, as `SpinLaw` does."""
        std = fitted.split_errors("friction")[0]
        errors, price = (std, np.zeros((len(std), 0))), np.full(len(std), np.inf)
        fit = self.fit(fitted, fitted.friction, errors, price)
        return fit.find_log_densities(others.friction, others.split_errors("friction")[0], self.design(others))

    def _fit_over_slips(
        self, value: Array, errors: tuple[Array, Array], price: Array, weights: Array, designs: Array, limit: Array
    ) -> Regression:
        """Fit a law with designs (k, n, p) at k slips of each contact, where it is at most so large (k, n)."""
        (std, shared), sticks, most = errors, np.zeros(limit.shape, dtype=bool), limit
        scatter = USUAL_FRICTION * _scatter_over(weights, designs[..., 0]) if designs.shape[2] else np.zeros(len(value))
        for _ in range(12):
            free = np.tensordot(weights, np.where(sticks[..., None], 0.0, designs), axes=1)
            stuck = weights @ np.where(sticks, most, 0.0)
            fit = Regression.of(value - stuck, np.hypot(std, scatter), shared, free, price)
            law = designs @ fit.coefficients
            if self.contains is not None:  # a friction that falls ends at none
                most = np.where(law * designs[..., 0] < 0, 0.0, limit)
            now = np.abs(law) > np.abs(most)
            before, scatter = scatter, _scatter_over(weights, np.where(now, most, law))
            if (now == sticks).all() and np.allclose(before, scatter, rtol=0.02, atol=1e-4):
                break
            if np.count_nonzero(weights @ ~now > 0.5) < 2 * designs.shape[2] + 1:
                break
            sticks = now
        return fit

    def describe(self, fit: Regression) -> str:
        """Give its name; a body that is heavier by a negative share is lighter."""
        return self.name.replace("heavier", "lighter") if fit.coefficients.sum() < 0 else self.name

    def list_causes(self, fit: Regression) -> tuple[str, ...]:
        """List the effects that make this law with the sign of its fit."""
        negative = self.causes_if_negative is not None and fit.coefficients.sum() < 0
        return self.causes_if_negative or () if negative else self.causes

    def is_shown(self, fit: Regression, contacts: Contacts) -> bool:
        """Decide whether more than one contact shows it, if it is one of several of its kind.

        Such a contact has an error that is small beside the effect. A component of a group is half a contact.
        """
        shows = np.abs(fit.predict()) > MIN_EFFECT_SIGMA * np.sqrt(fit.variance)
        return self.trials == 0 or float(contacts.share[shows].sum()) > 1

    def has_sign(self, fit: Regression, contacts: Contacts, sign: Array) -> bool:
        """Decide whether it has a sign (n,), and falls if it is a friction that falls.

        In a crowd, such a friction may fall to none in less than half the contacts.
        """
        positive = sign * (self.design(contacts) @ fit.coefficients) >= 0
        if self.contains is None:
            return bool(positive.all())
        enough = positive.mean() > 0.5 if contacts.of_crowd.all() else positive.all()
        return bool(enough and fit.coefficients[-1] > 0)

    @property
    def price(self) -> float:
        """The cost in -2 log likelihood of a law that is one of several of its kind."""
        return 2 * math.log(max(self.trials, 1))


@dataclass(frozen=True)
class SpinLaw:
    """A law of friction with an unseen spin of the striker, the names of its numbers with their units, and its causes.

    contains: the laws that it is without its spin or another number.
    """

    friction: FrictionLaw
    numbers: tuple[tuple[str, str], ...]
    causes: tuple[str, ...]
    contains: tuple[str, ...]

    @property
    def name(self) -> str:
        """The name of the law."""
        return name_with_spin(self.friction)

    def has_sign(self, fit: FrictionFit) -> bool:
        """Decide whether friction opposes the slip, and falls if it should, with a spin that has an error."""
        return bool((fit.numbers > 0).all() and np.isfinite(fit.std).all() and fit.width < 0.99 * MAX_WIDTH)

    def fit_and_predict(self, fitted: Contacts, others: Contacts) -> Array:
        """Fit the friction of contacts, and find the log density of that of others; shared errors are left out."""
        errors, others_errors = (
            (each.split_errors("friction")[0], np.zeros((len(each), 0))) for each in (fitted, others)
        )
        return FrictionFit.of(self.friction, fitted, errors, spins=True).find_log_densities(others, others_errors)


def name_with_spin(law: FrictionLaw) -> str:
    """Name a law of friction with an unseen spin of the striker."""
    return f"{law.name}, with an unseen spin of the striker"


def _scatter_over(weights: Array, values: Array) -> Array:
    """The standard deviation (n,) of values (k, n) with weights (k,)."""
    return np.asarray(np.sqrt(np.maximum(weights @ values**2 - (weights @ values) ** 2, 0.0)))


def _ones(contacts: Contacts) -> Array:
    return np.ones((len(contacts), 1))


def _nothing(contacts: Contacts) -> Array:
    return np.zeros((len(contacts), 0))


def _steepness(contacts: Contacts) -> Array:
    """The friction that would stop the tangential velocity of the surfaces, as if the balls could not turn."""
    return np.asarray((contacts.slip_t / ((1 + contacts.restitution) * contacts.speed_n))[:, None])


def _slip(contacts: Contacts, least: float) -> Array:
    return np.maximum(np.hypot(contacts.slip_t, contacts.slip_down), least)


def _across(contacts: Contacts) -> Array:
    """The share of Coulomb friction in the plane: the surface of a rolling striker, not of a disc, also moves down."""
    return np.asarray((contacts.slip_t / _slip(contacts, 1e-9))[:, None])


def _across_falling(contacts: Contacts) -> Array:
    slip = _slip(contacts, 1e-3) / np.median(np.maximum(contacts.slip, 1e-3))
    return np.asarray(_across(contacts) * np.column_stack([np.ones(len(slip)), -np.log(slip)]))


def _sticking(contacts: Contacts) -> Array:
    """The friction that stops the surfaces of two balls: they turn, so that it need stop two sevenths."""
    return np.asarray(2 / 7 * _steepness(contacts))


def _by_body(contacts: Contacts) -> Array:
    """The sign with which a heavier ball a shows in the recoil; zero in a crowd, which has no ball a."""
    return np.where(contacts.of_crowd, 0.0, np.where(contacts.a_strikes, -1.0, 1.0))[:, None]


def _of_ball(ball: int, contacts: Contacts) -> Array:
    return np.asarray(np.where(contacts.bodies == ball, contacts.levers, 0.0).sum(axis=1)[:, None])


# The errors of b and r are in the friction and in the regressor of a share, so the data favour a share. Name both.
_RUBBING = ("spin_transfer", "ball_friction")

LAWS: dict[str, tuple[ContactLaw, ...]] = {
    "restitution": (
        ContactLaw("constant", _ones, (("restitution", "1"),)),
        ContactLaw(
            "changes with the normal speed",
            lambda contacts: np.column_stack([_ones(contacts), contacts.speed_n]),
            (("restitution of slow contacts", "1"), ("slope", "s/m")),
            ("velocity_restitution",),
        ),
        ContactLaw(
            "changes with the obliqueness",
            lambda contacts: np.column_stack([_ones(contacts), contacts.speed_t / contacts.speed]),
            (("restitution of head-on contacts", "1"), ("slope with |b|", "1")),
            ("hop", "a wrong line of centres"),
        ),
    ),
    "friction": (
        ContactLaw("none", _nothing, ()),
        ContactLaw(COULOMB.name, _across, (("mu", "1"),), _RUBBING, limit=_sticking, of_slip=True),
        ContactLaw(
            FALLING.name,
            _across_falling,
            (("mu at the median slip speed", "1"), ("decrease from a speed to e times that", "1")),
            ("falling ball_friction",),
            limit=_sticking,
            contains=COULOMB.name,
            of_slip=True,
        ),
        ContactLaw(SHARE.name, _steepness, (("share", "1"),), _RUBBING, of_slip=True),
    ),
    "recoil": (
        ContactLaw("as the masses say", _nothing, ()),
        ContactLaw(
            "the struck body seems heavier by a share",
            _ones,
            (("log of the ratio", "1"),),
            ("mass_mismatch", "hop"),
            causes_if_negative=("mass_mismatch",),  # a hop takes momentum away
        ),
        ContactLaw("ball a is heavier by a share", _by_body, (("log of the ratio", "1"),), ("mass_mismatch",)),
    ),
}


SPIN_NUMBER = "rms of R w over the speed"  # w: the unseen spin, about the vertical
_OF_SPIN = (SPIN_NUMBER, "1")
LAWS_WITH_SPIN = (
    SpinLaw(COULOMB, (("mu", "1"), _OF_SPIN), ("ball_friction",), (COULOMB.name,)),
    SpinLaw(
        FALLING,
        (("mu at the median slip speed", "1"), ("decrease from a speed to e times that", "1"), _OF_SPIN),
        ("falling ball_friction",),
        (FALLING.name, name_with_spin(COULOMB)),
    ),
    SpinLaw(SHARE, (("share", "1"), _OF_SPIN), _RUBBING, (SHARE.name,)),
)


def list_laws(quantity: str, contacts: Contacts, laws: Sequence[ContactLaw]) -> Sequence[ContactLaw]:
    """The laws of a quantity; each ball of one crowd may be heavier, instead of ball a."""
    if quantity != "recoil" or not contacts.of_crowd.all():
        return laws
    several = len(np.unique(contacts.clip)) > 1  # its tracks are other balls in the next clip
    tried = [] if several else np.unique(contacts.bodies[contacts.bodies >= 0]).tolist()
    return laws[0], *(
        ContactLaw(
            f"ball {ball} is heavier by a share",
            partial(_of_ball, ball),
            (("log of the ratio", "1"),),
            ("mass_mismatch",),
            len(tried),
        )
        for ball in tried
    )
