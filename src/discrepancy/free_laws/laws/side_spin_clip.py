"""A spin about the vertical of each clip's striker, where the model has it roll: no effect can hold it.

The motion is that of the launch with the spin; a model that calls `launch.spin` free has it fitted in each launch.
"""

from collections.abc import Sequence

import numpy as np

from discrepancy.arrays import Array
from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import SIDE, pad_spins
from discrepancy.fitting.predict import predict_tracks
from discrepancy.free_laws.axis import Axis
from discrepancy.free_laws.law_kinds import FreeLaw
from discrepancy.free_laws.ranges import CoveredRanges, over_clips
from synthcam.model import LAUNCH_SPIN, Model

STEP = 1e-4  # m/s


class SideSpinClip(FreeLaw):
    symbol = "R times the striker's spin about the vertical"
    unit = "m/s"
    frees = LAUNCH_SPIN

    @staticmethod
    def over(covered: CoveredRanges) -> tuple[Axis, ...]:
        own = pad_spins(covered.launches)[:, SIDE]
        return () if own.any() else over_clips(len(own))  # the launches have it

    def columns(self, model: Model, launches: Array, clips: Sequence[MeasuredCollision]) -> list[Array]:
        numbers = self.basis(np.arange(len(clips), dtype=float))
        step = np.full(len(clips), STEP)
        ahead, behind = (self._spun(model, launches, clips, way * step) for way in (1, -1))
        slopes = [(a - b) / (2 * STEP) for a, b in zip(ahead, behind, strict=True)]
        return [s[..., None] * own for s, own in zip(slopes, numbers, strict=True)]

    def _moved(self, clips: Sequence[MeasuredCollision], model: Model, launches: Array, coefs: Array) -> list[Array]:
        spins = self.basis(np.arange(len(clips), dtype=float)) @ coefs
        spun, plain = self._spun(model, launches, clips, spins), predict_tracks(model, launches, clips)
        return [a - b for a, b in zip(spun, plain, strict=True)]

    @staticmethod
    def _spun(model: Model, launches: Array, clips: Sequence[MeasuredCollision], spins: Array) -> list[Array]:
        own = pad_spins(launches)
        own[:, SIDE] += spins
        return predict_tracks(model, own, clips)
