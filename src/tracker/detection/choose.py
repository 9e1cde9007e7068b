"""Chooses the detector and the colour channel that suit a film, from frames spread over it."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ive

from synthcam_shared.arrays import Array, Flags
from synthcam_shared.errors import InputError
from tracker.camera.camera import Camera
from tracker.camera.camera_keys import CHANNELS, CONTRAST, PLANES
from tracker.camera.colour_planes import PLATE, read_plane
from tracker.camera.film_options import BallExample, parse_colour
from tracker.camera.frames import GREY, Frames, pick_spread, spread_frames
from tracker.camera.recordings import Recording
from tracker.detection.background.still_background import estimate_still_background
from tracker.detection.background.windows import find_regions
from tracker.detection.balls_on_plate import BallsOnPlate, count_balls_on_plate
from tracker.detection.candidates import (
    MAX_FITTED,
    MAX_FOLLOWED,
    estimate_pixel_noise,
    median_of_nine,
    sample_plate,
)
from tracker.detection.outlines.contrast_regions import find_touching_discs

GLINTS, DISCS, MANY_GLINTS = "maximum_likelihood", "discs", "linear_fit"
MIN_BODY_AREA_PX = 28  # of a ball seen whole, 6 px across
CORE_PX = 2.5  # radius of what surely belongs to a ball that the user points at


@dataclass(frozen=True)
class SelectedDetector:
    """The detector that a film asks for."""

    name: str
    why: str = ""  # a note; '' for glints, which need none


def select_detector(clip: Recording) -> SelectedDetector:
    """Choose the detector of a recording: `choose_detector`, and the user's hints."""
    if clip.balls:
        return SelectedDetector(DISCS)
    return SelectedDetector(*choose_detector(sample_frames(clip), clip.camera))


def choose_detector(frames: Sequence[Any], camera: Camera) -> tuple[str, str]:
    """Choose the detector from 25 frames spread over a film.

    It is "discs" if a fifth of them, and at least three, show a round body of the common size on a still background.
    Otherwise it is "maximum_likelihood". If the camera knows the diameter of its balls, only bodies of about that size
    count. The second result is a note that gives the reason; '' for glints, which need none.
    """
    if isinstance(frames, Frames):
        frames.remember(k for count in (9, 25, 31) for k in spread_frames(frames, count))
    level, noise = sample_plate(frames)
    if noise > 4.0:  # counts; means of 3 x 3 pixels keep half of an encoder's noise
        frames, noise = SmoothedFrames(frames), noise * 0.5
        level = median_of_nine([frames[k] for k in spread_frames(frames)])
    picks = pick_spread(range(len(frames)), 25)
    least = _least_contrast(noise)
    expected = camera.diameter_px / 2 if camera.knows_diameter else None
    smallest = max(MIN_BODY_AREA_PX, 0.25 * np.pi * expected**2) if expected else MIN_BODY_AREA_PX
    changed, counts = (cv2.absdiff(np.asarray(frames[k]), level) > math.floor(least) for k in picks), list[int]()
    for mask in changed:
        counts.append(int(np.count_nonzero(mask)))
        if counts[-1] > smallest and find_regions(mask, smallest):
            break
    else:
        if np.median(counts) <= MAX_FITTED:  # so few pixels hold no more specks
            return GLINTS, ""
        return _choose_for_glints([frames[k] for k in picks], level, least)
    level = estimate_still_background(frames, noise).level
    found = [find_round_bodies(np.asarray(frames[k]), level, least, expected)[:, 0] for k in picks]
    radii = np.concatenate(found)
    usual = float(np.median(radii)) if len(radii) else 0.0
    having = sum(bool(_of_common_size(r, usual).any()) for r in found)
    if having < max(0.2 * len(picks), 3):
        return GLINTS, ""
    return DISCS, (
        f"detector: discs, because the film shows balls as bodies of {2 * usual:.0f} px, not only their glints; "
        "--detector overrides this"
    )


