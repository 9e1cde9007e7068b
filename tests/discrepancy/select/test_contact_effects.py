"""Effects of the impact: contacts that are drawn with a known law, and with none."""

import dataclasses

import numpy as np
import pytest
from tracker_local import draw_rows

from discrepancy.data.contacts import Contacts
from discrepancy.data.momentum_balances import MomentumBalance
from discrepancy.select.contact_effects import select_contact_laws
from tracker.measurement.local.local_columns import calibrate_set

ERROR = {"restitution": 0.02, "friction": 0.01, "recoil": 0.01}


def draw(count=60, seed=1, shared=None, **laws):
    """Contacts at 0.3 to 1.5 m/s; laws: functions of the contacts, plus errors and a scatter of twice their size."""
    rng = np.random.default_rng(seed)
    speed, sine = rng.uniform(0.3, 1.5, count), rng.uniform(0.05, 0.8, count)
    values = {
        "clip": np.arange(count),
        "bodies": np.full((count, 2), -1),
        "levers": np.tile([1.0, -1.0], (count, 1)),
        "share": np.ones(count),
        "a_strikes": rng.random(count) < 0.5,
        "glides": np.zeros(count, dtype=bool),
        "speed_n": speed * np.sqrt(1 - sine**2),
        "speed_t": speed * sine,
        "slip_t": speed * sine,
        "slip_t_std": np.zeros(count),
        "slip_down": speed * np.sqrt(1 - sine**2),
        "slip_down_std": np.zeros(count),
        "slip": speed,
    }
    values |= {name: np.full(count, np.nan) for name in ("turn", "turn_std")}
    empty = {f"{name}{end}": np.full(count, 0.8) for name in ERROR for end in ("", "_std")}
    shared = np.zeros((count, 3, 0)) if shared is None else shared
    plain = Contacts(**values, **empty, shared=shared, shared_of_recoil=shared[:, 2])
    usual = {"restitution": lambda c: 0.8, "friction": lambda c: 0.0, "recoil": lambda c: 0.0}
    for name, law in (usual | laws).items():
        own = rng.standard_normal(count) * ERROR[name] * np.sqrt(5)
        values |= {name: law(plain) + own, f"{name}_std": np.full(count, ERROR[name])}
    return Contacts(**values, shared=shared, shared_of_recoil=shared[:, 2])


def law_of(contacts, quantity):
    return next(claim for claim in select_contact_laws(contacts) if claim.quantity == quantity)


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


def test_friction_that_grows_with_the_slip_speed_does_not_fall():
    """Fast strikers that slide rub more in the plane, since their surfaces move down less than those that roll."""
    claim = law_of(draw(friction=lambda c: (0.3 + 0.15 * np.log(c.speed)) * c.speed_t / c.speed), "friction")
    assert claim.law == "Coulomb friction"
    assert "falling ball_friction" not in claim.causes


def test_nothing_is_named_where_nothing_is_hidden():
    named = [claim.causes for seed in range(40) for claim in select_contact_laws(draw(seed=seed)) if claim.causes]
    assert len(named) <= 4  # of 120 claims; each has two or three laws to try at 3 sigma


def test_few_contacts_name_nothing():
    assert select_contact_laws(draw(count=6, restitution=lambda c: 0.9 - 0.3 * c.speed_n)) == ()


def test_the_bias_of_a_set_does_not_average_out():
    rows = calibrate_set(draw_rows(40, 0.003, 0.003, bias=-0.02, seed=1))
    more = {"striker": "b", "b_local": 0.01, "b_local_std": 0.01}
    contacts = Contacts.of([row | more | {"clip": k} for k, row in enumerate(rows)])
    restitution, recoil = (law_of(contacts, quantity) for quantity in ("restitution", "recoil"))
    assert abs(restitution.mean.value - 0.8) < 3 * restitution.mean.std
    assert not recoil.causes  # the bias and the recoil are the same balance
    assert recoil.mean.std > 0.015


@pytest.mark.parametrize(
    ("bias", "law", "causes"),
    [
        (-0.15, "the struck body seems heavier by a share", ("mass_mismatch", "hop")),
        (0.15, "the struck body seems lighter by a share", ("mass_mismatch",)),  # a hop takes momentum away
    ],
)
def test_a_bias_beyond_errors_of_velocities_is_a_mass(bias, law, causes):
    """The same body strikes in all hits. No tracker errs by 15 % of the normal speed."""
    rows = calibrate_set(draw_rows(40, 0.003, 0.003, bias=bias, seed=1))
    more = {"striker": "b", "b_local": 0.01, "b_local_std": 0.01}
    recoil = law_of(Contacts.of([row | more | {"clip": k} for k, row in enumerate(rows)]), "recoil")
    assert (recoil.law, recoil.causes) == (law, causes)
    assert recoil.numbers[0].std == pytest.approx(0.025 * 2 / 1.8, rel=0.2)


