"""Errors of detected positions: missed, false, rmse, and its ratio to the Cramér-Rao bound.

Clips are pooled by adding their sums.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from scipy.optimize import linear_sum_assignment

from synthcam_shared.arrays import Array, Flags, Ints
from tracker.detection.likelihood.cramer_rao import localisation_bound

if TYPE_CHECKING:
    from tracker.camera.camera import Camera


@dataclass(frozen=True)
class MatchedDetections:
    """Detections of one clip, paired with the truth; only balls wholly in view count.

    pairs (n, 2): rows of `truth` and `found` that belong together.
    counted (k,): False for detections on balls partly out of view.
    missed, false: balls without a detection, and detections without a ball.
    """

    truth: pd.DataFrame
    found: pd.DataFrame
    pairs: Ints
    counted: Flags
    missed: int
    false: int

    @property
    def off(self) -> Array:
        """Found minus true position, (n, 2) px."""
        return _xy(self.found)[self.pairs[:, 1]] - _true(self.truth)[self.pairs[:, 0]]

    @property
    def moving(self) -> Flags:
        """Tell whether the ball of a pair moves along each axis, (n, 2)."""
        min_motion_px = 0.05  # per frame; a ball at rest always has the same sub-pixel phase
        pace = self.truth.sort_values("frame").groupby("particle")[["x_mean_px", "y_mean_px"]].diff().abs()
        return np.asarray(pace.reindex(self.truth.index).to_numpy(float)[self.pairs[:, 0]] > min_motion_px)


def find_required_rows(truth: pd.DataFrame, *, max_hidden: float = 0.5) -> Flags:
    """Find the rows (n,) of true tracks whose balls have to be found: in view, and not hidden by more than a share."""
    whole = truth["visible"].to_numpy(bool)
    if "hidden" not in truth:
        return whole
    return np.asarray(whole & ~(truth["hidden"].to_numpy(float) > max_hidden))


def match(truth: pd.DataFrame, found: pd.DataFrame, gate: float, ball_px: float) -> MatchedDetections:
    """Match detected positions (frame, x, y px) with true ones (frame, x_mean_px, y_mean_px, visible) by frame.

    `gate` is the largest distance of a pair, `ball_px` the diameter of a ball, px. A ball partly out of view, or more
    than half hidden by others (column hidden, if there is one), need not be found. A detection on it does not count.
    """
    position, seen = _true(truth), _xy(found)
    whole = find_required_rows(truth)
    pairs: list[tuple[int, int]] = []
    counted = np.ones(len(found), bool)
    then, now = truth["frame"].to_numpy(), found["frame"].to_numpy()
    for frame in np.unique(now):
        i, j = np.flatnonzero(then == frame), np.flatnonzero(now == frame)
        apart = np.linalg.norm(position[i][:, None] - seen[j][None], axis=-1)
        counted[j[(apart[~whole[i]] < ball_px).any(axis=0)]] = False
        for a, b in zip(*linear_sum_assignment(np.minimum(apart, 10 * gate)), strict=True):
            if apart[a, b] <= gate and whole[i[a]]:
                pairs.append((int(i[a]), int(j[b])))
                counted[j[b]] = True
    table = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    false = int(counted.sum()) - len(table)
    return MatchedDetections(truth, found, table, counted, int(whole.sum()) - len(table), false)


def position_bounds(matched: MatchedDetections, camera: Camera) -> Array:
    """Compute the Cramér-Rao covariance (n, 2, 2) px^2 of each paired position.

    The flux is that of the detection, the motion blur follows from the true velocity. NaN without flux or optics.
    """
    n = len(matched.pairs)
    if camera.sigma is None or "flux" not in matched.found or n == 0:
        return np.full((n, 2, 2), np.nan)
    truth, found = matched.truth.iloc[matched.pairs[:, 0]], matched.found.iloc[matched.pairs[:, 1]]
    glint, blur = find_true_glints(truth, camera)
    flux = found["flux"].to_numpy(float)
    known = np.isfinite(flux) & (flux > 0) & np.isfinite(glint).all(axis=1)
    out = np.full((n, 2, 2), np.nan)
    if known.any():
        out[known] = localisation_bound(camera, flux[known], glint[known], blur[known])
    return out


def find_true_glints(truth: pd.DataFrame, camera: Camera) -> tuple[Array, Array]:
    """The true positions (n, 2) of glints, px, and how far the ball of each moves during the exposure, px."""
    here = truth[["x", "y", "z"]].to_numpy(float)
    there = here + truth[["vx", "vy", "vz"]].to_numpy(float) * camera.exposure
    return truth[["glint_x_px", "glint_y_px"]].to_numpy(float), camera.project(there) - camera.project(here)


@dataclass(frozen=True)
class PositionSums:
    """Sums over the positions of clips, which can be added.

    squares, bound: of the errors of both axes, and of the traces of the bounds' covariances, px^2. glint_squares: of
    the distances from the true glints, px^2; NaN where the truth has none. For each axis, over
    moving balls: waves (2, 3, 3), products of cos, sin and 1 of the sub-pixel phase; errors (2, 3), the errors times
    these, px; moving_squares (2,), the squared errors, px^2.
    """

    n: int
    missed: int
    false: int
    squares: float
    glint_squares: float
    bound: float
    waves: Array
    errors: Array
    moving_squares: Array

    @classmethod
    def none(cls) -> PositionSums:
        """Make the sums of no clip."""
        return cls(0, 0, 0, 0.0, 0.0, 0.0, np.zeros((2, 3, 3)), np.zeros((2, 3)), np.zeros(2))

    @classmethod
    def of(cls, matched: MatchedDetections, cov: Array) -> PositionSums:
        """Make the sums of one clip; cov (n, 2, 2) px^2: the bounds of its pairs."""
        off, true, moving = matched.off, _true(matched.truth)[matched.pairs[:, 0]], matched.moving
        waves, errors, squares = np.zeros((2, 3, 3)), np.zeros((2, 3)), np.zeros(2)
        for axis in (0, 1):
            phase, error = (x[moving[:, axis], axis] for x in (true, off))
            terms = np.stack([np.cos(2 * np.pi * phase), np.sin(2 * np.pi * phase), np.ones_like(phase)])
            waves[axis], errors[axis], squares[axis] = terms @ terms.T, terms @ error, error @ error
        trace = float(np.trace(cov, axis1=1, axis2=2).sum())
        glint_squares = float("nan")
        if "glint_x_px" in matched.truth:
            glints = matched.truth[["glint_x_px", "glint_y_px"]].to_numpy(np.float64)[matched.pairs[:, 0]]
            glint_squares = float(((_xy(matched.found)[matched.pairs[:, 1]] - glints) ** 2).sum())
        sums = float((off**2).sum()), glint_squares, trace
        return cls(len(off), matched.missed, matched.false, *sums, waves, errors, squares)

    def __add__(self, other: PositionSums) -> PositionSums:
        return PositionSums(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))

    def statistics(self) -> dict[str, float]:
        """Compute the localisation scores of score.json.

        rmse_px, bound_px: of x and y.
        phase_bias_px: the first harmonic of the error in the sub-pixel phase of moving balls, for the worse axis. It is
        peak to peak and corrected for noise.
        """
        rmse, bound = (float(np.sqrt(x / (2 * self.n))) if self.n else np.nan for x in (self.squares, self.bound))
        return {
            "n": self.n,
            "missed": self.missed,
            "false": self.false,
            "rmse_px": rmse,
            "bound_px": bound,
            "ratio": rmse / bound if bound else np.nan,
            "phase_bias_px": self._phase_bias(),
        }

    @property
    def are_glints(self) -> bool:
        """Tell whether the positions are those of the glints, and not of the centres."""
        min_positions = 20  # from which on the kind of a position is judged
        return self.n >= min_positions and self.glint_squares < self.squares / 4

    def _phase_bias(self) -> float:
        worst = np.nan
        for waves, errors, squares in zip(self.waves, self.errors, self.moving_squares, strict=True):
            count, mean = waves[2, 2], errors[2] / max(waves[2, 2], 1.0)
            if count < 20:
                continue
            fit = np.linalg.pinv(waves, rcond=1e-12, hermitian=True) @ errors
            # square of the amplitude that noise alone makes, on average
            noise = 4 * (squares / count - mean**2) / count
            worst = np.fmax(worst, 2 * np.sqrt(max(fit[0] ** 2 + fit[1] ** 2 - noise, 0.0)))
        return float(worst)


def score_positions(clips: Iterable[tuple[MatchedDetections, Array]]) -> dict[str, float]:
    """Score the errors of detected positions, given as (matched, bounds), as `PositionSums.statistics` does."""
    return sum((PositionSums.of(*clip) for clip in clips), PositionSums.none()).statistics()


def _true(truth: pd.DataFrame) -> Array:
    return truth[["x_mean_px", "y_mean_px"]].to_numpy(np.float64)


def _xy(found: pd.DataFrame) -> Array:
    return found[["x", "y"]].to_numpy(np.float64)
