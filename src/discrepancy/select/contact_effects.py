"""Effects of the impact that contacts show: regressions with a scatter of its own for each contact.

The impact of a real contact is not the same each time: dirt, spin and springs change it. So each quantity is the sum of
a law of the approach, a random effect of that contact, and the error of its estimate. The size of the random effects is
fitted. Errors that several contacts share, such as the bias of a set, do not average out. They are part of the
covariance. Each quantity has a few laws, the simplest first. A law with more numbers replaces the simplest only if

- the likelihood gains `SearchPolicy.min_noise_gain` for each number, and more than `min_claim_sigma` in all, and
- each contact, left out in turn, is predicted better, by more than one standard error over recordings. With few
  recordings it is the error over contacts. The scatter is not fitted again without the contact, and errors that
  contacts share are left out of this test.

The same contacts cannot distinguish all causes. Such causes are named together.

In a film of a crowd a third body may meet two balls within a frame. Then the estimate of their contact is wrong by far
more than its error. So each contact of a crowd has a probability of 5 % to be odd, with a wide error. A law pays for
each contact that it takes as odd. Two balls that meet alone get opposite impulses, whatever their masses, and a third
body turns them. So the angle between the impulses counts in the price of an odd contact. Each ball may be the heavier
one, and trying them all is paid for as well. One contact does not say which of its two balls that is. So another ball
is a rival even if it could not be named alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.optimize import minimize_scalar

from discrepancy.data.contacts import Contacts
from discrepancy.data.slips import USUAL_FRICTION
from discrepancy.policy import current_policy
from synthcam_shared.arrays import Array, Flags, Ints
from tracker.measurement.random_effects import fit_random_effects

ODD_ERROR = 0.3  # standard error of restitution, friction, recoil and turn of such a contact
MIN_EFFECT_SIGMA = 2.0  # of the effect of a ball's mass on a contact that counts as one that shows it
# Price of an odd contact in -2 log likelihood. A third body disturbs 5 %: 2 of 48 and 1 of 33 in two films of thirty.
ODD_PRICE = 2 * math.log(1 / 0.05 - 1)


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

    def fit(self, contacts: Contacts, value: Array, errors: tuple[Array, Array], price: Array) -> _Fit:
        """Fit the law to values (n,) with their own errors (n,) and shared ones (n, k); price: of odd contacts (n,).

        In a crowd, a law is averaged over the slips that the errors allow. Its scatter over them is one more error.
        Contacts beyond the limit may have that value instead, if the law fits better so.
        """
        if not (self.of_slip and contacts.of_crowd.all()):
            return _Fit.of(value, *errors, self.design(contacts), price)
        weights, spread = contacts.spread_slips()
        designs = np.stack([self.design(one) for one in spread])
        found = [self._fit_over_slips(value, errors, price, weights, designs, np.full(designs.shape[:2], np.inf))]
        if self.limit is not None:
            most = np.stack([self.limit(one)[:, 0] for one in spread])
            found.append(self._fit_over_slips(value, errors, price, weights, designs, most))
        return min(found, key=lambda fit: fit.cost)

    def _fit_over_slips(
        self, value: Array, errors: tuple[Array, Array], price: Array, weights: Array, designs: Array, limit: Array
    ) -> _Fit:
        """Fit a law with designs (k, n, p) at k slips of each contact, where it is at most so large (k, n)."""
        (std, shared), sticks, most = errors, np.zeros(limit.shape, dtype=bool), limit
        scatter = USUAL_FRICTION * _scatter_over(weights, designs[..., 0]) if designs.shape[2] else np.zeros(len(value))
        for _ in range(12):
            free = np.tensordot(weights, np.where(sticks[..., None], 0.0, designs), axes=1)
            stuck = weights @ np.where(sticks, most, 0.0)
            fit = _Fit.of(value - stuck, np.hypot(std, scatter), shared, free, price)
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

    def describe(self, fit: _Fit) -> str:
        """Give its name; a body that is heavier by a negative share is lighter."""
        return self.name.replace("heavier", "lighter") if fit.coefficients.sum() < 0 else self.name

    def list_causes(self, fit: _Fit) -> tuple[str, ...]:
        """List the effects that make this law with the sign of its fit."""
        negative = self.causes_if_negative is not None and fit.coefficients.sum() < 0
        return self.causes_if_negative or () if negative else self.causes

    def is_shown(self, fit: _Fit, contacts: Contacts) -> bool:
        """Decide whether more than one contact shows it, if it is one of several of its kind.

        Such a contact has an error that is small beside the effect. A component of a group is half a contact.
        """
        shows = np.abs(fit.predict()) > MIN_EFFECT_SIGMA * np.sqrt(fit.variance)
        return self.trials == 0 or float(contacts.share[shows].sum()) > 1

    def has_sign(self, fit: _Fit, contacts: Contacts, sign: Array) -> bool:
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
class ContactNumber:
    """A fitted number of a law."""

    name: str
    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class ContactClaim:
    """The law of one quantity that the contacts support.

    causes: effects that make this law or one that fits as well; empty for the simplest law.
    scatter: standard deviation from contact to contact, beyond the errors.
    sigma: by the likelihood, over the simplest law.
    left_out_sigma: of the gain on contacts that are left out.
    contacts: their number; a group of contacts that follow one another too fast counts as one.
    rivals: laws that are not worse by `SearchPolicy.rival_excluded_chi2`.
    odd: how many contacts of a crowd count with a wide error.
    """

    quantity: str
    law: str
    causes: tuple[str, ...]
    numbers: tuple[ContactNumber, ...]
    contacts: int
    scatter: float
    sigma: float
    left_out_sigma: float
    rivals: tuple[str, ...]
    mean: ContactNumber  # of the quantity, whatever its law
    odd: int = 0


def price_odd_contacts(contacts: Contacts, quantity: str) -> Array:
    """Price (n,) of taking a contact as odd, in -2 log likelihood; infinite for two bodies that meet alone.

    It holds what else the contact shows, which is likelier either with its own error or with that of an odd contact:
    the turn of the impulses, and for the recoil also the restitution, beside that of the film.
    """
    price = ODD_PRICE * contacts.share + _compare_with_odd(contacts.turn, contacts.turn_std**2)
    if not contacts.of_crowd.any():
        return np.full(len(contacts), np.inf)
    known = np.isfinite(contacts.restitution) & np.isfinite(contacts.restitution_std)
    if quantity == "recoil" and known.any():
        (std, shared), ones = contacts.select(known).split_errors("restitution"), np.ones((int(known.sum()), 1))
        usual = _Fit.of(contacts.restitution[known], std, shared, ones, price[known])
        price[known] += _compare_with_odd(usual.value - usual.predict(), std**2 + usual.scatter**2)
    return np.where(contacts.of_crowd, price, np.inf)


def _compare_with_odd(value: Array, variance: Array) -> Array:
    """By how much, in -2 log likelihood, values about zero are less likely of odd contacts; 0 where not known."""
    odd = variance + ODD_ERROR**2
    return np.nan_to_num(value**2 * (1 / odd - 1 / variance) + np.log(odd / variance))


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
        ContactLaw("Coulomb friction", _across, (("mu", "1"),), _RUBBING, limit=_sticking, of_slip=True),
        ContactLaw(
            "Coulomb friction that falls with the slip speed",
            _across_falling,
            (("mu at the median slip speed", "1"), ("decrease from a speed to e times that", "1")),
            ("falling ball_friction",),
            limit=_sticking,
            contains="Coulomb friction",
            of_slip=True,
        ),
        ContactLaw("a share of the tangential speed stops", _steepness, (("share", "1"),), _RUBBING, of_slip=True),
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


def select_contact_laws(contacts: Contacts, least: int = 8) -> tuple[ContactClaim, ...]:
    """Choose the law of each quantity of the impact that at least `least` contacts show."""
    found = []
    for quantity, laws in LAWS.items():
        value, std = getattr(contacts, quantity), getattr(contacts, f"{quantity}_std")
        usable = np.isfinite(value) & np.isfinite(std)
        if contacts.share[usable].sum() >= least:
            some = contacts.select(usable)
            found.append(_choose_law(quantity, some, _list_laws(quantity, some, laws), least))
    return tuple(found)


def _list_laws(quantity: str, contacts: Contacts, laws: Sequence[ContactLaw]) -> Sequence[ContactLaw]:
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


def _choose_law(quantity: str, contacts: Contacts, laws: Sequence[ContactLaw], least: int) -> ContactClaim:
    policy = current_policy()
    value, (std, shared) = getattr(contacts, quantity), contacts.split_errors(quantity)
    price = price_odd_contacts(contacts, quantity)
    fits = [law.fit(contacts, value, (std, shared), price) for law in laws]
    sign = np.sign(contacts.slip_t) if quantity == "friction" else np.ones(len(value))  # friction opposes the slip
    costs = [f.cost + policy.min_noise_gain * f.design.shape[1] + law.price for f, law in zip(fits, laws, strict=True)]
    sigmas = [
        float(np.sqrt(max(fits[0].cost - fit.cost - law.price, 0.0))) for fit, law in zip(fits, laws, strict=True)
    ]
    recordings = contacts.clip if len(np.unique(contacts.clip)) >= least else np.arange(len(value))
    gains = [fits[0].compare(fit, recordings) for fit in fits]
    usable = [
        gain > 1
        and sigma > policy.min_claim_sigma
        and (quantity == "recoil" or law.has_sign(fit, contacts, sign))
        and law.is_shown(fit, contacts)
        for law, fit, gain, sigma in zip(laws, fits, gains, sigmas, strict=True)
    ]
    best = min((k for k in range(len(fits)) if k == 0 or usable[k]), key=lambda k: costs[k])
    limit = costs[best] + policy.rival_excluded_chi2
    others = [k for k in range(1, len(fits)) if k != best and (usable[k] or laws[k].trials)]
    cost_of = {law.name: cost for law, cost in zip(laws, costs, strict=True)}
    near = [k for k in others if costs[k] < min(limit, cost_of.get(laws[k].contains or "", np.inf))]
    fit, law = fits[best], laws[best]
    wide, own = np.where(fit.odd, np.hypot(fit.std, ODD_ERROR), fit.std), fit.design.any(axis=1)
    if own.all() or not own.any():
        own, safe = np.ones(len(value), dtype=bool), wide
    else:  # a few contacts of one ball cannot tell which of them is odd
        safe = fit.std if quantity == "recoil" else wide
    return ContactClaim(
        quantity=quantity,
        law=law.describe(fit),
        causes=tuple(dict.fromkeys(c for k in (best, *near) for c in laws[k].list_causes(fits[k]))) if best else (),
        numbers=_fit_numbers(fit.value[own], safe[own], shared[own], fit.design[own], law.numbers),
        contacts=round(float(contacts.share.sum())),
        scatter=fit.scatter,
        sigma=sigmas[best],
        left_out_sigma=gains[best],
        rivals=tuple(laws[k].describe(fits[k]) for k in near) if best else (),
        mean=_fit_numbers(value, wide, shared, _ones(contacts), ((f"mean {quantity}", "1"),))[0],
        odd=int(fit.odd.sum()),
    )


def _fit_numbers(
    value: Array, std: Array, shared: Array, design: Array, names: Sequence[tuple[str, str]]
) -> tuple[ContactNumber, ...]:
    if not names:
        return ()
    known = fit_random_effects(value, std, shared, design)
    rows = zip(names, known.coefficients.tolist(), known.std.tolist(), strict=True)
    return tuple(ContactNumber(name, v, s, unit) for (name, unit), v, s in rows)


@dataclass(frozen=True, eq=False)
class _Fit:
    """A regression with the most likely scatter; cost: -2 log likelihood, with the price of odd values."""

    value: Array
    std: Array  # of each value alone, without scatter
    variance: Array  # of each value alone, with the scatter
    shared: Array  # (n, k): the effects of errors that several values share
    design: Array
    scatter: float
    cost: float
    odd: Flags  # (n,): whether a value has a wide error
    odd_price: Array  # (n,): of each value that is odd

    @classmethod
    def of(cls, value: Array, std: Array, shared: Array, design: Array, odd_price: Array) -> _Fit:
        """Fit the scatter, and take values (n,) as odd for their prices, one after the other, while that costs less."""
        odd = odd_price < 0
        fit = cls._of(value, std, shared, design, odd, odd_price)
        while (np.isfinite(odd_price) & ~odd).any():
            one = odd.copy()
            one[np.argmax(np.where(odd, -np.inf, fit._leave_out()[0] - odd_price))] = True
            other = cls._of(value, std, shared, design, one, odd_price)
            if other.cost >= fit.cost:
                break
            fit, odd = other, one
        return fit

    @classmethod
    def _of(cls, value: Array, own: Array, shared: Array, design: Array, odd: Flags, odd_price: Array) -> _Fit:
        std, price = np.where(odd, np.hypot(own, ODD_ERROR), own), float(odd_price[odd].sum())

        def cost(log_scatter: float) -> float:
            return _cost(value, std**2 + np.exp(2 * log_scatter), shared, design)

        size = float(np.std(value[~odd])) + float(np.median(std[~odd])) if not odd.all() else ODD_ERROR
        best = minimize_scalar(cost, bounds=(np.log(1e-4 * size), np.log(10 * size)), method="bounded")
        none = _cost(value, std**2, shared, design)
        scatter = float(np.exp(best.x)) if best.fun < none - 1e-6 else 0.0
        cost_of_fit = min(float(best.fun), none) + price
        return cls(value, own, std**2 + scatter**2, shared, design, scatter, cost_of_fit, odd, odd_price)

    def predict(self) -> Array:
        """Predict the values (n,) by the law."""
        return np.asarray(self.design @ self.coefficients)

    @property
    def coefficients(self) -> Array:
        """The numbers of the law."""
        white = _whiten(self.variance, self.shared, self.value, self.design)[0]
        return np.asarray(np.linalg.lstsq(white[:, 1:], white[:, 0], rcond=None)[0])

    def compare(self, other: _Fit, recordings: Ints) -> float:
        """Sigma, by its scatter between recordings, of the gain of another fit on values that were left out."""
        gain = other._log_densities() - self._log_densities()
        each = np.array([gain[recordings == k].sum() for k in np.unique(recordings)])
        scatter = float(np.std(each, ddof=1)) if len(each) > 1 else 0.0
        return float(each.sum()) / (scatter * len(each) ** 0.5) if scatter > 0 else 0.0

    def _log_densities(self) -> Array:
        """Log predictive density of each value by all others; errors that they share leave its differences alone."""
        squares, share = self._leave_out()
        price = np.where(self.odd, self.odd_price, 0.0)
        return np.asarray(-0.5 * (squares + np.log(self.variance / share) + price))

    def _leave_out(self) -> tuple[Array, Array]:
        """Squared deviations (n,) of values from their predictions by all others, over the variance; and its share."""
        root = 1 / np.sqrt(self.variance)
        q, _ = np.linalg.qr(self.design * root[:, None])
        share = 1 - np.minimum((q**2).sum(axis=1), 0.999)
        left = self.value * root
        left = left - q @ (q.T @ left)
        return np.asarray(left**2 / share), share


def _cost(value: Array, variance: Array, shared: Array, design: Array) -> float:
    white, log_determinant = _whiten(variance, shared, value, design)
    q, _ = np.linalg.qr(white[:, 1:])
    left = white[:, 0] - q @ (q.T @ white[:, 0])
    return float(left @ left + log_determinant)


def _whiten(variance: Array, shared: Array, value: Array, design: Array) -> tuple[Array, float]:
    """Whiten values and design, as columns of one array; and the logarithm of the covariance's determinant."""
    factor = np.linalg.cholesky(np.diag(variance) + shared @ shared.T)
    white = np.linalg.solve(factor, np.column_stack([value, design]))
    return np.asarray(white), float(2 * np.log(np.diag(factor)).sum())
