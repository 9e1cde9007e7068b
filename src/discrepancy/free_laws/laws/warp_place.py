"""A shift of the picture that depends on the place in it."""

from collections.abc import Sequence

import numpy as np

from discrepancy.arrays import Array
from discrepancy.data.collisions import MeasuredCollision
from discrepancy.fitting.predict import predict_tracks
from discrepancy.free_laws.axis import Axis
from discrepancy.free_laws.law_kinds import FreeLaw
from discrepancy.free_laws.ranges import FIELD, CoveredRanges, over_place
from synthcam.model import Model


class WarpPlace(FreeLaw):
    symbol = "shift of the picture"
    unit = "px"
    parts = 2
    part_names = ("x", "y")
    centred = True
    bends = ("measure", "")

    @staticmethod
    def over(covered: CoveredRanges) -> tuple[Axis, ...]:
        seen = np.concatenate([c.xy for c in covered.clips])  # a ball may move where no camera looks
        return over_place(_pixels(covered.clips[0], seen), FIELD, "px")

    def columns(self, model: Model, launches: Array, clips: Sequence[MeasuredCollision]) -> list[Array]:
        out = []
        for clip, xy in zip(clips, predict_tracks(model, launches, clips), strict=True):
            pixels = _pixels(clip, xy)
            slope, weights = clip.camera.unproject(pixels)[1], self.basis(pixels[:, 0], pixels[:, 1])
            out.append((slope[..., None] * weights[:, None, None]).reshape(len(xy), 2, -1))
        return out


def _pixels(clip: MeasuredCollision, xy: Array) -> Array:
    """Where the camera sees centres (n, 2), m: (n, 2), px."""
    return np.asarray(clip.camera.project(np.concatenate([xy, np.full((len(xy), 1), clip.camera.radius)], axis=1)))
