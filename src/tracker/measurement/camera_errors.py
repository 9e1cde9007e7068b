"""Systematic errors of the camera file (scale, frame rate, ball diameter, view, lamp, warp) in all that is measured.

Each moves all estimates of all clips of one camera together. `add_camera_errors` finds by how much, from the linear
response of a fit, and widens the covariance of the estimates. `shared_effects` gives a fit of many clips the part that
does not average out.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from synthcam_shared.arrays import Array
from tracker.camera.camera import Camera, LampSettings
from tracker.camera.views import perturb_view, scale_at
from tracker.camera.warp import Warp
from tracker.measurement.collision.collision_fit import CollisionFits
from tracker.measurement.collision.collision_model import GRAVITY, TIED, compute_unit_vectors
from tracker.measurement.collision.departures import derive_values
from tracker.measurement.collision.derived import QUANTITY_NAMES, DerivedValues, derive_from_free
from tracker.measurement.collision.hidden_duration import (
    compute_steel_duration,
    estimate_hidden_duration,
    measure_closing_speed,
    measure_hidden_duration,
)
from tracker.measurement.collision.lasting_fit import LastingFit
from tracker.measurement.collision.lasting_motion import LastingResiduals
from tracker.measurement.collision.least_squares import BallPair, CollisionFit, WhitenedResiduals
from tracker.measurement.positions import BallTrack

DERIVATIVE_STEP = 1e-3  # of a standard error, for derivatives: t_c must not leave the exposure in which it lies


@dataclass(frozen=True)
class CameraError:
    """The standard error of a key of the camera file, and what changes with that key.

    Each method returns a quantity as it would be with the key larger by `by` of its standard errors.
    """

    key: str
    value: float  # in the file
    share: float  # the standard error over the value

    def move_track(self, track: BallTrack, by: float, fps: float) -> BallTrack:
        """A ball's positions and times."""
        if self.key == "scale":
            return replace(track, position=track.position * (1 + by * self.share))
        if self.key == "fps":
            return replace(track, start=track.start - track.frame / fps * by * self.share)
        return track

    def diameter(self, diameter: float, by: float) -> float:
        """The balls' diameter."""
        return diameter * (1 + by * self.share) if self.key == "ball_diameter" else diameter

    def rate(self, fps: float, by: float) -> float:
        """The frame rate."""
        return fps * (1 + by * self.share) if self.key == "fps" else fps

    def pair(self, pair: BallPair, by: float, fps: float) -> BallPair:
        """Both balls of a pair, and their diameter."""
        struck, striker = (self.move_track(track, by, fps) for _, track in pair.balls)
        return replace(pair, struck=struck, striker=striker, diameter=self.diameter(pair.diameter, by))


@dataclass(frozen=True)
class ViewError(CameraError):
    """One of the independent errors of the camera's view; `share` is its effect on the scale."""

    camera: Camera
    change: Array

    @staticmethod
    def of(camera: Camera, number: int) -> ViewError:
        """The error of that number in the camera file."""
        change = camera.view_errors[number]
        share = (scale_at(perturb_view(camera, DERIVATIVE_STEP * change)) / scale_at(camera) - 1) / DERIVATIVE_STEP
        return ViewError(f"view_errors[{number}]", float(camera.K[0, 0]), share, camera, change)

    def move_track(self, track: BallTrack, by: float, fps: float) -> BallTrack:
        """A ball's positions, as the other view projects the same pixels to the plate."""
        height = self.camera.centre_height
        middle = np.column_stack([track.position, np.full(len(track), height)])
        position, _ = perturb_view(self.camera, by * self.change).unproject(self.camera.project(middle), height)
        return replace(track, position=position)


@dataclass(frozen=True)
class LampError(CameraError):
    """The error of a coordinate of the lamp, which converts glints to centres; `share` is its effect on the scale."""

    camera: Camera
    step: Array

    @staticmethod
    def of(camera: Camera, lamp: LampSettings, axis: int) -> LampError:
        """The error of coordinate `axis`."""
        key, step = f"lamp.position[{axis}]", lamp.position_std[axis] * np.eye(3)[axis]
        error, side = LampError(key, lamp.position[axis], 0.0, camera, step), camera.scale * min(camera.size) / 2
        corners = camera.unproject((np.array(camera.size) - 1) / 2)[0] + side * np.array([[0.0, 0], [1, 0], [0, 1]])
        other = error.centres(corners, DERIVATIVE_STEP)
        larger = float(np.sqrt(abs(np.linalg.det(other[1:] - other[0])))) / side
        return replace(error, share=(larger - 1) / DERIVATIVE_STEP)

    def centres(self, given: Array, by: float) -> Array:
        """Balls (n, 2) whose glints by the other lamp lie at those of balls at `given` by the given lamp."""
        lamp = self.camera.lamp
        assert lamp is not None
        x, y, z = np.array(lamp.position) + by * self.step
        other = replace(self.camera, lamp=replace(lamp, position=(x, y, z)))
        return other.ball_of_glint(self.camera.glint_of_centre(given))[..., :2]

    def move_track(self, track: BallTrack, by: float, fps: float) -> BallTrack:
        """A ball's positions, if they were found from its glints."""
        return replace(track, position=self.centres(track.position, by)) if track.from_glint else track


