"""The apparatus of an experiment: camera, lamp, surfaces and sensor, as a scene and camera.json name them."""

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from synthcam.camera.lamp import Flicker, Lamp
from synthcam.camera.pinhole import PinholeCamera
from synthcam.camera.surface import IRON_N_K, Surface
from synthcam.scene.materials import MaterialSettings, is_under_room_light
from synthcam_shared.settings import Fraction, NotNegative, Positive, Settings

Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
Position = Annotated[list[Annotated[float, Field(ge=-1e6, le=1e6)]], Field(min_length=3, max_length=3)]

HIDDEN_KEYS = {"room", "ambient", "glint_peak", "white", *MaterialSettings.model_fields}  # from the experimenter
MAX_AVI_FPS = 1000  # the container's clock is no finer


class CameraSettings(Settings):
    """`camera:` known to the experimenter.

    - size: px; scale: m/px at the height of the balls' centres; height: m; tilt: rad, about x, then y
    - distortion: OpenCV's k1, k2, p1, p2, k3
    - psf_sigma_px: Gaussian blur of the optics; defocus_px: radius of the disc of defocus
    - f_number: for diffraction, 0 for none; it needs pixel_pitch and wavelength, m
    - vignetting: share of the light that is lost in the corners
    - line_time: delay of a rolling shutter from row to row, s
    - colour: three channels, each with a chip of its own
    """

    size: Annotated[list[Annotated[int, Field(ge=16, le=8192)]], Field(min_length=2, max_length=2)] = Field([640, 480])
    scale: Positive = 1.6e-4
    height: Positive = 0.5
    tilt: Pair = Field([0.0, 0.0])
    distortion: Annotated[list[float], Field(min_length=5, max_length=5)] = [0.0] * 5
    psf_sigma_px: Annotated[float, Field(ge=0.3, le=10)] = 1.0
    defocus_px: Annotated[float, Field(ge=0, le=30)] = 0.0
    f_number: Annotated[float, Field(ge=0, le=64)] = 0.0
    pixel_pitch: Annotated[float, Field(ge=5e-7)] = 5e-6
    wavelength: Annotated[float, Field(gt=0, le=2e-6)] = 5.5e-7
    vignetting: Fraction = 0.0
    shutter: Literal["global", "rolling"] = "global"
    line_time: Positive = 1e-5
    colour: bool | None = None


class FlickerSettings(Settings):
    """`lamp.flicker:` light 1 + depth cos(2 pi frequency t + phase); mains light has twice the mains' frequency."""

    depth: Fraction = 0.0
    frequency: Positive = 100.0
    phase: float = 0.0


class OneLampSettings(Settings):
    """A disc of `radius`, a ring from `inner` to `radius`, or a bar of `length` by `width`, at `angle` to x; m, rad."""

    position: Position = Field([0.05, 0.0, 0.45])
    radius: Positive = 0.01
    shape: Literal["disc", "ring", "bar"] = "disc"
    inner: NotNegative = 0.0
    length: NotNegative = 0.0
    width: NotNegative = 0.0
    angle: float = 0.0
    facing: Literal["down", "centre"] = "down"
    flicker: FlickerSettings = FlickerSettings()


class SecondLampSettings(OneLampSettings):
    """`lamp.second:` a further lamp. radiance: relative to the first's."""

    radiance: Positive = 1.0


class SceneLampSettings(OneLampSettings):
    """`lamp:` by default a disc that faces down.

    - room: radiance of the surroundings that a mirror ball shows, over the peak of its glint
    - ambient: share of the light on the plate that the whole room sends; with `surface.ball` or `surface.plate`
    - second: a further lamp
    """

    room: NotNegative = 0.02
    ambient: Fraction | None = None
    second: SecondLampSettings | None = None


class SurfaceSettings(MaterialSettings):
    """`surface:` of balls and plate.

    - steel: a law of reflection, or a metal's n and k
    - roughness, scratch_slope, plate_roughness: rms slopes
    - scratches: share of a ball's light in the wider lobe
    - plate_gloss: reflectance
    - plate_texture: rms of the brightness; plate_grain: size of the grains, m
    """

    steel: Literal["schlick", "iron"] | Pair = "schlick"
    roughness: Annotated[float, Field(ge=0, le=0.3)] = 0.0
    scratches: Fraction = 0.0
    scratch_slope: Annotated[float, Field(gt=0, le=0.3)] = 0.1
    plate_gloss: Fraction = 0.0
    plate_roughness: Annotated[float, Field(ge=0.02, le=1)] = 0.2
    plate_texture: Annotated[float, Field(ge=0, le=0.3)] = 0.0
    plate_grain: Annotated[float, Field(ge=2e-5)] = 3e-4
    plate_shadow: bool = False


class SensorSettings(Settings):
    """`sensor:` the quantities of EMVA 1288.

    - gain: e-/count; read_noise, full_well, dsnu: e-; dark: e-/s; black_level: counts
    - glint_peak: counts above black at the peak of a resting ball's glint, before clipping
    - white: with `surface.ball` or `surface.plate` counts of a white plate at the origin, not glint_peak
    - hot_pixels: share of the pixels that leak; hot_dark: their mean dark current, e-/s
    """

    bits: Annotated[int, Field(ge=8, le=16)] = 8
    gain: Positive = 20.0
    read_noise: NotNegative = 20.0
    dark: NotNegative = 0.0
    full_well: Positive = 6000.0
    prnu: Fraction = 0.005
    dsnu: NotNegative = 4.0
    black_level: NotNegative = 8.0
    glint_peak: Positive = 200.0
    white: Positive | None = None
    hot_pixels: Fraction = 0.0
    hot_dark: NotNegative = 1e6


