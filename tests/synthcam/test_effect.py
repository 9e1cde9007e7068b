"""Effects: declaration, limits, the laws they bend, and how they are found."""

import importlib
import sys
from dataclasses import dataclass

import pytest

from synthcam.effect import LAWS, ActiveLaws, Effect, parameter
from synthcam.library import find_plugin_classes, library


@dataclass(frozen=True)
class Rough(Effect):
    """A strength and a shape."""

    rise: float = parameter("1", typical=0.1, low=-1, high=2)
    slip: float = parameter("m/s", typical=0.2, fixed=True)

    def friction(self, mu, slip_speed):
        return mu * (1 + self.rise * slip_speed / self.slip)


def test_a_misspelt_law_is_an_error_when_the_class_is_made():
    with pytest.raises(TypeError, match=r"Wrong\.fricton: no such law; there are mass, .*restitution, .*friction"):

        class Wrong(Effect):
            def fricton(self, mu):
                return mu


def test_asking_for_what_a_law_does_not_know_is_an_error_too():
    with pytest.raises(TypeError, match=r"Wrong\.friction asks for colour; friction may ask for slip_speed"):

        class Wrong(Effect):
            def friction(self, mu, colour):
                return mu


def test_a_helper_may_be_private():
    class Fine(Effect):
        def _half(self, x):
            return x / 2

        def friction(self, mu):
            return self._half(mu)

    assert Fine.laws == {"friction": ()}


@pytest.mark.parametrize("value", [-1.001, 2.001, float("nan"), float("inf")])
def test_limits_are_kept(value):
    with pytest.raises(ValueError, match=r"test_effect\.rise = .*: expected a number from -1 to 2 1"):
        Rough(rise=value)


def test_strengths_and_shapes():
    assert [p.name for p in Rough.strengths()] == ["rise"]
    assert [(p.name, p.default, p.fixed) for p in Rough.parameters()] == [("rise", 0.0, False), ("slip", 0.2, True)]
    assert not Rough(slip=5).active
    assert Rough(rise=-0.1).active


def test_laws_apply_the_active_ones_by_name():
    laws = ActiveLaws([Rough(rise=0.5, slip=0.1), Rough(rise=0.0, slip=1e-9)])
    assert laws("friction", 0.2, {"slip_speed": 0.1}) == pytest.approx(0.3)
    assert laws.has_effect_on("friction")
    assert not laws.has_effect_on("push", "rolling")
    assert ActiveLaws([])("friction", 0.2, {}) == 0.2
    assert set(LAWS) >= {"restitution", "spin_transfer", "friction", "normal_load", "rolling", "push"}


def test_an_absent_name_is_none():
    assert "no_such_effect" not in library()


TWO = "from synthcam.effect import Effect\nclass A(Effect): pass\nclass B(Effect): pass\n"


@pytest.mark.parametrize("text", ["", TWO])
def test_a_file_holds_one_effect(tmp_path, monkeypatch, text):
    package = tmp_path / "shelf"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "odd.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    try:
        with pytest.raises(TypeError, match=r"shelf\.odd: expected one Effect in the file"):
            list(find_plugin_classes(importlib.import_module("shelf"), Effect))
    finally:
        for name in [m for m in sys.modules if m.partition(".")[0] == "shelf"]:
            del sys.modules[name]
