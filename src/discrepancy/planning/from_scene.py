"""Design the experiment of a scene: its collisions without rendering, with the errors of its camera."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from discrepancy.arrays import Array
from discrepancy.data.launch import equalise_launches
from discrepancy.data.study_design import split_held_out
from discrepancy.fitting.parameters import list_names_to_fit
from discrepancy.planning.experiment import (
    Errors,
    PlannedExperiment,
    PredictedGlintErrors,
    StatedErrors,
    make_unmeasured_clip,
)
from discrepancy.policy import current_policy
from synthcam.dynamics.launch import SPIN_COLUMNS
from synthcam.model import Model
from synthcam.scene.clip import Clip
from synthcam.scene.scene import Scene
from synthcam_shared.arguments import name_arguments
from synthcam_shared.errors import InputError
from tracker.camera.camera import Camera
from tracker.camera.views import find_first_difference


@dataclass(frozen=True)
class SceneExperiment:
    """The experiment of a scene."""

    experiment: PlannedExperiment  # the collisions that a search would fit; it holds out a quarter of them
    drawn: int  # collisions that were drawn
    usable: int  # collisions with enough frames in view
    notes: tuple[str, ...]  # influences that the errors do not include


def design_experiment(scene: Scene, count: int, noise_px: float | None = None, seed: int = 0) -> SceneExperiment:
    """Draw the collisions of a scene and predict what its camera would see of them.

    count: collisions to record. noise_px: error of a position, each axis; default: the limit of the scene's camera and
    lamp. seed: of all random numbers. Raises InputError if no search is possible with such clips.
    """
    least = current_policy().min_collisions
    if count < least:
        raise InputError(f"clips: expected {least} or more, to fit some and hold out others; found {count}")
    if noise_px is not None and not 0 < noise_px < np.inf:
        raise InputError(f"noise: expected an error of positions over 0 px, found {noise_px:g}")
    clips = [scene.draw(number, seed) for number in range(count)]
    for clip in clips:
        if (kind := clip.drawn["launch"]["kind"]) != "pair":
            raise InputError(f"{scene.where}: launch.kind: expected pair, found {kind}: no collision")
    model, camera = _shared_model_and_camera(scene, clips)
    launches = equalise_launches([_launch(c) for c in clips])
    whole = PlannedExperiment(
        model=model,
        names=list_names_to_fit(model),
        clips=tuple(
            make_unmeasured_clip(k, str(c.drawn["launch"]["striker"]), camera, launches[k], range(c.frames))
            for k, c in enumerate(clips)
        ),
        launches=np.array(launches),
        films=tuple(range(c.frames) for c in clips),
        errors=_errors(clips[0], noise_px, scene.where),
    )
    try:
        filmed = whole.observe()
    except ValueError as e:
        raise InputError(f"{scene.where}: the model has no motion for these launches: {e}") from None
    usable = len(filmed.clips)
    if usable < least:
        raise InputError(
            f"{scene.where}: both balls are in view before and after the contact in {usable} of {count} clips; "
            f"expected {least} or more"
        )
    kept = {c.clip for c in split_held_out(filmed.clips)[0]}
    rest = filmed.select([k for k, c in enumerate(filmed.clips) if c.clip in kept])
    notes: tuple[str, ...] = ()
    if noise_px is None and clips[0].drawn.get("video"):
        text = "the errors do not include the video encoder's loss; --noise PX sets the error of a position instead"
        notes = (name_arguments(text),)
    return SceneExperiment(experiment=rest, drawn=count, usable=usable, notes=notes)


def _shared_model_and_camera(scene: Scene, clips: list[Clip]) -> tuple[Model, Camera]:
    """The model and the camera that all clips share. Raises InputError if they differ."""
    first = clips[0]
    camera = Camera.from_dict(first.camera_json, scene.where)
    for clip in clips[1:]:
        if clip.model != first.model:
            raise InputError(
                f"{scene.where}: ball, model or effects differ from clip to clip, but a search fits one model to all; "
                "expected numbers, as by --model MODEL.yaml"
            )
        if key := find_first_difference(Camera.from_dict(clip.camera_json, scene.where), camera):
            raise InputError(f"{scene.where}: the camera's {key} differs from clip to clip; expected one camera")
    free = tuple(scene.settings.get("free") or ())
    return dataclasses.replace(first.model, free=free), camera


def _launch(clip: Clip) -> Array:
    """The columns of `discrepancy.data.launch`, (p,)."""
    radius, (target, striker) = clip.launch.bodies.radius, clip.launch.states[:, :2]
    share = radius[0] / radius.sum()  # of the distance between the centres, from the target
    drawn = clip.drawn["launch"]
    place = target + share * (striker - target)
    spin = [drawn[name] for name in SPIN_COLUMNS]
    return np.array([*place, clip.launch.time, drawn["v0"], drawn["heading"], drawn["b"], *spin])


def _errors(clip: Clip, noise_px: float | None, where: str) -> Errors:
    if noise_px is not None:
        return StatedErrors(noise_px)
    if clip.finish is not None:
        raise InputError(
            f"{where}: surface: the errors of balls under room light cannot be predicted; give them (--noise PX)"
        )
    return PredictedGlintErrors(clip.sensor.glint_peak, clip.room)
