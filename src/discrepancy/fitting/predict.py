"""Predicts the tracks of all clips: positions averaged over exposures, through camera, clock and tracker."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import T_C
from discrepancy.time_left import report_progress
from synthcam.camera.pinhole import PinholeCamera as Optics
from synthcam.dynamics.batch import CollisionBatch, solve_collisions
from synthcam.model import Model
from synthcam_shared.arrays import Array, Ints
from tracker.camera.camera import Camera, LampSettings


def predict_tracks(
    model: Model, launches: Array, clips: Sequence[MeasuredCollision], base: Mapping[str, Array] | None = None
) -> list[Array]:
    """Predict where each clip's balls are seen: centres (n_k, 2), m, where the clip has measurements.

    launches: (clips, p), with columns as in `discrepancy.data.launch`. The clips are of one camera, at any frame rates.
    base: base parameters of each clip, as `synthcam.dynamics.batch.solve_collisions` takes them.
    Raises ValueError where the model has no motion for a launch or the positions overflow; OutOfTime when the time of
    the search is over.
    """
    farthest = 1e9  # m; squares of such residuals are still finite
    report_progress()
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        positions = map_by_frame_rate(
            clips,
            lambda rows, some: _predict_one_rate(
                model, launches[rows], some, {name: values[rows] for name, values in (base or {}).items()}
            ),
        )
    if not all(np.abs(p).max(initial=0.0) < farthest for p in positions):  # NaN too
        raise ValueError("the predicted positions are not finite, or beyond 1e9 m")
    return positions


def map_by_frame_rate(
    clips: Sequence[MeasuredCollision], of: Callable[[Ints, Sequence[MeasuredCollision]], Sequence[Array]]
) -> list[Array]:
    """Predict in groups: apply `of` to indices and clips of each frame rate and exposure, and keep the clips' order."""
    rates: dict[tuple[str, str], list[int]] = {}
    for k, clip in enumerate(clips):
        rates.setdefault((f"{clip.camera.fps:.6g}", f"{clip.camera.exposure:.6g}"), []).append(k)
    if len(rates) == 1:
        return list(of(np.arange(len(clips)), clips))
    found: dict[int, Array] = {}
    for rows in rates.values():
        found |= zip(rows, of(np.array(rows), [clips[k] for k in rows]), strict=True)
    return [found[k] for k in range(len(clips))]


def _predict_one_rate(
    model: Model, launches: Array, clips: Sequence[MeasuredCollision], base: Mapping[str, Array]
) -> list[Array]:
    little = 1e-9  # friction so little that a slide outlasts every film, but ends
    if model.sliding_friction == 0:
        model = model.replace({"sliding_friction": little})
    if "sliding_friction" in base:
        base = {**base, "sliding_friction": np.where(base["sliding_friction"] == 0, little, base["sliding_friction"])}
    camera, (frames, seen) = clips[0].camera, _arrange_frames(clips)
    film = frames / camera.fps
    exposure = float(model.laws("exposure", camera.exposure, {"fps": camera.fps}))
    rows = np.array([[0.0], [camera.size[1] - 1.0]])
    both_ends = np.array([film.min(), film.max()])
    extent = model.laws("clock", both_ends, {"fps": camera.fps, "row": rows}) + np.array([0.0, exposure])
    start = min(float(extent.min()), float(launches[:, T_C].min()))
    last = np.array([c.frame.max() for c in clips]) / camera.fps
    ends = np.max(model.laws("clock", last, {"fps": camera.fps, "row": rows}) + exposure + 0 * rows, axis=0)
    a_strikes = [c.striker == "a" for c in clips]
    motion = solve_collisions(model, launches, start, float(extent.max()), a_strikes, ends, base)
    positions, opens = _average_exposures(model, motion, camera, film, exposure)
    height: Array | float = camera.radius
    if model.laws.has_effect_on("loft"):  # means over the exposures by Simpson's rule
        first, middle, last = (motion.heights(opens + share * exposure) for share in (0.0, 0.5, 1.0))
        height = ((first + 4 * middle + last) / 6).reshape(film.shape)[seen][:, None]
    places = _apply_camera(model, camera, positions.reshape(*film.shape, 2)[seen], height)
    return np.split(places, np.cumsum([len(c.frame) for c in clips])[:-1])


