"""Durations of contacts by the bend of paths, held to forces that are integrated in small steps."""

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from tracker_contacts import SoftHit

from benchmarks.real.contact_durations import integrate_push, measure_contact_duration
from benchmarks.real.recordings import RecordedHit

DRAG = np.array([[0.0, 0.0], [-0.4, 0.1]])  # of both discs, m/s^2


def make_hit(hit: SoftHit, seed: int) -> RecordedHit:
    """Tracks of a hit of discs that air slows, before and after it."""
    rows = hit.tracks(np.random.default_rng(seed))
    t = rows["frame"].to_numpy() / hit.fps
    lost = DRAG[rows["particle"]] * (t[:, None] - hit.before / hit.fps) ** 2 / 2
    return RecordedHit("", rows.assign(t_s=t, x=rows["x"] + lost[:, 0], y=rows["y"] + lost[:, 1]), hit.camera)


def test_a_push_adds_the_way_of_half_a_sine():
    duration, t = 0.02, np.linspace(-0.03, 0.03, 6001)
    force = np.where(np.abs(t) < duration / 2, np.cos(np.pi * t / duration) * np.pi / (2 * duration), 0.0)
    way = cumulative_trapezoid(cumulative_trapezoid(force, t, initial=0), t, initial=0)
    np.testing.assert_allclose(integrate_push(t, duration), way, atol=1e-7)


@pytest.mark.parametrize(("law", "seed"), [("spring", 1), ("hertz", 2), ("dents", 3)])
def test_soft_discs_push_each_other_for_a_time(law, seed):
    hit = SoftHit(0.02, r=0.85, v0=0.32, b=0.3, fps=250.0, noise=3e-5, law=law)
    found = measure_contact_duration(make_hit(hit, seed))
    assert found.is_finite
    assert abs(found.duration - hit.end_of_force()[0]) < 3 * found.std
    assert found.std < 2e-3


@pytest.mark.parametrize("seed", range(3))
def test_an_impact_has_a_limit_only(seed):
    hit = SoftHit(0.0, r=0.85, v0=0.32, b=0.3, fps=250.0, noise=3e-5)
    found = measure_contact_duration(make_hit(hit, seed))
    assert not found.is_finite
    assert 0 < found.limit < 0.012
