"""A camera file from known points of the plate: perspective and lens of the camera's view."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.special import chdtrc

from synthcam_shared.arrays import Array
from synthcam_shared.errors import InputError
from tracker.calibration.plate_points import MIN_POINTS, PlatePoints, find_board, read_picture_size, read_points
from tracker.camera.camera import Camera
from tracker.camera.camera_keys import VIEW_ERROR_COUNT
from tracker.camera.lens import distort
from tracker.camera.views import perturb_view, scale_at


@dataclass(frozen=True)
class PlateView:
    """K, dist, R, t as camera.json has them, with `errors` (n, 11), its view_errors; residuals (n, 2), px."""

    K: Array
    dist: Array
    R: Array
    t: Array
    errors: Array
    residuals: Array
    lens: int

    def to_dict(self) -> dict[str, Any]:
        """Its keys of camera.json."""
        keys = {"K": self.K, "dist": self.dist, "R": self.R, "t": self.t, "view_errors": self.errors}
        return {key: value.tolist() for key, value in keys.items()}


@dataclass(frozen=True)
class PlateCalibration:
    """A camera, and the view that it has from points; `given` are the keys of camera.json that the user said."""

    given: dict[str, Any]
    points: PlatePoints
    view: PlateView
    error: float

    def to_dict(self) -> dict[str, Any]:
        """camera.json."""
        residuals = np.round(self.view.residuals, 4).tolist()
        fit = {"points": len(self.points.pixels), "error_px": self.error, "residuals_px": residuals}
        fit |= {"not_found": self.missing}
        return self.given | {"scale": scale_at(self.camera), **self.view.to_dict(), "calibration": fit}

    @property
    def camera(self) -> Camera:
        """As used, at the scale in the picture's middle."""
        return Camera.from_dict(self.given | self.view.to_dict(), self.points.where)

    @property
    def missing(self) -> list[str]:
        """What the points do not tell."""
        lens = "lens: taken as straight; eight points or more, up to the picture's rim, show its distortion"
        lamp = "lamp: its position is not known; glints are not taken to centres"
        return [lamp] if self.view.lens else [lens, lamp]

    def summary(self) -> list[str]:
        """Lines for people."""
        left, camera = self.view.residuals, self.camera
        lines = [f"point {k + 1}: off by {x:+.2f}, {y:+.2f} px" for k, (x, y) in enumerate(left[:12].tolist())]
        rms = math.sqrt(float((left**2).sum(axis=1).mean()))
        lines.append(f"{len(left)} points: off by {rms:.2g} px rms, taken to be known to {self.error:g} px each way")
        quantities: list[tuple[str, str, float, Callable[[Camera], float]]] = [
            ("focal length", "px", 1.0, lambda camera: float(camera.K[0, 0])),
            ("height", "m", 1.0, lambda camera: float(camera.position[2])),
            ("tilt", "degrees", 180 / math.pi, lambda camera: math.acos(min(1.0, abs(float(camera.R[2, 2]))))),
            ("scale", "m/px in the picture's middle, where balls have their centres", 1.0, scale_at),
            *([("k1", "", 1.0, lambda camera: float(camera.dist[0]))] if self.view.lens else []),
        ]
        for name, unit, factor, function in quantities:
            ends = [[function(perturb_view(camera, step * e)) for step in (1e-3, -1e-3)] for e in self.view.errors]
            std = float(np.linalg.norm([(high - low) / (2 * 1e-3) for high, low in ends]))
            lines.append(f"{name}: {factor * function(camera):.6g} +- {factor * std:.2g} {unit}".rstrip())
        return lines + [f"not found - {line}" for line in self.missing]


