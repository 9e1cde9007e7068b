"""Answer requests for pictures of scenes, a line of JSON each, for a page whose sliders move the numbers of a scene."""

from __future__ import annotations

import base64
import json
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import yaml
from pydantic import Field

from synthcam.dataset.preview import show_on_screen
from synthcam.dataset.scene_sliders import list_sliders, move_sliders
from synthcam.scene.clip import Clip
from synthcam.scene.materials import is_under_room_light
from synthcam.scene.scene import Scene, check_scene, read_scene
from synthcam.scene.visibility import describe_unseen_balls
from synthcam.settings import SCENES
from synthcam_shared.errors import InputError, NoGL
from synthcam_shared.settings import Settings, build_settings


class PreviewRequest(Settings):
    """One line of a request; without `scene` it asks for the names of the scenes.

    - values: of sliders, by their names; seed: of everything random
    - frame: None for the last frame before the first contact
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
    shown = clip if sharp else _reduce_camera(moved.settings, clip, request.seed)
    k = _choose_frame(clip) if request.frame is None else min(request.frame, clip.frames - 1)
    picture = show_on_screen(shown.sketch(k, quick=not request.sharp), shown)
    encoded = cv2.imencode(
        ".png", picture[..., ::-1] if picture.ndim == 3 else picture, [cv2.IMWRITE_PNG_COMPRESSION, 1]
    )
    return {
        "picture": base64.b64encode(encoded[1].tobytes()).decode(),
        "size": list(clip.camera.size),
        "sharp": sharp,
        "frame": k,
        "frames": clip.frames,
        "paths": _find_paths(clip),
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


def _choose_frame(clip: Clip) -> int:
    """The last frame before the first contact, or the middle one."""
    hit = clip.view.motion.first("contact")
    when = hit.t - clip.camera.exposure if hit else 0.5 * clip.frames / clip.camera.fps
    return min(max(int(when * clip.camera.fps), 0), clip.frames - 1)


def _find_paths(clip: Clip, *, most: int = 60) -> list[list[list[float]]]:
    """The positions of each ball in at most so many frames, px."""
    times = np.unique(np.linspace(0, clip.frames - 1, most).round()) / clip.camera.fps
    pixels = [clip.camera.project(path) for path in clip.view.at(times)[:, :, :3]]
    return [[[round(float(x), 1), round(float(y), 1)] for x, y in path] for path in pixels]
