"""Reads camera.json: its keys as pydantic models, and the fields of a camera that follow from them.

Missing keys are assumed and listed in ``assumed``. Keys that the tracker cannot account for are listed in
``unmodelled``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, Protocol

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PlainValidator, ValidationError

from synthcam_shared.arrays import Array
from synthcam_shared.errors import InputError as InputError
from synthcam_shared.settings import did_you_mean
from tracker.camera.camera_keys import LONGEST_SIDE, MOST_PIXELS, VIEW_ERROR_COUNT, format_wrong_value, read_json
from tracker.camera.sensor import SensorSpec
from tracker.camera.warp import Warp

BODIES = {"ball": 0.4, "disc": 0.5}  # I/(m R^2)
STANDARD_ERRORS = ("scale_std", "fps_std", "ball_diameter_std")


class HasCameraJson(Protocol):
    """An object that knows the keys of its camera file, such as a clip of synthcam and its camera."""

    @property
    def camera_json(self) -> Mapping[str, Any]:
        """The keys of camera.json."""


def read_source(given: Mapping[str, Any] | str | Path | HasCameraJson) -> Any:
    """The keys of camera.json from a path, or from an object that holds them. Raises InputError."""
    if isinstance(given, Mapping):
        return given
    if not isinstance(given, str | Path):
        if keys := getattr(given, "camera_json", None):
            return keys
        kind = type(given).__name__
        raise InputError(f"camera: of type {kind}, expected the keys of camera.json, a path to it, or a tracker.Camera")
    path = Path(given)
    try:
        return read_json(path)
    except (OSError, ValueError) as error:
        kinds = {FileNotFoundError: "no such file", IsADirectoryError: "a folder"}
        what = next((text for kind, text in kinds.items() if isinstance(error, kind)), "")
        reason = f"{what}, expected a camera.json" if what else f"cannot be read as JSON ({error})"
        raise InputError(f"{path}: {reason}") from None


@dataclass(frozen=True)
class LampSettings:
    """A lamp as a disc: position of its centre, radius, and standard errors of the position, m."""

    position: tuple[float, float, float]
    radius: float = 0.0
    position_std: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def to_dict(self) -> dict[str, Any]:
        """The section of camera.json."""
        known = {"position": list(self.position), "radius": self.radius}
        return known | ({"position_std": list(self.position_std)} if any(self.position_std) else {})


# --- Types of values. Each check raises ValueError with what it expected. Limits are wider than any apparatus, and
# --- narrow enough for the arithmetic.


def _number(low: float, high: float, whole: bool = False) -> PlainValidator:
    """A number within limits, both included."""

    def check(value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:  # nor NaN
            raise ValueError(f"a number from {low:g} to {high:g}, not {format_wrong_value(value)}")
        if whole and value != int(value):
            raise ValueError(f"a whole number from {low:g} to {high:g}, not {format_wrong_value(value)}")
        return int(value) if whole else float(value)

    return PlainValidator(check)


def _array(low: float, high: float, *shape: int) -> PlainValidator:
    """An array of numbers within limits."""
    return PlainValidator(lambda given: _check_array(given, low, high, shape))


def _check_array(given: Any, low: float, high: float, shape: tuple[int, ...]) -> Array:
    try:
        value = np.array(given, dtype=object)  # as floats, text would be read as numbers
    except ValueError:
        value = np.empty(0)
    numbers = value.shape == shape and all(type(v) in (int, float) for v in value.flat)
    if not numbers or not all(low <= v <= high for v in value.flat):
        size = " x ".join(map(str, shape))
        raise ValueError(f"{size} numbers from {low:g} to {high:g}, not {format_wrong_value(given)}")
    return value.astype(np.float64)


def _check_rows(value: Any) -> Array:
    if not isinstance(value, list) or len(value) > VIEW_ERROR_COUNT:
        n = VIEW_ERROR_COUNT
        raise ValueError(f"at most {n} rows of {n} numbers, not {format_wrong_value(value)}")
    return _check_array(value, -1e3, 1e3, (len(value), VIEW_ERROR_COUNT)) if value else np.zeros((0, VIEW_ERROR_COUNT))


def _anything_that(is_right: Callable[[Any], bool], expected: str) -> PlainValidator:
    """A value that passes a test; `expected` says in messages what does."""

    def check(value: Any) -> Any:
        if not is_right(value):
            raise ValueError(f"{expected}, not {format_wrong_value(value)}")
        return value

    return PlainValidator(check)


def _choice(*words: str) -> PlainValidator:
    """One of a few words."""
    return _anything_that(lambda value: value in words, f"{', '.join(words[:-1])} or {words[-1]}")


def _is_list_of_names(value: Any) -> bool:
    return isinstance(value, list | tuple) and all(isinstance(name, str) for name in value)


def _check_size(value: Any) -> tuple[int, int]:
    if not (isinstance(value, list | tuple) and len(value) == 2):
        raise ValueError("[width, height] in pixels")
    if not all(isinstance(v, int) and not isinstance(v, bool) and 0 < v <= LONGEST_SIDE for v in value):
        raise ValueError(f"two whole numbers from 1 to {LONGEST_SIDE}, not {format_wrong_value(value)}")
    if value[0] * value[1] > MOST_PIXELS:
        raise ValueError(f"at most {MOST_PIXELS} pixels, not {value[0] * value[1]}")
    return int(value[0]), int(value[1])


def _check_body(value: Any) -> float:
    if isinstance(value, str) and value in BODIES:
        return BODIES[value]
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.01 <= value <= 1.0:
        raise ValueError(f"ball, disc, or I/(m R^2) from 0.01 to 1, not {format_wrong_value(value)}")
    return float(value)


# --- The sections: the keys that the tracker uses. _KNOWN_KEYS lists the others too.


class _Section(BaseModel):
    """A table of keys and values; unknown keys are listed by `_describe_unknown_keys`."""

    model_config = ConfigDict(extra="ignore", frozen=True, arbitrary_types_allowed=True)


class _Lamp(_Section):
    """The lamp, a disc unless `shape` says otherwise; lengths in m."""

    position: Annotated[Array | None, _array(-1e6, 1e6, 3)] = None
    position_std: Annotated[Array, _array(0.0, 100.0, 3)] = Field(default_factory=lambda: np.zeros(3))
    radius: Annotated[float, _number(0.0, 100.0)] = 0.0
    shape: Annotated[str, _choice("disc", "ring", "bar")] = "disc"
    inner: Annotated[float, _number(0.0, 100.0)] = 0.0
    length: Annotated[float, _number(0.0, 100.0)] = 0.0
    width: Annotated[float, _number(0.0, 100.0)] = 0.0
    second: Any = None

    def equivalent_radius(self) -> float:
        """Radius of the disc whose image has the same mean square width."""
        if self.shape == "bar":
            return math.hypot(self.length, self.width) / math.sqrt(6.0)
        return math.hypot(self.radius, self.inner if self.shape == "ring" else 0.0)


class _Psf(_Section):
    """The optics' blur, px; defocus and diffraction widen it beyond a Gaussian."""

    sigma_px: Annotated[float | None, _number(0.01, 100.0)] = None
    defocus_px: Annotated[float, _number(0.0, 1e3)] = 0.0
    f_number: Annotated[float, _number(0.0, 1e3)] = 0.0