def calibrate_plate(
    source: Path,
    given: dict[str, Any],
    points: Path | None,
    board: str,
    error: float | None = None,
    height: float | None = None,
) -> PlateCalibration:
    """Find perspective and lens from points that are known. Raises InputError.

    source: a film or a picture by the same camera in the same place; with a board, one that shows it.
    given: `keys_from_options`.
    points: a table of points.
    board: without points, what lies on the plate instead.
    error: standard error of the points, px.
    height: of the camera above the plate, m.
    """
    if points is not None and board:
        raise InputError("--points, --board: expected one of them")
    for name, value in (("--error", error), ("--height", height)):
        if value is not None and not 1e-3 <= value <= 1e3:
            raise InputError(f"{name}: expected a number from 0.001 to 1000, not {value!r}")
    size = read_picture_size(source)
    known = find_board(source, board) if points is None else read_points(points)
    # px: a person marks points to 0.5, a program finds corners of a board to 0.2
    used = error if error is not None else 0.5 if points is not None else 0.2
    view = fit_view(known, size, used, height)
    return PlateCalibration(given | {"size": list(size)}, known, view, used)


def fit_view(points: PlatePoints, size: tuple[int, int], error: float, height: float | None = None) -> PlateView:
    """Fit focal length, lens and pose to points of the plate. Raises InputError where they do not determine a view.

    A view from straight above does not determine the focal length and the height separately. Priors from usual cameras,
    or a measured height with its error, then decide.

    size: width and height of the picture.
    error: standard error of the points' pixels.
    height: of the camera above the plate, m, known to 2 %.
    """
    _check(points, size)
    # from 8 points on k1 is fitted, from 20 points on k2 too
    lens = max((count for needed, count in ((8, 1), (20, 2)) if len(points.pixels) >= needed), default=0)
    problem = _Problem(points, size, error, height, lens)
    tried = [(problem.fit(turn, begin, 30), turn) for turn, begin in _starts(problem)]
    fit, turn = min(tried, key=lambda pair: float(pair[0].fun @ pair[0].fun))
    turn, around = problem.rotate(turn, fit.x), np.concatenate([fit.x[:-6], np.zeros(3), fit.x[-3:]])
    fit = problem.fit(turn, around, 300)
    x, residual, slope = fit.x, fit.fun, np.asarray(fit.jac)
    left = residual[: points.pixels.size].reshape(-1, 2) * error
    # p-value below which no camera sees a plane so
    if chdtrc(len(residual) - len(x), float(residual @ residual)) < 1e-4:
        off = np.hypot(*left.T)
        worst = int(off.argmax())
        raise InputError(
            f"{points.where}: the points are {math.sqrt((off**2).mean()):.2g} px off, rms, far more than the error "
            f"given; worst is number {worst + 1}, {off[worst]:.2g} px; check it, or say --error"
        )
    values, vectors = np.linalg.eigh(np.linalg.inv(slope.T @ slope))
    errors = np.zeros((len(x), VIEW_ERROR_COUNT))
    errors[:, problem.free] = (vectors * np.sqrt(np.maximum(values, 0.0))).T
    K, dist, shift = problem.view(x)
    return PlateView(K, dist, problem.rotate(turn, x), shift, errors, left, lens)


@dataclass(frozen=True)
class _Problem:
    """The least-squares problem of a view.

    The unknowns x are the logarithm of the focal length and the offset of the principal point from the picture's
    middle (px, two numbers). Then follow k1 and k2 if they are free, a rotation vector, and t.
    """

    points: PlatePoints
    size: tuple[int, int]
    error: float
    height: float | None
    lens: int

    @property
    def free(self) -> list[int]:
        """Which of NUMBERS x has."""
        return [0, 1, 2, *range(3, 3 + self.lens), *range(5, VIEW_ERROR_COUNT)]

    def rotate(self, turn: Array, x: Array) -> Array:
        """The rotation from world to camera."""
        return np.asarray(cv2.Rodrigues(x[-6:-3])[0] @ turn)

    def view(self, x: Array) -> tuple[Array, Array, Array]:
        """K, dist and t."""
        focal, dist = math.exp(x[0]), np.zeros(5)
        dist[: self.lens] = x[3 : 3 + self.lens]
        middle_x, middle_y = ((side - 1) / 2 for side in self.size)
        matrix = np.array([[focal, 0, middle_x + x[1]], [0, focal, middle_y + x[2]], [0, 0, 1.0]])
        return matrix, dist, x[-3:]

    def residual(self, x: Array, turn: Array) -> Array:
        """Residuals of the pixels and of the priors, in standard errors."""
        K, dist, shift = self.view(x)
        rotation = self.rotate(turn, x)
        seen = self.points.metres @ rotation[:, :2].T + shift
        pixels = distort(seen[:, :2] / seen[:, 2:], dist)[0] @ K[:2, :2].T + K[:2, 2]
        # usual cameras: a focal length of 1.1 widths of the picture, with a scatter of 0.5 in its logarithm
        usual, scatter = (1.1, 0.5)
        # the principal point scatters about the middle by 1.5 % of the width
        aside = 0.015 * self.size[0]
        known = [(x[0] - math.log(usual * self.size[0])) / scatter, x[1] / aside, x[2] / aside]
        known += (x[3 : 3 + self.lens] / 0.5).tolist()
        if self.height is not None:
            known.append((-(rotation.T @ shift)[2] / self.height - 1) / 0.02)
        return np.concatenate([((pixels - self.points.pixels) / self.error).ravel(), known])

    def fit(self, turn: Array, begin: Array, most: int) -> Any:
        """The least squares near a beginning, where rotation vectors turn `turn`; most: evaluations."""
        return least_squares(self.residual, begin, args=(turn,), x_scale="jac", max_nfev=most)


