"""Check that a film shows its balls: few frames show a ball that is too fast, or outside the view."""

from __future__ import annotations

import numpy as np

from synthcam.scene.scene import Scene


def describe_unseen_balls(scene: Scene, number: int = 0, seed: int = 0, *, min_frames: int = 5) -> str:
    """Describe, in one line, a ball that hardly any frame of a clip shows; "" if its film shows all balls.

    min_frames: of a ball in the picture; fewer say little about its path.
    """
    try:
        clip = scene.draw(number, seed)
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
        drawn, camera = clip.drawn, clip.nominal
        step, width = drawn["launch"]["v0"] / camera.fps, camera.scale * camera.size[0]
        who = "the ball" if len(centres) == 1 else f"ball {ball + 1}"
        said = f"{who} is in the picture in {shown} of {clip.frames} frames; expected {least} or more"
        moves = f"launch.v0 {drawn['launch']['v0']:g} m/s is {step:.3g} m a frame, in a picture of {width:.3g} m"
        cure = (
            "lower launch.v0, or raise timing.fps or camera.scale" if step > width / 20 else "check timing and launch"
        )
        return f"{scene.where}, clip {number}: {said}. {moves}: {cure}"
    return ""
