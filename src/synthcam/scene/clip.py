"""A clip: one experiment with all its numbers drawn. It can be solved and filmed, and has the truth."""

from __future__ import annotations

import pickle
import sys
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from synthcam.camera.pinhole import Lamp, PinholeCamera
from synthcam.camera.room.finish import SurfaceFinish
from synthcam.camera.sensor import Counts, Sensor, SensorChip
from synthcam.camera.surface import Surface
from synthcam.dynamics.launch import SPIN_COLUMNS, Launch
from synthcam.dynamics.orientation import OrientationHistory
from synthcam.dynamics.solve import PLATE
from synthcam.dynamics.tabletop import Table
from synthcam.dynamics.trajectory import Trajectory
from synthcam.model import Model, build_model
from synthcam.scene import ground_truth
from synthcam.scene.apparatus import build_camera, build_lamp, build_surface, camera_json, find_video_problem
from synthcam.scene.bodies import build_table, describe_bodies, find_heights, list_kinds
from synthcam.scene.film_time import FilmedMotion
from synthcam.scene.groups import place_groups
from synthcam.scene.materials import build_finish, build_varnish, list_screen_colours, make_discs_matte
from synthcam.scene.motion import Motion
from synthcam_shared.arrays import Array
from synthcam_shared.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

PIXELS_EXPOSED_AT_ONCE = 16 * 512 * 256
CONTACT_UPSTREAM_S = 0.015 / 0.6  # at 0.6 m/s, contact is 15 mm before the centre: the slide ends in view


