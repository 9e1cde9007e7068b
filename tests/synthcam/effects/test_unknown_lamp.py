"""A lamp that camera.json does not tell of: the tracker takes its glints for centres, and the search says so."""

import dataclasses

import numpy as np
import pytest
from discrepancy_clips import CAMERA, EFFECTS, exact, noisy, only

from discrepancy.add import add
from discrepancy.search import search
from synthcam.library import library
from synthcam.model import Model
from tracker.camera.camera import LampSettings

POSITION = (0.12, -0.08, 0.25)
KNOWN = (*EFFECTS, "unknown_lamp", "glint_parallax", "lens_distortion")
RIVALS = ("warp_place", "restitution_speed")  # free laws


def without_a_lamp(clips, lamp=None):
    """The clips of a tracker that is told of no lamp; lamp: the true one, whose glints it took for centres."""
    blind, out = dataclasses.replace(CAMERA, lamp=None), []
    for clip in clips:
        xy = clip.xy
        if lamp:
            xy = CAMERA.unproject(dataclasses.replace(CAMERA, lamp=lamp).glint_of_centre(xy))[0]
        out.append(dataclasses.replace(clip, xy=xy, camera=blind))
    return out


@pytest.mark.gate
def test_the_lamp_is_named_and_found(monkeypatch):
    only(monkeypatch, RIVALS, **{name: library()[name] for name in KNOWN})
    found = search(noisy(without_a_lamp(exact(Model(), 12, 3), LampSettings(POSITION)), 3), Model())
    assert [n.effect for n in found.named] == ["unknown_lamp"]
    assert found.free_law is None
    assert found.verdict == "named"
    (lamp,) = found.named
    for key, true in zip(("x", "y", "height"), POSITION, strict=True):
        value, std = lamp.shapes[f"unknown_lamp.{key}"], lamp.shape_std[f"unknown_lamp.{key}"]
        assert abs(value - true) < 3.5 * std
        assert std < 0.04
    assert np.isclose(lamp.values["unknown_lamp.share"], 1, atol=3.5 * lamp.std["unknown_lamp.share"])


def test_no_lamp_given_and_none_there(monkeypatch):
    only(monkeypatch, RIVALS, **{name: library()[name] for name in KNOWN})
    found = search(noisy(without_a_lamp(exact(Model(), 12, 4)), 4), Model())
    assert found.named == ()
    assert found.free_law is None
    assert "glint_parallax" in found.undetectable
    assert "unknown_lamp" not in found.undetectable


def test_a_lamp_that_is_given_is_not_unknown(monkeypatch):
    only(monkeypatch, RIVALS, **{name: library()[name] for name in KNOWN})
    found = search(noisy(exact(Model(), 8, 4), 4), Model())
    assert found.named == ()
    assert "unknown_lamp" in found.undetectable


@pytest.mark.gate
def test_errors_reach_along_the_valley_of_share_and_height(monkeypatch):
    """A small share of a lamp aside is nearly as likely: eight clips tell little more."""
    only(monkeypatch, unknown_lamp=library()["unknown_lamp"])
    new = add(noisy(without_a_lamp(exact(Model(), 8, 7), LampSettings((0.05, 0.0, 0.45))), 7), Model(), "unknown_lamp")
    assert new.named.shapes["unknown_lamp.x"] > 0.12
    assert new.named.shape_std["unknown_lamp.x"] > 1.3 * new.fit.std["unknown_lamp.x"]
