"""The materials of matte balls and of plates under room light, as a scene's `surface` names them."""

from collections.abc import Sequence
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from synthcam.camera.room.finish import GREY_WEIGHTS, BallFinish, Colour, Pattern, SurfaceFinish
from synthcam.camera.surface import Surface
from synthcam_shared.arrays import Array
from synthcam_shared.errors import InputError
from synthcam_shared.settings import Fraction, NotNegative, Settings

REFLECTANCE_OF_COLOUR = {  # of red, green and blue light, over that of the brightest; not a screen's colours
    "white": (1.0, 0.97, 0.9),
    "grey": (0.5, 0.5, 0.5),
    "black": (0.04, 0.04, 0.04),
    "red": (0.75, 0.05, 0.05),
    "orange": (0.95, 0.35, 0.04),
    "yellow": (1.0, 0.7, 0.05),
    "green": (0.06, 0.4, 0.14),
    "blue": (0.05, 0.16, 0.6),
    "brown": (0.35, 0.18, 0.08),
    "pink": (1.0, 0.45, 0.5),
}
ColourName = Literal["white", "grey", "black", "red", "orange", "yellow", "green", "blue", "brown", "pink"]
ColourSetting = ColourName | Annotated[list[Fraction], Field(min_length=3, max_length=3)]


class BallFinishSettings(Settings):
    """A matte ball.

    - albedo: factor on both colours
    - colour: a name, or the reflectance of red, green and blue
    - second_colour: the other colour of the pattern
    - pattern: see `BallFinish`
    """

    albedo: Fraction | None = None
    colour: ColourSetting | None = None
    second_colour: ColourSetting | None = None
    pattern: Literal["plain", "half", "stripe", "spots"] | None = None


class MaterialSettings(BallFinishSettings):
    """Keys of `surface:` for balls and plates under room light.

    - gloss: reflectance of the balls' varnish at normal incidence; 0: none
    - b: the keys in which ball b differs
    - plate_contrast: factor on the relief of the plate's texture
    """

    ball: Literal["steel", "matte"] | None = None
    gloss: Annotated[float, Field(ge=0, le=0.2)] | None = None
    b: BallFinishSettings | None = None
    plate: Literal["black", "plain", "cloth", "wood", "paper"] | None = None
    plate_albedo: Fraction | None = None
    plate_colour: ColourSetting | None = None
    plate_contrast: Annotated[NotNegative, Field(le=3)] | None = None


class ScreenColours(NamedTuple):
    """The colours of a matte body on a screen: red, green and blue, 0 to 1."""

    main: tuple[float, ...]
    second: tuple[float, ...] | None = None  # of its pattern


def is_under_room_light(drawn: dict[str, Any]) -> bool:
    """Tell whether a scene is lit by a room: it has matte balls or a plate of some material."""
    return bool(drawn["surface"].get("ball") or drawn["surface"].get("plate"))


def build_finish(
    drawn: dict[str, Any], labels: Sequence[str], where: str, kinds: Sequence[dict[str, Any]] = ()
) -> SurfaceFinish | None:
    """Build the materials of balls with these labels and of their plate; None for mirror balls on a black plate.

    kinds: of the bodies of a scene that lists them.
    """
    surface = drawn["surface"]
    for k, kind in enumerate(kinds):
        key = next((key for key in BallFinishSettings.model_fields if key in kind), None)
        if key and surface.get("ball") != "matte":
            raise InputError(f"{where}: bodies: {key} of body {k}: expected together with surface.ball: matte")
    of_rooms = [key for key in MaterialSettings.model_fields if key in surface]
    if not is_under_room_light(drawn):
        if of_rooms or "ambient" in drawn["lamp"] or "white" in drawn["sensor"]:
            key = f"surface.{of_rooms[0]}" if of_rooms else "lamp.ambient, sensor.white"
            raise InputError(f"{where}: {key}: expected together with surface.ball or surface.plate")
        return None
    for key in ("scratches", "plate_gloss", "plate_texture", "plate_shadow"):  # of mirrors on a black plate
        if surface[key]:
            raise InputError(f"{where}: surface.{key}: has no effect together with surface.ball or surface.plate")
    colour = bool(drawn["camera"].get("colour"))
    matte = surface.get("ball") == "matte"
    plate: Any = surface.get("plate", "black")
    of_plate = {  # of the brightest channel, and of red, green and blue over it
        "black": (0.04, (1.0, 1.0, 1.0)),
        "plain": (0.5, (1.0, 1.0, 1.0)),
        "cloth": (0.3, (0.13, 1.0, 0.35)),
        "wood": (0.5, (1.0, 0.62, 0.33)),
        "paper": (0.8, (1.0, 0.99, 0.96)),
    }
    albedo, tint = of_plate[plate]
    return SurfaceFinish(
        balls=tuple(_build_ball_finish(keys, matte, colour) for keys in _list_ball_settings(surface, labels, kinds)),
        plate=_reflect(surface.get("plate_albedo", albedo), surface.get("plate_colour", tint), colour),
        texture=plate if plate in ("cloth", "wood", "paper") else "plain",
        contrast=surface.get("plate_contrast", 1.0),
        ambient=drawn["lamp"].get("ambient", 0.35),
    )


