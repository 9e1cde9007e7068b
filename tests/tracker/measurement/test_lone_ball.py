"""One ball that rolls by itself: its loss, by positions of a known deceleration."""

import numpy as np
import pytest

from tracker.measurement.lone_ball import fit_lone_ball
from tracker.measurement.positions import BallTrack


@pytest.mark.parametrize(("duration_s", "noise_m", "parts_known"), [(1.0, 2e-7, True), (0.2, 2e-6, False)])
def test_the_loss_is_known_where_its_parts_are_not(duration_s, noise_m, parts_known):
    """A ball at 0.4 m/s loses 0.1 m/s^2; over a short time, drag and decel are not distinguished."""
    time, noise = np.linspace(0, duration_s, 60), np.random.default_rng(3).normal(0, noise_m, (60, 2))
    way = np.outer(0.4 * time - 0.1 * time**2 / 2, [0.6, 0.8])
    cov = np.tile(np.eye(2) * noise_m**2, (60, 1, 1))
    found = fit_lone_ball(BallTrack(0, np.arange(60), time, way + noise, cov, 1e-6))
    loss, std = found.loss
    assert abs(loss - 0.1) < 4 * std
    assert std < 0.02
    assert (found.cov[5, 5] < 0.02**2) == parts_known
