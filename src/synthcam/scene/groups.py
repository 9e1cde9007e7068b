"""Groups of bodies in a scene: where many bodies start, and how fast, by a few numbers."""

import itertools
import math
import zlib
from collections.abc import Iterator
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from synthcam.model import Model
from synthcam.scene.bodies import MAX_BODIES, BodySettings, Point, check_counts
from synthcam_shared.arrays import Array
from synthcam_shared.errors import InputError
from synthcam_shared.settings import NotNegative, Settings


class GroupSettings(Settings):
    """One of `groups:`, bodies that start together.

    - count: number of bodies
    - arrangement: random, anywhere; lattice, on sites of a triangular lattice that fills the area, moved by chance as
      far as there is room; rack, rows of 1, 2, 3 ... bodies along x with the first in the centre
    - centre, m; size: width and height of the area in which random and lattice place the centres, m
    - gap: least distance between two surfaces, m
    - velocity: of the group, m/s; rms_speed: of its bodies about that, m/s, normal in each direction
    - body: what they are, instead of `bodies`; those of a list take turns
    """

    count: Annotated[int, Field(ge=1, le=MAX_BODIES)]
    arrangement: Literal["random", "lattice", "rack"] = "random"
    centre: Point = Field([0.0, 0.0])
    size: Annotated[list[Annotated[float, Field(gt=0, le=1e3)]], Field(min_length=2, max_length=2)] | None = None
    gap: Annotated[float, Field(ge=0, le=1e3)] = 0.0
    velocity: Point = Field([0.0, 0.0])
    rms_speed: NotNegative = 0.0
    body: BodySettings | Annotated[list[BodySettings], Field(min_length=1)] | None = None


def place_groups(model: Model, drawn: dict[str, Any], seed: tuple[int, int], where: str) -> dict[str, Any]:
    """Return the drawn settings with an entry of `launches` and of `bodies` for each body of the groups.

    seed: of the dataset, and the number of the clip. Raises InputError where a group has too little room.
    """
    launches, kinds = list(drawn.get("launches") or []), drawn["bodies"]
    listed = kinds if isinstance(kinds, list) else [kinds] * len(launches)
    if isinstance(kinds, list) and any("body" not in group for group in drawn["groups"]):
        raise InputError(f"{where}: bodies: a list beside groups; expected one kind, or a `body` in each group")
    check_counts(listed, launches, where)
    taken = np.array([launch["position"] for launch in launches]).reshape(-1, 2)
    radii = np.array([_radius(model, kind) for kind in listed])
    every = list(listed)
    if len(launches) + sum(group["count"] for group in drawn["groups"]) > MAX_BODIES:
        raise InputError(f"{where}: groups: expected at most {MAX_BODIES} bodies in all")
    for number, group in enumerate(drawn["groups"]):
        kind, key = group.get("body") or kinds, f"{where}: groups.{number}"
        stream = np.random.SeedSequence(seed[0], spawn_key=(seed[1], zlib.crc32(f"groups.{number}".encode())))
        turns = kind if isinstance(kind, list) else [kind]
        rng, radius = np.random.default_rng(stream), max(_radius(model, one) for one in turns)
        if group["arrangement"] != "rack" and "size" not in group:
            raise InputError(f"{key}.size: expected the width and the height of the area, m")
        count, least = group["count"], 2 * radius + group["gap"]
        if group["arrangement"] == "rack":  # rows of 1, 2, 3 ... bodies
            rows = (math.isqrt(8 * count + 1) + 1) // 2
            sites = [(row * math.sqrt(3) / 2, k - row / 2) for row in range(rows + 1) for k in range(row + 1)]
            places = least * np.array(sites[:count])
        elif group["arrangement"] == "lattice":
            places = _lattice(rng, count, group["size"], least, key)
        else:
            others = taken - group["centre"], radii + radius + group["gap"]
            places = _random(rng, count, group["size"], least, others, key)
        places = places + group["centre"]
        speeds = rng.standard_normal((count, 2))
        speeds -= speeds.mean(axis=0) if count > 1 else 0.0
        speeds = speeds * group["rms_speed"] / math.sqrt((speeds**2).sum(axis=1).mean()) + group["velocity"]
        launches += [
            {"position": at, "velocity": v, "slip": [0.0, 0.0], "spin": 0.0, "height": 0.0, "rise": 0.0, "time": 0.0}
            for at, v in zip(places.tolist(), speeds.tolist(), strict=True)
        ]
        taken, radii = np.vstack([taken, places]), np.append(radii, np.full(len(places), radius))
        every += itertools.islice(itertools.cycle(turns), count)
    rest = {name: value for name, value in drawn.items() if name != "groups"}
    return rest | {"launches": launches, "bodies": every if any(kind != kinds for kind in every) else kinds}


