"""A clip: one experiment with all its numbers drawn. It can be solved and filmed, and has the truth."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from synthcam.camera.pinhole import Lamp, PinholeCamera
from synthcam.camera.room.finish import SurfaceFinish
from synthcam.camera.sensor import Sensor
from synthcam.camera.surface import Surface
from synthcam.dynamics.launch import SPIN_COLUMNS, Launch
from synthcam.model import Model, build
from synthcam.scene import ground_truth
from synthcam.scene.apparatus import build_camera, build_lamp, build_surface, camera_json, find_video_problem
from synthcam.scene.film_time import FilmedMotion
from synthcam.scene.materials import build_finish, build_varnish
from synthcam.scene.motion import Motion
from synthcam.scene.sensor_frames import Counts, OpticalSetup, expose_frames
from synthcam_shared.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

    from synthcam.dynamics.orientation import OrientationHistory

LABELS = {"a": ("b", "a"), "b": ("a", "b")}  # of ball 1 and ball 2, by the striker
UPSTREAM = 0.015 / 0.6  # s: at 0.6 m/s the contact lies 15 mm before the centre, so that the slide's end is in view


@dataclass(frozen=True, repr=False)
class Clip:
    """One drawn clip: everything that decides its frames.

    Attributes
    ----------
    number : int
        In its dataset. Sensor noise, and all that is drawn, follow from it and `seed`.
    drawn : dict
        The plain settings it came from, without distributions.
    model : Model
        Ball, base model and effects.
    launch : Launch
        The balls' states at one instant.
    nominal, camera : Camera
        The camera that the experimenter knows; the camera as it is, with the effects on it.
    lamp : Lamp
    surface : Surface
    sensor : Sensor
    frames : int
        How many.
    seed : int
        Of everything drawn.
    look : Look, optional
        Of matte balls, or of a plate with texture, under room light; None: mirrors on a black plate.

    Examples
    --------
    >>> import synthcam
    >>> clip = synthcam.Scene.read("oblique", timing={"frames": 40}).draw(seed=1)
    >>> clip
    Clip 0 of oblique: 2 balls, v0 0.385 m/s, b 0.41; 40 frames of 640 x 480 px at 250 a second
    >>> round(clip.truth["r"], 3)
    0.903
    """

    number: int
    drawn: dict[str, Any]
    model: Model
    launch: Launch
    nominal: PinholeCamera
    camera: PinholeCamera
    lamp: Lamp
    surface: Surface
    sensor: Sensor
    frames: int
    seed: int = 0
    look: SurfaceFinish | None = None

    def __repr__(self) -> str:
        launch, (width, height) = self.drawn["launch"], self.camera.size
        balls = len(self.launch.bodies.radius)
        thrown = f"v0 {launch['v0']:.3g} m/s" + (f", b {launch['b']:.3g}" if balls > 1 else "")
        film = f"{self.frames} frames of {width} x {height} px at {self.camera.fps:g} a second"
        return f"Clip {self.number} of {self.drawn['name']}: {balls} ball{'s' * (balls > 1)}, {thrown}; {film}"

    @property
    def room(self) -> float:
        """What a ball mirrors beside the lamp, over the glint's peak."""
        return float(self.drawn["lamp"]["room"])

    @cached_property
    def view(self) -> FilmedMotion:
        """The motion over all frames as the camera takes it: against film time, where clock and shutter have a part."""
        return FilmedMotion.solve(self.model, self.launch, self.camera, self.frames)

    def solve(self) -> Motion:
        """Solve the motion, exactly, for as long as the film lasts.

        Returns
        -------
        Motion
            States at any time, and all events.

        Raises
        ------
        ValueError
            Where the model has no motion for this launch.
        """
        return Motion(self.view.motion, self.camera.fps)

    def pictures(self) -> Iterator[Counts]:
        """Draw and expose the frames one after the other, for clips too long for memory.

        Yields
        ------
        ndarray
            (height, width), of a colour camera (height, width, 3): uint8, or uint16 above 8 bits; counts.

        Raises
        ------
        NoGL
            Where no OpenGL can draw; `synthcam doctor` says what to install.
        """
        mirror = build_varnish(self.surface, self.drawn) if self.look else None
        radii = self.launch.bodies.radius.tolist()
        seen = OpticalSetup(self.camera, self.lamp, radii, self.room, self.surface, self.look, mirror)
        colour = bool(self.drawn["camera"].get("colour"))
        return expose_frames(self.view, seen, self.sensor, self.frames, (self.seed, self.number), self.turning, colour)

    @cached_property
    def turning(self) -> OrientationHistory | None:
        """How the balls are turned, where a pattern shows it: at random as the motion starts."""
        if self.look is None or not self.look.shows_rotation:
            return None
        from scipy.spatial.transform import Rotation  # here alone: slow to load, and few balls have a pattern

        from synthcam.dynamics.orientation import OrientationHistory

        stream = np.random.SeedSequence(self.seed, spawn_key=(self.number, zlib.crc32(b"turning")))
        first = Rotation.random(len(self.launch.bodies.radius), rng=np.random.default_rng(stream))
        return OrientationHistory(self.view.motion, first.as_quat())

    def film(self) -> NDArray[Any]:
        """Draw and expose all frames: the same pixels as a dataset of this scene and seed has in ``frames.tif``.

        Returns
        -------
        ndarray
            (frames, height, width), of a colour camera (frames, height, width, 3): counts, uint8 or, above 8 bits,
            uint16.

        Raises
        ------
        NoGL
            Where no OpenGL can draw; `synthcam doctor` says what to install.

        Examples
        --------
        >>> import synthcam
        >>> small = {"size": [96, 64], "scale": 3e-4}
        >>> scene = synthcam.Scene.read("oblique", camera=small, timing={"frames": 2, "contact_frame": 1})
        >>> film = scene.draw(seed=1).film()
        >>> film.shape, film.dtype
        ((2, 64, 96), dtype('uint8'))
        """
        return np.stack(list(self.pictures()))

    @property
    def camera_json(self) -> dict[str, Any]:
        """What the experimenter knows, with the keys of ``camera.json``: what `tracker.track` takes."""
        return camera_json(self.nominal, self.drawn)

    @property
    def truth(self) -> dict[str, float]:
        """The scalars of the collision, SI, by the names of docs/format.md; NaN where nothing collides."""
        return ground_truth.scalars(self.model, self.launch, self.view.motion)

    @property
    def tracks(self) -> pd.DataFrame:
        """The true tracks, a row for each ball and frame, at mid-exposure.

        Columns: frame; t_s (s); particle (0: ball 1, the target); x_px, y_px and glint_x_px, glint_y_px (px); x, y, z
        (m); vx, vy, vz (m/s); wx, wy, wz (rad/s); x_mean_px, y_mean_px (px, means over the exposure); state (rest,
        roll, slide, fly); visible. For balls with a pattern qx, qy, qz, qw: the rotation from the ball's axes to the
        world's.
        """
        return ground_truth.tracks(self.launch.bodies, self.view, self.lamp, self.frames, self.turning)


