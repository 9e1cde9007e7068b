"""The common part of both renderers: optics, flicker, moments of an exposure, rolling shutter.

A rolling shutter exposes each row a line time after the row above. A row sees what a global shutter sees that opens at
the row's time. Such pictures are made at steps of the balls' motion and interpolated between. Positions stay exact; the
variance of a spot grows by at most step^2/4.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from synthcam.camera.exposure import Picture, merge_boxes, outline_half_width, split_at_breaks
from synthcam.camera.lamp import Lamp
from synthcam.camera.pinhole import PinholeCamera
from synthcam.camera.psf import Psf
from synthcam_shared.arrays import Array, Float32, Index

Centres = Callable[[Array], Array]  # times (T,), s -> centres of the balls (T, N, 3), m
Pictures = tuple[Picture, ...]  # one per channel


class Renderer:
    """The view of one camera on balls of `radii` (N,), m.

    plates: the picture without balls, one per channel. extents: radii (N,), m, of balls that enclose the bodies. reach:
    of the region that a ball changes, over its own outline.
    Raises ValueError if a lamp is in view.
    """

    plates: tuple[Float32, ...]
    reach: Array | float = 1.0

    def __init__(self, camera: PinholeCamera, lamp: Lamp, radii: Array) -> None:
        self.camera, self.lamp, self.radii, self.extents = camera, lamp, radii, radii
        w, h = camera.size
        for each in lamp.all:
            at = camera.project(each.position)
            if np.all((at > -0.5) & (at < [w - 0.5, h - 0.5])):
                raise ValueError(f"lamp position {each.position.tolist()} is between the camera and the plate")
        self.psf = Psf(camera.psf_sigma_px, camera.defocus_px, camera.airy_px)
        self._vignette: Float32 | None = None  # share of the light: 1 in the middle, less by the square of the distance
        if camera.vignetting:
            across, down = (2 * np.arange(n) / (n - 1) - 1 for n in (w, h))
            square = (w * w * across**2 + (h * h * down**2)[:, None]) / (w * w + h * h)
            self._vignette = (1 - camera.vignetting * square).astype(np.float32)
        self._plates: dict[float, tuple[Float32, ...]] = {}

    def _plates_in(self, light: float) -> tuple[Float32, ...]:
        """The plates in so much light. Light equal to 1e-5 gives the same arrays, for which the sensor keeps tables."""
        light = round(light, 5)
        if light not in self._plates:
            self._plates[light] = self.plates if light == 1 else tuple(p * np.float32(light) for p in self.plates)
        return self._plates[light]

    def _split_exposures(
        self, centres: Centres, spans: Array, cuts: Array, low: Array | int, high: Array | int
    ) -> tuple[Array, Array, Index, Array]:
        """Bounds, weights and frames of the pieces of exposures (F, 2), s, as of `split_at_breaks`, and moves.

        The moves (P, N, 2) of the balls are in px; 0 of balls outside of the pixels `low` to `high`.
        """
        bounds, weights, frames = split_at_breaks(spans, cuts)
        ends = self.camera.project(np.asarray(centres(bounds.ravel()), float)).reshape(len(bounds), 2, -1, 2)
        near = np.all((ends > low) & (ends < high), axis=(1, 3))
        return bounds, weights, frames, np.where(near[..., None], ends[:, 1] - ends[:, 0], 0)

    def _travel(self, moves: Array) -> Array:
        """The longest (P,) of the moves (P, N, 2), px, over the blur's sigma."""
        longest = np.linalg.norm(moves, axis=2).max(axis=1, initial=0)
        return np.asarray(longest / np.hypot(self.camera.psf_sigma_px, 12**-0.5))

    def _see_balls(self, positions: Array) -> tuple[Array, Array]:
        """Pixels (T, N, 2), and half widths (T, N) px of the region that each ball at positions (T, N, 3) changes."""
        pixels, slope = self.camera.project_with_slope(positions)
        half = outline_half_width(self.camera, positions, self.extents, slope)
        return pixels, half * self.reach + self.psf.margin

    def _roll(
        self,
        centres: Centres,
        span: Array,
        cuts: Array,
        expose: Callable[[Array], list[Pictures]],
        step_px: float = 0.1,
    ) -> Pictures:
        """One frame of a rolling shutter.

        span: exposure (2,) of the top row, s.
        cuts: times at which velocities jump.
        expose: exposures (F, 2) -> the pictures of a global shutter.
        """
        rows, delay = np.arange(self.camera.size[1]), self.camera.line_time
        plates = list(self.plates)
        if self.lamp.flicker.depth:
            starts = span[0] + rows * delay
            light = self.lamp.flicker.mean(starts, starts + span[1] - span[0])[:, None]
            plates = [(plate * light).astype(np.float32) for plate in plates]
        images, boxes = [plate.copy() for plate in plates], []
        for first, beyond, speed in self._find_strips(centres, span, cuts):
            steps = max(1, int(np.ceil(speed * delay * (beyond - first) / step_px)))
            anchors = np.linspace(first, beyond - 1, steps + 1)
            exposed = expose(span + anchors[:, None] * delay)
            position = (rows[first:beyond] - anchors[0]) / max(anchors[-1] - anchors[0], 1) * steps
            for k, (before, after) in enumerate(pairwise(exposed)):
                own = rows[first:beyond][np.minimum(position.astype(int), steps - 1) == k]
                if len(own):
                    part, share = slice(own[0], own[-1] + 1), (position[own - first] - k)[:, None].astype(np.float32)
                    for pictures, weight in ((before, 1 - share), (after, share)):
                        for image, picture in zip(images, pictures, strict=True):
                            image[part] += weight * (picture.image[part] - picture.plate[part])
            for at_rows, columns in (box for pictures in exposed for box in pictures[0].boxes):
                top, bottom = max(at_rows.start, first), min(at_rows.stop, beyond)
                if top < bottom:
                    boxes.append((top, bottom, columns.start, columns.stop))
        disjoint = merge_boxes(boxes)
        return tuple(
            Picture(plate, disjoint, tuple(image[box] for box in disjoint))
            for plate, image in zip(plates, images, strict=True)
        )

    def _find_strips(self, centres: Centres, span: Array, cuts: Array) -> list[tuple[int, int, float]]:
        """Rows (first, beyond) in which balls may show while those rows are exposed, and the largest speed, px/s."""
        height, delay = self.camera.size[1], self.camera.line_time
        probes = np.linspace(span[0], span[1] + height * delay, 33)
        times = np.unique(np.concatenate([probes, cuts[(cuts > probes[0]) & (cuts < probes[-1])]]))
        pixels, half = self._see_balls(np.asarray(centres(times), float))
        strips: list[tuple[float, float, float]] = []
        for ball in range(half.shape[1]):
            y, reach = pixels[:, ball, 1], half[:, ball]
            # Row r is exposed from r delay on: the ball shows there only if it is in that row at that time.
            first, last = (times - span[1]) / delay, (times - span[0]) / delay
            slack = reach + np.abs(np.diff(y, prepend=y[0])) + (times[1] - times[0]) / delay
            there = (y + slack > first) & (y - slack < last)
            if there.any():
                low, high = max((y - reach)[there].min() - 1, 0), min((y + reach)[there].max() + 2, height)
                speed = np.linalg.norm(np.diff(pixels[:, ball], axis=0), axis=1) / np.diff(times)
                strips += [(low, high, float(speed.max()))] if low < high else []
        merged: list[tuple[float, float, float]] = []
        for low, high, speed in sorted(strips):
            if merged and low <= merged[-1][1]:
                first, last, fastest = merged.pop()
                low, high, speed = first, max(high, last), max(speed, fastest)
            merged.append((low, high, speed))
        return [(int(low), int(np.ceil(high)), speed) for low, high, speed in merged]
