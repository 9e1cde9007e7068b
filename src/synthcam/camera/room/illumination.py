"""How bright plate and balls are at given points: lamps with their shadows, the sky, and light thrown to and fro.

One is the light on the plate at the world's origin without balls. Between a ball and the plate light is thrown by
`bounce`, between two balls by `exchange`.
"""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from synthcam.camera.lamp import Lamp
from synthcam.camera.room.exchange import NEARS, TURNS, BallExchange, sample_directions, sample_facing_side
from synthcam.camera.room.finish import SurfaceFinish
from synthcam.camera.room.radiosity import UP, LightSource, PlateExchange, ReflectionTable, solve_plate_exchange
from synthcam.camera.room.view_factors import (
    dot,
    form_factor,
    mean_cosine_above_horizon,
    mirror_direction,
    visible_fraction,
)
from synthcam.camera.surface import Surface

Array = NDArray[np.float64]
Index = NDArray[np.intp]

WIDE = 0.12  # rad: of a lamp's disc that is taken as one
PARTS = 4  # of a wider one's, or a bar's, half-width
REACH = 7.0  # radii from where it touches the plate, a ball's part in the plate's light
FADE = 3.0  # radii over which that part is taken back to nothing
LOOKS = 4.0  # radii, the plate that a ball's equator looks at: closest to traced light among 1.5 to 4
TRADES = 3  # times that light goes between two balls
MIRRORS, VARNISHED = 3, 1  # a ray meets, at most, of metal and of varnish


@dataclass(frozen=True)
class LampCell:
    """A piece of a lamp: its middle, m, its area, m^2, the way it faces, and its radiance over pi."""

    position: Array
    area: float
    facing: Array
    strength: float


class BallsAtMoment(NamedTuple):
    """Balls (N, 3) at one moment, and what they trade."""

    centres: Array
    exchange: BallExchange | None


