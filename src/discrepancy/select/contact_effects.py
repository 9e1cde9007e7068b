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

Two rolling balls that meet alone may have an unseen spin, as `unseen_spin` says. It costs one number more. A law with
such a spin must also predict contacts that are left out better than each law without it, by more than one standard
error. Here a quarter of the recordings is left out at a time, and everything is fitted again without it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from discrepancy.data.contacts import Contacts
from discrepancy.policy import current_policy
from discrepancy.select.contact_regression import ODD_ERROR, Regression, find_gain_sigma
from discrepancy.select.impact_laws import LAWS, LAWS_WITH_SPIN, ContactLaw, SpinLaw, list_laws
from discrepancy.select.unseen_spin import FrictionFit, predict_left_out
from synthcam_shared.arrays import Array, Ints
from tracker.measurement.random_effects import fit_random_effects

# Price of an odd contact in -2 log likelihood. A third body disturbs 5 %: 2 of 48 and 1 of 33 in two films of thirty.
ODD_PRICE = 2 * math.log(1 / 0.05 - 1)


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
    excluded: laws of other causes that are worse by that, and that could be named alone. The law does not contain them.
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
    excluded: tuple[str, ...] = ()


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
        usual = Regression.of(contacts.restitution[known], std, shared, ones, price[known])
        price[known] += _compare_with_odd(usual.value - usual.predict(), std**2 + usual.scatter**2)
    return np.where(contacts.of_crowd, price, np.inf)


def _compare_with_odd(value: Array, variance: Array) -> Array:
    """By how much, in -2 log likelihood, values about zero are less likely of odd contacts; 0 where not known."""
    odd = variance + ODD_ERROR**2
    return np.nan_to_num(value**2 * (1 / odd - 1 / variance) + np.log(odd / variance))


