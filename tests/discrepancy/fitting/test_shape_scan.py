"""Many shapes at once: derivatives against those of the forward model."""

import dataclasses

import numpy as np
import pytest
from discrepancy_clips import exact

from discrepancy.fitting.jacobian import differentiate_tracks
from discrepancy.fitting.parameters import list_candidates, list_names_to_fit
from discrepancy.fitting.predict import predict_tracks
from discrepancy.fitting.shape_scan import can_scan, scan_shapes
from synthcam.model import Model

CLIPS = exact(Model(), 6, 11)
LAMPLESS = [dataclasses.replace(c, camera=dataclasses.replace(c.camera, lamp=None)) for c in CLIPS]
LAUNCHES = np.array([c.launch for c in CLIPS])
CANDIDATES = {s.name: s for s in list_candidates(Model(), list_names_to_fit(Model()))}


@pytest.mark.parametrize(
    ("name", "clips"), [("plate_waviness", CLIPS), ("dropped_frame", CLIPS), ("unknown_lamp", LAMPLESS)]
)
def test_derivatives_are_those_of_the_forward_model(name, clips):
    candidate = CANDIDATES[name]
    tries = list(candidate.grid(Model()))
    assert can_scan(candidate, tries)
    tries = tries[:: 1 + len(tries) // 40]
    here = predict_tracks(Model(), LAUNCHES, clips)
    told = scan_shapes(Model(), LAUNCHES, clips, candidate, tries, here)
    for k in range(0, len(tries), 4):
        for j, strength in enumerate(candidate.strengths):
            true = np.concatenate(differentiate_tracks(Model().replace(tries[k]), LAUNCHES, clips, strength, here))
            ours = np.concatenate([t[..., k, j] for t in told])
            length = np.linalg.norm(true)
            assert np.linalg.norm(ours) == pytest.approx(length, rel=0.05)
            assert (ours * true).sum() >= 0.998 * length * np.linalg.norm(ours)


def test_where_the_lamp_is_told_there_is_no_unknown_one():
    candidate = CANDIDATES["unknown_lamp"]
    told = scan_shapes(
        Model(), LAUNCHES, CLIPS, candidate, list(candidate.grid(Model())), predict_tracks(Model(), LAUNCHES, CLIPS)
    )
    assert not any(t.any() for t in told)


def test_what_is_tried_one_by_one():
    """Few shapes, or laws that are no small change of the motion between impacts."""
    assert not any(can_scan(s, list(s.grid(Model()))) for n, s in CANDIDATES.items() if n in ("hop", "ball_friction"))
    assert not can_scan(CANDIDATES["plate_waviness"], list(CANDIDATES["plate_waviness"].grid(Model()))[:5])