def _choose_for_glints(sample: Sequence[Any], level: NDArray[Any], least: float) -> tuple[str, str]:
    """Maximum likelihood, or linear fits where a frame shows so many specks that it would take minutes."""
    bright = [cv2.subtract(np.asarray(picture), level) > math.floor(least) for picture in sample]
    # Each speck has a run of pixels in one line at least, and runs are counted much sooner.
    runs = [np.count_nonzero(spots[:, 1:] > spots[:, :-1]) + np.count_nonzero(spots[:, 0]) for spots in bright]
    if np.median(runs) <= MAX_FITTED:
        return GLINTS, ""
    specks = int(np.median([cv2.connectedComponents(spots.view(np.uint8))[0] - 1 for spots in bright]))
    crowded_share = 0.3  # of the pixels, from which on the light changes
    if specks <= MAX_FITTED or np.median([spots.mean() for spots in bright]) > crowded_share:
        return GLINTS, ""
    brightest = f"the {MAX_FOLLOWED} brightest of them are followed; " if specks > MAX_FOLLOWED else ""
    return MANY_GLINTS, (
        f"detector: {MANY_GLINTS}, because a frame shows {specks} bright specks, too many for {GLINTS}; "
        f"{brightest}--detector overrides this"
    )


def choose_channel(frames: Frames, camera: Camera, *, whole: bool = True) -> tuple[str, str]:
    """Choose the plane of a film in colour in which it shows its balls best, from 15 frames spread over it.

    A red ball on green cloth may be as grey as the cloth, and a moving shadow may hide a ball in grey. Each plane has a
    score: the number of round bodies of one size, times the share of the changed pixels that they cover. Shadows, hands
    and cues cover the rest. Grey is kept unless another plane has 1.5 times its score, or 1.2 times where bodies cover
    less than half of what changes in grey. That may still hide a ball. A plane in which shadows hardly show replaces it
    if it has 1.3 times as many bodies, less the changes of their number. Bodies that cover little of what changes, and
    whose number changes as that of independent events does, are noise. If the camera knows the diameter of its balls,
    only bodies of about that size count. The second result is a note with the reason; '' for grey that no plane rivals.
    A film in grey has the plane "contrast" besides.

    whole: whether the frames are the whole pictures. A part may show another plate than most of the picture, from which
    the plane "plate" is made.
    """
    longest_side_px = 960  # of the pictures that are compared
    min_score = 3.0  # least bodies in the 15 frames that another channel than grey must show
    more_bodies = 1.3  # at 1.3 or more, grey hides at least one of four balls
    picks = pick_spread(range(len(frames)), 15)
    shrink = min(1.0, longest_side_px / max(frames.shape[1:]))
    expected = shrink * camera.diameter_px / 2 if camera.knows_diameter else None
    if frames.colours is None:
        return _choose_between_tones(
            frames, lambda film: [_shrink(film[k], shrink) for k in picks], expected, min_score
        )
    colours = [_shrink(frames.colours(k), shrink) for k in picks]
    found = {GREY: _rate_plane([_shrink(frames[k], shrink) for k in picks], expected)}
    white = frames.white(colours)
    shares = [name for name in PLANES if name != PLATE]
    for name in (*CHANNELS[1:], *shares):
        make = read_plane(name, lambda: colours, white)
        found[name] = _rate_plane([make(picture) for picture in colours], expected)
    noisy = {name for name, rating in found.items() if name != GREY and rating.is_like_noise(len(picks))}
    rivals = found
    found = {name: rating for name, rating in rivals.items() if name not in noisy}
    most = max(rating.score for rating in found.values())
    best = next(name for name, rating in found.items() if rating.score >= 0.9 * most)  # the plainest of equals
    if most < min_score or most < (1.5 if found[GREY].share > 0.5 else 1.2) * found[GREY].score:
        best = GREY
    least = max(more_bodies * found[best].bodies, min_score)
    more = [name for name in shares if name in found and found[name].bodies - found[name].changes >= least]
    best = max(more, key=lambda name: found[name].score, default=best)
    plate = _count_on_plate(colours, white, 2 * expected if expected else None) if whole else BallsOnPlate()
    if plate.are_all and plate.total >= more_bodies * max(rating.bodies for rating in found.values()):
        return PLATE, (
            f"channel: {PLATE}, because it shows {plate.total} balls, some of which touch or always rest, and {best} "
            f"{found[best].describe()}; --channel overrides this"
        )
    if best == GREY:
        return GREY, _describe_noise(found[GREY], {name: rivals[name] for name in noisy}, min_score)
    hint = ", and --ball X,Y@FRAME points at a ball that only grey shows" if found[GREY].bodies else ""
    return best, (
        f"channel: {best}, because it shows {found[best].describe()}, and grey {found[GREY].describe()}; "
        f"--channel overrides this{hint}"
    )