class VideoSettings(Settings):
    """`video:` a video beside the frames.

    - crf: of h264, 0 (best) to 51; q: of mjpeg, 1 (best) to 31
    - gamma: of the curve 255 (counts / white)^(1/gamma)
    - chroma: subsampling; ffv1 is lossless and has none
    """

    codec: Literal["h264", "mjpeg", "ffv1"] = "h264"
    crf: Annotated[int, Field(ge=0, le=51)] | None = None
    q: Annotated[int, Field(ge=1, le=31)] | None = None
    gamma: Annotated[float, Field(ge=0.2, le=5)] = 1.0
    chroma: Literal[420, 422, 444] | None = None

    @model_validator(mode="before")
    @classmethod
    def _fill_codec_defaults(cls, given: Any) -> Any:
        """Refuse keys that the codec does not have, and fill in the defaults of those that it has."""
        if not isinstance(given, dict):
            return given
        codec = given.get("codec", "h264")
        own = {"h264": {"crf": 23, "chroma": 420}, "mjpeg": {"q": 3, "chroma": 420}}.get(codec, {})
        for key in ("crf", "q", "chroma"):
            if given.get(key) is not None and key not in own:
                raise ValueError(f"{codec} has no {key}")
        return own | given


def find_video_problem(how: dict[str, Any], size: Sequence[int], fps: float) -> str:
    """Say why the video of an apparatus cannot be: its codec takes no pictures of this size and rate; '' if it can."""
    if how["codec"] == "ffv1" and fps > MAX_AVI_FPS:
        return f"expected at most {MAX_AVI_FPS} frames a second for ffv1, found {fps:g}"
    if how["codec"] == "h264" and how["chroma"] != 444 and any(side % 2 for side in size):
        return f"expected even sizes for h264 of chroma {how['chroma']}, found {size[0]} x {size[1]}; 444 takes any"
    return ""


def build_camera(drawn: dict[str, Any], ball_radius: float) -> PinholeCamera:
    """Build the nominal camera of an apparatus from checked settings."""
    camera, timing = drawn["camera"], drawn["timing"]
    same = ("scale", "height", "tilt", "distortion", "psf_sigma_px", "defocus_px", "vignetting")
    return PinholeCamera.overhead(
        size=tuple(camera["size"]),
        ball_radius=ball_radius,
        **{key: camera[key] for key in same},
        fps=timing["fps"],
        exposure=timing["exposure"],
        airy_px=camera["wavelength"] * camera["f_number"] / camera["pixel_pitch"],
        line_time=camera["line_time"] if camera["shutter"] == "rolling" else 0.0,
    )


def build_lamp(settings: dict[str, Any]) -> Lamp:
    """Build the lamp of an apparatus from checked settings. Raises ValueError for a lamp without area."""
    values = {k: v for k, v in settings.items() if k not in ("room", "ambient", "facing", "second")}
    values |= {"position": np.array(values["position"]), "flicker": Flicker(**values["flicker"])}
    towards = np.zeros(3) if settings["facing"] == "centre" else None
    second = settings.get("second")
    return Lamp(**values, towards=towards, second=build_lamp(second) if second else None)


def build_surface(settings: dict[str, Any]) -> Surface:
    """Build the surfaces of an apparatus from checked settings."""
    steel = settings["steel"]
    law = {"schlick": None, "iron": IRON_N_K}[steel] if isinstance(steel, str) else (steel[0], steel[1])
    own = {k: v for k, v in settings.items() if k not in MaterialSettings.model_fields}
    return Surface(**own | {"steel": law})


def camera_json(nominal: PinholeCamera, drawn: dict[str, Any]) -> dict[str, Any]:
    """Make the keys of camera.json: the experimenter's knowledge of camera, lamp and sensor, and the launched ball."""
    known: dict[str, Any] = {
        **{key: getattr(nominal, key).tolist() for key in ("K", "dist", "R", "t")},
        "size": list(nominal.size),
        **{key: getattr(nominal, key) for key in ("fps", "exposure", "scale")},
        "ball_diameter": drawn["ball"]["diameter"],
        **({} if drawn.get("launches") else {"striker": drawn["launch"]["striker"]}),
        "lamp": {"position": list(drawn["lamp"]["position"]), "radius": drawn["lamp"]["radius"]},
        "psf": {"sigma_px": nominal.psf_sigma_px},
        "sensor": {k: v for k, v in drawn["sensor"].items() if k not in (*HIDDEN_KEYS, "hot_pixels", "hot_dark")},
    }
    if is_under_room_light(drawn):
        surface = drawn["surface"]
        known["ball"] = {"finish": surface.get("ball", "steel")} | {k: surface[k] for k in ("colour",) if k in surface}
    if drawn.get("video"):
        known["video"] = dict(drawn["video"])
    # By section, the settings that differ from a plain camera under a plain lamp.
    camera = drawn["camera"]
    unusual = {
        "psf": {k: camera[k] for k in ("defocus_px",) if camera[k]},
        "lens": {k: camera[k] for k in ("vignetting",) if camera[k]},
        "shutter": {"kind": "rolling", "line_time": camera["line_time"]} if camera["shutter"] == "rolling" else {},
    }
    if camera["f_number"]:
        unusual["psf"] |= {k: camera[k] for k in ("f_number", "pixel_pitch", "wavelength")}
    for section, kind in (("lamp", SceneLampSettings), ("surface", SurfaceSettings), ("sensor", SensorSettings)):
        usual = kind.model_validate({}).model_dump(exclude_none=True)
        given = {k: v for k, v in drawn[section].items() if k not in HIDDEN_KEYS}
        unusual[section] = {k: v for k, v in given.items() if v != usual.get(k)}
    for section, values in unusual.items():
        if values:
            known[section] = known.get(section, {}) | values
    return known