def test_one_film_of_many_contacts_shows_a_law():
    contacts = draw(restitution=lambda c: 0.95 - 0.2 * c.speed_n)
    one_film = dataclasses.replace(contacts, clip=np.zeros(len(contacts), dtype=int))
    assert law_of(one_film, "restitution").causes == ("velocity_restitution",)


def test_an_effect_of_three_sigma_is_not_named():
    shown = [law_of(draw(seed=k, recoil=lambda c: 0.0095, count=60), "recoil") for k in range(10)]
    assert all(claim.sigma > 4 for claim in shown if claim.causes)
    assert sum(not claim.causes for claim in shown) >= 6


def crowd(contacts, balls=20, seed=2):
    """The same contacts as those of one film of so many balls."""
    rng = np.random.default_rng(seed)
    pairs = np.array([rng.permutation(balls)[:2] for _ in range(len(contacts))])
    return dataclasses.replace(contacts, clip=np.zeros(len(contacts), dtype=int), bodies=pairs)


def make_heavier(contacts, ball, share):
    """Contacts in which this ball recoils as if its mass had so much more logarithm."""
    struck, striking = contacts.bodies.T
    return dataclasses.replace(contacts, recoil=contacts.recoil + share * ((struck == ball) * 1.0 - (striking == ball)))


def test_one_heavier_ball_of_a_crowd_is_named():
    contacts = make_heavier(crowd(draw()), 7, 0.2)
    assert (contacts.bodies == 7).sum() > 4
    claim = law_of(contacts, "recoil")
    assert (claim.law, claim.causes) == ("ball 7 is heavier by a share", ("mass_mismatch",))
    assert abs(claim.numbers[0].value - 0.2) < 3.5 * claim.numbers[0].std
    two_films = dataclasses.replace(contacts, clip=np.arange(len(contacts)) % 2)
    assert not law_of(two_films, "recoil").causes  # its tracks are other balls in the other film


def test_contacts_of_the_heavier_ball_that_disagree_widen_its_error():
    """The most precise of them is wrong, as in a rendered film, so that the right one seems odd."""
    contacts = crowd(draw())
    rows = np.flatnonzero((contacts.bodies == 7).any(axis=1))
    kept = np.ones(len(contacts), dtype=bool)
    kept[rows[4:]] = False
    side = np.where(contacts.bodies[rows[:4], 0] == 7, 1.0, -1.0)
    recoil, std = contacts.recoil / np.sqrt(5), contacts.recoil_std.copy()  # no scatter beside the errors
    recoil[rows[:4]], std[rows[:4]] = side * [0.201, 0.123, 0.183, 0.264], [0.005, 0.038, 0.040, 0.013]
    claim = law_of(dataclasses.replace(contacts, recoil=recoil, recoil_std=std).select(kept), "recoil")
    assert claim.law == "ball 7 is heavier by a share"
    assert abs(claim.numbers[0].value - np.log(1.3)) < 3 * claim.numbers[0].std


def draw_two_of_the_heavier_ball(turn):
    """A crowd of 42 contacts with errors of 0.02, of which ball 40 has two; turn: of the impulses of these."""
    film = crowd(draw(count=42, seed=5), balls=30)
    values = {name: getattr(film, name) / np.sqrt(5) for name in ("recoil",)} | {"recoil_std": np.full(42, 0.02)}
    bodies, turns = film.bodies.copy(), 0.02 * np.random.default_rng(3).standard_normal(42)
    bodies[[7, 30], [0, 1]], turns[[7, 30]] = 40, turn
    film = dataclasses.replace(film, **values, bodies=bodies, turn=turns, turn_std=np.full(42, 0.02))
    return make_heavier(film, 40, np.log(1.3))


def test_two_contacts_show_the_heavier_ball_by_impulses_that_are_opposite():
    """A third body would turn them by 0.3. So an angle of 0.01(2) makes either contact the less likely an odd one."""
    shown = law_of(draw_two_of_the_heavier_ball(0.01), "recoil")
    assert shown.law == "ball 40 is heavier by a share"
    unknown = dataclasses.replace(draw_two_of_the_heavier_ball(0.01), turn=np.full(42, np.nan))
    gain = 2 * (np.log((0.02**2 + 0.3**2) / 0.02**2) - 0.01**2 * (1 / 0.02**2 - 1 / (0.02**2 + 0.3**2)))
    assert shown.sigma**2 - law_of(unknown, "recoil").sigma ** 2 == pytest.approx(gain)
    assert not law_of(draw_two_of_the_heavier_ball(0.3), "recoil").causes


