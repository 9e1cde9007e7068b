"""An experiment that could be filmed: collisions with launches, a camera, and the errors that positions would have."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from discrepancy.arrays import Array, Ints
from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import T_C
from discrepancy.fitting.base_fit import CLAIMED_NOISE
from discrepancy.fitting.gauss_newton import linearise
from discrepancy.fitting.model_fit import ModelFit, WhitenedClips
from discrepancy.fitting.predict import predict_tracks, predict_velocities
from discrepancy.noise.model import Noise
from discrepancy.planning.position_errors import Errors
from discrepancy.policy import current_policy
from synthcam.model import Model
from tracker.camera.camera import Camera

OUTLINE = np.linspace(0, 2 * np.pi, 16, endpoint=False)
NEVER = np.full(2, np.inf)


@dataclass(frozen=True)
class Experiment:
    """Collisions as a search would fit them.

    Attributes
    ----------
    model : Model
        Of which the tracks are.
    names : tuple of str
        The shared parameters that a search would fit.
    clips : tuple of Measured
        Where each ball is seen, by which errors; all of one camera.
    launches : (clips, p) array
        Columns as in `discrepancy.data.launch`.
    films : tuple of range
        The frames of each clip's film, whether a ball is in view or not.
    errors : Errors
        By which positions would be off.
    noise : Noise
        Of positions, in units of those errors.
    """

    model: Model
    names: tuple[str, ...]
    clips: tuple[MeasuredCollision, ...]
    launches: Array
    films: tuple[range, ...]
    errors: Errors
    noise: Noise = CLAIMED_NOISE

    @property
    def camera(self) -> Camera:
        return self.clips[0].camera

    @property
    def evidence(self) -> WhitenedClips:
        return WhitenedClips.of(self.clips, self.noise)

    def fit(self) -> ModelFit:
        """The fit that tracks without any noise or missing effect would have: with derivatives, nothing left.

        Raises ValueError where the model has no motion for these launches.
        """
        return linearise(self.evidence, self.model, self.names, self.launches)

    @property
    def error_px(self) -> float:
        """Error of a position, rms over all that are seen, each axis, px."""
        squares = np.concatenate([c.claimed_std() ** 2 + (c.offset * (c.resting_offset > 0)) ** 2 for c in self.clips])
        return float(np.sqrt(squares.mean()) / self.camera.scale)

    def through_camera(self, camera: Camera) -> Experiment:
        """Through another camera."""
        return dataclasses.replace(self, clips=tuple(dataclasses.replace(c, camera=camera) for c in self.clips))

    def select(self, rows: Sequence[int]) -> Experiment:
        """Some of its collisions."""
        clips, films = tuple(self.clips[k] for k in rows), tuple(self.films[k] for k in rows)
        return dataclasses.replace(self, clips=clips, films=films, launches=self.launches[list(rows)])

    def observe(self) -> Experiment:
        """The same with rows for every frame in which a ball is whole in the picture, and errors as they are there.

        Collisions of which too little is seen are left out.

        Returns
        -------
        Experiment
            Perhaps of no collision at all.

        Raises
        ------
        ValueError
            Where the model has no motion for these launches.
        """
        blank = [_make_blank_clip(*each) for each in zip(self.clips, self.launches, self.films, strict=True)]
        places, speeds = (f(self.model, self.launches, blank) for f in (predict_tracks, predict_velocities))
        rows = [_rows_in_picture(self.camera, xy) for xy in places]
        seen = [dataclasses.replace(c, xy=xy).select(r) for c, xy, r in zip(blank, places, rows, strict=True)]
        moving = [v[r] for v, r in zip(speeds, rows, strict=True)]
        kept = [k for k, clip in enumerate(seen) if _is_usable(clip)]
        if not kept:
            return dataclasses.replace(self, clips=(), films=(), launches=self.launches[:0])
        clips = _with_errors([seen[k] for k in kept], [moving[k] for k in kept], self.errors)
        films = tuple(self.films[k] for k in kept)
        return dataclasses.replace(self, clips=clips, films=films, launches=self.launches[kept])


def make_unfilmed_clip(number: int, striker: str, camera: Camera, launch: Array) -> MeasuredCollision:
    """A collision of which nothing is seen yet."""
    none = np.zeros(0, dtype=np.int64)
    return MeasuredCollision(number, striker, camera, none, none, np.zeros((0, 2)), np.zeros((0, 2, 2)), launch, NEVER)


def _make_blank_clip(clip: MeasuredCollision, launch: Array, film: range) -> MeasuredCollision:
    frame, ball = np.tile(np.array(film, dtype=np.int64), 2), np.repeat(np.arange(2), len(film))
    new = make_unfilmed_clip(clip.clip, clip.striker, clip.camera, launch)
    nothing = np.zeros((len(frame), 2)), np.zeros((len(frame), 2, 2))
    return dataclasses.replace(new, frame=frame, ball=ball, xy=nothing[0], covariance=nothing[1])


def _rows_in_picture(camera: Camera, xy: Array) -> Ints:
    """Rows (k,) at which the ball's whole outline is in the picture."""
    ring = camera.radius * np.stack([np.cos(OUTLINE), np.sin(OUTLINE)], axis=-1)
    around = xy[:, None] + ring
    pixels = camera.project(np.concatenate([around, np.full((*around.shape[:2], 1), camera.radius)], axis=-1))
    inside = (pixels > -0.5) & (pixels < np.array(camera.size) - 0.5)
    return np.flatnonzero(inside.all(axis=(1, 2)))


def _is_usable(clip: MeasuredCollision) -> bool:
    """Whether both balls are seen long enough before the contact, and after it."""
    opens = clip.frame / clip.fps
    early, late = opens + clip.exposure <= clip.launch[T_C], opens >= clip.launch[T_C]
    least = current_policy().min_frames_before_contact
    return all(np.sum(part & (clip.ball == ball)) >= least for part in (early, late) for ball in (0, 1))


def _with_errors(
    clips: Sequence[MeasuredCollision], speeds: Sequence[Array], errors: Errors
) -> tuple[MeasuredCollision, ...]:
    """The clips with claimed covariances; speeds (n, 2) m/s of each."""
    camera = clips[0].camera
    xy, velocity = np.concatenate([c.xy for c in clips]), np.concatenate(list(speeds))
    level = np.full((len(xy), 1), camera.radius)
    here, there = (camera.project(np.concatenate([x, level], axis=1)) for x in (xy, xy + velocity * camera.exposure))
    _, slope = camera.unproject(here)
    glints = camera.glint_of_centre(xy) if camera.lamp is not None else here
    whole, fixed = (slope @ c @ np.swapaxes(slope, 1, 2) for c in errors.covariances(camera, glints, there - here))
    out, ends = [], np.cumsum([len(c.frame) for c in clips])
    for clip, rows in zip(clips, np.split(np.arange(len(xy)), ends[:-1]), strict=True):
        covariance, steady = whole[rows], fixed[rows]
        resting = (clip.phases() == 0) & (clip.ball == 0)
        covariance[resting] -= steady[resting]
        offset = float(np.sqrt(np.trace(steady[resting], axis1=1, axis2=2).mean() / 2)) if resting.any() else 0.0
        out.append(dataclasses.replace(clip, covariance=covariance, offset=offset))
    return tuple(out)
