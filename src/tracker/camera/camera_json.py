"""Reading camera.json: what is missing is assumed and listed, and so is what cannot be modelled."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from synthcam_shared.errors import InputError as InputError
from tracker.camera.camera_keys import (
    LIMITS,
    LONGEST_SIDE,
    MOST_PIXELS,
    NUMBERS,
    describe_unknown_keys,
    format_value,
    read_json,
)
from tracker.camera.lens import Array
from tracker.camera.sensor import SensorSpec

DEFAULT_HEIGHT = 0.5  # m
LEAST_FOCAL = 1.0  # px
SMALLEST = 0.5  # px, of a ball
LARGEST = 4.0  # of a ball, over the picture's longer side
STANDARD_ERRORS = ("scale_std", "fps_std", "ball_diameter_std")
LARGEST_ERROR = 0.5  # of a standard error, over what it is of: beyond, that is not known at all
UNASSUMED = ("full_well", "codec_noise", "gamma")  # of a sensor: without them there is no such limit, loss or curve
LOOKING_DOWN = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))
BLURS = {  # keys that make a glint wider than psf.sigma_px, by section
    "psf": ("defocus_px", "f_number"),
    "surface": ("roughness", "scratches"),
}


def read_keys(path: Path) -> Any:
    """What a camera file holds. Raises InputError where that is not JSON."""
    try:
        return read_json(path)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file, expected a camera.json") from None
    except IsADirectoryError:
        raise InputError(f"{path}: a folder, expected a camera.json") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as JSON ({error})") from None


@runtime_checkable
class HasCameraJson(Protocol):
    """An object that knows the keys of its camera file, such as a clip of synthcam and its camera."""

    @property
    def camera_json(self) -> Mapping[str, Any]:
        """The keys of camera.json."""


def read_source(given: Mapping[str, Any] | str | Path | HasCameraJson) -> Any:
    """The keys of camera.json from a path, or from an object that holds them. Raises InputError."""
    if isinstance(given, str | Path):
        return read_keys(Path(given))
    if isinstance(given, Mapping):
        return given
    keys = given.camera_json if isinstance(given, HasCameraJson) else None
    if not keys:
        kind = type(given).__name__
        raise InputError(f"camera: of type {kind}, expected the keys of camera.json, a path to it, or a tracker.Camera")
    return keys


@dataclass(frozen=True)
class LampSettings:
    """A disc lamp, or what is as wide as one: position of its centre, radius, standard errors of the position, m."""

    position: tuple[float, float, float]
    radius: float = 0.0
    position_std: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def to_dict(self) -> dict[str, Any]:
        """As camera.json has it."""
        known = {"position": list(self.position), "radius": self.radius}
        return known | ({"position_std": list(self.position_std)} if any(self.position_std) else {})


def parse(data: Any, where: str) -> dict[str, Any]:
    """The fields of a Camera from the keys of camera.json; InputError names ``where`` and the key at fault."""
    return _Reader(data, where).fields()


class _Reader:
    """Reads the keys of one camera.json, collecting what had to be assumed."""

    def __init__(self, data: Any, where: str) -> None:
        self.where = where
        self.assumed: list[str] = []
        self.unmodelled: list[str] = []
        self.data: Mapping[str, Any] = self._table(data, "the file")
        self.unmodelled += describe_unknown_keys(self.data)

    def fields(self) -> dict[str, Any]:
        size = self._size()
        if "fps" not in self.data:
            raise self._bad("fps", "frames per second, it is missing")
        fps = self._number(self.data, "fps")
        if "scale" not in self.data and not {"K", "t"} <= set(self.data):
            raise self._bad("scale", "m/px, or K and t, from which it follows; they are missing")
        if "dist" in self.data and "K" not in self.data:
            raise self._bad("K", "the 3x3 camera matrix beside dist; it is missing")
        diameter = self._maybe("ball_diameter", math.nan)
        exposure = self._maybe("exposure", 0.0)
        if exposure > 1.0 / fps * (1 + 1e-9):
            raise self._bad("exposure", f"at most one frame time, {1 / fps:g} s")
        matrix, rotation, shift, scale = self._view(size, diameter)
        if not math.isnan(diameter) and not SMALLEST <= diameter / scale <= LARGEST * max(size):
            in_mm = SMALLEST <= diameter / scale / 1000 <= LARGEST * max(size)
            hint = f"; it is in m, did you mean {diameter / 1000:g}?" if in_mm else ""
            if SMALLEST <= diameter / scale * 1000 <= LARGEST * max(size):
                hint = f"; scale is in m/px, did you mean {scale / 1000:g}?"
            shows = f"a ball that the picture can show, not one of {diameter / scale:.3g} px{hint}"
            raise self._bad("ball_diameter", shows)
        found: dict[str, Any] = dict(
            K=matrix,
            dist=self._array("dist", (5,), np.zeros(5)),
            R=rotation,
            t=shift,
            size=size,
            fps=fps,
            exposure=exposure,
            scale=scale,
            ball_diameter=diameter,
            striker=self._striker(),
            lamp=self._lamp(),
            psf_sigma=self._psf(),
            sensor=self._sensor(),
            metric=self._metric(),
            line_time=self._line_time(),
            view_errors=self._view_errors(),
            matte=self._table(self.data.get("ball", {}), "ball").get("finish") == "matte",
        )
        found |= {key: self._error(key, found[key.removesuffix("_std")]) for key in STANDARD_ERRORS}
        assumed = dict.fromkeys([*self.assumed, *self._said_to_be_assumed()])
        return found | {"assumed": tuple(assumed), "unmodelled": tuple(self.unmodelled)}

    def _error(self, key: str, of: float) -> float:
        """The standard error of a number; 0 where it is not given."""
        value = self._number(self.data, key) if key in self.data else 0.0
        if value > 0 and not value <= LARGEST_ERROR * of:  # nor NaN
            name = key.removesuffix("_std")
            raise self._bad(key, f"the standard error of {name}, at most {LARGEST_ERROR:g} of what that is")
        return value

    def _view_errors(self) -> Array:
        value = self.data.get("view_errors", [])
        if value and not {"K", "R", "t"} <= set(self.data):
            raise self._bad("view_errors", "K, R and t beside it, whose errors these are")
        if not isinstance(value, list) or len(value) > NUMBERS:
            raise self._bad("view_errors", f"at most {NUMBERS} rows of {NUMBERS} numbers, not {format_value(value)}")
        none = np.zeros((0, NUMBERS))
        return self._array("view_errors", (len(value), NUMBERS), none) if value else none

    def _said_to_be_assumed(self) -> list[str]:
        names = self.data.get("assumed", [])
        if not isinstance(names, list | tuple) or not all(isinstance(name, str) for name in names):
            raise self._bad("assumed", f"a list of names of keys, not {format_value(names)}")
        return list(names)

    def _metric(self) -> bool:
        value = self.data.get("metric", True)
        if not isinstance(value, bool):
            raise self._bad("metric", f"true or false, not {format_value(value)}")
        return value

    def _view(self, size: tuple[int, int], diameter: float) -> tuple[Array, Array, Array, float]:
        """K, R, t and scale, whichever of them are given: (height - R) / scale is the focal length in px.

        Where the diameter is not known, the plate stands for the plane of the balls' centres.
        """
        radius = 0.0 if math.isnan(diameter) else diameter / 2
        rotation = self._array("R", (3, 3), np.array(LOOKING_DOWN))
        if np.max(np.abs(rotation @ rotation.T - np.eye(3))) > 1e-6 or np.linalg.det(rotation) < 0:
            raise self._bad("R", "a rotation matrix: orthogonal, of determinant 1")
        scale = self._number(self.data, "scale") if "scale" in self.data else None
        middle = ((size[0] - 1) / 2, (size[1] - 1) / 2)
        if "K" in self.data:
            matrix = self._array("K", (3, 3), np.eye(3))
            if min(matrix[0, 0], matrix[1, 1]) < LEAST_FOCAL or not np.allclose(matrix[2], (0, 0, 1)):
                raise self._bad("K", f"focal lengths of at least {LEAST_FOCAL:g} px and a last row 0, 0, 1")
            focal = float(matrix[0, 0])
            height = focal * scale + radius if scale is not None else DEFAULT_HEIGHT
        else:
            assert scale is not None
            height = float(self.data["t"][2]) if self._has_shift() else DEFAULT_HEIGHT
            focal = (height - radius) / scale
            matrix = np.array([[focal, 0, middle[0]], [0, focal, middle[1]], [0, 0, 1.0]])
            self.assumed.append("K")
        if "t" not in self.data and "K" not in self.data:
            self.assumed.append("height")
        shift = self._array("t", (3,), np.array([0.0, 0.0, height]))
        if scale is None:
            depth = float((rotation @ np.array([0, 0, radius]) + shift)[2])
            if depth <= 0:
                raise self._bad("t", "a camera that has the plate before it")
            scale = depth / focal
            self.assumed.append("scale")
        return matrix, rotation, shift, scale

    def _has_shift(self) -> bool:
        return "t" in self.data and self._array("t", (3,), np.zeros(3))[2] > 0

    def _size(self) -> tuple[int, int]:
        value = self.data.get("size")
        if not (isinstance(value, list | tuple) and len(value) == 2):
            raise self._bad("size", "[width, height] in pixels")
        if not all(isinstance(v, int) and not isinstance(v, bool) and 0 < v <= LONGEST_SIDE for v in value):
            raise self._bad("size", f"two whole numbers from 1 to {LONGEST_SIDE}, not {format_value(value)}")
        if value[0] * value[1] > MOST_PIXELS:
            raise self._bad("size", f"at most {MOST_PIXELS} pixels, not {value[0] * value[1]}")
        return int(value[0]), int(value[1])

    def _striker(self) -> str:
        value = self.data.get("striker", "b")
        if value not in ("a", "b"):
            raise self._bad("striker", '"a" or "b"')
        return str(value)

    def _lamp(self) -> LampSettings | None:
        lamp = self._table(self.data.get("lamp", {}), "lamp")
        if "position" not in lamp:
            self.assumed.append("lamp")
            return None
        x, y, z = self._array("position", (3,), np.zeros(3), lamp, "lamp.").tolist()
        if z <= 0:
            raise self._bad("lamp.position", f"a lamp above the plate, not at z = {z:g} m")
        if lamp.get("second"):
            self.unmodelled.append("lamp.second: positions are biased towards its glints")
        off = self._array("position_std", (3,), np.zeros(3), lamp, "lamp.").tolist()
        if not off[2] <= LARGEST_ERROR * z:
            raise self._bad("lamp.position_std", f"at most {LARGEST_ERROR:g} of the lamp's height, not {off[2]:g} m")
        return LampSettings((x, y, z), self._lamp_radius(lamp), (off[0], off[1], off[2]))

    def _lamp_radius(self, lamp: Mapping[str, Any]) -> float:
        """Of the disc whose image is as wide as the lamp's, by the mean square from its middle."""

        def length(key: str) -> float:
            return self._number(lamp, key, "lamp.") if key in lamp else 0.0

        shape = lamp.get("shape", "disc")
        if shape not in ("disc", "ring", "bar"):
            raise self._bad("lamp.shape", f"disc, ring or bar, not {format_value(shape)}")
        if shape == "bar":
            self.unmodelled.append("lamp.shape bar: its glints are taken as round")
            return math.hypot(length("length"), length("width")) / math.sqrt(6.0)
        return math.hypot(length("radius"), length("inner") if shape == "ring" else 0.0)

    def _psf(self) -> float | None:
        psf = self._table(self.data.get("psf", {}), "psf")
        for section, keys in BLURS.items():
            table = self._table(self.data.get(section, {}), section)
            for key in keys:
                if key in table and self._number(table, key, f"{section}.") > 0:
                    self.unmodelled.append(f"{section}.{key}: glints are taken as Gaussian, as wide as they are seen")
                    psf = {}
        if "sigma_px" not in psf:
            self.assumed.append("psf.sigma_px")
            return None
        return self._number(psf, "sigma_px", "psf.")

    def _line_time(self) -> float:
        shutter = self._table(self.data.get("shutter", {}), "shutter")
        kind = shutter.get("kind", "global")
        if kind not in ("global", "rolling"):
            raise self._bad("shutter.kind", f"global or rolling, not {format_value(kind)}")
        if kind == "global":
            return 0.0
        if "line_time" not in shutter:
            raise self._bad("shutter.line_time", "seconds from row to row of a rolling shutter; it is missing")
        return self._number(shutter, "line_time", "shutter.")

    def _sensor(self) -> SensorSpec:
        table = self._table(self.data.get("sensor", {}), "sensor")
        values: dict[str, Any] = {}
        for key in ("bits", "gain", "read_noise", "dark", "prnu", "dsnu", "black_level", *UNASSUMED):
            if key in table:
                values[key] = self._number(table, key, "sensor.")
            elif key not in UNASSUMED:
                self.assumed.append(f"sensor.{key}")
        if "bits" in values:
            if values["bits"] != int(values["bits"]):
                raise self._bad("sensor.bits", "a whole number from 1 to 16")
            values["bits"] = int(values["bits"])
        return SensorSpec(**values)

    def _maybe(self, key: str, default: float) -> float:
        if key in self.data:
            return self._number(self.data, key)
        self.assumed.append(key)
        return default

    def _number(self, table: Mapping[str, Any], key: str, prefix: str = "") -> float:
        value, (low, high) = table[key], LIMITS[prefix + key]
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:  # nor NaN
            raise self._bad(prefix + key, f"a number from {low:g} to {high:g}, not {format_value(value)}")
        return float(value)

    def _array(
        self,
        key: str,
        shape: tuple[int, ...],
        default: Array,
        table: Mapping[str, Any] | None = None,
        prefix: str = "",
    ) -> Array:
        source = self.data if table is None else table
        if key not in source:
            return default
        size, (low, high) = " x ".join(map(str, shape)), LIMITS[prefix + key]
        try:
            value = np.array(source[key], dtype=object)  # as floats, text would be read as numbers
        except ValueError:
            value = np.empty(0)
        numbers = value.shape == shape and all(type(v) in (int, float) for v in value.flat)
        if not numbers or not all(low <= v <= high for v in value.flat):
            raise self._bad(prefix + key, f"{size} numbers from {low:g} to {high:g}, not {format_value(source[key])}")
        return value.astype(np.float64)

    def _table(self, value: Any, key: str) -> Mapping[str, Any]:
        if not isinstance(value, Mapping):
            raise self._bad(key, "a table of keys and values")
        return value

    def _bad(self, key: str, expected: str) -> InputError:
        return InputError(f"{self.where}: {key}: expected {expected}")
