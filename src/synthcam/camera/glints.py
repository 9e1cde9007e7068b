"""Find the glints, the images of the lamp in the balls: position, width and flux, without rendering."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from synthcam.camera import reflections
from synthcam.camera.pinhole import Lamp, PinholeCamera
from synthcam.camera.surface import STEEL_ON_BLACK, Surface
from synthcam_shared.arrays import Array, Flags, Index

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


@dataclass(frozen=True)
class ImageSelection:
    """Which images of a lamp are found, and into which cells the lamp is cut, each with its own image."""

    cell: float = np.inf  # half-width of the cells, m; only a wider lamp is cut
    faintest: float = reflections.MIN_RELATIVE_FLUX  # flux over that of the primary
    bounces: range = range(1, 99)  # numbers of reflections


def find_glints(
    camera: PinholeCamera,
    lamp: Lamp,
    centres: Array,
    radii: Array,
    light: Array | Flags,
    surface: Surface = STEEL_ON_BLACK,
    selection: ImageSelection = ImageSelection(),
) -> GlintImages:
    """Find the images of a lamp, without the further ones behind it, in balls.

    The image of a cell is the cell under the exact derivative of the reflected path. Its flux and its second moments
    are therefore exact to first order in its size. The path of its middle decides whether it is hidden.

    centres: (T, N, 3), m, at each moment.
    radii: (N,), m.
    light: (T, N), brightness of the lamp relative to its mean; 0 for balls whose images are not wanted.
    """
    eye, cells, axes, bounces = camera.centre, lamp.cells(selection.cell), lamp.axes, selection.bounces
    chains = selection.faintest, bounces[-1]
    widest = radii.max() * reflections.find_reach_of_reflections(surface.head_on, *chains)
    reach = reflections.find_blocking_distance(cells.positions, eye, centres, radii, widest)
    near = reflections.find_neighbours(centres, reach)
    lengths = reflections.iterate_chains(len(centres), radii, near, surface.head_on, *chains)
    found = []
    for balls, when in _batch_chains(lengths, light != 0, bounces, MAX_PATHS_AT_ONCE // len(cells.areas)):
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
        seen = paths.exists & ~reflections.find_blocked_paths(source, eye, paths, balls, centres, radii, moment, near)
        if lamp.towards is not None:
            seen &= (paths.points[:, 0] - source) @ axes[:, 2] > 0
        order, ball = np.full(len(moment), balls.shape[1]), balls[:, -1]
        lobes = [(spread, flux)]
        if surface.roughness or surface.scratches:  # tilted: the variance by facets that are tilted by 1 rad rms, px^2
            tilted = ((slope @ reflections.differentiate_by_tilt(source, eye, paths, positions, spheres)) ** 2).sum(2)
            slopes = surface.roughness, np.hypot(surface.roughness, surface.scratch_slope)
            shares = zip(slopes, (1 - surface.scratches, surface.scratches), strict=True)
            lobes = [(spread + rms**2 * tilted, share * flux) for rms, share in shares if share]
        found += [[x[seen] for x in (moment, ball, pixels, wide, bright, order)] for wide, bright in lobes]
    none, flat, nowhere = np.zeros(0, np.intp), np.zeros(0), np.zeros((0, 2))
    found.append([none, none, nowhere, nowhere, flat, none])
    return GlintImages(*[np.concatenate(parts) for parts in zip(*found, strict=True)])


def _batch_chains(
    lengths: Iterable[tuple[Index, Index]], wanted: Flags, bounces: range, paths: int
) -> Iterator[tuple[Index, Index]]:
    """Batch the chains of each length: balls (n, k) and moments (n,), with all moments of a chain in one batch.

    wanted: (T, N). A batch ends as soon as it has more than `paths`.
    """
    for chains, moments in lengths:
        if chains.shape[1] not in bounces:
            continue
        seen = np.flatnonzero(wanted[moments, chains[:, -1]])
        balls, when = chains[seen], moments[seen]
        ends = np.append(np.flatnonzero((balls[1:] != balls[:-1]).any(axis=1)) + 1, len(balls))
        first = 0
        while first < len(balls):
            last = int(ends[min(int(np.searchsorted(ends, first + paths, "right")), len(ends) - 1)])
            yield balls[first:last], when[first:last]
            first = last


def narrow_cell(camera: PinholeCamera, lamp: Lamp, seen: Array) -> float:
    """Half-width, m, of the cells of a lamp whose images have the variances `seen`, px^2: there, 0.4 of the blur's."""
    share = lamp.cells(np.inf).spread[0, :2].sum() / max(seen.sum(), 1e-30)
    return float(0.4 * camera.psf_sigma_px * np.sqrt(share))


def join_glints(many: list[GlintImages]) -> GlintImages:
    """Join the glints of several lamps."""
    return GlintImages(*[np.concatenate([getattr(g, name) for g in many]) for name in GlintImages.__dataclass_fields__])