@dataclass(frozen=True, repr=False)
class Clip:
    """A clip with all its numbers drawn: everything that decides its frames.

    Attributes
    ----------
    number : int
        Its number in the dataset. It and `seed` decide all that is random, sensor noise included.
    drawn : dict
        The settings of the clip, without distributions.
    model : Model
        Ball, base model and effects.
    launch : Launch
        The states of the balls at one instant.
    nominal : PinholeCamera
        The camera that the experimenter knows.
    camera : PinholeCamera
        The real camera, which differs from the nominal one by the effects.
    lamp : Lamp
    surface : Surface
    sensor : Sensor
    frames : int
        Their number.
    seed : int
        Of everything drawn.
    finish : SurfaceFinish, optional
        Of matte balls, or of a plate with texture, under room light. None: mirror balls on a black plate.
    table : Table
        Walls, and what carries each body.
    heights : ndarray
        (N,) m, of discs; 0 of balls.
    trajectory : Trajectory, optional
        The motion, if it is known already, as from a clip with another camera. None: it is solved when needed.

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
    finish: SurfaceFinish | None = None
    table: Table = PLATE
    heights: Array = field(default_factory=lambda: np.zeros(0))
    trajectory: Trajectory | None = None

    def __repr__(self) -> str:
        launch, (width, height) = self.drawn["launch"], self.camera.size
        balls = len(self.launch.bodies.radius)
        thrown = f", v0 {launch['v0']:.3g} m/s" + (f", b {launch['b']:.3g}" if balls > 1 else "")
        if self.drawn.get("launches"):
            thrown = f", {len(self.table.walls)} walls"
        film = f"{self.frames} frames of {width} x {height} px at {self.camera.fps:g} a second"
        return f"Clip {self.number} of {self.drawn['name']}: {balls} ball{'s' * (balls > 1)}{thrown}; {film}"

    @property
    def room(self) -> float:
        """Radiance of the surroundings that a mirror ball shows, over the peak of its glint."""
        return float(self.drawn["lamp"]["room"])

    @property
    def plate_z(self) -> float:
        """z of the plate, m: 0, or half a height below discs, whose centres are as high as those of balls."""
        return self.model.ball.radius - float(self.heights.max()) / 2 if self.heights.any() else 0.0

    @cached_property
    def view(self) -> FilmedMotion:
        """The motion over all frames in film time, with the effects of clock and shutter."""
        if self.trajectory:
            return FilmedMotion(self.model, self.camera, self.trajectory)
        return FilmedMotion.solve(self.model, self.launch, self.camera, self.frames, self.table)

    def solve(self) -> Motion:
        """Solve the motion exactly, for the duration of the film.

        Returns
        -------
        Motion
            States at any time, and all events.

        Raises
        ------
        ValueError
            If the model has no motion for this launch.
        """
        bodies, orientation = self.launch.bodies, self.orientation if self.heights.any() else None
        colours = list_screen_colours(self.drawn, bodies.labels, list_kinds(self.drawn))
        radius, walls = tuple(bodies.radius.tolist()), self.table.walls
        return Motion(self.view.motion, self.camera.fps, radius, walls, colours, orientation)

    def pictures(self, every: int = 1) -> Iterator[Counts]:
        """Render and expose the frames one after the other, for clips too long for memory.

        Parameters
        ----------
        every : int
            Yield every n-th frame only, from the first on. The others are not rendered.

        Yields
        ------
        ndarray
            (height, width), of a colour camera (height, width, 3): uint8, or uint16 above 8 bits; counts.

        Raises
        ------
        NoGL
            If no OpenGL can render; `synthcam doctor` says what to install.
        """
        return self._expose(range(0, self.frames, every))

    def sketch(self, k: int, *, quick: bool = False) -> Counts:
        """Render and expose one frame at once. Its sensor noise is that of `pictures`, but drawn otherwise.

        Parameters
        ----------
        k : int
            Its number, from 0 on.
        quick : bool
            Leave out the light that matte balls reflect to each other, and their images in each other's varnish.

        Returns
        -------
        ndarray
            Counts, as of `pictures`.
        """
        return next(self._expose(range(k, k + 1), by_tables=False, quick=quick))

    def _expose(self, frames: range, *, by_tables: bool = True, quick: bool = False) -> Iterator[Counts]:
        """Render and expose these frames.

        by_tables: draw the noise of the plate from tables, which take seconds to make; otherwise pixel by pixel, with
        other random numbers.
        """
        camera, colour = self.camera, bool(self.drawn["camera"].get("colour"))
        apart = 1 << 64  # the seeds of the three chips are further apart than any two seeds that a user may give
        seeds = (self.seed + c * apart for c in range(3 if colour else 1))
        chips = [_make_chip(self.sensor, camera.size, camera.exposure, seed) for seed in seeds]
        renderer = _make_renderer(self.finish is not None, pickle.dumps(self._list_optics(quick)))
        view = replace(self.view, camera=replace(camera, line_time=0.0))  # the renderer applies the delay of each row
        orientation = self.orientation

        def centres(t: Array) -> Array:
            return view.at(t)[:, :, :3].transpose(1, 0, 2) - [0, 0, self.plate_z]

        def rotations(t: Array) -> Array:
            times = view.times(t)
            if orientation is None:
                return np.broadcast_to(np.eye(3), (len(t), len(times), 3, 3))
            return np.stack([orientation.at(ball, own).as_matrix() for ball, own in enumerate(times)], axis=1)

        paths = (centres, rotations) if self.finish else (centres,)
        drawn = renderer.frames(*paths, view.spans(frames), view.breaks())
        # Frames of matte balls take long, and are exposed as soon as they are drawn.
        many = 1 if self.finish else max(1, PIXELS_EXPOSED_AT_ONCE // (camera.size[0] * camera.size[1]))
        for first in range(0, len(frames), many):
            some = frames[first : first + many]
            films = zip(*(p if isinstance(p, tuple) else (p,) * len(chips) for p in islice(drawn, many)), strict=True)
            exposed = [
                chip.expose_film(film if by_tables else [picture.image for picture in film], self.number, some)
                for chip, film in zip(chips, films, strict=True)
            ]
            yield from (np.stack(each, axis=-1) if colour else each[0] for each in zip(*exposed, strict=True))

    def _list_optics(self, quick: bool) -> dict[str, Any]:
        """The arguments of the renderer: everything that decides a picture, except noise and where the balls are."""
        camera, lamp, radii = replace(self.camera, camera_json={}), self.lamp, self.launch.bodies.radius.tolist()
        if not self.finish:
            unnoticed = 0.2 * self.sensor.noise / self.sensor.glint_peak  # changes no position and no brightness
            mirrors = {"room": self.room, "surface": self.surface, "faintest": unnoticed}
            return {"camera": camera, "lamp": lamp, "radii": radii} | mirrors
        if z := self.plate_z:  # the renderer's plate is at z = 0
            camera, lamp = replace(camera, t=camera.t + z * camera.R[:, 2]), _lower(lamp, z)
        mirror, heights = build_varnish(self.surface, self.drawn), self.heights.tolist()
        matte = {"finish": self.finish, "mirror": mirror, "heights": heights, "quick": quick}
        return {"camera": camera, "lamp": lamp, "radii": radii} | matte

    @cached_property
    def orientation(self) -> OrientationHistory | None:
        """The orientation of bodies with a pattern, which is random when the motion starts.

        The pattern's axis, z of a body, lies in the plane of a disc.
        """
        if self.finish is None or not self.finish.shows_rotation:
            return None
        stream = np.random.SeedSequence(self.seed, spawn_key=(self.number, zlib.crc32(b"turning")))
        rng = np.random.default_rng(stream)
        first = Rotation.random(len(self.launch.bodies.radius), rng=rng).as_quat()
        flat = self.heights > 0
        turns = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi, flat.sum())[:, None])
        first[flat] = (turns * Rotation.from_euler("y", np.pi / 2)).as_quat()
        return OrientationHistory(self.view.motion, first)

    def film(self) -> NDArray[Any]:
        """Render and expose all frames: the pixels of ``frames.tif`` in a dataset of this scene and seed.

        Returns
        -------
        ndarray
            (frames, height, width), of a colour camera (frames, height, width, 3): counts, uint8 or, above 8 bits,
            uint16.

        Raises
        ------
        NoGL
            If no OpenGL can render; `synthcam doctor` says what to install.

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
        """The experimenter's knowledge, with the keys of ``camera.json``; `tracker.track` takes it."""
        return camera_json(self.nominal, self.drawn) | describe_bodies(self.drawn)

    @property
    def truth(self) -> dict[str, float]:
        """The scalars of the collision, SI units, by the names of docs/format.md; NaN if nothing collides."""
        return ground_truth.make_true_scalars(self.model, self.launch, self.view.motion)

    @property
    def tracks(self) -> pd.DataFrame:
        """The true tracks: a row for each ball and frame, at mid-exposure.

        - frame; t_s: time, s; particle: 0 is ball 1 (the target)
        - x_px, y_px: centre; glint_x_px, glint_y_px: primary glint, NaN of discs; x_mean_px, y_mean_px: mean over the
          exposure
        - x, y, z: m; vx, vy, vz: m/s; wx, wy, wz: rad/s
        - state: rest, roll, slide, fly, glide or push; visible: the whole outline is in the picture
        - qx, qy, qz, qw, of balls with a pattern: the rotation from the ball's axes to the world's
        """
        import pandas as pd  # here alone: slow to load

        return pd.DataFrame(list_track_columns(self))

    @property
    def energy(self) -> pd.DataFrame:
        """The energy of all bodies at the middle of each exposure, and by what it went since the start, J.

        - frame; t_s: time, s; energy: of translation, spin and height
        - lost_in_contacts, lost_at_walls, lost_in_landings: in hits of bodies, walls and the plate
        - lost_by_sliding, lost_by_rolling, lost_in_air: during such motion
        - given_by_hand: by launches and pushes
        """
        import pandas as pd  # here alone: slow to load

        return pd.DataFrame(list_energy_columns(self))


