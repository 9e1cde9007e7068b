"""Maximum likelihood of the pixel-integrated glint, clipped pixels censored, motion in the exposure modelled.

Candidates are collected frame by frame. A block of them is then fitted in two passes:

1. link the coarse positions to tracks, from which the motion blur follows; learn the ball profile; fit all glints;
2. fit again where the better velocities change the blur, or where a neighbour adds a secondary glint.

What no blur of a track describes is fitted with that of its own shape.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam_shared.arrays import Array, Flags, Ints
from tracker.camera.mirror_images import locate_zenith_point
from tracker.detection.candidates import Candidates, CandidateSearch
from tracker.detection.detector import Detections, View
from tracker.detection.glints import Glints, PositionFlag
from tracker.detection.likelihood.ball_profile import BallProfile
from tracker.detection.likelihood.brightness_priors import apply_common_reflectance, apply_flux_prior
from tracker.detection.likelihood.dsnu import DsnuEstimator
from tracker.detection.likelihood.glint_fit import (
    GlintFit,
    GlintWindows,
    fit_blurs,
    fit_glints,
    learn_profile,
    score_blur_length,
)
from tracker.detection.likelihood.neighbours import (
    Neighbours,
    find_isolated,
    find_neighbouring_glints,
    find_repeated,
)
from tracker.detection.likelihood.patches import (
    CandidatePatches,
    GlintGeometry,
    Patch,
    cut_patches,
    make_windows,
    measure_shapes,
    stack_patches,
)
from tracker.detection.link import assign_track_numbers, estimate_velocities
from tracker.detection.motion_blur import MotionBlurEvidence

SMEARED_RADII = 0.3  # displacement during the exposure from which on a ball's profile is not the learnt one


@dataclass(frozen=True, eq=False)
class _BlockFit:
    """Fitted glints of a block."""

    glints: Glints
    good: Flags  # which fits are a glint's
    light: Array  # (n, 3): covariance of position and log flux, px, and variance of the log flux
    secondary: Array  # (n, 4): flux of the secondary glint, counts; its covariance with the position; its variance

    def put(self, rows: Ints, other: "_BlockFit", chosen: Any = slice(None)) -> None:
        """Replace the fits of ``rows`` by the chosen ones of another."""
        self.glints.put(rows, other.glints.take(chosen))
        self.light[rows], self.good[rows] = other.light[chosen], other.good[chosen]


class MaximumLikelihood:
    """Finds candidates frame by frame, then fits all of a block at once."""

    def __init__(self, view: View) -> None:
        self.camera, self.sigma = view.camera, view.sigma
        self.settings, self.link = view.settings.detection, view.settings.link
        self.geometry = GlintGeometry(view)
        radius = self.geometry.radius
        # A ball's own secondary glints are .7 R from its centre, the next ball's glint at least 2 R away.
        self.search = CandidateSearch(view.plate, self.sigma, max(1.6 * radius, 4.0 * self.sigma), self.settings)
        self.profile: BallProfile | None = None
        self.blur = MotionBlurEvidence()
        self.levelled = self.sensor = self.camera.sensor
        # A ball hides the plate out to 1.5 radii from its glint at most.
        self.dsnu = DsnuEstimator(view.plate, math.ceil(1.5 * radius) + 2) if self.sensor.dsnu else None
        self.sound = np.ones(view.plate.level.shape, dtype=np.bool_)
        self.sound.ravel()[view.plate.hot] = False

    def __call__(self, frame: NDArray[Any]) -> Glints:
        """Glints of one frame, as if at rest during the exposure."""
        return self.detect([(0, frame)]).glints

    def detect(self, frames: Iterable[tuple[int, NDArray[Any]]]) -> Detections:
        """Glints of numbered frames, their motion blur from the glints' own motion from frame to frame."""
        return self.gather(self._examine_in_turn(frames))

    @property
    def can_share(self) -> bool:
        """False where all frames give the offsets of the pixels."""
        return self.dsnu is None

    def examine(self, number: int, frame: NDArray[Any]) -> tuple[Candidates, list[Patch]]:
        """The candidates of a frame, and the pixels around each."""
        [(_, examined)] = self._examine_in_turn([(number, frame)])
        return examined

    def _examine_in_turn(
        self, frames: Iterable[tuple[int, NDArray[Any]]]
    ) -> Iterator[tuple[int, tuple[Candidates, list[Patch]]]]:
        """Examine numbered frames, a few small ones at a time."""
        most_frames, most_pixels = 16, 5 * 2**20  # at a time
        together = min(max(most_pixels // self.sound.size, 1), most_frames)
        left = iter(frames)
        while some := list(islice(left, together)):
            for (number, frame), found in zip(
                some, self.search.search_together([each for _, each in some]), strict=True
            ):
                if self.dsnu and not found.crowded:
                    self.dsnu.add(frame, found.row, found.column)
                yield number, (found, cut_patches(frame, found, self.geometry.reach, self.sound))

    def gather(self, examined: Iterable[tuple[int, tuple[Candidates, list[Patch]]]]) -> Detections:
        """The glints of these candidates, fitted in blocks."""
        parts, waiting, count = [Glints.none()], list[tuple[int, Candidates, list[Patch]]](), 0
        for number, (found, patches) in examined:
            waiting.append((number, found, patches))
            count += len(patches)
            if count >= self.settings.block_windows:
                parts.append(self._fit_block(stack_patches(waiting)))
                waiting, count = [], 0
        if count:
            parts.append(self._fit_block(stack_patches(waiting)))
        return Detections(glints=Glints.join(parts), blur=self.blur)

    def _fit_block(self, patches: CandidatePatches) -> Glints:
        """The glints of a block of candidates."""
        rough = _rough_glints(patches)
        ids = assign_track_numbers(rough, self.camera, settings=self.link)
        blur = self._blurs(rough, ids)
        clipped = np.any((patches.counts >= self.sensor.ceiling) & patches.inside, axis=(1, 2))
        # From the glints to the middles of the ball profiles; it hardly depends on the exact position. The image of the
        # sky at an angle a from the zenith is a circle. Its centre is at cos(a/2) of the line from the ball's centre to
        # the point that mirrors the zenith. The profile's middle is that for a ring at half the ball's radius, cos 30
        # deg.
        bowl = locate_zenith_point(self.camera, patches.position, 0.866) - patches.position
        patches = replace(self._subtract_offsets(patches), blur=blur, bowl=bowl)
        # Encoders leave nothing of the mirrored room, so that there is no profile to learn.
        if self.profile is None and self.geometry.is_bounded and not self.sensor.codec_noise:
            self._learn_profile(patches)
        bowl_of_own = ~clipped & self.geometry.is_small
        first = self._fit(patches, bowl_of_own, np.zeros((len(patches), 3)))
        found, good, light = first.glints, first.good, first.light
        # The first positions were rough, and so were velocities and neighbours: fit again where that shows.
        better = blur.copy()
        better[good] = self._blurs(found.take(good), ids[good])
        patches = replace(patches, position=found.xy, blur=better)
        self._collect_blur_evidence(patches, found, good & ~clipped)
        near = find_neighbouring_glints(found, good, self.camera)
        # a change of the blur by .03 widths of the glint shows in its position
        changed = np.max(np.abs(better - blur), axis=1) > 0.03 * self.sigma
        rows = np.flatnonzero(changed | near.is_near | (near.secondary[:, 2] > 0))
        bowl_of_own |= near.is_near & ~clipped
        if len(rows):
            again = self._fit_beside(patches.take(rows), bowl_of_own[rows], near.take(rows), clipped[rows])
            first.put(rows, again)
        if not self.sensor.codec_noise and not self.camera.matte:
            self._fit_own_blurs(patches, first, near, bowl_of_own, clipped)
        found.flags[near.is_near] |= PositionFlag.NEAR
        found, light = found.take(good), light[good]
        if not clipped.any():  # position and flux of an open glint are hardly correlated
            return found
        xy, cov = apply_flux_prior(found.xy, found.cov, np.log(found.flux), light[:, :2], light[:, 2])
        return replace(found, x=xy[:, 0], y=xy[:, 1], cov=cov)

    def _fit_beside(self, patches: CandidatePatches, bowl_of_own: Flags, near: Neighbours, clipped: Flags) -> _BlockFit:
        """Fit glints with the secondary glints that their neighbours add."""
        fit = self._fit(patches, bowl_of_own, near.secondary)
        _correct_by_reflectance(fit.glints, fit.secondary, near.flux_ratio, fit.good & ~clipped)
        return fit

    def _fit_own_blurs(
        self, patches: CandidatePatches, fit: _BlockFit, near: Neighbours, bowl_of_own: Flags, clipped: Flags
    ) -> None:
        """Fit misfits, and candidates that seem no glints, with the blurs of their own shapes; `fit` gets better ones.

        The tracks give a wrong blur where a ball is hit or lost. If it is hit during the exposure, its path is bent.
        The middle of a straight line fitted to a path of up to three widths of the glint is the mean position during
        the exposure, within 0.02 of a width; longer bent paths are misfits.
        """
        min_share = 0.25  # of the light of a typical glint; reflections have less
        rows = np.flatnonzero(~clipped & (~fit.good | ((fit.glints.flags & PositionFlag.MISFIT) > 0)))
        if len(rows) == 0:
            return
        shapes = measure_shapes(patches.take(rows), self.sigma)
        typical = float(np.median(fit.glints.flux[fit.good] if fit.good.any() else shapes.flux))
        # A fit hardly has twice the light that was seen: the faintest candidates end below `min_share`.
        able = fit.good[rows] | (shapes.flux > min_share / 2.5 * typical)
        able &= shapes.width < 1.4 * self.sigma  # else no glint: a body, or several
        if not able.any():
            return
        rows, shapes = rows[able], shapes.take(able)
        smeared = replace(patches.take(rows), blur=shapes.blur, position=shapes.position)
        half = int(self.geometry.half_of_blur(smeared.blur).max())
        windows, origin = make_windows(self.geometry, smeared, half, with_profile=False)
        known = np.column_stack([smeared.position - origin, np.log(shapes.flux), shapes.background])
        blur = fit_blurs(windows, known, self.sigma, self.sensor)
        in_patch = np.hypot(*blur.T) < 2.0 * self.geometry.reach
        smeared = replace(smeared, blur=np.where(in_patch[:, None], blur, smeared.blur))
        again = self._fit_beside(smeared, bowl_of_own[rows], near.take(rows), clipped[rows])
        # What seemed no glint may be a ball's, if it is long and not faint as reflections are.
        if not fit.good.any():
            typical = float(np.median(again.glints.flux))
        long, bright = np.hypot(*smeared.blur.T) > 2.0 * self.sigma, again.glints.flux > min_share * typical
        chosen = again.good & _fits_better(again.glints, fit.glints.take(rows), fit.good[rows])
        chosen &= fit.good[rows] | (long & bright)
        if chosen.any():
            fit.put(rows[chosen], again, chosen)
            seen = np.flatnonzero(fit.good)  # a long smear has several candidates, which are now fits of the same
            fit.good[seen[find_repeated(fit.glints.take(seen), self.search.apart / 2)]] = False

    def _subtract_offsets(self, patches: CandidatePatches) -> CandidatePatches:
        """The patches without the fixed offsets of their pixels, where these are known all over a patch."""
        if not self.dsnu:
            return patches
        reach, (w, h) = self.geometry.reach, self.geometry.size
        span = np.arange(-reach, reach + 1)
        rows, columns = (np.clip(at[:, None] + span, 0, n - 1) for at, n in ((patches.row, h), (patches.column, w)))
        own, left = self.dsnu.offsets(rows[:, :, None], columns[:, None, :], self.sensor.dsnu / self.sensor.gain)
        known = np.logical_not(np.isnan(own).any(axis=(1, 2)))
        own[~known] = 0.0
        own[patches.counts >= self.sensor.ceiling] = 0.0
        self.levelled = replace(self.sensor, dsnu=left * self.sensor.gain)
        return replace(patches, counts=patches.counts - own, level=known)

    def _blurs(self, glints: Glints, ids: Ints) -> Array:
        """Displacements (n, 2) of glints during the exposure, px, from their tracks."""
        exposed_frames = self.camera.effective_exposure * self.camera.fps
        return estimate_velocities(glints.frame, ids, glints.xy) * exposed_frames

    def _is_isolated(self, patches: CandidatePatches) -> Flags:
        return find_isolated(patches.frame, patches.position, 3.0 * self.camera.diameter_px)

    def _collect_blur_evidence(self, patches: CandidatePatches, found: Glints, good: Flags) -> None:
        """Add what the 24 fastest and the 24 slowest isolated glints show of the length of the blur."""
        count = 24
        length = np.hypot(*patches.blur.T)
        rows = np.flatnonzero(good & self._is_isolated(patches))
        rows = rows[np.argsort(-length[rows], kind="stable")]
        if len(rows) < 2 * count or length[rows[count - 1]] < 0.05 * self.sigma:  # too short to be measured
            return
        rows = np.concatenate([rows[:count], rows[-count:]])
        half = int(self.geometry.half_of_blur(patches.blur[rows]).max())
        windows, origin = make_windows(self.geometry, patches.take(rows), half, with_profile=False)
        known = np.column_stack([found.xy[rows] - origin, np.log(found.flux[rows]), found.background[rows]])
        still = np.arange(len(rows)) >= count
        self.blur.add(*score_blur_length(windows, known, still, self.sigma, self.sensor))

    def _learn_profile(self, patches: CandidatePatches) -> None:
        """Learn the profile from 24 to 128 bright isolated glints; ``patches`` get their better positions."""
        bright = patches.strength > 0.5 * float(np.median(patches.strength))
        still = np.hypot(*patches.blur.T) < SMEARED_RADII * self.geometry.radius
        rows = np.flatnonzero(bright & still & self._is_isolated(patches))
        if len(rows) < 24:
            return
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, 128).round().astype(np.int64))]
        windows, origin = make_windows(self.geometry, patches.take(rows), self.geometry.half + 1, with_profile=True)
        self.profile, found = learn_profile(windows, self.sigma, self.levelled, self.geometry.profile_end)
        patches.position[rows] = origin + found

    def _fit(self, patches: CandidatePatches, bowl_of_own: Flags, secondaries: Array) -> _BlockFit:
        """Fit n glints in groups of one kind of window; `secondaries` (n, 3): their positions, px, and 1, or zeros."""
        n, blur, halves = len(patches), patches.blur, self.geometry.half_of_blur(patches.blur)
        # Near a neighbour, or smeared, a ball has another profile than the learnt one. A clipped glint keeps the
        # learnt one beside a neighbour: a free bowl would cost it more.
        bowl_of_own = bowl_of_own | (np.hypot(*blur.T) > SMEARED_RADII * self.geometry.radius)
        has_secondary = secondaries[:, 2] > 0
        kinds = np.column_stack([halves, patches.level, bowl_of_own, has_secondary])
        light, second, good = np.zeros((n, 3)), np.zeros((n, 4)), np.zeros(n, dtype=bool)
        out = _rough_glints(patches)
        for kind in np.unique(kinds, axis=0):
            rows = np.flatnonzero((kinds == kind).all(axis=1))
            half, is_level, own, paired = int(kind[0]), *map(bool, kind[1:])
            profile = None if own else self.profile
            windows, origin = make_windows(self.geometry, patches.take(rows), half, profile is not None)
            if paired:
                spots = secondaries[rows] - np.column_stack([origin, np.zeros(len(rows))])
                windows = replace(windows, secondaries=spots[:, None, :])
            result = fit_glints(windows, self.sigma, self.levelled if is_level else self.sensor, profile)
            inflation = _inflation(result, windows)
            out.x[rows], out.y[rows] = (origin + result.xy).T
            out.cov[rows] = result.cov * inflation[:, None, None]
            out.fixed[rows] = result.fixed
            out.flux[rows], out.background[rows] = result.flux, result.background
            relative = result.flux_std / result.flux
            light[rows] = np.column_stack([result.cross, relative**2]) * inflation[:, None]
            second[rows] = result.secondary * np.column_stack([np.ones(len(rows)), *[inflation] * 3])
            out.flags[rows] = self._flags(result, windows, blur[rows])
            good[rows] = self._is_good(result, out.xy[rows], half)
        return _BlockFit(glints=out, good=good, light=light, secondary=second)

    def _flags(self, result: GlintFit, windows: GlintWindows, blur: Array) -> Ints:
        full = ((windows.counts >= self.sensor.ceiling) & (windows.used > 0)).any(axis=(1, 2))
        cut = windows.used[:, windows.half, windows.half] == 0
        whole = min((2 * self.geometry.half + 1) ** 2, math.pi * self.geometry.limit**2)  # pixels
        properties = {
            PositionFlag.CLIPPED: full,
            PositionFlag.STREAK: np.hypot(*blur.T) > 0.5 * self.sigma,
            PositionFlag.MISFIT: _inflation(result, windows) > 1.0,
            PositionFlag.EDGE: cut | (windows.used.sum(axis=(1, 2)) < 0.8 * whole),
        }
        return np.asarray(sum(flag * holds for flag, holds in properties.items()), dtype=np.int64)

    def _is_good(self, result: GlintFit, xy: Array, half: int) -> Flags:
        """True if fits converged in their window, in the picture, on a significant flux."""
        in_view = np.all((xy > -0.5) & (xy < np.array(self.geometry.size) - 0.5), axis=1)
        in_window = np.max(np.abs(result.xy), axis=1) < half
        bright = result.flux > self.settings.glint_sigma * result.flux_std
        return np.asarray(in_view & in_window & bright & result.converged)