def build_clip(number: int, drawn: dict[str, Any], seed: int = 0, where: str = "") -> Clip:
    """The clip of plain, checked settings. Raises InputError when they contradict each other."""
    model, where = build(drawn), where or drawn["name"]
    timing, launch, camera = drawn["timing"], drawn["launch"], drawn["camera"]
    for effect in model.effects:
        if effect.active and "measure" in effect.laws:
            raise InputError(f"{where}: effects.{effect.name()}: a defect of trackers; expected none in a scene")
    if timing["exposure"] > 1 / timing["fps"]:
        raise InputError(f"{where}: timing.exposure: expected at most 1/fps, {1 / timing['fps']:g} s")
    if camera["height"] <= 2 * model.ball.diameter:
        raise InputError(f"{where}: camera.height: expected more than two ball diameters ({model.ball.diameter:g} m)")
    if drawn["lamp"]["position"][2] <= 2 * model.ball.diameter:
        raise InputError(f"{where}: lamp.position: expected z above the balls")
    if drawn.get("video") and (problem := find_video_problem(drawn["video"], camera["size"], timing["fps"])):
        raise InputError(f"{where}: video: {problem}")
    try:
        lamp = build_lamp(drawn["lamp"])
    except ValueError as e:
        raise InputError(f"{where}: {str(e).replace(' ', '.', 1)}") from None
    nominal = build_camera(drawn, model.ball.radius)
    look = build_finish(drawn, _ball_labels(launch), where)
    sensor = {k: v for k, v in drawn["sensor"].items() if k != "white"}
    if look:
        sensor["glint_peak"] = drawn["sensor"].get("white", 200.0)
    return Clip(
        number=number,
        seed=seed,
        drawn=drawn,
        model=model,
        launch=_build_launch(model, launch, timing["contact_frame"] / timing["fps"]),
        nominal=nominal,
        camera=_apply_effects(model, nominal),
        lamp=lamp,
        surface=build_surface(drawn["surface"]),
        sensor=Sensor(**sensor),
        frames=timing["frames"],
        look=look,
    )


def _apply_effects(model: Model, nominal: PinholeCamera) -> PinholeCamera:
    bent: PinholeCamera = model.laws("camera", nominal, {})
    return replace(bent, exposure=float(model.laws("exposure", nominal.exposure, {"fps": nominal.fps})))


def _ball_labels(launch: dict[str, Any]) -> tuple[str, ...]:
    return (launch["striker"],) if launch["kind"] == "single" else LABELS[launch["striker"]]


def _build_launch(model: Model, launch: dict[str, Any], time: float) -> Launch:
    heading, v0, position = launch["heading"], launch["v0"], launch["contact"]
    if position == "upstream":
        position = -UPSTREAM * v0 * np.array([np.cos(heading), np.sin(heading)])
    bodies, spin = model.bodies(_ball_labels(launch)), [launch[name] for name in SPIN_COLUMNS]
    if launch["kind"] == "single":
        if any(spin):
            raise InputError(
                f"launch.{SPIN_COLUMNS[int(np.flatnonzero(spin)[0])]}: of a pair's striker; expected 0 of a single ball"
            )
        return Launch.single(bodies, time, v0, heading, position)
    return Launch.pair(bodies, time, v0, launch["b"], heading, position, spin)