def build_clip(number: int, drawn: dict[str, Any], seed: int = 0, where: str = "") -> Clip:
    """Build one clip from settings without distributions. Raises InputError if they contradict each other."""
    model, where = build_model(drawn), where or drawn["name"]
    _check_settings(model, drawn, where)
    timing, launch = drawn["timing"], drawn["launch"]
    try:
        lamp = build_lamp(drawn["lamp"])
    except ValueError as e:
        raise InputError(f"{where}: {str(e).replace(' ', '.', 1)}") from None
    if drawn.get("groups"):
        drawn = place_groups(model, drawn, (seed, number), where)
    heights = np.zeros(0 if drawn.get("launches") else 1 + (launch["kind"] == "pair"))
    if drawn.get("launches"):
        started, table = build_table(model, drawn, (seed, number), where)
        heights = find_heights(drawn, where)
        drawn = make_discs_matte(drawn, heights, where)
    else:
        started, table = _build_launch(model, launch, timing["contact_frame"] / timing["fps"]), PLATE
    nominal = build_camera(drawn, model.ball.radius)
    finish = build_finish(drawn, started.bodies.labels, where, list_kinds(drawn))
    sensor = {k: v for k, v in drawn["sensor"].items() if k != "white"}
    if finish:
        sensor["glint_peak"] = drawn["sensor"].get("white", 200.0)
    return Clip(
        number=number,
        seed=seed,
        drawn=drawn,
        model=model,
        launch=started,
        table=table,
        nominal=nominal,
        camera=replace(
            model.laws("camera", nominal, {}),
            exposure=float(model.laws("exposure", nominal.exposure, {"fps": nominal.fps})),
            camera_json=camera_json(nominal, drawn) | describe_bodies(drawn),
        ),
        lamp=lamp,
        surface=build_surface(drawn["surface"]),
        sensor=Sensor(**sensor),
        frames=timing["frames"],
        finish=finish,
        heights=heights,
    )


