"""A shift of the picture that depends on the position in it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.fitting.predict import predict_tracks
from discrepancy.free_laws.law_kinds import FreeLaw
from discrepancy.free_laws.ranges import Axis, CoveredRanges, over_plane
from synthcam.model import Model
from synthcam_shared.arrays import Array


@dataclass(frozen=True)
class WarpPlace(FreeLaw):
    """The camera's slope turns the shift in pixels into one on the plate."""

    def derivatives(self, model: Model, launches: Array, clips: Sequence[MeasuredCollision]) -> list[Array]:
        out = []
        for clip, xy in zip(clips, predict_tracks(model, launches, clips), strict=True):
            pixels = _pixels(clip, xy)
            slope, weights = clip.camera.unproject(pixels)[1], self.basis(pixels[:, 0], pixels[:, 1])
            out.append((slope[..., None] * weights[:, None, None]).reshape(len(xy), 2, -1))
        return out


def _pixels(clip: MeasuredCollision, xy: Array) -> Array:
    """Project centres (n, 2), m, to pixels (n, 2)."""
    return np.asarray(clip.camera.project(np.concatenate([xy, np.full((len(xy), 1), clip.camera.radius)], axis=1)))


def _over(covered: CoveredRanges) -> tuple[Axis, ...]:
    """Cover the measured positions alone: the predicted motion continues outside the picture."""
    measured = np.concatenate([c.xy for c in covered.clips])
    return over_plane(_pixels(covered.clips[0], measured), "px")


LAWS = (
    WarpPlace(
        "warp_place",
        "Shift of the picture that depends on the position",
        "shift of the picture",
        unit="px",
        part_names=("x", "y"),
        centred=True,
        bends=("measure", ""),
        over=_over,
    ),
)
