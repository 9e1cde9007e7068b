"""Reflect light in a chain of mirror spheres: Fermat's principle, solved by Newton's method.

The length of a broken line lamp -> ball -> ... -> ball -> eye is a convex function of its corners. At its minimum over
solid balls, either every corner is on a surface and reflects outwards, or none is. A sequence of balls has therefore at
most one path, which Newton's method on the spheres finds.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Paths:
    """Reflected paths of one order k."""

    points: Array  # reflection points (M, k, 3), lamp side first, m
    transfer: Array  # derivative (M, 3, 3) of the last point by the lamp's position
    cosines: Array  # cosine (M, k) of the angle of incidence at each point
    exists: NDArray[np.bool_]  # (M,) False if the straight line crosses a ball, so that nothing is reflected


def reflect(lamp: Array, eye: Array, centres: Array, radii: Array) -> Paths:
    """Find the path of light from a lamp (3,) or lamps (M, 3) over k mirror spheres, in this order, to an eye (3,).

    centres: (M, k, 3). radii: (M, k). All are in m.
    """
    count, order = centres.shape[:2]
    normals = _first_guess(lamp, eye, centres)
    ends = _join(lamp, centres, eye)
    step = np.full((count, order, 2), np.inf)
    for _ in range(40):
        ends[:, 1:-1] = centres + radii[..., None] * normals
        tangents = _tangents(normals)
        slope, curvature, pressure, first = _expand(ends, normals, tangents, radii)
        # The step after one this small is its square, which is rounding. A converged path is not changed any more, so
        # that its last bit does not depend on the other paths.
        moving = np.abs(step).max(axis=(1, 2)) > 1e-8
        if not moving.any():
            break
        step = np.linalg.solve(curvature, -slope[..., None]).reshape(count, order, 2) / radii[..., None]
        # With longer steps, one path in a thousand of balls in contact ends where the balls overlap.
        step *= np.minimum(1, 0.15 / np.maximum(np.abs(step).max(axis=(1, 2), keepdims=True), 1e-30))
        step *= moving[:, None, None]
        moved = normals + (tangents @ step[..., None])[..., 0]
        moved /= np.linalg.norm(moved, axis=2, keepdims=True)
        normals = np.where(moving[:, None, None], moved, normals)
    # Only the first corner depends on the lamp: H dq + (dslope/dlamp) dlamp = 0.
    push = np.zeros((count, 2 * order, 3))
    push[:, :2] = first
    moves = -np.linalg.solve(curvature, push)
    transfer = tangents[:, -1] @ moves[:, -2:]
    converged = np.abs(step).max(axis=(1, 2)) < 1e-6
    return Paths(ends[:, 1:-1], transfer, pressure / 2, converged & (pressure > 1e-6).all(axis=1))


def differentiate_by_tilt(lamp: Array, eye: Array, paths: Paths, centres: Array, radii: Array) -> Array:
    """Derivative (M, 3, 2k) of a path's last point by tilts of the surface, rad, about two axes at each point.

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


def _first_guess(lamp: Array, eye: Array, centres: Array) -> Array:
    """Normals (M, k, 3) half-way between the directions to the centres before and after."""
    legs = np.diff(_join(lamp, centres, eye), axis=1)
    legs /= np.linalg.norm(legs, axis=2, keepdims=True)
    normals = legs[:, 1:] - legs[:, :-1]
    # A chain to and fro between two balls leaves their line towards lamp and eye.
    normals += 0.1 * (legs[:, -1:] - legs[:, :1])
    normals += [3e-9, 5e-9, 8e-9]  # a line straight through a centre has no half-way direction
    return np.asarray(normals / np.linalg.norm(normals, axis=2, keepdims=True))


def _tangents(normals: Array) -> Array:
    """Two unit vectors across each normal: (..., 3) -> (..., 3, 2). Duff et al. 2017, JCGT 6(1)."""
    x, y, z = np.moveaxis(normals, -1, 0)
    sign = np.where(z < 0, -1.0, 1.0)
    a = -1 / (sign + z)
    b = x * y * a
    first = np.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=-1)
    second = np.stack([b, sign + y * y * a, -y], axis=-1)
    return np.stack([first, second], axis=-1)