def _check_settings(model: Model, drawn: dict[str, Any], where: str) -> None:
    """Raise InputError where settings that are right by themselves contradict each other."""
    timing, camera = drawn["timing"], drawn["camera"]
    for effect in model.effects:
        if effect.active and "measure" in effect.laws:
            raise InputError(f"{where}: effects.{effect.name()}: a defect of trackers, expected none in a scene")
    if timing["exposure"] > 1 / timing["fps"]:
        raise InputError(f"{where}: timing.exposure: expected at most 1/fps, {1 / timing['fps']:g} s")
    if camera["height"] <= 2 * model.ball.diameter:
        raise InputError(f"{where}: camera.height: expected more than two ball diameters ({model.ball.diameter:g} m)")
    if drawn["lamp"]["position"][2] <= 2 * model.ball.diameter:
        raise InputError(f"{where}: lamp.position: expected z above the balls")
    if drawn.get("video") and (problem := find_video_problem(drawn["video"], camera["size"], timing["fps"])):
        raise InputError(f"{where}: video: {problem}")


def list_track_columns(clip: Clip) -> ground_truth.Columns:
    """List the columns of `Clip.tracks`, which takes half the time of a table."""
    bodies, turning = clip.launch.bodies, clip.orientation
    return ground_truth.list_true_tracks(bodies, clip.view, clip.lamp, clip.frames, turning, heights=clip.heights)


def list_energy_columns(clip: Clip) -> ground_truth.Columns:
    """List the columns of `Clip.energy`."""
    motion = clip.view.motion
    times = np.clip(clip.view.spans(clip.frames).mean(axis=1), motion.t0, motion.t1)
    return ground_truth.list_true_energies(clip.launch.bodies, motion, times, clip.model.gravity)


def _build_launch(model: Model, launch: dict[str, Any], time: float) -> Launch:
    heading, v0, position, striker = (launch[key] for key in ("heading", "v0", "contact", "striker"))
    if position == "upstream":
        position = -CONTACT_UPSTREAM_S * v0 * np.array([np.cos(heading), np.sin(heading)])
    if launch["kind"] == "single":
        if spins := [name for name in SPIN_COLUMNS if launch[name]]:
            raise InputError(f"launch.{spins[0]}: of a pair's striker; expected 0 of a single ball")
        return Launch.single(model.bodies(striker), time, v0, heading, position)
    bodies = model.bodies(("b" if striker == "a" else "a") + striker)
    return Launch.pair(bodies, time, v0, launch["b"], heading, position, [launch[name] for name in SPIN_COLUMNS])


@lru_cache(maxsize=2)
def _make_renderer(matte: bool, optics: bytes) -> Any:
    """The renderer of all clips with one setup: its plate and its unit take as long as ten frames.

    optics: its arguments, pickled, because arrays have no hash.
    """
    if matte:
        from synthcam.camera.room.room_renderer import RoomRenderer

        return RoomRenderer(**pickle.loads(optics))
    from synthcam.camera.render import MirrorRenderer  # here alone: everything else works without OpenGL

    return MirrorRenderer(**pickle.loads(optics))


def has_opengl_started() -> bool:
    """Tell whether OpenGL may have started in this process, by any library; it must not be copied then."""
    return not sys.modules.keys().isdisjoint({"synthcam.camera.render", "OpenGL"})


def _lower(lamp: Lamp, by: float) -> Lamp:
    second = _lower(lamp.second, by) if lamp.second else None
    return replace(lamp, position=lamp.position - [0, 0, by], second=second)


# of all clips of a camera: its fixed pattern takes as long to draw as many frames
_make_chip = lru_cache(maxsize=6)(SensorChip)