def _choose_between_tones(
    frames: Frames, sample: Callable[[Frames], list[NDArray[Any]]], expected: float | None, min_score: float
) -> tuple[str, str]:
    """Choose the plane of a film in grey: "contrast" if it shows at least twice as many bodies as grey does."""
    if not shows_two_tones(frames):
        return GREY, ""
    grey, contrast = (_rate_plane(sample(film), expected) for film in (frames, frames.select_channel(CONTRAST)))
    if contrast.score < min_score or contrast.bodies < 2 * grey.bodies:
        return GREY, ""
    return CONTRAST, (
        f"channel: {CONTRAST}, because it shows {contrast.describe()}, and grey {grey.describe()}: bodies have a "
        "bright and a dark part. Shadows count as parts of them; --channel overrides this"
    )


def shows_two_tones(frames: Frames, min_share: float = 0.2) -> bool:
    """Decide whether much of a film in grey becomes brighter, and as much darker, by bodies or their shadows.

    min_share: of the pixels that are brighter among those that differ, or of the darker ones.
    """
    level, noise = sample_plate(frames)
    least, plate = _least_contrast(noise), level.astype(np.float32)
    for k in spread_frames(frames, 3):
        off = np.asarray(frames[k], np.float32) - plate
        fewer, more = sorted((np.count_nonzero(off > least), np.count_nonzero(off < -least)))
        if fewer < max(MIN_BODY_AREA_PX, min_share * (fewer + more)):
            return False
    return True


def _count_on_plate(colours: list[NDArray[Any]], white: float, diameter: float | None) -> BallsOnPlate:
    make = read_plane(PLATE, lambda: colours, white)
    return count_balls_on_plate([make(picture) for picture in colours], diameter)


@dataclass(frozen=True)
class _Rating:
    """How well a plane shows balls."""

    bodies: int  # round, of one size, on ground that was seen empty
    share: float  # of the pixels that differ from the background, which they cover
    changes: int = 0  # of their number from picture to picture, added up: balls stay, other bodies come and go

    @property
    def score(self) -> float:
        return self.bodies * self.share

    def is_like_noise(self, pictures: int) -> bool:
        """True if the bodies cover little of what changes, and their number changes as that of independent events.

        Balls beside an arm or a shadow cover little, too. Balls that start and stop change in number, too.
        """
        min_share, steady_share = 0.2, 0.6  # of what changes; of the changes of independent events
        mean = self.bodies / pictures
        # The mean difference of two Poisson numbers of equal mean (Skellam distribution)
        independent = (pictures - 1) * 2 * mean * (ive(0, 2 * mean) + ive(1, 2 * mean))
        return bool(self.share < min_share and self.changes > steady_share * independent)

    def describe(self) -> str:
        return f"{self.bodies} round bodies ({100 * self.share:.0f} % of what changes)"


