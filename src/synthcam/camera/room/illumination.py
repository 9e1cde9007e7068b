"""Illumination of plate and balls: lamps with their shadows, the sky, and light reflected between surfaces.

The unit is the light on the plate at the world's origin without balls. `radiosity` has the light that surfaces reflect
to each other.
"""

import itertools
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from synthcam.camera.disc import list_discs
from synthcam.camera.lamp import Lamp
from synthcam.camera.room.finish import SurfaceFinish
from synthcam.camera.room.radiosity import (
    EXCHANGE_CELLS,
    FACES,
    UP,
    ExchangeTable,
    LightExchange,
    LightSource,
    PlateExchange,
    ReflectionTable,
    find_cell,
    sample_directions_to_ball,
    sample_facing_side,
    solve_plate_exchange,
    tabulate_faces,
)
from synthcam.camera.room.view_factors import (
    compute_form_factor,
    dot,
    mean_cosine_above_horizon,
    mirror_direction,
    visible_fraction,
)
from synthcam.camera.surface import Surface
from synthcam_shared.arrays import Array, Index

REACH_RADII = 7.0  # distance from its point of contact up to which a ball changes the light on the plate


@dataclass(frozen=True)
class LampCell:
    """A cell of a lamp."""

    position: Array  # its middle (3,), m
    area: float  # m^2
    facing: Array  # the direction (3,) in which it shines
    strength: float  # radiance over pi


class BallsAtMoment(NamedTuple):
    """Centres of the balls (N, 3), m, at one moment, and the light that they exchange."""

    centres: Array
    exchange: LightExchange | None


class BallView(NamedTuple):
    """Rays from n points of one ball, the receiver, to another, the sender: m from each point."""

    receiver: int
    sender: int
    axes: Array  # (3, 3), as of `sample_facing_side`
    weights: Array  # (n, m)
    face: Array  # unit vectors (n m, 3) from the sender's centre to where the rays meet it
    direct: Array  # light (n m, c) of lamps, sky and plate there
    hidden: Array  # radiance (n, m, c) of the sky and the plate behind the sender
    share: Array  # form factor (n,) of the sender


