"""A spin about the vertical of each clip's striker, where the model has it roll. No effect can express it.

The motion is that of the launch with the spin. A model that declares `launch.spin` free has it fitted in each launch.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import SIDE, pad_spins
from discrepancy.fitting.predict import predict_tracks
from discrepancy.free_laws.law_kinds import FreeLaw
from discrepancy.free_laws.ranges import Axis, CoveredRanges, over_clips
from synthcam.model import LAUNCH_SPIN, Model
from synthcam_shared.arrays import Array


@dataclass(frozen=True)
class SideSpinClip(FreeLaw):
    """The ball's radius times the spin, m/s, of each clip."""

    def derivatives(self, model: Model, launches: Array, clips: Sequence[MeasuredCollision]) -> list[Array]:
        step = 1e-4  # m/s: central differences are linear there to 1e-6
        numbers = self.basis(np.arange(len(clips), dtype=float))
        spins = np.full(len(clips), step)
        ahead, behind = (self._predict(model, launches, clips, sign * spins) for sign in (1, -1))
        slopes = [(a - b) / (2 * step) for a, b in zip(ahead, behind, strict=True)]
        return [s[..., None] * own for s, own in zip(slopes, numbers, strict=True)]

    def _displacements(
        self, clips: Sequence[MeasuredCollision], model: Model, launches: Array, coefs: Array
    ) -> list[Array]:
        spins = self.basis(np.arange(len(clips), dtype=float)) @ coefs
        spun, plain = self._predict(model, launches, clips, spins), predict_tracks(model, launches, clips)
        return [a - b for a, b in zip(spun, plain, strict=True)]

    @staticmethod
    def _predict(model: Model, launches: Array, clips: Sequence[MeasuredCollision], spins: Array) -> list[Array]:
        own = pad_spins(launches)
        own[:, SIDE] += spins
        return predict_tracks(model, own, clips)


def _over(covered: CoveredRanges) -> tuple[Axis, ...]:
    """A number for each clip, unless the launches have a spin already."""
    spins = pad_spins(covered.launches)[:, SIDE]
    return () if spins.any() else over_clips(len(spins))


LAWS = (
    SideSpinClip(
        "side_spin_clip",
        "Spin about the vertical of each clip's striker",
        "R times the striker's spin about the vertical",
        unit="m/s",
        frees=LAUNCH_SPIN,
        over=_over,
    ),
)
