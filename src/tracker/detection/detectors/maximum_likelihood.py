"""Maximum likelihood of the pixel-integrated glint, clipped pixels censored, motion in the exposure modelled."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracker.camera.lens import Array
from tracker.camera.mirror_images import locate_secondary_glints, locate_zenith_point, secondary_flux_ratio
from tracker.detection.candidates import CandidateSearch, estimate_coarse_positions
from tracker.detection.glints import BLURRED, CLIPPED, EDGE, MISFIT, NEAR, Glints, View
from tracker.detection.likelihood.ball_profile import BallProfile
from tracker.detection.likelihood.dsnu import DsnuEstimator
from tracker.detection.likelihood.flux_prior import apply_flux_prior
from tracker.detection.likelihood.glint_fit import GlintFit, GlintWindows, fit_glints, learn_profile, score_blur_length
from tracker.detection.likelihood.secondary_glints import apply_common_reflectance
from tracker.detection.link import FASTEST, assign, estimate_velocities
from tracker.detection.motion_blur import MotionBlurEvidence

Ints = NDArray[np.int64]

WIDTHS = 3.5  # of the glint, that a window holds on each side
BLOCK = 1024  # windows held at once: of 512 frames with two balls
SIGNIFICANT = 5.0  # deviations of the flux, for a glint on the free background
NEARBY = 1.5  # ball diameters between glints, within which a neighbour alters the profile of an open glint
AGREE = 2.5  # the same, within which secondary glints are bright enough to give the balls' reflectance
SHOWING = 5.0  # the same, within which a ball shows its neighbour's glint too
CROWD = 12  # balls in a frame, among which neighbours are looked for
SHOWS = 0.03  # of the glint's width, a change of the blur that shows in its position
PUPILS = 128  # windows from which the profile is learnt, and
FEWEST = 24  # the fewest
MIDDLE = 0.866  # of the way from the ball's centre to its zenith: cos 30 degrees, at half the ball's radius
MOVED, STILL = 24, 24  # glints of a block, the fastest and the slowest, from which the blur's length is found, and
LEAST = 0.05  # of the glint's width, the shortest blur that is used
SMEARED = 0.3  # of the ball's radius: after a longer way in the exposure the profile is no longer the one learnt
CLEAR = 0.68  # of the ball's radius, out to which the learnt shape holds
END = 0.9  # of the ball's radius: .71, and the blur
HIDES = 1.5  # of the ball's radius about its glint, what a ball hides of the plate at most
LIKE = 0.55  # of the ball's radius: out to .71 a ball mirrors what is above the plate, less the blur


@dataclass(frozen=True, eq=False)
class _Patches:
    """Candidates of many frames: ``frame``, ``column``, ``row`` (n,), ``counts`` (n, p, p), ``inside``, and
    which are ``level`` (n,): less their pixels' own offsets.
    """

    frame: Ints
    column: Ints
    row: Ints
    strength: Array
    counts: NDArray[Any]
    inside: NDArray[np.bool_]
    level: NDArray[np.bool_]

    def take(self, rows: Ints) -> _Patches:
        return _Patches(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))


class MaximumLikelihood:
    """Finds candidates frame by frame, then fits all of a block's at once."""

    def __init__(self, view: View) -> None:
        self.camera = view.camera
        self.sigma = view.sigma
        self.size = (view.plate.level.shape[1], view.plate.level.shape[0])
        radius = self.camera.diameter_px / 2.0
        # A ball's own secondary glints stand .7 R from its centre, the next ball's glint at least 2 R away.
        self.search = CandidateSearch(view.plate, self.sigma, apart=max(1.6 * radius, 4.0 * self.sigma))
        self.half = max(2, round(WIDTHS * self.sigma + 0.5))
        self.end, self.clear = END * radius, CLEAR * radius
        self.bounded = LIKE * radius > 2.5 * self.sigma
        # On a small ball that would cut the glint itself, and the blur makes the profile another than the one learnt.
        self.small = self.bounded and LIKE * radius < WIDTHS * self.sigma
        self.limit = min(self.clear, WIDTHS * self.sigma) if self.small else LIKE * radius
        travel = FASTEST * self.camera.effective_exposure / self.camera.scale if self.camera.metric else 4.0
        self.profile: BallProfile | None = None
        self.motion_blur = MotionBlurEvidence()
        self.reach = self.half + math.ceil(min(travel, 60.0) / 2.0) + 1
        self.levelled = self.sensor = self.camera.sensor
        self.bare = DsnuEstimator(view.plate, math.ceil(HIDES * radius) + 2) if self.sensor.dsnu else None
        self.sound = np.ones(view.plate.level.shape, dtype=np.bool_)
        self.sound.ravel()[view.plate.hot] = False

    def __call__(self, frame: NDArray[Any]) -> Glints:
        """Glints of one frame, taken as at rest during the exposure."""
        return self.many([(0, frame)])

    def many(self, frames: Iterable[tuple[int, NDArray[Any]]]) -> Glints:
        """Glints of numbered frames, their motion blur taken from the glints' own motion from frame to frame."""
        parts: list[Glints] = []
        held: list[_Patches] = []
        windows = 0
        for number, frame in frames:
            patches = self._candidates(number, frame)
            if patches is not None:
                held.append(patches)
                windows += len(patches.frame)
            if windows >= BLOCK:
                parts.append(self._block(held))
                held, windows = [], 0
        if held:
            parts.append(self._block(held))
        return Glints.join(parts)

    def _candidates(self, number: int, frame: NDArray[Any]) -> _Patches | None:
        finds = self.search(frame)
        if self.bare and not finds.crowded:
            self.bare.add(frame, finds.row, finds.column)
        if len(finds.row) == 0:
            return None
        cuts = [self._cut(frame, *at) for at in zip(finds.row.tolist(), finds.column.tolist(), strict=True)]
        counts, inside = (np.stack(part) for part in zip(*cuts, strict=True))
        return _Patches(
            np.full(len(finds.row), number),
            finds.column,
            finds.row,
            finds.strength,
            counts,
            inside,
            np.zeros(len(counts), bool),
        )

    def _cut(self, frame: NDArray[Any], row: int, column: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """The pixels (p, p) about one, those of the rim beyond it, and which are in the frame and not hot."""
        reach, (h, w) = self.reach, frame.shape
        if reach <= row < h - reach and reach <= column < w - reach:
            part = slice(row - reach, row + reach + 1), slice(column - reach, column + reach + 1)
            return frame[part].copy(), self.sound[part]
        span = np.arange(-reach, reach + 1)
        rows, columns = np.clip(row + span, 0, h - 1), np.clip(column + span, 0, w - 1)
        inside = np.logical_and.outer(rows == row + span, columns == column + span)
        return frame[np.ix_(rows, columns)], inside & self.sound[np.ix_(rows, columns)]

    def _block(self, held: list[_Patches]) -> Glints:
        names = _Patches.__dataclass_fields__
        patches = _Patches(*(np.concatenate([getattr(p, n) for p in held]) for n in names))
        corner = np.column_stack([patches.column, patches.row]).astype(np.float64)
        position = corner + estimate_coarse_positions(patches.counts, self.reach)
        rough = self._rough(patches, position)
        ids = assign(rough, self.camera)
        blur = self._blurs(rough, ids)
        clipped = np.any((patches.counts >= self.sensor.ceiling) & patches.inside, axis=(1, 2))
        patches = self._level(patches)
        bowl = self._bowl(position)
        if self.profile is None and self.bounded and not self.sensor.codec_noise:  # encoders leave nothing of the shine
            self._learn(patches, position, blur, bowl)
        own = ~clipped & self.small
        found, good, light, _ = self._fit(patches, position, blur, bowl, own, np.zeros((len(position), 4)))
        # The first positions were rough, and so were velocities and neighbours: fit again where that shows.
        better = blur.copy()
        better[good] = self._blurs(found.take(good), ids[good])
        self._stretch(patches, found, better, bowl, good & ~clipped)
        near, secondaries = self._neighbours(found, good)
        again = np.max(np.abs(better - blur), axis=1) > SHOWS * self.sigma
        rows = np.flatnonzero(again | near | (secondaries[:, 2] > 0))
        if len(rows):
            position = np.where(good[:, None], found.xy, position)
            redone, kept, light[rows], second = self._fit(
                patches.take(rows),
                position[rows],
                better[rows],
                bowl[rows],
                (own | near & ~clipped)[rows],
                secondaries[rows],
            )
            good[rows] = kept
            self._agree(redone, second, secondaries[rows, 3], kept & ~clipped[rows])
            found = found.put(rows, redone)
        found.flags[near] |= NEAR
        found, light = found.take(good), light[good]
        if not clipped.any():  # position and flux of an open glint are hardly correlated
            return found
        xy, cov = apply_flux_prior(found.xy, found.cov, np.log(found.flux), light[:, :2], light[:, 2])
        return replace(found, x=xy[:, 0], y=xy[:, 1], cov=cov)

    def _agree(self, found: Glints, second: Array, share: Array, open_: NDArray[np.bool_]) -> None:
        """Corrects positions and covariances by the common reflectance of secondaries, of flux ``second`` (n, 4)."""
        rows = np.flatnonzero(open_ & (share > 0) & (second[:, 3] > 0))
        unit = share[rows] * found.flux[rows]
        ratios = second[rows] / np.column_stack([unit, unit, unit, unit**2])
        xy, cov = apply_common_reflectance(found.xy[rows], found.cov[rows], ratios[:, 0], ratios[:, 1:3], ratios[:, 3])
        found.x[rows], found.y[rows] = xy.T
        found.cov[rows] = cov

    def _level(self, patches: _Patches) -> _Patches:
        """Open counts less their pixels' own offsets, where these are known all over a patch."""
        if not self.bare:
            return patches
        span, (w, h) = np.arange(-self.reach, self.reach + 1), self.size
        rows, columns = (np.clip(at[:, None] + span, 0, n - 1) for at, n in ((patches.row, h), (patches.column, w)))
        own, left = self.bare.offsets(rows[:, :, None], columns[:, None, :], self.sensor.dsnu / self.sensor.gain)
        known = np.logical_not(np.isnan(own).any(axis=(1, 2)))
        own[~known] = 0.0
        own[patches.counts >= self.sensor.ceiling] = 0.0
        self.levelled = replace(self.sensor, dsnu=left * self.sensor.gain)
        return replace(patches, counts=patches.counts - own, level=known)

    def _bowl(self, position: Array) -> Array:
        """From the glints to the middles of the ball profiles, px; hardly changes from place to place.

        What mirrors the sky at an angle a from the zenith is a circle about cos(a/2) of the way from the ball's
        centre to where it mirrors the zenith.
        """
        return locate_zenith_point(self.camera, position, MIDDLE) - position

    def _rough(self, patches: _Patches, position: Array) -> Glints:
        n = len(position)
        return Glints(
            patches.frame, position[:, 0], position[:, 1], np.tile(np.eye(2), (n, 1, 1)), patches.strength,
            np.zeros(n), np.zeros(n, np.int64),
        )  # fmt: skip

    def _blurs(self, glints: Glints, ids: Ints) -> Array:
        if self.camera.effective_exposure == 0.0:
            return np.zeros((len(glints), 2))
        return estimate_velocities(glints.frame, ids, glints.xy) * (self.camera.effective_exposure * self.camera.fps)

    def _stretch(self, patches: _Patches, found: Glints, blur: Array, bowl: Array, good: NDArray[np.bool_]) -> None:
        """Gathers what the block's fastest single glints show of the length of the motion blur."""
        length = np.hypot(*blur.T)
        rows = np.flatnonzero(good & self._find_isolated(patches.frame, found.xy))
        rows = rows[np.argsort(-length[rows], kind="stable")]
        if len(rows) < MOVED + STILL or length[rows[MOVED - 1]] < LEAST * self.sigma:
            return
        rows = np.concatenate([rows[:MOVED], rows[-STILL:]])
        half = min(self.half + math.floor(float(np.max(np.abs(blur[rows]))) / 2.0 + 0.35), self.reach)
        windows, origin = self._windows(patches, found.xy, blur, bowl, rows, half, self.limit)
        known = np.column_stack([found.xy[rows] - origin, np.log(found.flux[rows]), found.background[rows]])
        self.motion_blur.add(*score_blur_length(windows, known, np.arange(len(rows)) >= MOVED, self.sigma, self.sensor))

    def _fit(
        self, patches: _Patches, position: Array, blur: Array, bowl: Array, own: NDArray[np.bool_], secondaries: Array
    ) -> tuple[Glints, NDArray[np.bool_], Array, Array]:
        """Fits in groups of one window size, with and without a secondary glint; all glints, which are good, (n, 3):
        the covariance of their positions with log flux, and its variance; (n, 4): the secondary's flux, and likewise.
        """
        longest = np.max(np.abs(blur), axis=1)
        halves = np.minimum(self.half + np.floor(longest / 2.0 + 0.35).astype(np.int64), self.reach)
        # Beside a neighbour, or smeared, the profile is another than the one learnt; a clipped glint's own
        # bowl would cost more than a neighbour does.
        own = own | (np.hypot(*blur.T) > SMEARED * self.camera.diameter_px / 2.0)
        groups = 8 * halves + 4 * patches.level + 2 * own + (secondaries[:, 2] > 0)
        light, second = np.zeros((len(position), 3)), np.zeros((len(position), 4))
        out = self._rough(patches, position)
        good = np.zeros(len(position), dtype=bool)
        for group in np.unique(groups).tolist():
            rows = np.flatnonzero(groups == group)
            half, kind = divmod(group, 8)
            known = self.profile if kind & 2 == 0 else None
            windows, origin = self._windows(
                patches, position, blur, bowl, rows, half, self.limit if known is None else self.clear
            )
            if kind & 1:
                spots = secondaries[rows, :3] - np.column_stack([origin, np.zeros(len(rows))])
                windows = replace(windows, secondaries=spots[:, None, :])
            result = fit_glints(windows, self.sigma, self.levelled if kind & 4 else self.sensor, known)
            inflation = _inflation(result, windows)
            out.x[rows], out.y[rows] = (origin + result.xy).T
            out.cov[rows] = result.cov * inflation[:, None, None]
            out.fixed[rows] = result.fixed
            out.flux[rows], out.background[rows] = result.flux, result.background
            relative = result.flux_std / result.flux
            light[rows] = np.column_stack([result.cross, relative**2]) * inflation[:, None]
            second[rows] = result.secondary * np.column_stack([np.ones(len(rows)), *[inflation] * 3])
            out.flags[rows] = self._flags(result, windows, blur[rows])
            good[rows] = self._good(result, out.xy[rows], half)
        return out, good, light, second

    def _learn(self, patches: _Patches, position: Array, blur: Array, bowl: Array) -> None:
        """The clip's ball profile, from bright single glints of the block; ``position`` gets their better positions."""
        clear = patches.strength > 0.5 * float(np.median(patches.strength))
        clear &= np.hypot(*blur.T) < SMEARED * self.camera.diameter_px / 2.0
        rows = np.flatnonzero(clear & self._find_isolated(patches.frame, position))
        if len(rows) < FEWEST:
            return
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, PUPILS).round().astype(np.int64))]
        windows, origin = self._windows(patches, position, blur, bowl, rows, self.half + 1, self.clear)
        self.profile, found = learn_profile(windows, self.sigma, self.levelled, self.end)
        position[rows] = origin + found

    def _find_isolated(self, frame: Ints, position: Array) -> NDArray[np.bool_]:
        """Which candidates have no other within three diameters in their frame; sorted by frame."""
        alone = np.ones(len(frame), dtype=bool)
        for lag in range(1, min(len(frame), CROWD)):
            same = np.flatnonzero(frame[lag:] == frame[:-lag])
            if len(same) == 0:
                break
            close = same[np.hypot(*(position[same + lag] - position[same]).T) < 3.0 * self.camera.diameter_px]
            alone[close] = alone[close + lag] = False
        return alone

    def _windows(
        self, patches: _Patches, position: Array, blur: Array, bowl: Array, rows: Ints, half: int, limit: float
    ) -> tuple[GlintWindows, Array]:
        """Windows of 2 half + 1 pixels about the pixels nearest to ``position``, and those pixels' positions."""
        corner = np.column_stack([patches.column[rows], patches.row[rows]])
        room = self.reach - half
        shift = np.clip(np.round(position[rows] - corner).astype(np.int64), -room, room)
        index = np.arange(-half, half + 1) + self.reach
        across = index + shift[:, :1]
        down = index + shift[:, 1:]
        each = np.arange(len(rows))[:, None, None]
        counts = patches.counts[rows][each, down[:, :, None], across[:, None, :]].astype(np.float64)
        inside = patches.inside[rows][each, down[:, :, None], across[:, None, :]].astype(np.float64)
        origin = (corner + shift).astype(np.float64)
        start = np.clip(position[rows] - origin, -half, half)
        offsets = np.abs(np.arange(-half, half + 1) - start[..., None])  # (n, axis, pixel)
        side = half + 0.5 if limit == self.clear else self.half + 0.5 + np.abs(blur[rows][..., None]) / 2.0
        near = (offsets <= side).astype(np.float64)
        used = inside * near[:, 1, :, None] * near[:, 0, None, :]
        used *= self._on_body(start + bowl[rows], blur[rows], half, limit)
        secondaries = np.zeros((len(rows), 0, 3))
        return GlintWindows(counts, used, start, blur[rows], bowl[rows], secondaries), origin

    def _on_body(self, middle: Array, blur: Array, half: int, limit: float) -> Array:
        """1 where a pixel sees the part of the ball that mirrors the room, in which the profile is a smooth bowl."""
        if not self.bounded:
            return np.ones((len(middle), 1, 1))
        offsets = np.arange(-half, half + 1.0)
        across, down = (offsets - middle[:, :1])[:, None, :], (offsets - middle[:, 1:])[:, :, None]
        length = np.hypot(blur[:, 0], blur[:, 1])[:, None, None]
        way = blur[..., None, None] / np.maximum(np.hypot(blur[:, 0], blur[:, 1]), 1e-9)[:, None, None, None]
        along = way[:, 0] * across + way[:, 1] * down
        along -= np.clip(along, -length / 2.0, length / 2.0)
        aside = way[:, 0] * down - way[:, 1] * across
        aside = np.where(length > 0, aside, np.hypot(across, down))
        return np.asarray(along**2 + aside**2 <= limit**2, dtype=np.float64)

    def _flags(self, result: GlintFit, windows: GlintWindows, blur: Array) -> Ints:
        full = ((windows.counts >= self.sensor.ceiling) & (windows.used > 0)).any(axis=(1, 2))
        flags = np.where(full, CLIPPED, 0)
        flags |= np.where(np.hypot(blur[:, 0], blur[:, 1]) > 0.5 * self.sigma, BLURRED, 0)
        flags |= np.where(_inflation(result, windows) > 1.0, MISFIT, 0)
        cut = windows.used[:, windows.half, windows.half] == 0
        edge = windows.used.sum(axis=(1, 2)) < 0.8 * min((2 * self.half + 1) ** 2, math.pi * self.limit**2)
        return np.asarray(flags | np.where(edge | cut, EDGE, 0), dtype=np.int64)

    def _good(self, result: GlintFit, xy: Array, half: int) -> NDArray[np.bool_]:
        in_view = np.all((xy > -0.5) & (xy < np.array(self.size) - 0.5), axis=1)
        kept_place = np.max(np.abs(result.xy), axis=1) < half
        bright = result.flux > SIGNIFICANT * result.flux_std
        return np.asarray(in_view & kept_place & bright & (result.converged > 0))

    def _neighbours(self, glints: Glints, good: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], Array]:
        """Which glints (n,) have another ball near, and where that one makes a secondary glint on theirs (n, 4): its
        position, 1, and where it is bright its share of the flux, but for the balls' reflectance.
        """
        nearest = np.full(len(glints), np.inf)
        other = np.zeros((len(glints), 2))
        rows = np.flatnonzero(good)
        order = rows[np.argsort(glints.frame[rows], kind="stable")]
        frame, xy = glints.frame[order], glints.xy[order]
        for lag in range(1, min(len(order), CROWD)):
            pairs = np.flatnonzero(frame[lag:] == frame[:-lag])
            if len(pairs) == 0:
                break
            gap = np.hypot(*(xy[pairs + lag] - xy[pairs]).T)
            for one, two in ((pairs, pairs + lag), (pairs + lag, pairs)):
                closer = gap < nearest[order[one]]
                nearest[order[one[closer]]] = gap[closer]
                other[order[one[closer]]] = xy[two[closer]]
        paired = nearest < SHOWING * self.camera.diameter_px
        secondaries = np.zeros((len(glints), 4))
        if self.camera.corrects_glint and paired.any():
            secondaries[paired, :2] = locate_secondary_glints(self.camera, glints.xy[paired], other[paired])
            secondaries[paired, 2] = 1.0
        bright = nearest < AGREE * self.camera.diameter_px
        if self.camera.corrects_glint and bright.any():
            secondaries[bright, 3] = secondary_flux_ratio(self.camera, glints.xy[bright], other[bright])
        return nearest < NEARBY * self.camera.diameter_px, secondaries


def _inflation(result: GlintFit, windows: GlintWindows) -> Array:
    """What the covariance is multiplied by where residuals are beyond doubt larger than the noise."""
    freedom = np.maximum(windows.used.sum(axis=(1, 2)) - 5.0, 1.0)
    return np.where(result.chi2 > 1.0 + 4.0 * np.sqrt(2.0 / freedom), result.chi2, 1.0)
