"""Projects points to pixels and back, and converts the position of a glint to that of its ball's centre.

Axes and conventions are those of ``camera.json``. The plate is at z = 0, ball centres at z = R, and pixel centres at
integers. ``x_cam = R x_world + t`` and the lens distortion are those of OpenCV.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from synthcam_shared.arguments import check_arguments
from synthcam_shared.arrays import Array
from synthcam_shared.errors import InputError
from tracker.camera.camera_json import (
    BODIES,
    STANDARD_ERRORS,
    HasCameraJson,
    LampSettings,
    parse_camera_keys,
    read_source,
)
from tracker.camera.camera_keys import VIEW_ERROR_COUNT
from tracker.camera.lens import distort, find_mirror_normal, undistort
from tracker.camera.sensor import SensorSpec
from tracker.camera.warp import Warp

__all__ = ["Camera", "InputError", "LampSettings", "SensorSpec"]


@dataclass(frozen=True, eq=False)
class Camera:
    """Camera, lamp and ball of a ``camera.json``.

    Attributes
    ----------
    K, dist : ndarray of shape (3, 3), ndarray of shape (5,)
        Camera matrix, px; lens distortion k1, k2, p1, p2, k3. "Camera calibration and 3D reconstruction" of OpenCV 4
        defines both.
    R, t : ndarray of shape (3, 3), ndarray of shape (3,)
        World to camera, x_cam = R x_world + t, m.
    size : tuple of int
        Width and height, px.
    fps, exposure : float
        Frames a second; exposure of a frame, s.
    scale : float
        m/px at the height of the balls' centres.
    ball_diameter : float
        m; NaN without it in the file: collisions are then not measured.
    striker : {"a", "b"}
        Which ball was launched.
    lamp : Lamp or None
    psf_sigma : float or None
        Gaussian width of the optics, px.
    sensor : Sensor
    assumed : tuple of str
        The keys that have a default or an estimate.
    metric : bool
        False without a scale (no camera file): all lengths are then in pixels.
    line_time : float
        Delay of each row of a rolling shutter after the one above, s.
    unmodelled : tuple of str
        Keys of the file that the tracker does not account for.
    exposure_from_blur : float or None
        The exposure that the motion blur of the glints shows, s; None where it agrees with `exposure`.
    scale_std, fps_std, ball_diameter_std : float
        Standard errors, m/px, 1/s, m; 0 if unknown.
    view_errors : ndarray of shape (n, 11)
        The change of K, dist, R and t by each of n independent standard errors; see `perturb_view`.
    matte : bool
        Whether the balls are matte: they show no glint and are seen whole.
    warp : Warp or None
        A smooth correction of positions on the plate; `project` and `unproject` contain it.
    mass_ratio : float or None
        Mass of ball a over that of ball b; None if unknown.
    body : float
        Moment of inertia of the bodies over m R^2.
    support : {"", "cloth", "air", "sliding"}
        What carries the bodies; "" if the tracks decide.

    Examples
    --------
    >>> import tracker
    >>> given = {"size": [640, 480], "fps": 250, "scale": 1.6e-4, "t": [0, 0, 0.5], "ball_diameter": 2.38e-3}
    >>> camera = tracker.Camera.from_dict(given)
    >>> camera.project([0.016, 0.0, camera.radius]).round(6)
    array([419.5, 239.5])
    >>> camera.assumed[:3]
    ('exposure', 'K', 'lamp')
    """

    K: Array
    dist: Array
    R: Array
    t: Array
    size: tuple[int, int]
    fps: float
    exposure: float
    scale: float
    ball_diameter: float
    striker: str = "b"
    lamp: LampSettings | None = None
    psf_sigma: float | None = None
    sensor: SensorSpec = field(default_factory=SensorSpec)
    assumed: tuple[str, ...] = ()
    metric: bool = True
    line_time: float = 0.0
    unmodelled: tuple[str, ...] = ()
    exposure_from_blur: float | None = None
    scale_std: float = 0.0
    fps_std: float = 0.0
    ball_diameter_std: float = 0.0
    view_errors: Array = field(default_factory=lambda: np.zeros((0, VIEW_ERROR_COUNT)))
    matte: bool = False
    warp: Warp | None = None
    mass_ratio: float | None = None
    body: float = BODIES["ball"]
    support: str = ""

    @property
    def effective_exposure(self) -> float:
        """Exposure that fits the motion blur, s: from the blur where it is known, else the file's."""
        return self.exposure if self.exposure_from_blur is None else self.exposure_from_blur

    @property
    def radius(self) -> float:
        """Ball radius, m; 0 if unknown."""
        return self.ball_diameter / 2.0 if self.knows_diameter else 0.0

    @property
    def knows_diameter(self) -> bool:
        """True if the camera file has the balls' diameter."""
        return math.isfinite(self.ball_diameter)

    @property
    def glides(self) -> bool:
        """True if the camera file says that bodies glide: they do not roll after a slide."""
        return self.support in ("air", "sliding")

    @property
    def diameter_px(self) -> float:
        """Ball diameter in the picture, px; if unknown 15 px, a usual one, which is enough for a search."""
        return self.ball_diameter / self.scale if self.knows_diameter else 15.0

    @property
    def centre_height(self) -> float:
        """Height of the balls' centres, m; without a diameter the height at which ``scale`` holds."""
        if self.knows_diameter:
            return self.radius
        return float((self.position + self.R[2] * self.scale * self.K[0, 0])[2])

    @property
    def position(self) -> Array:
        """Position of the camera in the world, (3,), m."""
        return np.asarray(-self.R.T @ self.t, dtype=np.float64)

    @property
    def corrects_glint(self) -> bool:
        """True if glints can be converted to centres: lamp, ball diameter and camera height are all given."""
        return (
            self.metric
            and self.lamp is not None
            and not {"ball_diameter", "height"} & set(self.assumed)
            and self.lamp.position[2] > self.ball_diameter
        )

    @property
    def lamp_image_radius(self) -> float:
        """Radius of the lamp's mirror image, px (its disc widens the glint by radius^2 / 4 in variance)."""
        if self.lamp is None or not self.metric:
            return 0.0
        return self.radius / 2.0 * self.lamp.radius / max(self.lamp.position[2], self.radius) / self.scale

    @property
    def sigma(self) -> float | None:
        """Gaussian width of a resting glint, px, from optics and lamp image together; None if not known."""
        if self.psf_sigma is None:
            return None
        return math.sqrt(self.psf_sigma**2 + self.lamp_image_radius**2 / 4.0)

    def project(self, points: ArrayLike) -> Array:
        """Project points to pixels.

        Parameters
        ----------
        points : array_like of shape (..., 3)
            In the world, m.

        Returns
        -------
        ndarray of shape (..., 2)
        """
        given = np.asarray(points, dtype=np.float64)
        if self.warp is not None:
            given = np.concatenate([self.warp.undo(given[..., :2]), given[..., 2:]], axis=-1)
        cam = given @ self.R.T + self.t
        bent, _ = distort(cam[..., :2] / cam[..., 2:3], self.dist)
        return bent @ self.K[:2, :2].T + self.K[:2, 2]

    def unproject(self, pixels: ArrayLike, z: float | None = None) -> tuple[Array, Array]:
        """Find the points of a horizontal plane that are seen at pixels.

        Parameters
        ----------
        pixels : array_like of shape (..., 2)
        z : float, optional
            Height of the plane, m; default: of the balls' centres.

        Returns
        -------
        positions : ndarray of shape (..., 2)
            x and y, m.
        jacobians : ndarray of shape (..., 2, 2)
            Derivative of the positions by the pixels, m/px.
        """
        position, straight, bend, depth, stretch = self._on_plane(pixels, self.centre_height if z is None else z)
        # d straight / d position at this depth, from x_cam = R x_world + t
        slope = (self.R[:2, :2] - straight[..., :, None] * self.R[2, :2]) / depth[..., None]
        return position, np.asarray(stretch @ np.linalg.inv(self.K[:2, :2] @ bend @ slope), dtype=np.float64)

    def _on_plane(self, pixels: ArrayLike, height: float) -> tuple[Array, Array, Array, Array, Array]:
        """Positions on a plane; normalised coordinates, the lens's Jacobian there, the depth (..., 1); the warp's."""
        bent = (np.asarray(pixels, dtype=np.float64) - self.K[:2, 2]) @ np.linalg.inv(self.K[:2, :2]).T
        straight, bend = undistort(bent, self.dist)
        ray = np.concatenate([straight, np.ones_like(straight[..., :1])], axis=-1) @ self.R
        depth = (height - self.position[2]) / ray[..., 2:3]
        position, stretch = np.asarray(self.position[:2] + depth * ray[..., :2], dtype=np.float64), np.eye(2)
        if self.warp is not None:
            shift, slope = self.warp.displace(position)
            position, stretch = position + shift, stretch + slope
        return position, straight, bend, depth, stretch

    def glint_of_centre(self, centres: ArrayLike) -> Array:
        """Find the pixels at which balls mirror the centre of the lamp. An InputError says that the lamp is unknown.

        Parameters
        ----------
        centres : array_like of shape (..., 2)
            x and y of balls on the plate, m.

        Returns
        -------
        ndarray of shape (..., 2)
        """
        middle = self._at_ball_height(np.asarray(centres, dtype=np.float64))
        return self.project(middle + self.radius * self._glint_normal(middle))

    def _glint_normal(self, middle: Array, start: Array | None = None, steps: int = 20) -> Array:
        """Unit normals (..., 3) of balls about positions (..., 3), m, where they mirror the lamp.

        start: near them. steps: from there, at most.
        """
        if self.lamp is None:
            raise InputError("camera: lamp is missing, expected its position for the position of a glint")
        return find_mirror_normal(middle, self.radius, self.position, np.array(self.lamp.position), start, steps)

    def centre_of_glint(self, glints: ArrayLike) -> tuple[Array, Array]:
        """Convert the pixels of glints to those of the balls' centres.

        Parameters
        ----------
        glints : array_like of shape (..., 2)

        Returns
        -------
        centres : ndarray of shape (..., 2)
            The glints themselves if lamp, diameter or height are unknown: see `corrects_glint`.
        jacobians : ndarray of shape (..., 2, 2)
            Derivative of the centres by the glints.
        """
        seen = np.asarray(glints, dtype=np.float64)
        if not self.corrects_glint or seen.size == 0:
            return seen.copy(), np.broadcast_to(np.eye(2), (*seen.shape, 2)).copy()
        around = np.concatenate([np.zeros((1, 2)), 0.5 * np.eye(2), -0.5 * np.eye(2)])
        pixels = self.project(self.ball_of_glint(seen + around.reshape(5, *[1] * (seen.ndim - 1), 2)))
        jacobian = np.stack([pixels[1] - pixels[3], pixels[2] - pixels[4]], axis=-1)
        return pixels[0], jacobian

    def ball_of_glint(self, glints: ArrayLike) -> Array:
        """Convert the pixels of glints to positions of the balls' centres.

        Parameters
        ----------
        glints : array_like of shape (..., 2)
            px; the position of the lamp must be known.

        Returns
        -------
        ndarray of shape (..., 3)
            In the world, m.
        """
        at = target = self._on_plane(glints, self.radius)[0]
        normal = None
        for _ in range(40):  # both the place and the normal contract by about R/height, .003, a step
            middle = self._at_ball_height(at)
            normal = self._glint_normal(middle, normal, steps=1)
            point = middle + self.radius * normal
            # the eye's ray through the glint meets the plane of the centres there
            share = (self.radius - point[..., 2:]) / (self.position[2] - point[..., 2:])
            miss = target - (point + share * (self.position - point))[..., :2]
            at = at + miss
            if np.max(np.abs(miss)) < 1e-12:
                break
        return self._at_ball_height(at)

    def _at_ball_height(self, at: Array) -> Array:
        return np.concatenate([at, np.full_like(at[..., :1], self.radius)], axis=-1)

    @staticmethod
    def of(given: CameraSource) -> Camera:
        """Make a camera from whatever describes one. An InputError names the file and the key.

        Parameters
        ----------
        given : Camera, dict, str, Path or object
            The keys of camera.json, a path to it, or an object with the keys as its attribute ``camera_json``. Clips of
            synthcam and their cameras are such objects.

        Returns
        -------
        Camera
        """
        if isinstance(given, Camera):
            return given
        return Camera.from_dict(read_source(given), f"{given}" if isinstance(given, str | Path) else "camera")

    @staticmethod
    @check_arguments
    def read(path: Path | str) -> Camera:
        """Read a camera file. An InputError names the file and the key.

        Parameters
        ----------
        path : str or Path

        Returns
        -------
        Camera
        """
        return Camera.of(Path(path))

    @staticmethod
    def from_dict(data: Any, where: str = "camera") -> Camera:
        """Make a camera from the keys of camera.json. An InputError names the key.

        Parameters
        ----------
        data : dict
            The keys, as docs/format.md lists them. Unknown ones are listed in `unmodelled`.
        where : str
            How messages name it.

        Returns
        -------
        Camera
        """
        camera = Camera(**parse_camera_keys(data, where))
        if camera.position[2] <= camera.radius:
            raise InputError(f"{where}: R, t: expected a camera above the plate, not at z = {camera.position[2]:g} m")
        most = 3.0  # between scale and the scale of the view anywhere in the picture
        if not 1 / most < (reach := camera._scales() / camera.scale).min() <= reach.max() < most:
            raise InputError(
                f"{where}: K, dist, R, t: expected a view of about {camera.scale:.3g} m/px all over the picture, "
                f"as scale says; they make it {camera.scale * reach.min():.3g} to {camera.scale * reach.max():.3g}"
            )
        return camera

    def _scales(self) -> Array:
        """m/px at 9 x 9 pixels; infinite at a pixel without a position, or whose position projects to another pixel."""
        across, down = (np.linspace(0, n - 1, 9) for n in self.size)
        pixels = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
        level = np.full((len(pixels), 1), self.centre_height)
        with np.errstate(all="ignore"):
            try:
                at, slope = self.unproject(pixels)
            except np.linalg.LinAlgError:
                return np.array([np.inf])
            back = self.project(np.concatenate([at, level], axis=-1))
            found = np.all(np.abs(back - pixels) < 0.01, axis=1)  # px
            return np.where(found, np.sqrt(np.abs(np.linalg.det(slope))), np.inf)

    @staticmethod
    def unknown(size: tuple[int, int], bits: int) -> Camera:
        """Make a camera without a file: lengths in pixels, times in frames.

        Parameters
        ----------
        size, bits : tuple of int, int
            Width and height, px; bits of the sensor.

        Returns
        -------
        Camera
        """
        guess = Camera.from_dict({"scale": 1.6e-4, "size": list(size), "fps": 1.0}, "no camera file")
        return replace(guess, sensor=replace(guess.sensor, bits=bits), metric=False, assumed=("camera", *guess.assumed))

    def to_dict(self) -> dict[str, Any]:
        """Give the keys of camera.json, `assumed` and `metric`.

        Returns
        -------
        dict
            Without the keys of a lamp, a PSF or a diameter that is unknown.
        """
        plain = {"codec_noise": 0.0, "gamma": 1.0}
        sensor = {k: v for k, v in vars(self.sensor).items() if math.isfinite(v) and v != plain.get(k)}
        out: dict[str, Any] = {
            "K": self.K.tolist(), "dist": self.dist.tolist(), "R": self.R.tolist(), "t": self.t.tolist(),
            "size": list(self.size), "fps": self.fps, "exposure": self.exposure, "scale": self.scale,
            "striker": self.striker, "sensor": sensor, "assumed": list(self.assumed), "metric": self.metric,
        }  # fmt: skip
        optional = {
            "ball_diameter": self.ball_diameter if self.knows_diameter else None,
            **{key: getattr(self, key) or None for key in STANDARD_ERRORS},
            "view_errors": self.view_errors.tolist() or None,
            "lamp": None if self.lamp is None else self.lamp.to_dict(),
            "psf": None if self.psf_sigma is None else {"sigma_px": self.psf_sigma},
            "shutter": {"kind": "rolling", "line_time": self.line_time} if self.line_time else None,
            "ball": {"finish": "matte"} if self.matte else None,
            "mass_ratio": self.mass_ratio,
            "body": self.body if self.body != BODIES["ball"] else None,
            "support": self.support or None,
            "exposure_seen_s": self.exposure_from_blur,
            "warp": None if self.warp is None else self.warp.to_dict(),
        }
        return out | {key: value for key, value in optional.items() if value is not None}


CameraSource: TypeAlias = Camera | Mapping[str, Any] | str | Path | HasCameraJson
