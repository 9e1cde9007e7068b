"""Tracks in metres: where each ball was, when, and how well that is known."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam_shared.arrays import Array, Flags, Ints
from tracker.camera.camera import Camera
from tracker.detection.glints import SHADED_POSITION_ERROR_RADII, PositionFlag
from tracker.detection.link import Tracks
from tracker.measurement.noise.position_noise import ScatterRatio, measure_scatter
from tracker.measurement.noise.whitening import PositionWhitener


@dataclass(frozen=True, eq=False)
class BallTrack:
    """One ball's positions on the plate, by frame."""

    particle: int
    frame: Ints  # (n,)
    start: Array  # (n,) s, of the exposures
    position: Array  # (n, 2) m, mean over the exposure
    cov: Array  # (n, 2, 2) m^2
    exposure: float  # s
    fixed: Array = field(default_factory=lambda: np.empty(0))  # the part of `cov` that a resting ball always has
    width: float = 0.0  # of a glint, m
    # a shift in `fixed` that lasts as a ball moves on: its rms along either axis, and the way over which it lasts, m.
    # It occurs for balls that lie partly in their own shadow, and in video encoded with loss.
    drift: tuple[float, float] = (0.0, 0.0)
    warp: tuple[float, float] = (0.0, 0.0)  # the same of the camera's warp, whose size no scatter of the tracks shows
    has_errors: bool = True  # whether the table of tracks claims errors
    noise_dof: float = np.inf  # of the tracks' own scatter, if it gave the errors their size; inf: they are as claimed
    error_scale: float = 1.0  # that size over the claimed one
    rho: float = 0.0  # correlation of the errors from one frame to the next, beyond `fixed`
    encoded: bool = False  # whether the film was encoded with loss
    outlined: bool = False  # whether these are centres of outlines of matte balls
    from_glint: bool = False  # whether these are centres that were found from glints

    def __post_init__(self) -> None:
        if len(self.fixed) == 0:
            object.__setattr__(self, "fixed", np.zeros_like(self.cov))

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def time(self) -> Array:
        """(n,) s, middle of each exposure."""
        return self.start + self.exposure / 2

    @property
    def variance(self) -> Array:
        """(n,) m^2, of a coordinate, the mean of both."""
        return np.asarray(np.trace(self.cov, axis1=1, axis2=2) / 2)

    @cached_property
    def whiten(self) -> PositionWhitener:
        """By the positions' full covariance."""
        return PositionWhitener(self.position, self.cov, self.fixed, self.width, self.frame, self.rho, self.drifts)

    @property
    def drifts(self) -> tuple[tuple[float, float], ...]:
        """The shifts that last, each with its own way."""
        return tuple(one for one in (self.drift, self.warp) if one[0] > 0)

    def scale_errors(self, size: ScatterRatio) -> BallTrack:
        """The same ball with errors of another size, as its own scatter shows them."""
        factor, kept = float(np.sqrt(size.ratio)), (1 - size.ratio) * self.warp[0] ** 2 * np.eye(2)
        return replace(
            self,
            cov=self.cov * size.ratio + kept,
            fixed=self.fixed * size.ratio + kept,
            drift=(self.drift[0] * factor, self.drift[1]),
            noise_dof=size.dof,
            error_scale=factor * self.error_scale,
        )

    def where(self, rows: Flags) -> BallTrack:
        """The same ball, only those rows."""
        if rows.all():
            return self
        arrays: dict[str, Any] = {name: v[rows] for name, v in vars(self).items() if isinstance(v, np.ndarray)}
        return replace(self, **arrays)


def measure_separation(one: BallTrack, other: BallTrack) -> tuple[Ints, Array, NDArray[Any], NDArray[Any]]:
    """Measure the distance of two balls, m, in all frames that show both: frames, distances, and the rows of either."""
    frames, mine, its = np.intersect1d(one.frame, other.frame, return_indices=True)
    return frames, np.hypot(*(one.position[mine] - other.position[its]).T), mine, its