def test_an_odd_restitution_makes_a_contact_odd():
    film = draw_two_of_the_heavier_ball(0.01)
    restitution = film.restitution.copy()
    restitution[[7, 30]] -= 0.3
    assert not law_of(dataclasses.replace(film, restitution=restitution), "recoil").causes


def draw_group(balls, seed, std=0.16):
    """A group of contacts of equal balls, of which each would show its mass by a component of its own."""
    levers = np.zeros((len(balls), 2))
    levers[:2] = [[0.8, 0.3], [0.3, -0.8]]
    gained = std * np.random.default_rng(seed).standard_normal(2)
    return MomentumBalance(np.arange(2), gained, std, np.array(balls), levers)


def draw_one_contact_of_the_heavier_ball(seed, balls=(41, 3, 5)):
    """A crowd of 42 contacts with errors of 0.008, in which ball 40 is heavier and meets 41 once; and a group."""
    film = crowd(draw(count=42, seed=seed), balls=30, seed=seed)
    bodies = film.bodies.copy()
    bodies[7] = 40, 41
    recoil = film.recoil / (ERROR["recoil"] * np.sqrt(5)) * 0.008
    film = dataclasses.replace(film, bodies=bodies, recoil=recoil, recoil_std=np.full(42, 0.008))
    film = dataclasses.replace(film, turn=np.full(42, 0.01), turn_std=np.full(42, 0.02))
    return make_heavier(film, 40, np.log(1.3)).with_balances(0, [draw_group(balls, seed)])


def test_one_contact_and_a_group_that_shows_nothing_name_no_ball():
    """The noise of this group agrees with a ball 41 that is lighter by 30 %."""
    claim = law_of(draw_one_contact_of_the_heavier_ball(5), "recoil")
    assert not claim.causes
    assert claim.contacts == 43  # the group counts once


def test_a_ball_that_meets_the_heavier_one_alone_is_named_with_it():
    """Both contacts of ball 40 are with 41, so that 41 may be lighter by as much."""
    film = draw_two_of_the_heavier_ball(0.01)
    bodies = film.bodies.copy()
    bodies[[7, 30], [1, 0]] = 41
    claim = law_of(dataclasses.replace(film, bodies=bodies), "recoil")
    either = {"ball 40 is heavier by a share", "ball 41 is lighter by a share"}
    assert {claim.law, *claim.rivals} == either
    assert (claim.numbers[0].value > 0) == ("heavier" in claim.law)


def test_groups_alone_are_as_many_contacts_as_there_are_groups():
    none = draw(count=3).select(np.zeros(3, dtype=bool))
    groups = [draw_group((2 * k, 2 * k + 1), k) for k in range(8)]
    assert select_contact_laws(none.with_balances(0, groups[:4])) == ()
    assert law_of(none.with_balances(0, groups), "recoil").contacts == 8


def test_contacts_of_a_crowd_say_nothing_about_ball_a_of_a_pair():
    pairs = draw(recoil=lambda c: np.where(c.a_strikes, -0.06, 0.06))
    balls = crowd(draw(seed=4))
    names = [f.name for f in dataclasses.fields(Contacts)]
    both = Contacts(**{name: np.concatenate([getattr(pairs, name), getattr(balls, name)]) for name in names})
    (number,) = law_of(both, "recoil").numbers
    assert law_of(both, "recoil").law == "ball a is heavier by a share"
    assert abs(number.value - 0.06) < 3 * number.std < 0.02


def test_no_ball_of_an_equal_crowd_is_named():
    """The recoil scatters from contact to contact by four times its error."""
    for seed in range(12):
        film = crowd(draw(count=60, seed=seed), balls=12, seed=seed)
        assert not law_of(dataclasses.replace(film, recoil=2 * film.recoil), "recoil").causes


def test_a_gain_that_the_best_of_thirty_balls_may_reach_by_chance_names_none():
    """One ball alone would be named at 4.7 sigma, and 2 ln 30 of the gain is the price of the choice."""
    equal = crowd(draw(count=80), balls=30)
    equal = dataclasses.replace(equal, recoil=equal.recoil_std * np.where(np.arange(80) % 2, 1.0, -1.0))
    chance, shown = (law_of(make_heavier(equal, 7, share), "recoil") for share in (0.022, 0.026))
    assert not chance.causes
    assert shown.law == "ball 7 is heavier by a share"
    assert shown.sigma == pytest.approx(np.sqrt(5.63**2 - 2 * np.log(30)), abs=0.1)