class Illumination:
    """lamp, look: as in a film. radii: (N,) m. mirror: the balls' varnish or bare metal, None: dull."""

    def __init__(self, lamp: Lamp, finish: SurfaceFinish, radii: Array, mirror: Surface | None) -> None:
        self.finish, self.radii, self.mirror = finish, radii, mirror
        self.colours = [ball.mean for ball in finish.balls]
        self.plate = np.array(finish.plate)
        cells = [cell for each in lamp.all for cell in _cells(each)]
        whole = sum(_irradiance(cell, np.zeros((1, 3)), UP[None])[0, 0] for cell in cells)
        self.unit = (1 - finish.ambient) / whole  # of a radiance over pi
        self.cells = [LampCell(c.position, c.area, c.facing, c.strength * self.unit) for c in cells]
        tables: dict[tuple[bytes, float], PlateExchange] = {}
        for colour, radius in zip(self.colours, radii.tolist(), strict=True):
            if (colour.tobytes(), radius) not in tables:
                made = solve_plate_exchange(partial(self._sources, radius), finish.ambient, colour, self.plate)
                tables[colour.tobytes(), radius] = made
        self.bounces = [tables[c.tobytes(), r] for c, r in zip(self.colours, radii.tolist(), strict=True)]
        slant = max(np.hypot(*c.position[:2]) / c.position[2] for c in self.cells)
        self.reach = max(REACH, 1.5 * slant + np.hypot(slant, 1) + 1)  # radii

    def _sources(self, radius: float, spots: Array) -> list[LightSource]:
        """The lamps at spots (n, 3) on the plate, in radii of a ball."""
        points, up = spots * radius, np.broadcast_to(UP, spots.shape)
        return [
            LightSource(*_direction_and_size(cell, points), _irradiance(cell, points, up)[:, 0]) for cell in self.cells
        ]

    def bare(self, points: Array) -> Array:
        """Light (n,) on the plate at points (n, 3) where there is no ball."""
        return np.asarray(self._lights(points).sum(axis=1))

    def _lights(self, points: Array) -> Array:
        """Light (n, 1 + cells) of the sky and of the lamps on the bare plate."""
        up = np.broadcast_to(UP, points.shape)
        sky = np.full((len(points), 1), self.finish.ambient)
        return np.concatenate([sky, *(_irradiance(cell, points, up) for cell in self.cells)], axis=1)

    def on_plate(self, points: Array, centres: Array, soft: float = 0.0) -> Array:
        """Light (n, c) on the plate at points (n, 3) among balls (N, 3). soft: m, rms blur of a shadow's edge."""
        bare = self._lights(points)
        shares = np.ones((len(centres), *bare.shape))  # that each ball leaves
        for ball, centre in enumerate(centres):
            near, kept = self._unshadowed_shares(ball, points, centre, soft)
            shares[ball, near] = kept
        total = np.repeat((bare * shares.prod(axis=0)).sum(axis=1)[:, None], self.finish.channels, axis=1)
        local = self.bare(centres * [1, 1, 0])
        for ball, centre in enumerate(centres):
            near, fade = self._near(ball, points, centre)
            others = np.delete(shares[:, near], ball, axis=0).prod(axis=0)
            dim = (bare[near] * others).sum(axis=1) / bare[near].sum(axis=1)  # what it throws it has from about there
            thrown = self.bounces[ball].on_plate((points[near, :2] - centre[:2]) / self.radii[ball])
            total[near] += (local[ball] * fade * dim)[:, None] * thrown
        return total

    def _near(self, ball: int, points: Array, centre: Array) -> tuple[Index, Array]:
        """Points of the plate near a ball, and how much its part in their light counts there: it ends softly."""
        r = np.hypot(points[:, 0] - centre[0], points[:, 1] - centre[1]) / self.radii[ball]
        near = np.flatnonzero(r < REACH)
        return near, _smooth((REACH - r[near]) / FADE)

    def _unshadowed_shares(self, ball: int, points: Array, centre: Array, soft: float = 0.0) -> tuple[Index, Array]:
        """Points that a ball takes light from, and the shares (n, 1 + cells) of sky and lamps that it leaves them."""
        r = np.hypot(points[:, 0] - centre[0], points[:, 1] - centre[1]) / self.radii[ball]
        near = np.flatnonzero(r < self.reach)
        fade, offset = _smooth((REACH - r[near]) / FADE), centre - points[near]
        far = np.sqrt(dot(offset, offset))
        wide = np.arcsin(np.clip(self.radii[ball] / far, 0, 1))
        shares = [1 - fade * form_factor(np.broadcast_to(UP, offset.shape), offset, self.radii[ball])]
        for cell in self.cells:
            way, size = _direction_and_size(cell, points[near])
            apart = np.arccos(np.clip(dot(offset, way) / far, -1, 1))
            shares.append(visible_fraction(np.hypot(size, 2 * soft / far), wide, apart))
        return near, np.stack(shares, axis=1)

    def on_ball(
        self, ball: int, points: Array, normals: Array, centres: Array, exchange: BallExchange | None = None
    ) -> Array:
        """Light (n, c) on a ball at points (n, 3). exchange: what it trades with the others."""
        lamps = np.zeros(len(points))
        for cell in self.cells:
            light = _irradiance(cell, points, normals)[:, 0]
            for k in range(len(centres)):
                if k != ball:
                    light = light * self._visible_share(cell, points, centres[k], self.radii[k])
            lamps += light
        sky = self.finish.ambient * (1 + normals[:, 2]) / 2
        total = (lamps + sky)[:, None] + self._from_plate(ball, normals, centres)
        if exchange is not None:
            total += exchange.on_ball(ball, normals)
        return np.asarray(np.maximum(total, 0))

    def _from_plate(self, ball: int, normals: Array, centres: Array) -> Array:
        """Light (n, c) that a ball gets from the plate, dimmed as other balls dim it where the ball looks."""
        foot = centres[ball] * [1, 1, 0]
        out = self.bounces[ball].on_ball(normals) * self.bare(foot[None])[0]
        if len(centres) == 1:
            return np.asarray(out)
        looks = foot + LOOKS * self.radii[ball] * normals * [1, 1, 0]
        bare = self._lights(looks)
        left = bare.copy()
        for k in range(len(centres)):
            if k != ball:
                near, kept = self._unshadowed_shares(k, looks, centres[k])
                left[near] *= kept
        return np.asarray(out * (left.sum(axis=1) / bare.sum(axis=1))[:, None])

    def exchange(self, centres: Array) -> BallExchange | None:
        """What each two balls trade: light that one throws on the other less what it hides of plate and sky."""
        if len(centres) == 1:
            return None
        pairs = [(a, b) for a in range(len(centres)) for b in range(len(centres)) if a != b]
        found: BallExchange | None = None
        for _ in range(TRADES):
            tables = {}
            for a, b in pairs:
                axes, normals = sample_facing_side(centres[b] - centres[a])
                points = centres[a] + self.radii[a] * normals
                ways, weights = sample_directions(points, normals, centres[b], self.radii[b])
                many = np.repeat(points, ways.shape[1], axis=0)
                flat = ways.reshape(-1, 3)
                offset = many - centres[b]
                along = dot(offset, flat)
                root = np.sqrt(np.maximum(along**2 - dot(offset, offset) + self.radii[b] ** 2, 0))
                face = _units(offset + (-along - root)[:, None] * flat)
                given = self.colours[b] * self.on_ball(b, centres[b] + self.radii[b] * face, face, centres, found)
                plate = self._from_plate(a, normals, centres) / np.maximum((1 - normals[:, 2:]) / 2, 1e-3)
                up = ways[..., 2:] > 0
                hidden = np.where(up, self.finish.ambient, plate[:, None])
                net = (weights[..., None] * (given.reshape(hidden.shape) - hidden)).sum(axis=1)
                share = form_factor(normals, centres[b] - points, self.radii[b])
                tables[a, b] = axes, ReflectionTable((share[:, None] * net).reshape(NEARS, TURNS, -1))
            found = BallExchange(tables)
        return found

    def _visible_share(self, cell: LampCell, points: Array, centre: Array, radius: float) -> Array:
        """Share (n,) of a lamp's cell that a ball leaves in view."""
        offset = centre - points
        far = np.maximum(np.sqrt(dot(offset, offset)), radius)
        way, size = _direction_and_size(cell, points)
        apart = np.arccos(np.clip(dot(offset, way) / far, -1, 1))
        return np.asarray(visible_fraction(size, np.arcsin(np.clip(radius / far, 0, 1)), apart))

    def radiance(
        self, ball: int, points: Array, ways: Array, among: BallsAtMoment, paint: Array, mirrors: int | None = None
    ) -> Array:
        """What is seen (n, c) of a ball at points (n, 3) along ways (n, 3), without the lamps' images in it.

        paint: its reflectance there, (n, c).
        """
        normals = _units(points - among.centres[ball])
        out = np.zeros((len(points), self.finish.channels))
        if paint.any():
            out += paint * self.on_ball(ball, points, normals, *among)
        if mirrors is None:
            mirrors = MIRRORS if self.mirror is not None and self.mirror.head_on > 0.2 else VARNISHED
        if self.mirror is not None and mirrors:
            away, cosine = mirror_direction(normals, ways)
            out += self.mirror.mirror(cosine)[:, None] * self._around(ball, points, away, among, mirrors - 1)
        return out

    def _around(self, ball: int, points: Array, ways: Array, among: BallsAtMoment, mirrors: int) -> Array:
        """What a ball mirrors (n, c): sky, plate or another ball."""
        centres = among.centres
        out = np.full((len(points), self.finish.channels), self.finish.ambient)
        nearest = np.full(len(points), np.inf)
        meets = np.full(len(points), -1)
        for k in range(len(centres)):
            offset = points - centres[k]
            b, c = dot(offset, ways), dot(offset, offset) - self.radii[k] ** 2
            root = b * b - c
            hit = (root > 0) & (b < 0) & (-b - np.sqrt(np.maximum(root, 0)) < nearest) & (k != ball)
            nearest[hit] = (-b - np.sqrt(np.maximum(root, 0)))[hit]
            meets[hit] = k
        down = np.flatnonzero((meets < 0) & (ways[:, 2] < -1e-6))
        if len(down):
            hit_at = points[down] - ways[down] * (points[down, 2:] / ways[down, 2:])
            out[down] = self.plate * self.on_plate(hit_at * [1, 1, 0], centres)
        for k in range(len(centres)):
            own = np.flatnonzero(meets == k)
            if len(own):
                at = points[own] + nearest[own, None] * ways[own]
                paint = np.broadcast_to(self.colours[k], (len(own), self.finish.channels))
                out[own] = self.radiance(k, at, ways[own], among, paint, mirrors)
        return out


