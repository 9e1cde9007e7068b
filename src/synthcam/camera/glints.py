"""The lamp's images in the balls: where they are seen, how wide and how bright, without drawing anything."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from synthcam.camera import reflections
from synthcam.camera.pinhole import Lamp, PinholeCamera
from synthcam.camera.surface import Surface

Array = NDArray[np.float64]
PLAIN = Surface()
PATHS = 4096  # after so many at once, more save no time


@dataclass(frozen=True)
class GlintImages:
    """Images of a lamp, or of a part of one, in the balls.

    moment, ball: (G,) which sub-exposure, and the ball it is seen on. pixels: (G, 2). spread: (G, 2) px^2,
    variance of the lamp's image along columns and rows. flux: (G,) solid angle in px^2 times reflectance.
    order: (G,) number of bounces.
    """

    moment: NDArray[np.intp]
    ball: NDArray[np.intp]
    pixels: Array
    spread: Array
    flux: Array
    order: NDArray[np.intp]


def find_glints(
    camera: PinholeCamera,
    lamp: Lamp,
    centres: Array,
    radii: Array,
    light: Array | NDArray[np.bool_],
    surface: Surface = PLAIN,
    cell: float = np.inf,
) -> GlintImages:
    """Find the images of a lamp in balls.

    Images weaker than 1e-4 of the primary are left out (`reflections.reach`). A cell's image is the cell under the
    exact derivative of the reflected path, so its flux and its second moments are exact to first order in its size; its
    middle's path decides whether it is hidden.

    Parameters
    ----------
    camera : Camera
    lamp : Lamp
        Without the further ones behind it.
    centres : ndarray of shape (T, N, 3)
        Of the balls at each moment, m.
    radii : ndarray of shape (N,)
        m.
    light : ndarray of shape (T, N)
        The lamp's brightness at each moment, relative to its mean; 0 for balls of which no image is wanted.
    surface : Surface
    cell : float
        A lamp wider than this, m, is cut into cells of that half-width, each with an image of its own.

    Returns
    -------
    Glints
    """
    eye, cells, axes = camera.centre, lamp.cells(cell), lamp.axes
    found = []
    for balls, when in _batch_chains(
        reflections.iterate_chains(centres, radii, surface.head_on), light != 0, len(cells.areas)
    ):
        part = np.tile(np.arange(len(cells.areas)), len(when))
        moment, balls = (np.repeat(x, len(cells.areas), axis=0) for x in (when, balls))
        source, (uu, vv, uv) = cells.positions[part], cells.spread[part].T[..., None]
        spheres, positions = radii[balls], centres[moment[:, None], balls]
        paths = reflections.reflect(source, eye, positions, spheres)
        pixels, slope = camera.project_with_slope(paths.points[:, -1])
        shape = (slope @ paths.transfer) @ axes[:, :2]
        area = cells.areas[part] * lamp.radiance * np.abs(np.linalg.det(shape))
        flux = area * np.prod(surface.mirror(paths.cosines), axis=1) * light[moment, balls[:, -1]]
        u, v = shape[..., 0], shape[..., 1]
        spread = u * u * uu + v * v * vv + 2 * u * v * uv
        seen = paths.exists & ~reflections.find_hidden(source, eye, paths, balls, centres[moment], radii)
        if lamp.towards is not None:
            seen &= (paths.points[:, 0] - source) @ axes[:, 2] > 0
        order, ball = np.full(len(moment), balls.shape[1]), balls[:, -1]
        lobes = [(spread, flux)]
        if surface.roughness or surface.scratches:
            tilted = ((slope @ reflections.differentiate_by_tilt(source, eye, paths, positions, spheres)) ** 2).sum(2)
            lobes = _lobes(surface, tilted, spread, flux)
        found += [[x[seen] for x in (moment, ball, pixels, wide, bright, order)] for wide, bright in lobes]
    if not found:
        none, flat, nowhere = np.zeros(0, np.intp), np.zeros(0), np.zeros((0, 2))
        return GlintImages(none, none, nowhere, nowhere, flat, none)
    return GlintImages(*[np.concatenate(parts) for parts in zip(*found, strict=True)])


def _lobes(surface: Surface, tilted: Array, spread: Array, flux: Array) -> list[tuple[Array, Array]]:
    """Spread (n, 2) px^2 and flux (n,) of each lobe of a rough surface; tilted (n, 2): px^2 for facets of 1 rad rms."""
    slopes = (
        (surface.roughness, 1 - surface.scratches),
        (np.hypot(surface.roughness, surface.scratch_slope), surface.scratches),
    )
    return [(spread + rms**2 * tilted, share * flux) for rms, share in slopes if share]


def _batch_chains(
    chains: Iterable[tuple[tuple[int, ...], NDArray[np.bool_]]], wanted: NDArray[np.bool_], cells: int
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Chains of one length together, as many as make a good batch: balls (n, k) and sub-exposures (n,)."""
    for _, alike in groupby(chains, key=lambda found: len(found[0])):
        balls: list[NDArray[np.intp]] = []
        moments: list[NDArray[np.intp]] = []
        for chain, active in alike:
            when = np.flatnonzero(active & wanted[:, chain[-1]])
            if len(when):
                balls.append(np.tile(np.array(chain, np.intp), (len(when), 1)))
                moments.append(when)
            if sum(map(len, moments)) * cells > PATHS:
                yield np.concatenate(balls), np.concatenate(moments)
                balls, moments = [], []
        if moments:
            yield np.concatenate(balls), np.concatenate(moments)


def join_glints(many: list[GlintImages]) -> GlintImages:
    """All glints of several lamps."""
    if len(many) == 1:
        return many[0]
    return GlintImages(*[np.concatenate([getattr(g, name) for g in many]) for name in GlintImages.__dataclass_fields__])
