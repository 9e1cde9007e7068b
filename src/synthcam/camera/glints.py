"""Find the glints, the images of the lamp in the balls: position, width and flux, without rendering."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from synthcam.camera import reflections
from synthcam.camera.pinhole import Lamp, PinholeCamera
from synthcam.camera.surface import STEEL_ON_BLACK, Surface

Array = NDArray[np.float64]
Index = NDArray[np.intp]
MAX_PATHS_AT_ONCE = 4096  # larger batches save no time


@dataclass(frozen=True)
class GlintImages:
    """Images of a lamp, or of its cells, in the balls."""

    moment: Index  # of the sub-exposure (G,)
    ball: Index  # on which the image is seen (G,)
    pixels: Array  # position (G, 2), px
    spread: Array  # variance of the lamp's image along columns and rows (G, 2), px^2
    flux: Array  # solid angle in px^2 times reflectance (G,)
    order: Index  # number of bounces (G,)


def find_glints(
    camera: PinholeCamera,
    lamp: Lamp,
    centres: Array,
    radii: Array,
    light: Array | NDArray[np.bool_],
    surface: Surface = STEEL_ON_BLACK,
    cell: float = np.inf,
) -> GlintImages:
    """Find the images of a lamp, without the further ones behind it, in balls.

    Images weaker than 1e-4 of the primary are left out (`reflections.widest_pairs`). The image of a cell is the cell
    under the exact derivative of the reflected path. Its flux and its second moments are therefore exact to first order
    in its size. The path of its middle decides whether it is hidden.

    centres: (T, N, 3), m, at each moment. radii: (N,), m. light: (T, N), brightness of the lamp relative to its mean;
    0 for balls whose images are not wanted. cell: a wider lamp is cut into cells of this half-width, m, each with its
    own image.
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
        if surface.roughness or surface.scratches:  # tilted: spread by facets of 1 rad rms
            tilted = ((slope @ reflections.differentiate_by_tilt(source, eye, paths, positions, spheres)) ** 2).sum(2)
            slopes = surface.roughness, np.hypot(surface.roughness, surface.scratch_slope)
            shares = 1 - surface.scratches, surface.scratches
            both = zip(slopes, shares, strict=True)
            lobes = [(spread + rms**2 * tilted, share * flux) for rms, share in both if share]
        found += [[x[seen] for x in (moment, ball, pixels, wide, bright, order)] for wide, bright in lobes]
    none, flat, nowhere = np.zeros(0, np.intp), np.zeros(0), np.zeros((0, 2))
    found.append([none, none, nowhere, nowhere, flat, none])
    return GlintImages(*[np.concatenate(parts) for parts in zip(*found, strict=True)])


def _batch_chains(
    chains: Iterable[tuple[tuple[int, ...], NDArray[np.bool_]]], wanted: NDArray[np.bool_], cells: int
) -> Iterator[tuple[Index, Index]]:
    """Batch the chains of one length: balls (n, k) and sub-exposures (n,)."""
    for _, of_length in groupby(chains, key=lambda found: len(found[0])):
        balls: list[Index] = []
        moments: list[Index] = []
        for chain, active in of_length:
            when = np.flatnonzero(active & wanted[:, chain[-1]])
            if len(when):
                balls.append(np.tile(np.array(chain, np.intp), (len(when), 1)))
                moments.append(when)
            if sum(map(len, moments)) * cells > MAX_PATHS_AT_ONCE:
                yield np.concatenate(balls), np.concatenate(moments)
                balls, moments = [], []
        if moments:
            yield np.concatenate(balls), np.concatenate(moments)


def narrow_cell(camera: PinholeCamera, lamp: Lamp, seen: Array) -> float:
    """Half-width, m, of the cells of a lamp whose images have the variances `seen`, px^2: there, 0.4 of the blur's."""
    share = lamp.cells(np.inf).spread[0, :2].sum() / max(seen.sum(), 1e-30)
    return float(0.4 * camera.psf_sigma_px * np.sqrt(share))


def join_glints(many: list[GlintImages]) -> GlintImages:
    """Join the glints of several lamps."""
    return GlintImages(*[np.concatenate([getattr(g, name) for g in many]) for name in GlintImages.__dataclass_fields__])