def _cells(lamp: Lamp) -> list[LampCell]:
    whole = max(lamp.radius, lamp.length / 2) if lamp.shape == "bar" else lamp.radius
    one = lamp.shape == "disc" and lamp.radius < WIDE * float(np.linalg.norm(lamp.position))
    cells = lamp.cells(np.inf if one else whole / PARTS)
    facing = lamp.axes[:, 2]
    return [
        LampCell(position, float(area), facing, lamp.radiance)
        for position, area in zip(cells.positions, cells.areas, strict=True)
    ]


def _direction_and_size(cell: LampCell, points: Array) -> tuple[Array, Array]:
    """Unit ways (n, 3) to a lamp's cell, and the angular radius (n,) of a disc as large as it looks."""
    way = cell.position - points
    far = np.sqrt(dot(way, way))
    way = way / far[:, None]
    area = cell.area * np.maximum(-(way @ cell.facing), 1e-6)
    return way, np.sqrt(area / np.pi) / far


def _irradiance(cell: LampCell, points: Array, normals: Array) -> Array:
    """Light (n, 1) of a lamp's cell."""
    way, size = _direction_and_size(cell, points)
    return np.asarray(
        (cell.strength * size * size * np.pi * mean_cosine_above_horizon(dot(normals, way), np.sin(size)))[:, None]
    )


def _smooth(x: Array) -> Array:
    x = np.clip(x, 0, 1)
    return np.asarray(x * x * (3 - 2 * x))


def _units(vectors: Array) -> Array:
    return np.asarray(vectors / np.sqrt(dot(vectors, vectors))[:, None])