def _rough_glints(patches: CandidatePatches) -> Glints:
    """Candidates as glints at their first positions, with a covariance that the fit will replace."""
    x, y = patches.position.T.copy()
    return replace(Glints.at(x, y, 1.0, patches.strength), frame=patches.frame)


def _fits_better(new: Glints, old: Glints, was_good: Flags) -> Flags:
    """Tell which fits (n,) describe the pixels, or halve the chi^2 of misfits."""
    area = [np.linalg.det(one.cov) for one in (new, old)]  # of a misfit it grows with the square of chi^2
    return np.asarray(((new.flags & PositionFlag.MISFIT) == 0) | (was_good & (area[0] < area[1] / 4)))


def _correct_by_reflectance(found: Glints, second: Array, ratio: Array, is_open: Flags) -> None:
    """Correct glints by the common reflectance; `second` as in `_BlockFit`, flux ratios (n,) from geometry."""
    rows = np.flatnonzero(is_open & (ratio > 0) & (second[:, 3] > 0))
    unit = ratio[rows] * found.flux[rows]
    ratios = second[rows] / np.column_stack([unit, unit, unit, unit**2])
    xy, cov = apply_common_reflectance(found.xy[rows], found.cov[rows], ratios[:, 0], ratios[:, 1:3], ratios[:, 3])
    found.x[rows], found.y[rows] = xy.T
    found.cov[rows] = cov


def _inflation(result: GlintFit, windows: GlintWindows) -> Array:
    """Factors (n,) of the covariances: chi^2 per degree of freedom where it exceeds 1 by 4 standard deviations."""
    freedom = np.maximum(windows.used.sum(axis=(1, 2)) - 5.0, 1.0)
    return np.where(result.chi2 > 1.0 + 4.0 * np.sqrt(2.0 / freedom), result.chi2, 1.0)
