"""A scene: an experiment whose numbers may be distributions. Each draw is one clip."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, create_model
from yaml import YAMLError

from synthcam.library import cache_until_effects_change
from synthcam.model import (
    SYMBOLS,
    BallSettings,
    ModelSettings,
    check_free,
    effect_settings,
    list_model_settings,
    model_file,
    read_model,
    refuse_search_only_laws,
    resolve_symbols,
    table_settings,
)
from synthcam.scene.apparatus import CameraSettings, SceneLampSettings, SensorSettings, SurfaceSettings, VideoSettings
from synthcam.scene.bodies import MAX_BODIES, MAX_WALLS, ManyBodiesSettings, Point
from synthcam.scene.clip import Clip, build_clip
from synthcam.scene.distribution import (
    draw_settings,
    find_choices,
    find_distributions,
    pick_representatives,
    replace_at,
    replace_by_extremes,
)
from synthcam.scene.groups import GroupSettings
from synthcam.settings import InputError, read_yaml
from synthcam_shared.arguments import check_arguments
from synthcam_shared.settings import NotNegative, Positive, Settings, build_settings, parse_yaml

MAX_GROUPS = 100

Speed = Annotated[float, Field(ge=-1e3, le=1e3)]  # m/s


def _check_radians(angle: float) -> float:
    largest = 10.0  # a larger angle must be in degrees
    if abs(angle) > largest:
        raise ValueError(f"expected radians from {-largest:g} to {largest:g}")
    return angle


class LaunchSettings(Settings):
    """`launch:` a pair that collides, or a single ball that rolls through `contact` at the contact frame.

    - v0: speed of the striker at contact, m/s; b: impact parameter over the sum of the radii; heading: rad
    - striker: the ball that moves; contact: where the balls touch, m, or "upstream" of the origin
    - slip_along, slip_across, side: spin of a striker that does not roll, m/s; see `Launch.pair`
    """

    kind: Literal["pair", "single"] = "pair"
    v0: Positive = 0.3
    b: Annotated[float, Field(gt=-1, lt=1)] = 0.0
    heading: Annotated[float, AfterValidator(_check_radians)] = 0.0
    striker: Literal["a", "b"] = "b"
    contact: Literal["upstream"] | Point = "upstream"
    slip_along: Speed = 0.0
    slip_across: Speed = 0.0
    side: Speed = 0.0


class TimingSettings(Settings):
    """`timing:` contact_frame is t_c x fps, any real number."""

    fps: Positive = 250.0
    frames: Annotated[int, Field(ge=1, le=1_000_000)] = 100
    exposure: NotNegative = 5e-4
    contact_frame: float = 25.0


@cache_until_effects_change
def scene_file() -> type[Settings]:
    """The sections of a scene as a pydantic model, for numbers; any number may be a distribution instead."""
    return _define_scene(effect_settings(), table_settings())


@cache
def _scene_file_without_effects() -> type[Settings]:
    """The same for scenes without effects and free laws: the library takes .07 s to load."""
    return _define_scene(Settings, Settings)


def _define_scene(effects: type[Settings], free_laws: type[Settings]) -> type[Settings]:
    sections: dict[str, Any] = {
        "ball": BallSettings,
        "model": ModelSettings,
        "effects": effects,
        "launch": LaunchSettings,
        "timing": TimingSettings,
        "camera": CameraSettings,
        "lamp": SceneLampSettings,
        "surface": SurfaceSettings,
        "sensor": SensorSettings,
    }
    fields: dict[str, Any] = {k: (v, v()) for k, v in sections.items()}
    fields |= {k: (f.annotation, f) for k, f in ManyBodiesSettings.model_fields.items()}
    fields["groups"] = (Annotated[list[GroupSettings], Field(min_length=1, max_length=MAX_GROUPS)] | None, None)
    fields["free_laws"] = (free_laws | None, None)
    return create_model(
        "Scene",
        __base__=Settings,
        __doc__="A scene of synthcam. The paper's values are the defaults.",
        name=(str, "scene"),
        free=(list[str], []),
        video=(VideoSettings | None, None),
        **fields,
    )


@dataclass(frozen=True, repr=False)
class Scene:
    """An experiment: checked settings in which a number may be a distribution that is drawn for each clip.

    Attributes
    ----------
    name : str
    settings : dict
        By section, as in the scene's file. Missing keys have the paper's value. See docs/format.md.
    where : str
        Name of the file, for messages.

    Examples
    --------
    >>> import synthcam
    >>> scene = synthcam.Scene.read("painter_behringer", launch={"b": 0.2, "heading": 0.0})
    >>> scene
    Scene painter-behringer: launch.v0 uniform [0.1, 0.6], timing.contact_frame uniform [20, 30]
    >>> [round(scene.draw(k, seed=1).truth["v0"], 4) for k in range(2)]
    [0.3854, 0.5448]
    """

    name: str
    settings: dict[str, Any]
    where: str

    @classmethod
    @check_arguments
    def read(cls, path: str | Path, **sections: Any) -> Scene:
        """Read a scene's YAML file, and change some of it.

        Parameters
        ----------
        path : str or Path
            A file, or the name of one that comes with synthcam ("painter_behringer", "scenes/oblique.yaml").
        **sections
            Values that replace the file's. ``launch={"v0": 0.3}`` changes only that key of its section;
            ``effects={"plate_tilt": {"x": 1e-3}}`` adds an effect to those of the file.

        Returns
        -------
        Scene

        Raises
        ------
        InputError
            If the file is not a scene: one line with file and key.
        """
        loaded = read_yaml(Path(path))
        for name, values in sections.items():
            here = loaded.get(name)
            kept = here if isinstance(here, dict) else {}
            plain = _plain(values)
            if isinstance(plain, dict):  # under one name each, so that a value replaces the file's
                kept, plain = (resolve_symbols({name: part}, str(path))[name] for part in (kept, plain))
                plain = kept | plain
            loaded[name] = plain
        return check_scene(loaded, str(path))

    @classmethod
    @check_arguments
    def build(cls, name: str = "scene", **sections: Any) -> Scene:
        """Build a scene from values, without a file.

        Parameters
        ----------
        name : str
        **sections
            Dicts with the keys of the scene's file, as ``launch={"v0": {"uniform": [0.1, 0.6]}, "b": 0.2}`` and
            ``effects={"plate_tilt": {"x": 1e-3}}``. Missing keys have the paper's value.

        Returns
        -------
        Scene

        Raises
        ------
        InputError
            If a key or value is wrong: one line with the key.

        Examples
        --------
        >>> import synthcam
        >>> synthcam.Scene.build("fast", launch={"v0": {"uniform": [0.4, 0.6]}}, timing={"fps": 500})
        Scene fast: launch.v0 uniform [0.4, 0.6]
        """
        return check_scene({"name": name} | _plain(sections), name)

    def __repr__(self) -> str:
        listed = [f"{key} {kind} {value}" for key, kind, value in find_distributions(self.settings)]
        listed[4:] = [f"{len(listed) - 4} more"] if len(listed) > 4 else []
        return f"Scene {self.name}: {', '.join(listed) or 'all clips are the same except for noise'}"

    @check_arguments
    def draw(self, number: int = 0, seed: int = 0) -> Clip:
        """Draw a clip.

        Parameters
        ----------
        number : int
            Its number. Each value has its own random stream, by seed, number and key, independent of the others.
        seed : int
            Of everything random, the sensor's noise included.

        Returns
        -------
        Clip
            The clip of that number in the dataset that ``synthcam generate --seed`` makes.

        Raises
        ------
        InputError
            If the drawn values contradict each other.
        """
        for name, value in (("number", number), ("seed", seed)):
            if value < 0:
                raise InputError(f"{name}: expected 0 or more, not {value}")
        where = f"{self.where}, clip {number}"
        return build_clip(number, _validate(draw_settings(self.settings, number, seed), where), seed, where)


def rebuild_clip(number: int, drawn: dict[str, Any], where: str) -> Clip:
    """Rebuild a scene's clip from its `drawn` settings, as datasets record them: camera, lamp, bodies of the film.

    Raises InputError, which begins with `where`.
    """
    return build_clip(number, _validate(drawn, where), where=where)


def _plain(value: Any) -> Any:
    """Convert numpy's numbers, arrays and tuples to the types that YAML gives."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    return [_plain(v) for v in value] if isinstance(value, list | tuple) else value


