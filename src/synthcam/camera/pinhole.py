"""Pinhole camera with lens distortion: project points and the primary glints of balls to pixels.

Conventions are OpenCV's (OpenCV 4, "Camera calibration and 3D reconstruction"): x_cam = R x_world + t, and a distortion
k1, k2, p1, p2, k3. Image x points right and y down. Pixel centres are at integers.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike

from synthcam.camera import reflections
from synthcam.camera.lamp import Lamp
from synthcam_shared.arrays import Array

__all__ = ["Lamp", "PinholeCamera", "locate_glint", "project_glint"]


@dataclass(frozen=True)
class PinholeCamera:
    """A calibrated camera."""

    K: Array  # camera matrix (3, 3), px
    dist: Array  # distortion (5,)
    R: Array  # rotation (3, 3) from world to camera
    t: Array  # translation (3,), m
    size: tuple[int, int]  # width and height, px
    fps: float  # frame rate, 1/s
    exposure: float  # s
    scale: float  # m/px at the height of the balls' centres
    psf_sigma_px: float  # standard deviation of the optics' blur
    defocus_px: float = 0.0  # radius of the disc to which defocus spreads a point
    airy_px: float = 0.0  # wavelength times f-number over the pixel pitch; 0 without diffraction
    vignetting: float = 0.0  # share of the light that is lost in the corners of the picture
    line_time: float = 0.0  # delay of the exposure from one row to the next, s; 0 for a global shutter
    # The keys of camera.json, which the experimenter knows; `tracker.track` takes them. Only a clip's camera has them.
    camera_json: Mapping[str, Any] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def overhead(
        cls,
        size: tuple[int, int],
        scale: float,
        height: float,
        tilt: Sequence[float] = (0.0, 0.0),
        distortion: Sequence[float] = (0.0, 0.0, 0.0, 0.0, 0.0),
        *,
        ball_radius: float,
        **fields: float,
    ) -> "PinholeCamera":
        """Make a camera at a distance of `height` m from the world's origin, at which it looks.

        size: width and height, px.
        scale: m/px at z = ball_radius.
        tilt: angles a, b, rad. The camera is rotated about the origin, by a about the world's x axis, then by b about
        y. Its centre is Ry(b) Rx(a) (0, 0, height).
        ball_radius: m. fields: fps, exposure, psf_sigma_px and other fields that are numbers.

        Raises ValueError if height does not exceed ball_radius.
        """
        if height <= ball_radius:
            raise ValueError(f"camera height {height} m must be over the balls' centres at {ball_radius} m")
        focal = (height - ball_radius) / scale
        K = np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1]])
        (sin_a, sin_b), (cos_a, cos_b) = np.sin(tilt), np.cos(tilt)
        about_x = np.array([[1, 0, 0], [0, cos_a, -sin_a], [0, sin_a, cos_a]])
        about_y = np.array([[cos_b, 0, sin_b], [0, 1, 0], [-sin_b, 0, cos_b]])
        return cls(
            K=K,
            dist=np.array(distortion, float),
            R=np.diag([1.0, -1, -1]) @ (about_y @ about_x).T,
            t=np.array([0, 0, float(height)]),
            size=(int(size[0]), int(size[1])),
            scale=float(scale),
            **{name: float(value) for name, value in fields.items()},  # type: ignore[arg-type]
        )

    @property
    def centre(self) -> Array:
        """Position of the camera in the world: (3,) m."""
        return np.asarray(-self.R.T @ self.t)

    def project(self, points: ArrayLike) -> Array:
        """Project world points (..., 3), m, to pixels (..., 2); NaN behind the camera."""
        flat, _ = self._flatten(points)
        return np.asarray(self._distort(flat)[0] @ self.K[:2, :2].T + self.K[:2, 2])

    def project_with_slope(self, points: ArrayLike) -> tuple[Array, Array]:
        """Project world points (..., 3), m, to pixels (..., 2), with the derivative (..., 2, 3), px/m."""
        flat, depth = self._flatten(points)
        bent, bend = self._distort(flat)
        lens = self.K[:2, :2]
        pixels = bent @ lens.T + self.K[:2, 2]
        slope = np.zeros((*flat.shape, 3))
        slope[..., 0, 0] = slope[..., 1, 1] = 1
        slope[..., 2] = -flat
        slope /= depth[..., None, None]
        return pixels, (lens @ bend if self.dist.any() else lens) @ slope @ self.R

    def _flatten(self, points: ArrayLike) -> tuple[Array, Array]:
        """Normalised coordinates (..., 2) of world points (..., 3), m, and their depth, m; NaN behind the camera."""
        seen = np.asarray(points, float) @ self.R.T + self.t
        depth = np.where(seen[..., 2] > 0, seen[..., 2], np.nan)
        return seen[..., :2] / depth[..., None], depth

    def unproject(self, pixels: Array) -> Array:
        """Directions (..., 3) in the world, of depth 1, of the rays of pixels (..., 2)."""
        flat = (pixels - self.K[:2, 2]) @ np.linalg.inv(self.K[:2, :2]).T
        if self.dist.any():
            steps = (cv2.TERM_CRITERIA_MAX_ITER, 60, 0)
            bent = pixels.reshape(-1, 1, 2).astype(float)
            flat = np.asarray(cv2.undistortPoints(bent, self.K, self.dist, criteria=steps)).reshape(pixels.shape)
        return np.asarray(np.concatenate([flat, np.ones((*flat.shape[:-1], 1))], axis=-1) @ self.R)

    def _distort(self, flat: Array) -> tuple[Array, Array]:
        """Apply OpenCV's lens model to normalised coordinates (..., 2); return also its Jacobian (..., 2, 2)."""
        if not self.dist.any():
            return flat, np.broadcast_to(np.eye(2), (*flat.shape, 2))
        k1, k2, p1, p2, k3 = self.dist
        x, y = flat[..., 0], flat[..., 1]
        square = x * x + y * y
        radial = 1 + square * (k1 + square * (k2 + square * k3))
        rise = 2 * (k1 + square * (2 * k2 + square * 3 * k3))  # d radial / dx = rise x
        bent_x = x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x)
        bent_y = y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y
        mixed = rise * x * y + 2 * p1 * x + 2 * p2 * y
        xx = radial + rise * x * x + 2 * p1 * y + 6 * p2 * x
        yy = radial + rise * y * y + 6 * p1 * y + 2 * p2 * x
        bend = np.stack([np.stack([xx, mixed], -1), np.stack([mixed, yy], -1)], -2)
        return np.stack([bent_x, bent_y], -1), bend


def locate_glint(camera: PinholeCamera, lamp: Lamp, centre: ArrayLike, radius: float) -> Array:
    """Locate primary glints in space: points (..., 3), m, at which balls at centre (..., 3) mirror the lamp's centre.

    The path lamp -> ball -> camera has stationary length (Fermat's principle). Other balls are ignored.
    """
    centres = np.asarray(centre, float)
    flat = centres.reshape(-1, 1, 3)
    paths = reflections.reflect(lamp.position, camera.centre, flat, np.full(flat.shape[:2], float(radius)))
    return paths.points.reshape(centres.shape)


def project_glint(camera: PinholeCamera, lamp: Lamp, centre: ArrayLike, radius: float) -> Array:
    """Project the primary glints of balls at centre (..., 3), m, to pixels (..., 2)."""
    return camera.project(locate_glint(camera, lamp, centre, radius))
