"""Detects discs on a still background by their outlines: matte, coloured, dark or bright balls, and pucks."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from synthcam_shared.arrays import Array, Flags
from synthcam_shared.steps import report_step
from tracker.camera.camera_keys import CONTRAST
from tracker.camera.colour_planes import PLATE, is_plane
from tracker.camera.frames import Frames, pick_spread
from tracker.detection.background.still_background import StillBackground, average_uncovered, estimate_still_background
from tracker.detection.background.takes import find_takes
from tracker.detection.background.windows import Index, PixelRegion, find_regions
from tracker.detection.balls_on_plate import find_balls_at_rest
from tracker.detection.detector import Detections, OutlineRadius, View
from tracker.detection.glints import Glints, PositionFlag
from tracker.detection.outlines.contrast_regions import (
    MIN_STREAK_FULLNESS,
    ContrastRegion,
    casts_shadow,
    find_disc_centres,
    find_touching_discs,
    split_region,
)
from tracker.detection.outlines.disc_fit import DiscAppearance, DiscFit, DiscScene, find_lit_side, fit_disc
from tracker.detection.outlines.disc_group import fit_disc_group
from tracker.detection.outlines.disc_packing import ENLARGEMENT_PX, estimate_least_distance, pack_region
from tracker.detection.outlines.hidden_disc import fit_outline_circle

PLATE_SHIFT_SHARE = 0.25  # shift of a lit disc in the plane of distances from the plate, over how much it is enlarged
TURNING_ERROR_RADII = 0.02  # rms of a position where a shadow counts as part of a body with two tones, as it turns
ContrastArea: TypeAlias = tuple[PixelRegion, NDArray[np.float32]]  # a region, and its difference from the background
MAX_BLUR_AT_REST = 0.35  # displacement during the exposure, in radii, up to which a disc counts as at rest


@dataclass
class _Tally:
    """Counts of one frame, or of all."""

    refused: int = 0  # objects that are not balls
    refused_area: float = 0.0  # of these, in balls
    shadows: int = 0
    cut_frames: int = 0  # frames with too many objects
    radii: list[float] = field(default_factory=list)  # of whole discs, px
    surveyed: int = 0  # frames that the survey has looked at
    to_survey: int = 0  # those that it looks at in all

    def note_surveyed(self) -> None:
        """Count one more frame of the survey, and report it as progress."""
        self.surveyed += 1
        report_step("frames", self.surveyed, self.to_survey)


@dataclass(frozen=True, eq=False)
class _SeenFrame:
    """A frame with the brightness of its background, and the background."""

    light: NDArray[Any]
    ground: StillBackground

    @staticmethod
    def of(frame: NDArray[Any], ground: StillBackground) -> _SeenFrame:
        change = _measure_change(frame, ground.level)
        return _SeenFrame(frame.astype(np.float32) - np.float32(change) if change else frame, ground)

    def difference(self, at: Index) -> NDArray[np.float32]:
        """How far a part of the frame differs from the background, counts."""
        return np.asarray(np.subtract(self.light[at], self.ground.level[at], dtype=np.float32))

    @cached_property
    def whole_difference(self) -> NDArray[np.float32]:
        """How far each pixel of the frame differs from the background, counts."""
        return self.difference((slice(None), slice(None)))


class Discs:
    """Finds regions that differ from the background of their scene, and fits discs to the pixels at their edges.

    Made from a view, it surveys the film. It finds the background of each scene, the radii of the balls, and whether
    light from one side casts shadows. `detect` then fits the discs of each frame.
    """

    point: ClassVar[str] = "centre"

    def __init__(self, view: View) -> None:
        self.view, self.settings = replace(view, frames=()), view.settings.detection
        self.takes = view.takes or find_takes(view.frames)
        self.scene_of = self.takes.scene_of_frames()
        self.noise = self.takes.noise
        self.is_noisy = self.noise > 4.0  # counts
        given = view.radius or view.camera.diameter_px / 2
        knows_radius = view.radius is not None or view.camera.knows_diameter
        # Means of 5 x 5 pixels suppress noise better than those of 3 x 3, but only large balls stay as they are.
        large = not knows_radius or given > 7.5
        self.box = (5, 5) if self.is_noisy and large else (3, 3)
        self.low = max(self.settings.disc_contrast_sigma * self.noise / self.box[0], self.settings.disc_contrast_counts)
        fresh = sorted(self.scene_of)
        survey, scenes = pick_spread(fresh, 25), sorted(set(self.takes.scenes))
        samples = {scene: pick_spread([k for k in fresh if self.scene_of[k] == scene], 31) for scene in scenes}
        # of the frames that the survey looks at
        tally = _Tally(to_survey=len(survey) + sum(map(len, samples.values())))
        if isinstance(view.frames, Frames):
            view.frames.remember([*itertools.chain(*samples.values()), *survey])
        self.scenes = {
            scene: estimate_still_background(
                [view.frames[k] for k in numbers], self.noise * 1.5 / self.box[0], self.box
            )
            for scene, numbers in samples.items()
        }
        self.in_colour = is_plane(view.channel)  # shadows hardly show; hands and cues do
        self.on_plate = view.channel == PLATE  # balls show where they always rest, and look larger than they are
        self.elongated = False  # balls look elongated even at rest: the view is oblique, or pixels are not square
        self.signs: tuple[int, ...] = (0,)
        self.dark_balls = True
        self.relative_radius_std = 0.0
        self.true_to_fitted_radius = 1.0
        areas = [self._survey(k, np.asarray(view.frames[k]), tally) for k in survey]
        self.radii, self.contrast = self._usual_radius(areas, given if knows_radius else None)
        if not self.contrast:  # no disc
            areas = [self._survey_rim(k, np.asarray(view.frames[k])) for k in survey]
            self.radii, self.contrast = self._usual_radius(areas, given if knows_radius else None)
        self.low = max(self.low, 0.2 * self.contrast)  # fainter objects are not balls
        self.apart = estimate_least_distance(self.radius, 2 * given if knows_radius else None)
        if self.on_plate:  # a ball of little contrast looks as large as it is
            self.radii.append(self.apart / 2)
        self.plate_shift = self._estimate_plate_shift(view.frames, survey, areas) if self.on_plate else np.zeros(2)
        for scene, numbers in samples.items():
            clean = self._clear_balls_at_rest if self.on_plate else self._clean_background
            self.scenes[scene] = clean(scene, [np.asarray(view.frames[k]) for k in numbers], tally)
        self.fitted = tuple(tally.radii)  # radii of whole discs in these frames, px
        if self.is_shaded and len(self.fitted) > 3:
            self._tie_radii(given)

    def _tie_radii(self, given: float) -> None:
        """Give balls that are lit from one side the radii of all: their far sides hardly show."""
        fitted = np.array(self.fitted)
        near = np.abs(fitted[:, None] - self.radii).argmin(axis=1)
        self.relative_radius_std = 0.002
        self.radii = [float(np.median(fitted[near == k])) for k in np.unique(near)]
        if self.view.camera.knows_diameter and abs(self.radii[0] / given - 1) < 0.12:
            self.true_to_fitted_radius = given / self.radii[0]

    @property
    def radius(self) -> float:
        """The most common radius of the balls, px."""
        return self.radii[0]

    @property
    def is_shaded(self) -> bool:
        """True if balls are brighter on one side, or cast shadows."""
        return self.signs != (0,)

    def detect(self, frames: Iterable[tuple[int, NDArray[Any]]]) -> Detections:
        """Discs of all frames except those between takes and repeated ones; the flux is the area, px^2, of a ball."""
        return self.gather((number, self.examine(number, frame)) for number, frame in frames)

    can_share: ClassVar[bool] = True

    def examine(self, number: int, frame: NDArray[Any]) -> tuple[Glints, _Tally]:
        """Discs of one frame, and counts; none in a frame between takes or a repeated one."""
        tally = _Tally()
        if number not in self.scene_of:
            return Glints.none(), tally
        seen = _SeenFrame.of(frame, self.scenes[self.scene_of[number]])
        found = self._in_frame(seen, tally)
        # a disc in a position that was never seen empty may always be there
        middles, reach = np.round(found.xy).astype(int), int(self.radius)
        moves = np.array([seen.ground.was_seen_around(x, y, reach) for x, y in middles], dtype=bool)
        most = 4  # discs in positions that were never seen empty; more are parts of a shaking background
        if (~moves).sum() > most:
            found = found.take(moves)
            tally.refused += int((~moves).sum())
        return replace(found, frame=np.full(len(found), number, np.int64)), tally

    def gather(self, examined: Iterable[tuple[int, tuple[Glints, _Tally]]]) -> Detections:
        """The discs of all frames, and notes."""
        refused, parts, whole = dict[int, int](), [Glints.none()], _Tally(radii=list(self.fitted))
        for number, (found, tally) in examined:
            parts.append(found)
            whole.shadows += tally.shadows
            whole.cut_frames += tally.cut_frames
            whole.refused_area += tally.refused_area
            whole.radii += tally.radii
            if tally.refused:
                refused[number] = tally.refused
        return Detections(
            glints=Glints.join(parts),
            notes=tuple(self._notes(refused, sum(map(len, parts)), whole)),
            outline_radius=self._measure_radius(np.array(whole.radii)),
        )

    def __call__(self, frame: NDArray[Any]) -> Glints:
        """Discs of one frame of the first scene."""
        return self._in_frame(_SeenFrame.of(frame, self.scenes[self.takes.scenes[0]]), _Tally())

    def _measure_radius(self, radii: Array) -> OutlineRadius | None:
        """The radius of discs of the most common size; None of shaded balls, whose dark side does not show."""
        enlargement_std_px = 0.5  # of a radius, in the plane of distances from the plate: by 0 to 2 px
        radii = radii[_are_equal(radii, self.radius)]
        if self.is_shaded or len(radii) < 10:
            return None
        spread = 1.4826 * float(np.median(np.abs(radii - np.median(radii))))  # of a normal distribution
        radius, std = float(np.median(radii)), spread / float(np.sqrt(len(radii)))
        if self.on_plate:
            return OutlineRadius(radius - ENLARGEMENT_PX, float(np.hypot(std, enlargement_std_px)))
        return OutlineRadius(radius, std)

    def _notes(self, refused: dict[int, int], found: int, tally: _Tally) -> Iterator[str]:
        """Notes on the frames that were searched: objects refused by frame, positions found, tally of all frames."""
        min_crowd = 3.0  # area of what is refused, over that of the balls found, from which on a note reports a crowd
        yield from self.takes.describe()
        if refused:
            why, count = "not round, of another size, or always there", sum(refused.values())
            yield (
                f"one object in frame {min(refused)} is not a ball and is left out ({why})"
                if count == 1
                else f"{count} objects in {len(refused)} frames are not balls and are left out ({why}), "
                f"frame {min(refused)} first"
            )
        if tally.refused_area > min_crowd * max(found, 10):
            height, width = self.view.plate.level.shape
            share = tally.refused_area * np.pi * self.radius**2 / (height * width * max(len(self.scene_of), 1))
            much = (
                f"as much as {tally.refused_area:.0f} balls in all, and {found} balls are found"
                if found
                else "and no ball is found"
            )
            yield (
                f"crowd: what is left out covers {share:.1%} of each frame, {much}; balls that touch are not all "
                "separated, and a camera that moves shows the same"
                + (". A ball in a hand is not round: --colour and --ball X,Y,R@FRAME point at it" if not found else "")
            )
        if tally.cut_frames:
            most = self.settings.max_objects_per_frame
            yield (
                f"crowd: {tally.cut_frames} frames show more than {most} objects, of which the {most} largest are "
                f"looked at; a file with `detection: {{max_objects_per_frame: {10 * most}}}` behind --settings has more"
            )
        if tally.shadows:
            yield (
                f"shadows: the tracker takes {tally.shadows} dark regions beside brighter balls for their shadows; "
                "such positions may be off by .2 px towards the lamp; their errors include 1 % of the radius"
            )
        if self.view.camera.sensor.codec_noise:
            yield (
                "lossy video: the errors in tracks are those of the noise of pixels. An encoder may shift an "
                "outline by .3 px for many frames; a measurement takes its errors from the residuals instead"
            )
        if len(self.radii) > 1 and not self.on_plate:
            yield "discs of two sizes: " + " and ".join(f"{2 * r:.1f} px across" for r in self.radii)

    def _clean_background(self, scene: int, sample: list[NDArray[Any]], tally: _Tally) -> StillBackground:
        """The background of a scene, without the balls, shadows and other objects in these of its frames."""
        ground = self._average_uncovered(sample, self.scenes[scene], tally)
        if ground.known.all():
            return ground
        tally.to_survey += len(sample)
        return self._average_uncovered(sample, ground, tally)

    def _clear_balls_at_rest(self, scene: int, sample: list[NDArray[Any]], tally: _Tally) -> StillBackground:
        """The background of a plane of distances from the plate, without the balls that rest all the time."""
        ground = self.scenes[scene]
        if not self.contrast:  # no disc
            return ground
        floor = np.float32(np.median(ground.level))
        at_rest = ground.level - floor > 0.5 * self.contrast

        def measure(frame: NDArray[Any]) -> NDArray[np.float32]:
            tally.note_surveyed()
            return np.asarray((frame - floor) / np.float32(self.contrast), np.float32)

        balls = find_balls_at_rest(map(measure, sample), at_rest, self.radius, self.apart)
        return StillBackground(np.where(balls, floor, ground.level), ground.error, ground.known | balls)

    def _average_uncovered(self, sample: list[NDArray[Any]], ground: StillBackground, tally: _Tally) -> StillBackground:
        """The same, from objects found over a background that may be wrong where balls rest."""
        rim_px = 4  # around an object, which it may still affect
        covered, changes = [], []
        for frame in sample:
            tally.note_surveyed()
            changes.append(_measure_change(frame, ground.level))
            seen = _SeenFrame.of(frame, ground)
            parts = self._split(self._find_areas(seen, tally))
            differs = self._smooth_difference(seen) > self.low
            mask = (differs & ground.known).view(np.uint8)  # elsewhere a difference may be the plate's
            for x, y in self._fit_parts(seen, parts, tally).xy:
                cv2.circle(mask, (round(x), round(y)), round(self.radius), 1, -1)
            balls = [part for part in parts if part.sign > 0 and self._is_disc(part, self.radius)]
            for part in parts:
                if any(casts_shadow(ball, part) for ball in balls):
                    part.fill(mask)
            near = cv2.dilate(mask, np.ones((2 * rim_px + 1, 2 * rim_px + 1), np.uint8))
            covered.append(np.packbits(np.asarray(near, np.uint8), axis=1))
        return average_uncovered(sample, covered, self.noise, changes)

    def _in_frame(self, seen: _SeenFrame, tally: _Tally) -> Glints:
        """Discs of one frame; the tally counts what it shows besides."""
        return self._fit_parts(seen, self._split(self._find_areas(seen, tally)), tally)

    def _fit_parts(self, seen: _SeenFrame, parts: list[ContrastRegion], tally: _Tally) -> Glints:
        """The same, of the parts of its regions."""
        fits, balls = list[tuple[DiscFit, int, float]](), list[ContrastRegion]()
        for part in sorted(parts, key=lambda p: -p.sign):
            radius = min(self.radii, key=lambda r: abs(r - part.minor))
            if part.sign > 0 and self._is_disc(part, radius):
                balls.append(part)
            elif any(casts_shadow(ball, part) for ball in balls) and not (
                self.dark_balls and self._is_disc(part, radius)
            ):
                tally.shadows += 1
                continue
            dark = part.sign < 0 and not self.dark_balls
            fitted = [] if dark else self._in_part(seen, part, radius)
            tally.radii += [f.radius for f, flag in fitted if flag == 0]
            tally.refused += not fitted and part.area > 0.5 * np.pi * radius**2
            tally.refused_area += 0.0 if fitted else part.area / (np.pi * radius**2)
            fits += [(f, flag, radius) for f, flag in fitted]
        return self._glints(_drop_repeated(fits), seen.light.shape) if fits else Glints.none()

    def _find_areas(self, seen: _SeenFrame, tally: _Tally) -> list[ContrastArea]:
        """The regions of a frame that differ from the background, largest first, with their differences."""
        least, reach = np.pi * self.settings.min_disc_radius_px**2, max(self.box) // 2
        rounding = 1.0  # counts, of both means

        def examine(at: Index) -> Flags:
            top, left = (max(side.start - reach, 0) for side in at)
            wide = slice(top, at[0].stop + reach), slice(left, at[1].stop + reach)
            mean = cv2.blur(seen.difference(wide), self.box)
            inner = mean[at[0].start - top : at[0].stop - top, at[1].start - left : at[1].stop - left]
            return np.asarray(np.abs(inner) > self.low)

        rough = self._smooth_difference(seen) > math.floor(self.low - rounding)
        if self.view.area is not None:
            rough &= self.view.area
        regions, most = find_regions(rough, least, examine), self.settings.max_objects_per_frame
        tally.cut_frames += len(regions) > most
        return [(region, seen.difference(region.at)) for region in regions[:most]]

    def _smooth_difference(self, seen: _SeenFrame) -> NDArray[Any]:
        """How far the means over boxes of pixels differ from those of the background, in whole counts as the frame."""
        return np.asarray(cv2.absdiff(cv2.blur(seen.light, self.box), seen.ground.blur(self.box, seen.light.dtype)))

    def _split(self, areas: list[ContrastArea]) -> list[ContrastRegion]:
        """The parts of regions: a ball without its shadow, or the brighter or darker part of a region."""
        parts, least = list[ContrastRegion](), self.settings.min_disc_radius_px
        for region, apart in areas:
            smooth = cv2.blur(apart, (3, 3)) if self.is_noisy else apart
            for sign in self.signs:
                parts += split_region(smooth, region.own, (region.left, region.top), sign, self.low, least)
        return parts

    def _usual_radius(self, areas: list[list[ContrastArea]], given: float | None) -> tuple[list[float], float]:
        """The common radii of discs in frames spread over the film, px, or the given one; and their contrast."""
        if self.on_plate:
            given = None
        seen = self._without_shadows(areas, given)
        if not seen:
            return [given or self.view.camera.diameter_px / 2], 0.0
        radii, contrasts = np.array([(p.radius, p.contrast) for p in seen]).T
        order = np.argsort(contrasts)
        weight = np.cumsum((contrasts * radii**2)[order])  # a ball counts more than many specks
        usual = float(contrasts[order][np.searchsorted(weight, weight[-1] / 2)])
        strong = contrasts > 0.35 * usual  # fainter discs do not enter the radius
        still = strong & [float(np.hypot(*p.blur)) < MAX_BLUR_AT_REST * p.minor for p in seen]
        if self.on_plate:
            enough = still if still.sum() > 3 else strong
            return _common_radii(radii[enough], self.settings.disc_radius_tolerance)[:1], usual
        if given:
            return [given], usual
        if still.sum() <= (3 if self.in_colour else 0):
            # all move fast, or look elongated: the short half axis is the radius of both
            self.elongated = self.in_colour
            radii, still = np.array([p.minor for p in seen]), strong
        return _common_radii(radii[still], self.settings.disc_radius_tolerance), usual

    def _estimate_plate_shift(self, frames: Sequence[Any], survey: list[int], areas: list[list[ContrastArea]]) -> Array:
        """The mean shift (2,) of discs in the plane of distances from the plate, px, towards the light.

        The bright side of a ball differs more from the plate, so that its edge is enlarged more. The light comes from
        where the discs of some frames are brighter.
        """
        most_frames, least_discs = 9, 3
        if not isinstance(frames, Frames) or frames.film_colours is None:
            return np.zeros(2)
        sides = list[Array]()
        for number, of_frame in pick_spread(list(zip(survey, areas, strict=True)), most_frames):
            discs = [part for part in self._split(of_frame) if self._is_disc(part, self.radius)]
            if discs:
                light = np.asarray(frames.film_colours(number), np.float32)[..., :3].sum(axis=2)
                sides += [find_lit_side(light, disc.middle, self.radius) for disc in discs]
        if len(sides) < least_discs:
            return np.zeros(2)
        return np.asarray(PLATE_SHIFT_SHARE * (self.radius - self.apart / 2) * np.mean(sides, axis=0))

    def _without_shadows(self, areas_of_frames: list[list[ContrastArea]], given: float | None) -> list[ContrastRegion]:
        """Discs in frames spread over the film; decides whether balls are lit from one side or are dark."""
        either = [p for areas in areas_of_frames for p in self._split(areas) if self._is_disc(p, given or p.minor)]
        if self.in_colour:  # light and shadow show too little
            return either
        self.signs = (1, -1)
        bright, shadowed, alone = list[ContrastRegion](), 0, 0
        for parts in map(self._split, areas_of_frames):  # again, now with brighter and darker parts separate
            balls = [p for p in parts if p.sign > 0 and self._is_disc(p, given or p.minor)]
            bright += balls
            shadowed += sum(any(casts_shadow(p, other) for other in parts) for p in balls)
            dark = [p for p in parts if p.sign < 0 and self._is_disc(p, given or p.minor)]
            alone += sum(not any(casts_shadow(p, d) for p in balls) for d in dark)
        least = max(0.5 * len(bright), 3)
        if shadowed > least or (len(bright) > 3 and 2 * len(bright) > len(either) and _lit_from_one_side(bright)):
            self.dark_balls = alone > least
            return bright
        self.signs = (0,)
        return either

    def _survey(self, number: int, frame: NDArray[Any], tally: _Tally) -> list[ContrastArea]:
        """The regions of a frame that do not touch the picture's rim."""
        tally.note_surveyed()
        seen = _SeenFrame.of(frame, self.scenes[self.scene_of[number]])
        return [area for area in self._find_areas(seen, tally) if not area[0].touches_rim(frame.shape)]

    def _survey_rim(self, number: int, frame: NDArray[Any]) -> list[ContrastArea]:
        """The regions of a frame at the picture's rim that it hardly cuts, as of a ball that rolls along it."""
        max_axes = 1.1  # long half axis over short one
        areas = self._find_areas(_SeenFrame.of(frame, self.scenes[self.scene_of[number]]), _Tally())
        parts = [(area, self._split([area])) for area in areas]
        return [area for area, one in parts if len(one) == 1 and one[0].area < max_axes * np.pi * one[0].minor ** 2]

    def _is_disc(self, region: ContrastRegion, radius: float) -> bool:
        return region.is_disc(radius, self.settings.disc_radius_tolerance, self.elongated)

    def _in_part(self, seen: _SeenFrame, part: ContrastRegion, radius: float) -> list[tuple[DiscFit, int]]:
        """Discs in one part, with their flags."""
        found: list[tuple[DiscFit, int]] = []
        balls, is_one = part.area / (np.pi * radius**2), self._is_disc(part, radius)
        if self.on_plate and self.contrast and not (is_one and balls < 1.4):
            packed = self._packed_group(seen, part, self.radius)
            if packed:
                return packed
        if is_one:
            fitted = self._fit(seen, radius, part.middle, part.blur)
            flag = PositionFlag.STREAK if np.hypot(*part.blur) > MAX_BLUR_AT_REST * radius else 0
            found = [(fitted, flag)] if fitted is not None else []
        elif self.in_colour:
            found = self._in_coloured_part(seen, part, radius)
        elif part.is_oblong_disc(radius, self.settings.disc_radius_tolerance):
            fitted = self._fit(seen, radius, part.middle, np.zeros(2))
            found = [(fitted, 0)] if fitted is not None else []
        elif 0.3 < balls < 6:
            found = self._touching(seen, part, radius)
        whole = [(f, flag) for f, flag in found if abs(f.radius / radius - 1) < self.settings.disc_radius_tolerance]
        # two discs whose waist is filled are as long as a streak of 3.5 radii
        several = not is_one or np.hypot(*part.blur) > 2.2 * radius
        if self.in_colour and several and 1.6 < balls < 6 and len(whole) < max(round(balls), 2):
            whole = max(whole, self._smeared_group(seen, part, radius), key=len)
        return whole

    def _in_coloured_part(self, seen: _SeenFrame, part: ContrastRegion, radius: float) -> list[tuple[DiscFit, int]]:
        """The same in a plane of colour, for a region that is not one whole disc: the most discs that fit.

        A ball has the usual contrast. Between two balls that touch, or a ball and a hand or a cue, there is less.
        """
        own, corner = part.mask[1:-1, 1:-1], (part.left + 1, part.top + 1)
        apart = seen.difference(part.at)
        best = list[DiscFit]()
        for share in (0.6, 0.7, 0.8):
            strong = (own > 0) & (np.abs(apart) > share * self.contrast)
            parts = split_region(apart, strong, corner, 0, self.low, 0.6 * radius) if strong.any() else []
            fits = [fit for p in parts for fit in self._inner_discs(seen, p, radius)]
            best = max(best, fits, key=lambda fits: (len(fits), -sum(fit.spread for fit in fits)))
        found = [(fit, int(PositionFlag.NEAR)) for fit in best]
        balls = part.area / (np.pi * radius**2)
        if len(found) < max(round(balls), 1) and 0.3 < balls < 6:
            found = max(found, self._touching(seen, part, radius), key=len)
        return found

    def _inner_discs(self, seen: _SeenFrame, part: ContrastRegion, radius: float) -> list[DiscFit]:
        """The disc, or the discs that touch, of a part of such a region; a rough look: the fits decide."""
        middles, blur = find_touching_discs(part.mask)[1], np.zeros(2)
        starts = [np.add(middle, (part.left, part.top)) for middle in middles]
        if not starts:
            streak = np.hypot(*part.blur) > 2.2 * radius
            if part.fullness > (MIN_STREAK_FULLNESS if streak else 0.85) and 0.6 < part.minor / radius < 1.25:
                starts, blur = [part.middle], part.blur
        fits = list[DiscFit]()
        for start in starts:
            others = [(float(x), float(y)) for x, y in starts if (x, y) != tuple(start)]
            fit = self._fit(seen, radius, start, blur, others)
            if fit is not None and abs(fit.radius / radius - 1) < 0.15:
                fits.append(fit)
        return fits

    def _fit(
        self, seen: _SeenFrame, radius: float, start: Array, blur: Array, others: Sequence[tuple[float, float]] = ()
    ) -> DiscFit | None:
        fitted_radius, spread = radius * self.true_to_fitted_radius, radius * self.relative_radius_std
        look = DiscAppearance(fitted_radius, self.noise, self.is_shaded, spread)
        return fit_disc(DiscScene(seen.light, seen.ground, look, blur, others), start)

    def _touching(self, seen: _SeenFrame, part: ContrastRegion, radius: float) -> list[tuple[DiscFit, int]]:
        """Discs in a region that is not one whole disc: cut by the picture's rim, or several that touch."""
        centres = [(x + part.left, y + part.top) for x, y in find_disc_centres(part, radius)]
        if not centres:
            return []
        found, at_window = list[tuple[DiscFit, int]](), _find_rays(centres, radius, seen.light.shape)
        corner = np.array([at_window[1].start, at_window[0].start])
        level = seen.ground.level[at_window]
        own = seen.light[at_window].astype(np.float32)
        if part.sign:  # without the shadows of the others
            own = level + part.sign * np.maximum(part.sign * (own - level), 0)
        for at in centres:
            others = [p for p in centres if p != at]
            here, *there = (tuple(np.subtract(p, corner)) for p in (at, *others))
            start = fit_outline_circle(own, level, here, radius, there, self.low)
            if start is not None:
                start = start + corner
            if start is None and part.sign and others:  # the lit part of a ball is not round
                start = np.array(at)
            fitted = None if start is None else self._fit(seen, radius, start, np.zeros(2), others)
            if fitted is not None:
                found.append((fitted, PositionFlag.NEAR if others else 0))
        return found

    def _smeared_group(self, seen: _SeenFrame, part: ContrastRegion, radius: float) -> list[tuple[DiscFit, int]]:
        """Find discs that touch, where an encoder has smeared their colours into each other, by their outline."""
        group = fit_disc_group(part.mask, (part.left, part.top), radius, seen.light.shape)
        return self._fit_edges(seen, group, radius)

    def _packed_group(self, seen: _SeenFrame, part: ContrastRegion, radius: float) -> list[tuple[DiscFit, int]]:
        """Find discs that touch, in the plane of distances from the plate; none if discs do not explain the region."""
        group = pack_region(part, seen.whole_difference / self.contrast, radius, self.apart)
        return [(fit, int(PositionFlag.NEAR)) for fit in group]

    def _fit_edges(self, seen: _SeenFrame, group: list[DiscFit], radius: float) -> list[tuple[DiscFit, int]]:
        """Fit each disc of a group to its edge, with flags. A disc whose fit fails keeps its position in the group."""
        found = list[DiscFit]()
        for one in group:
            others = [(float(x), float(y)) for x, y in (other.position for other in group if other is not one)]
            fit = self._fit(seen, radius, one.position, np.zeros(2), others)
            is_same = fit is not None and abs(fit.radius / one.radius - 1) < 0.15
            found.append(fit if fit is not None and is_same else one)
        return [(fit, int(PositionFlag.NEAR)) for fit in found]

    def _glints(self, fits: list[tuple[DiscFit, int, float]], shape: tuple[int, ...]) -> Glints:
        """Fits of one frame with their flags and radii as glints; the flux is the area of a ball, px^2."""
        found, flags, radii = zip(*fits, strict=True)
        x, y = np.array([f.position for f in found]).T
        cov, fixed = np.array([f.cov for f in found]), np.array([f.fixed for f in found])
        for matrix in (cov, fixed):
            matrix[:, 1, 0] = matrix[:, 0, 1]
        if self.on_plate:  # a side of less light is enlarged less; what is left is the same in most frames
            x, y = x - self.plate_shift[0], y - self.plate_shift[1]
            shift = PLATE_SHIFT_SHARE * (self.radius - self.apart / 2)
            cov, fixed = cov + shift**2 * np.eye(2), fixed + shift**2 * np.eye(2)
        if self.view.channel == CONTRAST:
            cov = cov + (TURNING_ERROR_RADII * self.radius) ** 2 * np.eye(2)
        rim = np.minimum.reduce([x, y, shape[1] - 1 - x, shape[0] - 1 - y]) <= radii
        flags |= np.where(rim, PositionFlag.EDGE, 0) | (PositionFlag.SHADED if self.is_shaded else 0)
        area = [np.pi * r**2 for r in radii]
        return replace(Glints.at(x, y, cov, area), flags=flags.astype(np.int64), fixed=fixed)


