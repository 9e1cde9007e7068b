"""Render films of matte balls on a plate under lamps and room light, in one channel or three.

Balls are sampled on a grid finer than the pixels. Outlines are drawn by the share of a sample that they cover. The blur
of the optics is a product with exact weights. The images of the lamps in varnish are added from their exact positions.
"""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike

from synthcam.camera.disc import measure_shares_covered_by_body
from synthcam.camera.exposure import (
    Box,
    Picture,
    blur_matrix,
    blur_tiles,
    integrate_spots,
    merge_boxes,
    outline_half_width,
    place_sub_exposures,
)
from synthcam.camera.glints import ImageSelection, find_glints, join_glints, narrow_cell
from synthcam.camera.lamp import Lamp
from synthcam.camera.pinhole import PinholeCamera
from synthcam.camera.renderer import Centres, Pictures, Renderer
from synthcam.camera.room import texture
from synthcam.camera.room.finish import SurfaceFinish
from synthcam.camera.room.illumination import BallsAtMoment, Illumination
from synthcam.camera.room.view_factors import dot
from synthcam.camera.surface import Surface
from synthcam_shared.arrays import Array, Float32, Index

Turns = Callable[[Array], Array]  # times (T,), s -> rotations (T, N, 3, 3) from ball axes to the world's

FINENESS = 3  # samples of balls and plate per pixel, along rows and along columns


