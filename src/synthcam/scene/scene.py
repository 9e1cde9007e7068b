"""A scene: an experiment whose numbers may be distributions; drawn, it is one clip."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError, create_model
from yaml import YAMLError

from synthcam.camera.pinhole import Camera, Lamp
from synthcam.camera.sensor import Sensor
from synthcam.camera.surface import Surface
from synthcam.dynamics.launch import Launch
from synthcam.model import BallSettings, Model, ModelSettings, build, check_free, effect_settings
from synthcam.scene.apparatus import (
    CameraSettings,
    LampSettings,
    SensorSettings,
    SurfaceSettings,
    camera_of,
    lamp_of,
    surface_of,
)
from synthcam.scene.distribution import choices, corner, drawn, replaced, telling
from synthcam.settings import (
    InputError,
    NotNegative,
    Positive,
    Settings,
    one_line,
    parse_yaml,
    read_yaml,
)

LABELS = {"a": ("b", "a"), "b": ("a", "b")}  # of ball 1 and ball 2, by the striker
UPSTREAM = 0.015 / 0.6  # s: at 0.6 m/s the contact lies 15 mm before the centre, so that the slide's end is in view
Place = Annotated[list[Annotated[float, Field(ge=-1e3, le=1e3)]], Field(min_length=2, max_length=2)]  # m, on the plate


class LaunchSettings(Settings):
    """`launch:` a pair that collides, or a single ball that rolls through `contact` at the contact frame."""

    kind: Literal["pair", "single"] = "pair"
    v0: Positive = 0.3
    b: Annotated[float, Field(gt=-1, lt=1)] = 0.0
    heading: float = 0.0
    striker: Literal["a", "b"] = "b"
    contact: Literal["upstream"] | Place = "upstream"


class TimingSettings(Settings):
    """`timing:` contact_frame is t_c x fps, any real number."""

    fps: Positive = 250.0
    frames: Annotated[int, Field(ge=1, le=1_000_000)] = 100
    exposure: NotNegative = 5e-4
    contact_frame: float = 25.0


@cache
def scene_file() -> type[Settings]:
    """What a scene may hold, as numbers; any number may be a distribution instead."""
    sections: dict[str, Any] = {
        "ball": BallSettings,
        "model": ModelSettings,
        "effects": effect_settings(),
        "launch": LaunchSettings,
        "timing": TimingSettings,
        "camera": CameraSettings,
        "lamp": LampSettings,
        "surface": SurfaceSettings,
        "sensor": SensorSettings,
    }
    fields: dict[str, Any] = {k: (v, v()) for k, v in sections.items()}
    return create_model(
        "Scene",
        __base__=Settings,
        __doc__="A scene of synthcam. The paper's values are the defaults.",
        name=(str, "scene"),
        free=(list[str], []),
        **fields,
    )


@dataclass(frozen=True)
class Clip:
    """One drawn clip: everything that decides its frames, and `drawn`, the plain settings it came from.

    nominal: the camera that the experimenter knows; camera: as it is, with the effects on it.
    """

    number: int
    drawn: dict[str, Any]
    model: Model
    launch: Launch
    nominal: Camera
    camera: Camera
    lamp: Lamp
    surface: Surface
    sensor: Sensor
    frames: int

    @property
    def room(self) -> float:
        return float(self.drawn["lamp"]["room"])


@dataclass(frozen=True)
class Scene:
    """A checked scene: plain settings in which a number may be a distribution."""

    name: str
    settings: dict[str, Any]
    where: str

    def draw(self, number: int, seed: int) -> Clip:
        """Clip `number`. Each value is drawn from its own stream: (seed, clip, key), so that no value moves another."""
        where = f"{self.where}, clip {number}"
        return clip_of(number, _checked(drawn(self.settings, number, seed), where), where)


def clip_of(number: int, drawn: dict[str, Any], where: str = "") -> Clip:
    """The clip of plain, checked settings. Raises InputError when they contradict each other."""
    model, where = build(drawn), where or drawn["name"]
    timing, launch, camera = drawn["timing"], drawn["launch"], drawn["camera"]
    for effect in model.effects:
        if effect.active and "measure" in effect.laws:
            raise InputError(f"{where}: effects.{effect.name()}: a defect of trackers; expected none in a scene")
    if timing["exposure"] > 1 / timing["fps"]:
        raise InputError(f"{where}: timing.exposure: expected at most 1/fps, {1 / timing['fps']:g} s")
    if camera["height"] <= 2 * model.ball.diameter:
        raise InputError(f"{where}: camera.height: expected more than two ball diameters")
    if drawn["lamp"]["position"][2] <= 2 * model.ball.diameter:
        raise InputError(f"{where}: lamp.position: expected z above the balls")
    try:
        lamp = lamp_of(drawn["lamp"])
    except ValueError as e:
        raise InputError(f"{where}: {str(e).replace(' ', '.', 1)}") from None
    nominal = camera_of(drawn, model.ball.radius)
    return Clip(
        number=number,
        drawn=drawn,
        model=model,
        launch=_launch(model, launch, timing["contact_frame"] / timing["fps"]),
        nominal=nominal,
        camera=_as_it_is(model, nominal),
        lamp=lamp,
        surface=surface_of(drawn["surface"]),
        sensor=Sensor(**drawn["sensor"]),
        frames=timing["frames"],
    )


def _as_it_is(model: Model, nominal: Camera) -> Camera:
    bent: Camera = model.laws("camera", nominal, {})
    return replace(bent, exposure=float(model.laws("exposure", nominal.exposure, {"fps": nominal.fps})))


def _launch(model: Model, launch: dict[str, Any], time: float) -> Launch:
    heading, v0, place = launch["heading"], launch["v0"], launch["contact"]
    if place == "upstream":
        place = -UPSTREAM * v0 * np.array([np.cos(heading), np.sin(heading)])
    labels = (launch["striker"],) if launch["kind"] == "single" else LABELS[launch["striker"]]
    bodies = model.bodies(labels)
    if launch["kind"] == "single":
        return Launch.single(bodies, time, v0, heading, place)
    return Launch.pair(bodies, time, v0, launch["b"], heading, place)


def read_scene(path: Path, overrides: tuple[str, ...] = ()) -> Scene:
    """Read and check a scene file, `overrides` as "launch.v0=0.2". Raises InputError."""
    return check_scene(read_yaml(path), str(path), overrides)


def check_scene(loaded: dict[str, Any], where: str, overrides: tuple[str, ...] = ()) -> Scene:
    """Check plain settings: every extreme of every distribution must pass as a number would."""
    settings = copy.deepcopy(loaded)
    for text in overrides:
        _override(settings, text)
    for end in ("low", "high"):
        clip_of(0, _checked(corner(settings, end, "", where), where), where)
    low = corner(settings, "low", "", where)
    for key, options in choices(settings):
        for option in telling(options, ".".join(key), where):
            _checked(replaced(low, key, option), where)
    check_free(settings.get("free") or (), where)
    return Scene(str(settings.get("name", "scene")), settings, where)


def _checked(plain: dict[str, Any], where: str) -> dict[str, Any]:
    try:
        return scene_file().model_validate(plain).model_dump(exclude_none=True)
    except ValidationError as e:
        raise one_line(e, where) from None


def _override(settings: dict[str, Any], text: str) -> None:
    key, equals, value = text.partition("=")
    if not equals or not key:
        raise InputError(f"--set {text}: expected key=value, as in launch.v0=0.2")
    *parents, last = key.split(".")
    here = settings
    for parent in parents:
        here = here.setdefault(parent, {})
        if not isinstance(here, dict):
            raise InputError(f"--set {text}: {parent} holds a value, not keys")
    try:
        here[last] = parse_yaml(value)
    except YAMLError:
        raise InputError(f"--set {text}: the value is not plain YAML") from None


def schema() -> dict[str, Any]:
    """JSON Schema of a scene, distributions included."""
    plain = scene_file().model_json_schema()
    number = {"type": "number"}
    pair = {"type": "array", "items": number, "minItems": 2, "maxItems": 2}
    plain["$defs"]["Distribution"] = {
        "title": "drawn anew for each clip",
        "oneOf": [
            {"type": "object", "properties": {k: v}, "required": [k], "additionalProperties": False}
            for k, v in (("uniform", pair), ("normal", pair), ("choice", {"type": "array", "minItems": 1}))
        ],
    }
    sections = [d for name, d in plain["$defs"].items() if name != "Distribution"]
    for definition in sections:
        for name, rule in definition.get("properties", {}).items():
            if rule.get("type") in ("number", "integer") or "enum" in rule:
                about = {k: rule.pop(k) for k in ("default", "title", "description") if k in rule}
                definition["properties"][name] = about | {"anyOf": [rule, {"$ref": "#/$defs/Distribution"}]}
    return plain
