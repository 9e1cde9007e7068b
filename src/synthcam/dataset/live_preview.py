"""Answer requests for pictures of scenes, a line of JSON each, for a page whose sliders move the numbers of a scene."""

import base64
import copy
import json
import math
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import yaml
from pydantic import Field

from synthcam.dataset.labelled_frames import encode_png
from synthcam.dataset.preview import find_telling_frame, show_on_screen
from synthcam.scene.clip import Clip
from synthcam.scene.distribution import parse_distribution
from synthcam.scene.materials import is_under_room_light
from synthcam.scene.scene import Scene, check_scene, read_scene
from synthcam.scene.visibility import describe_unseen_balls
from synthcam.settings import SCENES
from synthcam_shared.errors import InputError, NoGL
from synthcam_shared.settings import Settings, build_settings


class PreviewRequest(Settings):
    """One line of a request; without `scene` it asks for the names of the scenes.

    - values: of sliders, by their names; seed: of everything random
    - frame: None for the last frame before the first contact, or the middle one without a contact
    - sharp: in full size, whatever time it takes
    """

    scene: Annotated[str, Field(pattern=r"^\w*$")] = ""
    values: dict[str, float] = Field(default_factory=dict)
    seed: Annotated[int, Field(ge=0)] = 0
    frame: Annotated[int, Field(ge=0)] | None = None
    sharp: bool = False


def answer_requests(lines: Iterable[str], write: Callable[[str], None]) -> None:
    """Answer each line with one line: an object, whose key `error` alone says why there is no picture."""
    for line in lines:
        try:
            answer = answer_request(json.loads(line))
        except RecursionError:
            answer = {"error": "preview: nested too deeply"}
        except (InputError, NoGL, ValueError, OverflowError, MemoryError) as error:
            answer = {"error": " ".join(f"{error}".split())}
        write(json.dumps(answer))


def answer_request(values: Any) -> dict[str, Any]:
    """The names of the scenes, or a picture with the scene as YAML, its sliders and the paths of its balls.

    Raises InputError or NoGL.
    """
    request = build_settings(values, PreviewRequest, "preview")
    if not request.scene:
        return {"scenes": [path.stem for path in sorted(SCENES.glob("*.yaml"))]}
    began, path = time.perf_counter(), SCENES / f"{request.scene}.yaml"
    if not path.is_file():
        raise InputError(f"{request.scene}: no such file among the scenes of synthcam")
    scene, start, moved, clip = _draw_moved_scene(path, tuple(sorted(request.values.items())), request.seed)
    sharp = request.sharp or not is_under_room_light(clip.drawn)
    times = np.unique(np.linspace(0, clip.frames - 1, num=60).round()) / clip.camera.fps
    paths = [clip.camera.project(path).astype(float).tolist() for path in clip.view.at(times)[:, :, :3]]
    shown = clip if sharp else _reduce_camera(moved.settings, clip, request.seed)
    k = find_telling_frame(clip) if request.frame is None else min(request.frame, clip.frames - 1)
    picture = show_on_screen(shown.sketch(k, quick=not request.sharp), shown)
    return {
        "picture": base64.b64encode(encode_png(picture, compression=1)).decode(),
        "size": list(clip.camera.size),
        "sharp": sharp,
        "frame": k,
        "frames": clip.frames,
        "paths": [[[round(x, 1), round(y, 1)] for x, y in path] for path in paths],
        "yaml": yaml.safe_dump(moved.settings, sort_keys=False, default_flow_style=None, width=100),
        "sliders": [asdict(slider) for slider in list_sliders(scene, start)],
        "used": [slider.name for slider in list_sliders(moved, clip.drawn)],
        "hint": describe_unseen_balls(moved, seed=request.seed, clip=clip),
        "ms": round(1e3 * (time.perf_counter() - began), 1),
    }


@lru_cache(maxsize=1)  # another frame, or a sharp picture, needs no new solution of the motion
def _draw_moved_scene(
    path: Path, values: tuple[tuple[str, float], ...], seed: int
) -> tuple[Scene, dict[str, Any], Scene, Clip]:
    """A scene, its drawn settings, the scene with the numbers of the sliders, and a clip of that."""
    scene = read_scene(path)
    start = scene.draw(seed=seed).drawn
    moved = check_scene(move_sliders(scene, start, dict(values)), path.stem)
    return scene, start, moved, moved.draw(seed=seed)


def _reduce_camera(settings: dict[str, Any], clip: Clip, seed: int, *, factor: int = 4) -> Clip:
    """The same clip in so many times fewer columns and rows: matte balls take a hundred times longer than mirrors."""
    camera = clip.drawn["camera"]
    smaller: dict[str, Any] = {
        "size": [max(n // factor, 16) for n in camera["size"]],
        "psf_sigma_px": max(camera["psf_sigma_px"] / factor, 0.3),
        "defocus_px": camera["defocus_px"] / factor,
    }
    smaller |= {key: camera[key] * factor for key in ("scale", "pixel_pitch", "line_time")}
    reduced = {key: value for key, value in settings.items() if key != "video"}
    reduced["camera"] = settings.get("camera", {}) | smaller
    return replace(check_scene(reduced, "preview").draw(seed=seed), trajectory=clip.view.motion)


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
    light = sensor.get("white" if is_under_room_light(drawn) else "glint_peak", 200.0)
    at = drawn["lamp"]["position"][0]
    far = 2e3 * max(abs(at), camera["size"][0] * camera["scale"])
    pair = not _has_many(scene.settings) and drawn["launch"]["kind"] == "pair"
    return [
        Slider("speed", "Speed", *_find_speed(scene.settings, drawn)),
        *([Slider("offset", "Offset b", "", drawn["launch"]["b"], -0.95, 0.95)] if pair else []),
        Slider("restitution", "Restitution r", "", drawn["model"]["restitution"], 0.0, 1.0),
        Slider("friction", "Sliding friction", "", drawn["model"]["sliding_friction"], 0.01, 0.6),
        Slider("balls", "Balls", "", *_count_balls(scene.settings, drawn), whole=True),
        Slider("light", "Light", "counts", light, 5.0, max(4 * light, 800.0)),
        Slider("lamp", "Lamp, to the right", "mm", 1e3 * at, -far, far, 1e3),
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
    most = 60  # that a slider offers
    if "groups" in settings:
        count = settings["groups"][-1]["count"]
        return count, 1, max(count, most)
    if "launches" in settings:
        return len(settings["launches"]), 1, len(settings["launches"])
    camera, own = drawn["camera"], drawn["ball"]["diameter"]
    area = math.prod(camera["size"]) * camera["scale"] ** 2
    return 1 + (drawn["launch"]["kind"] == "pair"), 1, max(2, min(most, int(0.1 * area / own**2)))


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
