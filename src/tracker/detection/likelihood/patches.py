"""Cuts the pixels around candidates out of frames, and the windows around glints in which they are fitted."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from synthcam_shared.arrays import Array, Flags, Ints
from tracker.detection.candidates import Candidates, estimate_coarse_positions
from tracker.detection.detector import View
from tracker.detection.glints import RowArrays
from tracker.detection.likelihood.glint_fit import GlintWindows
from tracker.settings import USUAL_SPEED_M_S

Patch: TypeAlias = tuple[NDArray[Any], Flags]  # counts (p, p), and which pixels of it can be used


class GlintGeometry:
    """Sizes, in px, of a ball and of its glint in a clip, and the windows that follow from them."""

    def __init__(self, view: View) -> None:
        camera, widths = view.camera, 3.5 * view.sigma
        self.radius = camera.diameter_px / 2.0
        # Half width of the window of a resting glint: 3.5 widths of the glint on each side.
        self.half = max(2, round(widths + 0.5))
        # Two radii about the middle of the mirrored room. Beyond the first the ball mirrors no room: it is .71 of the
        # ball's radius and the blur of the optics. Up to the second the learnt shape of the profile holds.
        self.profile_end, self.profile_clear = 0.9 * self.radius, 0.68 * self.radius
        # Out to .71 of its radius a ball mirrors what is above the plate; the blur reduces that to .55.
        on_body = 0.55 * self.radius
        # Pixels are used only out to `limit`, on the ball, unless the glint is wide beside the ball.
        self.is_bounded = on_body > 2.5 * view.sigma
        # That limit would cut the glint of a small ball: its window follows the glint.
        self.is_small = self.is_bounded and on_body < widths
        self.limit = min(self.profile_clear, widths) if self.is_small else on_body
        fastest = view.settings.link.max_speed_m_s or USUAL_SPEED_M_S
        travel = fastest * camera.effective_exposure / camera.scale if camera.metric else 4.0
        # Half width of a patch: it holds the window of the fastest ball, whichever way it moves.
        self.reach = self.half + math.ceil(min(travel, 60.0) / 2.0) + 1
        self.size = (view.plate.level.shape[1], view.plate.level.shape[0])

    def half_of_blur(self, blur: Array) -> Ints:
        """Half widths (n,) of the windows of glints with these blurs (n, 2), px."""
        longest = np.max(np.abs(blur), axis=1)
        return np.asarray(np.minimum(self.half + np.floor(longest / 2.0 + 0.35).astype(np.int64), self.reach))


@dataclass(frozen=True, eq=False)
class CandidatePatches(RowArrays):
    """The pixels, p by p, around the n candidates of many frames."""

    frame: Ints
    column: Ints  # of the central pixel, as `row`
    row: Ints
    strength: Array  # as of `Candidates`
    counts: NDArray[Any]  # (n, p, p)
    inside: Flags  # (n, p, p): pixels that lie in the frame and are not hot
    level: Flags  # (n,): the counts are corrected for the fixed offsets of their pixels
    position: Array  # (n, 2): first positions of the glints, px
    blur: Array  # (n, 2): displacements during the exposure, px
    bowl: Array  # (n, 2): from the glints to the middles of the ball profiles, px


def cut_patches(frame: NDArray[Any], found: Candidates, reach: int, sound: Flags) -> list[Patch]:
    """Cut the pixels out to `reach` around each candidate of a frame; `sound` (h, w): which pixels are not hot."""
    at = zip(found.row.tolist(), found.column.tolist(), strict=True)
    return [_cut(frame, *one, reach, sound) for one in at]


def stack_patches(frames: Sequence[tuple[int, Candidates, list[Patch]]]) -> CandidatePatches:
    """Stack the patches of numbered frames, of which there must be one at least."""
    frame = np.concatenate([np.full(len(found.row), number) for number, found, _ in frames])
    column, row, strength = (
        np.concatenate([getattr(found, name) for _, found, _ in frames]) for name in ("column", "row", "strength")
    )
    counts, inside = (np.stack(part) for part in zip(*(patch for *_, own in frames for patch in own), strict=True))
    position = np.column_stack([column, row]) + estimate_coarse_positions(counts, counts.shape[1] // 2)
    level, unknown = np.zeros(len(counts), bool), np.zeros_like(position)
    return CandidatePatches(frame, column, row, strength, counts, inside, level, position, unknown, unknown)


def _cut(frame: NDArray[Any], row: int, column: int, reach: int, sound: Flags) -> Patch:
    """The pixels (p, p) around one, those of the rim repeated beyond it, and which are in the frame and not hot."""
    h, w = frame.shape
    if reach <= row < h - reach and reach <= column < w - reach:
        part = slice(row - reach, row + reach + 1), slice(column - reach, column + reach + 1)
        return frame[part].copy(), sound[part]
    span = np.arange(-reach, reach + 1)
    rows, columns = np.clip(row + span, 0, h - 1), np.clip(column + span, 0, w - 1)
    inside = np.logical_and.outer(rows == row + span, columns == column + span)
    return frame[np.ix_(rows, columns)], inside & sound[np.ix_(rows, columns)]


def make_windows(
    geometry: GlintGeometry, patches: CandidatePatches, half: int, with_profile: bool
) -> tuple[GlintWindows, Array]:
    """Cut windows, 2 half + 1 pixels wide, around the pixels (n, 2) nearest to first positions of glints; and these.

    `with_profile`: the learnt profile holds, which reaches further than a free bowl.
    """
    position, blur, bowl = patches.position, patches.blur, patches.bowl
    limit = geometry.profile_clear if with_profile else geometry.limit
    corner = np.column_stack([patches.column, patches.row])
    room = geometry.reach - half
    shift = np.clip(np.round(position - corner).astype(np.int64), -room, room)
    index = np.arange(-half, half + 1) + geometry.reach
    across, down = (index + shift[:, [axis]] for axis in (0, 1))
    pixels = np.arange(len(position))[:, None, None], down[:, :, None], across[:, None, :]
    counts, inside = (picture[pixels].astype(np.float64) for picture in (patches.counts, patches.inside))
    origin = (corner + shift).astype(np.float64)
    start = np.clip(position - origin, -half, half)
    offsets = np.abs(np.arange(-half, half + 1) - start[..., None])  # (n, axis, pixel)
    follows_glint = limit != geometry.profile_clear
    side = geometry.half + 0.5 + np.abs(blur[..., None]) / 2.0 if follows_glint else half + 0.5
    near = (offsets <= side).astype(np.float64)
    used = inside * near[:, 1, :, None] * near[:, 0, None, :]
    if geometry.is_bounded:
        used *= _on_body(start + bowl, blur, half, limit)
    secondaries = np.zeros((len(position), 0, 3))
    return GlintWindows(counts, used, start, blur, bowl, secondaries), origin


@dataclass(frozen=True, eq=False)
class SpotShapes(RowArrays):
    """The shapes of n bright spots."""

    position: Array  # (n, 2), px
    blur: Array  # (n, 2), px: of a glint that is as long as the spot; never zero
    width: Array  # (n,), px: standard deviation of the light across that
    flux: Array  # (n,) counts
    background: Array  # (n,) counts per pixel


def measure_shapes(patches: CandidatePatches, sigma: float) -> SpotShapes:
    """Measure spots by the moments of their bright pixels; sigma: width of a glint at rest, px."""
    bright_share = 0.25  # of the brightest pixel, from which on a pixel counts
    half = patches.counts.shape[1] // 2
    core, span = slice(half - 2, half + 3), np.arange(-half, half + 1.0)
    background = np.median(patches.counts.reshape(len(patches), -1), axis=1)
    risen = np.where(patches.inside, patches.counts - background[:, None, None], 0.0)
    weight = np.where(risen > bright_share * risen[:, core, core].max(axis=(1, 2), keepdims=True), risen, 0.0)
    flux = np.maximum(weight.sum(axis=(1, 2)), 1.0)
    weight /= flux[:, None, None]
    by_axis = np.stack([weight.sum(axis=1), weight.sum(axis=2)], axis=1)  # (n, axis, pixel)
    middle = by_axis @ span
    off = span - middle[..., None]
    moments = np.einsum("nij,ni,nj->n", weight, off[:, 1], off[:, 0])[:, None, None] * (1 - np.eye(2))
    moments += ((by_axis * off**2).sum(axis=2) - 0.8 * sigma**2)[..., None] * np.eye(2)  # bright pixels are narrower
    spread, axes = np.linalg.eigh(moments)
    length = np.sqrt(12.0 * np.maximum(spread[:, 1], 0.04 * sigma**2))  # of an even line
    return SpotShapes(
        position=np.column_stack([patches.column, patches.row]) + middle,
        blur=axes[:, :, 1] * length[:, None],
        width=np.sqrt(np.maximum(spread[:, 0], -0.8 * sigma**2) + 0.8 * sigma**2),
        flux=flux,
        background=background,
    )


def _on_body(middle: Array, blur: Array, half: int, limit: float) -> Array:
    """1 where a pixel shows the part of the ball that mirrors the room, in which the profile is a smooth bowl."""
    offsets = np.arange(-half, half + 1.0)
    across, down = (offsets - middle[:, :1])[:, None, :], (offsets - middle[:, 1:])[:, :, None]
    length = np.hypot(*blur.T)[:, None, None]
    direction = blur[..., None, None] / np.maximum(length, 1e-9)[..., None]
    along = direction[:, 0] * across + direction[:, 1] * down
    along -= np.clip(along, -length / 2.0, length / 2.0)
    aside = direction[:, 0] * down - direction[:, 1] * across
    aside = np.where(length > 0, aside, np.hypot(across, down))
    return np.asarray(along**2 + aside**2 <= limit**2, dtype=np.float64)
