"""Scenes of many bodies: what they are, how each starts, what carries them, and the walls between which they move."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from synthcam.dynamics.contacts.walls import Rim, StraightWall, Wall
from synthcam.dynamics.kinematics import plate_state, push_share
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.supports import Air, DryPlate, Support
from synthcam.dynamics.table import Scatter, Table
from synthcam.model import Ball, Bodies, Model
from synthcam_shared.errors import InputError
from synthcam_shared.settings import Fraction, NotNegative, Positive, Settings

INERTIA = {"solid": 2 / 5, "shell": 2 / 3, "disc": 1 / 2}  # I/(m R^2)
MAX_BODIES = 20_000
# m, or m/s
Point = Annotated[list[Annotated[float, Field(ge=-1e3, le=1e3)]], Field(min_length=2, max_length=2)]


class SupportSettings(Settings):
    """`support:` carries the bodies.

    - plate: they slide and roll by the laws of `model`
    - air: discs glide, v' = -(decel + drag v) v/|v| + curl z x v; spin_drag: rate at which the spin decays, 1/s
    - dry: discs slide and turn with the sliding friction of `model`, under an even pressure
    """

    kind: Literal["plate", "air", "dry"] = "plate"
    decel: NotNegative = 0.0
    drag: NotNegative = 0.0
    curl: Annotated[float, Field(ge=-1e3, le=1e3)] = 0.0
    spin_drag: NotNegative = 0.0


class BodySettings(Settings):
    """One of `bodies:`, or the kind of all.

    - diameter, m, and density, kg/m^3: those of `ball` if left out; or mass, kg
    - shape: solid or shell, balls; disc, of the given height, m
    - inertia: I/(m R^2); default: the shape's
    - label: a or b, the ball that effects such as mass_mismatch act on, or not
    - support: default: the scene's
    """

    diameter: Positive | None = None
    density: Positive | None = None
    mass: Positive | None = None
    shape: Literal["solid", "shell", "disc"] = "solid"
    inertia: Annotated[float, Field(gt=0, le=1)] | None = None
    label: Literal["a", "b"] = "b"
    support: SupportSettings | None = None


class BodyLaunchSettings(Settings):
    """One of `launches:`, the state of a body at time 0.

    - position: of the centre, m; velocity, m/s
    - slip: velocity of the lowest point, m/s; 0 rolls; for balls on the plate
    - spin: about the vertical, rad/s
    - height: of the lowest point above the plate, m; rise: vertical velocity, m/s
    """

    position: Point
    velocity: Point = Field([0.0, 0.0])
    slip: Point = Field([0.0, 0.0])
    spin: float = 0.0
    height: NotNegative = 0.0
    rise: float = 0.0


class WallSettings(Settings):
    """One of `walls:`, a segment from `start` to `end`, or a rim about `centre` with a `radius`, m.

    - inside: whether the bodies are inside the rim
    - restitution; friction, Coulomb's coefficient; tangential_restitution, where the contact sticks
    - height: at which the wall touches balls, m; default: that of their centres
    """

    start: Point | None = None
    end: Point | None = None
    centre: Point | None = None
    radius: Positive | None = None
    inside: bool = True
    restitution: Fraction = 0.8
    friction: NotNegative = 0.2
    tangential_restitution: Annotated[float, Field(ge=-1, le=1)] = 0.0
    height: Positive | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        straight = self.start is not None and self.end is not None
        rim = self.centre is not None and self.radius is not None
        halves = sum(x is not None for x in (self.start, self.end, self.centre, self.radius))
        if straight == rim or halves != 2:
            raise ValueError("expected start and end, or centre and radius")
        if straight and self.start == self.end:
            raise ValueError(f"a wall from {self.start} to {self.end} has no length; expected two points")
        return self


class ScatterSettings(Settings):
    """`scatter:` how contacts of bodies differ by chance: standard deviations of normal distributions.

    - restitution: of r
    - friction: of the factor on the tangential impulse
    - normal: of the angle by which the normal is turned about the vertical, rad
    """

    restitution: Annotated[float, Field(ge=0, le=1)] = 0.0
    friction: Annotated[float, Field(ge=0, le=1)] = 0.0
    normal: Annotated[float, Field(ge=0, le=0.5)] = 0.0


class ManyBodiesSettings(Settings):
    """The sections of a scene of many bodies; without `launches` the scene has one pair, or one ball."""

    bodies: BodySettings | Annotated[list[BodySettings], Field(min_length=1)] = BodySettings()
    launches: Annotated[list[BodyLaunchSettings], Field(min_length=1, max_length=MAX_BODIES)] | None = None
    walls: Annotated[list[WallSettings], Field(max_length=1000)] = Field([])
    support: SupportSettings = SupportSettings()
    scatter: ScatterSettings = ScatterSettings()
    contact_duration: NotNegative = 1e-5  # s; bounds sequences of impacts without end


def build_table(model: Model, drawn: dict[str, Any], seed: tuple[int, int], where: str) -> tuple[Launch, Table]:
    """Build the launch of a scene's bodies and the table that they move on; seed: of the scatter of contacts.

    Raises InputError where bodies overlap or lie in a wall or beyond it, and where their numbers differ.
    """
    launches, kinds = drawn["launches"], drawn["bodies"]
    kinds = kinds if isinstance(kinds, list) else [kinds] * len(launches)
    if len(kinds) != len(launches):
        raise InputError(
            f"{where}: bodies: {len(kinds)} of them and {len(launches)} launches; expected as many, or one"
        )
    bodies = _build_bodies(model, kinds)
    supports = tuple(_build_support(model, kind.get("support") or drawn["support"]) for kind in kinds)
    walls = tuple(_build_wall(wall) for wall in drawn["walls"])
    states = np.array([_state(one, *body) for one, *body in zip(launches, bodies.radius, bodies.inertia, strict=True)])
    for k, (launch, kind, support) in enumerate(zip(launches, kinds, supports, strict=True)):
        flat = support is not None or kind["shape"] == "disc"
        if flat and isinstance(support, DryPlate) and bodies.inertia[k] != INERTIA["disc"]:
            raise InputError(f"{where}: bodies: body {k} is on a dry support; expected a disc of even density")
        if support is None and kind["shape"] == "disc":
            raise InputError(f"{where}: bodies: disc {k} is on a plate of balls; expected support: air or dry")
        if flat and (any(launch["slip"]) or launch["height"] or launch["rise"]):
            raise InputError(f"{where}: launches.{k}: slip, height and rise are of balls on the plate; expected 0")
        if flat:
            states[k, 6:8] = 0.0
    _check_places(states, bodies, walls, where)
    return Launch(0.0, states, bodies), Table(
        walls, supports, drawn["contact_duration"], Scatter(**drawn["scatter"], seed=seed)
    )


def _build_bodies(model: Model, kinds: list[dict[str, Any]]) -> Bodies:
    bodies = model.bodies([kind["label"] for kind in kinds])
    radius, mass = bodies.radius.copy(), bodies.mass.copy()
    for k, kind in enumerate(kinds):
        ball = Ball(kind.get("diameter") or model.ball.diameter, kind.get("density") or model.ball.density)
        # effects on radius and mass, such as a mismatch, act by the same factor
        radius[k] *= ball.radius / model.ball.radius
        mass[k] *= (kind.get("mass") or ball.mass) / model.ball.mass
    inertia = np.array([kind.get("inertia") or INERTIA[kind["shape"]] for kind in kinds])
    return Bodies(radius, mass, bodies.of_a, inertia)


def _build_support(model: Model, settings: dict[str, Any]) -> Support | None:
    if settings["kind"] == "plate":
        return None
    if settings["kind"] == "dry":
        return DryPlate(model.sliding_friction * model.gravity)
    return Air(**{name: value for name, value in settings.items() if name != "kind"})


def _build_wall(settings: dict[str, Any]) -> Wall:
    law: dict[str, Any] = {k: settings.get(k) for k in ("restitution", "friction", "tangential_restitution", "height")}
    if settings.get("start"):
        return StraightWall(**law, start=tuple(settings["start"]), end=tuple(settings["end"]))
    return Rim(**law, centre=tuple(settings["centre"]), radius=settings["radius"], inside=settings["inside"])


def _state(launch: dict[str, Any], radius: float, inertia: float) -> NDArray[np.float64]:
    velocity, slip = np.array(launch["velocity"]), np.array(launch["slip"])
    q = velocity - (1 - push_share(inertia)) * slip
    state = plate_state(np.array(launch["position"]), q, slip, launch["spin"], radius, inertia)
    state[2], state[3:5], state[5] = radius + launch["height"], velocity, launch["rise"]
    return state


def _check_places(states: NDArray[np.float64], bodies: Bodies, walls: tuple[Wall, ...], where: str) -> None:
    """Raises InputError where bodies overlap, or are in a wall or on the wrong side of closed walls."""
    from scipy.spatial import cKDTree

    tolerance, radius = 1e-9 * bodies.radius.min(), bodies.radius
    tree = cKDTree(states[:, :3])
    for i, j in sorted(tree.query_pairs(2 * radius.max(), output_type="set")):
        depth = radius[i] + radius[j] - np.linalg.norm(states[i, :3] - states[j, :3])
        if depth > tolerance:
            raise InputError(
                f"{where}: launches: bodies {i} and {j} overlap by {depth:.3g} m; expected none to overlap"
            )
    loop = _closed_loop(walls)
    for k, (x, y) in enumerate(states[:, :2].tolist()):
        for number, wall in enumerate(walls):
            far, _, _ = wall.distance(x, y)
            if abs(wall.rise(radius[k])) >= 1:
                raise InputError(
                    f"{where}: walls.{number}.height: expected a height within body {k}, 0 to {2 * radius[k]:g} m"
                )
            if far < wall.reach(radius[k]) - tolerance:
                side = "in" if far > -radius[k] else "beyond"
                raise InputError(
                    f"{where}: launches.{k}: the body is {side} wall {number}; expected it clear of the walls"
                )
        if loop is not None and not _is_inside(x, y, loop):
            raise InputError(f"{where}: launches.{k}: the body is outside the walls; expected it inside")


def _closed_loop(walls: tuple[Wall, ...]) -> NDArray[np.float64] | None:
    """Return the corners (n, 2) of the walls where all are straight and each begins where the one before ends."""
    if len(walls) < 3 or not all(isinstance(w, StraightWall) for w in walls):
        return None
    starts = np.array([w.start for w in walls if isinstance(w, StraightWall)])
    ends = np.array([w.end for w in walls if isinstance(w, StraightWall)])
    return starts if np.allclose(np.roll(starts, -1, axis=0), ends) else None


def _is_inside(x: float, y: float, corners: NDArray[np.float64]) -> bool:
    """Tell whether a point is in a polygon: how often the walls turn about it."""
    angles = np.arctan2(corners[:, 1] - y, corners[:, 0] - x)
    steps = np.diff(np.append(angles, angles[0]))
    return bool(abs(np.sum((steps + math.pi) % (2 * math.pi) - math.pi)) > math.pi)
