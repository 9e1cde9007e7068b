"""Camera, lamp and ball: where a point is seen, and how far a glint stands from its ball's centre.

Axes and conventions are those of ``camera.json``: plate at z = 0, ball centres at z = R, pixel centres at
integers, ``x_cam = R x_world + t`` and lens distortion as OpenCV defines them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tracker.camera.camera_json import InputError, Lamp, parse
from tracker.camera.camera_keys import read_json
from tracker.camera.lens import Array, distort, mirror_normal, pair_normal, undistort
from tracker.camera.sensor import Sensor

__all__ = ["Camera", "InputError", "Lamp", "Sensor"]

PLACING = ("K", "dist", "R", "t", "size", "fps", "exposure", "line_time", "ball_diameter", "lamp")
ALIKE = 1e-6  # relative: numbers of two camera files that differ by less are the same
FAR = 1e6  # m, of a point as good as straight overhead
USUAL_PX = 15.0  # px, of a ball whose diameter is not known, for the search of its glint
CHECKED = 9  # pixels along each side of the picture at which a camera file is tried
UNEVEN = 3.0  # between scale and what the view makes of it anywhere in the picture
LOST = 0.01  # px between a pixel and what its position is projected to


@dataclass(frozen=True, eq=False)
class Camera:
    """What ``camera.json`` holds; ``assumed`` names each key left to a default or an estimate.

    ``metric`` is False where nothing ties pixels to metres (no camera file): then there are only pixels.
    ``ball_diameter`` is NaN where the file does not have it; collisions are then not measured.
    ``line_time`` s: by so much later each row of a rolling shutter is exposed. ``unmodelled`` lists what in
    the file is not accounted for. ``exposure_seen`` s: the exposure found from the motion blur of the glints, where it
    differs from ``exposure``.
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
    lamp: Lamp | None = None
    psf_sigma: float | None = None
    sensor: Sensor = field(default_factory=Sensor)
    assumed: tuple[str, ...] = ()
    metric: bool = True
    line_time: float = 0.0
    unmodelled: tuple[str, ...] = ()
    exposure_seen: float | None = None

    @property
    def exposed(self) -> float:
        """Seconds for which glints are drawn out."""
        return self.exposure if self.exposure_seen is None else self.exposure_seen

    def differs(self, other: Camera) -> str:
        """The first key of camera.json in which another camera would see the same balls at other pixels; empty where
        there is none.

        In what is measured anew of each clip (the exposure as seen, the glints' width) it may differ.
        """
        for key in PLACING:
            one, two = (getattr(c, key) for c in (self, other))
            if key == "lamp":
                one, two = (lamp.position if lamp else () for lamp in (one, two))
            if np.shape(one) != np.shape(two) or not np.allclose(one, two, ALIKE, ALIKE**2, equal_nan=True):
                return key
        return ""

    @property
    def radius(self) -> float:
        """Ball radius, m; 0 where it is not known."""
        return self.ball_diameter / 2.0 if self.knows_diameter else 0.0

    @property
    def knows_diameter(self) -> bool:
        """Whether the camera file has the balls' diameter."""
        return math.isfinite(self.ball_diameter)

    @property
    def diameter_px(self) -> float:
        """Ball diameter as seen, px; where it is not known a usual one, good enough for a search."""
        return self.ball_diameter / self.scale if self.knows_diameter else USUAL_PX

    @property
    def centre_height(self) -> float:
        """Height of the balls' centres, m; where the diameter is not known that at which ``scale`` holds."""
        if self.knows_diameter:
            return self.radius
        return float((self.position + self.R[2] * self.scale * self.K[0, 0])[2])

    @property
    def position(self) -> Array:
        """(3,) the camera's own position in the world, m."""
        return np.asarray(-self.R.T @ self.t, dtype=np.float64)

    @property
    def corrects_glint(self) -> bool:
        """Whether glint -> centre is possible: lamp, ball diameter and camera height all given."""
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
        """World points (..., 3), m -> pixels (..., 2)."""
        cam = np.asarray(points, dtype=np.float64) @ self.R.T + self.t
        bent, _ = distort(cam[..., :2] / cam[..., 2:3], self.dist)
        return bent @ self.K[:2, :2].T + self.K[:2, 2]

    def unproject(self, pixels: ArrayLike, z: float | None = None) -> tuple[Array, Array]:
        """Pixels (..., 2) -> points of the plane at height z (default: ball centres), m.

        Returns the positions (..., 2) and the Jacobians d position / d pixel (..., 2, 2), m/px.
        """
        height = self.centre_height if z is None else z
        bent = (np.asarray(pixels, dtype=np.float64) - self.K[:2, 2]) @ np.linalg.inv(self.K[:2, :2]).T
        straight, bend = undistort(bent, self.dist)
        ray = np.concatenate([straight, np.ones_like(straight[..., :1])], axis=-1) @ self.R
        reach = (height - self.position[2]) / ray[..., 2:3]
        at = self.position[:2] + reach * ray[..., :2]
        # d straight / d position at this depth, from x_cam = R x_world + t
        depth = reach[..., None]
        slope = (self.R[:2, :2] - straight[..., :, None] * self.R[2, :2]) / depth
        return at, np.linalg.inv(self.K[:2, :2] @ bend @ slope)

    def _position_at(self, pixels: Array) -> Array:
        """``unproject`` without its Jacobian."""
        bent = (pixels - self.K[:2, 2]) @ np.linalg.inv(self.K[:2, :2]).T
        straight, _ = undistort(bent, self.dist)
        ray = np.concatenate([straight, np.ones_like(straight[..., :1])], axis=-1) @ self.R
        reach = (self.radius - self.position[2]) / ray[..., 2:3]
        return np.asarray(self.position[:2] + reach * ray[..., :2], dtype=np.float64)

    def glint_of_centre(self, centres: ArrayLike) -> Array:
        """Ball centres (n, 2), m -> pixels (n, 2) at which the lamp's centre is mirrored."""
        if self.lamp is None:
            raise InputError("camera: lamp is missing, expected its position for the position of a glint")
        xy = np.asarray(centres, dtype=np.float64)
        middle = np.concatenate([xy, np.full_like(xy[..., :1], self.radius)], axis=-1)
        light = np.array(self.lamp.position)
        return self.project(middle + self.radius * mirror_normal(middle, self.radius, self.position, light))

    def centre_of_glint(self, glints: ArrayLike) -> tuple[Array, Array]:
        """Glint pixels (n, 2) -> ball-centre pixels (n, 2) and Jacobians d centre / d glint (n, 2, 2).

        Without lamp, diameter or height it returns its input: see ``corrects_glint``.
        """
        seen = np.asarray(glints, dtype=np.float64)
        if not self.corrects_glint or seen.size == 0:
            return seen.copy(), np.broadcast_to(np.eye(2), (*seen.shape, 2)).copy()
        around = np.concatenate([np.zeros((1, 2)), 0.5 * np.eye(2), -0.5 * np.eye(2)])
        pixels = self._centre_pixel(self._centre_position(seen + around.reshape(5, *[1] * (seen.ndim - 1), 2)))
        jacobian = np.stack([pixels[1] - pixels[3], pixels[2] - pixels[4]], axis=-1)
        return pixels[0], jacobian

    def zenith_of_glint(self, glints: ArrayLike, share: float) -> Array:
        """Glint pixels (n, 2) -> pixels (n, 2), a share of the way from their balls' centres to where these mirror what
        is straight overhead. What a ball mirrors of a room that is the same all round is symmetric about that line.
        """
        seen = np.asarray(glints, dtype=np.float64)
        if not self.corrects_glint or seen.size == 0:
            return seen.copy()
        at = self._centre_position(seen)
        middle = np.concatenate([at, np.full_like(at[..., :1], self.radius)], axis=-1)
        overhead = np.concatenate([at, np.full_like(at[..., :1], FAR)], axis=-1)
        zenith = self.project(middle + self.radius * mirror_normal(middle, self.radius, self.position, overhead))
        centre = self.project(middle)
        return np.asarray(centre + share * (zenith - centre), dtype=np.float64)

    def secondary_of_pair(self, glints: ArrayLike, others: ArrayLike) -> Array:
        """Pixels (n, 2) at which balls of primary glints (n, 2) show the lamp as their neighbours mirror it."""
        middle, other = self._centre(glints), self._centre(others)
        return self._mirrored(middle, pair_normal(middle, other, self.radius, self.position, self._lamp_position()))

    def secondary_share(self, glints: ArrayLike, others: ArrayLike) -> Array:
        """Flux (n,) of those secondary glints over that of the primary ones, but for one reflectance.

        The image of a small lamp is as large as the determinant of its pixel's derivative by the lamp's position.
        """
        middle, other = self._centre(glints), self._centre(others)
        sides = [
            self._lamp_position(),
            *(self._lamp_position() + 0.03 * self._lamp_position()[2] * axis for axis in np.eye(3)[:2]),
        ]
        areas = []
        for normals in (
            [pair_normal(middle, other, self.radius, self.position, light) for light in sides],
            [mirror_normal(middle, self.radius, self.position, light) for light in sides],
        ):
            still, by_x, by_y = (self._mirrored(middle, normal) for normal in normals)
            areas.append(np.abs(np.linalg.det(np.stack([by_x - still, by_y - still], axis=-1))))
        return np.asarray(areas[0] / areas[1], dtype=np.float64)

    def _lamp_position(self) -> Array:
        if self.lamp is None:
            raise InputError("camera: lamp is missing, expected its position for the position of a glint")
        return np.array(self.lamp.position, dtype=np.float64)

    def _centre(self, glints: ArrayLike) -> Array:
        """Ball centres (n, 3), m, of primary glints (n, 2)."""
        at = self._centre_position(np.asarray(glints, dtype=np.float64))
        return np.concatenate([at, np.full_like(at[..., :1], self.radius)], axis=-1)

    def _mirrored(self, middle: Array, normal: Array) -> Array:
        return self.project(middle + self.radius * normal)

    def _centre_position(self, seen: Array) -> Array:
        target = self._position_at(seen)
        at = target
        for _ in range(12):  # contracts by about R/height, .003, a step
            miss = target - self._position_at(self.glint_of_centre(at))
            at = at + miss
            if np.max(np.abs(miss)) < 1e-12:
                break
        return at

    def _centre_pixel(self, at: Array) -> Array:
        return self.project(np.concatenate([at, np.full_like(at[..., :1], self.radius)], axis=-1))

    @staticmethod
    def read(path: Path | str) -> Camera:
        """Camera from a JSON file; InputError names the file and the key at fault."""
        where = Path(path)
        try:
            data = read_json(where)
        except FileNotFoundError:
            raise InputError(f"{where}: no such file, expected a camera.json") from None
        except (OSError, ValueError) as error:
            raise InputError(f"{where}: cannot be read as JSON ({error})") from None
        return Camera.from_dict(data, str(where))

    @staticmethod
    def from_dict(data: Any, where: str = "camera") -> Camera:
        """Camera from the keys of camera.json; unknown keys are listed in ``unmodelled``. Raises InputError."""
        camera = Camera(**parse(data, where))
        if camera.position[2] <= camera.radius:
            raise InputError(f"{where}: R, t: expected a camera above the plate, not at z = {camera.position[2]:g} m")
        if not 1 / UNEVEN < (reach := camera._scales() / camera.scale).min() <= reach.max() < UNEVEN:
            raise InputError(
                f"{where}: K, dist, R, t: expected a view of about {camera.scale:.3g} m/px all over the picture, "
                f"as scale says; they make it {camera.scale * reach.min():.3g} to {camera.scale * reach.max():.3g}"
            )
        return camera

    def _scales(self) -> Array:
        """m/px all over the picture; infinite at pixels that have no position, or whose position is another pixel's."""
        across, down = (np.linspace(0, n - 1, CHECKED) for n in self.size)
        pixels = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
        level = np.full((len(pixels), 1), self.centre_height)
        with np.errstate(all="ignore"):
            try:
                at, slope = self.unproject(pixels)
            except np.linalg.LinAlgError:
                return np.array([np.inf])
            back = self.project(np.concatenate([at, level], axis=-1))
            found = np.all(np.abs(back - pixels) < LOST, axis=1)
            return np.where(found, np.sqrt(np.abs(np.linalg.det(slope))), np.inf)

    @staticmethod
    def unknown(size: tuple[int, int], bits: int) -> Camera:
        """A camera of which only the pictures are known: lengths in pixels, times in frames."""
        guess = Camera.from_dict({"scale": 1.6e-4, "size": list(size), "fps": 1.0}, "no camera file")
        return replace(guess, sensor=replace(guess.sensor, bits=bits), metric=False, assumed=("camera", *guess.assumed))

    def to_dict(self) -> dict[str, Any]:
        """The keys of camera.json, and ``assumed``; None for an unknown lamp or PSF is left out."""
        sensor = {k: v for k, v in vars(self.sensor).items() if math.isfinite(v)}
        out: dict[str, Any] = {
            "K": self.K.tolist(), "dist": self.dist.tolist(), "R": self.R.tolist(), "t": self.t.tolist(),
            "size": list(self.size), "fps": self.fps, "exposure": self.exposure, "scale": self.scale,
            "striker": self.striker, "sensor": sensor, "assumed": list(self.assumed), "metric": self.metric,
        }  # fmt: skip
        if self.knows_diameter:
            out["ball_diameter"] = self.ball_diameter
        if self.lamp is not None:
            out["lamp"] = {"position": list(self.lamp.position), "radius": self.lamp.radius}
        if self.psf_sigma is not None:
            out["psf"] = {"sigma_px": self.psf_sigma}
        if self.line_time:
            out["shutter"] = {"kind": "rolling", "line_time": self.line_time}
        if self.exposure_seen is not None:
            out["exposure_seen_s"] = self.exposure_seen
        return out