def _drop_repeated(fits: list[tuple[DiscFit, int, float]]) -> list[tuple[DiscFit, int, float]]:
    """Fits further than a radius from those before them.

    One ball may be two parts of a region, by its two colours or by a line that is drawn across it.
    """
    at = np.array([fit.position for fit, _, _ in fits])
    away = np.hypot(*np.moveaxis(at[:, None] - at, -1, 0))
    near = away <= np.array([radius for _, _, radius in fits])[:, None]
    kept = np.ones(len(fits), dtype=bool)
    for k in np.flatnonzero(np.tril(near, -1).any(axis=1)):
        kept[k] = not (near[k, :k] & kept[:k]).any()
    return [fit for fit, keep in zip(fits, kept, strict=True) if keep]


def _measure_change(frame: NDArray[Any], level: NDArray[np.float32]) -> float:
    """Counts by which a frame is brighter than the background; 0 unless the camera has adapted by over a count."""
    step = max(1, int(np.sqrt(frame.size / 16_000)))
    change = float(np.median(frame[::step, ::step] - level[::step, ::step]))
    return change if abs(change) > 1 else 0.0


def _find_rays(centres: list[tuple[float, float]], radius: float, shape: tuple[int, ...]) -> Index:
    """Index of the part of the picture that is searched for outlines of discs, up to 1.6 radii away."""
    reach = int(1.6 * radius) + 4
    (left, top), (right, bottom) = (np.round(edge(centres, axis=0)).astype(int) for edge in (np.min, np.max))
    rows = slice(max(top - reach, 0), min(bottom + reach + 1, shape[0]))
    return rows, slice(max(left - reach, 0), min(right + reach + 1, shape[1]))


def _lit_from_one_side(discs: list[ContrastRegion]) -> bool:
    """True if discs are brighter on one side, all on the same."""
    leans = np.array([disc.lean for disc in discs])
    mean = np.median(leans, axis=0)
    size = float(np.hypot(*mean))
    # the median change of contrast over a radius, and half of it in that direction for four fifths of the discs
    return size > 0.15 and float(np.quantile(leans @ mean / size, 1 - 0.8)) > 0.15 / 2


def _are_equal(radii: Array, radius: Any) -> Flags:
    """Which radii are those of one kind of ball: within a tenth."""
    return np.asarray(np.abs(radii / radius - 1) < 0.1)


def _common_radii(radii: Array, tolerance: float) -> list[float]:
    """The most common radius, px, and a second one if it is common; the two differ by the relative tolerance."""
    common: list[float] = []
    for _ in range(2):
        if len(radii) == 0:
            break
        near = _are_equal(radii[:, None], radii)
        best = near[near.sum(axis=1).argmax()]
        if common and best.sum() < max(0.3 * len(near), 5):
            break
        common.append(float(np.median(radii[best])))
        radii = radii[np.abs(radii / common[-1] - 1) > tolerance]
    return common
