"""Many shapes at once: derivatives against those of the forward model."""

import numpy as np
import pytest

from discrepancy.fit import derivative
from discrepancy.forecast import forecast
from discrepancy.parameter import fitted, suspects
from discrepancy.scan import scannable, scanned
from discrepancy_clips import exact
from synthcam.model import Model

CLIPS = exact(Model(), 6, 11)
LAUNCHES = np.array([c.launch for c in CLIPS])
SUSPECTS = {s.name: s for s in suspects(Model(), fitted(Model()))}


@pytest.mark.parametrize("name", ["plate_waviness", "dropped_frame"])
def test_derivatives_are_those_of_the_forward_model(name):
    suspect = SUSPECTS[name]
    tries = list(suspect.grid(Model()))
    assert scannable(suspect, tries)
    tries = tries[:: len(tries) // 40]
    told = scanned(Model(), LAUNCHES, CLIPS, suspect, tries)
    here = forecast(Model(), LAUNCHES, CLIPS)
    for k in range(0, len(tries), 4):
        for j, strength in enumerate(suspect.strengths):
            true = np.concatenate(derivative(Model().replace(tries[k]), LAUNCHES, CLIPS, strength, here))
            ours = np.concatenate([t[..., k, j] for t in told])
            length = np.linalg.norm(true)
            assert np.linalg.norm(ours) == pytest.approx(length, rel=0.05)
            assert (ours * true).sum() >= 0.998 * length * np.linalg.norm(ours)


def test_what_is_tried_one_by_one():
    """Few shapes, or laws that are no small change of the motion between impacts."""
    assert not any(scannable(s, list(s.grid(Model()))) for n, s in SUSPECTS.items() if n in ("hop", "ball_friction"))
    assert not scannable(SUSPECTS["plate_waviness"], list(SUSPECTS["plate_waviness"].grid(Model()))[:5])
