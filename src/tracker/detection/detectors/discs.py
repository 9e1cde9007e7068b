"""Discs on a still background: matte, coloured, dark or bright balls, and pucks, seen by their outlines."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from tracker.camera.lens import Array
from tracker.detection.contrast_regions import (
    ALIKE,
    SMALLEST,
    Box,
    ContrastRegion,
    casts_shadow,
    find_disc_centres,
    split_region,
)
from tracker.detection.disc_fit import DiscAppearance, DiscFit, fit_disc
from tracker.detection.glints import BLURRED, EDGE, NEAR, SHADED, Glints, View
from tracker.detection.outline import fit_outline_circle
from tracker.detection.still_background import SAMPLES, StillBackground, average_uncovered, estimate_still_background
from tracker.detection.takes import find_takes

LEAST_CONTRAST = 8.0  # counts, of a ball over the background
DEVIATIONS = 6.0  # the same, of the noise of a mean of 3 x 3 pixels
NOISY, ROOMY = 4.0, 7.5  # counts of noise, from which means are of 5 x 5 pixels; px, of the radius for it
FAINT, FAINTEST = 0.35, 0.2  # of the clearest discs' contrast: what is fainter is not asked for their size; is none
ROUND = 0.35  # radii, a way of what is taken for a ball at rest
FREE = 0.5  # of a disc's place, seen without it; else it may be always there
SHAKEN = 4  # such discs in a frame: more are parts of what shakes with the camera
RIM = 4  # px about an object, that may still be its
TRUSTED = 0.12  # of the radius that the camera file gives, by which that seen may differ
TIED = 0.002  # of the radius: by which radii of balls lit from one side may differ, whose far sides are hardly seen
SHADOWED = 0.5  # of the bright discs, beside which something is darker than the background: balls that cast shadows
LIT = 0.15  # of the contrast, a radius: the slope by which a lamp on one side shows, where no shadow does
MOST_LIT = 0.8  # of the discs, that have half that slope in the same direction
CLOSE = 0.1  # of a radius, within which two are counted as the same
SECOND = 0.3  # of the most common radius's count, that of a second one
FEWEST = 3  # discs at rest, from which their radius is read
ENOUGH = 10  # discs seen whole, to say how large they are
NORMAL = 1.4826  # standard deviation of a normal spread over its median absolute deviation
LOOKED = 25  # frames, for the usual radius
MOST = 40  # objects in a frame: beyond that it is no picture of a few balls


class Discs:
    """Discs by the pixels at their edges, in what differs from the background of their scene."""

    point: ClassVar[str] = "centre"

    def __init__(self, view: View) -> None:
        self.view = view
        self.takes = view.takes or find_takes(view.frames)
        self.noise = self.takes.noise
        given = view.camera.diameter_px / 2
        large = not view.camera.knows_diameter or given > ROOMY
        self.box = (5, 5) if self.noise > NOISY and large else (3, 3)
        self.low = max(DEVIATIONS * self.noise / self.box[0], LEAST_CONTRAST)
        self.refused: dict[int, int] = {}
        self.shadows = 0
        self.scenes = {
            scene: estimate_still_background(
                [cv2.blur(frame, self.box) for frame in self._samples(scene)], self.noise * 1.5 / self.box[0]
            )
            for scene in sorted(set(self.takes.scenes))
        }
        self.signs: tuple[int, ...] = (0,)
        self.dark_balls = True
        self.fitted: list[float] = []  # radii, px
        self.tied = 0.0  # of a radius
        self.larger = 1.0  # the balls' radius over that which is seen
        self.radii, contrast = self._usual_radius(given if view.camera.knows_diameter else None)
        self.low = max(self.low, FAINTEST * contrast)
        self.scenes = {scene: self._clean_background(scene) for scene in self.scenes}
        self.shadows = 0  # those met so far were the samples'
        if self.is_shaded and len(self.fitted) > FEWEST:
            fitted = np.array(self.fitted)
            near = np.abs(fitted[:, None] - self.radii).argmin(axis=1)
            self.tied, self.radii = TIED, [float(np.median(fitted[near == k])) for k in np.unique(near)]
            if view.camera.knows_diameter and abs(self.radii[0] / given - 1) < TRUSTED:
                self.larger = given / self.radii[0]

    @property
    def radius(self) -> float:
        """The balls', px, or the most common one."""
        return self.radii[0]

    @property
    def is_shaded(self) -> bool:
        """Whether balls are brighter on one side, or cast shadows."""
        return self.signs != (0,)

    def measured_radius(self) -> tuple[float, float]:
        """Median radius of the discs fitted so far, px, and its random error; 0 where it is not to be seen.

        So it is of balls with one dark side, and where few are seen whole.
        """
        radii = np.array(self.fitted)
        radii = radii[np.abs(radii / self.radius - 1) < CLOSE]
        if self.is_shaded or len(radii) < ENOUGH:
            return 0.0, 0.0
        spread = NORMAL * float(np.median(np.abs(radii - np.median(radii))))
        return float(np.median(radii)), spread / float(np.sqrt(len(radii)))

    def notes(self) -> list[str]:
        """What a user has to know, once the frames have been searched."""
        said = self.takes.describe()
        if self.refused:
            count = sum(self.refused.values())
            said.append(
                f"{count} objects in {len(self.refused)} frames are no balls (not round, of another size, or "
                f"always there): left out, frame {min(self.refused)} is the first"
            )
        if self.shadows:
            said.append(
                f"shadows: {self.shadows} dark parts beside brighter balls are taken for the shadows they cast; such "
                "balls may lie off by .2 px towards the lamp; their errors hold 1 % of the radius"
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
                ground = self.scenes[scene_of[number]]
                found, refused = self._in_frame(frame, ground)
                moves = np.array([self._leaves(ground, at) for at in found.xy], dtype=bool)
                if (~moves).sum() > SHAKEN:
                    found, refused = found.take(moves), refused + int((~moves).sum())
                parts.append(Glints(np.full(len(found), number, np.int64), *(getattr(found, n) for n in _REST)))
                if refused:
                    self.refused[number] = refused
        return Glints.join(parts)

    def __call__(self, frame: NDArray[Any]) -> Glints:
        """Discs of one frame of the first scene; ``flux`` is their area, px^2, which balls of one size share."""
        return self._in_frame(frame, self.scenes[self.takes.scenes[0]])[0]

    def _leaves(self, ground: StillBackground, at: Array) -> bool:
        """Whether the place of a disc was seen without it."""
        x, y = np.round(at).astype(int)
        reach = int(self.radius)
        return bool(ground.known[max(y - reach, 0) : y + reach + 1, max(x - reach, 0) : x + reach + 1].mean() > FREE)

    def _samples(self, scene: int) -> list[NDArray[Any]]:
        """Frames spread over all takes of a scene."""
        fresh = sorted(k for k, own in self._scene_of().items() if own == scene)
        picks = sorted({fresh[round(i * (len(fresh) - 1) / (SAMPLES - 1))] for i in range(SAMPLES)})
        return [np.asarray(self.view.frames[k]) for k in picks]

    def _clean_background(self, scene: int) -> StillBackground:
        """The background of a scene, from what is no ball, shadow or other object in its frames."""
        ground = self._average_uncovered(scene, self.scenes[scene])
        return ground if ground.known.all() else self._average_uncovered(scene, ground)

    def _average_uncovered(self, scene: int, ground: StillBackground) -> StillBackground:
        """The same, where objects are told by a background that may be wrong where balls rest."""
        frames, covered = [], []
        for frame in self._samples(scene):
            light = frame.astype(np.float32)
            light -= _brighter(light, ground.level)
            apart = (light - ground.level).astype(np.float32)
            boxes, labels = self._regions(apart)
            mask = ((labels > 0) & ground.known).view(np.uint8)  # elsewhere what differs may be the plate
            for x, y in self._in_frame(frame, ground)[0].xy:
                cv2.circle(mask, (round(x), round(y)), round(self.radius), 1, -1)
            parts = [part for number, box in boxes[:MOST] for part in self._parts(apart, labels, number, box)]
            balls = [part for part in parts if part.sign > 0 and part.is_disc(self.radius)]
            for part in parts:
                if any(casts_shadow(ball, part) for ball in balls):
                    part.fill(mask)
            frames.append(light)
            covered.append(cv2.dilate(mask, np.ones((2 * RIM + 1, 2 * RIM + 1), np.uint8)).view(np.bool_))
        return average_uncovered(frames, covered, self.noise)

    def _in_frame(self, frame: NDArray[Any], ground: StillBackground) -> tuple[Glints, int]:
        """Discs of one frame, and how many objects are none."""
        light = frame.astype(np.float32)
        light -= _brighter(light, ground.level)
        apart = light - ground.level.astype(np.float32)
        boxes, labels = self._regions(apart)
        parts = [part for number, box in boxes[:MOST] for part in self._parts(apart, labels, number, box)]
        rows, refused, balls = list[tuple[float, ...]](), 0, list[ContrastRegion]()
        for part in sorted(parts, key=lambda p: -p.sign):
            radius = min(self.radii, key=lambda r: abs(r - part.minor))
            if part.sign > 0 and part.is_disc(radius):
                balls.append(part)
            elif any(casts_shadow(ball, part) for ball in balls) and not (self.dark_balls and part.is_disc(radius)):
                self.shadows += 1
                continue
            dark = part.sign < 0 and not self.dark_balls
            found = [] if dark else self._in_part(light, ground, part, radius)
            refused += not found and part.area > 0.5 * np.pi * radius**2
            rows += [self._row(f, flag, radius, light.shape) for f, flag in found]
        if not rows:
            return Glints.none(), refused
        x, y, xx, xy, yy, fxx, fxy, fyy, area, flags = np.array(rows).T
        cov = np.stack([xx, xy, xy, yy], -1).reshape(-1, 2, 2)
        fixed = np.stack([fxx, fxy, fxy, fyy], -1).reshape(-1, 2, 2)
        nothing = np.zeros(len(rows))
        return Glints(nothing.astype(np.int64), x, y, cov, area, nothing, flags.astype(np.int64), fixed), refused

    def _regions(self, apart: NDArray[np.float32]) -> tuple[list[tuple[int, Box]], NDArray[np.int32]]:
        """Connected regions that differ from the background, largest first: number and box; and their picture."""
        mask = (np.abs(cv2.blur(apart, self.box)) > self.low).view(np.uint8)
        count, labels, boxes, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
        large = [k for k in range(1, count) if boxes[k][4] > np.pi * SMALLEST**2]
        large.sort(key=lambda k: -int(boxes[k][4]))
        return [(k, tuple(boxes[k].tolist())) for k in large], np.asarray(labels, dtype=np.int32)

    def _parts(
        self, apart: NDArray[np.float32], labels: NDArray[np.int32], number: int, box: Box
    ) -> list[ContrastRegion]:
        """What in a region has half its contrast: a ball without its shadow; or its brighter and its darker parts."""
        at = slice(box[1], box[1] + box[3]), slice(box[0], box[0] + box[2])
        smooth = cv2.blur(apart[at], (3, 3)) if self.noise > NOISY else apart[at]
        return [p for sign in self.signs for p in split_region(smooth, labels[at] == number, box, sign, self.low)]

    def _usual_radius(self, given: float | None) -> tuple[list[float], float]:
        """The most common radius of discs in frames spread over the film, px, or the given one; and their contrast."""
        seen = self._without_shadows(given)
        if not seen:
            return [given or self.view.camera.diameter_px / 2], 0.0
        radii, contrasts = np.array([(p.radius, p.contrast) for p in seen]).T
        order = np.argsort(contrasts)
        weight = np.cumsum((contrasts * radii**2)[order])  # a ball counts more than many specks
        usual = float(contrasts[order][np.searchsorted(weight, weight[-1] / 2)])
        strong = contrasts > FAINT * usual
        still = strong & [float(np.hypot(*p.way)) < ROUND * p.minor for p in seen]
        return [given] if given else _common_radii(radii[still if still.sum() > FEWEST else strong]), usual

    def _without_shadows(self, given: float | None) -> list[ContrastRegion]:
        """Discs in frames spread over the film; sets what is told apart in all of them."""
        either = [p for parts in self._survey() for p in parts if p.is_disc(given or p.minor)]
        self.signs = (1, -1)
        bright, shadowed, alone = list[ContrastRegion](), 0, 0
        for parts in self._survey():
            balls = [p for p in parts if p.sign > 0 and p.is_disc(given or p.minor)]
            bright += balls
            shadowed += sum(any(casts_shadow(p, other) for other in parts) for p in balls)
            dark = [p for p in parts if p.sign < 0 and p.is_disc(given or p.minor)]
            alone += sum(not any(casts_shadow(p, d) for p in balls) for d in dark)
        least = max(SHADOWED * len(bright), FEWEST)
        if shadowed > least or (len(bright) > FEWEST and 2 * len(bright) > len(either) and _lit_from_one_side(bright)):
            self.dark_balls = alone > least
            return bright
        self.signs = (0,)
        return either

    def _survey(self) -> Iterator[list[ContrastRegion]]:
        """Parts clear of the picture's rim, of frames spread over the film."""
        scene_of = self._scene_of()
        frames = sorted(scene_of)
        for k in sorted({frames[round(i * (len(frames) - 1) / (LOOKED - 1))] for i in range(LOOKED)}):
            ground = self.scenes[scene_of[k]]
            light = np.asarray(self.view.frames[k]).astype(np.float32)
            apart = (light - _brighter(light, ground.level) - ground.level).astype(np.float32)
            boxes, labels = self._regions(apart)
            height, width = apart.shape
            inside = [
                (k, b) for k, b in boxes[:MOST] if min(b[:2]) > 0 and b[0] + b[2] < width and b[1] + b[3] < height
            ]
            yield [part for number, box in inside for part in self._parts(apart, labels, number, box)]

    def _scene_of(self) -> dict[int, int]:
        """The scene of each frame that is in a take and not given twice."""
        both = zip(self.takes.spans, self.takes.scenes, strict=True)
        every = {k: scene for (a, b), scene in both for k in range(a, b + 1)}
        return {k: scene for k, scene in every.items() if k not in self.takes.repeated}

    def _in_part(
        self, light: NDArray[np.float32], ground: StillBackground, part: ContrastRegion, radius: float
    ) -> list[tuple[DiscFit, int]]:
        """Discs in one part, with their flags."""
        found: list[tuple[DiscFit, int]] = []
        if part.is_disc(radius):
            fitted = fit_disc(light, ground, part.middle, self._look(radius), part.way, [])
            flag = BLURRED if np.hypot(*part.way) > ROUND * radius else 0
            found = [(fitted, flag)] if fitted is not None else []
        elif 0.3 < part.area / (np.pi * radius**2) < 6:
            found = self._touching(light, ground, part, radius)
        found = [(f, flag) for f, flag in found if abs(f.radius / radius - 1) < ALIKE]
        self.fitted += [f.radius for f, flag in found if flag == 0]
        return found

    def _look(self, radius: float) -> DiscAppearance:
        return DiscAppearance(radius * self.larger, self.noise, self.is_shaded, self.tied * radius)

    def _touching(
        self, light: NDArray[np.float32], ground: StillBackground, part: ContrastRegion, radius: float
    ) -> list[tuple[DiscFit, int]]:
        """Discs in a part that is not one whole disc: cut by the picture's rim, or several that touch."""
        places = [(x + part.left, y + part.top) for x, y in find_disc_centres(part, radius)]
        found, own = [], light
        if part.sign:  # without the others' shadows
            level = ground.level.astype(np.float32)
            own = level + part.sign * np.maximum(part.sign * (light - level), 0)
        for at in places:
            others = [p for p in places if p != at]
            start = fit_outline_circle(own, ground.level, at, radius, others, self.low)
            if start is None and part.sign and others:  # what is lit of a ball is not round
                start = np.array(at)
            fitted = None
            if start is not None:
                fitted = fit_disc(light, ground, start, self._look(radius), np.zeros(2), others)
            if fitted is not None:
                found.append((fitted, NEAR if others else 0))
        return found

    def _row(self, found: DiscFit, flag: int, radius: float, shape: tuple[int, ...]) -> tuple[float, ...]:
        x, y = found.place
        flag |= SHADED if self.is_shaded else 0
        whole = radius < x < shape[1] - 1 - radius and radius < y < shape[0] - 1 - radius
        cov = [m[i, j] for m in (found.cov, found.fixed) for i, j in ((0, 0), (0, 1), (1, 1))]
        return x, y, *cov, np.pi * radius**2, flag | (0 if whole else EDGE)


_REST = ("x", "y", "cov", "flux", "background", "flags", "fixed")


def _brighter(light: NDArray[np.float32], level: Array) -> float:
    """Counts by which the whole picture is brighter than the background: exposure that the camera chose anew."""
    step = max(1, int(np.sqrt(light.size / 16_000)))
    change = float(np.median(light[::step, ::step] - level[::step, ::step]))
    return change if abs(change) > 1 else 0.0


def _lit_from_one_side(discs: list[ContrastRegion]) -> bool:
    """Whether discs are brighter on one side, all on the same."""
    leans = np.array([disc.lean for disc in discs])
    mean = np.median(leans, axis=0)
    size = float(np.hypot(*mean))
    return size > LIT and float(np.quantile(leans @ mean / size, 1 - MOST_LIT)) > LIT / 2


def _common_radii(radii: Array) -> list[float]:
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
