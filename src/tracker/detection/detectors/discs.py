"""Discs on a still background: matte, coloured, dark or bright balls, and pucks, seen by their outlines."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from tracker.camera.lens import Array
from tracker.detection.disc_fit import BLURRED as BLUR
from tracker.detection.disc_fit import Found, fit_disc
from tracker.detection.glints import BLURRED, EDGE, NEAR, Glints, View
from tracker.detection.outline import outline
from tracker.detection.still_background import SAMPLES, Background, still_background
from tracker.detection.takes import takes_of

LEAST_CONTRAST = 8.0  # counts, of a ball over the background
DEVIATIONS = 4.0  # of a pixel's noise, the same; means of 3 x 3 pixels are compared with it
SMALLEST = 3.0  # px, a radius
ALIKE = 0.25  # of a radius: what differs more is no ball
FULL = 0.9  # area over that of an ellipse with its moments
LONGEST = 2.2  # radii, a way during the exposure
FAINT, FAINTEST = 0.35, 0.2  # of the clearest discs' contrast: what is fainter is not asked for their size; is none
SWEPT = 0.8  # of the major moment's root, and BLUR px: a shorter way is the pixels'
ROUND = 0.35  # radii, a way of what is taken for a ball at rest
CLOSE = 0.1  # of a radius, within which two are counted as the same
SECOND = 0.3  # of the most common radius's count, that of a second one
FEWEST = 3  # discs at rest, from which their radius is read
LOOKED = 25  # frames, for the usual radius
MOST = 40  # objects in a frame: beyond that it is no picture of a few balls
Box = tuple[int, ...]


@dataclass(frozen=True, eq=False)
class _Part:
    """A connected region of about one contrast: its filled mask at ``left``, ``top``, and its moments."""

    mask: NDArray[np.uint8]
    left: int
    top: int
    area: float
    middle: Array
    minor: float  # px, a half axis
    way: Array  # px (2,), that a disc moved during the exposure to look so
    contrast: float  # counts, the median

    @property
    def radius(self) -> float:
        """Of the disc, px: of its area what the way has not added."""
        long = float(np.hypot(*self.way))
        return float((np.sqrt(long**2 + np.pi * self.area) - long) / np.pi)


class Discs:
    """Discs by the pixels at their edges, in what differs from the background of their scene."""

    point: ClassVar[str] = "centre"

    def __init__(self, view: View) -> None:
        self.view = view
        self.takes = view.takes or takes_of(view.frames)
        self.noise = self.takes.noise
        self.low = max(DEVIATIONS * self.noise, LEAST_CONTRAST)
        self.refused: dict[int, int] = {}
        self.scenes = {scene: self._background(scene) for scene in sorted(set(self.takes.scenes))}
        given = view.camera.diameter_px / 2
        self.radii, contrast = self._usual(given if view.camera.knows_diameter else None)
        self.low = max(self.low, FAINTEST * contrast)

    @property
    def radius(self) -> float:
        """The balls', px, or the most common one."""
        return self.radii[0]

    def notes(self) -> list[str]:
        """What a user has to know, once the frames have been searched."""
        said = self.takes.notes()
        if self.refused:
            count = sum(self.refused.values())
            said.append(
                f"{count} objects in {len(self.refused)} frames are no balls (not round, or of another size): "
                f"left out, frame {min(self.refused)} is the first"
            )
        if len(self.radii) > 1:
            said.append("discs of two sizes: " + " and ".join(f"{2 * r:.1f} px across" for r in self.radii))
        return said

    def many(self, frames: Iterable[tuple[int, NDArray[Any]]]) -> Glints:
        """Discs of all frames, but those between takes and those that are given twice."""
        scene_of = self._scene_of()
        parts = []
        for number, frame in frames:
            if number in scene_of:
                found, refused = self._in_frame(frame, self.scenes[scene_of[number]])
                parts.append(Glints(np.full(len(found), number, np.int64), *(getattr(found, n) for n in _REST)))
                if refused:
                    self.refused[number] = refused
        return Glints.join(parts)

    def __call__(self, frame: NDArray[Any]) -> Glints:
        """Discs of one frame of the first scene; ``flux`` is their area, px^2, which balls of one size share."""
        return self._in_frame(frame, self.scenes[self.takes.scenes[0]])[0]

    def _background(self, scene: int) -> Background:
        """From frames spread over all takes of a scene."""
        fresh = sorted(k for k, own in self._scene_of().items() if own == scene)
        picks = sorted({fresh[round(i * (len(fresh) - 1) / (SAMPLES - 1))] for i in range(SAMPLES)})
        return still_background([self.view.frames[k] for k in picks], self.noise)

    def _in_frame(self, frame: NDArray[Any], ground: Background) -> tuple[Glints, int]:
        """Discs of one frame, and how many objects are none."""
        light = frame.astype(np.float32)
        light -= _brighter(light, ground.level)
        rows, refused = [], 0
        boxes, labels = self._regions(light - ground.level.astype(np.float32))
        for number, box in boxes[:MOST]:
            found, none = self._in_region(light, ground, labels, number, box)
            rows += found
            refused += none
        if not rows:
            return Glints.none(), refused
        x, y, xx, xy, yy, fxx, fxy, fyy, area, flags = np.array(rows).T
        cov = np.stack([xx, xy, xy, yy], -1).reshape(-1, 2, 2)
        fixed = np.stack([fxx, fxy, fxy, fyy], -1).reshape(-1, 2, 2)
        nothing = np.zeros(len(rows))
        return Glints(nothing.astype(np.int64), x, y, cov, area, nothing, flags.astype(np.int64), fixed), refused

    def _regions(self, apart: NDArray[np.float32]) -> tuple[list[tuple[int, Box]], NDArray[np.int32]]:
        """Connected regions that differ from the background, largest first: number and box; and their picture."""
        mask = (np.abs(cv2.blur(apart, (3, 3))) > self.low).view(np.uint8)
        count, labels, boxes, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
        large = [k for k in range(1, count) if boxes[k][4] > np.pi * SMALLEST**2]
        large.sort(key=lambda k: -int(boxes[k][4]))
        return [(k, tuple(boxes[k].tolist())) for k in large], np.asarray(labels, dtype=np.int32)

    def _parts(self, apart: NDArray[Any], own: NDArray[np.bool_], box: Box) -> list[_Part]:
        """What in a region's box has half its contrast: a ball without its shadow."""
        left, top, width, height, _ = box
        inside = np.abs(apart)
        high = (own & (inside > 0.5 * np.median(inside[own]))).view(np.uint8)
        outlines, _ = cv2.findContours(np.pad(high, 1), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        parts = []
        for line in outlines:
            mask = np.zeros((height + 2, width + 2), np.uint8)
            cv2.drawContours(mask, [line], -1, 1, cv2.FILLED)
            m = cv2.moments(mask, binaryImage=True)
            if m["m00"] < np.pi * SMALLEST**2:
                continue
            cov = np.array([[m["mu20"], m["mu11"]], [m["mu11"], m["mu02"]]]) / m["m00"]
            (least, most), axes = np.linalg.eigh(cov)
            long = np.sqrt(max(12 * (most - least), 0.0))
            way = (long if long > max(BLUR, SWEPT * np.sqrt(most)) else 0.0) * axes[:, 1]
            middle = np.array([m["m10"], m["m01"]]) / m["m00"] + [left - 1, top - 1]
            minor = 2 * np.sqrt(max(least, 0.0))
            contrast = float(np.median(inside[(mask[1:-1, 1:-1] > 0) & own]))
            parts.append(_Part(mask, left - 1, top - 1, m["m00"], middle, minor, way, contrast))
        return parts

    def _is_disc(self, part: _Part, radius: float) -> bool:
        """Whether a part looks as one disc that moved a little."""
        long = float(np.hypot(*part.way))
        ellipse = np.pi * part.minor * 2 * np.sqrt((part.minor / 2) ** 2 + long**2 / 12)
        sized = abs(part.minor / radius - 1) < ALIKE and abs(part.radius / radius - 1) < ALIKE
        return sized and part.area > FULL * ellipse and long < LONGEST * radius

    def _usual(self, given: float | None) -> tuple[list[float], float]:
        """The most common radius of discs in frames spread over the film, px, or the given one; and their contrast."""
        scene_of, round_parts = self._scene_of(), list[_Part]()
        frames = sorted(scene_of)
        for k in sorted({frames[round(i * (len(frames) - 1) / (LOOKED - 1))] for i in range(LOOKED)}):
            ground = self.scenes[scene_of[k]]
            light = np.asarray(self.view.frames[k]).astype(np.float32)
            apart = (light - _brighter(light, ground.level) - ground.level).astype(np.float32)
            boxes, labels = self._regions(apart)
            for number, (left, top, width, height, area) in boxes[:MOST]:
                if left > 0 and top > 0 and left + width < apart.shape[1] and top + height < apart.shape[0]:
                    at = slice(top, top + height), slice(left, left + width)
                    parts = self._parts(apart[at], labels[at] == number, (left, top, width, height, area))
                    round_parts += [p for p in parts if self._is_disc(p, given or p.minor)]
        if not round_parts:
            return [given or self.view.camera.diameter_px / 2], 0.0
        radii, contrasts = np.array([(p.radius, p.contrast) for p in round_parts]).T
        order = np.argsort(contrasts)
        weight = np.cumsum((contrasts * radii**2)[order])  # a ball counts more than many specks
        usual = float(contrasts[order][np.searchsorted(weight, weight[-1] / 2)])
        strong = contrasts > FAINT * usual
        still = strong & [float(np.hypot(*p.way)) < ROUND * p.minor for p in round_parts]
        return [given] if given else _common(radii[still if still.sum() > FEWEST else strong]), usual

    def _scene_of(self) -> dict[int, int]:
        """The scene of each frame that is in a take and not given twice."""
        both = zip(self.takes.spans, self.takes.scenes, strict=True)
        every = {k: scene for (a, b), scene in both for k in range(a, b + 1)}
        return {k: scene for k, scene in every.items() if k not in self.takes.repeated}

    def _in_region(
        self,
        light: NDArray[np.float32],
        ground: Background,
        labels: NDArray[np.int32],
        number: int,
        box: Box,
    ) -> tuple[list[tuple[float, ...]], int]:
        """Rows of discs of one region, and how many objects in it are none."""
        rows, refused = [], 0
        if box[4] < 0.3 * np.pi * min(self.radii) ** 2:
            return [], 0
        top, left = slice(box[1], box[1] + box[3]), slice(box[0], box[0] + box[2])
        apart = light[top, left] - ground.level[top, left]
        for part in self._parts(apart, labels[top, left] == number, box):
            radius = min(self.radii, key=lambda r: abs(r - part.minor))
            found: list[tuple[Found, int]] = []
            if self._is_disc(part, radius):
                fitted = fit_disc(light, ground, part.middle, radius, part.way, [], self.noise)
                flag = BLURRED if np.hypot(*part.way) > ROUND * radius else 0
                found = [(fitted, flag)] if fitted is not None else []
            elif 0.3 < part.area / (np.pi * radius**2) < 6:
                found = self._touching(light, ground, part, radius)
            found = [(f, flag) for f, flag in found if abs(f.radius / radius - 1) < ALIKE]
            refused += not found and part.area > 0.5 * np.pi * radius**2
            rows += [self._row(f, flag, radius, light.shape) for f, flag in found]
        return rows, refused

    def _touching(
        self, light: NDArray[np.float32], ground: Background, part: _Part, radius: float
    ) -> list[tuple[Found, int]]:
        """Discs in a part that is not one whole disc: cut by the picture's rim, or several that touch."""
        places = [(x + part.left, y + part.top) for x, y in _middles(part, radius)]
        found = []
        for at in places:
            others = [p for p in places if p != at]
            start = outline(light, ground.level, at, radius, others, self.low)
            fitted = None
            if start is not None:
                fitted = fit_disc(light, ground, start, radius, np.zeros(2), others, self.noise)
            if fitted is not None:
                found.append((fitted, NEAR if others else 0))
        return found

    def _row(self, found: Found, flag: int, radius: float, shape: tuple[int, ...]) -> tuple[float, ...]:
        x, y = found.place
        whole = radius < x < shape[1] - 1 - radius and radius < y < shape[0] - 1 - radius
        cov = [m[i, j] for m in (found.cov, found.fixed) for i, j in ((0, 0), (0, 1), (1, 1))]
        return x, y, *cov, np.pi * radius**2, flag | (0 if whole else EDGE)


_REST = ("x", "y", "cov", "flux", "background", "flags", "fixed")


def _brighter(light: NDArray[np.float32], level: Array) -> float:
    """Counts by which the whole picture is brighter than the background: exposure that the camera chose anew."""
    step = max(1, int(np.sqrt(light.size / 16_000)))
    change = float(np.median(light[::step, ::step] - level[::step, ::step]))
    return change if abs(change) > 1 else 0.0


def _common(radii: Array) -> list[float]:
    """The most common of radii, and a second if it is common, px."""
    common: list[float] = []
    for _ in range(2):
        if len(radii) == 0:
            break
        near = np.abs(radii[:, None] / radii - 1) < CLOSE
        best = near[near.sum(axis=1).argmax()]
        if common and best.sum() < max(SECOND * len(near), 5):
            break
        common.append(float(np.median(radii[best])))
        radii = radii[np.abs(radii / common[-1] - 1) > ALIKE]
    return common


def _middles(part: _Part, radius: float) -> list[tuple[float, float]]:
    """Where balls' middles may be in a part: the places furthest from its rim, a radius apart at least."""
    balls = round(part.area / (np.pi * radius**2))
    if balls <= 1:
        return [(part.middle[0] - part.left, part.middle[1] - part.top)]
    depth, middles = cv2.distanceTransform(part.mask, cv2.DIST_L2, 5), []
    for _ in range(balls):
        _, deepest, _, (x, y) = cv2.minMaxLoc(depth)
        if deepest < 0.7 * radius:
            break
        middles.append((float(x), float(y)))
        cv2.circle(depth, (x, y), round(1.3 * radius), 0.0, -1)
    return middles