def select_contact_laws(contacts: Contacts, least: int = 8) -> tuple[ContactClaim, ...]:
    """Choose the law of each quantity of the impact that at least `least` contacts show."""
    found = []
    for quantity, laws in LAWS.items():
        value, std = getattr(contacts, quantity), getattr(contacts, f"{quantity}_std")
        usable = np.isfinite(value) & np.isfinite(std)
        if contacts.share[usable].sum() >= least:
            some = contacts.select(usable)
            found.append(_choose_law(quantity, some, list_laws(quantity, some, laws), least))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A fitted law of a quantity, as it is compared with the others.

    cost: -2 log likelihood, with the prices of its numbers and of the choice. wide: the standard error (n,) of each
    contact. usable: whether it may be named.
    """

    name: str
    causes: tuple[str, ...]
    contains: tuple[str, ...]
    cost: float
    sigma: float
    left_out_sigma: float
    usable: bool
    one_of_several: bool
    scatter: float
    wide: Array
    odd: int
    measure: Callable[[], tuple[ContactNumber, ...]]


def _choose_law(quantity: str, contacts: Contacts, laws: Sequence[ContactLaw], least: int) -> ContactClaim:
    tried = _fit_laws(quantity, contacts, laws, least)
    if quantity == "friction" and not (contacts.of_crowd | contacts.glides).any():
        tried += _fit_laws_with_spin(contacts, laws, tried, least)
    best = min((one for one in tried if one.usable), key=lambda one: one.cost)
    limit, cost_of = best.cost + current_policy().rival_excluded_chi2, {one.name: one.cost for one in tried}
    others = [
        one
        for one in tried[1:]
        if one is not best
        and (one.usable or one.one_of_several)
        and one.cost < min((cost_of[name] for name in one.contains), default=np.inf)
    ]
    near = [one for one in others if one.cost < limit]
    causes = dict.fromkeys(cause for one in (best, *near) for cause in one.causes)
    rest = [one for one in others if one.usable and one not in near and one.name not in best.contains]
    far = [one for one in rest if not causes.keys() >= set(one.causes)]
    named = best is not tried[0]
    (mean,) = _fit_numbers(
        getattr(contacts, quantity),
        best.wide,
        contacts.split_errors(quantity)[1],
        np.ones((len(contacts), 1)),
        ((f"mean {quantity}", "1"),),
    )
    return ContactClaim(
        quantity=quantity,
        law=best.name,
        causes=tuple(causes) if named else (),
        numbers=best.measure(),
        contacts=round(float(contacts.share.sum())),
        scatter=best.scatter,
        sigma=best.sigma,
        left_out_sigma=best.left_out_sigma,
        rivals=tuple(one.name for one in near) if named else (),
        mean=mean,
        odd=best.odd,
        excluded=tuple(one.name for one in far) if named else (),
    )


def _fit_laws(quantity: str, contacts: Contacts, laws: Sequence[ContactLaw], least: int) -> list[_Candidate]:
    """Fit the laws without an unseen spin; the first, and simplest, is always usable."""
    policy, (std, shared) = current_policy(), contacts.split_errors(quantity)
    value, price = getattr(contacts, quantity), price_odd_contacts(contacts, quantity)
    recordings = _number_recordings(contacts, least)
    fits = [law.fit(contacts, value, (std, shared), price) for law in laws]
    sign = np.sign(contacts.slip_t) if quantity == "friction" else np.ones(len(value))  # friction opposes the slip
    out: list[_Candidate] = []
    for law, fit in zip(laws, fits, strict=True):
        sigma = float(np.sqrt(max(fits[0].cost - fit.cost - law.price, 0.0)))
        gain = fits[0].compare(fit, recordings)
        signed = quantity == "recoil" or law.has_sign(fit, contacts, sign)
        shown = gain > 1 and sigma > policy.min_claim_sigma and signed and law.is_shown(fit, contacts)
        one = _Candidate(
            name=law.describe(fit),
            causes=law.list_causes(fit),
            contains=(law.contains,) if law.contains else (),
            cost=fit.cost + policy.min_noise_gain * fit.design.shape[1] + law.price,
            sigma=sigma,
            left_out_sigma=gain,
            usable=not out or shown,
            one_of_several=law.trials > 0,
            scatter=fit.scatter,
            wide=np.where(fit.odd, np.hypot(fit.std, ODD_ERROR), fit.std),
            odd=int(fit.odd.sum()),
            measure=partial(_measure_numbers, quantity, law, fit),
        )
        out.append(one)
    return out


def _measure_numbers(quantity: str, law: ContactLaw, fit: Regression) -> tuple[ContactNumber, ...]:
    wide, own = np.where(fit.odd, np.hypot(fit.std, ODD_ERROR), fit.std), fit.design.any(axis=1)
    if own.all() or not own.any():
        own, safe = np.ones(len(wide), dtype=bool), wide
    else:  # a few contacts of one ball cannot tell which of them is odd
        safe = fit.std if quantity == "recoil" else wide
    return _fit_numbers(fit.value[own], safe[own], fit.shared[own], fit.design[own], law.numbers)


def _measure_with_spin(law: SpinLaw, fit: FrictionFit) -> tuple[ContactNumber, ...]:
    rows = zip(law.numbers, [*fit.numbers, fit.width], fit.std, strict=True)
    return tuple(ContactNumber(name, float(value), float(std), unit) for (name, unit), value, std in rows)


def _number_recordings(contacts: Contacts, least: int) -> Ints:
    """Number the recordings (n,) of contacts; with fewer than `least`, each contact counts as one."""
    several = len(np.unique(contacts.clip)) >= least
    return np.unique(contacts.clip, return_inverse=True)[1] if several else np.arange(len(contacts))


def _fit_laws_with_spin(
    contacts: Contacts, laws: Sequence[ContactLaw], plain: Sequence[_Candidate], least: int
) -> list[_Candidate]:
    """Fit laws of the friction with an unseen spin of the striker.

    A law without a spin must pay its price. Else any scatter that has a limit could pass for friction beside a spin.
    """
    if min(one.cost for one in plain[1:]) >= plain[0].cost:
        return []
    policy, errors = current_policy(), contacts.split_errors("friction")
    cost_of = {one.name: one.cost for one in plain}
    compare = _compare_left_out((*laws, *LAWS_WITH_SPIN), contacts, _number_recordings(contacts, least))
    out: list[_Candidate] = []
    for law in LAWS_WITH_SPIN:
        fit = FrictionFit.of(law.friction, contacts, errors, spins=True)
        cost = fit.cost + policy.min_noise_gain * len(fit.std)
        sigma = float(np.sqrt(max(plain[0].cost - fit.cost, 0.0)))
        pays = cost < min(cost_of[name] for name in law.contains)
        others = dict.fromkeys([*(one.name for one in plain), *law.contains])  # the simplest law first
        matters = pays and sigma > policy.min_claim_sigma and law.has_sign(fit)
        gains = [compare(law.name, other) for other in others] if matters else [0.0]
        cost_of[law.name] = cost
        one = _Candidate(
            name=law.name,
            causes=law.causes,
            contains=law.contains,
            cost=cost,
            sigma=sigma,
            left_out_sigma=gains[0],
            usable=min(gains) > 1,
            one_of_several=False,
            scatter=fit.scatter,
            wide=errors[0],
            odd=0,
            measure=partial(_measure_with_spin, law, fit),
        )
        out.append(one)
    return out


def _compare_left_out(
    laws: Sequence[ContactLaw | SpinLaw], contacts: Contacts, recordings: Ints
) -> Callable[[str, str], float]:
    """Make a function that gives the sigma of a law's gain over another, by their names, on recordings left out."""
    fits = {law.name: law.fit_and_predict for law in laws}

    @cache
    def predict(name: str) -> Array:
        return predict_left_out(contacts, recordings, fits[name])

    return lambda law, other: find_gain_sigma(predict(law) - predict(other), recordings)


def _fit_numbers(
    value: Array, std: Array, shared: Array, design: Array, names: Sequence[tuple[str, str]]
) -> tuple[ContactNumber, ...]:
    if not names:
        return ()
    known = fit_random_effects(value, std, shared, design)
    rows = zip(names, known.coefficients.tolist(), known.std.tolist(), strict=True)
    return tuple(ContactNumber(name, v, s, unit) for (name, unit), v, s in rows)