def make_discs_matte(drawn: dict[str, Any], heights: Array, where: str) -> dict[str, Any]:
    """Return the drawn settings with matte bodies where there are discs. Raises InputError for discs of steel."""
    surface = drawn["surface"]
    if not heights.any() or surface.get("ball") == "matte":
        return drawn
    if surface.get("ball") == "steel":
        raise InputError(f"{where}: surface.ball: steel is of balls alone; expected matte for discs")
    return drawn | {"surface": surface | {"ball": "matte"}}


def list_screen_colours(
    drawn: dict[str, Any], labels: Sequence[str], kinds: Sequence[dict[str, Any]]
) -> tuple[ScreenColours | None, ...]:
    """List the colours of bodies on a screen; None of balls of steel. labels, kinds: as of `build_finish`."""
    if drawn["surface"].get("ball") != "matte":
        return (None,) * len(labels)
    out = []
    for keys in _list_ball_settings(drawn["surface"], labels, kinds):
        finish = _build_ball_finish(keys, True, True)
        main, second = (tuple(x ** (1 / 2.2) for x in colour) for colour in (finish.colour, finish.second))
        out.append(ScreenColours(main, None if finish.pattern == "plain" else second))
    return tuple(out)


def _list_ball_settings(
    surface: dict[str, Any], labels: Sequence[str], kinds: Sequence[dict[str, Any]]
) -> list[dict[str, Any]]:
    """List the settings of each body's surface: the scene's, those of ball b, and its own."""
    own = [{key: kind[key] for key in BallFinishSettings.model_fields if key in kind} for kind in kinds]
    return [
        surface | (surface.get("b", {}) if label == "b" else {}) | keys
        for label, keys in zip(labels, own or [{}] * len(labels), strict=True)
    ]


def build_varnish(surface: Surface, drawn: dict[str, Any]) -> Surface | None:
    """Build the mirror on the material of balls under room light: metal, or a varnish of glass with that `gloss`.

    A glass of index n reflects ((n - 1)/(n + 1))^2 at normal incidence.
    """
    if drawn["surface"].get("ball") != "matte":
        return surface
    gloss = np.sqrt(drawn["surface"].get("gloss", 0.04))
    return Surface(steel=((1 + gloss) / (1 - gloss), 0.0), roughness=surface.roughness) if gloss else None


def _build_ball_finish(surface: dict[str, Any], matte: bool, colour: bool) -> BallFinish:
    albedo = surface.get("albedo", 0.85) if matte else 0.0
    pattern: Pattern = surface.get("pattern", "plain") if matte else "plain"
    first, second = surface.get("colour", "white"), surface.get("second_colour", "red")
    return BallFinish(_reflect(albedo, first, colour), _reflect(albedo, second, colour), pattern)


def _reflect(albedo: float, given: str | Sequence[float], colour: bool) -> Colour:
    """Reflectance in each channel of a camera, three or one of a grey camera. given: a name, or red, green and blue."""
    whole = albedo * np.array(REFLECTANCE_OF_COLOUR[given] if isinstance(given, str) else given)
    return tuple(whole.tolist()) if colour else (float(whole @ GREY_WEIGHTS),)
