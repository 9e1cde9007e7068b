"""A smooth correction of the camera's map, from the residuals of free motion.

The displacement of each position is a sum of cubic B-splines with a prior of smoothness (Eilers and Marx 1996, Stat.
Sci. 11, 89). The strength of the prior maximises the marginal likelihood. The free motion of each stretch is fitted
beside it. Shifts, turns and uniform strains do not change free motion: the correction has no such part. A map is
accepted only if it predicts the stretches of recordings that were left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import eigh, null_space
from scipy.special import stdtr

from synthcam_shared.arrays import Array
from synthcam_shared.errors import InputError
from synthcam_shared.jobs import Progress
from tracker.calibration.free_stretches import FreeStretch, FrictionPrior, find_free_stretches, fit_stretch
from tracker.camera.camera import Camera
from tracker.camera.warp import Warp
from tracker.measurement.positions import to_ball_tracks
from tracker.results import read_clip

VALIDATION_FOLDS = 8


@dataclass(frozen=True, eq=False)
class SplineField:
    """Displacement fields of a rectangle: tensor products of cubic B-splines, for x and for y."""

    low: Array
    high: Array
    intervals: tuple[int, int]

    @staticmethod
    def over(position: Array) -> SplineField:
        """The fields over all positions (n, 2)."""
        min_intervals, max_intervals = 3, 16  # of the splines, along either side, and along the longer one
        positions_per_cell = 40  # at least, in the mean over the cells of the splines
        low, high = position.min(axis=0), position.max(axis=0)
        sides = np.maximum(high - low, 1e-9)
        cells = len(position) / positions_per_cell
        side = max(float(np.sqrt(sides.prod() / cells)), float(sides.max()) / max_intervals)
        across, down = (max(round(s / side), min_intervals) for s in sides)
        return SplineField(low, high, (across, down))

    @property
    def spacing(self) -> float:
        """Mean distance of the knots along either axis, m: displacements this far apart are nearly independent."""
        return float(np.mean((self.high - self.low) / self.intervals))

    def basis(self, position: Array, orders: tuple[int, int] = (0, 0)) -> Array:
        """Values (n, k) of the k splines, or derivatives of these orders, at positions (n, 2)."""
        one, other = (self._along(position[:, axis], axis, orders[axis]) for axis in (0, 1))
        return np.asarray((one[:, :, None] * other[:, None, :]).reshape(len(position), -1))

    def _along(self, at: Array, axis: int, order: int) -> Array:
        low, high, n = self.low[axis], self.high[axis], self.intervals[axis]
        knots = low + (high - low) / n * np.arange(-3, n + 4)
        splines = BSpline(knots, np.eye(n + 3), 3)
        return np.asarray(splines(np.clip(at, low, high), nu=order), dtype=np.float64)

    def roughness(self) -> Array:
        """Matrix (k, k) of the integral of the squared second derivatives, with a weak prior of the size."""
        grid = [
            self.low[a] + (self.high[a] - self.low[a]) * (np.arange(4 * n) + 0.5) / (4 * n)
            for a, n in enumerate(self.intervals)
        ]
        at = np.stack(np.meshgrid(*grid), axis=-1).reshape(-1, 2)
        size = float((self.high - self.low).max())
        parts = [(1.0, (2, 0)), (2.0, (1, 1)), (1.0, (0, 2)), (size**-4.0, (0, 0))]
        whole = sum(share * (b := self.basis(at, orders)).T @ b for share, orders in parts)
        return np.asarray(whole * size**4 / len(at))


class _NormalEquations(NamedTuple):
    """Sums over stretches, beside their own motion: the least squares problem of the displacements."""

    matrix: Any
    vector: Any
    square: Any
    dof: int

    @staticmethod
    def total(parts: Sequence[_NormalEquations]) -> _NormalEquations:
        return _NormalEquations(*(sum(values) for values in zip(*parts, strict=True)))


@dataclass(frozen=True, eq=False)
class _Posterior:
    """Coefficients of the displacements: mean, and a root (p, p) of their covariance; the chosen smoothness."""

    mean: Array
    root: Array
    smoothness: float


@dataclass(frozen=True, eq=False)
class CameraWarp:
    """A correction of a camera's map that predicts stretches which were left out."""

    camera: Camera
    recordings: int  # how many were used
    stretches: int
    positions: int
    rms_before: float  # of the residuals of stretches that were left out, m
    rms_after: float
    p_value: float  # of the gain
    size: float  # rms of the displacements at the positions, m
    error: float  # standard error of a displacement along either axis there, m
    certain: float  # share of the square of the displacements that is not error
    halves: float  # correlation of the maps of two halves of the data

    def to_dict(self) -> dict[str, Any]:
        """The keys of camera.json, with those of the fit under `calibration`."""
        fit = {key: value for key, value in vars(self).items() if key != "camera"}
        return {**self.camera.to_dict(), "calibration": {"warp": fit}}

    def summary(self) -> list[str]:
        """Lines for a terminal."""
        warp = self.camera.warp
        assert warp is not None
        shared = float(np.sqrt(self.error**2 - warp.std**2))
        return [
            f"{self.positions} positions in {self.stretches} free stretches of {self.recordings} recordings",
            f"rms of residuals on held-out stretches: {1e3 * self.rms_before:.4g} mm, with the warp "
            f"{1e3 * self.rms_after:.4g} mm (p {self.p_value:.2g})",
            f"displacements: {1e3 * self.size:.4g} mm rms, {100 * self.certain:.0f} % of their square is certain; "
            f"maps of two halves of the data correlate by {self.halves:.2f}",
            f"the map has an error of {1e3 * self.error:.3g} mm along either axis: {1e3 * shared:.3g} mm in "
            f"{len(warp.errors)} maps that all recordings share, and {1e3 * warp.std:.3g} mm that lasts over "
            f"{1e3 * warp.length:.3g} mm of a path",
        ]