def _arrange_frames(clips: Sequence[MeasuredCollision]) -> tuple[Ints, tuple[Ints, Ints]]:
    """Arrange the frames of n clips by ball, (2n, m) with balls as in `CollisionBatch`, and find each position in them.

    Each ball has its own frames alone: those of stretches in a long film differ. Shorter rows are padded with the last
    frame of the clip.
    """
    ball = np.concatenate([k + c.ball * len(clips) for k, c in enumerate(clips)])
    counts, order = np.bincount(ball, minlength=2 * len(clips)), np.argsort(ball, kind="stable")
    column = np.empty_like(ball)
    column[order] = np.arange(len(ball)) - np.repeat(np.cumsum(counts) - counts, counts)
    last = np.array([c.frame.max() for c in clips])
    frames = np.repeat(np.tile(last, 2)[:, None], counts.max(), axis=1)
    frames[ball, column] = np.concatenate([c.frame for c in clips])
    return frames, (ball, column)


def _average_exposures(
    model: Model, motion: CollisionBatch, camera: Camera, film: Array, exposure: float
) -> tuple[Array, Array]:
    """Means over exposures (2, clips, frames, 2), m, and when these open, s; film: times by its clock."""
    if not model.laws.needs("clock", "row"):
        opens = model.laws("clock", film, {"fps": camera.fps, "row": 0.0})
        return motion.average_centres(opens, exposure), opens
    positions, opens = motion.average_centres(film, exposure), film
    for _ in range(2):
        pixels = camera.project(_spatial(positions, camera.radius))
        rows = np.clip(pixels[..., 1], 0, camera.size[1] - 1).reshape(film.shape)
        own = model.laws("clock", film, {"fps": camera.fps, "row": rows})
        opens = np.clip(own, motion.start, motion.end - exposure)
        positions = motion.average_centres(opens, exposure)
    return positions, opens


def _apply_camera(model: Model, camera: Camera, positions: Array, height: Array | float) -> Array:
    """Positions that a tracker with the nominal camera, for balls on the plate, finds for centres at these heights."""
    if not model.laws.has_effect_on("camera", "measure", "loft"):
        return positions
    own: dict[str, Any] = {name: getattr(camera, name) for name in ("K", "R", "t", "size", "fps", "exposure")}
    nominal = Optics(**own, dist=np.asarray(camera.dist), scale=np.nan, psf_sigma_px=np.nan)
    flat = positions if camera.warp is None else camera.warp.undo(positions)  # the nominal optics have no warp
    pixels = replace(model.laws("camera", nominal, {})).project(_spatial(flat, height))
    pixels = model.laws("measure", pixels, collect_measurement_context(camera))
    return np.asarray(camera.unproject(pixels)[0])


def collect_measurement_context(camera: Camera) -> dict[str, Any]:
    """Collect the quantities that a tracker's defect (law "measure") may depend on, for a prediction."""

    def glint(seen: Array) -> Array:
        return camera.glint_of_centre(camera.unproject(seen)[0])

    def mirrored(seen: Array, lamp: tuple[float, float, float]) -> Array:
        if camera.lamp is not None:
            return seen
        return replace(camera, lamp=LampSettings(lamp)).glint_of_centre(camera.unproject(seen)[0])

    return {"glint": glint, "mirrored": mirrored}


def _spatial(positions: Array, height: Array | float) -> Array:
    return np.concatenate([positions, np.broadcast_to(height, (*positions.shape[:-1], 1))], axis=-1)


def predict_velocities(model: Model, launches: Array, clips: Sequence[MeasuredCollision]) -> list[Array]:
    """Velocities of the predicted positions, (n_k, 2) m/s for each clip, by a shift of the contact's time."""
    step = 1e-4  # s
    nudge = step * (np.arange(launches.shape[1]) == T_C)
    ahead, behind = (predict_tracks(model, launches + sign * nudge, clips) for sign in (-1, 1))
    return [(a - b) / (2 * step) for a, b in zip(ahead, behind, strict=True)]
