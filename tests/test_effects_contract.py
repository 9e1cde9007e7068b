"""One contract over every effect in the library."""

import dataclasses
import sys

import numpy as np
import pytest
import yaml

import synthcam.effects
from synthcam import effect as effect_module
from synthcam import model as model_module
from synthcam import scene as scene_module
from synthcam.dynamics import solve
from synthcam.effect import LAWS, library
from synthcam.launch import Launch
from synthcam.model import Model, build, read_model, settings_of, write_model
from synthcam.scene import check_scene
from synthcam.settings import InputError

R = Model().ball.radius
LAUNCH = Launch.pair(Model().bodies("ab"), 0.1, 0.5, 0.4, 0.7, (0.003, -0.001))
TIMES = np.linspace(0, 0.3, 151)
every = pytest.mark.parametrize("kind", library().values(), ids=list(library()))
each = pytest.mark.parametrize(
    ("kind", "name"), [(k, p.name) for k in library().values() for p in k.parameters()], ids=lambda x: str(x)
)


def track(*effects):
    return solve(Model(effects=effects), LAUNCH, 0.0, 0.3).at(TIMES)


def present(kind, **values):
    """The effect at its realistic size."""
    return kind(**{p.name: p.scale for p in kind.parameters()} | values)


def test_the_library_is_not_empty():
    assert {"plate_tilt", "velocity_restitution", "rolling_quadratic"} <= set(library())


@every
def test_null_is_absence_bit_for_bit(kind):
    null = present(kind, **{p.name: 0.0 for p in kind.strengths()})
    np.testing.assert_array_equal(track(null), track())
    assert not null.active


@each
def test_every_parameter_moves_a_track(kind, name):
    scale = next(p.scale for p in kind.parameters() if p.name == name)
    others = {p.name: 0.0 for p in kind.strengths() if p.name != name}
    fixed = name not in [p.name for p in kind.strengths()]
    near, far = present(kind, **({} if fixed else others)), present(kind, **({name: 0.5 * scale} if fixed else others))
    reference = track(near) if fixed else track()
    assert np.abs(track(far) - reference)[..., :2].max() > 1e-8


@every
def test_it_survives_yaml_and_back(kind, tmp_path):
    model = Model(restitution=0.8, effects=(present(kind),), free=("restitution",))
    write_model(model, tmp_path / "m.yaml")
    assert read_model(tmp_path / "m.yaml") == model
    scene = check_scene(settings_of(model), "here")
    assert scene.draw(0, 0).model == dataclasses.replace(model, free=())
    assert build(yaml.safe_load(yaml.safe_dump(settings_of(model))), model.free) == model


@each
def test_its_limits_are_enforced(kind, name):
    rule = next(p for p in kind.parameters() if p.name == name)
    beyond = [x for x in (rule.low - 1, rule.high + 1) if np.isfinite(x)]
    for value in beyond:
        with pytest.raises(ValueError, match=rf"{kind.name()}\.{name} = .*: expected a number from"):
            kind(**{name: value})
        with pytest.raises(InputError, match=rf"file\.yaml: effects\.{kind.name()}\.{name}: .*found"):
            check_scene({"effects": {kind.name(): {name: value}}}, "file.yaml")
    for value in (float("nan"), float("inf"), "1", True):
        with pytest.raises(InputError, match=rf"effects\.{kind.name()}\.{name}: "):
            check_scene({"effects": {kind.name(): {name: value}}}, "file.yaml")


@every
def test_it_is_declared_in_full(kind):
    assert kind.__doc__ is not None
    assert kind.__doc__ != f"{kind.__name__}({', '.join(f.name for f in dataclasses.fields(kind))})"
    assert kind.laws
    assert set(kind.laws) <= set(LAWS)
    assert kind.strengths()
    for p in kind.parameters():
        assert p.low <= p.default <= p.high
        assert p.low <= p.scale <= p.high
        assert p.scale > 0
        assert p.unit
    assert "".join(part.title() for part in kind.name().split("_")) == kind.__name__


STICKY = '''
"""Friction that grows with speed."""

from dataclasses import dataclass

from synthcam.effect import Effect, parameter


@dataclass(frozen=True)
class StickyFingers(Effect):
    """mu (1 + k u)."""

    k: float = parameter("s/m", scale=0.05, low=0)

    def friction(self, mu, slip_speed):
        return mu * (1 + self.k * slip_speed)
'''


def test_a_file_dropped_into_the_folder_is_an_effect(tmp_path, monkeypatch):
    (tmp_path / "sticky_fingers.py").write_text(STICKY)
    caches = [library, model_module.effect_settings, model_module.model_file, scene_module.scene_file]
    monkeypatch.setattr(synthcam.effects, "__path__", [*synthcam.effects.__path__, str(tmp_path)])
    for cache in caches:
        cache.cache_clear()
    try:
        kind = effect_module.library()["sticky_fingers"]
        clip = check_scene({"effects": {"sticky_fingers": {"k": {"uniform": [0.1, 0.2]}}}}, "x").draw(0, 0)
        assert isinstance(clip.model.effects[0], kind)
        assert 0.1 <= clip.model.value("sticky_fingers.k") <= 0.2
        assert np.abs(track(kind(k=0.05)) - track())[..., :2].max() > 1e-8
        with pytest.raises(InputError, match=r"sticky_fingers\.k: input should be greater than or equal to 0"):
            check_scene({"effects": {"sticky_fingers": {"k": -1}}}, "x")
    finally:
        sys.modules.pop("synthcam.effects.sticky_fingers", None)
        for cache in caches:
            cache.cache_clear()
    assert "sticky_fingers" in kind.name()
