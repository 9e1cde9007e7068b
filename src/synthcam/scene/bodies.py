"""Scenes of many bodies: what they are, how each starts, what carries them, and the walls between which they move."""

import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from synthcam.dynamics.contacts.lasting import ContactSpring
from synthcam.dynamics.contacts.walls import Rim, StraightWall, Wall
from synthcam.dynamics.kinematics import plate_state, push_share
from synthcam.dynamics.launch import LaterLaunch, Launch
from synthcam.dynamics.supports import Air, DryPlate, Support
from synthcam.dynamics.tabletop import ContactScatter, Table
from synthcam.model import Ball, Bodies, Model
from synthcam.scene.materials import BallFinishSettings
from synthcam_shared.arrays import Array, Flags, Index
from synthcam_shared.errors import InputError
from synthcam_shared.settings import Fraction, NotNegative, Positive, Settings

INERTIA = {"solid": 2 / 5, "shell": 2 / 3, "disc": 1 / 2}  # I/(m R^2)
MAX_BODIES, MAX_WALLS = 20_000, 1000
# m, or m/s
Point = Annotated[list[Annotated[float, Field(ge=-1e3, le=1e3)]], Field(min_length=2, max_length=2)]


def _check_order(limits: list[float]) -> list[float]:
    if limits[0] > limits[1]:
        raise ValueError("expected low before high")
    return limits


def _check_not_negative(limits: list[float]) -> list[float]:
    if limits[0] < 0:
        raise ValueError("expected no number below 0")
    return limits


Range = Annotated[Point, AfterValidator(_check_order)]


class SupportSettings(Settings):
    """`support:` carries the bodies.

    - plate: they slide and roll by the laws of `model`
    - air: discs glide, v' = -(decel + drag v) v/|v| + curl z x v; spin_drag: rate at which the spin decays, 1/s
    - decel_range, curl_range: of air, limits between which decel and curl are drawn for each stretch between two hits
    - dry: discs slide and turn with the sliding friction of `model`, under an even pressure
    """

    kind: Literal["plate", "air", "dry"] = "plate"
    decel: NotNegative = 0.0
    drag: NotNegative = 0.0
    curl: Annotated[float, Field(ge=-1e3, le=1e3)] = 0.0
    spin_drag: NotNegative = 0.0
    decel_range: Annotated[Range, AfterValidator(_check_not_negative)] | None = None
    curl_range: Range | None = None


class BodySettings(BallFinishSettings):
    """One of `bodies:`, or the kind of all.

    - diameter, m, and density, kg/m^3: those of `ball` if left out; or mass, kg
    - shape: solid or shell, balls; or disc
    - height: of discs, m; default: a quarter of the ball's diameter, or with balls beside them the whole
    - inertia: I/(m R^2); default: the shape's
    - label: a or b, the ball that effects such as mass_mismatch act on, or not
    - support: default: the scene's
    - sticks: of discs, the impulse, N s, of a later hit that parts it from a body that it has hit; 0: it does not stick
    - albedo, colour, second_colour, pattern: in place of those of `surface`, for matte bodies
    """

    diameter: Positive | None = None
    density: Positive | None = None
    mass: Positive | None = None
    shape: Literal["solid", "shell", "disc"] = "solid"
    height: Positive | None = None
    inertia: Annotated[float, Field(gt=0, le=1)] | None = None
    label: Literal["a", "b"] = "b"
    support: SupportSettings | None = None
    sticks: NotNegative = 0.0


class PushSettings(Settings):
    """A hand that pushes a body from its launch on with an acceleration, m/s^2, until a time, s, or its next hit."""

    until: Positive
    acceleration: Point