class _Sensor(_Section):
    """The sensor by EMVA 1288, with the units of `SensorSpec`. The last three keys have no estimate."""

    bits: Annotated[int | None, _number(1, 16, whole=True)] = None
    gain: Annotated[float | None, _number(1e-6, 1e6)] = None
    read_noise: Annotated[float | None, _number(0.0, 1e6)] = None
    dark: Annotated[float | None, _number(0.0, 1e12)] = None
    prnu: Annotated[float | None, _number(0.0, 1.0)] = None
    dsnu: Annotated[float | None, _number(0.0, 1e6)] = None
    black_level: Annotated[float | None, _number(0.0, 65535.0)] = None
    full_well: Annotated[float | None, _number(1e-6, 1e12)] = None
    codec_noise: Annotated[float | None, _number(0.0, 65535.0)] = None
    gamma: Annotated[float | None, _number(0.2, 5.0)] = None


class _Shutter(_Section):
    """The shutter; a rolling one exposes each row `line_time` s after the one above."""

    kind: Annotated[str, _choice("global", "rolling")] = "global"
    line_time: Annotated[float | None, _number(0.0, 1.0)] = None


class _Surface(_Section):
    """Finish of balls and plate; roughness and scratches widen a glint."""

    roughness: Annotated[float, _number(0.0, 1e3)] = 0.0
    scratches: Annotated[float, _number(0.0, 1e3)] = 0.0


