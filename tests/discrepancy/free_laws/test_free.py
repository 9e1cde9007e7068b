"""Laws left free, of one ball alone or of both, over what they may depend on: against motions that know of no slot."""

import dataclasses

import numpy as np
import pytest
from discrepancy_clips import exact, noisy, only

from discrepancy.fitting.gauss_newton import BASE, Evidence, fit
from discrepancy.fitting.predict import forecast
from discrepancy.free_laws.answer import Answer, words
from discrepancy.free_laws.free import ALONE, BENDS, PACE, SLOTS, UNBENT
from discrepancy.free_laws.slots import columns, slots
from discrepancy.noise.model import Component, Noise
from discrepancy.search import find
from discrepancy.selection.free_law_contest import Slots
from synthcam.effect import Effect, parameter
from synthcam.effects.rolling_mismatch import RollingMismatch
from synthcam.library import library
from synthcam.model import Model

NOISE = Noise(Component(1.0))


def exchanged(count, seed):
    """Clips of the base model; ball a strikes in every second."""
    return [dataclasses.replace(c, striker="ba"[k % 2]) for k, c in enumerate(exact(Model(), count, seed))]


CLIPS = exchanged(6, 11)
LAUNCHES = np.array([c.launch for c in CLIPS])
FREE = {s.name: s for s in slots(Model(), LAUNCHES, CLIPS)}
MINE = [c.ball == int(c.striker == "a") for c in CLIPS]


def moved(model, clips=CLIPS):
    return forecast(model, np.array([c.launch for c in clips]), clips)