def _expand(ends: Array, normals: Array, tangents: Array, radii: Array) -> tuple[Array, Array, Array, Array]:
    """Length of the broken line to second order in tangential moves of its corners.

    Returns the slope (M, 2k), the curvature (M, 2k, 2k), the pressure n . (u_before + u_after) (M, k) and the
    derivative of the first corner's slope by the lamp's position (M, 2, 3).
    """
    count, order = normals.shape[:2]
    legs = np.diff(ends, axis=1)
    lengths = np.linalg.norm(legs, axis=2)
    units = legs / lengths[..., None]
    across = (np.eye(3) - units[..., :, None] * units[..., None, :]) / lengths[..., None, None]
    pull = units[:, :-1] - units[:, 1:]
    turned = np.swapaxes(tangents, -1, -2)
    slope = (turned @ pull[..., None])[..., 0].reshape(count, 2 * order)
    pressure = -np.einsum("mkc,mkc->mk", normals, pull)
    curvature = np.zeros((count, 2 * order, 2 * order))
    for k in range(order):
        here = slice(2 * k, 2 * k + 2)
        bend = turned[:, k] @ (across[:, k] + across[:, k + 1]) @ tangents[:, k]
        # Off the plane of contact the sphere falls away; the floor keeps a straight-through line solvable.
        bend += (np.maximum(pressure[:, k], 1e-3) / radii[:, k])[:, None, None] * np.eye(2)
        curvature[:, here, here] = bend
        if k + 1 < order:
            there = slice(2 * k + 2, 2 * k + 4)
            cross = -turned[:, k] @ across[:, k + 1] @ tangents[:, k + 1]
            curvature[:, here, there] = cross
            curvature[:, there, here] = np.swapaxes(cross, 1, 2)
    return slope, curvature, pressure, -turned[:, 0] @ across[:, 0]


def find_hidden(
    lamp: Array, eye: Array, paths: Paths, balls: NDArray[np.intp], centres: Array, radii: Array
) -> NDArray[np.bool_]:
    """Find the paths (M,) that a third ball blocks: balls (M, k) of each path, centres (M, N, 3), radii (N,)."""
    ends = _join(lamp, paths.points, eye)
    blocked = np.zeros(len(balls), bool)
    for leg in range(balls.shape[1] + 1):
        touching = balls[:, max(leg - 1, 0) : leg + 1]
        start, way = ends[:, leg], ends[:, leg + 1] - ends[:, leg]
        for ball in range(len(radii)):
            third = ~(touching == ball).any(axis=1)
            if third.any():
                offset = centres[:, ball] - start
                along = np.clip((offset * way).sum(1) / (way * way).sum(1), 0, 1)
                blocked |= third & (np.linalg.norm(offset - along[:, None] * way, axis=1) < radii[ball])
    return blocked


@cache
def widest_pairs(mirror: float, faintest: float = 1e-4, most_bounces: int = 24) -> dict[int, float]:
    """By number of bounces, the largest distance of two balls that show such a glint, in mean radii.

    The glint must carry `faintest` of the primary. Between mirrors in contact, the flux falls slowly with the number of
    bounces, more slowly for a larger reflectance `mirror`. The distance is found with lamp and eye far overhead.
    """
    apart = 2 + np.append(0, np.geomspace(1e-3, 60, 90))
    pair = np.zeros((len(apart), 2, 3))
    pair[:, 0, 0], pair[:, 1, 0] = -apart / 2, apart / 2
    far = np.array([0.0, 0.0, 400.0])
    widest: dict[int, float] = {}
    for order in range(1, most_bounces + 1):
        paths = reflect(far, far, pair[:, np.arange(order) % 2], np.ones((len(apart), order)))
        bright = np.abs(np.linalg.det(paths.transfer[:, :2, :2])) * mirror**order * paths.exists
        if order == 1:
            primary = bright
        elif bright[0] < faintest * primary[0]:
            break
        else:
            widest[order] = float(apart[np.argmin(bright > faintest * primary)])
    return widest


def iterate_chains(centres: Array, radii: Array, mirror: float) -> Iterator[tuple[tuple[int, ...], NDArray[np.bool_]]]:
    """Iterate over the chains of balls to follow, each with the times (T,) at which it may show.

    centres: (T, N, 3). radii: (N,). mirror: reflectance of the balls. Chains of more than 4 bounces are followed only
    between two balls: in a heap, all others would be too many.
    """
    times, balls = centres.shape[:2]
    widest_pair = widest_pairs(mirror)
    gaps = np.linalg.norm(centres[:, :, None] - centres[:, None], axis=-1)
    gaps /= (radii[:, None] + radii) / 2
    gaps[:, np.arange(balls), np.arange(balls)] = np.inf
    growing: deque[tuple[tuple[int, ...], NDArray[np.bool_], Array]]
    growing = deque(((ball,), np.ones(times, bool), np.zeros(times)) for ball in range(balls))
    while growing:
        chain, mask, widest = growing.popleft()
        yield chain, mask
        order = len(chain) + 1
        for ball in range(balls) if order in widest_pair else ():
            if ball != chain[-1] and (order <= 4 or len({*chain, ball}) == 2):
                widened = np.maximum(widest, gaps[:, chain[-1], ball])
                mask = widened < widest_pair[order]
                if mask.any():
                    growing.append(((*chain, ball), mask, widened))