class _CameraFile(_Section):
    """All keys of camera.json; docs/format.md describes them. The tracker does not use those of type Any."""

    size: Annotated[tuple[int, int], PlainValidator(_check_size)] = Field(description="[width, height] in pixels")
    fps: Annotated[float, _number(1e-6, 1e9)] = Field(description="frames per second, it is missing")
    exposure: Annotated[float | None, _number(0.0, 1e6)] = None
    scale: Annotated[float | None, _number(1e-9, 1.0)] = None
    ball_diameter: Annotated[float | None, _number(1e-7, 10.0)] = None
    scale_std: Annotated[float, _number(0.0, 1.0)] = 0.0
    fps_std: Annotated[float, _number(0.0, 1e9)] = 0.0
    ball_diameter_std: Annotated[float, _number(0.0, 10.0)] = 0.0
    R: Annotated[Array, _array(-1.001, 1.001, 3, 3)] = Field(default_factory=lambda: np.diag([1.0, -1.0, -1.0]))
    K: Annotated[Array | None, _array(-1e9, 1e9, 3, 3)] = None
    t: Annotated[Array | None, _array(-1e6, 1e6, 3)] = None
    dist: Annotated[Array | None, _array(-1e12, 1e12, 5)] = None
    striker: Annotated[str, _choice("a", "b")] = "b"
    lamp: _Lamp = _Lamp()
    psf: _Psf = _Psf()
    sensor: _Sensor = _Sensor()
    metric: Annotated[bool, _anything_that(lambda value: isinstance(value, bool), "true or false")] = True
    shutter: _Shutter = _Shutter()
    lens: dict[Any, Any] = {}
    surface: _Surface = _Surface()
    ball: dict[Any, Any] = {}
    video: Any = None
    view_errors: Annotated[Array, PlainValidator(_check_rows)] = Field(
        default_factory=lambda: np.zeros((0, VIEW_ERROR_COUNT))
    )
    assumed: Annotated[Sequence[str], _anything_that(_is_list_of_names, "a list of names of keys")] = ()
    warp: Annotated[Warp | None, PlainValidator(Warp.of)] = None
    ball_masses: Annotated[Array | None, _array(1e-9, 1e3, 2)] = None
    mass_ratio: Annotated[float | None, _number(1e-3, 1e3)] = None
    body: Annotated[float, PlainValidator(_check_body)] = BODIES["ball"]
    support: Annotated[str, _choice("cloth", "air", "sliding")] = ""
    exposure_seen_s: Any = None
    calibration: Any = None


_KNOWN_KEYS = {
    "": [*_CameraFile.model_fields],
    "lamp": [*_Lamp.model_fields, "angle", "facing", "flicker", "radiance"],
    "psf": [*_Psf.model_fields, "pixel_pitch", "wavelength"],
    "sensor": [*_Sensor.model_fields, "hot_pixels", "hot_dark"],
    "shutter": [*_Shutter.model_fields],
    "lens": ["vignetting"],
    "ball": ["finish", "colour"],
    "video": ["codec", "crf", "q", "gamma", "chroma"],
    "surface": [
        *_Surface.model_fields,
        *"steel scratch_slope plate_gloss plate_roughness plate_texture plate_grain plate_shadow".split(),
    ],
}


def _describe_unknown_keys(data: Mapping[str, Any]) -> Iterator[str]:
    """A line for each key of camera.json that nothing reads, with the key that may have been meant."""
    known = {key: f"{section}.{key}".lstrip(".") for section, keys in _KNOWN_KEYS.items() for key in keys}
    for section, keys in _KNOWN_KEYS.items():
        table = data.get(section) if section else data
        for key in table if isinstance(table, Mapping) else ():
            if key not in keys:
                hint = did_you_mean(str(key), known, written=known)
                name = format_wrong_value(f"{section}.{key}".lstrip("."), quoted=False)
                yield f"{name}: not a key of camera.json{hint}"


