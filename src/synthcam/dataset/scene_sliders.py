"""The numbers of a scene that a page moves by sliders, such as speed, friction, exposure and number of balls."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from synthcam.scene.distribution import parse_distribution
from synthcam.scene.materials import is_under_room_light
from synthcam.scene.scene import Scene
from synthcam_shared.errors import InputError

MAX_BALLS = 60  # that a slider offers


@dataclass(frozen=True)
class Slider:
    """One number of a scene, in `unit`; `factor` units are one of SI."""

    name: str
    label: str
    unit: str
    value: float
    low: float
    high: float
    factor: float = 1.0
    whole: bool = False


def list_sliders(scene: Scene, drawn: dict[str, Any]) -> list[Slider]:
    """The sliders of a scene. drawn: the settings of the clip whose numbers they show at first."""
    timing, sensor, camera = drawn["timing"], drawn["sensor"], drawn["camera"]
    speed, light = (
        _find_speed(scene.settings, drawn),
        sensor.get("white" if is_under_room_light(drawn) else "glint_peak", 200.0),
    )
    at, field = drawn["lamp"]["position"][0], camera["size"][0] * camera["scale"]
    listed = [Slider("speed", "Speed", *speed)]
    if not _has_many(scene.settings) and drawn["launch"]["kind"] == "pair":
        listed.append(Slider("offset", "Offset b", "", drawn["launch"]["b"], -0.95, 0.95))
    return [
        *listed,
        Slider("restitution", "Restitution r", "", drawn["model"]["restitution"], 0.0, 1.0),
        Slider("friction", "Sliding friction", "", drawn["model"]["sliding_friction"], 0.01, 0.6),
        Slider("balls", "Balls", "", *_count_balls(scene.settings, drawn), whole=True),
        Slider("light", "Light", "counts", light, 5.0, max(4 * light, 800.0)),
        Slider(
            "lamp", "Lamp, to the right", "mm", 1e3 * at, -2e3 * max(abs(at), field), 2e3 * max(abs(at), field), 1e3
        ),
        Slider("exposure", "Exposure", "ms", 1e3 * timing["exposure"], 0.0, 1e3 / timing["fps"], 1e3),
        Slider("noise", "Read noise", "e-", sensor["read_noise"], 0.0, max(3 * sensor["read_noise"], 200.0)),
    ]


def move_sliders(scene: Scene, drawn: dict[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of a scene with sliders at other values; all other numbers stay as they are. Raises InputError."""
    sliders = {slider.name: slider for slider in list_sliders(scene, drawn)}
    settings = copy.deepcopy(scene.settings)
    for name, value in values.items():
        if name not in sliders:
            raise InputError(f"{scene.where}: expected one of {', '.join(sliders)}, not {name!r}")
        slider = sliders[name]
        if isinstance(value, bool) or not isinstance(value, int | float) or not slider.low <= value <= slider.high:
            raise InputError(f"{slider.label}: expected {slider.low:g} to {slider.high:g}, not {value!r}")
        moved = round(value) if slider.whole else float(f"{value / slider.factor:.6g}")
        if name == "speed":
            _set_speed(settings, moved)
        elif name != "balls":
            light = "white" if is_under_room_light(drawn) else "glint_peak"
            section, key = {
                "offset": ("launch", "b"),
                "restitution": ("model", "restitution"),
                "friction": ("model", "sliding_friction"),
                "light": ("sensor", light),
                "lamp": ("lamp", "position"),
                "exposure": ("timing", "exposure"),
                "noise": ("sensor", "read_noise"),
            }[name]
            own = [moved, *drawn["lamp"]["position"][1:]] if name == "lamp" else moved
            settings.setdefault(section, {})[key] = own
    if "balls" in values:  # the last: a pair becomes a group of its speed
        _set_balls(settings, drawn, round(values["balls"]))
    return settings


def _has_many(settings: Mapping[str, Any]) -> bool:
    return "launches" in settings or "groups" in settings


def _find_speed(settings: Mapping[str, Any], drawn: Mapping[str, Any]) -> tuple[str, float, float, float]:
    """Unit, value, lowest and highest value: of the pair, of the last group, or a factor on all launches."""
    if not _has_many(settings):
        speed = drawn["launch"]["v0"]
    elif "launches" in settings:
        return "times", 1.0, 0.05, 3.0
    else:
        given = settings["groups"][-1].get("rms_speed", 0.0)
        found = parse_distribution(given, "rms_speed", "")
        speed = sum(found[1]) / 2 if found and found[0] == "uniform" else found[1][0] if found else given
    return "m/s", float(speed), 0.02, max(1.0, 3 * float(speed))


def _set_speed(settings: dict[str, Any], speed: float) -> None:
    if not _has_many(settings):
        settings.setdefault("launch", {})["v0"] = speed
    elif "launches" in settings:
        for launch in settings["launches"]:
            launch["velocity"] = _scale(launch.get("velocity", [0.0, 0.0]), speed)
    else:
        settings["groups"][-1]["rms_speed"] = speed


def _scale(value: Any, factor: float) -> Any:
    """Numbers, and those of distributions, times a factor."""
    if isinstance(value, dict):
        return {key: _scale(part, factor) for key, part in value.items()}
    return [_scale(part, factor) for part in value] if isinstance(value, list) else value * factor


def _count_balls(settings: Mapping[str, Any], drawn: Mapping[str, Any]) -> tuple[int, int, int]:
    """The number of balls, the lowest and the highest: of the last group, of the launches, or in place of a pair."""
    if "groups" in settings:
        count = settings["groups"][-1]["count"]
        return count, 1, max(count, MAX_BALLS)
    if "launches" in settings:
        return len(settings["launches"]), 1, len(settings["launches"])
    camera, own = drawn["camera"], drawn["ball"]["diameter"]
    area = math.prod(camera["size"]) * camera["scale"] ** 2
    return 1 + (drawn["launch"]["kind"] == "pair"), 1, max(2, min(MAX_BALLS, int(0.1 * area / own**2)))


def _set_balls(settings: dict[str, Any], drawn: Mapping[str, Any], count: int) -> None:
    if "groups" in settings:
        settings["groups"][-1]["count"] = count
    elif "launches" in settings:
        settings["launches"] = settings["launches"][:count]
        if isinstance(settings.get("bodies"), list):
            settings["bodies"] = settings["bodies"][:count]
    elif count <= 2:
        settings.setdefault("launch", {})["kind"] = "pair" if count == 2 else "single"
    else:
        camera, speed = drawn["camera"], settings.pop("launch", {}).get("v0", drawn["launch"]["v0"])
        size = [0.6 * n * camera["scale"] for n in camera["size"]]
        gap = 0.1 * drawn["ball"]["diameter"]
        settings["groups"] = [{"count": count, "size": size, "gap": gap, "rms_speed": speed}]
