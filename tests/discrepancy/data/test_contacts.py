"""Contacts from rows of the estimates: an impact of two discs that is computed by hand."""

import numpy as np
import pytest

from discrepancy.data.contacts import Contacts, read_contacts

# A disc of 1 kg meets one of 2 kg at rest with 0.8 m/s along the line of centres and 0.6 m/s across it. r is 0.5, and a
# third of the tangential velocity stops: impulses 0.8 and 0.1333 N s.
ROW = {"clip": 4, "striker": "b", "motion_local": "glide", "v0_local": 1.0, "b_local": 0.6, "r_local": 0.5}
ROW |= {"s_local": 2 / 3, "mass_ratio": 2.1}
ROW |= {f"{name}_std": 0.01 for name in ("v0_local", "b_local", "r_local", "s_local", "mass_ratio")}


def test_quantities_of_an_impact():
    both = Contacts.of([ROW, ROW | {"striker": "a"}], {4: 2.0})
    assert both.speed_n == pytest.approx(0.8)
    assert both.speed_t == pytest.approx(0.6)
    assert both.friction == pytest.approx(0.1333 / 0.8, rel=1e-3)
    assert both.recoil == pytest.approx(np.log([2.1 / 2, 2.1 / 0.5]))
    assert both.glides.all()


def test_a_quantity_that_the_tracks_do_not_show_is_nan():
    some = Contacts.of([ROW | {"s_local": np.nan}, ROW | {"v0_local": np.nan}])
    assert len(some) == 1
    assert np.isnan(some.friction[0])
    assert some.restitution[0] == 0.5


def test_a_table_of_tracks_has_no_contacts(tmp_path):
    assert len(read_contacts(tmp_path / "tracks.csv")) == 0
    assert len(read_contacts([])) == 0
