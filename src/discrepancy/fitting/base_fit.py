"""The start of a search: checks the clips, and fits the given model."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import T_C, V0, B, allow_side_spin
from discrepancy.data.outlier_points import remove_outliers
from discrepancy.fitting.gauss_newton import fit_model
from discrepancy.fitting.model_fit import ModelFit, WhitenedClips
from discrepancy.fitting.parameters import list_names_to_fit
from discrepancy.fitting.predict import predict_tracks
from discrepancy.fitting.stretch_starts import leave_local_minima
from discrepancy.noise.model import Noise, NoiseComponent
from discrepancy.policy import current_policy
from discrepancy.time_left import in_stage
from synthcam.model import LAUNCH_SPIN, Model
from synthcam_shared.errors import InputError
from tracker.camera.views import find_first_difference

CLAIMED_NOISE = Noise(NoiseComponent(1.0))  # white noise of the claimed size


def check_clips(clips: Sequence[MeasuredCollision], model: Model) -> Sequence[MeasuredCollision]:
    """Check the clips at the start of a search: enough of them, one camera, and the model's ball.

    A ball of another size or another camera would otherwise look like a missing effect. Frame rates and exposures may
    differ. The returned clips have a side spin of each striker where the model's `free` lists it. Raises InputError.
    """
    if len(clips) < current_policy().min_collisions:
        least = current_policy().min_collisions
        there = f"{len(clips)} measured collision{'' if len(clips) == 1 else 's'}"
        raise InputError(f"{there}: expected {least} or more, to fit some and hold out others")
    first, held = clips[0].camera, 2 * model.ball.radius
    for c in clips:
        if abs(c.camera.ball_diameter / held - 1) > current_policy().max_diameter_mismatch:
            raise InputError(
                f"the ball of camera.json is {1e3 * c.camera.ball_diameter:.6g} mm wide (clip {c.clip}), that of the "
                f"model {1e3 * held:.6g} mm; expected the same"
            )
        if other := find_first_difference(c.camera, first, besides=("fps", "exposure")):
            raise InputError(
                f"camera.json: {other} of clip {c.clip} is not that of clip {clips[0].clip}; expected clips of one "
                "camera; search each camera's clips separately"
            )
    return [replace(c, launch=allow_side_spin(c.launch)) for c in clips] if LAUNCH_SPIN in model.free else clips


@in_stage("fit")
def fit_base_model(
    clips: Sequence[MeasuredCollision], model: Model, noise: Noise, poor: float = 100.0, first_starts: bool = False
) -> ModelFit:
    """Fit the model's base parameters that are not zero, and those in `model.free`.

    The fit starts from the model's values. If it ends with chi^2 per degree of freedom above `poor`, it starts again
    from the friction that the durations of slides after impacts give. The rolling loss is scaled too, as a wrong clock
    would do it. The default of `poor` is far beyond any misfit of a start near the minimum. Free stretches that are
    fitted poorly begin from other starts (`leave_local_minima`), unless `first_starts` is true.

    Raises InputError where the model has no motion for these collisions.
    """
    names = list_names_to_fit(model)
    impact_parameters = ("restitution", "spin_transfer")  # free stretches do not show them
    free = all(clip.is_stretch for clip in clips)
    if free:
        names = tuple(name for name in names if name not in impact_parameters)
    try:
        found = fit_model(clips, model, names, noise)
        if free and not first_starts:
            return leave_local_minima(WhitenedClips.of(clips, noise), found)
    except ValueError as e:
        raise InputError(f"the model has no motion for these collisions: {e}") from None
    if found.chi2 > poor * (found.points - found.parameters) and "sliding_friction" in names and not free:
        with suppress(ValueError):
            again = fit_model(clips, _rescale_friction(clips, model), names, noise)
            return min(found, again, key=lambda f: f.chi2)
    return found


def remove_outliers_beside_model(
    clips: Sequence[MeasuredCollision], kept_out: Sequence[MeasuredCollision], model: Model
) -> tuple[list[MeasuredCollision], list[MeasuredCollision]]:
    """Remove positions that are outliers relative to the fitted base model, so that they do not count as noise.

    The base model is fitted to `clips`; of the held-out clips only the launches are fitted. Returns both lists.
    """
    base = fit_base_model(clips, model, CLAIMED_NOISE, first_starts=True)
    every, places = [*clips, *kept_out], base.launches
    with suppress(ValueError):  # the model has no motion for one of them
        if kept_out:
            places = np.concatenate([places, fit_model(kept_out, base.model, (), CLAIMED_NOISE).launches])
    predicted = every[: len(places)]
    kept = [*remove_outliers(predicted, predict_tracks(base.model, places, predicted)), *every[len(places) :]]
    return kept[: len(clips)], kept[len(clips) :]


def _rescale_friction(clips: Sequence[MeasuredCollision], model: Model) -> Model:
    """The model with mu = 2 u / (7 g tau): u is the target's slip speed after the contact, tau its sliding time."""
    t_c, v0, b = np.array([c.launch for c in clips]).T[[T_C, V0, B]]
    lasts = np.array([c.slide_ends[0] for c in clips]) - t_c
    slip = (1 + model.restitution) / 2 * v0 * np.sqrt(1 - b**2)
    known = lasts > 0
    if not known.any():
        return model
    friction = float(np.median(2 / 7 * slip[known] / (model.gravity * lasts[known])))
    slower = friction / model.sliding_friction if model.sliding_friction else 1.0
    rolling = {"rolling_drag": model.rolling_drag * slower**0.5, "rolling_decel": model.rolling_decel * slower}
    return model.replace({"sliding_friction": friction} | rolling)
