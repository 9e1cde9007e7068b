"""A camera file from known points of the plate."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from synthcam_shared.errors import InputError
from tracker.calibration.calibrate import keys_from_options, write_camera_file
from tracker.calibration.plate_points import PlatePoints, find_board, read_picture_size, read_points
from tracker.calibration.plate_view import PlateView, fit_view
from tracker.camera.camera import Camera
from tracker.camera.views import perturb_view, scale_at


@dataclass(frozen=True)
class PlateCalibration:
    """A camera, and the view that it has from points; `given` are the keys of camera.json that the user said."""

    given: dict[str, Any]
    points: PlatePoints
    view: PlateView
    error: float

    def to_dict(self) -> dict[str, Any]:
        """camera.json."""
        view, camera = self.view, self.camera
        return self.given | {
            "scale": scale_at(camera), "K": view.K.tolist(), "dist": view.dist.tolist(), "R": view.R.tolist(),
            "t": view.t.tolist(), "view_errors": view.errors.tolist(),
            "calibration": {
                "points": len(self.points.pixels), "error_px": self.error,
                "residuals_px": np.round(view.residuals, 4).tolist(), "not_found": self.missing,
            },
        }  # fmt: skip

    @property
    def camera(self) -> Camera:
        """As used, at the scale in the picture's middle."""
        view = self.view
        keys = {"K": view.K, "dist": view.dist, "R": view.R, "t": view.t, "view_errors": view.errors}
        return Camera.from_dict(self.given | {key: value.tolist() for key, value in keys.items()}, self.points.where)

    @property
    def missing(self) -> list[str]:
        """What the points do not tell."""
        lens = "lens: taken as straight; eight points or more, up to the picture's rim, show its distortion"
        lamp = "lamp: its position is not known; glints are not taken to centres"
        return [lamp] if self.view.lens else [lens, lamp]

    def write(self, path: Path) -> None:
        """The camera file, written aside and moved into place."""
        write_camera_file(path, self.to_dict())

    def summary(self) -> list[str]:
        """Lines for people."""
        left, view = self.view.residuals, self.view
        lines = [f"point {k + 1}: off by {x:+.2f}, {y:+.2f} px" for k, (x, y) in enumerate(left[:12].tolist())]
        rms = math.sqrt(float((left**2).sum(axis=1).mean()))
        lines.append(f"{len(left)} points: off by {rms:.2g} px rms, taken to be known to {self.error:g} px each way")
        for name, unit, factor, function in (
            ("focal length", "px", 1.0, lambda camera: float(camera.K[0, 0])),
            ("height", "m", 1.0, lambda camera: float(camera.position[2])),
            ("tilt", "degrees", 180 / math.pi, lambda camera: math.acos(min(1.0, abs(float(camera.R[2, 2]))))),
            ("scale", "m/px in the picture's middle, where balls have their centres", 1.0, scale_at),
            *([("k1", "", 1.0, lambda camera: float(camera.dist[0]))] if view.lens else []),
        ):
            value, std = self._with_error(function)
            lines.append(f"{name}: {factor * value:.6g} +- {factor * std:.2g} {unit}".rstrip())
        return lines + [f"not found - {line}" for line in self.missing]

    def _with_error(self, function: Any) -> tuple[float, float]:
        camera = self.camera
        slopes = [
            (function(perturb_view(camera, 1e-3 * e)) - function(perturb_view(camera, -1e-3 * e))) / (2 * 1e-3)
            for e in self.view.errors
        ]
        return function(camera), float(np.linalg.norm(slopes))


def calibrate_plate(
    source: Path,
    said: tuple[float, float, float | None, float],
    points: Path | None,
    board: str,
    error: float | None = None,
    height: float | None = None,
) -> PlateCalibration:
    """Find perspective and lens from points that are known. Raises InputError.

    source: a film or a picture by the same camera in the same place; with a board, one that shows it. said: diameter,
    fps, exposure and gamma, as `keys_from_options` takes them. points: a table of points. board: without points, what
    lies on the plate instead. error: standard error of the points, px. height: of the camera above the plate, m.
    """
    given = keys_from_options(*said)
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
