"""Free laws, of one ball alone or of both: against motions that know of none; one more is one file more."""

import dataclasses
import sys

import numpy as np
import pytest
from discrepancy_clips import exact, noisy, only
from discrepancy_laws import with_constant
from discrepancy_selected import challenged

from discrepancy.data.launch import HEADING, B
from discrepancy.fitting.gauss_newton import fit_model
from discrepancy.fitting.parameters import BASE_PARAMETERS
from discrepancy.fitting.predict import predict_tracks
from discrepancy.free_laws import laws
from discrepancy.free_laws.law_summary import LawSummary, describe_law
from discrepancy.free_laws.library import count_laws, free_laws_over, list_free_laws
from discrepancy.noise.model import Noise, NoiseComponent
from discrepancy.search import search
from synthcam.effect import Effect, parameter
from synthcam.effects.rolling_mismatch import RollingMismatch
from synthcam.library import library as effects
from synthcam.model import Model
from synthcam.tabulated_law import REFERENCE_SPEED_M_S

NOISE = Noise(NoiseComponent(1.0))


def exchanged(count, seed):
    """Clips of the base model; ball a strikes in every second."""
    return [dataclasses.replace(c, striker="ba"[k % 2]) for k, c in enumerate(exact(Model(), count, seed))]


CLIPS = exchanged(6, 11)
LAUNCHES = np.array([c.launch for c in CLIPS])
FREE = {s.name: s for s in free_laws_over(Model(), LAUNCHES, CLIPS)}
ALONE = sorted({law.name.removesuffix("_a") for law in FREE.values() if law.ball == "a"})
MINE = [c.ball == int(c.striker == "a") for c in CLIPS]


def moved(model, clips=CLIPS):
    return predict_tracks(model, np.array([c.launch for c in clips]), clips)


