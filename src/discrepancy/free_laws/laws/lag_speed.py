"""A lag of the picture behind the motion that depends on the speed. No effect can express it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.fitting.predict import predict_velocities
from discrepancy.free_laws.law_kinds import FreeLaw
from discrepancy.free_laws.ranges import over_range
from synthcam.model import Model
from synthcam_shared.arrays import Array


@dataclass(frozen=True)
class LagSpeed(FreeLaw):
    """The lag times the velocity is subtracted from each position."""

    def derivatives(self, model: Model, launches: Array, clips: Sequence[MeasuredCollision]) -> list[Array]:
        speeds = predict_velocities(model, launches, clips)
        return [-v[..., None] * self.basis(np.hypot(v[:, 0], v[:, 1]))[:, None] for v in speeds]


LAWS = (
    LagSpeed(
        "lag_speed",
        "Lag of the picture that depends on the speed",
        "lag of the picture",
        unit="s",
        centred=True,
        over=lambda covered: over_range("speed", "v", covered.speeds, 0.0),
    ),
)