def read_scene(path: Path, overrides: tuple[str, ...] = (), model: Path | None = None) -> Scene:
    """Read and check a scene file. Raises InputError.

    overrides: as "launch.v0=0.2". model: a model file, whose ball, model, effects and free laws replace the scene's.
    """
    loaded = read_yaml(path)
    if model is not None:
        physics = list_model_settings(read_model(model))
        loaded = {k: v for k, v in loaded.items() if k not in model_file().model_fields} | physics
    return check_scene(loaded, str(path), overrides)


def check_scene(loaded: dict[str, Any], where: str, overrides: tuple[str, ...] = ()) -> Scene:
    """Check settings as in a YAML file: both extremes of every distribution must be valid numbers. Raises InputError.

    where: name of the file, for messages. overrides: as "launch.v0=0.2".
    """
    _refuse_long_tables(loaded, where)
    settings = resolve_symbols(copy.deepcopy(loaded), where)
    for many in ("launches", "groups"):
        if many in settings and "launch" in settings:
            raise InputError(f"{where}: launch: of one pair, beside {many} of many bodies; expected one of the two")
    for text in overrides:
        _apply_override(settings, text)
    refuse_search_only_laws(settings.get("free_laws"), where)
    low = replace_by_extremes(settings, "low", where)
    for plain in (low, replace_by_extremes(settings, "high", where)):
        build_clip(0, _validate(plain, where), where=where)
    for key, options in find_choices(settings):
        for option in pick_representatives(options, ".".join(key), where):
            _validate(replace_at(low, key, option), where)
    check_free(settings.get("free") or (), where)
    return Scene(str(settings.get("name", "scene")), settings, where)


