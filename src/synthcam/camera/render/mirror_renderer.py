"""Render films of mirror balls: the balls by pyrender, the images of the lamp in closed form.

Our own shader ray-traces the balls into one float32 channel without the lamp. The images of the lamp are small and
bright; they are added from their exact positions, fluxes and second moments.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike

from synthcam.camera.exposure import (
    BallSquares,
    Picture,
    SubExposures,
    add_to_plate,
    blur_matrix,
    blur_tiles,
    integrate_spots,
    merge_sub_exposures,
    outline_half_width,
    place_sub_exposures,
)
from synthcam.camera.glints import GlintImages, ImageSelection, find_glints, join_glints, narrow_cell
from synthcam.camera.pinhole import Lamp, PinholeCamera
from synthcam.camera.plate import (
    BLACK_PLATE_RADIANCE,
    compute_gloss,
    compute_grain,
    compute_irradiance,
    is_plain_plate,
    plate_points,
    shadow_casters,
)
from synthcam.camera.reflections import MIN_RELATIVE_FLUX, find_neighbours
from synthcam.camera.render.ball_squares import divide_balls
from synthcam.camera.render.canvas import BUFFER_SIDE, MAX_BALLS_PER_CALL, BallBatch, get_canvas
from synthcam.camera.renderer import Centres, Renderer
from synthcam.camera.surface import STEEL_ON_BLACK, STEEL_REFLECTANCE, Surface
from synthcam_shared.arrays import Array, Float32, Index

FINENESS = 3  # samples of a ball per pixel, along rows and along columns
EXPOSURES_PER_BATCH = 128


class DrawnParts(IntEnum):
    """The parts of a picture that the shader can draw; its SCENE."""

    BALLS = 0
    ON_PLATE = 1  # balls, with their images in the plate
    SHADES = 2  # the light that they take from the plate
    PLATE_ALONE = 3


class MirrorRenderer(Renderer):
    """The view of one camera on a black plate under one lamp or two, with any number of steel balls.

    radii: one a ball, m.
    room: radiance of the dim surroundings that a ball shows at its top, over the peak of its glint; towards the horizon
    it fades to the radiance of the plate.
    faintest: the brightness over that peak below which a secondary glint or the image of a neighbour is left out; for
    more than two balls.

    Raises NoGL if OpenGL cannot draw, ValueError if a lamp is in view or the lens bends too strongly within one ball.
    """

    def __init__(
        self,
        camera: PinholeCamera,
        lamp: Lamp,
        radii: Sequence[float],
        room: float = 0.02,
        surface: Surface = STEEL_ON_BLACK,
        faintest: float = MIN_RELATIVE_FLUX,
    ) -> None:
        self._canvas = get_canvas()
        self.room, self.surface = room, surface
        super().__init__(camera, lamp, np.array(radii, float))
        self._check_lens()
        self._cells = [narrow_cell(camera, each, self._find_resting_glint(each, np.inf).spread) for each in lamp.all]
        self._unit = self._measure_unit()
        self._uniforms = {
            "up": camera.R[:, 2].copy(),
            "zenith": float(room / surface.head_on),
            "steel": float(STEEL_REFLECTANCE),
            "metal": np.array(surface.steel or (0.0, 0.0)),
            "gloss": surface.plate_gloss,
            "lamp": np.zeros(3),
        }
        self.faintest = MIN_RELATIVE_FLUX if len(self.radii) <= 2 else faintest
        self._mirror_reach, self._shade_reach = self._find_reaches()
        self._defines = ({"PAIR": 1} if len(self.radii) <= 2 else {}) | ({"METAL": 1} if surface.steel else {})
        self._plain = is_plain_plate(lamp, surface)
        self._slope = 0.0 if self._plain else self._find_steepest()
        self._lit = np.zeros((1, 1), np.float32)
        self.plate = self._draw_plate() if self._plain else self._compute_plate()
        self.plate.flags.writeable = False
        self.plates = (self.plate,)

    def _find_resting_glint(self, lamp: Lamp, cell: float) -> GlintImages:
        rest, one = np.array([[[0, 0, self.radii[0]]]]), np.ones((1, 1), bool)
        return find_glints(self.camera, lamp, rest, self.radii[:1], one, self.surface, ImageSelection(cell))

    def _measure_unit(self) -> float:
        """The factor that makes the peak of the glint of a ball at rest 1."""
        whole, glints = (self._find_resting_glint(self.lamp, cell) for cell in (np.inf, self._cells[0]))
        lone = len(glints.flux) == 1 and self.psf.is_gaussian
        half = 0 if lone else self.psf.margin + int(np.ceil(np.abs(glints.pixels - whole.pixels[:1]).max()))
        position = glints.pixels - whole.pixels[0] + half
        spread = glints.spread + self.camera.psf_sigma_px**2
        rows, columns = integrate_spots(position, spread, np.zeros((1, 2)), 2 * half + 1, self.psf.steps)
        if lone:
            return float(1 / (glints.flux * rows[0, 0] * columns[0, 0])[0])
        spot = ((rows * glints.flux[:, None]).T @ columns)[None].astype(np.float32)
        return float(1 / self.psf.spread(spot).max())

    def _find_reaches(self) -> tuple[Array, Array]:
        """Distances (N,), m, within which balls mirror each other, and shade each other's surroundings.

        A ball's image in a neighbour at distance d covers .1 (r R / d)^2, for radii r and R. Through optics and pixel
        of together s^2, this spot has a peak of the room's radiance times its area over 2 pi s^2.
        """
        # further away, single precision no longer suffices, and an image is 1e-5 of the ball
        limit = 60.0 * self.radii
        if len(self.radii) <= 2:
            return limit, limit
        wide = self.camera.psf_sigma_px**2 + self.camera.defocus_px**2 / 4 + 1 / 12
        peak = self.room * 0.1 * (self.radii.max() / self.camera.scale) ** 2 / (2 * np.pi * wide)
        bright = self.radii * np.sqrt(peak / self.faintest)
        touching = 2.5 * (self.radii + self.radii.max())  # what may cover a ball is drawn with it
        return np.minimum(limit, np.maximum(bright, touching)), limit

    def _check_lens(self) -> None:
        """Refuse a lens that is not nearly linear within a ball: its curvature must be far below a sample."""
        camera, radius = self.camera, self.radii.max()
        if not camera.dist.any():
            return
        w, h = np.array(camera.size)
        columns, rows = np.meshgrid(np.linspace(-0.1, 1.1, 25) * w, np.linspace(-0.1, 1.1, 25) * h)
        flat = np.stack([columns, rows, np.ones_like(rows)], axis=-1).reshape(-1, 3) @ np.linalg.inv(camera.K).T
        seen = flat * np.linalg.norm(camera.centre)
        middle, slope = camera.project_with_slope((seen - camera.t) @ camera.R)
        inside = np.all((middle > -0.1 * w) & (middle < [1.1 * w, 1.1 * h]), axis=1)
        bend = 0.0
        for side in radius * np.array([[1, 0, 0], [0, 1, 0], [0.7, 0.7, 0], [0.7, -0.7, 0]]):
            curved = camera.project((seen + side - camera.t) @ camera.R) - middle - slope @ (camera.R.T @ side)
            bend = max(bend, float(np.linalg.norm(curved[inside], axis=1).max(initial=0)))
        if bend > 0.05:
            outline = f"bends a ball's outline by {bend:.2g} px, more than 0.05"
            raise ValueError(f"camera distortion {camera.dist.tolist()} {outline}")

    def _draw_plate(self) -> Float32:
        w, h = self.camera.size
        unit = self.lamp.position[2]
        jobs = self._jobs(np.zeros((1, 3)), np.array([unit]), fineness=1)
        middle = self.camera.project(np.zeros(3)) + 0.5
        jobs[0, 0, 2:] = middle
        jobs[0, 3] = 0, np.maximum(middle, [w, h] - middle).max() + 1, 0, BLACK_PLATE_RADIANCE * self.room
        uniforms = self._uniforms | {"lamp": self.camera.R @ self.lamp.position / unit}
        alone = BallBatch(jobs, np.zeros((1, 1, 4), np.float32), {"SCENE": DrawnParts.PLATE_ALONE})
        plate = self._canvas.draw([alone], (h, w), uniforms)
        return plate.copy() if self._vignette is None else plate * self._vignette

    def _compute_plate(self) -> Float32:
        points, surface = plate_points(self.camera), self.surface
        dull = BLACK_PLATE_RADIANCE * self.room * compute_irradiance(self.lamp, points)
        lit, mirrored = dull * compute_grain(surface, points) if surface.plate_texture else dull, np.zeros(1)
        if surface.plate_gloss:
            lit = lit + self._unit * compute_gloss(self.lamp, surface, self.camera.centre, points)
            way = self.camera.centre - points
            up = way[..., 2] / np.linalg.norm(way, axis=-1)
            mirrored = surface.plate_gloss * (dull + (self.room / surface.head_on - dull) * up)
        shade: Array | Float32 = np.ones(1) if self._vignette is None else self._vignette
        self._lit = (lit * shade).astype(np.float32)
        return ((lit + mirrored) * shade).astype(np.float32)

    def _find_steepest(self) -> float:
        """Tangent of the largest angle of incidence of the lamps' light on the plate in view."""
        w, h = self.camera.size
        corners = plate_points(self.camera)[:: h - 1, :: w - 1].reshape(-1, 3)
        ways = [lamp.position - corner for corner in corners for lamp in self.lamp.all]
        return float(max(np.hypot(way[0], way[1]) / way[2] for way in ways))

    def _reach(self, positions: Array, slope: Array) -> Array:
        """Half width (T, N) px of the region that a ball changes: itself, its image in the plate, its shadow."""
        extent = outline_half_width(self.camera, positions, self.radii, slope)
        far = extent
        if self.surface.plate_gloss:
            image = self.camera.project(positions * [1, 1, -1]) - self.camera.project(positions)
            far = np.maximum(far, np.linalg.norm(image, axis=-1) + extent)
        if self.surface.plate_shadow:
            shadow = self._slope * positions[..., 2] / self.radii + np.hypot(self._slope, 1) + 0.3
            far = np.maximum(far, extent * shadow)
        return np.asarray(np.minimum(far, 12 * extent))

    def _jobs(self, centres: Array, radii: Array, fineness: int) -> Float32:
        """Instance matrices (n, 4, 4) for balls (n, 3), (n,), without position and neighbours."""
        camera = self.camera
        slope = camera.project_with_slope(centres)[1] @ camera.R.T
        jobs = np.zeros((len(centres), 4, 4), np.float32)
        maps = np.linalg.inv(slope[:, :, :2]) / (fineness * radii[:, None, None])
        jobs[:, 1] = np.swapaxes(maps, 1, 2).reshape(-1, 4)
        jobs[:, 2, :3] = (camera.centre - centres) @ camera.R.T / radii[:, None]
        jobs[:, 2, 3] = 1
        to_lamp = self.lamp.position - centres * [1, 1, 0]
        # Lambert's plate under a small lamp facing down: cos^4 of the angle.
        fall = (self.lamp.position[2] / np.linalg.norm(to_lamp, axis=1)) ** 4
        if not self._plain:
            fall = compute_irradiance(self.lamp, centres * [1, 1, 0])
        jobs[:, 3, 3] = BLACK_PLATE_RADIANCE * self.room * fall
        return jobs

    def frames(self, centres: Centres, intervals: ArrayLike, breaks: ArrayLike = ()) -> Iterator[Picture]:
        """Mean pictures over exposures; each depends on its own exposure only.

        centres: times (T,), s -> ball centres (T, N, 3), m.
        intervals: (F, 2) start and end of each exposure, s; they may be of zero length.
        breaks: times at which velocities jump; exposures are split there.
        """
        spans, cuts = np.asarray(intervals, float).reshape(-1, 2), np.sort(np.asarray(breaks, float))
        if self.camera.line_time:
            for span in spans:
                (picture,) = self._roll(centres, span, cuts, lambda of: [(p,) for p in self._expose(centres, of, cuts)])
                yield picture
        else:
            max_balls = 1024  # of a batch: many balls need much memory
            many = min(EXPOSURES_PER_BATCH, max(1, max_balls // len(self.radii)))
            for first in range(0, len(spans), many):
                yield from self._expose(centres, spans[first : first + many], cuts)

    def _expose(self, centres: Centres, spans: Array, cuts: Array) -> Iterator[Picture]:
        moments, coarse, counts = self._place_moments(centres, spans, cuts)
        positions = np.asarray(centres(moments.times), float)
        pixels, slope = self.camera.project_with_slope(positions)
        extent = self._reach(positions, slope)
        patches = BallSquares(self.camera, self.psf.margin, moments, pixels, extent, len(spans))
        if coarse:
            few = np.asarray(centres(coarse.times), float)
            shown = [(moments, self._find_glints(moments, positions, patches, range(1, 99)))]
        else:
            shown = []
            for count, bounces in zip(counts, (range(1, 2), range(2, 99)), strict=True):
                coarse, few, smear = merge_sub_exposures(moments, positions, pixels, count)
                found = self._find_glints(coarse, few, patches, bounces)
                shown.append((coarse, replace(found, spread=found.spread + smear[found.moment, found.ball])))
        assert coarse is not None
        drawn: dict[int, Float32] = {}
        shades: dict[int, Float32] = {}
        for width in np.unique(patches.widths):
            same = np.flatnonzero(patches.widths == width)
            tile = (width - 2 * patches.margin) * FINENESS
            room_for = max(1, BUFFER_SIDE // tile) ** 2
            for first in range(0, len(same), room_for):
                selected = same[first : first + room_for]
                bodies = DrawnParts.BALLS if self._plain else DrawnParts.ON_PLATE
                images = self._draw_balls(few, coarse, patches, selected, bodies)
                for at, found in shown:
                    self._add_glints(images, found, at, patches, selected)
                drawn |= zip(selected.tolist(), self.psf.spread(images), strict=True)
                if not self._plain:
                    shade = self._draw_balls(few, coarse, patches, selected, DrawnParts.SHADES)
                    shades |= zip(selected.tolist(), self.psf.spread(shade), strict=True)
        lights = self.lamp.flicker.mean(*spans.T).tolist()
        # Composed in turn with what the caller does with each, a picture takes twice as long: the caches are then cold.
        at_once = 16 if len(self.radii) <= 4 else 1
        for first in range(0, len(spans), at_once):
            last = min(first + at_once, len(spans))
            yield from [self._compose(k, lights[k], patches, drawn, shades) for k in range(first, last)]

    def _compose(
        self, frame: int, light: float, patches: BallSquares, drawn: dict[int, Float32], shades: dict[int, Float32]
    ) -> Picture:
        """Compose a picture of the plate in so much light and the patches (w, w) of its balls, by number."""
        (plate,) = self._plates_in(light)
        numbers = patches.number[frame][patches.number[frame] >= 0].tolist()
        corners = [patches.box(number, self.camera.size) for number in numbers]
        changes = []
        for number, (top, bottom, left, right) in zip(numbers, corners, strict=True):
            here = np.s_[top:bottom, left:right]
            x, y = patches.origins[number]
            there = np.s_[top - y : bottom - y, left - x : right - x]
            ball = drawn[number][there]
            change = ball if self._vignette is None else ball * self._vignette[here]
            changes.append((here, change, self._lit[here] * shades[number][there] if number in shades else None))
        return add_to_plate(plate, corners, changes)

    def _find_glints(
        self, moments: SubExposures, positions: Array, patches: BallSquares, bounces: range
    ) -> GlintImages:
        wanted = patches.number[moments.frames] >= 0
        found = []
        for lamp, cell in zip(self.lamp.all, self._cells, strict=True):
            light = wanted * lamp.light(moments.times)[:, None]
            selection = ImageSelection(cell, self.faintest, bounces)
            found.append(find_glints(self.camera, lamp, positions, self.radii, light, self.surface, selection))
        return join_glints(found)

    def _place_moments(
        self, centres: Centres, spans: Array, cuts: Array
    ) -> tuple[SubExposures, SubExposures | None, tuple[Index, Index]]:
        """Sub-exposures for the glints, and fewer for the balls, which are wide and faint.

        In most exposures of more than two balls some ball hits another. There are then no fewer ones. The numbers (F,)
        say to how many those of each frame are merged, for the primary glints and for all else. A ball that is drawn
        once for a travel of u sigma lacks its blur. This changes the steepest edge, of contrast c, by .01 c u^2.
        """
        size = np.array(self.camera.size)
        bounds, weights, frames, moves = self._split_exposures(centres, spans, cuts, -size, 2 * size)
        waves = [2 * np.pi * lamp.flicker.frequency for lamp in self.lamp.all if lamp.flicker.depth]
        wave = np.diff(bounds, axis=1)[:, 0] * max(waves, default=0.0)
        travel = self._travel(moves)
        fine = place_sub_exposures(bounds, weights, frames, travel, wave)
        whole = np.zeros((len(spans), len(self.radii)))
        np.add.at(whole, frames, np.linalg.norm(moves, axis=2))
        path = self._travel(whole[..., None])
        turns = np.ceil(np.diff(spans, axis=1)[:, 0] * max(waves, default=0.0)).astype(int)
        least = np.where(turns > 0, 2 + turns, 1)
        steps = 1.0, min(2.0, 10 * np.sqrt(self.faintest / max(self.room, 1e-30)))
        primary, rest = (np.maximum(least, np.ceil(path / step)).astype(int) for step in steps)
        pair = len(self.radii) <= 2
        return fine, place_sub_exposures(bounds, weights, frames, travel / 4, wave) if pair else None, (primary, rest)

    def _draw_balls(
        self, positions: Array, moments: SubExposures, patches: BallSquares, selected: Index, scene: DrawnParts
    ) -> Float32:
        """Draw blurred balls minus the plate behind them: (n, width, width) for n patches of one width.

        positions: (T, N, 3) at the moments. scene: not PLATE_ALONE.
        """
        pixels, slope = self.camera.project_with_slope(positions)
        extent = self._reach(positions, slope)
        width, margin = int(patches.widths[selected[0]]), patches.margin
        tile = (width - 2 * margin) * FINENESS
        across = max(1, BUFFER_SIDE // tile)
        ranks = patches.ranks(selected)[patches.number[moments.frames]]
        moment, ball = np.nonzero(ranks >= 0)
        rank, position = ranks[moment, ball], pixels[moment, ball]
        jobs = self._jobs(positions[moment, ball], self.radii[ball], FINENESS)
        jobs[:, 0, :2] = np.stack([rank % across, rank // across], axis=1) * tile
        jobs[:, 0, 2:] = (position - patches.origins[selected[rank]] - margin + 0.5) * FINENESS
        jobs[:, 2, 3] = (moments.weights * self.lamp.light(moments.times))[moment]
        jobs[:, 3, 1] = extent[moment, ball] * FINENESS
        others = self._neighbours(jobs, positions, moment, ball, ordered=scene == DrawnParts.SHADES)
        if scene != DrawnParts.BALLS:
            others = self._with_notes(jobs, others, positions[moment, ball], ball, scene)
        rows = -(-len(selected) // across)
        batches = self._sort_by_neighbours(jobs, others, scene)
        drawn = self._canvas.draw(batches, (rows * tile, across * tile), self._uniforms)
        tiles = drawn.reshape(rows, tile, across, tile).swapaxes(1, 2).reshape(-1, tile, tile)[: len(selected)]
        blur = blur_matrix(width, margin, FINENESS, self.camera.psf_sigma_px, self.psf.steps)
        return blur_tiles(tiles, blur)

    def _neighbours(self, jobs: Float32, positions: Array, moment: Index, ball: Index, ordered: bool) -> Float32:
        """NearBalls (n, k, 4) of each ball in its own radii, nearest first; writes their number into the jobs.

        ordered: balls of lower number have negative radii.
        """
        used, rank = np.unique(moment, return_inverse=True)
        near = find_neighbours(positions[used], self._shade_reach if ordered else self._mirror_reach)
        row = rank * len(self.radii) + ball
        counts = near.counts[row]
        found = np.zeros((len(jobs), max(1, int(counts.max(initial=0))), 4))
        job = np.repeat(np.arange(len(jobs)), counts)
        column = np.arange(len(job)) - np.repeat(np.cumsum(counts) - counts, counts)
        other = near.other[near.first[row[job]] + column]
        found[job, column, :3] = (positions[moment[job], other] - positions[moment[job], ball[job]]) @ self.camera.R.T
        found[job, column, 3] = self.radii[other]
        found /= self.radii[ball][:, None, None]
        if ordered:
            found[job, column, 3] *= np.where(other < ball[job], -1, 1)
        jobs[:, 3, 0] = counts
        return found.astype(np.float32)

    def _sort_by_neighbours(self, jobs: Float32, others: Float32, scene: DrawnParts) -> list[BallBatch]:
        """Sort balls by their number of neighbours: in a program for so many, a neighbour costs a third."""
        defines = {"SCENE": int(scene)} | self._defines
        if len(self.radii) <= 2 or scene == DrawnParts.SHADES:
            whole = BallBatch(jobs, others, defines)
            if scene != DrawnParts.BALLS or len(jobs) > MAX_BALLS_PER_CALL or not self._canvas.is_software:
                return [whole]
            return [whole._replace(squares=divide_balls(jobs, others[:, 0]))]
        # A neighbour whose outline meets the ball's in the picture covers a part of it, or is covered.
        eye = jobs[:, None, 2, :3] / np.linalg.norm(jobs[:, None, 2, :3], axis=-1, keepdims=True)
        aside = others[..., :3] - (others[..., :3] * eye).sum(-1, keepdims=True) * eye
        counts = jobs[:, 3, 0].astype(int)
        listed = np.arange(others.shape[1]) < counts[:, None]
        meets = (listed & (np.linalg.norm(aside, axis=-1) < 1.1 * (1 + others[..., 3]) + 0.1)).any(axis=1)
        programs = 0, 1, 2, 3, 4, 6, 8  # numbers of neighbours for which there are programs
        kinds = np.append(programs, others.shape[1])
        kind = np.searchsorted(programs, counts)
        batches = []
        for k, meet in sorted(set(zip(kind.tolist(), meets.tolist(), strict=True))):
            own = np.flatnonzero((kind == k) & (meets == meet))
            many = {"NEAR": int(kinds[k])} if k < len(programs) else {}
            apart = {} if meet else {"APART": 1}
            width = others.shape[1] if scene != DrawnParts.BALLS else max(1, int(kinds[k]))
            batches.append(BallBatch(jobs[own], others[own, :width], defines | many | apart))
        return batches

    def _with_notes(self, jobs: Float32, others: Float32, positions: Array, ball: Index, scene: int) -> Float32:
        """Append the depth of the plate and the lamps to the neighbours, as the shader reads them."""
        radii, count, camera = self.radii[ball], jobs[:, 3, 0].astype(int), self.camera
        casting = self.surface.plate_shadow and scene == DrawnParts.SHADES
        discs = [shadow_casters(self.lamp, p * [1, 1, 0]) if casting else np.zeros((0, 5)) for p in positions]
        notes = np.zeros((len(jobs), 1 + 2 * max(len(d) for d in discs), 4), np.float32)
        notes[:, 0, 0] = positions[:, 2] / radii
        for k, disc in enumerate(discs):
            notes[k, 0, 2] = len(disc)
            notes[k, 1 : 1 + 2 * len(disc) : 2, :3] = (disc[:, :3] - positions[k]) @ camera.R.T / radii[k]
            notes[k, 1 : 1 + 2 * len(disc) : 2, 3] = disc[:, 3] / radii[k]
            notes[k, 2 : 2 + 2 * len(disc) : 2, 0] = disc[:, 4]
        rows = np.zeros((len(jobs), others.shape[1] + notes.shape[1], 4), np.float32)
        rows[:, : others.shape[1]] = others
        for k, near in enumerate(count):
            rows[k, near : near + notes.shape[1]] = notes[k]
        return rows

    def _add_glints(
        self, images: Float32, glints: GlintImages, moments: SubExposures, patches: BallSquares, selected: Index
    ) -> None:
        ranks = patches.ranks(selected)[patches.number[moments.frames[glints.moment], glints.ball]]
        order = np.argsort(ranks, kind="stable")
        order = order[np.searchsorted(ranks[order], 0) :]
        ranks, moment = ranks[order], glints.moment[order]
        variances = glints.spread[order] + self.camera.psf_sigma_px**2
        origins = patches.origins[selected[ranks]]
        width = int(patches.widths[selected[0]])
        rows, columns = integrate_spots(glints.pixels[order], variances, origins, width, self.psf.steps)
        rows *= (glints.flux[order] * moments.weights[moment] * self._unit)[:, None]
        bounds = np.searchsorted(ranks, np.arange(len(images) + 1))
        for k, image_of_ball in enumerate(images):
            own = slice(bounds[k], bounds[k + 1])
            image_of_ball += rows[own].T @ columns[own]
