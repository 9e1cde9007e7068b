"""What a model says the tracks should be: exposure means of all clips at once, through camera, clock and tracker."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from discrepancy.measured import Measured
from synthcam.batch import LAUNCH, Batch, collisions
from synthcam.model import Model
from synthcam.optics import Camera as Optics
from tracker.geometry import Camera

Array = NDArray[np.float64]
__all__ = ["LAUNCH", "forecast"]

FRICTIONLESS = 1e-9  # stands in for no sliding friction: a slide then outlasts every film, but ends


def forecast(model: Model, launches: Array, clips: Sequence[Measured]) -> list[Array]:
    """Predicted centres (n_k, 2), m, where each clip has measurements; launches (clips, 6), columns LAUNCH.

    All clips are of one camera. Raises ValueError when the model has no motion for such a launch.
    """
    if model.sliding_friction == 0:
        model = model.replace({"sliding_friction": FRICTIONLESS})
    camera = clips[0].camera
    frames = np.arange(min(int(c.frame.min()) for c in clips), max(int(c.frame.max()) for c in clips) + 1)
    film = frames / camera.fps
    exposure = float(model.laws("exposure", camera.exposure, {"fps": camera.fps}))
    rows = np.array([[0.0], [camera.size[1] - 1.0]])
    extent = model.laws("clock", film[[0, -1]], {"fps": camera.fps, "row": rows}) + np.array([0.0, exposure])
    start = min(float(extent.min()), float(launches[:, 2].min()))
    motion = collisions(model, launches, start, float(extent.max()), [c.striker == "a" for c in clips])
    places = _seen(model, camera, _exposed(model, motion, camera, film, exposure))
    return [places[c.ball, k, c.frame - frames[0]] for k, c in enumerate(clips)]


def _exposed(model: Model, motion: Batch, camera: Camera, film: Array, exposure: float) -> Array:
    """Means over the exposures, (2, clips, frames, 2), m; each ball by the clock of its own row where that matters."""
    if not model.laws.asks("clock", "row"):
        return motion.means(model.laws("clock", film, {"fps": camera.fps, "row": 0.0}), exposure)
    places = motion.means(film, exposure)
    for _ in range(2):
        rows = np.clip(_project(camera, places)[..., 1], 0, camera.size[1] - 1).reshape(-1, len(film))
        own = model.laws("clock", film + 0 * rows, {"fps": camera.fps, "row": rows})
        places = motion.means(np.clip(own, motion.start, motion.end - exposure), exposure)
    return places


def _seen(model: Model, camera: Camera, places: Array) -> Array:
    """Where the tracker, which knows the nominal camera, puts centres that are at `places`."""
    if not model.laws.bent("camera", "measure"):
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
    pixels = replace(model.laws("camera", nominal, {})).project(_spatial(camera, places))
    pixels = model.laws("measure", pixels, {"glint": lambda seen: camera.glint_of_centre(camera.unproject(seen)[0])})
    return np.asarray(camera.unproject(pixels)[0])


def _project(camera: Camera, places: Array) -> Array:
    return np.asarray(camera.project(_spatial(camera, places)))


def _spatial(camera: Camera, places: Array) -> Array:
    return np.concatenate([places, np.full((*places.shape[:-1], 1), camera.radius)], axis=-1)