def _describe_noise(grey: _Rating, noisy: dict[str, _Rating], min_score: float) -> str:
    """Say which plane shows more bodies than grey, but among so much else that they are noise; '' if none does."""
    name = max(noisy, key=lambda name: noisy[name].bodies, default="")
    if not name or noisy[name].score < max(min_score, 1.2 * grey.score):
        return ""
    return (
        f"channel: {GREY}, because {name} shows {noisy[name].describe()}, which noise does too, and {GREY} "
        f"{grey.describe()}; --channel, --colour or --ball X,Y@FRAME say how the balls show"
    )


def _rate_plane(pictures: list[NDArray[Any]], expected: float | None) -> _Rating:
    """Rate a plane by its pictures, at the threshold that suits it best: 1, 2, 4 or 8 times the least contrast."""
    max_threshold_counts = 120  # balls of more contrast show at a lower threshold too
    noise = estimate_pixel_noise(pictures)
    ground = estimate_still_background(pictures, noise)
    level, best = ground.level.astype(np.float32), _Rating(0, 0.0)
    for least in (_least_contrast(noise) * times for times in (1, 2, 4, 8)):
        if least > max_threshold_counts:
            break
        found, changed = [np.empty((0, 3))], 0
        for picture in pictures:
            bodies = find_round_bodies(picture, level, least, expected)
            column, row = np.round(bodies[:, 1:].T).astype(int)
            contrast = picture[row, column] - level[row, column]
            reach = np.round(bodies[:, 0]).astype(int)
            empty = [ground.was_seen_around(*at) for at in zip(column, row, reach, strict=True)]
            seen = [known and _differs_from_ring(picture, b, least) for known, b in zip(empty, bodies, strict=True)]
            found.append(bodies[np.array(seen, bool) & ~_are_shadows(bodies, contrast)])
            changed += int(((cv2.absdiff(picture.astype(np.float32), level) > least) & ground.known).sum())
        radii = np.concatenate(found)[:, 0]
        usual = float(np.median(radii)) if len(radii) else 0.0
        same = radii[_of_common_size(radii, usual)]
        counts = [int(_of_common_size(bodies[:, 0], usual).sum()) for bodies in found[1:]]
        share = min(float(np.pi * (same**2).sum()) / max(changed, 1), 1.0)
        rating = _Rating(len(same), share, int(np.abs(np.diff(counts)).sum()))
        best = max(best, rating, key=lambda r: r.score)
    return best


def _differs_from_ring(picture: NDArray[Any], body: Array, least: float) -> bool:
    """True if a body (3,) differs from the ring around it in its picture; else the background shows a ball there."""
    radius, x, y = body
    reach = int(1.8 * radius) + 1
    top, left = max(round(y) - reach, 0), max(round(x) - reach, 0)
    part = picture[top : round(y) + reach + 1, left : round(x) + reach + 1].astype(np.float32)
    rows, columns = np.mgrid[top : top + part.shape[0], left : left + part.shape[1]]
    away = np.hypot(columns - x, rows - y) / radius
    inside, ring = part[away < 0.7], part[(away > 1.3) & (away < 1.8)]
    return len(inside) > 0 and len(ring) > 0 and abs(float(np.median(inside)) - float(np.median(ring))) > least / 2


def _are_shadows(bodies: Array, contrast: Array) -> Flags:
    """Which bodies (n, 3) lie within three radii of one that differs more from the background, to the other side."""
    away = np.hypot(*(bodies[:, None, 1:] - bodies[None, :, 1:]).transpose(2, 0, 1))
    other = contrast[:, None] * contrast < 0
    weaker = np.abs(contrast)[:, None] < np.abs(contrast)
    return np.asarray((other & weaker & (away < 3 * bodies[:, 0])).any(axis=1))


def _shrink(picture: NDArray[Any], times: float) -> NDArray[Any]:
    if times == 1:
        return np.array(picture)
    return np.asarray(cv2.resize(np.ascontiguousarray(picture), None, fx=times, fy=times, interpolation=cv2.INTER_AREA))