def parse_camera_keys(data: Any, where: str) -> dict[str, Any]:
    """The fields of a `Camera` from the keys of camera.json. Raises InputError, which names `where` and the key."""
    if not isinstance(data, Mapping):
        raise InputError(f"{where}: the file: expected a table of keys and values")
    try:
        file = _CameraFile.model_validate({key: value for key, value in data.items() if isinstance(key, str)})
    except ValidationError as error:
        first = error.errors()[0]
        key, expected = ".".join(map(str, first["loc"])), "a table of keys and values"
        if first["type"] == "value_error":
            expected = str(first["ctx"]["error"])
        elif first["type"] == "missing":
            expected = str(_CameraFile.model_fields[key].description)
        raise InputError(f"{where}: {key}: expected {expected}") from None
    try:
        return _camera_fields(file, list(_describe_unknown_keys(data)))
    except _KeyProblem as problem:
        raise InputError(f"{where}: {problem}") from None


class _KeyProblem(ValueError):
    """A key that contradicts another one."""

    def __init__(self, key: str, expected: str) -> None:
        super().__init__(f"{key}: expected {expected}")


def _camera_fields(file: _CameraFile, unmodelled: list[str]) -> dict[str, Any]:
    """The fields of a `Camera`. Raises _KeyProblem where keys contradict each other."""
    assumed: list[str] = []
    if file.scale is None and (file.K is None or file.t is None):
        raise _KeyProblem("scale", "m/px, or K and t, from which it follows; they are missing")
    if file.dist is not None and file.K is None:
        raise _KeyProblem("K", "the 3x3 camera matrix beside dist; it is missing")
    assumed += [key for key in ("ball_diameter", "exposure") if getattr(file, key) is None]
    diameter = math.nan if file.ball_diameter is None else file.ball_diameter
    exposure = file.exposure or 0.0
    if exposure > 1.0 / file.fps * (1 + 1e-9):
        raise _KeyProblem("exposure", f"at most one frame time, {1 / file.fps:g} s")
    matrix, shift, scale = _view(file, assumed)
    _check_ball_size(diameter, scale, max(file.size))
    if len(file.view_errors) and (file.K is None or file.t is None or "R" not in file.model_fields_set):
        raise _KeyProblem("view_errors", "K, R and t beside it, whose errors these are")
    lamp = _lamp(file.lamp, assumed, unmodelled)
    psf_sigma = _psf_sigma(file, assumed, unmodelled)
    if file.shutter.kind == "rolling" and file.shutter.line_time is None:
        raise _KeyProblem("shutter.line_time", "seconds from row to row of a rolling shutter; it is missing")
    sensor = file.sensor.model_dump(exclude_none=True)
    needed = ("bits", "gain", "read_noise", "dark", "prnu", "dsnu", "black_level")
    assumed += [f"sensor.{key}" for key in needed if key not in sensor]
    plain = ("R", "size", "fps", "striker", "metric", "view_errors", "warp", "body", "support", *STANDARD_ERRORS)
    fields: dict[str, Any] = {key: getattr(file, key) for key in plain} | dict(
        K=matrix,
        dist=np.zeros(5) if file.dist is None else file.dist,
        t=shift,
        exposure=exposure,
        scale=scale,
        ball_diameter=diameter,
        lamp=lamp,
        psf_sigma=psf_sigma,
        sensor=SensorSpec(**sensor),
        line_time=file.shutter.line_time if file.shutter.kind == "rolling" else 0.0,
        matte=file.ball.get("finish") == "matte",
        mass_ratio=file.mass_ratio,
    )
    if file.ball_masses is not None:
        ratio = fields["mass_ratio"] = float(file.ball_masses[0] / file.ball_masses[1])
        if file.mass_ratio is not None and abs(file.mass_ratio / ratio - 1) > 1e-3:
            raise _KeyProblem("mass_ratio", f"{ratio:.6g}, that of ball_masses, not {file.mass_ratio:g}")
    for key in STANDARD_ERRORS:
        name = key.removesuffix("_std")
        error = fields[key]
        if error > 0 and not error <= 0.5 * fields[name]:  # refuses NaN too; with larger errors it is not known
            raise _KeyProblem(key, f"the standard error of {name}, at most 0.5 of what that is")
    assumed += file.assumed
    return fields | {"assumed": tuple(dict.fromkeys(assumed)), "unmodelled": tuple(unmodelled)}


