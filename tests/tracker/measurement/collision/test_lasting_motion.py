"""Slides and impulses of contacts that take time, held to integrations of five laws of the force."""

import numpy as np
import pytest
from tracker_contacts import GRAVITY, LAWS, SoftHit

from tracker.measurement.collision.collision_model import FREE
from tracker.measurement.collision.lasting_motion import (
    advance_slides,
    delay_of_slides,
    rewind_slides,
    turn_of_impulse,
)


@pytest.mark.parametrize("past", [0.01, 0.3, 0.6])
def test_slides_that_are_rewound_and_advanced_return(past):
    free = np.arange(1.0, len(FREE) + 1)
    tau = 0.1
    for name in ("log_tau1", "log_tau2"):
        free[FREE.index(name)] = np.log(tau)
    delay = np.array(past * tau)
    later = advance_slides(free, delay)
    assert rewind_slides(later, delay) == pytest.approx(free, rel=1e-6)
    v, f, left = (later[FREE.index(name)] for name in ("v1x", "f1x", "log_tau1"))
    before = free[FREE.index("v1x")], free[FREE.index("f1x")]
    assert np.exp(left) == pytest.approx((1 - past) * tau)
    assert v - f == pytest.approx((1 - past) * (before[0] - before[1]))  # the slip falls evenly


def test_some_of_a_slide_is_left_however_late_it_is():
    free = np.zeros(len(FREE))
    later = advance_slides(free, np.array(20.0))
    assert np.isfinite(later).all()
    assert later[FREE.index("log_tau1")] < -10


def integrate(hit):
    """Of two balls, integrated until the force ends.

    Seconds, the impulse on the struck ball over its mass, its slip and its position; friction then acts along the slip.
    """
    lasts, state = hit.end_of_force()
    velocity, carried = state[4:6], state[8:10]
    return lasts, (5 * velocity + 2 * carried) / 5, velocity - carried, state[0:2]


@pytest.mark.parametrize(
    ("r", "friction", "duration"),
    [
        (0.6, 0.1, 0.02),
        *(pytest.param(*case, marks=pytest.mark.gate) for case in ((0.9, 0.15, 0.015), (0.7, 0.2, 0.012))),
    ],
)
def test_slides_are_delayed_by_what_five_laws_integrate_to(r, friction, duration):
    excess = []
    for law in LAWS:
        hit = SoftHit(duration, r, friction=friction, law=law)
        lasts, impulse, slip, place = integrate(hit)
        loss = 3.5 * friction * GRAVITY  # of slip, m/s^2
        delay = lasts - (impulse[0] - slip[0]) / loss
        # the slide as it would be without the contact leads back to where the paths cross
        since = np.linspace(0, lasts, 2001)
        back = since - lasts
        apart = place[0] + (impulse[0] * 5 / 7 + slip[0] * 2 / 7) * back - friction * GRAVITY * back**2 / 2
        before = since[np.argmin(np.abs(apart))]
        given = hit.v0, 2 * impulse[0] / hit.v0 - 1, np.log(friction), before, hit.v0 * before
        (_, mean), (_, more) = (delay_of_slides(*map(np.array, given), np.array(q)) for q in (0.0, 1.0))
        excess.append((delay - mean) / (more - mean))
    assert abs(np.mean(excess)) < 0.6
    assert np.abs(excess).max() < 2.3
    assert np.std(excess) > 0.4


@pytest.mark.parametrize(
    ("b", "friction"),
    [(0.45, 0.15), *(pytest.param(*case, marks=pytest.mark.gate) for case in ((-0.3, 0.1), (0.3, 0.2)))],
)
def test_an_impulse_is_turned_by_what_five_laws_integrate_to(b, friction):
    """Against the line of centres where the paths cross, towards where it turns."""
    excess = []
    for law in LAWS:
        hit = SoftHit(0.02, 0.7, b=b, friction=friction, law=law, v0=0.35)
        lasts, impulse, slip, place = integrate(hit)
        back = np.linspace(-lasts, 0, 4001)[:, None]
        pull = friction * GRAVITY * slip / np.hypot(*slip)
        after = place + (impulse * 5 / 7 + slip * 2 / 7) * back - pull * back**2 / 2
        striker = np.array([-np.sqrt(1 - b**2), -b]) * hit.diameter + np.array([hit.v0, 0.0]) * (back + lasts)
        # the balls are equal, so that both paths cross where that of the struck ball leads back to its start
        crossing = -striker[np.argmin((after**2).sum(axis=1))]
        turn = np.arctan2(*impulse[::-1]) - np.arctan2(*crossing[::-1])
        given = np.arcsin(-b), hit.v0 * hit.time_within / hit.diameter
        mean, more = (turn_of_impulse(*map(np.array, given), np.array(q)) for q in (0.0, 1.0))
        excess.append((turn - mean) / (more - mean))
    assert np.abs(excess).max() < 2.5
    assert abs(np.mean(excess)) < 1.5