def constant(slot, part=0):
    """Coefficients of a law, or one part of it, that is one everywhere: the first cosine alone."""
    return 1.0 * (np.arange(slot.size) == part * slot.size // slot.parts)


def test_all_are_there_and_counted():
    assert set(FREE) == {*BENDS, *UNBENT, *(f"{name}_{ball}" for name in ALONE for ball in "ab")}
    assert len(FREE) == SLOTS


@pytest.mark.parametrize("name", ALONE)
def test_a_law_of_one_ball_moves_that_ball_alone_and_as_the_law_of_both_does(name):
    slot, rng = FREE[f"{name}_a"], np.random.default_rng(1)
    way = 1e-3 * rng.standard_normal(slot.size) / np.sqrt(slot.size)
    alone = moved(slot.bent(Model(), way))
    both = moved(dataclasses.replace(slot, name=name, ball="").bent(Model(), way))
    other = moved(dataclasses.replace(slot, name=f"{name}_b", ball="b").bent(Model(), way))
    for mine, a, b, ab, none in zip(MINE, alone, other, both, moved(Model()), strict=True):
        for ours, theirs in ((a, mine), (b, ~mine)):
            np.testing.assert_allclose(ours[theirs], ab[theirs], rtol=0, atol=1e-10)
            np.testing.assert_allclose(ours[~theirs], none[~theirs], rtol=0, atol=1e-10)
            assert np.abs(ours - none)[theirs].max() > 1e-8


@pytest.mark.parametrize("name", [f"{name}_{ball}" for name in ALONE for ball in "ab"])
def test_derivatives_are_those_of_the_forward_model(name):
    slot = FREE[name]
    way = 1e-3 * np.random.default_rng(2).standard_normal(slot.size) / np.sqrt(slot.size)
    ahead, behind = (np.concatenate(moved(slot.bent(Model(), sign * way))) for sign in (1, -1))
    true = (ahead - behind) / 2
    told = np.concatenate(columns(slot, Model(), LAUNCHES, CLIPS)) @ way
    assert np.linalg.norm(told - true) < 0.02 * np.linalg.norm(true)


@pytest.mark.parametrize(
    ("name", "part", "size", "numbers"),
    [
        ("friction_speed_a", 0, 0.01, {"friction_mismatch.excess": 0.01 / 0.232}),
        ("rolling_speed_a", 0, 1e-3, {"rolling_mismatch.decel": 1e-3}),
        ("rolling_heading", 0, 1e-3, {"rolling_decel": 0.0113}),
        ("rolling_heading", 1, 1e-3, {"rolling_drag": 0.135 + 1e-3 / PACE}),
        ("rolling_place", 1, 1e-3, {"rolling_drag": 0.135 + 1e-3 / PACE}),
        ("force_place_a", 0, 1e-3, {}),
    ],
)
def test_a_constant_law_is_a_number_of_the_model_or_an_effect(name, part, size, numbers):
    """Of a force on one ball: what a plate's tilt does to that ball."""
    slot = dataclasses.replace(FREE[name], centred=False)
    ours, known = moved(slot.bent(Model(), size * constant(slot, part))), Model().replace(numbers)
    if not numbers:
        known = Model().replace({"plate_tilt.x": np.arcsin(size / Model().gravity)})
    for own, a, b, none in zip(MINE, ours, moved(known), moved(Model()), strict=True):
        rows = own if not numbers else np.ones_like(own)
        np.testing.assert_allclose(a[rows], b[rows], rtol=0, atol=1e-9)
        assert np.abs(a[rows] - none[rows]).max() > 1e-7


@pytest.mark.parametrize("name", ["restitution_obliqueness", "spin_transfer_obliqueness", "spin_transfer_heading"])
def test_a_law_of_the_impact_is_each_clips_own_number(name):
    slot = FREE[name]
    coefs = 1e-3 * np.random.default_rng(3).standard_normal(slot.size)
    ours, owner = moved(slot.bent(Model(), coefs)), slot.owners[0][0]
    for clip, xy in zip(CLIPS, ours, strict=True):
        x = clip.launch[4] if "heading" in name else abs(clip.launch[5])
        own = Model().replace({owner: Model().value(owner) + float(slot.values(coefs, np.array([x]))[0])})
        np.testing.assert_allclose(xy, moved(own, [clip])[0], rtol=0, atol=1e-12)


@dataclasses.dataclass(frozen=True)
class Grain(Effect):
    """A plate on which balls roll worse one way than across it."""

    size: float = parameter("1", typical=0.1)

    def rolling(self, loss, velocity):
        return loss * (1 + self.size * np.cos(2 * np.arctan2(velocity[..., 1], velocity[..., 0]) - 0.7))


@dataclasses.dataclass(frozen=True)
class Rust(Effect):
    """Ball a alone slides with a friction that falls with the slip's speed."""

    size: float = parameter("1", typical=0.1)

    def friction(self, mu, slip_speed, of_a):
        return mu + of_a * self._law(slip_speed)

    def _law(self, u):
        return self.size * np.exp(-u / 0.3)


def hiding(effect, count=12, seed=6):
    """Collisions in which an effect is hidden."""
    clips = exchanged(count, seed)
    seen = moved(Model(effects=(effect,)), clips)
    return noisy([dataclasses.replace(c, xy=xy) for c, xy in zip(clips, seen, strict=True)], seed)


def contest(effect):
    """The best slot beside the base model."""
    clips = hiding(effect)
    base = fit(clips, Model(), BASE, NOISE)
    return min(Slots(Evidence.of(clips, NOISE), base).filled, key=lambda f: f.score)


def test_a_loss_by_heading_is_found_and_written():
    best = contest(Grain(0.1))
    assert best.slot.name == "rolling_heading"
    answer = Answer.of(best)
    assert answer.law == "added rolling loss that depends on the heading"
    assert "(2 th" in answer.formula
    assert "v in m/s" in answer.formula
    rest, pace = (0.1 * share * np.cos(2 * answer.x[0] - 0.7) for share in (0.0103, 0.135 * PACE))
    for part, true in enumerate((rest, pace)):
        low, high = answer.bands["band"][:, part].T
        assert np.mean((true > low) & (true < high)) >= 0.9
    assert np.median(high - low) < 0.7 * np.ptp(true)


def test_a_friction_of_one_ball_is_found_and_said_to_be_of_that_ball():
    best = contest(Rust(0.02))
    assert best.slot.name == "friction_speed_a"
    assert words(best.slot) == "mu of ball a that depends on the slip speed"
    answer = Answer.of(best)
    assert answer.formula.startswith("mu of ball a = 0.2")
    true, std = (
        Model().sliding_friction + Rust(0.02)._law(answer.x[0]),
        np.ptp(answer.bands["band68"][:, 0], axis=1) / 2,
    )
    assert np.sqrt(np.mean(((answer.curve[:, 0] - true) / std) ** 2)) < 2
    assert np.median(std) < 0.05 * np.ptp(true)


def test_a_ball_that_rolls_worse_is_named_and_no_slot_is_declared(monkeypatch):
    few = ("rolling_mismatch", "drag_mismatch", "mass_mismatch", "rolling_quadratic")
    only(monkeypatch, **{name: library()[name] for name in few})
    found = find(hiding(RollingMismatch(drag=0.02, decel=1e-3)), Model())
    assert [n.effect for n in found.named] == ["rolling_mismatch"]
    assert found.slot is None
    named = found.named[0]
    for strength, true in (("drag", 0.02), ("decel", 1e-3)):
        assert abs(named.values[f"rolling_mismatch.{strength}"] - true) < 4 * named.std[f"rolling_mismatch.{strength}"]
