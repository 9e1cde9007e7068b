"""How five laws of the force throw balls back against friction, held to integrations by other programs."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tracker_contacts import GRAVITY, LAWS, SoftHit

from tracker.measurement.collision.force_laws import LEAST_RESTITUTION, solve_restitutions


def solve_one(ratio, friction=0.0, tangent=0.0, way=0.0):
    (found,) = solve_restitutions(*(np.array([float(each)]) for each in (ratio, friction, tangent, way)))
    return found


@pytest.mark.parametrize("r", [0.15, 0.3, 0.6, 0.95])
@pytest.mark.parametrize("force", [0.0, 1e-4])
def test_without_friction_the_ratio_of_speeds_is_the_restitution(r, force):
    """Errors of precise tracks are .0001. What friction costs is smaller than what it takes from the speed."""
    assert solve_one(r, friction=force, tangent=10 * force, way=0.1) == pytest.approx(r, abs=1e-9 + force)


@pytest.mark.parametrize("r", [0.4, 0.7])
def test_a_dashpot_gives_back_a_part_of_what_a_constant_force_costs(r):
    """Scipy integrates a spring with a dashpot against a small force; the dashpot pushes the balls at once."""
    damping = -np.log(r)  # a contact of 1 s
    stiffness, force = np.pi**2 + damping**2, 0.01

    def rates(t, y):
        return [y[1], -stiffness * y[0] - 2 * damping * y[1] + force]

    def leaves(t, y):
        return y[0] if t > 0.1 else 1.0

    leaves.terminal = True
    found = solve_ivp(rates, (0, 3), [0.0, 1.0], events=leaves, rtol=1e-10, atol=1e-12)
    got = solve_one(-found.y[1, -1], friction=force * found.t[-1])[0]
    assert got == pytest.approx(r, abs=3e-4)
    assert abs(-found.y[1, -1] - r) > 4e-4


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(
    ("r", "friction", "duration", "b"),
    [(0.8, 0.2, 0.015, 0.0), (0.9, 0.08, 0.025, 0.5), (0.9, 0.0, 0.025, 0.5), (0.5, 0.06, 0.01, 0.3)],
)
def test_each_law_gives_the_restitution_of_two_balls_that_follow_it(law, r, friction, duration, b):
    """The balls of the helper move in a plane and roll until they slide."""
    hit, step = SoftHit(duration, r, b=b, friction=friction, law=law), 1e-6
    lasts, closing = hit.time_within, hit.v0 * np.sqrt(1 - b**2)
    one, two = hit.positions(lasts + step * np.arange(1, 3))
    ratio = np.diff(np.hypot(*(one - two).T))[0] / step / closing
    pressed = 2 * friction * GRAVITY * lasts / closing
    found = solve_one(ratio, pressed, b / np.sqrt(1 - b**2), closing * lasts / hit.diameter)
    off = abs(ratio - r)
    assert found[LAWS.index(law)] == pytest.approx(r, abs=max(1e-3, 0.03 * off))


def test_balls_that_hardly_part_have_a_finite_restitution():
    assert np.isfinite(solve_one(LEAST_RESTITUTION / 2, friction=0.5)).all()
    assert np.isfinite(solve_one(1.1, friction=0.1)).all()


def test_an_instant_needs_no_correction():
    assert solve_one(0.7, way=0.0) == pytest.approx(0.7, abs=1e-3)


def test_balls_that_friction_would_keep_together_have_a_larger_restitution():
    """Balls whose restitution is the ratio of speeds would not part against this friction."""
    found = solve_one(0.15, friction=0.45, way=0.15)
    assert found.min() > 0.25
    assert not (found == found.round(2)).any()  # solved, not only raised
