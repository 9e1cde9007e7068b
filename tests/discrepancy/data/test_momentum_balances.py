"""Balances of momentum of discs on air that meet one after another, whose velocities are chosen by hand."""

import numpy as np
import pandas as pd

from discrepancy.data.momentum_balances import balance_groups
from tracker.tables.read import to_pixels
from tracker.tables.table import TrackTable

FPS, SCALE, DIAMETER, SHARE = 500.0, 1e-4, 0.01, 0.3
CAMERA = {"size": [2000, 1000], "fps": FPS, "scale": SCALE, "ball_diameter": DIAMETER, "support": "air"}
FIRST = 0.08  # s, of the contact of ball 0 with 1
# Ball 0 of 1.3 kg gives 1.2 N s along x and 0.2 along y to ball 1 of 1 kg, which gives 0.5 along x to ball 2 of 1 kg.
VELOCITIES = {
    0: (
        [1.0, 0.1],
        [1.0 - 1.2 / (1 + SHARE), 0.1 - 0.2 / (1 + SHARE)],
        [1.0 - 1.2 / (1 + SHARE), 0.1 - 0.2 / (1 + SHARE)],
    ),
    1: ([-0.2, 0.0], [1.0, 0.2], [0.5, 0.2]),
    2: ([0.1, 0.0], [0.1, 0.0], [0.6, 0.0]),
}


def balance(later_s=0.008, measured=(), seed=1):
    """The balances of this chain, with 0.02 px noise; later_s: from its first contact to its second."""
    rng, frames, tables, second = np.random.default_rng(seed), np.arange(120), [], FIRST + later_s
    time = frames / FPS
    spans = np.column_stack([np.minimum(time, FIRST), np.clip(time - FIRST, 0, later_s), np.maximum(time - second, 0)])
    for ball, velocities in VELOCITIES.items():
        xy = spans @ np.array(velocities) / SCALE + [300 + 300 * ball, 400] + 0.02 * rng.standard_normal((120, 2))
        tables.append(pd.DataFrame(xy, columns=["x", "y"]).assign(frame=frames, particle=ball))
    table = pd.concat(tables).assign(x_std=0.02, y_std=0.02, cov_xy=0.0)
    read = to_pixels(TrackTable(table), "by hand", CAMERA)
    contacts = pd.DataFrame({"t_s": [FIRST, second], "t_s_std": 1e-5, "particle1": [0, 1], "particle2": [1, 2]})
    contacts = contacts.assign(energy_lost=np.nan, energy_lost_std=np.nan, misfit=False, collision=[0, 1])
    return balance_groups(read.clips[0][0], read.camera, contacts, measured)


def test_two_contacts_in_fast_succession_are_one_balance_that_shows_the_heavier_ball():
    """Noise of 0.02 px leaves an error of the mass of a few thousandths."""
    (group,) = balance()
    assert group.contacts.tolist() == [0, 1]
    assert group.balls.tolist() == [0, 1, 2]
    explained = np.log(1 + SHARE) * group.levers[0]
    assert np.abs(group.gained).max() > 20 * group.std
    assert np.abs(group.gained - explained).max() < 3 * group.std + 2e-3  # and what is cubic in the share
    assert np.abs(group.gained - np.log(1 + SHARE) * group.levers[2]).max() > 20 * group.std


def test_the_error_of_a_balance_is_its_scatter_from_film_to_film():
    groups = [balance(seed=seed)[0] for seed in range(30)]
    scores = np.array([(group.gained - np.log(1 + SHARE) * group.levers[0]) / group.std for group in groups])
    assert 0.6 < np.sqrt((scores**2).mean()) < 1.4


def test_contacts_that_are_measured_one_by_one_are_not_balanced_again():
    """The value of contact 0 is from paths of balls 0 and 1, so the balance of both would share their errors."""
    assert balance(measured=[0, 1]) == balance(measured=[0]) == balance(measured=[1]) == []
    assert len(balance(measured=[2])) == 1
    separate = balance(later_s=0.04)
    assert [group.contacts.tolist() for group in separate] == [[0], [1]]
    assert [group.contacts.tolist() for group in balance(later_s=0.04, measured=[0])] == [[1]]
