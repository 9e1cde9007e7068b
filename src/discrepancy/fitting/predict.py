"""What a model says the tracks should be: exposure means of all clips at once, through camera, clock and tracker."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from discrepancy import deadline
from discrepancy.arrays import Array, Ints
from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import T_C
from synthcam.camera.pinhole import PinholeCamera as Optics
from synthcam.dynamics.batch import CollisionBatch, solve_collisions
from synthcam.model import Model
from tracker.camera.camera import Camera, LampSettings

FRICTIONLESS = 1e-9  # stands in for no sliding friction: a slide then outlasts every film, but ends
LATE = 1e-4  # s, the step of a numerical derivative
FAR = 1e9  # m: squares of such residuals are still numbers


def predict_tracks(model: Model, launches: Array, clips: Sequence[MeasuredCollision]) -> list[Array]:
    """Predict where each clip's balls are seen.

    Parameters
    ----------
    model : Model
    launches : (clips, p) array
        Columns as in `discrepancy.data.launch`.
    clips : sequence of Measured
        All of one camera, at any frame rates.

    Returns
    -------
    list of (n_k, 2) arrays
        Centres, m, where each clip has measurements.

    Raises
    ------
    ValueError
        The model has no motion for such a launch, or one that leads farther than any number should.
    OutOfTime
        Where a search's time is over.
    """
    deadline.check()
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        places = map_by_frame_rate(clips, lambda rows, some: _predict_one_rate(model, launches[rows], some))
    if not all(np.abs(p).max(initial=0.0) < FAR for p in places):  # NaN too
        raise ValueError("the motion leads out of the world")
    return places


def map_by_frame_rate(
    clips: Sequence[MeasuredCollision], of: Callable[[Ints, Sequence[MeasuredCollision]], Sequence[Array]]
) -> list[Array]:
    """What a function gives for clips of one frame rate and exposure, for all clips.

    Parameters
    ----------
    clips : sequence of Measured
    of : callable
        (places of some clips, these clips) -> an array of each.
    """
    rates: dict[tuple[str, str], list[int]] = {}
    for k, clip in enumerate(clips):
        rates.setdefault((f"{clip.camera.fps:.6g}", f"{clip.camera.exposure:.6g}"), []).append(k)
    if len(rates) == 1:
        return list(of(np.arange(len(clips)), clips))
    found: dict[int, Array] = {}
    for rows in rates.values():
        found |= zip(rows, of(np.array(rows), [clips[k] for k in rows]), strict=True)
    return [found[k] for k in range(len(clips))]


def _predict_one_rate(model: Model, launches: Array, clips: Sequence[MeasuredCollision]) -> list[Array]:
    if model.sliding_friction == 0:
        model = model.replace({"sliding_friction": FRICTIONLESS})
    camera = clips[0].camera
    frames = np.arange(min(int(c.frame.min()) for c in clips), max(int(c.frame.max()) for c in clips) + 1)
    film = frames / camera.fps
    exposure = float(model.laws("exposure", camera.exposure, {"fps": camera.fps}))
    rows = np.array([[0.0], [camera.size[1] - 1.0]])
    extent = model.laws("clock", film[[0, -1]], {"fps": camera.fps, "row": rows}) + np.array([0.0, exposure])
    start = min(float(extent.min()), float(launches[:, T_C].min()))
    motion = solve_collisions(model, launches, start, float(extent.max()), [c.striker == "a" for c in clips])
    places, opens = _average_exposures(model, motion, camera, film, exposure)
    height = _heights(motion, opens, exposure) if model.laws.has_effect_on("loft") else camera.radius
    places = _apply_camera(model, camera, places, height)
    return [places[c.ball, k, c.frame - frames[0]] for k, c in enumerate(clips)]


def _average_exposures(
    model: Model, motion: CollisionBatch, camera: Camera, film: Array, exposure: float
) -> tuple[Array, Array]:
    """Means over the exposures, (2, clips, frames, 2), m; each ball by the clock of its own row where that matters.

    And when the exposures open, (frames,) or (2 clips, frames).
    """
    if not model.laws.needs("clock", "row"):
        opens = model.laws("clock", film, {"fps": camera.fps, "row": 0.0})
        return motion.average_centres(opens, exposure), opens
    places, opens = motion.average_centres(film, exposure), film
    for _ in range(2):
        rows = np.clip(_project(camera, places)[..., 1], 0, camera.size[1] - 1).reshape(-1, len(film))
        own = model.laws("clock", film + 0 * rows, {"fps": camera.fps, "row": rows})
        opens = np.clip(own, motion.start, motion.end - exposure)
        places = motion.average_centres(opens, exposure)
    return places, opens


def _heights(motion: CollisionBatch, opens: Array, exposure: float) -> Array:
    """Of the centres, means over the exposures by Simpson's rule, (2, clips, frames, 1), m: some hop."""
    first, middle, last = (motion.heights(opens + share * exposure)[..., None] for share in (0.0, 0.5, 1.0))
    return np.asarray((first + 4 * middle + last) / 6)


def _apply_camera(model: Model, camera: Camera, places: Array, height: Array | float) -> Array:
    """Where the tracker, which knows the nominal camera and no hop, puts centres that are at `places` and `height`."""
    if not model.laws.has_effect_on("camera", "measure", "loft"):
        return places
    nominal = Optics(
        K=camera.K,
        dist=np.asarray(camera.dist),
        R=camera.R,
        t=camera.t,
        size=camera.size,
        fps=camera.fps,
        exposure=camera.exposure,
        scale=float("nan"),
        psf_sigma_px=float("nan"),
    )
    pixels = replace(model.laws("camera", nominal, {})).project(_spatial(places, height))
    pixels = model.laws("measure", pixels, measurement_context(camera))
    return np.asarray(camera.unproject(pixels)[0])


def measurement_context(camera: Camera) -> dict[str, Any]:
    """What a defect of a tracker with this camera file may ask for, as LAWS has it."""

    def glint(seen: Array) -> Array:
        return camera.glint_of_centre(camera.unproject(seen)[0])

    def mirrored(seen: Array, lamp: tuple[float, float, float]) -> Array:
        if camera.lamp is not None:
            return seen
        return replace(camera, lamp=LampSettings(lamp)).glint_of_centre(camera.unproject(seen)[0])

    return {"glint": glint, "mirrored": mirrored}


def _project(camera: Camera, places: Array) -> Array:
    return np.asarray(camera.project(_spatial(places, camera.radius)))


def _spatial(places: Array, height: Array | float) -> Array:
    return np.concatenate([places, np.broadcast_to(height, (*places.shape[:-1], 1))], axis=-1)


def predict_velocities(model: Model, launches: Array, clips: Sequence[MeasuredCollision]) -> list[Array]:
    """How fast the forecast positions move, (n_k, 2) m/s of each clip: by shifting the contact's time."""
    nudge = LATE * (np.arange(launches.shape[1]) == T_C)
    ahead, behind = (predict_tracks(model, launches + way * nudge, clips) for way in (-1, 1))
    return [(a - b) / (2 * LATE) for a, b in zip(ahead, behind, strict=True)]