def to_ball_tracks(tracks: Tracks, camera: Camera, *, unknown_error_px: float = 0.1) -> list[BallTrack]:
    """Convert tracks from pixels to metres on the plate, one BallTrack for each particle in order of its number.

    Rows without a finite position are left out. If not every row has a covariance, all get that of the tracks' own
    scatter about smooth motion. Tracks that are too short to show it get `unknown_error_px` along each axis.
    """
    default_glint_width_px = 1.0  # where the camera file has none
    xy = np.column_stack([tracks.x, tracks.y]).astype(np.float64)
    keep = np.isfinite(xy).all(axis=1)
    xy, frame, particle = xy[keep], np.asarray(tracks.frame)[keep].astype(np.int64), np.asarray(tracks.particle)[keep]
    position, slope = camera.unproject(xy)
    pixel, fixed = (np.asarray(c, dtype=np.float64)[keep] for c in (tracks.cov, tracks.fixed))
    weighed = _have_covariances(pixel)
    if not weighed:
        pixel, fixed = np.broadcast_to(np.eye(2) * unknown_error_px**2, pixel.shape), np.zeros_like(pixel)
    cov, shared = (slope @ c @ np.swapaxes(slope, 1, 2) for c in (pixel, np.nan_to_num(fixed)))
    time = np.asarray(tracks.time, dtype=np.float64)[keep]
    taken = np.where(np.isfinite(time), time, frame / camera.fps)
    start, width = taken + camera.line_time * xy[:, 1], (camera.sigma or default_glint_width_px) * camera.scale
    apart = np.hypot(tracks.x - tracks.glint_x, tracks.y - tracks.glint_y)[keep]  # NaN or 0 where no glint was seen
    word = PositionFlag.SHADED.word
    shaded = np.array([word in words for words in tracks.flags[keep].tolist()], dtype=bool)
    encoded = camera.sensor.codec_noise > 0
    found = []
    for ball in np.unique(particle):
        rows = np.flatnonzero(particle == ball)
        rows = rows[np.unique(frame[rows], return_index=True)[1]]  # in order; a frame given twice counts once
        found.append(
            BallTrack(
                particle=int(ball),
                frame=frame[rows],
                start=start[rows],
                position=position[rows],
                cov=cov[rows],
                exposure=camera.exposure,
                fixed=shared[rows],
                width=width,
                drift=_find_shading_drift(cov[rows], camera) if shaded[rows].any() else (0.0, 0.0),
                has_errors=weighed,
                noise_dof=np.inf if weighed else 0.0,
                encoded=encoded,
                outlined=camera.matte,
                from_glint=bool((apart[rows] > 0).any()),
            )
        )
    if weighed and encoded:
        found = _with_codec_noise(found, camera)
    free = measure_scatter(found, camera.ball_diameter) if not weighed else None
    if not weighed and (size := free or measure_scatter(found)) is not None:  # kinks make errors rather too large
        found = [track.scale_errors(size) for track in found]
    if (warp := camera.warp) is None or not warp.std:
        return found
    own = warp.std**2 * np.eye(2)  # of an error that lasts while a ball moves on
    return [replace(b, cov=b.cov + own, fixed=b.fixed + own, warp=(warp.std, warp.length)) for b in found]


def _have_covariances(pixel: Array) -> bool:
    """True if all of some matrices (n, 2, 2) are covariances, and there is one."""
    determinant = pixel[:, 0, 0] * pixel[:, 1, 1] - pixel[:, 0, 1] * pixel[:, 1, 0]
    return len(pixel) > 0 and bool(np.all((determinant > 0) & (pixel[:, 0, 0] > 0)))  # NaN is not


def _find_shading_drift(cov: Array, camera: Camera) -> tuple[float, float]:
    """The error that lasts while a shaded ball moves on, and the way over which it lasts, m.

    Each position keeps a share of its variance: the ball may look smaller than it is.
    """
    shadow = SHADED_POSITION_ERROR_RADII * camera.ball_diameter / 2
    most = np.sqrt((1 - 1e-3) * float(np.linalg.eigvalsh(cov)[:, 0].min()))
    return min(shadow, float(most)), camera.ball_diameter


def _with_codec_noise(balls: list[BallTrack], camera: Camera) -> list[BallTrack]:
    """Add the part of an encoder's errors that persists while a ball moves on to its fixed errors.

    H.264 moves what it shows by quarters of a pixel from frame to frame. Errors persist where a ball's speed along an
    axis comes near a multiple of that, and the fitted motion then absorbs them.
    """
    # Share of the variance that persists, of positions with errors of `at_px`; it grows with their square. With this
    # share z is 1 in 600 clips of two seeds, at crf 18, 23 and 28 (errors of .063, .078 and .105 px).
    share, at_px, max_share = 0.25, 0.075, 0.45
    length_px = 250.0  # distance over which the errors persist
    size, every = measure_scatter(balls, camera.ball_diameter), [track.variance for track in balls]
    off = float(np.median(np.concatenate(every))) * (size.ratio if size else 1.0) / camera.scale**2 if balls else 0.0
    persistent, out = min(share * off / at_px**2, max_share), []
    for track, variances in zip(balls, every, strict=True):
        own = persistent * float(np.median(variances))
        drift, shift = (float(np.sqrt(own)), length_px * camera.scale), own * np.eye(2)
        wider = replace(track, cov=track.cov + shift, fixed=track.fixed + shift, drift=drift)
        out.append(track if track.drift[0] else wider)
    return out