def _starts(problem: _Problem) -> Iterator[tuple[Array, Array]]:
    """Rotations and x to begin with: poses that show the points, for focal lengths from wide to long."""
    points = problem.points
    plate = np.column_stack([points.metres, np.zeros(len(points.metres))])
    found = False
    # focal lengths over the width of the picture
    for share in (0.4, 0.7, 1.1, 2.0, 4.0):
        x = np.concatenate([[math.log(share * problem.size[0])], np.zeros(problem.lens + 8)])
        matrix, dist, _ = problem.view(x)
        _, turns, shifts, _ = cv2.solvePnPGeneric(plate, points.pixels, matrix, dist, flags=cv2.SOLVEPNP_IPPE)
        for turn, shift in zip(turns, shifts, strict=True):
            rotation = np.asarray(cv2.Rodrigues(turn)[0], np.float64)
            if -(rotation.T @ shift)[2, 0] > 0 and (plate @ rotation.T + shift.ravel())[:, 2].min() > 0:
                found = True
                yield rotation, np.concatenate([x[:-3], shift.ravel()])
    if not found:
        raise InputError(f"{points.where}: no camera above the plate sees the points so; are some of them exchanged?")


def _check(points: PlatePoints, size: tuple[int, int]) -> None:
    """Raises InputError for too few points, points on a line, exchanged or mirrored ones."""
    where, count = points.where, len(points.pixels)
    if count < MIN_POINTS:
        raise InputError(f"{where}: {count} points, expected at least {MIN_POINTS}, no three of them on a line")
    outside = ~np.all((points.pixels >= -0.5) & (points.pixels <= np.array(size) - 0.5), axis=1)
    if outside.any():
        x, y = points.pixels[outside][0]
        raise InputError(f"{where}: {x:g}, {y:g} px lies outside the picture of {size[0]} x {size[1]}")
    rows = []
    centred = [values - values.mean(axis=0) for values in (points.pixels, points.metres)]
    spread = [values / max(float(np.sqrt((values**2).sum(axis=1).mean())), 1e-300) for values in centred]
    for (u, v), (x, y) in zip(*spread, strict=True):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y, -u], [0, 0, 0, x, y, 1, -v * x, -v * y, -v]]
    strength = np.linalg.svd(np.array(rows), compute_uv=False)
    if strength[7] < 1e-3 * strength[0]:
        raise InputError(
            f"{where}: the points lie on a line, or all but one do; expected four corners, as of a rectangle"
        )
    homography = np.asarray(cv2.findHomography(points.metres, points.pixels)[0], np.float64)
    # the determinant of the derivative of pixels by places
    turned = np.linalg.det(homography) / (points.metres @ homography[2, :2] + homography[2, 2]) ** 3
    if (turned > 0).all():
        raise InputError(f"{where}: x, y are mirrored: seen from above y grows upwards where x grows to the right")
    if (turned > 0).any():
        raise InputError(f"{where}: no camera sees the points so; are some of them exchanged?")