def test_contacts_that_a_third_body_disturbs_hide_no_law():
    contacts = crowd(draw(restitution=lambda c: 0.95 - 0.12 * c.speed_n))
    disturbed = contacts.restitution.copy()
    disturbed[[3, 30, 44]] -= [0.4, 0.3, 0.5]
    claim = law_of(dataclasses.replace(contacts, restitution=disturbed), "restitution")
    assert claim.causes == ("velocity_restitution",)
    assert claim.odd == 3
    assert abs(claim.numbers[1].value + 0.12) < 3.5 * claim.numbers[1].std
    alone = dataclasses.replace(contacts, restitution=disturbed, bodies=np.full_like(contacts.bodies, -1))
    assert law_of(alone, "restitution").odd == 0  # two bodies that meet alone have no third one


def test_friction_against_the_velocity_across_is_that_of_a_turning_ball():
    """A ball that turns fast drags the other along; friction then has the sign of the slip, not of the velocity."""
    contacts = draw(friction=lambda c: 0.2 * c.speed_t / c.speed)
    signs = np.where(np.arange(len(contacts)) % 2, 1.0, -1.0)
    turned = dataclasses.replace(contacts, slip_t=signs * contacts.slip_t, friction=signs * contacts.friction)
    claim = law_of(turned, "friction")
    assert claim.law == "Coulomb friction"
    assert claim.numbers[0].value == pytest.approx(law_of(contacts, "friction").numbers[0].value)


@pytest.mark.parametrize("seed", [2, 3])
def test_surfaces_that_stick_hide_no_friction_that_falls(seed):
    """Friction stops slow surfaces early, so that it is less there than Coulomb's law says."""

    def find_friction(contacts):
        coulomb = (0.2 - 0.15 * np.log(contacts.slip / 0.8)) * contacts.slip_t / contacts.slip
        return np.minimum(coulomb, 2 / 7 * contacts.slip_t / (1.8 * contacts.speed_n))

    contacts = crowd(draw(count=24, seed=seed, friction=find_friction))
    true = find_friction(contacts)
    claim = law_of(dataclasses.replace(contacts, friction=true + (contacts.friction - true) / 5), "friction")
    assert claim.law == "Coulomb friction that falls with the slip speed"
    truth = 0.2 - 0.15 * np.log(np.median(contacts.slip) / 0.8), 0.15
    for number, expected in zip(claim.numbers, truth, strict=True):
        assert abs(number.value - expected) < min(3 * number.std, 0.04)


def draw_with_uncertain_slips(mu, seed, count=60):
    """A crowd with friction mu(slip). The true slips scatter about the traced ones by 0.01 to 0.3 m/s."""
    rng = np.random.default_rng(seed)
    film = crowd(draw(count=count, seed=seed), seed=seed)
    std = np.geomspace(0.01, 0.3, count)[rng.permutation(count)]
    seen, down = rng.normal(0, 0.25, count), rng.uniform(0.02, 0.3, count)
    across = seen + std * rng.standard_normal(count)
    law = np.minimum(
        mu(np.hypot(across, down)) * np.abs(across) / np.hypot(across, down),
        2 / 7 * np.abs(across) / ((1 + film.restitution) * film.speed_n),
    )
    values = {"slip_t": seen, "slip_t_std": std, "slip_down": down, "slip": np.hypot(seen, down)}
    values |= {"friction": np.sign(across) * law + 0.01 * rng.standard_normal(count)}
    return dataclasses.replace(film, **values, friction_std=np.full(count, 0.01))


def test_slips_with_errors_show_friction_that_falls():
    films = [draw_with_uncertain_slips(lambda u: 0.03 + 0.4 * np.exp(-u / 0.12), seed) for seed in range(6)]
    as_if_known = [dataclasses.replace(film, slip_t_std=np.zeros(len(film))) for film in films]
    named, by_wrong_errors = (
        sum("falling ball_friction" in law_of(film, "friction").causes for film in some)
        for some in (films, as_if_known)
    )
    assert named == 6
    assert by_wrong_errors < 5


def test_a_fall_that_friction_does_not_show_is_no_rival():
    """Coulomb friction that falls contains Coulomb friction, so that it always fits as well."""
    films = [draw_with_uncertain_slips(lambda u: 0.1 + 0 * u, seed) for seed in range(6)]
    claims = [law_of(film, "friction") for film in films]
    assert all("ball_friction" in claim.causes for claim in claims)
    assert not any("falling ball_friction" in claim.causes for claim in claims)


def test_errors_of_slips_do_not_bias_the_friction():
    claims = [law_of(draw_with_uncertain_slips(lambda u: 0.1 + 0 * u, seed), "friction") for seed in range(6)]
    off = np.array([(claim.numbers[0].value - 0.1) / claim.numbers[0].std for claim in claims])
    assert np.abs(off).max() < 3
    assert all(claim.numbers[0].std < 0.012 for claim in claims)