class Illumination:
    """The light of a scene.

    radii, heights: (N,), m; a height of 0 is a ball's, others are those of discs.
    mirror: the balls' varnish or bare metal; None: dull. Discs are dull, and no surface mirrors them.
    quick: balls exchange no light and do not mirror each other.
    """

    def __init__(
        self,
        lamp: Lamp,
        finish: SurfaceFinish,
        radii: Array,
        mirror: Surface | None,
        heights: Array | None = None,
        *,
        quick: bool = False,
    ) -> None:
        self.quick = quick
        self.finish, self.radii, self.mirror = finish, radii, mirror
        self.discs = list_discs(radii, np.zeros(len(radii)) if heights is None else heights)
        self.colours = [ball.mean for ball in finish.balls]
        self.plate = np.array(finish.plate)
        cells = [cell for each in lamp.all for cell in _cells(each)]
        whole = sum(_irradiance(cell, np.zeros((1, 3)), UP[None])[0] for cell in cells)
        self.unit = (1 - finish.ambient) / whole  # of a radiance over pi
        self.cells = [replace(cell, strength=cell.strength * self.unit) for cell in cells]
        tables: dict[tuple[bytes, float], PlateExchange] = {}
        for colour, radius, disc in zip(self.colours, radii.tolist(), self.discs, strict=True):
            if disc is None and (colour.tobytes(), radius) not in tables:
                made = solve_plate_exchange(partial(self._sources, radius), finish.ambient, colour, self.plate)
                tables[colour.tobytes(), radius] = made
        self.bounces = [tables.get((c.tobytes(), r)) for c, r in zip(self.colours, radii.tolist(), strict=True)]
        slant = max(np.hypot(*c.position[:2]) / c.position[2] for c in self.cells)
        far = max(REACH_RADII, 1.5 * slant + np.hypot(slant, 1) + 1)
        falls = max(1.5 * slant, 6.0)  # heights; further from its rim, a disc hides less than 0.4 % of the sky
        self.reaches = np.array([1 + d.height / d.radius * falls if d else far for d in self.discs])  # radii
        self.reach = float(self.reaches.max())

    def _sources(self, radius: float, spots: Array) -> list[LightSource]:
        """The lamps as seen from spots (n, 3) on the plate, in radii of a ball."""
        points, up = spots * radius, np.broadcast_to(UP, spots.shape)
        return [LightSource(*_direction_and_size(cell, points), _irradiance(cell, points, up)) for cell in self.cells]

    def bare(self, points: Array) -> Array:
        """Light (n,) on the plate without balls, at points (n, 3), m."""
        return np.asarray(self._lights(points).sum(axis=1))

    def _lights(self, points: Array) -> Array:
        """Light (n, 1 + cells) of the sky and of the lamps on the plate without balls."""
        up = np.broadcast_to(UP, points.shape)
        sky = np.full(len(points), self.finish.ambient)
        return np.stack([sky, *(_irradiance(cell, points, up) for cell in self.cells)], axis=1)

    def on_plate(self, points: Array, centres: Array, soft: float = 0.0) -> Array:
        """Light (n, c) on the plate at points (n, 3), m, among balls (N, 3).

        soft: rms blur of a shadow's edge, m.
        """
        bare = self._lights(points)
        shares = [self._unshadowed_shares(ball, points, centre, soft) for ball, centre in enumerate(centres)]
        left = np.ones(bare.shape)  # of the light, by all balls
        for near, kept in shares:
            left[near] *= kept
        total = np.repeat((bare * left).sum(axis=1)[:, None], self.finish.channels, axis=1)
        local = self.bare(centres * [1, 1, 0])
        for ball, centre in enumerate(centres):
            near, fade = self._near(ball, points, centre)
            if not len(near):
                continue
            others = np.ones(bare.shape)
            apart = np.hypot(*(centres - centre)[:, :2].T)
            for k in np.flatnonzero(apart < 2 * self.reach * self.radii.max()).tolist():
                if k != ball:
                    others[shares[k][0]] *= shares[k][1]
            others = others[near]
            dim = (bare[near] * others).sum(axis=1) / bare[near].sum(axis=1)  # its light comes from about there
            offsets, bounces = points[near, :2] - centre[:2], self.bounces[ball]
            if bounces:
                thrown = local[ball] * bounces.on_plate(offsets / self.radii[ball])
            else:
                thrown = self._from_side(ball, offsets, centre)
            total[near] += (fade * dim)[:, None] * thrown
        return total

    def _near(self, ball: int, points: Array, centre: Array, reach: float = REACH_RADII) -> tuple[Index, Array]:
        """Points of the plate near a ball, and the weight of its reflected light there, which falls to 0 smoothly."""
        full, fading = REACH_RADII, 3.0  # radii; over the second distance the change fades to nothing
        if self.discs[ball]:
            full = reach = float(self.reaches[ball])
            fading = (full - 1) / 2
        x, y, radius = points[:, 0] - centre[0], points[:, 1] - centre[1], self.radii[ball]
        near = np.flatnonzero(np.maximum(np.abs(x), np.abs(y)) < reach * radius * (1 + 1e-9))
        r = np.hypot(x[near], y[near]) / radius
        inside = r < reach
        weight = np.clip((full - r[inside]) / fading, 0, 1)
        return near[inside], weight * weight * (3 - 2 * weight)

    def _from_side(self, ball: int, offsets: Array, centre: Array) -> Array:
        """Light (n, c) that the side of a disc reflects to the plate at offsets (n, 2), m, from its axis."""
        disc = self.discs[ball]
        assert disc
        turn = np.linspace(-np.pi, np.pi, 33)
        normals = np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])
        light = self._direct(ball, centre + disc.radius * normals, normals, centre[None], alone=True)
        angle = np.arctan2(offsets[:, 1], offsets[:, 0])
        shown = np.stack([np.interp(angle, turn, of_channel) for of_channel in light.T], axis=1)
        return np.asarray(disc.hide_sky(np.hypot(*offsets.T))[:, None] * self.colours[ball] * shown)

    def _unshadowed_shares(self, ball: int, points: Array, centre: Array, soft: float = 0.0) -> tuple[Index, Array]:
        """Points that a ball shadows, and the shares (n, 1 + cells) of the light of sky and lamps that it leaves."""
        near, fade = self._near(ball, points, centre, self.reach)
        at = points[near]
        if disc := self.discs[ball]:
            hidden = disc.hide_sky(np.hypot(at[:, 0] - centre[0], at[:, 1] - centre[1]))
        else:
            hidden = compute_form_factor(np.broadcast_to(UP, at.shape), centre - at, self.radii[ball])
        lamps = (self._visible_share(ball, cell, at, centre, soft) for cell in self.cells)
        return near, np.stack([1 - fade * hidden, *lamps], axis=1)

    def on_ball(
        self, ball: int, points: Array, normals: Array, centres: Array, exchange: LightExchange | None = None
    ) -> Array:
        """Light (n, c) on a ball at points (n, 3), m. exchange: the light between balls."""
        total = self._direct(ball, points, normals, centres)
        if exchange is not None:
            total += exchange.on_ball(ball, normals)
        return np.asarray(np.maximum(total, 0))

    def _direct(self, ball: int, points: Array, normals: Array, centres: Array, *, alone: bool = False) -> Array:
        """Light (n, c) of lamps, sky and plate on a ball. alone: `centres` is its own, (1, 3)."""
        lamps = np.zeros(len(points))
        for cell in self.cells:
            light = _irradiance(cell, points, normals)
            for k in () if alone else self._neighbours(ball, centres):
                light = light * self._visible_share(k, cell, points, centres[k])
            lamps += light
        sky = self.finish.ambient * (1 + normals[:, 2]) / 2
        if alone:
            plate = np.outer(self.bare(centres * [1, 1, 0]) * (1 - normals[:, 2]) / 2, self.plate)
        else:
            plate = self._from_plate(ball, normals, centres)
        return np.asarray((lamps + sky)[:, None] + plate)

    def _visible_share(self, ball: int, cell: LampCell, points: Array, centre: Array, soft: float = 0.0) -> Array:
        """Share (n,) of a lamp's cell that a ball leaves visible from points outside it. soft: as of `on_plate`."""
        way, size = _direction_and_size(cell, points)
        if disc := self.discs[ball]:
            return disc.find_visible_share(points, way, size, centre, soft)
        offset, radius = centre - points, float(self.radii[ball])
        far = np.maximum(np.sqrt(dot(offset, offset)), radius)
        cosine = dot(offset, way) / far
        # Most balls are beside the lamp: cos x >= 1 - x^2/2, and asin x <= pi/2 x.
        widest = size + (2 * soft + np.pi / 2 * radius) / far
        before = np.flatnonzero(cosine > 1 - widest * widest / 2)
        out = np.ones(len(points))
        if len(before):
            far, wide = far[before], np.hypot(size[before], 2 * soft / far[before])
            apart = np.arccos(np.clip(cosine[before], -1, 1))
            out[before] = visible_fraction(wide, np.arcsin(np.clip(radius / far, 0, 1)), apart)
        return out

    def _neighbours(self, ball: int, centres: Array, reach: float = np.inf) -> list[int]:
        """Other balls up to `reach` radii away, or as far as a shadow falls; of two balls the other one."""
        far = np.sqrt(dot(centres - centres[ball], centres - centres[ball]))
        near = far < min(reach, self.reach + 2) * self.radii.max()
        return [k for k in range(len(centres)) if k != ball and (near[k] or len(centres) == 2)]

    def _from_plate(self, ball: int, normals: Array, centres: Array) -> Array:
        """Light (n, c) from the plate on a ball, reduced by the shadows of other balls on that part of the plate."""
        foot = centres[ball] * [1, 1, 0]
        if not (bounces := self.bounces[ball]):
            return self._on_side(ball, normals, centres)
        out = bounces.on_ball(normals) * self.bare(foot[None])[0]
        if len(centres) == 1:
            return np.asarray(out)
        # A ball's equator looks at the plate 4 radii away: of 1.5 to 4, this is closest to traced light.
        looks = foot + 4 * self.radii[ball] * normals * [1, 1, 0]
        bare = self._lights(looks)
        left = bare.copy()
        for k in self._neighbours(ball, centres):
            near, kept = self._unshadowed_shares(k, looks, centres[k])
            left[near] *= kept
        return np.asarray(out * (left.sum(axis=1) / bare.sum(axis=1))[:, None])

    def _on_side(self, ball: int, normals: Array, centres: Array) -> Array:
        """Light (n, c) from the plate on a disc: that of the plate as far from its side as it is high."""
        disc = self.discs[ball]
        assert disc
        out = np.zeros((len(normals), self.finish.channels))
        lean = np.flatnonzero(normals[:, 2] < 1 - 1e-9)
        way = normals[lean] * [1, 1, 0] / np.hypot(*normals[lean, :2].T)[:, None]
        looks = centres[ball] * [1, 1, 0] + (disc.radius + disc.height) * way
        light = self._lights(looks)
        for k in [ball, *self._neighbours(ball, centres)]:
            near, kept = self._unshadowed_shares(k, looks, centres[k])
            light[near] *= kept
        out[lean] = np.outer((1 - normals[lean, 2]) / 2 * light.sum(axis=1), self.plate)
        return out

    def exchange(self, centres: Array) -> LightExchange | None:
        """Exchange of each two balls: the light sent minus the light of plate and sky that the sender hides."""
        if len(centres) == 1 or self.quick:
            return None
        balls = [k for k, disc in enumerate(self.discs) if disc is None]  # of discs one sees little but the top
        reach = 5.0  # radii; further away, a white one of many balls returns less than 4 % of the light
        near = ((a, self._neighbours(a, centres, reach)) for a in balls)
        pairs = [(a, b) for a, others in near for b in others if self.discs[b] is None]
        if not pairs:
            return None
        many = len(centres) > 2  # seen from many sides: each ball's own light is looked up in a table
        own: dict[int, ReflectionTable] = {}
        for k in set(itertools.chain(*pairs)) if many else ():
            light = self._direct(k, centres[k] + self.radii[k] * FACES, FACES, centres)
            own[k] = tabulate_faces(light)
        views = [self._view(a, b, centres, own) for a, b in pairs]
        found: LightExchange | None = None
        for _ in range(3):  # reflections to and fro
            received = {k: tabulate_faces(found.on_ball(k, FACES)) for k in own} if found else {}
            tables: dict[int, list[ExchangeTable]] = {}
            for view in views:
                light = view.direct
                if received:
                    light = light + received[view.sender].at(*find_cell(view.face))
                elif found is not None:
                    light = light + found.on_ball(view.sender, view.face)
                given = self.colours[view.sender] * np.maximum(light, 0)
                net = (view.weights[..., None] * (given.reshape(view.hidden.shape) - view.hidden)).sum(axis=1)
                table = ReflectionTable((view.share[:, None] * net).reshape(*EXCHANGE_CELLS, -1))
                tables.setdefault(view.receiver, []).append((view.axes, table))
            found = LightExchange(tables)
        return found

    def _view(self, a: int, b: int, centres: Array, own: dict[int, ReflectionTable]) -> "BallView":
        """Sample what ball a sees of ball b. own: the direct light of each ball, where there are many."""
        axes, normals = sample_facing_side(centres[b] - centres[a])
        points = centres[a] + self.radii[a] * normals
        ways, weights = sample_directions_to_ball(points, normals, centres[b], self.radii[b])
        flat = ways.reshape(-1, 3)
        offset = np.repeat(points, ways.shape[1], axis=0) - centres[b]
        along = dot(offset, flat)
        root = np.sqrt(np.maximum(along**2 - dot(offset, offset) + self.radii[b] ** 2, 0))
        face = _units(offset + (-along - root)[:, None] * flat)
        # nearer balls have sharp shadows where they face each other
        if own and np.linalg.norm(centres[b] - centres[a]) > 1.1 * (self.radii[a] + self.radii[b]):
            direct = own[b].at(*find_cell(face))
        else:
            direct = self._direct(b, centres[b] + self.radii[b] * face, face, centres)
        plate = self._from_plate(a, normals, centres) / np.maximum((1 - normals[:, 2:]) / 2, 1e-3)
        hidden = np.where(ways[..., 2:] > 0, self.finish.ambient, plate[:, None])
        share = compute_form_factor(normals, centres[b] - points, self.radii[b])
        return BallView(a, b, axes, weights, face, direct, hidden, share)

    def radiance(
        self, ball: int, points: Array, ways: Array, among: BallsAtMoment, paint: Array, mirrors: int | None = None
    ) -> Array:
        """Radiance (n, c) of a ball at points (n, 3) against directions (n, 3), without the lamps' images in it.

        paint: its reflectance there, (n, c).
        """
        disc, centre = self.discs[ball], among.centres[ball]
        normals = disc.find_normals(points, centre) if disc else _units(points - centre)
        out = np.zeros((len(points), self.finish.channels))
        if paint.any():
            out += paint * self.on_ball(ball, points, normals, *among)
        if mirrors is None:
            metal = self.mirror is not None and self.mirror.head_on > 0.2
            mirrors = 3 if metal else 1  # reflections of a ray on metal and on varnish
        if self.mirror is not None and mirrors and not disc:
            away, cosine = mirror_direction(normals, ways)
            out += self.mirror.mirror(cosine)[:, None] * self._around(ball, points, away, among, mirrors - 1)
        return out

    def _around(self, ball: int, points: Array, ways: Array, among: BallsAtMoment, mirrors: int) -> Array:
        """Radiance (n, c) that a ball mirrors: of sky, plate or another ball."""
        centres = among.centres
        out = np.full((len(points), self.finish.channels), self.finish.ambient)
        nearest = np.full(len(points), np.inf)
        meets = np.full(len(points), -1)
        seen = [k for k in self._neighbours(ball, centres) if self.discs[k] is None and not self.quick]
        for k in seen:
            offset = points - centres[k]
            b, c = dot(offset, ways), dot(offset, offset) - self.radii[k] ** 2
            root = b * b - c
            hit = (root > 0) & (b < 0) & (-b - np.sqrt(np.maximum(root, 0)) < nearest)
            nearest[hit] = (-b - np.sqrt(np.maximum(root, 0)))[hit]
            meets[hit] = k
        down = np.flatnonzero((meets < 0) & (ways[:, 2] < -1e-6))
        if len(down):
            hit_at = points[down] - ways[down] * (points[down, 2:] / ways[down, 2:])
            out[down] = self.plate * self.on_plate(hit_at * [1, 1, 0], centres)
        for k in seen:
            own = np.flatnonzero(meets == k)
            if len(own):
                at = points[own] + nearest[own, None] * ways[own]
                paint = np.broadcast_to(self.colours[k], (len(own), self.finish.channels))
                out[own] = self.radiance(k, at, ways[own], among, paint, mirrors)
        return out