@dataclass(frozen=True)
class WarpError(CameraError):
    """One of the independent errors of the camera's warp; `value` is its rms at the knots, m."""

    map: Warp

    @staticmethod
    def of(warp: Warp, number: int) -> WarpError:
        """The error of that number in the camera file."""
        rms = float(np.sqrt(np.mean(warp.errors[number] ** 2)))
        return WarpError(f"warp.errors[{number}]", rms, 0.0, warp.error_maps[number])

    def shift(self, position: Array) -> Array:
        """Displacements (n, 2) of positions by one standard error, m."""
        return self.map.displace(position)[0]

    def move_track(self, track: BallTrack, by: float, fps: float) -> BallTrack:
        """A ball's positions, displaced."""
        return replace(track, position=track.position + by * self.shift(track.position))


def camera_errors(camera: Camera) -> tuple[CameraError, ...]:
    """The standard errors that the camera file gives."""
    keys = ("scale", "fps", "ball_diameter")
    given = [(key, getattr(camera, key), getattr(camera, f"{key}_std")) for key in keys]
    known = [CameraError(key, value, std / value) for key, value, std in given if std > 0]
    views = (ViewError.of(camera, number) for number in range(len(camera.view_errors)))
    lamp = camera.lamp if camera.corrects_glint and not camera.matte else None
    lamps = (LampError.of(camera, lamp, axis) for axis in range(3) if lamp.position_std[axis]) if lamp else ()
    warp = camera.warp
    warps = (WarpError.of(warp, number) for number in range(len(warp.errors))) if warp else ()
    return (*known, *views, *lamps, *warps)


def add_camera_errors(fit: CollisionFit, values: DerivedValues, camera: Camera) -> tuple[CollisionFit, DerivedValues]:
    """Add the errors of the camera file to a tied or free fit and its quantities.

    The parameters keep their values: the errors of the camera are not estimated. The new chi^2 is that by a covariance
    of the positions to which the camera's errors are added. The covariance of the quantities holds the camera's errors,
    and their `shared` is the effect of each.
    """
    errors, diameter = camera_errors(camera), fit.pair.diameter
    if not errors:
        return fit, values
    shift, _, explained = _shift_fit(fit, errors, camera)

    def changed(error: CameraError, by: float) -> Array:
        at = fit.parameters + by * shift[:, errors.index(error)]
        return derive_values(fit, at, error.diameter(diameter, by), shift)

    if not fit.is_tied:  # the values of both balls are averaged with other weights
        values = derive_from_free(fit.parameters, fit.cov, diameter, shift)
    return replace(fit, chi2=fit.chi2 - explained), values.with_shared(differentiate_by_camera(errors, changed))


def add_camera_errors_to_lasting(read: CollisionFits, camera: Camera) -> CollisionFits:
    """Add the errors of the camera file to the fits of a contact that lasts, as `add_camera_errors` does to others."""
    errors, fits = camera_errors(camera), read.fits
    if not errors or fits is None:
        return read
    changed: dict[str, Any] = {}
    for name in ("tied", "free"):
        fit: LastingFit = getattr(fits, name)
        residual, rows = fit.problem(fit.x)

        def moved(error: CameraError, by: float, fit: LastingFit = fit) -> Array:
            return LastingResiduals(error.pair(fits.pair, by, camera.fps), fit.problem.kind).residual(fit.x)

        shift, _, explained = linear_response(residual, rows, fit.cov, differentiate_by_camera(errors, moved))

        def values(error: CameraError, by: float, fit: LastingFit = fit, shift: Array = shift) -> Array:
            problem = LastingResiduals(error.pair(fits.pair, by, camera.fps), fit.problem.kind)
            moved = replace(fit, problem=problem, x=fit.x + by * shift[:, errors.index(error)])
            return np.append(moved.values.value, moved.times(moved.x).sum())

        response = differentiate_by_camera(errors, values)
        changed[name] = replace(getattr(read, name), chi2=fit.chi2 - explained)
        changed[f"{name}_values"] = getattr(read, f"{name}_values").with_shared(np.nan_to_num(response[:-1]))
    if fits.contact is not None:
        std = float(np.hypot(fits.contact.duration_std, np.linalg.norm(response[-1])))
        changed["fits"] = replace(fits, contact=replace(fits.contact, duration_std=std))
    return replace(read, **changed)