def find_camera_warp(results: Sequence[Path], progress: Progress) -> CameraWarp:
    """Fit a warp to the free stretches of results of one camera. Raises InputError where they show none."""
    clips = [(folder, file) for folder in results for file in sorted((folder / "clips").glob("[0-9]*/tracks.parquet"))]
    for folder in results:
        if not any(one == folder for one, _ in clips):
            raise InputError(f"{folder}: no clips/ with tracks in it, expected RESULTS, as tracker track makes them")
    recordings, cameras = [], list[Camera]()
    for done, (folder, file) in enumerate(clips):
        progress(done, len(clips))
        tracks, camera = read_clip(folder, int(file.parent.name))
        cameras.append(camera := replace(camera, warp=None))
        if not cameras[0].metric:
            raise InputError(f"{folder}: no scale, expected results of a camera file")
        one, other = (
            np.concatenate([c.K.ravel(), c.dist, c.R.ravel(), c.t, [c.scale], c.size]) for c in (cameras[0], camera)
        )
        if not np.array_equal(one, other):
            raise InputError(f"{folder}: clip {file.parent.name}: another camera, expected results of one camera")
        recordings.append(find_free_stretches(to_ball_tracks(tracks, camera), camera.ball_diameter))
    return fit_camera_warp(replace(cameras[0], exposure_from_blur=None), recordings, progress)


def fit_camera_warp(
    camera: Camera,
    recordings: Sequence[Sequence[FreeStretch]],
    progress: Progress = lambda done, total: None,
    *,
    max_p: float = 1e-3,
) -> CameraWarp:
    """Fit a warp to free stretches by recording. Raises InputError where they are too few, or it does not help.

    max_p: p-value of the gain on held-out stretches, above which the warp is refused.
    """
    min_stretches = 20
    min_recordings = 8  # with fewer the stretches are left out in turn, and not the recordings
    repetitions = 2  # of the fit, each with the friction that the corrected stretches show
    groups = [one for one in _leave_out_bad(recordings) if one]
    count, stretches = len(groups), sum(len(one) for one in groups)
    if stretches < min_stretches:
        raise InputError(f"warp: {stretches} free stretches, expected at least {min_stretches}")
    if count < min_recordings:
        groups = [[stretch] for one in groups for stretch in one]
    problem = start = _WarpProblem.of(groups)
    for _ in range(repetitions):
        problem = problem.repeat_at(problem.solve().mean, progress)
    found = problem.solve()
    before, after, value = start.test_on_held_out(progress)
    if not value < max_p:
        raise InputError(
            f"warp: refused, the free stretches show none: it changes the rms of held-out residuals from "
            f"{1e3 * before:.4g} to {1e3 * after:.4g} mm (p {value:.2g}, expected under {max_p:g})"
        )
    shift, error = problem.displace(found.mean), problem.displace(found.root)
    errors, std = problem.split_error(found.root)
    halves = [problem.displace(problem.solve(half, found.smoothness).mean).ravel() for half in (0, 1)]
    size, variance = (float(np.sum(part**2)) / len(shift) for part in (shift, error))
    return CameraWarp(
        camera=replace(
            camera, warp=replace(problem.to_warp(found.mean), std=std, length=problem.field.spacing, errors=errors)
        ),
        recordings=count,
        stretches=stretches,
        positions=len(shift),
        rms_before=before,
        rms_after=after,
        p_value=value,
        size=float(np.sqrt(size)),
        error=float(np.sqrt(variance / 2)),
        certain=size / (size + variance),
        halves=float(np.corrcoef(halves[0], halves[1])[0, 1]),
    )