def _radius(model: Model, kind: dict[str, Any]) -> float:
    """The largest radius that a body of this kind has, m, whatever effects make of it."""
    largest = max(model.bodies([kind["label"]]).radius[0], model.ball.radius)
    return float((kind.get("diameter") or model.ball.diameter) / model.ball.diameter * largest)


def _lattice(rng: np.random.Generator, count: int, size: list[float], least: float, key: str) -> Array:
    """Places (count, 2), m, on random sites of the widest triangular lattice that has enough, moved within its room.

    Raises InputError where the bodies need more room.
    """
    room = sum(_count_columns(size, least))
    if room < count:
        raise InputError(
            f"{key}: {room} of {count} bodies have room on a lattice of {size[0]:g} x {size[1]:g} m; "
            "expected a larger size, fewer bodies or a smaller gap"
        )
    low, high = least, math.hypot(*size) + least
    for _ in range(60):  # to the last digit
        middle = (low + high) / 2
        low, high = (middle, high) if sum(_count_columns(size, middle)) >= count else (low, middle)
    columns, step = list(_count_columns(size, low)), low * math.sqrt(3) / 2
    x = [low * (np.arange(n) + row % 2 / 2) for row, n in enumerate(columns)]
    y = -(len(columns) - 1) * step / 2 + np.arange(len(columns)) * step
    sites = np.column_stack([np.concatenate(x), np.repeat(y, columns)])
    sites[:, 0] -= sites[:, 0].max() / 2
    chosen = np.sort(rng.permutation(len(sites))[:count])
    reach = (low - least) / 2 * np.sqrt(rng.random(count)) * (1 - 1e-9)
    angle = rng.uniform(0, 2 * math.pi, count)
    places = sites[chosen] + reach[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.asarray(np.clip(places, -np.array(size) / 2, np.array(size) / 2))


def _count_columns(size: list[float], spacing: float) -> Iterator[int]:
    """Yield the number of sites in each row of a triangular lattice, at most MAX_BODIES rows."""
    width, height = size
    rows = min(int(height / (spacing * math.sqrt(3) / 2) + 1e-9) + 1, MAX_BODIES)
    for row in range(rows):
        shift = spacing / 2 * (row % 2)
        yield int((width - shift) / spacing + 1e-9) + 1 if width >= shift else 0


def _random(
    rng: np.random.Generator, count: int, size: list[float], least: float, others: tuple[Array, Array], key: str
) -> Array:
    """Places (count, 2), m, one after the other anywhere in the area that is free (random sequential addition).

    others: places (n, 2) of other bodies and the least distance from each, m. Raises InputError where one finds none.
    """
    # Discs fill at most 0.547 of a plane in this way (Feder, J. Theor. Biol. 87 (1980) 237), and 2000 tries reach 0.5.
    max_tries = 2000
    cells: dict[tuple[int, int], list[Array]] = {}
    places = list[Array]()
    half = np.array(size) / 2
    while len(places) < count:
        for _ in range(max_tries):
            at = rng.uniform(-half, half)
            column, row = (int(c) for c in np.floor(at / least))
            around = itertools.product(range(column - 1, column + 2), range(row - 1, row + 2))
            near = itertools.chain.from_iterable(cells.get(cell, ()) for cell in around)
            free = all((at[0] - p[0]) ** 2 + (at[1] - p[1]) ** 2 >= least**2 for p in near)
            if free and (np.hypot(*(others[0] - at).T) >= others[1]).all():
                cells.setdefault((column, row), []).append(at)
                places.append(at)
                break
        else:
            raise InputError(
                f"{key}: {len(places)} of {count} bodies find a position at random in {size[0]:g} x {size[1]:g} m; "
                "expected a larger size, fewer bodies, a smaller gap, or arrangement: lattice"
            )
    return np.array(places)