def _cells(lamp: Lamp) -> list[LampCell]:
    """Cut a lamp into cells: one of a disc that looks narrow, 4 of half a wider lamp's width."""
    one = lamp.shape == "disc" and lamp.radius < 0.12 * float(np.linalg.norm(lamp.position))
    cells = lamp.cells(np.inf if one else lamp.half_width / 4)
    each = zip(cells.positions, cells.areas.tolist(), strict=True)
    return [LampCell(position, area, lamp.axes[:, 2], lamp.radiance) for position, area in each]


def _direction_and_size(cell: LampCell, points: Array) -> tuple[Array, Array]:
    """Unit vectors (n, 3) to a lamp's cell, and the angular radius (n,) of a disc of equal solid angle."""
    way = cell.position - points
    far = np.sqrt(dot(way, way))
    way = way / far[:, None]
    area = cell.area * np.maximum(-(way @ cell.facing), 1e-6)
    return way, np.sqrt(area / np.pi) / far


def _irradiance(cell: LampCell, points: Array, normals: Array) -> Array:
    """Light (n,) of a lamp's cell."""
    way, size = _direction_and_size(cell, points)
    mean_cosine = mean_cosine_above_horizon(dot(normals, way), np.sin(size))
    return np.asarray(cell.strength * size * size * np.pi * mean_cosine)


def _units(vectors: Array) -> Array:
    return np.asarray(vectors / np.sqrt(dot(vectors, vectors))[:, None])