@dataclass(frozen=True, eq=False)
class _WarpProblem:
    """Stretches in groups, of which each is left out once, the field of their displacements, and its prior."""

    groups: Sequence[Sequence[FreeStretch]]
    field: SplineField
    constraint: Array
    prior: Array
    friction: FrictionPrior

    @staticmethod
    def of(groups: Sequence[Sequence[FreeStretch]]) -> _WarpProblem:
        stretches = [stretch for group in groups for stretch in group]
        position = np.concatenate([stretch.position for stretch in stretches])
        field = SplineField.over(position)
        constraint, rough = _affine_free(field, position), field.roughness()
        prior = sum(part.T @ rough @ part for part in np.split(constraint, 2))
        return _WarpProblem(groups, field, constraint, np.asarray(prior), FrictionPrior.of(stretches))

    @property
    def stretches(self) -> list[FreeStretch]:
        return [stretch for group in self.groups for stretch in group]

    @cached_property
    def sums(self) -> list[_NormalEquations]:
        """The sums of each fold, as far as there are groups for it."""
        folds = [list[_NormalEquations]() for _ in range(VALIDATION_FOLDS)]
        for number, group in enumerate(self.groups):
            folds[number % VALIDATION_FOLDS] += map(self._sum_stretch, group)
        return [_NormalEquations.total(parts) for parts in folds if parts]

    def _sum_stretch(self, stretch: FreeStretch) -> _NormalEquations:
        """The sums over one stretch; its residuals are those of positions before the correction."""
        basis, residual = self.field.basis(stretch.position) / stretch.std[:, None], stretch.residual
        columns = stretch.project(np.concatenate([basis @ part for part in np.split(self.constraint, 2)]))
        return _NormalEquations(columns.T @ columns, -columns.T @ residual, residual @ residual, stretch.dof)

    def solve(self, half: int | None = None, smoothness: float | None = None) -> _Posterior:
        """The displacements by all folds, or by every second; at the smoothness of the largest marginal likelihood."""
        sums = _NormalEquations.total(self.sums if half is None else self.sums[half::2])
        size, axes = eigh(sums.matrix, self.prior)
        size, pull = np.maximum(size, 0.0), axes.T @ sums.vector
        # precision of the prior over that of the positions
        ratios = size.max() * np.logspace(-8, 8, 65) if smoothness is None else np.array([smoothness])
        left = sums.square - (pull**2 / (size + ratios[:, None])).sum(axis=1)
        evidence = -sums.dof * np.log(left) - np.log1p(size / ratios[:, None]).sum(axis=1)
        best = int(np.argmax(evidence))
        shrunk = size + ratios[best]
        root = axes * np.sqrt(left[best] / sums.dof / shrunk)
        return _Posterior(axes @ (pull / shrunk), root, float(ratios[best]))

    def repeat_at(self, mean: Array, progress: Progress = lambda done, of: None) -> _WarpProblem:
        """The problem about these displacements, with a prior of friction as the corrected stretches show it."""
        friction = FrictionPrior.of([one.fit_again(self._shift(one.position, mean)) for one in self.stretches])
        groups = []
        for number, group in enumerate(self.groups):
            progress(number, len(self.groups))
            groups.append([one.fit_again(self._shift(one.position, mean), friction) for one in group])
        return replace(self, groups=groups, friction=friction)

    def without(self, fold: int) -> _WarpProblem:
        """The problem of the other folds alone, with their friction."""
        rest = replace(self, groups=[one for k, one in enumerate(self.groups) if k % VALIDATION_FOLDS != fold])
        return replace(rest, friction=FrictionPrior.of(rest.stretches))

    def test_on_held_out(self, progress: Progress) -> tuple[float, float, float]:
        """The rms of residuals of groups that were left out, m, without and with a correction; p-value of the gain.

        The map, the friction and the motions about which both are linear come from the other groups alone. Each
        stretch that was left out is fitted again.
        """
        gains, total, left = [], 0.0, 0.0
        for fold in range(VALIDATION_FOLDS):
            progress(fold, VALIDATION_FOLDS)
            plain = self.without(fold)
            fitted = plain.repeat_at(plain.solve().mean)
            mean = fitted.solve().mean
            for group in self.groups[fold::VALIDATION_FOLDS]:
                gain = 0.0
                for stretch in group:
                    shifted = stretch.position + self._shift(stretch.position, mean)
                    before = fit_stretch(stretch.time, stretch.position, stretch.std, plain.friction).chi2
                    after = fit_stretch(stretch.time, shifted, stretch.std, fitted.friction).chi2
                    total, left, gain = total + before, left + after, gain + before - after
                gains.append(gain)
        error = np.std(gains, ddof=1) / np.sqrt(len(gains))
        noise = float(np.median(np.concatenate([stretch.std for stretch in self.stretches])))
        dof = sum(stretch.dof for stretch in self.stretches)
        before, after = (noise * float(np.sqrt(square / dof)) for square in (total, left))
        return before, after, float(stdtr(len(gains) - 1, -np.mean(gains) / max(error, 1e-300)))

    def displace(self, coefficients: Array) -> Array:
        """Displacements (n, 2, ...) of all positions by coefficients (p, ...)."""
        return self._shift(np.concatenate([stretch.position for stretch in self.stretches]), coefficients)

    def _shift(self, position: Array, coefficients: Array) -> Array:
        basis = self.field.basis(position)
        return np.stack([basis @ (part @ coefficients) for part in np.split(self.constraint, 2)], axis=1)

    def to_warp(self, coefficients: Array) -> Warp:
        """The displacements at the knots."""
        x, y, (dx, dy) = *self._knots, self._shift_knots(coefficients)
        return Warp(x, y, dx, dy)

    @cached_property
    def _knots(self) -> tuple[Array, Array]:
        """Knots x and y of a warp, twice as dense as those of the field."""
        low, high = self.field.low, self.field.high
        x, y = (np.linspace(low[a], high[a], 2 * self.field.intervals[a] + 1) for a in (0, 1))
        return x, y

    def _shift_knots(self, coefficients: Array) -> Array:
        """Displacements (2, n, m) at the knots by coefficients (p,)."""
        at = np.stack(np.meshgrid(*self._knots), axis=-1)
        return np.moveaxis(self._shift(at.reshape(-1, 2), coefficients).reshape(at.shape), -1, 0)

    def split_error(self, root: Array) -> tuple[Array, float]:
        """Split the error of the displacements into its largest principal components and a rest.

        Each component is a map of one independent standard error. Together they hold 90 % of the variance at the
        positions, unless that needs more than 12. The rest varies over a way as short as the field can.

        root: (p, p), of the covariance of the coefficients. Returns the maps at the knots (k, 2, n, m), rounded to a
        nanometre, and the standard error of the rest along either axis, m.
        """
        error = self.displace(root).reshape(-1, root.shape[1])
        size, axes = np.linalg.eigh(error.T @ error / len(error))
        size, axes = np.maximum(size[::-1], 0.0), axes[:, ::-1]
        left = 1 - np.cumsum(size) / size.sum()
        count = min(int(np.sum(left > 1 - 0.9)) + 1, 12, len(size) - 1)
        maps = [self._shift_knots(root @ axes[:, k]).round(9) for k in range(count)]
        return np.stack(maps), float(np.sqrt(size[count:].sum()))


def _leave_out_bad(recordings: Sequence[Sequence[FreeStretch]]) -> list[list[FreeStretch]]:
    """Keep the stretches whose residuals are at most 3 times the usual ones; the others are not free motion."""
    sizes = [stretch.chi2 / stretch.dof for one in recordings for stretch in one]
    limit = 3.0**2 * float(np.median(sizes)) if sizes else 0.0
    return [[stretch for stretch in one if stretch.chi2 / stretch.dof <= limit] for one in recordings]


def _affine_free(field: SplineField, position: Array) -> Array:
    """Columns (2k, 2k - 6) of displacements that have no shift, turn or uniform strain over the positions."""
    basis = field.basis(position)
    centred = (position - position.mean(axis=0)) / np.ptp(position, axis=0).max()
    sums = np.column_stack([np.ones(len(position)), centred]).T @ basis
    empty = np.zeros_like(sums)
    return np.asarray(null_space(np.block([[sums, empty], [empty, sums]])))