class RoomRenderer(Renderer):
    """The view of one camera on balls with a `finish` and, unless they are dull, a `mirror`: varnish or bare metal.

    The unit of a picture is the white of a plate of reflectance 1 at the world's origin.

    radii: one a ball, m.
    heights: those of discs, m, and 0 of balls.
    quick: as of `Illumination`; motion during an exposure is in few steps.

    Raises ValueError if a lamp is in view.
    """

    def __init__(
        self,
        camera: PinholeCamera,
        lamp: Lamp,
        radii: Sequence[float],
        finish: SurfaceFinish,
        mirror: Surface | None,
        heights: Sequence[float] = (),
        *,
        quick: bool = False,
    ) -> None:
        super().__init__(camera, lamp, np.array(radii, float))
        self.finish = finish
        disc_heights = np.array(heights or np.zeros(len(self.radii)), float)
        self.extents = self.radii + disc_heights / 2  # of balls that enclose the bodies
        self.shade = Illumination(lamp, finish, self.radii, mirror, disc_heights, quick=quick)
        self.reach = self.shade.reaches
        self._points = self._meet_plate(*(np.arange(n, dtype=float) for n in camera.size))
        self._bare = self.shade.bare(self._points.reshape(-1, 3)).reshape(self._points.shape[:2])
        self.plates = self._draw_plates()

    def _rays(self, x: Array, y: Array) -> Array:
        """Unit directions (len(y), len(x), 3) of the rays of pixels at columns x and rows y."""
        way = self.camera.unproject(np.stack(np.meshgrid(x, y), axis=-1))
        return np.asarray(way / np.sqrt(dot(way, way))[..., None])

    def _meet_plate(self, x: Array, y: Array) -> Array:
        """The plate's points (len(y), len(x), 3), m, at columns x and rows y of the picture."""
        way, eye = self._rays(x, y), self.camera.centre
        points: Array = eye - way * (eye[2] / way[..., 2:])
        points[..., 2] = 0
        return points

    def _draw_plates(self) -> tuple[Float32, ...]:
        """Render the plate without balls: (h, w) of each channel. In strips of rows, to save memory."""
        w, h = self.camera.size
        sigma = np.hypot(self.camera.psf_sigma_px, self.camera.defocus_px / 2)
        shade = np.ones((h, w)) if self._vignette is None else self._vignette
        even = [np.asarray(self._bare * shade * c) for c in self.finish.plate]
        if self.finish.texture != "plain":
            margin = int(np.ceil(4 * sigma))
            across = (np.arange((w + 2 * margin) * FINENESS) + 0.5) / FINENESS - 0.5 - margin
            rows = blur_matrix(w + 4 * margin, margin, FINENESS, sigma)[2 * margin : 2 * margin + w]
            relief = np.zeros((h, w, self.finish.channels))
            for top in range(0, h, 64):
                n = min(64, h - top)
                down = (np.arange((n + 2 * margin) * FINENESS) + 0.5) / FINENESS - 0.5 - margin + top
                points = self._meet_plate(across, down)[..., :2]
                fine = texture.compute_texture(self.finish, points.reshape(-1, 2)).reshape(*points.shape[:2], -1)
                columns = blur_matrix(n + 4 * margin, margin, FINENESS, sigma)[2 * margin : 2 * margin + n]
                for c in range(fine.shape[2]):
                    relief[top : top + n, :, c] = columns @ fine[..., c] @ rows.T
            even = [plate * relief[..., c] for c, plate in enumerate(even)]
        plates = tuple(plate.astype(np.float32) for plate in even)
        for plate in plates:
            plate.flags.writeable = False
        return plates

    def frames(
        self, centres: Centres, turns: Turns, intervals: ArrayLike, breaks: ArrayLike = ()
    ) -> Iterator[Pictures]:
        """Render the mean pictures over exposures, one per channel.

        intervals: (F, 2) start and end of each exposure, s. breaks: times at which velocities jump.
        """
        cuts = np.sort(np.asarray(breaks, float))

        def expose(spans: Array) -> list[Pictures]:
            return [self._expose(centres, turns, span, cuts) for span in spans]

        for span in np.asarray(intervals, float).reshape(-1, 2):
            yield self._roll(centres, span, cuts, expose) if self.camera.line_time else expose(span[None])[0]

    def _expose(self, centres: Centres, turns: Turns, span: Array, cuts: Array) -> Pictures:
        """One exposure of a global shutter."""
        far = 3 * max(self.camera.size)
        bounds, weights, frames, moves = self._split_exposures(centres, span[None], cuts, -far, far)
        moments = place_sub_exposures(bounds, weights, frames, self._travel(moves) / (8 if self.shade.quick else 2))
        positions = np.asarray(centres(moments.times), float)
        turned = turns(moments.times)
        boxes = merge_boxes(self._find_boxes(positions))
        light = float(self.lamp.flicker.mean(span[:1], span[1:])[0])
        plates = self._plates_in(light)
        parts = [[plate[box] * 0.0 for box in boxes] for plate in plates]
        exchange = self.shade.exchange(positions[len(positions) // 2])  # it hardly changes during an exposure
        blur = self.camera.scale * np.sqrt(self.camera.psf_sigma_px**2 + self.camera.defocus_px**2 / 4 + 1 / 12)
        for together in self._group_moments(positions):
            weights = moments.weights[together]
            shown = [np.zeros((1 + len(plates), *plates[0][box].shape), np.float32) for box in boxes]
            for k, weight in zip(together.tolist(), weights, strict=True):
                among = BallsAtMoment(positions[k], exchange)
                placed = ((ball, *self._place(positions[k], ball)) for ball in range(len(self.radii)))
                tiles = [
                    (low, self._draw_ball(ball, low, width, among, turned[k][ball]))
                    for ball, low, width in placed
                    if np.all(low + width > 0) and np.all(low < self.camera.size)
                ]
                for total, box in zip(shown, boxes, strict=True):
                    total += np.float32(weight) * self._lay_tiles(tiles, box)
            middle = np.average(positions[together], axis=0, weights=weights)
            travel = np.ptp(positions[together], axis=0).max(initial=0)
            soft = np.hypot(blur, travel / np.sqrt(12))  # blur of a shadow's edge, m rms
            for number, box in enumerate(boxes):
                bare = self._bare[box][..., None]
                light_on_plate = self.shade.on_plate(self._points[box].reshape(-1, 3), middle, soft)
                lit = light_on_plate.reshape(*bare.shape[:2], -1) / bare
                open_ = np.float32(weights.sum()) - shown[number][0]
                for c, plate in enumerate(plates):
                    parts[c][number] += plate[box] * (lit[..., c] * open_) + light * shown[number][1 + c]
        return tuple(Picture(plate, boxes, tuple(part)) for plate, part in zip(plates, parts, strict=True))

    def _group_moments(self, positions: Array, travel_px: float = 1.5) -> list[Index]:
        """Group moments so that no ball moves further than `travel_px`: they share the light on the plate."""
        steps = np.linalg.norm(np.diff(positions, axis=0), axis=2).max(axis=1, initial=0) / self.camera.scale
        count = max(1, min(len(positions), int(np.ceil(steps.sum() / travel_px))))
        return np.array_split(np.arange(len(positions)), count)

    def _find_boxes(self, positions: Array) -> list[tuple[int, int, int, int]]:
        """Find the boxes (top, bottom, left, right) of the picture that each ball changes during an exposure."""
        pixels, extent = self._see_balls(positions)
        low = np.floor((pixels - extent[..., None]).min(axis=0)).astype(int)
        high = np.ceil((pixels + extent[..., None]).max(axis=0)).astype(int) + 1
        corners = np.concatenate([np.maximum(low, 0), np.minimum(high, self.camera.size)], axis=1).tolist()
        return [(top, bottom, x, end) for x, top, end, bottom in corners if x < end and top < bottom]

    def _place(self, centres: Array, ball: int) -> tuple[Index, int]:
        """First column and row, and width, of a square that holds a ball and its blur."""
        own = np.s_[None, ball : ball + 1]
        pixels, slope = self.camera.project_with_slope(centres[own])
        half = float(outline_half_width(self.camera, centres[own], self.extents[own[1]], slope)[0, 0])
        half += 1 + self.psf.margin
        return np.floor(pixels[0, 0] - half).astype(int), int(2 * half) + 3

    def _draw_ball(self, ball: int, low: Index, width: int, among: BallsAtMoment, turn: Array) -> Float32:
        """Render a ball in the square at `low`: (1 + c, width, width), its share of each pixel and its radiance."""
        centres = among.centres
        side = width - 2 * self.psf.margin
        at = (np.arange(side * FINENESS) + 0.5) / FINENESS - 0.5 + self.psf.margin
        way = self._rays(at + low[0], at + low[1])
        share = self._shares(ball, centres, way)
        rows, columns = np.nonzero(share > 0)
        tiles = np.zeros((1 + self.finish.channels, *share.shape), np.float32)
        tiles[0] = share
        if len(rows):
            ways = way[rows, columns]
            disc = self.shade.discs[ball]
            if disc:
                points, _ = disc.meet(self.camera.centre, ways, centres[ball])
            else:
                points = self._meet_ball(centres[ball], self.radii[ball], ways)
            own_finish = self.finish.balls[ball]
            sharp = self.camera.scale / (FINENESS * self.radii[ball])
            paint = own_finish.paint((points - centres[ball]) / self.radii[ball] @ turn, sharp)
            seen = self.shade.radiance(ball, points, ways, among, paint)
            tiles[1:, rows, columns] = (share[rows, columns, None] * seen).T
        blur = blur_matrix(width, self.psf.margin, FINENESS, self.camera.psf_sigma_px, self.psf.steps)
        images = blur_tiles(tiles, blur)
        if self.shade.mirror is not None and not self.shade.discs[ball]:
            images[1:] += self._draw_glints(ball, centres, low, width, self.shade.mirror)
        return self.psf.spread(images)

    def _shares(self, ball: int, centres: Array, way: Array) -> Array:
        """Share of each sample in which this ball is in front. Outlines are ramps one sample wide."""
        own, near = self._cover(ball, centres, way)
        at, scale = self.camera.project(centres), self.extents / self.camera.scale
        for k in range(len(centres)):
            apart = np.hypot(*(at[k] - at[ball])) > 2 * (scale[k] + scale[ball]) + 2 and len(centres) > 2
            if k != ball and not apart:
                other, before = self._cover(k, centres, way)
                own = own * np.where(before < near, 1 - other, 1)
        return own

    def _cover(self, ball: int, centres: Array, way: Array) -> tuple[Array, Array]:
        """Share of each sample that a body covers, and its distance, m."""
        if disc := self.shade.discs[ball]:
            miss, _ = disc.find_miss(self.camera.centre, way, centres[ball])
            _, far = disc.meet(self.camera.centre, way, centres[ball])
            return measure_shares_covered_by_body(miss, disc.radius), far
        offset, radius = centres[ball] - self.camera.centre, self.radii[ball]
        along = way @ offset
        aside = offset - along[..., None] * way
        miss = np.sqrt(dot(aside, aside))
        return measure_shares_covered_by_body(miss, radius), along - np.sqrt(np.maximum(radius**2 - miss**2, 0))

    def _meet_ball(self, centre: Array, radius: float, ways: Array) -> Array:
        """Points (n, 3) at which rays meet a ball; of a ray that misses it, the nearest point of its surface."""
        offset = self.camera.centre - centre
        b = ways @ offset
        far = -b - np.sqrt(np.maximum(b * b - offset @ offset + radius * radius, 0))
        out = offset + far[:, None] * ways
        return np.asarray(centre + out * (radius / np.sqrt(dot(out, out)))[:, None])

    def _draw_glints(self, ball: int, centres: Array, low: Index, width: int, mirror: Surface) -> Float32:
        """Images (width steps, width steps) of the lamps in a ball."""
        balls = [k for k, disc in enumerate(self.shade.discs) if disc is None and (k == ball or not self.shade.quick)]
        light = (np.array(balls) == ball)[None].astype(float)
        centres, radii, found = centres[balls], self.radii[balls], []
        for lamp in self.lamp.all:
            whole = find_glints(self.camera, lamp, centres[None], radii, light, mirror)
            cell = narrow_cell(self.camera, lamp, whole.spread[:1])
            found.append(find_glints(self.camera, lamp, centres[None], radii, light, mirror, ImageSelection(cell)))
        glints = join_glints(found)
        variances = glints.spread + self.camera.psf_sigma_px**2
        rows, columns = integrate_spots(glints.pixels, variances, low[None].astype(float), width, self.psf.steps)
        rows *= (glints.flux * np.pi * self.shade.unit)[:, None]
        return (rows.T @ columns).astype(np.float32)

    def _lay_tiles(self, tiles: list[tuple[Index, Float32]], box: Box) -> Float32:
        """Sum the tiles of balls in a box: the share that they cover, and their radiance by channel, (1 + c, h, w)."""
        rows, columns = box
        shape = (rows.stop - rows.start, columns.stop - columns.start)
        total = np.zeros((1 + self.finish.channels, *shape), np.float32)
        for low, images in tiles:
            x, y, width = int(low[0]) - columns.start, int(low[1]) - rows.start, images.shape[1]
            top, bottom, left, right = max(y, 0), min(y + width, shape[0]), max(x, 0), min(x + width, shape[1])
            if top < bottom and left < right:
                total[:, top:bottom, left:right] += images[:, top - y : bottom - y, left - x : right - x]
        if self._vignette is not None:
            total[1:] *= self._vignette[box]
        return total