def _view(file: _CameraFile, assumed: list[str]) -> tuple[Array, Array, float]:
    """K, t and scale, whichever of them are given: (height - R) / scale is the focal length in px.

    Without a diameter the plate is taken as the plane of the balls' centres. A camera of unknown height is assumed at
    half a metre.
    """
    default_height, least_focal = 0.5, 1.0  # m, px
    radius, scale = (file.ball_diameter or 0.0) / 2, file.scale
    if np.max(np.abs(file.R @ file.R.T - np.eye(3))) > 1e-6 or np.linalg.det(file.R) < 0:
        raise _KeyProblem("R", "a rotation matrix: orthogonal, of determinant 1")
    if file.K is not None:
        matrix = file.K
        if min(matrix[0, 0], matrix[1, 1]) < least_focal or not np.allclose(matrix[2], (0, 0, 1)):
            raise _KeyProblem("K", f"focal lengths of at least {least_focal:g} px and a last row 0, 0, 1")
        focal = float(matrix[0, 0])
        height = focal * scale + radius if scale is not None else default_height
    else:
        assert scale is not None
        height = float(file.t[2]) if file.t is not None and file.t[2] > 0 else default_height
        focal = (height - radius) / scale
        middle = ((file.size[0] - 1) / 2, (file.size[1] - 1) / 2)
        matrix = np.array([[focal, 0, middle[0]], [0, focal, middle[1]], [0, 0, 1.0]])
        assumed.append("K")
    if file.t is None and file.K is None:
        assumed.append("height")
    shift = np.array([0.0, 0.0, height]) if file.t is None else file.t
    if scale is None:
        depth = float((file.R @ np.array([0, 0, radius]) + shift)[2])
        if depth <= 0:
            raise _KeyProblem("t", "a camera that has the plate before it")
        scale = depth / focal
        assumed.append("scale")
    return matrix, shift, scale


def _check_ball_size(diameter: float, scale: float, longest_side: int) -> None:
    """Refuse a ball that the picture cannot show: below half a pixel, or over four times its longer side."""

    def fits(size: float) -> bool:
        return 0.5 <= size <= 4.0 * longest_side

    if math.isnan(diameter) or fits(diameter / scale):
        return
    hint = f"; it is in m, did you mean {diameter / 1000:g}?" if fits(diameter / scale / 1000) else ""
    if fits(diameter / scale * 1000):
        hint = f"; scale is in m/px, did you mean {scale / 1000:g}?"
    shows = f"a ball that the picture can show, not one of {diameter / scale:.3g} px{hint}"
    raise _KeyProblem("ball_diameter", shows)


def _lamp(lamp: _Lamp, assumed: list[str], unmodelled: list[str]) -> LampSettings | None:
    if lamp.position is None:
        assumed.append("lamp")
        return None
    (x, y, z), off = lamp.position.tolist(), lamp.position_std.tolist()
    if z <= 0:
        raise _KeyProblem("lamp.position", f"a lamp above the plate, not at z = {z:g} m")
    if lamp.second:
        unmodelled.append("lamp.second: positions are biased towards its glints")
    if not off[2] <= 0.5 * z:
        raise _KeyProblem("lamp.position_std", f"at most 0.5 of the lamp's height, not {off[2]:g} m")
    if lamp.shape == "bar":
        unmodelled.append("lamp.shape bar: its glints are taken as round")
    return LampSettings((x, y, z), lamp.equivalent_radius(), (off[0], off[1], off[2]))


def _psf_sigma(file: _CameraFile, assumed: list[str], unmodelled: list[str]) -> float | None:
    """Width of the PSF, px; None where something widens glints beyond it: then the film has to show it."""
    widening = ("psf.defocus_px", "psf.f_number", "surface.roughness", "surface.scratches")
    wider = [key for key in widening if attrgetter(key)(file) > 0]
    unmodelled += [f"{key}: glints are taken as Gaussian, with the width that the film shows" for key in wider]
    if wider or file.psf.sigma_px is None:
        assumed.append("psf.sigma_px")
        return None
    return file.psf.sigma_px