def add_contact_errors(
    fit: CollisionFit, values: DerivedValues, camera: Camera, distance: tuple[float, float]
) -> DerivedValues:
    """Add errors to a fit of an impact for a contact that is too short to be seen.

    distance: of the centres at the contact, as `measure_contact_distance` gives it. A contact that lasts lets the paths
    cross within one diameter, and plate friction presses the balls together in the meantime.
    """
    measured, std = measure_hidden_duration(fit.pair.diameter, values, distance)
    if not (np.isfinite(measured) and std > 0):
        return values
    closing = measure_closing_speed(values)
    lasts = estimate_hidden_duration(measured, std, compute_steel_duration(fit.pair.diameter, closing))
    nearer = lasts / std * distance[1] * fit.pair.diameter  # m, by which the paths cross within one diameter
    unit = CameraError("ball_diameter", camera.ball_diameter, -nearer / fit.pair.diameter)
    shift = _shift_fit(fit, [unit], camera)[0][:, 0]

    def changed(_: CameraError, by: float) -> Array:
        return derive_values(fit, fit.parameters + by * shift, fit.pair.diameter)

    effect = np.nan_to_num(differentiate_by_camera([unit], changed)[:, 0])
    friction = float(np.nan_to_num(values.value[QUANTITY_NAMES.index("mu_k")]))
    pressed = 2 * min(max(friction, 0.0), 1.0) * GRAVITY * lasts
    effect[QUANTITY_NAMES.index("r")] -= pressed / closing
    return replace(values, cov=values.cov + np.outer(effect, effect))


def measure_contact_distance(fit: CollisionFit, camera: Camera) -> tuple[float, float]:
    """Measure how wrong the camera file's scale or diameter may be: the distance at the contact, by a fit.

    The fit assumes that they touch at one diameter. Returns the distance in diameters, and its standard error with
    those of scale and diameter.
    """
    unit = CameraError("ball_diameter", camera.ball_diameter, 0.01)
    pull = _shift_fit(fit, [unit], camera)[1][:, 0]
    square, along = max(float(pull @ pull), 1e-300), float(pull @ fit.linearised[1])
    off, worse = -along / square, (fit.chi2 - along**2 / square) / max(fit.dof, 1)
    glints = fit.pair.striker.from_glint
    errors = (error for error in camera_errors(camera) if glints or not isinstance(error, LampError))
    known = [error.share for error in errors if error.key != "fps"]
    return 1 + off * unit.share, float(np.linalg.norm([unit.share * np.sqrt(max(worse, 1.0) / square), *known]))


def _shift_fit(fit: CollisionFit, errors: Sequence[CameraError], camera: Camera) -> tuple[Array, Array, float]:
    """The `linear_response` of all parameters of a fit to errors of the camera."""
    problem, residual, rows, cov = fit.linearised
    shift, left, explained = linear_response(residual, rows, cov, differentiate_residuals(fit, errors, camera))
    every = np.zeros((problem.size, len(errors)))
    every[problem.index] = shift
    return every, left, explained


def differentiate_residuals(fit: CollisionFit, errors: Sequence[CameraError], camera: Camera) -> Array:
    """Differentiate the whitened residuals of a fit by the errors of the camera file, per standard error: (m, k)."""

    def moved(error: CameraError, by: float) -> Array:
        problem = WhitenedResiduals(error.pair(fit.pair, by, camera.fps), fit.is_tied)
        return problem.residual(fit.parameters[problem.index])

    return np.column_stack(
        [
            _differentiate_by_diameter(fit, error)
            if error.key == "ball_diameter"
            else differentiate_by_camera([error], moved)[:, 0]
            for error in errors
        ]
    )


def _differentiate_by_diameter(fit: CollisionFit, error: CameraError) -> Array:
    """Differentiate the residuals (m,) by the diameter: ball 2 stands off ball 1 by it, along the line of centres."""
    problem = fit.linearised[0]
    _, normal, _ = compute_unit_vectors(fit.parameters[TIED.index("heading")], fit.parameters[TIED.index("beta")])
    shift = np.outer(problem.ball == 2, -error.share * fit.pair.diameter * normal)
    return np.concatenate([problem.whiten(shift[None])[0], np.zeros(len(problem.index))])


