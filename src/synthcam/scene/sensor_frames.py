"""A solved motion drawn and exposed: frames as the sensor gives them, one at a time."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from synthcam.camera.pinhole import Lamp, PinholeCamera
from synthcam.camera.room.finish import SurfaceFinish
from synthcam.camera.sensor import Chip, Sensor
from synthcam.camera.surface import Surface
from synthcam.scene.film_time import FilmedMotion

if TYPE_CHECKING:
    from synthcam.dynamics.orientation import OrientationHistory

APART = 1 << 64  # between the seeds of a colour camera's chips
Array = NDArray[np.float64]
Counts = NDArray[np.uint8] | NDArray[np.uint16]


class OpticalSetup(NamedTuple):
    """All that a camera sees, but for where the balls are. radii: of the balls, m; room: what they mirror beside.

    look, mirror: of matte balls, or a plate with texture, and of what the balls mirror with.
    """

    camera: PinholeCamera
    lamp: Lamp
    radii: list[float]
    room: float
    surface: Surface
    look: SurfaceFinish | None = None
    mirror: Surface | None = None


def expose_frames(
    view: FilmedMotion,
    seen: OpticalSetup,
    sensor: Sensor,
    frames: int,
    key: tuple[int, int],
    turning: OrientationHistory | None,
    colour: bool,
) -> Iterator[Counts]:
    """The frames as the sensor gives them, one at a time. key: seed, and number of the clip, of the chips' noise.

    turning: of balls with a pattern. colour: three channels, (h, w, 3).
    """
    seed, number = key
    chips = [_chip(sensor, seen.camera.size, seen.camera.exposure, seed + c * APART) for c in range(3 if colour else 1)]
    drawn = _renderer(pickle.dumps(tuple(seen)))
    view = view.as_drawn()

    def centres(t: Array) -> Array:
        return view.at(t)[:, :, :3].transpose(1, 0, 2)

    def turns(t: Array) -> Array:
        times = view.times(t)
        if turning is None:
            return np.broadcast_to(np.eye(3), (len(t), len(times), 3, 3))
        return np.stack([turning.at(ball, own).as_matrix() for ball, own in enumerate(times)], axis=1)

    how = (centres, turns) if seen.look else (centres,)
    for k, found in enumerate(drawn.frames(*how, view.spans(frames), view.breaks())):
        pictures = found if isinstance(found, tuple) else (found,) * len(chips)
        exposed = (chip.expose(picture, number, k) for chip, picture in zip(chips, pictures, strict=True))
        yield np.stack(list(exposed), axis=-1) if colour else next(exposed)


@lru_cache(maxsize=2)
def _renderer(seen: bytes) -> Any:
    """One film serves all clips that are seen alike: its plate and its unit take as long as ten frames.

    seen: what a film is made of, pickled, as arrays have no hash.
    """
    camera, lamp, radii, room, surface, look, mirror = pickle.loads(seen)
    if look:
        from synthcam.camera.room.room_renderer import RoomRenderer

        return RoomRenderer(camera, lamp, radii, look, mirror)
    from synthcam.camera.render import MirrorRenderer  # here alone: everything else works without OpenGL

    return MirrorRenderer(camera, lamp, radii, room, surface)


@lru_cache(maxsize=6)
def _chip(sensor: Sensor, size: tuple[int, int], exposure: float, seed: int) -> Chip:
    """One chip serves all clips of a camera: its fixed pattern takes as long to draw as many frames."""
    return Chip(sensor, size, exposure, seed)
