"""One contract over every effect in the library."""

import dataclasses
import re
import sys

import numpy as np
import pytest
import yaml
from sticky_effect import STICKY

import synthcam.effects
from synthcam import model as model_module
from synthcam.camera.pinhole import Lamp, PinholeCamera, project_glint
from synthcam.dynamics.batch import solve_collisions
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.effect import LAWS
from synthcam.library import library
from synthcam.model import Model, build_model, list_model_settings, read_model, write_model
from synthcam.scene import scene as scene_module
from synthcam.scene.film_time import FilmedMotion
from synthcam.scene.scene import check_scene
from synthcam_shared.errors import InputError

SETUP = {"time": 0.1, "v0": 0.5, "b": 0.4, "heading": 0.7, "contact": (0.003, -0.001)}
LAMP = (0.05, 0.0, 0.45)
ROW = np.array([[0.003, -0.001, 0.1, 0.5, 0.7, 0.4]])
TIMES = np.linspace(0, 0.3, 151)
FRAMES = 75
NOMINAL = PinholeCamera.overhead(
    (640, 480), 1.6e-4, 0.5, ball_radius=Model().ball.radius, fps=250, exposure=5e-4, psf_sigma_px=1.0
)
every = pytest.mark.parametrize("kind", library().values(), ids=list(library()))
each = pytest.mark.parametrize(
    ("kind", "name"), [(k, p.name) for k in library().values() for p in k.parameters()], ids=lambda x: str(x)
)


def track(*effects):
    model = Model(effects=effects)
    return solve(model, Launch.pair(model.bodies("ab"), **SETUP), 0.0, 0.3).at(TIMES)


def picture(*effects):
    """Compute where a tracker sees the balls, px (2, frames, 2), means over the exposure."""
    model = Model(effects=effects)
    bent = model.laws("camera", NOMINAL, {})
    bent = dataclasses.replace(bent, exposure=float(model.laws("exposure", bent.exposure, {"fps": bent.fps})))
    view = FilmedMotion.solve(model, Launch.pair(model.bodies("ab"), **SETUP), bent, FRAMES)
    px = view.mean(view.spans(FRAMES), lambda states: bent.project(states[..., :3]))

    def mirrored(px, lamp=LAMP):
        centres = view.at(view.spans(FRAMES).mean(axis=1))[..., :3]
        return (
            px + project_glint(bent, Lamp(np.array(lamp), 0.01), centres, Model().ball.radius) - bent.project(centres)
        )

    return model.laws("measure", px, {"glint": mirrored, "mirrored": mirrored})


def present(kind, **values):
    """The effect at its realistic size."""
    return kind(**{p.name: p.typical for p in kind.parameters()} | values)


def defect(kind):
    """A tracker's, which no scene may have."""
    return "measure" in kind.laws


def test_the_library_holds_what_was_asked_for():
    asked = """velocity_restitution ball_friction hop stribeck viscous_friction friction_anisotropy adhesion plate_tilt
        air_drag rolling_quadratic magnetic_attraction mass_mismatch diameter_mismatch eccentric_mass
        spin_transfer_velocity plate_waviness drilling_spin scale_error aspect_error lens_distortion camera_tilt
        clock_error clock_drift dropped_frame exposure_blur rolling_shutter glint_parallax pixel_locking
        unknown_lamp rolling_mismatch friction_mismatch drag_mismatch"""
    assert set(asked.split()) <= set(library())


@every
def test_null_is_absence_bit_for_bit(kind):
    null = present(kind, **{p.name: 0.0 for p in kind.strengths()})
    assert not null.active
    np.testing.assert_array_equal(track(null), track())
    np.testing.assert_array_equal(picture(null), picture())
    starts = np.arange(FRAMES) / 250
    many = [solve_collisions(Model(effects=e), ROW, 0.0, 0.31).average_centres(starts, 5e-4) for e in ((null,), ())]
    np.testing.assert_array_equal(*many)


@each
def test_every_parameter_moves_a_track_or_a_picture(kind, name):
    rule = next(p for p in kind.parameters() if p.name == name)
    others = {p.name: 0.0 for p in kind.strengths() if p.name != name}
    if rule.fixed:  # a shape, beside strengths of realistic size
        near, far = present(kind), present(kind, **{name: 1.5 * rule.typical or 0.3})
        if (kind.name(), name) == ("ball_friction", "beta"):  # means something where the contact sticks
            near, far = present(kind, mu=0.9), present(kind, mu=0.9, beta=0.3)
        if (kind.name(), name) == ("ball_friction", "fall"):  # of the rise, which is none by itself
            near, far = (present(kind, mu=0.01, rise=0.1, fall=v) for v in (rule.typical, 1.5 * rule.typical))
        assert np.abs(picture(far) - picture(near)).max() > 1e-4
    else:
        far = present(kind, **others)
        assert np.abs(picture(far) - picture()).max() > 1e-4
    physical = any(law not in ("camera", "clock", "exposure", "measure") for law in kind.laws)
    reference = track(near) if rule.fixed else track()
    assert (np.abs(track(far) - reference)[..., :2].max() > 1e-8) == physical


@every
def test_it_survives_yaml_and_back(kind, tmp_path):
    model = Model(restitution=0.8, effects=(present(kind),), free=("restitution",))
    write_model(model, tmp_path / "m.yaml")
    assert read_model(tmp_path / "m.yaml") == model
    if defect(kind):
        line = rf"^here: effects\.{kind.name()}: a defect of trackers, expected none in a scene$"
        with pytest.raises(InputError, match=line):
            check_scene(list_model_settings(model), "here")
    else:
        scene = check_scene(list_model_settings(model), "here")
        assert scene.draw(0, 0).model == dataclasses.replace(model, free=())
    assert build_model(yaml.safe_load(yaml.safe_dump(list_model_settings(model))), model.free) == model


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
        assert p.low <= p.typical <= p.high
        assert p.typical > 0 or p.fixed
        assert p.unit
        assert re.search(rf"(?<!\w){p.name}(?!\w)", kind.__doc__), f"its docstring does not say what {p.name} does"
    assert "".join(part.title() for part in kind.name().split("_")) == kind.__name__


def test_no_two_effects_say_the_same():
    """A file that was copied, and its docstring left as it was."""
    said = [" ".join((kind.__doc__ or "").split()) for kind in library().values()]
    assert len(set(said)) == len(said)


def test_a_file_dropped_into_the_folder_is_an_effect(tmp_path, monkeypatch):
    (tmp_path / "sticky_fingers.py").write_text(STICKY)
    caches = [library, model_module.effect_settings, model_module.model_file, scene_module.scene_file]
    monkeypatch.setattr(synthcam.effects, "__path__", [*synthcam.effects.__path__, str(tmp_path)])
    for cache in caches:
        cache.cache_clear()
    try:
        kind = library()["sticky_fingers"]
        clip = check_scene({"effects": {"sticky_fingers": {"k": {"uniform": [0.1, 0.2]}}}}, "x").draw(0, 0)
        assert isinstance(clip.model.effects[0], kind)
        assert 0.1 <= clip.model.value("sticky_fingers.k") <= 0.2
        assert np.abs(track(kind(k=0.05)) - track())[..., :2].max() > 1e-8
        with pytest.raises(InputError, match=r"sticky_fingers\.k: expected a number of 0 or more"):
            check_scene({"effects": {"sticky_fingers": {"k": -1}}}, "x")
    finally:
        sys.modules.pop("synthcam.effects.sticky_fingers", None)
        for cache in caches:
            cache.cache_clear()
    assert "sticky_fingers" in kind.name()