def constant(law, part=0):
    """Coefficients of a law, or one part of it, that is one everywhere: the first cosine alone."""
    return 1.0 * (np.arange(law.size) == part * law.size // law.parts)


def test_all_are_there_and_counted():
    both = {law.base_name for law in list_free_laws()}
    assert set(FREE) == {*both, *(f"{name}_{ball}" for name in ALONE for ball in "ab")}
    assert len(FREE) == count_laws()


@pytest.mark.parametrize("name", ALONE)
def test_a_law_of_one_ball_moves_that_ball_alone_and_as_the_law_of_both_does(name):
    law, rng = FREE[f"{name}_a"], np.random.default_rng(1)
    way = 1e-3 * rng.standard_normal(law.size) / np.sqrt(law.size)
    alone = moved(law.add_to(Model(), way))
    both = moved(dataclasses.replace(law, ball="").add_to(Model(), way))
    other = moved(dataclasses.replace(law, ball="b").add_to(Model(), way))
    for mine, a, b, ab, none in zip(MINE, alone, other, both, moved(Model()), strict=True):
        for ours, theirs in ((a, mine), (b, ~mine)):
            np.testing.assert_allclose(ours[theirs], ab[theirs], rtol=0, atol=1e-10)
            np.testing.assert_allclose(ours[~theirs], none[~theirs], rtol=0, atol=1e-10)
            assert np.abs(ours - none)[theirs].max() > 1e-8


@pytest.mark.parametrize("name", [f"{name}_{ball}" for name in ALONE for ball in "ab"])
def test_derivatives_are_those_of_the_forward_model(name):
    law = FREE[name]
    way = 1e-3 * np.random.default_rng(2).standard_normal(law.size) / np.sqrt(law.size)
    ahead, behind = (np.concatenate(moved(law.add_to(Model(), sign * way))) for sign in (1, -1))
    true = (ahead - behind) / 2
    told = np.concatenate(law.derivatives(Model(), LAUNCHES, CLIPS)) @ way
    assert np.linalg.norm(told - true) < 0.02 * np.linalg.norm(true)


@pytest.mark.parametrize(
    ("name", "part", "size", "numbers"),
    [
        ("friction_speed_a", 0, 0.01, {"friction_mismatch.excess": 0.01 / 0.232}),
        ("rolling_speed_a", 0, 1e-3, {"rolling_mismatch.decel": 1e-3}),
        ("rolling_heading", 0, 1e-3, {"rolling_decel": 0.0113}),
        ("rolling_heading", 1, 1e-3, {"rolling_drag": 0.135 + 1e-3 / REFERENCE_SPEED_M_S}),
        ("rolling_place", 1, 1e-3, {"rolling_drag": 0.135 + 1e-3 / REFERENCE_SPEED_M_S}),
        ("force_place_a", 0, 1e-3, {}),
    ],
)
def test_a_constant_law_is_a_number_of_the_model_or_an_effect(name, part, size, numbers):
    """A constant force on one ball does what a tilt of the plate does to that ball."""
    law = with_constant(FREE[name])
    ours, known = moved(law.add_to(Model(), size * constant(law, part))), Model().replace(numbers)
    if not numbers:
        known = Model().replace({"plate_tilt.x": np.arcsin(size / Model().gravity)})
    for own, a, b, none in zip(MINE, ours, moved(known), moved(Model()), strict=True):
        rows = own if not numbers else np.ones_like(own)
        np.testing.assert_allclose(a[rows], b[rows], rtol=0, atol=1e-9)
        assert np.abs(a[rows] - none[rows]).max() > 1e-7


@pytest.mark.parametrize("name", ["restitution_obliqueness", "spin_transfer_obliqueness", "spin_transfer_heading"])
def test_a_law_of_the_impact_is_each_clips_own_number(name):
    law = FREE[name]
    coefs = 1e-3 * np.random.default_rng(3).standard_normal(law.size)
    ours, owner = moved(law.add_to(Model(), coefs)), law.owners[0][0]
    for clip, xy in zip(CLIPS, ours, strict=True):
        x = clip.launch[HEADING] if "heading" in name else abs(clip.launch[B])
        own = Model().replace({owner: Model().value(owner) + float(law.values(coefs, np.array([x]))[0])})
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


def likeliest(effect):
    """The best free law beside the base model."""
    clips = hiding(effect)
    base = fit_model(clips, Model(), BASE_PARAMETERS, NOISE)
    return min(challenged(clips, base, NOISE), key=lambda f: f.score)


def test_a_loss_by_heading_is_found_and_written():
    best = likeliest(Grain(0.1))
    assert best.law.name == "rolling_heading"
    answer = LawSummary.of(best)
    assert answer.description == "added rolling loss that depends on the heading"
    assert "(2 th" in answer.formula
    assert "v in m/s" in answer.formula
    rest, pace = (0.1 * share * np.cos(2 * answer.x[0] - 0.7) for share in (0.0103, 0.135 * REFERENCE_SPEED_M_S))
    for part, true in enumerate((rest, pace)):
        low, high = answer.bands["band"][:, part].T
        assert np.mean((true > low) & (true < high)) >= 0.9
    assert np.median(high - low) < 0.7 * np.ptp(true)


@pytest.mark.gate
def test_a_friction_of_one_ball_is_found_and_said_to_be_of_that_ball():
    best = likeliest(Rust(0.02))
    assert best.law.name == "friction_speed_a"
    assert describe_law(best.law) == "mu of ball a that depends on the slip speed"
    answer = LawSummary.of(best)
    assert answer.formula.startswith("mu of ball a = 0.2")
    true, std = (
        Model().sliding_friction + Rust(0.02)._law(answer.x[0]),
        np.ptp(answer.bands["band68"][:, 0], axis=1) / 2,
    )
    assert np.sqrt(np.mean(((answer.curve[:, 0] - true) / std) ** 2)) < 2
    assert np.median(std) < 0.05 * np.ptp(true)


@pytest.mark.gate
def test_a_ball_that_rolls_worse_is_named_and_no_free_law_is_declared(monkeypatch):
    few = ("rolling_mismatch", "drag_mismatch", "mass_mismatch")
    only(monkeypatch, ("rolling_speed", "force_speed"), **{name: effects()[name] for name in few})
    found = search(hiding(RollingMismatch(drag=0.02, decel=1e-3)), Model())
    assert [n.effect for n in found.named] == ["rolling_mismatch"]
    assert found.free_law is None
    named = found.named[0]
    for strength, true in (("drag", 0.02), ("decel", 1e-3)):
        assert abs(named.values[f"rolling_mismatch.{strength}"] - true) < 4 * named.std[f"rolling_mismatch.{strength}"]


SIDE = '''
"""Restitution that depends on the impact parameter, its sign included."""

from discrepancy.data.launch import B
from discrepancy.free_laws.law_kinds import ImpactLaw
from discrepancy.free_laws.ranges import over_range

LAWS = (
    ImpactLaw(
        "restitution_side",
        "Restitution over b, its sign included. No effect may ask for that.",
        "r",
        owners=(("restitution", 0),),
        over=lambda covered: over_range("impact parameter", "b", covered.launches[:, B], unit="1"),
        at_impact=lambda launches: launches[:, B],
    ),
)
'''


@pytest.fixture
def one_more(tmp_path, monkeypatch):
    """A free law in a file that is dropped into the folder."""
    (tmp_path / "restitution_side.py").write_text(SIDE)
    monkeypatch.setattr(laws, "__path__", [*laws.__path__, str(tmp_path)])
    before = count_laws()
    list_free_laws.cache_clear()
    yield before
    sys.modules.pop("discrepancy.free_laws.laws.restitution_side", None)
    list_free_laws.cache_clear()


def test_a_file_dropped_into_the_folder_is_found(one_more):
    assert count_laws() == one_more + 1


@pytest.mark.gate
def test_a_file_dropped_into_the_folder_is_fitted_and_named(one_more, monkeypatch):
    few = {name: effects()[name] for name in ("velocity_restitution", "spin_transfer_velocity")}
    only(monkeypatch, ("restitution_side", "restitution_obliqueness", "spin_transfer_speed"), **few)
    clips = exact(Model(), 12, 6)
    sides = [Model().replace({"restitution": 0.9 + 0.01 * np.tanh(c.launch[B] / 0.1)}) for c in clips]
    seen = noisy([dataclasses.replace(c, xy=moved(m, [c])[0]) for c, m in zip(clips, sides, strict=True)], 6)
    found = search(seen, Model())
    assert (found.verdict, found.free_law.law.name) == ("outside_library", "restitution_side")
    said = found.document()["outside"][0]
    assert (said["slot"], said["law"]) == ("restitution_side", "r that depends on the impact parameter")
    true = 0.9 + 0.01 * np.tanh(np.array(said["x"]) / 0.1)
    low, high = np.array(said["band"]).T
    assert np.mean((true > low) & (true < high)) >= 0.9
    assert np.median(high - low) < 0.5 * np.ptp(true)