class BodyLaunchSettings(Settings):
    """One of `launches:`, the state of a body at a time, s; until then it rests there, unless it is hit.

    - position: of the centre at time 0, m; velocity, m/s
    - slip: velocity of the lowest point, m/s; 0 rolls; for balls on the plate
    - spin: about the vertical, rad/s
    - height: of the lowest point above the plate, m, at time 0; rise: vertical velocity, m/s
    - push: how a hand pushes it from then on
    """

    position: Point
    velocity: Point = Field([0.0, 0.0])
    slip: Point = Field([0.0, 0.0])
    spin: Annotated[float, Field(ge=-1e5, le=1e5)] = 0.0
    height: Annotated[float, Field(ge=0, le=1e3)] = 0.0
    rise: Annotated[float, Field(ge=-1e3, le=1e3)] = 0.0
    time: NotNegative = 0.0
    push: PushSettings | None = None

    @model_validator(mode="after")
    def _can_be(self) -> Self:
        if self.height and self.time:
            raise ValueError("height: of a launch at time 0; expected 0 with a later time")
        if self.push and self.push.until <= self.time:
            raise ValueError(f"push.until: expected a time after the launch, {self.time:g} s")
        if self.push and (self.height or self.rise):
            raise ValueError("push: of a body on its plate; expected no height and no rise with it")
        return self