def select_channel(clip: Recording, name: str | None) -> tuple[Recording, str]:
    """Return the recording in the channel ``name``, or in the one that suits it, and a note why. Raises InputError."""
    if name is not None:
        return clip.select_channel(name), ""
    if clip.balls:
        best, why = choose_channel_by_examples(clip)
    else:
        best, why = choose_channel(sample_frames(clip), clip.camera, whole=clip.area is None)
    return clip.select_channel(best), why


def find_radius(clip: Recording) -> float | None:
    """Choose the radius, px, of balls that the user points at: the median of those given or seen; None without one."""
    radii = [ball.radius for ball in clip.balls if ball.radius]
    for ball in (ball for ball in clip.balls if not ball.radius):
        profile = _profile(clip.frames[_row(clip, ball)], ball)
        change = np.abs(profile - profile[0])
        if change.max() > 0:  # it ends where its light has changed by half
            radii.append(float(np.argmax(change > change.max() / 2)) + CORE_PX)
    return float(np.median(radii)) if radii else None


def choose_channel_by_examples(clip: Recording) -> tuple[str, str]:
    """Choose the plane in which the balls that the user points at differ most from their surroundings.

    The difference is relative to the 99th percentile of what else changes in the plane, such as a shadow. The second
    result is a note; '' for grey.
    """
    frames = clip.frames
    if frames.colours is None:
        return GREY, ""
    sample = [np.asarray(frames.colours(k)) for k in spread_frames(frames)]
    own = [np.asarray(frames.colours(_row(clip, ball))) for ball in clip.balls]
    white, contrast = frames.white(sample), dict[str, float]()
    grey = np.array((0.299, 0.587, 0.114))
    for name in (*CHANNELS, *(plane for plane in PLANES if plane != PLATE)):
        read = (lambda p: p[..., :3] @ grey) if name == GREY else read_plane(name, lambda: sample, white)
        planes = np.array([read(picture) for picture in sample], np.float32)
        clutter = float(np.percentile(np.abs(planes - np.median(planes, axis=0)), 99)) + 1.0
        profiles = [_profile(read(picture), ball) for picture, ball in zip(own, clip.balls, strict=True)]
        contrast[name] = min(float(np.abs(p - p[0]).max()) for p in profiles) / clutter
    best = max(contrast, key=lambda name: contrast[name])
    if contrast[best] < 1.2 * contrast[GREY]:
        return GREY, ""
    return best, (
        f"channel: {best}, because the balls of --ball differ there by {contrast[best]:.1f} times what else changes, "
        f"and in grey by {contrast[GREY]:.1f} times; --channel overrides this"
    )


def _row(clip: Recording, ball: BallExample) -> int:
    return int(np.searchsorted(clip.frames.numbers, ball.frame))


def _profile(picture: NDArray[Any], ball: BallExample) -> Array:
    """Median of a plane by distance from a ball's middle, in steps of a pixel, the first out to `CORE_PX`."""
    height, width = picture.shape
    reach = int(2 * ball.radius if ball.radius else min(height, width) / 4)
    rows, columns = np.mgrid[:height, :width]
    away = np.hypot(columns - ball.x, rows - ball.y)
    steps = [picture[away <= CORE_PX]]
    steps += [picture[(away > r) & (away <= r + 1)] for r in CORE_PX + np.arange(max(reach, 3))]
    return np.array([np.median(step) if len(step) else np.nan for step in steps if len(step)], float)


def name_channel(channel: str | None, colour: str) -> str | None:
    """The channel that a user asks for, by its name or by the colour of the balls. Raises InputError."""
    if not colour:
        return channel
    if channel is not None:
        raise InputError("--colour, --channel: expected one of the two")
    return parse_colour(colour)


def sample_frames(clip: Recording) -> Frames:
    """Return the frames from which a detector is chosen, cut to the area of the search."""
    return clip.frames if clip.area is None else clip.frames.crop(clip.area)


