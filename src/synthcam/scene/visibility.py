"""Check that a film shows its balls: few frames show a ball that is too fast, or outside the view."""

import itertools
import math

import numpy as np

from synthcam.scene.clip import Clip
from synthcam.scene.distribution import draw_settings
from synthcam.scene.scene import Scene


def describe_unseen_balls(scene: Scene, number: int = 0, seed: int = 0, *, clip: Clip | None = None) -> str:
    """Describe, in one line, a ball that hardly any frame of a clip shows; "" if its film shows all balls.

    clip: the scene's clip of that number and seed, if it is drawn already.
    """
    min_frames = 5  # fewer say little about a path
    try:
        clip = clip or scene.draw(number, seed)
        view = clip.view
    except ValueError:  # its maker reports a clip that cannot be made
        return ""
    centres = view.at(view.spans(clip.frames).mean(axis=1))[..., :3]
    size, least = np.array(clip.camera.size), min(min_frames, -(-clip.frames // 2))
    for ball, path in enumerate(centres):
        px = clip.camera.project(path)
        shown = int(((px > -0.5) & (px < size - 0.5)).all(axis=1).sum())
        if shown >= least:
            continue
        who = "the ball" if len(centres) == 1 else f"ball {ball + 1}"
        said = f"{who} is in the picture in {shown} of {clip.frames} frames; expected {least} or more"
        speed, key, place = _find_keys(scene, clip, ball, seed)
        camera = clip.nominal
        step, width = speed / camera.fps, camera.scale * camera.size[0]
        moves = f"{key} {speed:g} m/s is {step:.3g} m a frame, in a picture of {width:.3g} m"
        cure = f"lower {key}, or raise timing.fps or camera.scale" if step > width / 20 else f"check timing and {place}"
        return f"{scene.where}, clip {clip.number}: {said}. {moves}: {cure}"
    return ""


def _find_keys(scene: Scene, clip: Clip, ball: int, seed: int) -> tuple[float, str, str]:
    """Find the speed of a ball's launch, m/s, and the keys of the scene that set this speed and its position."""
    launches = clip.drawn.get("launches")
    if not launches:
        return clip.drawn["launch"]["v0"], "launch.v0", "launch"
    speed = math.hypot(*launches[ball]["velocity"])
    groups = draw_settings(scene.settings, clip.number, seed).get("groups") or []
    first = len(launches) - sum(group["count"] for group in groups)
    if ball < first:
        return speed, f"launches.{ball}.velocity", f"launches.{ball}.position"
    firsts = itertools.accumulate((group["count"] for group in groups), initial=first)
    number = sum(k <= ball for k in firsts) - 1
    group, key = groups[number], f"groups.{number}"
    scattered = group.get("rms_speed", 0.0) >= math.hypot(*group.get("velocity", (0.0, 0.0)))
    return speed, f"{key}.{'rms_speed' if scattered else 'velocity'}", f"{key}.centre"
