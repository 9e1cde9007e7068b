"""Render and expose a solved motion: the frames as the sensor gives them, one at a time."""

from __future__ import annotations

import pickle
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from synthcam.camera.pinhole import Lamp, PinholeCamera
from synthcam.camera.reflections import MIN_RELATIVE_FLUX
from synthcam.camera.room.finish import SurfaceFinish
from synthcam.camera.sensor import Sensor, SensorChip
from synthcam.camera.surface import Surface
from synthcam.scene.film_time import FilmedMotion
from synthcam_shared.arrays import Array

if TYPE_CHECKING:
    from synthcam.dynamics.orientation import OrientationHistory

Counts = NDArray[np.uint8] | NDArray[np.uint16]


class OpticalSetup(NamedTuple):
    """Everything that decides a picture except where the balls are."""

    camera: PinholeCamera
    lamp: Lamp
    radii: list[float]  # one a ball, m
    room: float  # radiance of the surroundings that a mirror ball shows, over the peak of its glint
    surface: Surface  # of mirror balls on a black plate
    finish: SurfaceFinish | None = None  # of matte balls, or of a plate with texture
    varnish: Surface | None = None  # the mirror on the balls of a `finish`; None: they are dull
    heights: Sequence[float] = ()  # of discs, m; 0 of balls
    plate_z: float = 0.0  # m
    faintest: float = MIN_RELATIVE_FLUX  # what many mirror balls leave out of a picture, over the peak of a glint
    quick: bool = False  # whether matte balls exchange no light and do not mirror each other


def expose_frames(
    motion: FilmedMotion,
    setup: OpticalSetup,
    sensor: Sensor,
    frames: range,
    key: tuple[int, int],
    orientation: OrientationHistory | None,
    colour: bool,
    *,
    by_tables: bool = True,
) -> Iterator[Counts]:
    """Yield the frames as the sensor gives them.

    frames: their numbers. key: seed and number of the clip, for the chips' noise. orientation: of balls with a pattern.
    colour: three channels, each with a chip of its own: (h, w, 3). by_tables: draw the noise of the plate from tables,
    which take seconds to make; otherwise pixel by pixel, with other random numbers.
    """
    seed, number = key
    apart = 1 << 64  # the seeds of the three chips are further apart than any two seeds that a user may give
    camera = setup.camera
    chips = [_chip(sensor, camera.size, camera.exposure, seed + c * apart) for c in range(3 if colour else 1)]
    unnoticed = 0.2 * sensor.noise / sensor.glint_peak  # a spot that changes no position and no brightness noticeably
    # A renderer serves all that differs by noise alone.
    setup = setup._replace(camera=replace(camera, camera_json={}))
    if setup.finish is None:
        setup = setup._replace(faintest=unnoticed)
    renderer = _renderer(pickle.dumps(tuple(setup)))
    motion = motion.as_drawn()

    def centres(t: Array) -> Array:
        return motion.at(t)[:, :, :3].transpose(1, 0, 2) - [0, 0, setup.plate_z]

    def rotations(t: Array) -> Array:
        times = motion.times(t)
        if orientation is None:
            return np.broadcast_to(np.eye(3), (len(t), len(times), 3, 3))
        return np.stack([orientation.at(ball, own).as_matrix() for ball, own in enumerate(times)], axis=1)

    paths = (centres, rotations) if setup.finish else (centres,)
    drawn = renderer.frames(*paths, motion.spans(frames), motion.breaks())
    for k, rendered in zip(frames, drawn, strict=True):
        pictures = rendered if isinstance(rendered, tuple) else (rendered,) * len(chips)
        exposed = (
            chip.expose(picture if by_tables else picture.image, number, k)
            for chip, picture in zip(chips, pictures, strict=True)
        )
        yield np.stack(list(exposed), axis=-1) if colour else next(exposed)


@lru_cache(maxsize=2)
def _renderer(setup: bytes) -> Any:
    """The renderer of all clips with one setup: its plate and its unit take as long as ten frames.

    setup: pickled, because arrays have no hash.
    """
    camera, lamp, radii, room, surface, finish, varnish, heights, plate_z, faintest, quick = pickle.loads(setup)
    if finish:
        from synthcam.camera.room.room_renderer import RoomRenderer

        if plate_z:  # the renderer's plate is at z = 0
            camera, lamp = replace(camera, t=camera.t + plate_z * camera.R[:, 2]), _lower(lamp, plate_z)
        return RoomRenderer(camera, lamp, radii, finish, varnish, heights, quick=quick)
    from synthcam.camera.render import MirrorRenderer  # here alone: everything else works without OpenGL

    return MirrorRenderer(camera, lamp, radii, room, surface, faintest)


def _lower(lamp: Lamp, by: float) -> Lamp:
    second = _lower(lamp.second, by) if lamp.second else None
    return replace(lamp, position=lamp.position - [0, 0, by], second=second)


# of all clips of a camera: its fixed pattern takes as long to draw as many frames
_chip = lru_cache(maxsize=6)(SensorChip)
