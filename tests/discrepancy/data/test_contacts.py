"""Contacts from rows of the estimates: an impact of two discs that is computed by hand."""

import json

import numpy as np
import pytest

import tracker
from benchmarks.search.crowd_laws import COULOMB, make_tray, search_film
from discrepancy.data.contacts import Contacts, read_contacts
from discrepancy.select.contact_effects import select_contact_laws

# A disc of 1 kg meets one of 2 kg at rest with 0.8 m/s along the line of centres and 0.6 m/s across it. r is 0.5, and a
# third of the tangential velocity stops: impulses 0.8 and 0.1333 N s.
ROW = {"clip": 4, "striker": "b", "motion_local": "glide", "v0_local": 1.0, "b_local": 0.6, "r_local": 0.5}
ROW |= {"s_local": 2 / 3, "mass_ratio": 2.1, "status": "misfit", "local": "{}", "local_shared": "{}"}
ROW |= {f"{name}_std": 0.01 for name in ("v0_local", "b_local", "r_local", "s_local", "mass_ratio")}


def test_quantities_of_an_impact():
    both = Contacts.of([ROW, ROW | {"striker": "a"}], {4: 2.0})
    assert both.speed_n == pytest.approx(0.8)
    assert both.speed_t == pytest.approx(0.6)
    assert both.friction == pytest.approx(0.1333 / 0.8, rel=1e-3)
    assert both.recoil == pytest.approx(np.log([2.1 / 2, 2.1 / 0.5]))


@pytest.mark.parametrize("gliding", [2, 4])
def test_two_hits_of_twelve_that_seem_to_glide_roll_as_the_others_do(gliding):
    """A rolling striker's surface moves down with the speed of approach, 0.8 m/s."""
    rolling = ROW | {"motion_local": "slide and roll"}
    some = Contacts.of([ROW] * gliding + [rolling] * (12 - gliding))
    assert some.glides.sum() == (0 if gliding == 2 else 4)
    assert some.slip_down[0] == pytest.approx(0.8 if gliding == 2 else 0.0)


@pytest.mark.parametrize("angle", [0.0, 0.2])
def test_the_turn_of_two_impulses_is_the_angle_between_them_whatever_the_masses(angle):
    """The struck disc gets 0.4 m/s along x, the striking one loses 0.8 m/s in a direction at this angle."""
    lost = 0.8 * np.array([np.cos(angle), np.sin(angle)])
    velocities = {"1i": (0.1, 0.0), "2i": (1.0, 0.3), "1o": (0.5, 0.0), "2o": np.array([1.0, 0.3]) - lost}
    row = ROW | {f"v{k}{axis}_local": v for k, pair in velocities.items() for axis, v in zip("xy", pair, strict=True)}
    row |= {f"v{k}{axis}_local_std": 0.01 for k in velocities for axis in "xy"}
    row |= {"balance_t_local": 0.0, "balance_t_local_std": 0.02}
    (turn,), (std,) = (getattr(Contacts.of([row]), name) for name in ("turn", "turn_std"))
    assert turn == pytest.approx(np.sin(angle))
    assert std == pytest.approx(0.02 / np.sqrt(0.4 * 0.8))


def test_a_quantity_that_the_tracks_do_not_show_is_nan():
    some = Contacts.of([ROW | {"s_local": np.nan}, ROW | {"v0_local": np.nan}])
    assert len(some) == 1
    assert np.isnan(some.friction[0])
    assert some.restitution[0] == 0.5


def test_a_table_of_tracks_has_no_contacts(tmp_path):
    assert len(read_contacts(tmp_path / "tracks.csv")) == 0
    assert len(read_contacts([])) == 0


@pytest.mark.parametrize(
    "fault",
    [
        {"r_local": 1.3},
        {"mass_ratio": 90.0},
        {"status": "stay_together"},
        {"local_hits": 20, "balance_n_local": 0.2, "balance_n_local_std": 0.01},
    ],
)
def test_a_contact_without_a_usable_local_estimate_is_left_out(fault):
    assert len(Contacts.of([ROW, ROW | fault])) == 1