class WallSettings(Settings):
    """One of `walls:`, a segment from `start` to `end`, or a rim about `centre` with a `radius`, m.

    - inside: whether the bodies are inside the rim
    - restitution; friction, Coulomb's coefficient; tangential_restitution, where the contact sticks
    - height: at which the wall touches balls, m; default: that of their centres
    - cushion: the law of the impact, han or mathavan
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
    cushion: Literal["han", "mathavan"] = "han"

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        straight = self.start is not None and self.end is not None
        rim = self.centre is not None and self.radius is not None
        halves = sum(x is not None for x in (self.start, self.end, self.centre, self.radius))
        if straight == rim or halves != 2:
            raise ValueError("expected start and end, or centre and radius")
        if straight and self.start == self.end:
            raise ValueError(f"a wall from {self.start} to {self.end} has no length; expected two points")
        if self.cushion == "mathavan" and self.tangential_restitution:
            raise ValueError("tangential_restitution: of the law han; expected 0 with mathavan")
        return self


class ScatterSettings(Settings):
    """`scatter:` how contacts of bodies differ by chance: standard deviations of normal distributions.

    - restitution: of r
    - friction: of the factor on the tangential impulse
    - normal: of the angle by which the normal is turned about the vertical, rad
    - distance: of the distance of the centres, over the sum of the radii
    """

    restitution: Annotated[float, Field(ge=0, le=1)] = 0.0
    friction: Annotated[float, Field(ge=0, le=1)] = 0.0
    normal: Annotated[float, Field(ge=0, le=0.5)] = 0.0
    distance: Annotated[float, Field(ge=0, le=0.1)] = 0.0


class ContactForceSettings(Settings):
    """`contact_force:` a spring and a damper between bodies in contact; without it, contacts take no time.

    - law: linear, with the duration of a contact, s; or hertz, with the modulus E*, Pa
    """

    law: Literal["linear", "hertz"] = "linear"
    duration: Positive | None = None
    modulus: Positive | None = None

    @model_validator(mode="after")
    def _one_number(self) -> Self:
        if (self.law == "linear") != (self.duration is not None) or (self.law == "hertz") != (self.modulus is not None):
            raise ValueError("expected law: linear with a duration, or law: hertz with a modulus")
        return self


class ManyBodiesSettings(Settings):
    """The sections of a scene of many bodies; without `launches` the scene has one pair, or one ball."""

    bodies: BodySettings | Annotated[list[BodySettings], Field(min_length=1)] = BodySettings()
    launches: Annotated[list[BodyLaunchSettings], Field(min_length=1, max_length=MAX_BODIES)] | None = None
    walls: Annotated[list[WallSettings], Field(max_length=MAX_WALLS)] = Field([])
    support: SupportSettings = SupportSettings()
    scatter: ScatterSettings = ScatterSettings()
    contact_duration: Annotated[float, Field(ge=0, le=1e-2)] = 1e-5  # s; bounds sequences of impacts without end
    contact_force: ContactForceSettings | None = None


def build_table(model: Model, drawn: dict[str, Any], seed: tuple[int, int], where: str) -> tuple[Launch, Table]:
    """Build the launch of a scene's bodies and the table that they move on; seed: of the scatter of contacts.

    Raises InputError where bodies overlap or lie in a wall or beyond it, and where their numbers differ.
    """
    launches, kinds = drawn["launches"], list_kinds(drawn)
    check_counts(kinds, launches, where)
    bodies = _build_bodies(model, kinds)
    supports = tuple(_build_support(model, **(kind.get("support") or drawn["support"])) for kind in kinds)
    walls = tuple(_build_wall(**wall) for wall in drawn["walls"])
    sticks, force = tuple(float(kind["sticks"]) for kind in kinds), drawn.get("contact_force")
    _check_cushions(walls, supports, where)
    states = np.array([_state(one, *body) for one, *body in zip(launches, bodies.radius, bodies.inertia, strict=True)])
    for k, (launch, kind, support) in enumerate(zip(launches, kinds, supports, strict=True)):
        if support is None and kind["shape"] == "disc":
            raise InputError(f"{where}: bodies: disc {k} is on a plate of balls; expected support: air or dry")
        if support is not None or kind["shape"] == "disc":
            _check_flat(k, launch, support, float(bodies.inertia[k]), where)
            states[k, 2], states[k, 6:8] = model.ball.radius, 0.0  # rims touch, so all centres are at one height
    _check_forces(model, supports, any(sticks), bool(force), where)
    later = _list_later_launches(launches, states)
    if (later or force) and model.laws.needs("push", "other"):
        raise InputError(
            f"{where}: balls that push each other are launched together and hit in an instant; "
            "expected no `time`, no `push` and no `contact_force`"
        )
    _check_places(states, bodies, walls, where)
    for one in later:
        if one.time > 0:
            states[one.body, 3:] = 0.0
    table = Table(
        walls=walls,
        supports=supports,
        contact_duration=drawn["contact_duration"],
        scatter=ContactScatter(**drawn["scatter"], seed=seed),
        sticks=sticks if any(sticks) else (),
        spring=ContactSpring(**force) if force else None,
    )
    return Launch(0.0, states, bodies, later), table


def _check_cushions(walls: Sequence[Wall], supports: Sequence[Support | None], where: str) -> None:
    for number, wall in enumerate(walls):
        if wall.cushion == "mathavan" and any(supports):
            raise InputError(f"{where}: walls.{number}.cushion: mathavan is a law of balls on the plate; expected han")


def _check_flat(k: int, launch: dict[str, Any], support: Support | None, inertia: float, where: str) -> None:
    """Raise InputError where a body that glides cannot move so: inertia is over m R^2."""
    if isinstance(support, DryPlate) and inertia != INERTIA["disc"]:
        raise InputError(f"{where}: bodies: body {k} is on a dry support; expected a disc of even density")
    if any(launch["slip"]) or launch["height"] or launch["rise"]:
        raise InputError(f"{where}: launches.{k}: slip, height and rise are of balls on the plate; expected 0")


def _check_forces(
    model: Model, supports: Sequence[Support | None], bodies_stick: bool, contacts_last: bool, where: str
) -> None:
    """Raise InputError where forces that hold bodies together, or contacts that last, do not fit the scene."""
    if bodies_stick and {type(support) for support in supports} not in ({Air}, {DryPlate}):
        raise InputError(
            f"{where}: bodies: bodies stick on air, and discs on a dry plate; "
            "expected support: air for all, or dry for all, or sticks: 0"
        )
    if bodies_stick and contacts_last:
        raise InputError(f"{where}: contact_force: of bodies that do not stick; expected sticks: 0 with it")
    if contacts_last and model.laws.has_effect_on("loft"):
        raise InputError(f"{where}: contact_force: balls do not hop in contacts that last; expected no effect `hop`")


def _list_later_launches(launches: Sequence[dict[str, Any]], states: Array) -> tuple[LaterLaunch, ...]:
    """List the launches of bodies that are not free at once: they start later, or a hand pushes them."""
    later = []
    for k, launch in enumerate(launches):
        push = launch.get("push", {})
        if launch["time"] or push:
            hand = push.get("until", -math.inf), tuple(push.get("acceleration", (0.0, 0.0)))
            later.append(LaterLaunch(k, launch["time"], tuple(states[k, 3:].tolist()), *hand))
    return tuple(later)


def check_counts(kinds: list[Any], launches: list[Any], where: str) -> None:
    """Raise InputError unless as many kinds of bodies are listed as launches."""
    if len(kinds) != len(launches):
        both = f"{len(kinds)} of them and {len(launches)} launches"
        raise InputError(f"{where}: bodies: {both}; expected as many, or one")


def list_kinds(drawn: dict[str, Any]) -> list[dict[str, Any]]:
    """List the kind of each body of the drawn settings."""
    kinds: Any = drawn.get("bodies")
    return kinds if isinstance(kinds, list) else [kinds] * len(drawn.get("launches") or ())


def describe_bodies(drawn: dict[str, Any]) -> dict[str, Any]:
    """Make the keys `body` and `support` of camera.json, where all have the same and are no solid balls on cloth.

    An experimenter knows both, and they decide which laws of motion can be fitted.
    """
    kinds, known = list_kinds(drawn), dict[str, Any]()
    inertias = {kind.get("inertia") or INERTIA[kind["shape"]] for kind in kinds}
    if len(inertias) == 1 and (inertia := inertias.pop()) != INERTIA["solid"]:
        known["body"] = "disc" if inertia == INERTIA["disc"] else inertia
    supports = {(kind.get("support") or drawn["support"])["kind"] for kind in kinds}
    if len(supports) == 1 and (support := supports.pop()) != "plate":
        known["support"] = {"air": "air", "dry": "sliding"}[support]
    return known


def find_heights(drawn: dict[str, Any], where: str) -> Array:
    """Find the height (N,), m, of each disc; 0 of balls. All centres are level, so that all discs have one height.

    Raises InputError for another height.
    """
    kinds = list_kinds(drawn)
    flat = np.array([kind["shape"] == "disc" for kind in kinds])
    given = {kind["height"]: k for k, kind in enumerate(kinds) if kind.get("height")}
    for k, kind in enumerate(kinds):
        if kind.get("height") and not flat[k]:
            raise InputError(f"{where}: bodies: body {k} is a ball; expected no height, or shape: disc")
    usual = drawn["ball"]["diameter"] * (0.25 if flat.all() else 1.0)
    if len(given) > 1 or (given and not flat.all() and usual not in given):
        wanted = "one height for all" if flat.all() else f"that of the balls beside it, {usual:g} m"
        raise InputError(f"{where}: bodies: disc {max(given.values())} is {max(given):g} m high; expected {wanted}")
    height = next(iter(given), usual)
    for k in np.flatnonzero(flat).tolist():
        most = 2 * (kinds[k].get("diameter") or drawn["ball"]["diameter"])
        most = min(most, drawn["camera"]["height"] / 2, drawn["lamp"]["position"][2] / 2)
        if height > most:
            raise InputError(
                f"{where}: bodies: disc {k} is {height:g} m high; expected at most {most:g} m: two diameters, "
                "and half as high as camera and lamp"
            )
    return np.where(flat, height, 0.0)


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


def _build_support(model: Model, kind: str, **numbers: Any) -> Support | None:
    if kind == "plate":
        return None
    if kind == "dry":
        return DryPlate(model.sliding_friction * model.gravity)
    return Air(**_freeze(numbers))


def _build_wall(*, inside: bool, **numbers: Any) -> Wall:
    return StraightWall(**_freeze(numbers)) if "start" in numbers else Rim(**_freeze(numbers), inside=inside)


def _freeze(numbers: dict[str, Any]) -> dict[str, Any]:
    return {name: tuple(value) if isinstance(value, list) else value for name, value in numbers.items()}


def _state(launch: dict[str, Any], radius: float, inertia: float) -> Array:
    velocity, slip = np.array(launch["velocity"]), np.array(launch["slip"])
    q = velocity - (1 - push_share(inertia)) * slip
    state = plate_state(np.array(launch["position"]), q, slip, launch["spin"], radius, inertia)
    state[2], state[3:5], state[5] = radius + launch["height"], velocity, launch["rise"]
    return state


def _check_places(states: Array, bodies: Bodies, walls: tuple[Wall, ...], where: str) -> None:
    """Raises InputError where bodies overlap, or are in a wall or on the wrong side of closed walls."""
    tolerance, radius = 1e-9 * bodies.radius.min(), bodies.radius
    if found := _find_overlap(states[:, :3], radius, tolerance):
        i, j = found
        depth = radius[i] + radius[j] - np.linalg.norm(states[i, :3] - states[j, :3])
        raise InputError(f"{where}: launches: bodies {i} and {j} overlap by {depth:.3g} m; expected none to overlap")
    outside = _find_outside(states[:, :2], walls)
    near = _list_walls_near(states[:, :2], radius, walls)
    for k, (x, y) in enumerate(states[:, :2].tolist()):
        for number in near.get(k, ()):
            wall = walls[number]
            far, _, _ = wall.distance(x, y)
            if abs(wall.rise(radius[k])) >= 1:
                within = f"expected a height within body {k}, 0 to {2 * radius[k]:g} m"
                raise InputError(f"{where}: walls.{number}.height: {within}")
            if far < wall.reach(radius[k]) - tolerance:
                side = "in" if far > -radius[k] else "beyond"
                clear = f"the body is {side} wall {number}; expected it clear of the walls"
                raise InputError(f"{where}: launches.{k}: {clear}")
        if outside[k]:
            raise InputError(f"{where}: launches.{k}: the body is outside the walls; expected it inside")


def _list_walls_near(places: Array, radius: Array, walls: tuple[Wall, ...]) -> dict[int, list[int]]:
    """List by body the numbers of the walls whose box it touches, and of those whose height no wall may have."""
    near: dict[int, list[int]] = {}
    for number, wall in enumerate(walls):
        left, low, right, high = wall.box
        apart = np.maximum([left, low] - places, places - [right, high]).max(axis=1)
        touches = apart < radius * (1 + 1e-9)
        if wall.height is not None:
            touches |= np.abs(wall.height / radius - 1) >= 1
        for k in np.flatnonzero(touches).tolist():
            near.setdefault(k, []).append(number)
    return near


def _find_overlap(centres: Array, radius: Array, tolerance: float) -> tuple[int, int] | None:
    """Find two bodies of centres (N, 3), m, that overlap by more than the tolerance; None if no two do.

    Bodies are compared in classes of radii within a factor of 2. In a class without overlaps few bodies are near any
    one of them. A heap of bodies at one place ends the search at once.
    """
    from scipy.spatial import cKDTree

    def check(i: Index, j: Index) -> tuple[int, int] | None:
        depth = radius[i] + radius[j] - np.linalg.norm(centres[i] - centres[j], axis=1)
        pairs = np.sort(np.column_stack([i, j])[depth > tolerance], axis=1)
        return tuple(pairs[np.lexsort(pairs.T[::-1])[0]].tolist()) if len(pairs) else None

    kinds = np.floor(np.log2(radius.max() / radius))
    classes = [np.flatnonzero(kinds == kind) for kind in np.unique(kinds)]
    for rank, own in enumerate(classes):  # the largest first
        tree, widest = cKDTree(centres[own]), radius[own].max()
        if len(own) > 1:
            nearest = np.asarray(tree.query(centres[own], k=2)[1])
            others = np.where(nearest[:, 0] == np.arange(len(own)), nearest[:, 1], nearest[:, 0])
            if found := check(own, own[others]):
                return found
            pairs = tree.query_pairs(2 * widest, output_type="ndarray")
            if found := check(own[pairs[:, 0]], own[pairs[:, 1]]):
                return found
        for smaller in classes[rank + 1 :]:
            for first in range(0, len(smaller), 1000):  # a large body among all others has them all near
                some = smaller[first : first + 1000]
                near = tree.query_ball_point(centres[some], widest + radius[some])
                i = np.repeat(some, [len(one) for one in near])
                j = own[np.concatenate([np.array(one, np.intp) for one in near])]
                if found := check(i, j):
                    return found
    return None


def _find_outside(places: Array, walls: tuple[Wall, ...]) -> Flags:
    """Find the places (n, 2) outside of walls that form a polygon, by how often the walls turn about them.

    Walls form a polygon where all are straight and each begins where the one before ends.
    """
    ends = np.array([(w.start, w.end) for w in walls if isinstance(w, StraightWall)])
    if not 3 <= len(walls) == len(ends) or not np.allclose(np.roll(ends[:, 0], -1, axis=0), ends[:, 1]):
        return np.zeros(len(places), dtype=bool)
    outside = np.zeros(len(places), dtype=bool)
    for k, place in enumerate(places):
        angles = np.arctan2(*(ends[:, 0] - place).T[::-1])
        steps = np.diff(angles, append=angles[0])
        outside[k] = abs(((steps + math.pi) % (2 * math.pi) - math.pi).sum()) <= math.pi
    return outside
