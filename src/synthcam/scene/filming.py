"""A solved motion drawn and exposed: frames as the sensor gives them, one at a time."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from synthcam.camera.pinhole import Camera, Lamp
from synthcam.camera.sensor import Chip, Sensor
from synthcam.camera.surface import Surface
from synthcam.scene.filmed_motion import View

if TYPE_CHECKING:
    from synthcam.camera.render import Film

Counts = NDArray[np.uint8] | NDArray[np.uint16]


class Seen(NamedTuple):
    """All that a camera sees, but for where the balls are. radii: of the balls, m; room: what they mirror beside."""

    camera: Camera
    lamp: Lamp
    radii: list[float]
    room: float
    surface: Surface


def film(view: View, seen: Seen, sensor: Sensor, frames: int, key: tuple[int, int]) -> Iterator[Counts]:
    """The frames as the sensor gives them, one at a time. key: seed, and number of the clip, of the chip's noise."""
    seed, number = key
    chip = _chip(sensor, seen.camera.size, seen.camera.exposure, seed)
    drawn = _film(pickle.dumps(tuple(seen)))
    view = view.as_drawn()
    pictures = drawn.frames(
        lambda t: view.at(t)[:, :, :3].transpose(1, 0, 2),
        view.spans(frames),
        view.breaks(),
    )
    for k, picture in enumerate(pictures):
        yield chip.expose(picture, number, k)


@lru_cache(maxsize=2)
def _film(seen: bytes) -> Film:
    """One film serves all clips that are seen alike: its plate and its unit take as long as ten frames.

    seen: what a Film is made of, pickled, as arrays have no hash.
    """
    from synthcam.camera.render import Film  # here alone: everything else works without OpenGL

    return Film(*pickle.loads(seen))


@lru_cache(maxsize=2)
def _chip(sensor: Sensor, size: tuple[int, int], exposure: float, seed: int) -> Chip:
    """One chip serves all clips of a camera: its fixed pattern takes as long to draw as many frames."""
    return Chip(sensor, size, exposure, seed)