def _refuse_long_tables(loaded: dict[str, Any], where: str) -> None:
    """Raises InputError for more entries than any table of a scene may have, before they are copied and checked."""
    limits = {"launches": MAX_BODIES, "bodies": MAX_BODIES, "walls": MAX_WALLS, "groups": MAX_GROUPS}
    tables = [(key, loaded.get(key), limit) for key, limit in limits.items()]
    groups = loaded.get("groups")
    if isinstance(groups, list):
        dicts = ((k, group) for k, group in enumerate(groups[:MAX_GROUPS]) if isinstance(group, dict))
        tables += [(f"groups.{k}.body", group.get("body"), MAX_BODIES) for k, group in dicts]
    for key, table, limit in tables:
        if isinstance(table, list) and len(table) > limit:
            raise InputError(f"{where}: {key}: expected {limit} values or fewer, found {len(table)}")


def _validate(plain: dict[str, Any], where: str) -> dict[str, Any]:
    without = all(plain.get(key, {}) == {} for key in ("effects", "free_laws"))
    kind = _scene_file_without_effects() if without else scene_file()
    settings = build_settings(plain, kind, where).model_dump(exclude_none=True)
    if "launches" in settings or "groups" in settings:
        return settings
    for key in (k for k in ManyBodiesSettings.model_fields if k in plain):
        raise InputError(f"{where}: {key}: of a scene of many bodies; expected `launches` or `groups` with it")
    return {k: v for k, v in settings.items() if k not in ManyBodiesSettings.model_fields}


def _apply_override(settings: dict[str, Any], text: str) -> None:
    key, equals, value = text.partition("=")
    if not equals or not key:
        raise InputError(f"--set {text}: expected key=value, as in launch.v0=0.2")
    *parents, last = key.split(".")
    text = text if len(text) <= 80 else f"{text[:80]}..."
    max_depth = 8  # of a key under others; scenes have 2
    if len(parents) > max_depth:
        raise InputError(f"--set {text}: {len(parents) + 1} keys deep, expected at most {max_depth + 1}")
    last = SYMBOLS.get(last, last) if parents == ["model"] else last
    here = settings
    for parent in parents:
        here = here.setdefault(parent, {})
        if not isinstance(here, dict):
            raise InputError(f"--set {text}: {parent} holds a value, not keys")
    try:
        here[last] = parse_yaml(value)
    except YAMLError as error:
        reason = getattr(error, "problem", None) or "unreadable"
        raise InputError(f"--set {text}: the value is not plain YAML ({reason})") from None


def schema() -> dict[str, Any]:
    """Make the JSON Schema of a scene, distributions included."""
    plain = scene_file().model_json_schema()
    number = {"type": "number"}
    pair = {"type": "array", "items": number, "minItems": 2, "maxItems": 2}
    plain["$defs"]["Distribution"] = {
        "title": "drawn for each clip",
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
