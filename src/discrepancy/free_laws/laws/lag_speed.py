"""A lag of the picture behind the motion that depends on the speed: no effect can hold it."""

from collections.abc import Sequence

import numpy as np

from discrepancy.arrays import Array
from discrepancy.data.collisions import MeasuredCollision
from discrepancy.fitting.predict import predict_velocities
from discrepancy.free_laws.axis import Axis
from discrepancy.free_laws.law_kinds import FreeLaw
from discrepancy.free_laws.ranges import CoveredRanges, over_speed
from synthcam.model import Model


class LagSpeed(FreeLaw):
    symbol = "lag of the picture"
    unit = "s"
    centred = True

    @staticmethod
    def over(covered: CoveredRanges) -> tuple[Axis, ...]:
        return over_speed("speed", "v", covered.speeds, 0.0)

    def columns(self, model: Model, launches: Array, clips: Sequence[MeasuredCollision]) -> list[Array]:
        seen = predict_velocities(model, launches, clips)
        return [-v[..., None] * self.basis(np.hypot(v[:, 0], v[:, 1]))[:, None] for v in seen]