@pytest.mark.parametrize("misfit", [False, True])
def test_a_contact_of_a_crowd_that_no_free_motion_describes_is_left_out(misfit):
    """A third ball that hits one of both makes their recoil wrong by five claimed errors."""
    row = ROW | {"status": "crowd", "particle1": 3, "particle2": 8, "collision": 0, "misfit_local": misfit}
    assert len(Contacts.of([ROW, row])) == 2 - misfit


def test_shared_errors_follow_into_each_quantity():
    shared = {"fps": {"of": 50.0, "effect": {"b": 0.004, "r": 0.003, "s": -0.005, "mass_ratio": 0.02}}}
    given = ROW | {"local_shared": json.dumps(shared)}
    contacts = Contacts.of([given, given])
    moved = {f"{n}_local" if n != "mass_ratio" else n: v for n, v in shared["fps"]["effect"].items()}
    after = Contacts.of([ROW | {name: ROW[name] + v for name, v in moved.items()}])
    for k, name in enumerate(("restitution", "friction", "recoil")):
        change = (getattr(after, name) - getattr(contacts, name)[:1])[0]
        assert contacts.shared[0, k, 0] == pytest.approx(change, rel=0.03)


def test_a_contact_keeps_an_error_of_its_own_where_what_it_shares_is_larger():
    shared = {"friction": {"of": 0.2, "effect": {"r": 0.02}}}  # twice the error of r
    row = ROW | {"local_shared": json.dumps(shared), "status": "crowd", "particle1": 3, "particle2": 8, "collision": 0}
    contacts = Contacts.of([row, row])
    own, effects = contacts.split_errors("restitution")
    assert (own > 0.003).all()
    assert own**2 + effects[:, 0] ** 2 == pytest.approx(contacts.restitution_std**2, rel=0.01)


def test_the_error_of_the_friction_has_that_of_the_impact_parameter():
    exact = ROW | {"s_local_std": 1e-9, "r_local_std": 1e-9}
    one, other = Contacts.of([exact, exact | {"b_local": 0.61}]).friction
    assert Contacts.of([exact]).friction_std[0] == pytest.approx(abs(other - one), rel=0.03)


@pytest.mark.gate
@pytest.mark.parametrize(("share", "seed"), [(0.3, 1), (0.3, 2), (0.3, 42), (0.0, 1)])
def test_one_film_of_thirty_balls_shows_the_one_that_is_heavier(share, seed):
    """Ball 0 has 30 % more mass."""
    scene = make_tray(share)
    true, rng = scene.draw(seed=seed).tracks, np.random.default_rng(seed)
    x, y = (true[f"{axis}_mean_px"] + 0.05 * rng.standard_normal(len(true)) for axis in "xy")
    table = true[["frame", "particle"]].assign(x=x, y=y, x_std=0.05, y_std=0.05, cov_xy=0.0)
    result = tracker.measure(table, scene.draw(seed=seed).camera_json)
    claims = {claim.quantity: claim for claim in select_contact_laws(read_contacts([result]))}
    recoil = claims["recoil"]
    assert recoil.causes == (("mass_mismatch",) if share else ())
    assert not claims["restitution"].causes
    if share:
        heavy = result.tracks.particle[np.hypot(result.tracks.x - x[0], result.tracks.y - y[0]).idxmin()]
        assert recoil.law == f"ball {heavy} is heavier by a share"
        size = recoil.numbers[0]
        assert abs(size.value - np.log(1 + share)) < min(0.02, 3 * size.std)
        assert size.std < 0.03
        assert not recoil.rivals
    else:
        assert abs(recoil.mean.value) < 3 * recoil.mean.std < 0.018  # slides against the kick alone: 0.022


@pytest.mark.gate
@pytest.mark.parametrize(("kind", "seed"), [("falling", 210), ("coulomb", 34)])
def test_one_film_of_36_balls_shows_whether_their_friction_falls(kind, seed):
    """In the film with seed 210 a fast third ball disturbs a slow contact."""
    found = search_film(kind, seed)
    assert found["right"]
    assert found["contacts"] > 40
    if kind != "falling":
        value, std = found["numbers"][0]
        assert abs(value - COULOMB["mu"]) < 3 * std < 0.03
