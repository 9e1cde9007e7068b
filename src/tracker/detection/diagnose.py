"""Explains why a clip shows no ball that can be tracked, with what to change; warns of a moving camera."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from synthcam_shared.arrays import Flags
from tracker.camera.camera_keys import DARK
from tracker.camera.film_options import BallExample
from tracker.camera.frames import GREY, pick_spread, spread_frames
from tracker.detection.candidates import CandidateSearch, EmptyPlate
from tracker.detection.detector import View
from tracker.detection.glints import Glints, PositionFlag
from tracker.detection.link import Tracks

MIN_DETECTIONS = 6  # in a clip; with fewer there is a reason to explain
RIM_SHARE = 0.06  # of the picture's longer side: so wide is the rim at which balls come in and leave
STILL_CAMERA = "balls are found before a still background: --frames A:B takes a part in which the camera stands still"


def explain_no_glints(frames: Sequence[Any], view: View, glints: Glints) -> str:
    """The reason in one line why a clip shows too few glints; '' where there are enough."""
    still = np.array_equal(frames[0], frames[-1])
    if len(glints) >= MIN_DETECTIONS and not still:
        return ""
    sample = [np.array(frames[k]) for k in spread_frames(frames)]
    level, noise = view.plate.level, view.plate.noise
    if np.mean([np.mean(s >= view.camera.sensor.ceiling) for s in sample]) > 0.5:  # of the pixels
        return "overexposed: most of the picture is at the sensor's limit"
    if all(np.array_equal(s, sample[0]) for s in sample):
        return "nothing moves: all frames are the same picture"
    if len(glints) >= MIN_DETECTIONS:
        return ""
    search = CandidateSearch(view.plate, view.sigma, max(4.0, 0.8 * view.camera.diameter_px), view.settings.detection)
    crowded = sum(search(s).crowded for s in sample) > len(sample) // 2
    flicker = np.ptp([np.median(s) for s in sample])
    least = view.settings.detection.disc_contrast_counts
    if crowded and flicker <= 5.0 and not _differ(sample, least):  # a codec's blocks flicker by a few counts
        return f"nothing moves: nothing differs from the background by {least:g} counts"
    if crowded or flicker > 5.0:  # counts
        return "the light changes: most of the picture is brighter than the plate"
    if any(_shows_dark_ball(s, level, noise, view.camera.diameter_px) for s in sample):
        return (
            "dark balls on a bright ground: a glint brighter than the plate is needed; --detector discs follows dark "
            "bodies"
        )
    if len(glints):
        return f"too few detections: {len(glints)} glints in {len(frames)} frames"
    return "no balls: nothing is brighter than the plate"


def _differ(sample: Sequence[NDArray[Any]], least: float) -> bool:
    """Decide whether a pixel of any picture differs from the median of all by `least` counts."""
    level = np.median(np.array(sample), axis=0)
    return any(float(np.abs(picture - level).max()) > least for picture in sample)


def explain_no_discs(frames: Sequence[Any], view: View) -> str:
    """The reason in one line why a film shows no disc that moves on a still background."""
    sample = [np.asarray(frames[k]).astype(np.float32) for k in spread_frames(frames)]
    if all(np.array_equal(s, sample[0]) for s in sample):
        return "nothing moves: all frames are the same picture"
    level = np.median(np.array(sample), axis=0).astype(np.float32)
    least = view.settings.detection.disc_contrast_counts
    apart = [(cv2.absdiff(s, level) > max(4.0 * view.plate.noise, least)).view(np.uint8) for s in sample]
    shift = measure_camera_motion(sample)
    share = float(np.median(np.array([float(a.mean()) for a in apart])))
    if share > 0.03 and shift > 1.0:  # px, while balls alone change less than 3 % of the pixels
        return f"no still background: the camera moves, by up to {shift:.0f} px; {STILL_CAMERA}"
    if share > 0.3:
        return "no still background: the light changes, or most of the picture moves"
    areas = [cv2.connectedComponentsWithStats(a, connectivity=4)[2][1:, cv2.CC_STAT_AREA] for a in apart]
    largest = max((int(a.max()) for a in areas if len(a)), default=0)
    smallest, most = 28, view.settings.detection.max_objects_per_frame  # 28 px are a disc 6 px across
    if largest == 0:
        return f"nothing moves: nothing differs from the background by {least:g} counts"
    if largest < smallest:
        return f"too small: what moves covers {largest} pixels at most, expected balls of 6 px across at least"
    if np.median([np.sum(a > smallest) for a in areas]) > most:
        return f"too many: over {most} things differ from the background in most frames"
    return "nothing round moves on a still background"


def explain_no_paths(frames: int) -> str:
    """The reason why balls that are found in this number of frames make no track; '' of fewer than 10 frames."""
    if frames < 10:
        return ""
    return f"no path: {frames} frames show what may be a ball, but its steps from frame to frame are those of no ball"


def measure_camera_motion(pictures: Sequence[NDArray[Any]]) -> float:
    """Measure the largest motion of the background from the first of these pictures, px; 0 where none is seen.

    Features of each picture are followed into the next one. Most of them must agree on one shift, turn and change of
    size. They must also be spread over the picture, because balls, hands and shadows move too.
    """
    min_features = 20
    min_share = 0.5  # of the features that are followed, which must agree within 1 px
    min_spread = 0.12  # of the picture's width and height, over which four fifths of those must be spread
    shown = [_to_bytes(picture) for picture in pictures]
    height, width = shown[0].shape
    first: Any = None
    here: Any = None
    largest = 0.0
    for one, other in pairwise(shown):
        points = cv2.goodFeaturesToTrack(one, maxCorners=300, qualityLevel=0.01, minDistance=8)
        if points is None or len(points) < min_features:
            break
        moved, seen, _ = cv2.calcOpticalFlowPyrLK(one, other, points, np.empty_like(points), maxLevel=4)
        kept = seen[:, 0] == 1
        if kept.sum() < min_features:
            break
        change, agree = cv2.estimateAffinePartial2D(points[kept], moved[kept], ransacReprojThreshold=1.0)
        if change is None or agree.mean() < min_share:
            break
        low, high = np.quantile(points[kept][agree[:, 0] == 1, 0], (0.1, 0.9), axis=0)
        if (high - low < min_spread * np.array([width, height])).any():
            break
        if first is None:
            first = here = np.array([[(x, y) for x in (low[0], high[0]) for y in (low[1], high[1])]])
        here = cv2.transform(here, change)
        largest = max(largest, float(np.median(np.hypot(*(here - first)[0].T))))
    return largest


def _to_bytes(picture: NDArray[Any]) -> NDArray[np.uint8]:
    """A picture with its range spread over 8 bits."""
    low, high = float(np.min(picture)), float(np.max(picture))
    return np.asarray((np.asarray(picture, np.float32) - low) * (255.0 / max(high - low, 1.0))).astype(np.uint8)


def warn_of_moving_camera(frames: Sequence[Any]) -> tuple[str, ...]:
    """Warn where the background moves by 3 px or more between frames spread over a film."""
    min_motion_px = 3.0
    shift = measure_camera_motion([np.asarray(frames[k]) for k in spread_frames(frames, 25)])
    return (f"the camera moves, by up to {shift:.0f} px: {STILL_CAMERA}",) if shift >= min_motion_px else ()


def describe_other_specks(frames: Sequence[Any], plate: EmptyPlate, channel: str) -> tuple[str, ...]:
    """Say that a film shows as many dark specks as bright ones, which a detector of glints leaves out.

    A speck has the area of the bright ones, within a factor of 4. So the dark side of a steel ball is too large, and
    so is its shadow.
    """
    fewest, sample_count = 10, 5  # specks in a frame; frames that are looked at
    sizes, least = 4.0, max(8.0 * plate.noise, 8.0)  # ratio of areas; counts
    if channel not in (GREY, DARK):
        return ()
    counts = []
    for k in pick_spread(range(len(frames)), sample_count):
        picture, bright, dark = np.asarray(frames[k]), np.empty(0), np.empty(0)
        if np.count_nonzero(cv2.subtract(plate.level, picture) > least) >= 2 * fewest:
            bright, dark = (_measure_areas(cv2.subtract(*pair) > least) for pair in _both_ways(picture, plate.level))
        usual = float(np.median(bright)) if len(bright) else 0.0
        counts.append((len(bright), int(((dark > usual / sizes) & (dark < sizes * usual)).sum())))
    own_count, other_count = np.median(counts, axis=0)
    if other_count < max(fewest, own_count):
        return ()
    own, other, how = ("bright", "dark", f"--channel {DARK} follows these")
    if channel == DARK:
        own, other, how = other, own, f"without --channel {DARK} these are followed"
    return (f"specks: {own} ones are followed, and some {other_count:.0f} {other} ones in a frame are left out; {how}",)


def _both_ways(one: NDArray[Any], other: NDArray[Any]) -> tuple[tuple[NDArray[Any], NDArray[Any]], ...]:
    return (one, other), (other, one)


def _measure_areas(spots: NDArray[Any]) -> NDArray[Any]:
    """Areas (n,), px^2, of the connected regions of more than one pixel."""
    areas = cv2.connectedComponentsWithStats(np.asarray(spots).view(np.uint8))[2][1:, cv2.CC_STAT_AREA]
    return np.asarray(areas[areas > 1])


def warn_of_missed_examples(tracks: Tracks, examples: Sequence[BallExample], view: View) -> tuple[str, ...]:
    """Explain, as a warning, that no track passes the balls that the user points at."""
    notes = []
    for ball in examples:
        within = ball.radius or view.radius or view.camera.diameter_px / 2
        rows = tracks.frame == ball.frame
        away = np.hypot(tracks.x[rows] - ball.x, tracks.y[rows] - ball.y)
        if len(away) and away.min() <= within:
            continue
        near = f"the nearest is {away.min():.0f} px away" if len(away) else "none is followed in that frame"
        notes.append(
            f"--ball {ball.x:g},{ball.y:g}@{ball.frame}: no ball is followed within {within:.0f} px of it, {near}; try "
            "another frame, its radius (X,Y,R@FRAME), or --colour"
        )
    return tuple(notes)


def warn_of_exchanges(tracks: Tracks) -> tuple[str, ...]:
    """Name, as warnings, the balls whose tracks may be those of other balls, and the frames from which on.

    Two in one frame may have exchanged their numbers. One alone turned back unseen at the edge of the picture.
    """
    doubtful = np.array([PositionFlag.EXCHANGE.word in flags.split("|") for flags in tracks.flags.tolist()], dtype=bool)
    frame, particle = tracks.frame[doubtful], tracks.particle[doubtful]
    balls = {k: sorted(particle[frame == k].tolist()) for k in np.unique(frame).tolist()}
    exchanged = {k: own for k, own in balls.items() if len(own) > 1}
    turned = {k: own for k, own in balls.items() if len(own) == 1}
    where, notes = f"({PositionFlag.EXCHANGE.word} in column flags of tracks); compare overlay.mp4, and", []
    if exchanged:
        notes.append(
            f"balls may have exchanged their numbers in {len(exchanged)} frame{'s' * (len(exchanged) > 1)}, because "
            f"other links are nearly as likely there: {_name_balls(exchanged)} {where} exchange numbers back by --edits"
        )
    if turned:
        notes.append(
            "a ball may have left the picture and another one entered under its number, because no wall is seen where "
            f"it turned back: {_name_balls(turned)} {where} cut the track by --edits"
        )
    return tuple(notes)


def _name_balls(balls: dict[int, list[int]]) -> str:
    most = 5  # frames that are named
    named = [f"{' and '.join(map(str, own))} in frame {k}" for k, own in list(balls.items())[:most]]
    return ", ".join(named) + (f" and {len(balls) - most} more" if len(balls) > most else "")


@dataclass(frozen=True)
class LooseEnds:
    """Ends of tracks inside the picture and a take, where no ball comes in or leaves."""

    count: int
    ends: int  # of all tracks
    resumed: int  # tracks that begin where another ended shortly before

    HINT_AT_BODIES: ClassVar[str] = "; bright specks are followed, --detector discs follows bodies, dark ones too"
    NO_BODIES: ClassVar[str] = "; bright specks are followed; --detector discs was tried, and follows no body for long"

    @property
    def are_most(self) -> bool:
        return self.count >= max(4, 0.5 * self.ends)

    def describe(self) -> str:
        return (
            f"{self.count} of the {self.ends} ends of tracks lie inside the picture, where no ball comes in or leaves"
        )

    def warn(self, hint: str = "", *, lossy: bool = False) -> tuple[str, ...]:
        """Explain, as a warning that ends with the hint, that most tracks have such ends, or are pieces of a ball.

        lossy: the video was encoded with loss, which blurs small glints and leaves specks in their place.
        """
        begin = "tracks begin" if self.resumed > 1 else "track begins"
        pieces = f"{self.resumed} {begin} where another ended shortly before: they may be pieces of one ball that was"
        joins = "`link: {max_gap_frames: 20}` in a file behind --settings joins longer gaps"
        if not self.are_most:
            return (f"{pieces} hidden or hit; an edit gives them one number (--edits)",) if self.resumed else ()
        text = "the tracks may be reflections or specks, or more objects than the tracker can distinguish"
        if 4 * self.resumed >= self.count:  # half of the loose ends
            text = f"{pieces} hidden; {joins}"
        if lossy:
            text += "; the compression of the video may be the cause: film without it, or with less"
        return (f"{self.describe()}: {text}{hint}",)


def count_loose_ends(tracks: Tracks, size: tuple[int, int], spans: Sequence[tuple[int, int]]) -> LooseEnds:
    """Count the ends of tracks that lie inside the picture and a take.

    Ends at the picture's rim count as well if their track stays there: what flickers in one position does not come in
    from outside. `size` is the width and height of the picture, px; `spans` are the first and last frames of the takes.
    """
    rows = [np.flatnonzero(tracks.particle == one) for one in np.unique(tracks.particle)]
    ends = np.array([r[[tracks.frame[r].argmin(), tracks.frame[r].argmax()]] for r in rows], dtype=int).ravel()
    x, y, frame = tracks.x[ends], tracks.y[ends], tracks.frame[ends]
    travel = np.array([max(np.ptp(tracks.x[r]), np.ptp(tracks.y[r])) for r in rows])
    rim_px = RIM_SHARE * max(size)
    rim = np.minimum.reduce([x, y, size[0] - 1 - x, size[1] - 1 - y]) < rim_px
    rim &= np.repeat(travel, 2) > rim_px
    cut = np.abs(frame[:, None] - np.array(spans).ravel()).min(axis=1) <= 2  # frames
    loose = ~(rim | cut)
    found = LooseEnds(int(loose.sum()), len(ends), 0)
    return replace(found, resumed=_count_resumed(tracks, rows, loose, rim_px))


def follow_bodies(tracks: Tracks, size: tuple[int, int]) -> bool:
    """Decide whether tracks of outlines follow moving bodies, rather than what changes in one place.

    Half of all positions must be in tracks that lead over `RIM_SHARE` of the picture's longer side.
    """
    min_positions = 10  # of such a track
    min_straight = 0.2  # distance of its ends over the length of the path between them, which noise makes longer
    followed = 0
    for particle in np.unique(tracks.particle):
        own = np.flatnonzero(tracks.particle == particle)
        xy = tracks.xy[own[np.argsort(tracks.frame[own], kind="stable")]]
        net, path = np.hypot(*(xy[-1] - xy[0])), np.hypot(*np.diff(xy, axis=0).T).sum()
        followed += len(own) * (len(own) >= min_positions and net >= max(RIM_SHARE * max(size), min_straight * path))
    return len(tracks) > 0 and bool(followed >= 0.5 * len(tracks))


def _count_resumed(tracks: Tracks, rows: list[NDArray[np.intp]], loose: Flags, reach: float) -> int:
    """Loose ends of tracks that another track's loose beginning continues, within 40 frames and `reach` px.

    rows: of each track; loose: whether its first and its last position are so, one after the other.
    """
    longest, count = 40, 0
    ordered = [own[np.argsort(tracks.frame[own], kind="stable")] for own in rows]
    begins = [own[0] for k, own in enumerate(ordered) if loose[2 * k]]
    for k, own in enumerate(ordered):
        if not loose[2 * k + 1]:
            continue
        near = own[-5:]
        time = max(int(tracks.frame[near[-1]] - tracks.frame[near[0]]), 1)
        speed = (tracks.xy[near[-1]] - tracks.xy[near[0]]) / time
        for begin in begins:
            gap = int(tracks.frame[begin] - tracks.frame[near[-1]])
            if 0 < gap <= longest:
                miss = tracks.xy[begin] - tracks.xy[near[-1]]
                # the ball may go on as before, or stop
                off = min(float(np.hypot(*miss)), float(np.hypot(*(miss - gap * speed))))
                if off <= reach:
                    count += 1
                    begins.remove(begin)
                    break
    return count


def _shows_dark_ball(frame: Any, level: Any, noise: float, diameter: float) -> bool:
    """True if a region of about a ball's size is darker than the plate, by 6 standard deviations of 5 x 5 means."""
    lack = cv2.blur(cv2.subtract(level, frame, dtype=cv2.CV_32F), (5, 5))
    dark = int(np.count_nonzero(lack > 6.0 * noise / 5.0 + 1.0))
    return dark > 0.15 * diameter**2