class SmoothedFrames(Sequence[Any]):
    """The frames of a film, each as the means of 3 x 3 of its pixels."""

    def __init__(self, frames: Sequence[Any]) -> None:
        self.frames = frames

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, k: Any) -> Any:
        return cv2.blur(np.asarray(self.frames[k]), (3, 3))


def _least_contrast(noise: float) -> float:
    """Counts by which a body differs from the plate at least: 8, and 8 standard deviations of the noise."""
    return max(8.0 * noise, 8.0)


def _of_common_size(radii: Array, usual: float) -> Flags:
    return np.asarray(np.abs(radii - usual) < 0.25 * usual)


def find_round_bodies(frame: NDArray[Any], level: NDArray[Any], least: float, expected: float | None) -> Array:
    """Find round bodies in one frame, to choose a detector: radius, x and y (n, 3), px; they differ by `least` counts.

    `expected` is the radius of the balls, px, where the camera file gives it.
    """
    max_regions = 40  # the largest ones are examined
    low, high = 0.8, 1.25  # of the radius over the expected one; a glint out of focus is smaller than its ball
    min_radius_px = 4.0  # where none is expected; a clipped glint looks like a small disc
    rounding = 0.5  # counts, of the level
    rough = cv2.absdiff(frame, np.rint(level).astype(frame.dtype)) > math.floor(least - rounding)
    found = []
    for region in find_regions(
        rough, MIN_BODY_AREA_PX - 1, lambda at: np.abs(np.subtract(frame[at], level[at], dtype=np.float32)) > least
    )[:max_regions]:
        whole = np.subtract(frame[region.at], level[region.at], dtype=np.float32)
        for own in _separate_discs(region.own):
            radius, x, y = _measure_body(whole, own, least)
            if radius > min_radius_px if expected is None else low < radius / expected < high:
                found.append((radius, region.left + x, region.top + y))
    return np.array(found).reshape(-1, 3)


def _separate_discs(own: Flags) -> list[Flags]:
    """The pixels of the discs in a region (h, w): several that touch, itself if it is round, or none."""
    min_roundness = 0.6  # area of a round region over that of the circle around it
    radius, centres = find_touching_discs(own)
    if not centres:
        return [own] if own.sum() >= min_roundness * np.pi / 4 * max(own.shape) ** 2 else []
    y, x = np.ogrid[: own.shape[0], : own.shape[1]]
    return [own & (np.hypot(x - column, y - row) <= radius) for column, row in centres]


def _measure_body(whole: NDArray[np.float32], own: Flags, least: float) -> tuple[float, float, float]:
    """Radius and middle (x, y), px, of a body from differences from the background (h, w); radius 0 of a glint."""
    max_glint_ratio = 4.0  # contrast of the brightest spot over that halfway out; of steel only the glint is bright
    min_steepness = 0.4  # pixels over 4/5 of the contrast among those over 1/5; discs have edges, glints fade
    area, (rows, columns) = int(own.sum()), np.nonzero(own)
    y, x = np.ogrid[: own.shape[0], : own.shape[1]]
    away = np.hypot(x - columns.mean(), y - rows.mean()) / np.sqrt(area / np.pi)
    over, ring = whole[own], whole[(away > 0.5) & (away < 0.8)]
    if len(ring) == 0:
        return 0.0, 0.0, 0.0
    body = float(np.median(ring))
    steep = (np.abs(over) > 0.8 * abs(body)).sum() / (np.abs(over) > 0.2 * abs(body)).sum()
    spot = float(whole[away < 0.9].max())
    glint = spot > max(least, abs(body) * max_glint_ratio) or (body < 0 and spot > least)
    solid = not glint and steep > min_steepness
    radius = np.sqrt((np.abs(over) > abs(body) / 2).sum() / np.pi) if solid else 0.0
    return float(radius), float(columns.mean()), float(rows.mean())
