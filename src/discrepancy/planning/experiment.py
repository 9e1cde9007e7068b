"""A planned experiment: its collisions, its camera, the errors that positions would have; and that of a scene."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import T_C, equalise_launches
from discrepancy.data.study_design import split_held_out
from discrepancy.fitting.base_fit import CLAIMED_NOISE
from discrepancy.fitting.jacobian import linearise
from discrepancy.fitting.model_fit import ModelFit, WhitenedClips
from discrepancy.fitting.parameters import list_names_to_fit
from discrepancy.fitting.predict import predict_tracks, predict_velocities
from discrepancy.noise.model import Noise
from discrepancy.policy import current_policy
from synthcam.dynamics.launch import SPIN_COLUMNS
from synthcam.model import Model
from synthcam.scene.clip import Clip
from synthcam.scene.scene import Scene
from synthcam_shared.arguments import name_arguments
from synthcam_shared.arrays import Array, Ints
from synthcam_shared.errors import InputError
from tracker.camera.camera import Camera
from tracker.camera.views import find_first_difference
from tracker.detection.likelihood.cramer_rao import compute_glint_shape, localisation_bound, localisation_bound_fixed


@dataclass(frozen=True)
class StatedErrors:
    """Errors that the user states: white, and the same everywhere. std: each axis, px."""

    std: float

    def covariances(self, camera: Camera, glints: Array, blur: Array) -> tuple[Array, Array]:
        """Covariances as `PredictedGlintErrors` returns them; no part is the same in all frames."""
        return np.tile(self.std**2 * np.eye(2), (len(glints), 1, 1)), np.zeros((len(glints), 2, 2))

    def brighter(self, times: float) -> None:
        """None: the effect of more light on stated errors is unknown."""
        return


@dataclass(frozen=True)
class PredictedGlintErrors:
    """Errors of glints, predicted from the light that reaches the sensor."""

    peak: float  # counts above black at the peak of a resting ball's glint, before clipping
    room: float = 0.0  # light of the room that a ball reflects, over that peak

    def covariances(self, camera: Camera, glints: Array, blur: Array) -> tuple[Array, Array]:
        """Predict the covariances (n, 2, 2) of positions, px^2, and the part that is the same in every frame of a ball
        at rest.

        glints, blur: (n, 2), positions of the glints and their motion in an exposure, px.

        The bound is `tracker.detection.likelihood.cramer_rao.localisation_bound`: position, flux and background free,
        the sensor's noise by EMVA 1288, with clipping. `make bench-localisation` compares the tracker with it.
        """
        if camera.sigma is None:
            raise ValueError("the bound needs psf.sigma_px")
        half = int(np.ceil(4 * camera.sigma))  # px; the window holds all light of a glint
        share = float(compute_glint_shape(np.zeros((1, 2)), np.zeros((1, 2)), camera.sigma, half).value.max())
        flux = np.full(len(glints), self.peak / share)
        ground = camera.sensor.black_level + self.room * self.peak
        return localisation_bound(camera, flux, glints, blur, ground), localisation_bound_fixed(camera, flux, glints)

    def brighter(self, times: float) -> PredictedGlintErrors:
        """The errors with so many times as much light."""
        return dataclasses.replace(self, peak=times * self.peak)


Errors = StatedErrors | PredictedGlintErrors


@dataclass(frozen=True)
class PlannedExperiment:
    """Collisions as a search would fit them."""

    model: Model  # makes the tracks
    names: tuple[str, ...]  # the shared parameters that a search would fit
    clips: tuple[MeasuredCollision, ...]  # the visible positions and their errors; all of one camera
    launches: Array  # (clips, p), columns as in `discrepancy.data.launch`
    films: tuple[range, ...]  # the frames of each clip's film, with or without a ball in view
    errors: Errors  # that positions would have
    noise: Noise = CLAIMED_NOISE  # of positions, in units of those errors

    @property
    def camera(self) -> Camera:
        return self.clips[0].camera

    @property
    def evidence(self) -> WhitenedClips:
        return WhitenedClips.of(self.clips, self.noise)

    def fit(self) -> ModelFit:
        """The fit to tracks without noise or missing effect. Raises ValueError if the model has no motion for them."""
        return linearise(self.evidence, self.model, self.names, self.launches)

    @property
    def error_px(self) -> float:
        """The rms error of a position, each axis, px."""
        squares = np.concatenate([c.claimed_std() ** 2 + (c.offset * (c.resting_offset > 0)) ** 2 for c in self.clips])
        return float(np.sqrt(squares.mean()) / self.camera.scale)

    def through_camera(self, camera: Camera) -> PlannedExperiment:
        """The same collisions through another camera."""
        return dataclasses.replace(self, clips=tuple(dataclasses.replace(c, camera=camera) for c in self.clips))

    def select(self, rows: Sequence[int]) -> PlannedExperiment:
        """Select some of its collisions."""
        clips, films = tuple(self.clips[k] for k in rows), tuple(self.films[k] for k in rows)
        return dataclasses.replace(self, clips=clips, films=films, launches=self.launches[list(rows)])

    def thin_out(self) -> PlannedExperiment:
        """Select at most 24 collisions, evenly, to change and compare: more would not change a cosine."""
        count = len(self.clips)
        return self.select(np.unique(np.linspace(0, count - 1, min(24, count)).astype(int)).tolist())

    def observe(self) -> PlannedExperiment:
        """Predict the positions in every frame that shows a whole ball, with their errors there.

        Collisions with too few frames before or after the contact are left out; none may be left. Raises ValueError if
        the model has no motion for these launches.
        """
        blank = [
            make_unmeasured_clip(c.clip, c.striker, c.camera, launch, film)
            for c, launch, film in zip(self.clips, self.launches, self.films, strict=True)
        ]
        places, speeds = (f(self.model, self.launches, blank) for f in (predict_tracks, predict_velocities))
        rows = [_rows_in_picture(self.camera, xy) for xy in places]
        seen = [dataclasses.replace(c, xy=xy).select(r) for c, xy, r in zip(blank, places, rows, strict=True)]
        moving = [v[r] for v, r in zip(speeds, rows, strict=True)]
        kept = [k for k, clip in enumerate(seen) if _is_usable(clip)]
        clips = _with_errors([seen[k] for k in kept], [moving[k] for k in kept], self.errors) if kept else ()
        return dataclasses.replace(self.select(kept), clips=clips)


def make_unmeasured_clip(number: int, striker: str, camera: Camera, launch: Array, film: range) -> MeasuredCollision:
    """Make a collision of a planned experiment: both balls in all frames of its film, no position measured yet."""
    frame, ball = np.tile(np.array(film, dtype=np.int64), 2), np.repeat(np.arange(2), len(film))
    xy, covariance = np.zeros((len(frame), 2)), np.zeros((len(frame), 2, 2))
    return MeasuredCollision(number, striker, camera, frame, ball, xy, covariance, launch, np.full(2, np.inf))


def _rows_in_picture(camera: Camera, xy: Array) -> Ints:
    """Rows (k,) in which the whole outline of the ball, at 16 points, is in the picture."""
    angle = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    ring = camera.radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    around = xy[:, None] + ring
    pixels = camera.project(np.concatenate([around, np.full((*around.shape[:2], 1), camera.radius)], axis=-1))
    inside = (pixels > -0.5) & (pixels < np.array(camera.size) - 0.5)
    return np.flatnonzero(inside.all(axis=(1, 2)))


def _is_usable(clip: MeasuredCollision) -> bool:
    """True if both balls have enough frames before the contact, and after it."""
    opens = clip.frame / clip.fps
    early, late = opens + clip.exposure <= clip.launch[T_C], opens >= clip.launch[T_C]
    least = current_policy().min_frames_before_contact
    return all(np.sum(part & (clip.ball == ball)) >= least for part in (early, late) for ball in (0, 1))


def _with_errors(
    clips: Sequence[MeasuredCollision], speeds: Sequence[Array], errors: Errors
) -> tuple[MeasuredCollision, ...]:
    """Set the covariances of the clips. speeds: velocities (n, 2), m/s, of each."""
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


@dataclass(frozen=True)
class SceneExperiment:
    """The experiment of a scene."""

    experiment: PlannedExperiment  # the collisions that a search would fit; it holds out a quarter of them
    drawn: int  # collisions that were drawn
    usable: int  # collisions with enough frames in view
    notes: tuple[str, ...]  # influences that the errors do not include


def design_experiment(scene: Scene, count: int, noise_px: float | None = None, seed: int = 0) -> SceneExperiment:
    """Draw the collisions of a scene and predict what its camera would see of them.

    count: collisions to record.
    noise_px: error of a position, each axis; default: the limit of the scene's camera and lamp.
    seed: of all random numbers.

    Raises InputError if no search is possible with such clips.
    """
    least = current_policy().min_collisions
    if count < least:
        raise InputError(f"clips: expected {least} or more, to fit some and hold out others; found {count}")
    if noise_px is not None and not 0 < noise_px < np.inf:
        raise InputError(f"noise: expected an error of positions over 0 px, found {noise_px:g}")
    clips = [scene.draw(number, seed) for number in range(count)]
    for clip in clips:
        if (kind := clip.drawn["launch"]["kind"]) != "pair":
            raise InputError(f"{scene.where}: launch.kind: expected pair, found {kind}: no collision")
    model, camera = _shared_model_and_camera(scene, clips)
    launches = equalise_launches([_launch(c) for c in clips])
    whole = PlannedExperiment(
        model=model,
        names=list_names_to_fit(model),
        clips=tuple(
            make_unmeasured_clip(k, str(c.drawn["launch"]["striker"]), camera, launches[k], range(c.frames))
            for k, c in enumerate(clips)
        ),
        launches=np.array(launches),
        films=tuple(range(c.frames) for c in clips),
        errors=_errors(clips[0], noise_px, scene.where),
    )
    try:
        filmed = whole.observe()
    except ValueError as e:
        raise InputError(f"{scene.where}: the model has no motion for these launches: {e}") from None
    usable = len(filmed.clips)
    if usable < least:
        raise InputError(
            f"{scene.where}: both balls are in view before and after the contact in {usable} of {count} clips; "
            f"expected {least} or more"
        )
    kept = {c.clip for c in split_held_out(filmed.clips)[0]}
    rest = filmed.select([k for k, c in enumerate(filmed.clips) if c.clip in kept])
    notes: tuple[str, ...] = ()
    if noise_px is None and clips[0].drawn.get("video"):
        text = "the errors do not include the video encoder's loss; --noise PX sets the error of a position instead"
        notes = (name_arguments(text),)
    return SceneExperiment(experiment=rest, drawn=count, usable=usable, notes=notes)


def _shared_model_and_camera(scene: Scene, clips: list[Clip]) -> tuple[Model, Camera]:
    """The model and the camera that all clips share. Raises InputError if they differ."""
    first = clips[0]
    camera = Camera.from_dict(first.camera_json, scene.where)
    for clip in clips[1:]:
        if clip.model != first.model:
            raise InputError(
                f"{scene.where}: ball, model or effects differ from clip to clip, but a search fits one model to all; "
                "expected numbers, as by --model MODEL.yaml"
            )
        if key := find_first_difference(Camera.from_dict(clip.camera_json, scene.where), camera):
            raise InputError(f"{scene.where}: the camera's {key} differs from clip to clip; expected one camera")
    free = tuple(scene.settings.get("free") or ())
    return dataclasses.replace(first.model, free=free), camera


def _launch(clip: Clip) -> Array:
    """The columns of `discrepancy.data.launch`, (p,)."""
    radius, (target, striker) = clip.launch.bodies.radius, clip.launch.states[:, :2]
    share = radius[0] / radius.sum()  # of the distance between the centres, from the target
    drawn = clip.drawn["launch"]
    place = target + share * (striker - target)
    spin = [drawn[name] for name in SPIN_COLUMNS]
    return np.array([*place, clip.launch.time, drawn["v0"], drawn["heading"], drawn["b"], *spin])


def _errors(clip: Clip, noise_px: float | None, where: str) -> Errors:
    if noise_px is not None:
        return StatedErrors(noise_px)
    if clip.finish is not None:
        raise InputError(
            f"{where}: surface: the errors of balls under room light cannot be predicted; give them (--noise PX)"
        )
    return PredictedGlintErrors(clip.sensor.glint_peak, clip.room)
