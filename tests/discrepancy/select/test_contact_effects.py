"""Effects of the impact: contacts that are drawn with a known law, and with none."""

import dataclasses

import numpy as np
import pytest
from tracker_local import draw_rows

from discrepancy.data.contacts import Contacts
from discrepancy.select.contact_effects import examine_contacts
from tracker.measurement.local.local_columns import calibrate_set

ERROR = {"restitution": 0.02, "friction": 0.01, "recoil": 0.01}


def draw(count=60, seed=1, shared=None, **laws):
    """Contacts at 0.3 to 1.5 m/s; laws: functions of the contacts, plus errors and a scatter of twice their size."""
    rng = np.random.default_rng(seed)
    speed, sine = rng.uniform(0.3, 1.5, count), rng.uniform(0.05, 0.8, count)
    values = {
        "clip": np.arange(count),
        "a_strikes": rng.random(count) < 0.5,
        "glides": np.zeros(count, dtype=bool),
        "speed_n": speed * np.sqrt(1 - sine**2),
        "speed_t": speed * sine,
    }
    empty = {f"{name}{end}": np.full(count, 0.8) for name in ERROR for end in ("", "_std")}
    plain = Contacts(**values, **empty, shared=np.zeros((count, 3, 0)))
    usual = {"restitution": lambda c: 0.8, "friction": lambda c: 0.0, "recoil": lambda c: 0.0}
    for name, law in (usual | laws).items():
        own = rng.standard_normal(count) * ERROR[name] * np.sqrt(5)
        values |= {name: law(plain) + own, f"{name}_std": np.full(count, ERROR[name])}
    return Contacts(**values, shared=np.zeros((count, 3, 0)) if shared is None else shared)


def law_of(contacts, quantity):
    return next(claim for claim in examine_contacts(contacts) if claim.quantity == quantity)


@pytest.mark.parametrize(
    ("quantity", "law", "name", "numbers", "cause"),
    [
        (
            "restitution",
            lambda c: 0.85 - 0.12 * c.speed_n,
            "changes with the normal speed",
            (0.85, -0.12),
            "velocity_restitution",
        ),
        ("restitution", lambda c: 0.7 + 0.3 * c.speed_t / c.speed, "changes with the obliqueness", (0.7, 0.3), "hop"),
        ("friction", lambda c: 0.2 * c.speed_t / c.speed, "Coulomb friction", (0.2,), "ball_friction"),
        (
            "friction",
            lambda c: 0.4 * c.speed_t / ((1 + c.restitution) * c.speed_n),
            "a share of the tangential speed stops",
            (0.4,),
            "spin_transfer",
        ),
        ("recoil", lambda c: 0.05, "the struck body seems heavier by a share", (0.05,), "hop"),
        (
            "recoil",
            lambda c: np.where(c.a_strikes, -0.05, 0.05),
            "ball a is heavier by a share",
            (0.05,),
            "mass_mismatch",
        ),
    ],
)
def test_a_law_is_named_with_its_numbers_and_its_scatter(quantity, law, name, numbers, cause):
    claim = law_of(draw(**{quantity: law}), quantity)
    assert claim.law == name
    assert cause in claim.causes
    for found, true in zip(claim.numbers, numbers, strict=True):
        assert abs(found.value - true) < 3.5 * found.std
    assert claim.scatter == pytest.approx(2 * ERROR[quantity], rel=0.4)


def test_laws_that_fit_as_well_are_named_together():
    claim = law_of(draw(friction=lambda c: 0.1 * c.speed_t / c.speed, count=25, seed=3), "friction")
    assert {"ball_friction", "spin_transfer"} <= set(claim.causes)
    assert claim.rivals


def test_nothing_is_named_where_nothing_is_hidden():
    named = [claim.causes for seed in range(40) for claim in examine_contacts(draw(seed=seed)) if claim.causes]
    assert len(named) <= 4  # of 120 claims; each has two or three laws to try at 3 sigma


def test_few_contacts_name_nothing():
    assert examine_contacts(draw(count=6, restitution=lambda c: 0.9 - 0.3 * c.speed_n)) == ()


def test_the_bias_of_a_set_does_not_average_out():
    rows = calibrate_set(draw_rows(40, 0.003, 0.003, bias=-0.02, seed=1))
    more = {"striker": "b", "b_local": 0.01, "b_local_std": 0.01}
    contacts = Contacts.of([row | more | {"clip": k} for k, row in enumerate(rows)])
    restitution, recoil = (law_of(contacts, quantity) for quantity in ("restitution", "recoil"))
    assert abs(restitution.mean.value - 0.8) < 3 * restitution.mean.std
    assert not recoil.causes  # the bias and the recoil are the same balance
    assert recoil.mean.std > 0.015


def test_one_film_of_many_contacts_shows_a_law():
    contacts = draw(restitution=lambda c: 0.95 - 0.2 * c.speed_n)
    one_film = dataclasses.replace(contacts, clip=np.zeros(len(contacts), dtype=int))
    assert law_of(one_film, "restitution").causes == ("velocity_restitution",)


def test_an_effect_of_three_sigma_is_not_named():
    shown = [law_of(draw(seed=k, recoil=lambda c: 0.0095, count=60), "recoil") for k in range(10)]
    assert all(claim.sigma > 4 for claim in shown if claim.causes)
    assert sum(not claim.causes for claim in shown) >= 6
