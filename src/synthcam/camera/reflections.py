"""Reflect light in a chain of mirror spheres: Fermat's principle, solved by Newton's method.

The length of a broken line lamp -> ball -> ... -> ball -> eye is a convex function of its corners. At its minimum over
solid balls, either every corner is on a surface and reflects outwards, or none is. A sequence of balls has therefore at
most one path, which Newton's method on the spheres finds.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.spatial import cKDTree

from synthcam_shared.arrays import Array, Flags, Index

UNIT_2, UNIT_3 = np.eye(2), np.eye(3)
MAX_BOUNCES = 24  # that are followed between two balls
MIN_RELATIVE_FLUX = 1e-4  # flux of a secondary glint over that of the primary, below which it is left out


@dataclass(frozen=True)
class Paths:
    """Reflected paths of one order k."""

    points: Array  # reflection points (M, k, 3), lamp side first, m
    transfer: Array  # derivative (M, 3, 3) of the last point by the lamp's position
    cosines: Array  # cosine (M, k) of the angle of incidence at each point
    exists: Flags  # (M,) False if the straight line crosses a ball, so that nothing is reflected


def reflect(lamp: Array, eye: Array, centres: Array, radii: Array) -> Paths:
    """Find the path of light from a lamp (3,) or lamps (M, 3) over k mirror spheres, in this order, to an eye (3,).

    centres: (M, k, 3). radii: (M, k). All are in m.
    """
    count, order = centres.shape[:2]
    ends = _join(lamp, centres, eye)
    legs = ends[:, 1:] - ends[:, :-1]
    legs /= _lengths(legs)[..., None]
    normals = legs[:, 1:] - legs[:, :-1]  # half-way between the directions to the centres before and after
    # A chain to and fro between two balls leaves their line towards lamp and eye.
    normals += 0.1 * (legs[:, -1:] - legs[:, :1])
    normals += [3e-9, 5e-9, 8e-9]  # a line straight through a centre has no half-way direction
    normals /= _lengths(normals)[..., None]
    moving, last = np.arange(count), np.full(count, np.inf)  # paths, and the size of their last step
    for _ in range(40):
        own, corners, spheres = normals[moving], ends[moving], radii[moving]
        corners[:, 1:-1] = centres[moving] + spheres[..., None] * own
        tangents = _tangents(own)
        slope, curvature, _, _ = _expand(corners, own, tangents, spheres)
        step = np.linalg.solve(curvature, -slope[..., None]).reshape(-1, order, 2) / spheres[..., None]
        # With longer steps, one path in a thousand of balls in contact ends where the balls overlap.
        longest = np.abs(step).max(axis=(1, 2))
        share = np.minimum(1, 0.15 / np.maximum(longest, 1e-30))
        moved = own + (tangents @ (step * share[:, None, None])[..., None])[..., 0]
        normals[moving] = moved / _lengths(moved)[..., None]
        last[moving] = longest * share
        moving = moving[last[moving] > 1e-8]  # the step after one this small is its square, which is rounding
        if not len(moving):
            break
    ends[:, 1:-1] = centres + radii[..., None] * normals
    tangents = _tangents(normals)
    _, curvature, pressure, across = _expand(ends, normals, tangents, radii)
    # Only the first corner depends on the lamp: H dq + (dslope/dlamp) dlamp = 0.
    push = np.zeros((count, 2 * order, 3))
    push[:, :2] = -np.swapaxes(tangents, -1, -2)[:, 0] @ across
    moves = -np.linalg.solve(curvature, push)
    transfer = tangents[:, -1] @ moves[:, -2:]
    return Paths(ends[:, 1:-1], transfer, pressure / 2, (last < 1e-6) & (pressure > 1e-6).all(axis=1))


def differentiate_by_tilt(lamp: Array, eye: Array, paths: Paths, centres: Array, radii: Array) -> Array:
    """Derivative (M, 3, 2k) of a path of light at its last point by tilts of the mirrors, rad, about two axes at each.

    A tilt by a changes the gradient of the length along the facet by a times the pressure: H dq = -a pressure.
    """
    normals = (paths.points - centres) / radii[..., None]
    tangents = _tangents(normals)
    _, curvature, pressure, _ = _expand(_join(lamp, paths.points, eye), normals, tangents, radii)
    push = np.eye(2 * centres.shape[1]) * np.repeat(pressure, 2, axis=1)[:, None, :]
    return np.asarray(-tangents[:, -1] @ np.linalg.solve(curvature, push)[:, -2:])


def _join(lamp: Array, points: Array, eye: Array) -> Array:
    """Corners (M, k + 2, 3) of the broken lines from the lamp over points (M, k, 3) to the eye."""
    ends = np.empty((len(points), points.shape[1] + 2, 3))
    ends[:, 0], ends[:, 1:-1], ends[:, -1] = lamp, points, eye
    return ends


def _lengths(vectors: Array) -> Array:
    """Lengths (...) of vectors (..., 3), summed as np.linalg.norm sums them, in half its time for few."""
    squares = vectors * vectors
    return np.asarray(np.sqrt(squares[..., 0] + squares[..., 1] + squares[..., 2]))


def _tangents(normals: Array) -> Array:
    """Two unit vectors across each normal: (..., 3) -> (..., 3, 2). Duff et al. 2017, JCGT 6(1)."""
    x, y, z = normals[..., 0], normals[..., 1], normals[..., 2]
    sign = np.where(z < 0, -1.0, 1.0)
    a = -1 / (sign + z)
    b = x * y * a
    both = np.empty((*normals.shape, 2))
    both[..., 0, 0], both[..., 0, 1] = 1 + sign * x * x * a, b
    both[..., 1, 0], both[..., 1, 1] = sign * b, sign + y * y * a
    both[..., 2, 0], both[..., 2, 1] = -sign * x, -y
    return both


def _expand(ends: Array, normals: Array, tangents: Array, radii: Array) -> tuple[Array, Array, Array, Array]:
    """Length of the broken line to second order in tangential moves of its corners.

    Returns the slope (M, 2k), the curvature (M, 2k, 2k), the pressure n . (u_before + u_after) (M, k), and how the
    direction of the first leg changes with its end (M, 3, 3).
    """
    count, order = normals.shape[:2]
    legs = ends[:, 1:] - ends[:, :-1]
    lengths = _lengths(legs)
    units = legs / lengths[..., None]
    across = (UNIT_3 - units[..., :, None] * units[..., None, :]) / lengths[..., None, None]
    pull = units[:, :-1] - units[:, 1:]
    turned = np.swapaxes(tangents, -1, -2)
    slope = (turned @ pull[..., None])[..., 0].reshape(count, 2 * order)
    pressure = -np.einsum("mkc,mkc->mk", normals, pull)
    bend = turned @ (across[:, :-1] + across[:, 1:]) @ tangents
    # Off the plane of contact the sphere falls away; the floor keeps a straight-through line solvable.
    bend += (np.maximum(pressure, 1e-3) / radii)[..., None, None] * UNIT_2
    if order == 1:
        return slope, bend[:, 0], pressure, across[:, 0]
    cross = -turned[:, :-1] @ across[:, 1:-1] @ tangents[:, 1:]
    blocks = np.zeros((count, order, 2, order, 2))
    for k in range(order):
        blocks[:, k, :, k] = bend[:, k]
        if k + 1 < order:
            blocks[:, k, :, k + 1] = cross[:, k]
            blocks[:, k + 1, :, k] = np.swapaxes(cross[:, k], 1, 2)
    curvature = blocks.reshape(count, 2 * order, 2 * order)
    return slope, curvature, pressure, across[:, 0]


def find_blocked_paths(
    lamp: Array, eye: Array, paths: Paths, balls: Index, centres: Array, radii: Array, moment: Index, near: "NearBalls"
) -> Flags:
    """Find the paths of light (M,) that a third ball blocks.

    balls: (M, k) of each path.
    centres: (T, N, 3).
    radii: (N,).
    moment: (M,) of each path.
    near: within the distance that `find_blocking_distance` gives. Only balls near a ball of the path can block it: its
    legs join such balls, or leave the layer in which balls are.
    """
    ends, order, ceiling = _join(lamp, paths.points, eye), balls.shape[1], (centres[..., 2] + radii).max()
    blocked = np.zeros(len(balls), bool)
    for leg in range(order + 1):
        ball, start, end = balls[:, max(leg - 1, 0)], ends[:, max(leg, 1)], ends[:, leg + 1 if leg else 0]
        length = np.linalg.norm(end - start, axis=1)
        if leg in (0, order):
            length *= np.clip((ceiling - start[:, 2]) / np.maximum(end[:, 2] - start[:, 2], 1e-30), 0, 1)
        far = length + radii[ball] + radii.max()
        row = moment * len(radii) + ball
        for k in range(int(near.counts[row].max(initial=0))):
            path = np.flatnonzero((k < near.counts[row]) & ~blocked)
            entry = near.first[row[path]] + k
            close = near.distance[entry] < far[path]
            path, third = path[close], near.other[entry[close]]
            if not len(path):
                break
            free = ~(balls[path, max(leg - 1, 0) : leg + 1] == third[:, None]).any(axis=1)
            path, third = path[free], third[free]
            start, way = ends[path, leg], ends[path, leg + 1] - ends[path, leg]
            offset = centres[moment[path], third] - start
            along = np.clip((offset * way).sum(1) / (way * way).sum(1), 0, 1)
            blocked[path] = np.linalg.norm(offset - along[:, None] * way, axis=1) < radii[third]
    return blocked


def find_blocking_distance(lamps: Array, eye: Array, centres: Array, radii: Array, leg: float) -> Array:
    """Find how far from a ball, (N,), m, another can block a path of light between mirror balls up to `leg` apart.

    lamps: (L, 3). From lamp and eye, light is among balls only in the lowest layer.
    """
    ceiling, longest = (centres[..., 2] + radii).max(), leg
    for apex in (*np.atleast_2d(lamps), eye):
        away = np.abs(apex[:2] - centres[..., :2]).max(axis=(0, 1)) + radii.max()
        high = apex[2] - ceiling
        share = min(ceiling / high, 1.0) if high > 0 else 1.0
        longest = max(longest, float(np.hypot(np.hypot(*away), apex[2]) * share))
    return np.full(len(radii), longest + 2 * radii.max())


@dataclass(frozen=True)
class NearBalls:
    """NearBalls of N balls at T moments, those of one ball and moment together and nearest first."""

    other: Index  # the neighbour (P,)
    distance: Array  # of the centres (P,), m
    first: Index  # number in these of the first neighbour of ball i at moment t (T N,), at t N + i
    counts: Index  # how many there are (T N,)


def find_neighbours(centres: Array, reach: Array) -> NearBalls:
    """Find the balls that may block or reflect light between others: centres (T, N, 3), m, within reach (N,), m."""
    count, balls = centres.shape[:2]
    flat, furthest = centres.reshape(-1, 3), float(reach.max()) * (1 + 1e-9)
    # Moments lie apart along a fourth axis, so that one tree serves all of them.
    apart = np.repeat(np.arange(count) * 2 * furthest, balls)
    pairs = cKDTree(np.column_stack([flat, apart])).query_pairs(furthest, output_type="ndarray")
    own, other = np.concatenate([pairs, pairs[:, ::-1]]).T
    distance = np.linalg.norm(flat[own] - flat[other], axis=-1)
    order = np.lexsort([other, distance, own])
    order = order[distance[order] < reach[own[order] % balls]]
    counts = np.bincount(own[order], minlength=count * balls)
    return NearBalls(other[order] % balls, distance[order], np.cumsum(counts) - counts, counts)


@cache
def tabulate_pair_brightness(mirror: float, faintest: float = MIN_RELATIVE_FLUX) -> tuple[Array, Array]:
    """Tabulate the brightness (K, n) of light after 1 to K reflections between two balls, over the primary glint.

    The balls are at distances (n,), in mean radii, which are returned first; lamp and eye are far overhead. The glint
    of K bounces is the last that carries `faintest` of the primary at contact. Two bounces fall as the inverse square
    of the distance. Between mirrors in contact, the flux falls slowly with the number of bounces, more slowly for a
    larger reflectance `mirror`.
    """
    apart = 2 + np.append(0, np.geomspace(1e-3, 60, 90))
    pair = np.zeros((len(apart), 2, 3))
    pair[:, 0, 0], pair[:, 1, 0] = -apart / 2, apart / 2
    far = np.array([0.0, 0.0, 400.0])
    found = list[Array]()
    for order in range(1, MAX_BOUNCES + 1):
        paths = reflect(far, far, pair[:, np.arange(order) % 2], np.ones((len(apart), order)))
        bright = np.abs(np.linalg.det(paths.transfer[:, :2, :2])) * mirror**order * paths.exists
        if found and bright[0] < faintest * found[0][0]:
            break
        found.append(bright)
    return apart, np.array(found) / found[0]


def find_reach_of_reflections(
    mirror: float, faintest: float = MIN_RELATIVE_FLUX, most_bounces: int = MAX_BOUNCES
) -> float:
    """Find the distance of two balls, in mean radii, beyond which light reflected between them is below `faintest`."""
    apart, bright = tabulate_pair_brightness(mirror, faintest)
    if min(len(bright), most_bounces) == 1:
        return 0.0
    return float(apart[min((bright[1] > faintest).sum(), len(apart) - 1)])


def iterate_chains(
    moments: int,
    radii: Array,
    near: NearBalls,
    mirror: float,
    faintest: float = MIN_RELATIVE_FLUX,
    most_bounces: int = MAX_BOUNCES,
) -> Iterator[tuple[Index, Index]]:
    """Iterate over the lengths k of chains of mirror spheres to follow: balls (M, k) and moments (M,), in order.

    radii: (N,).
    near: at so many moments, within the reach of `find_reach_of_reflections`.
    mirror: reflectance of the balls.

    A chain is left out if an upper limit of its brightness is below `faintest` of the primary. For this limit the legs
    are taken from the longest to the shortest. Each dims the glint as one more bounce does between two balls at that
    distance. Chains of more than 4 bounces are followed only between two balls: in a heap, all others would be too
    many.
    """
    balls, at_once = len(radii), 8192  # chains that grow together, to save memory
    apart, bright = tabulate_pair_brightness(mirror, faintest)
    moment, ball = np.divmod(np.arange(moments * balls), balls)
    order = np.lexsort([moment, ball])
    chains, moment, gaps = ball[order][:, None], moment[order], np.zeros((moments * balls, 0))
    yield chains, moment
    # Neighbours beyond the widest gap make no image: of each ball's list, so many come first.
    widest = float(apart[min((bright[1] > faintest).sum(), len(apart) - 1)]) if len(bright) > 1 else 0.0
    reaching = np.append(0, np.cumsum(near.distance < (widest + 1e-9) * radii.max()))
    within = reaching[near.first + near.counts] - reaching[near.first]
    for length in range(2, min(len(bright), most_bounces) + 1):
        found = []
        for first in range(0, len(chains), at_once):
            some = slice(first, first + at_once)
            row = moment[some] * balls + chains[some, -1]
            many = within[row]
            grown = first + np.repeat(np.arange(len(row)), many)
            entry = np.repeat(near.first[row] - np.cumsum(many) + many, many) + np.arange(len(grown))
            other = near.other[entry]
            gap = near.distance[entry] / ((radii[chains[grown, -1]] + radii[other]) / 2)
            legs = np.sort(np.column_stack([gaps[grown], gap]), axis=1)[:, ::-1]
            place = np.clip(np.searchsorted(apart, legs, "right") - 1, 0, len(apart) - 1)
            step = [bright[k + 1, place[:, k]] / np.maximum(bright[k, place[:, k]], 1e-300) for k in range(length - 1)]
            kept = (gap < apart[-1]) & (np.prod(step, axis=0) > faintest)
            if length > 4:
                there = np.column_stack([chains[grown], other])
                kept &= (there[:, 2:] == there[:, :-2]).all(axis=1)
            found.append((grown[kept], other[kept], gap[kept]))
        grown, other, gap = (np.concatenate(part) for part in zip(*found, strict=True))
        chains, moment = np.column_stack([chains[grown], other]), moment[grown]
        gaps = np.column_stack([gaps[grown], gap])
        order = np.lexsort([moment, *chains.T[::-1]])
        chains, moment, gaps = chains[order], moment[order], gaps[order]
        if not len(chains):
            return
        yield chains, moment