def differentiate_by_camera(errors: Sequence[CameraError], function: Callable[[CameraError, float], Array]) -> Array:
    """Differentiate m values by each of k keys of the camera, per standard error: (m, k).

    function(error, by) gives the m values for a key that is larger by `by` of its standard errors.
    """
    return np.array(
        [(function(e, DERIVATIVE_STEP) - function(e, -DERIVATIVE_STEP)) / (2 * DERIVATIVE_STEP) for e in errors]
    ).T


def linear_response(residual: Array, rows: Array, cov: Array, by: Array) -> tuple[Array, Array, float]:
    """Compute how errors of the camera file, as disturbances of size 1, shift a least-squares fit to first order.

    residual (m,), rows (m, p), cov (p, p): at the minimum, with the derivatives by the parameters, and the parameters'
    covariance. by (m, k): derivative of the residuals by the disturbances.

    Returns the derivative (p, k) of the parameters by the disturbances; what the shifted parameters leave (m, k) of
    these; and the reduction of chi^2 when the disturbances are part of the covariance of the residuals.
    """
    shift = -cov @ rows.T @ by
    left = by + rows @ shift
    pull = left.T @ residual
    return shift, left, float(pull @ np.linalg.solve(np.eye(by.shape[1]) + left.T @ left, pull))


def effects_to_json(camera: Camera, blocks: dict[str, Array]) -> dict[str, Any]:
    """Write the effects of camera errors as the entry "shared" of `cov` in estimates.parquet; see docs/format.md.

    blocks: by fit, the effect of one standard error of each of the camera's k keys on its n quantities, (n, k).
    """
    return {
        error.key: {"of": error.value}
        | {fit: [float(v) if np.isfinite(v) else None for v in block[:, k]] for fit, block in blocks.items()}
        for k, error in enumerate(camera_errors(camera))
    }


def shared_effects(rows: pd.DataFrame, names: Sequence[str], *fits: str) -> Array:
    """Collect the effects of camera errors that several rows of estimates.parquet share: (rows, names, errors).

    They are per standard error, and 0 in rows that do not have that error. Rows share an error where the file's value
    is the same to the last digit. The fit that a column `fit` names, else the first of `fits` that is in a row's `cov`,
    gives its effects. Local estimates also share the bias and the mass ratio of their set.
    """
    found: dict[tuple[str, float], dict[int, Array]] = {}
    columns = (rows.get(name, [""] * len(rows)) for name in ("cov", "local_shared", "fit"))
    for i, (cov, local, fit) in enumerate(zip(*columns, strict=True)):
        given = json.loads(local) if fit == "local" and isinstance(local, str) and local else {}
        own = ((key, block["of"], block["effect"]) for key, block in given.items())
        for key, of, by_name in own if fit == "local" else _list_shared(cov, (fit, *fits)):
            effect = np.array([by_name.get(name, 0.0) for name in names], dtype=np.float64)
            found.setdefault((key, of), {})[i] = np.nan_to_num(effect)
    several = [effects for effects in found.values() if len(effects) > 1]
    out = np.zeros((len(rows), len(names), len(several)))
    for k, effects in enumerate(several):
        out[list(effects), :, k] = list(effects.values())
    return out


def _list_shared(cov: Any, fits: Sequence[str]) -> Iterator[tuple[str, float, dict[str, float | None]]]:
    """Iterate over the errors in `cov`: key, its value, and effects by quantity, for the first of these fits."""
    if not isinstance(cov, str) or '"shared"' not in cov:
        return
    table = json.loads(cov)
    for key, block in table["shared"].items():
        effects = next((block[one] for one in fits if one in block), None)
        if effects is not None:
            yield key, block["of"], dict(zip(table["names"], effects, strict=True))


def covariance_of_shared(effects: Array) -> Array:
    """Convert effects of camera errors (..., names, errors) to the covariance (..., names, names) that clips share."""
    part = effects @ np.swapaxes(effects, -1, -2)
    # an effect is known to 3 %: clips must not determine the error of the camera from less
    return np.asarray(part * (1 - 0.03**2 * np.eye(part.shape[-1])))


def remove_shared(std: Array, effects: Array) -> Array:
    """Remove from standard errors (n,) of one quantity the effects of camera errors that several rows share."""
    least = float(np.finfo(float).tiny)
    return np.asarray(np.sqrt(np.maximum(std**2 - covariance_of_shared(effects)[:, 0, 0], least)))
