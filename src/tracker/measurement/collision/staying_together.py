"""Balls that meet and stay together, such as discs with tape: their restitution is zero."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from synthcam_shared.arrays import Array, Index, Ints
from tracker.measurement.collision.collision_model import GRAVITY
from tracker.measurement.collision.contacts import fit_velocity
from tracker.measurement.positions import BallTrack, measure_separation
from tracker.measurement.stretch_cuts import CUTTER

MAX_DISTANCE = 1.02  # diameters


@dataclass(frozen=True, eq=False)
class StayingPair:
    """Two balls that stay together; ball 2 is the faster before."""

    struck: BallTrack
    striker: BallTrack
    first: int  # frame in which they are together
    last: int
    time: float  # s, of the first touch
    speed: float  # m/s, relative, before the touch
    speed_std: float
    offset: float  # impact parameter over the diameter
    offset_std: float
    r_std: float  # of the restitution, which is 0
    bounces: bool  # whether they part first or in the end, so that this is no restitution


def find_staying_pairs(a: BallTrack, b: BallTrack, diameter: float, *, may_roll: bool = True) -> Iterator[StayingPair]:
    """Find where two balls meet and then keep their distance of about a diameter (m).

    may_roll: friction may bring them back after a bounce, as it does with balls that roll. The error of r then contains
    the bounce that the noise may hide.
    """
    usual_friction = 0.2  # of balls that slide on a plate
    max_speed_share = 0.03  # speed at which balls that stay together may move apart, over the closing speed
    min_frames = 10  # for which they stay together
    # Standard errors of that speed from which on the balls part, as rolling ones do that touch twice. In 20 simulated
    # and 6 real pairs with tape it was at most 2.5.
    parting_sigma = 5.0
    frames, apart, mine, _ = measure_separation(a, b)
    if len(frames) < min_frames:
        return
    time = a.time[mine]
    noise = float(np.sqrt(np.trace(np.median(a.cov, axis=0) + np.median(b.cov, axis=0)) / 2))
    depth = max((MAX_DISTANCE - 1) * diameter, diameter - float(apart.min()))  # tape swings out as far as in
    near = apart < diameter + depth + 3 * noise
    edges = np.flatnonzero(np.diff(np.concatenate([[0], near.astype(np.int8), [0]])))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        approach = _find_approach((a, b), frames, apart, begin, noise) if end - begin >= min_frames else None
        if approach is None:
            continue
        early, closing = approach
        late = np.arange((begin + end) // 2, end)
        parts = [fit_slope(time[rows], apart[rows], noise) for rows in (late, late[len(late) // 2 :])]
        limit = max_speed_share * abs(closing)
        if any(std > limit or abs(v) > max(3 * std, limit) for v, std in parts):
            continue
        inside = begin + int(np.argmax(apart[begin:end] < diameter))
        lines = [(track, *fit_velocity(track.where(np.isin(track.frame, frames[early])))) for track in (a, b)]
        (struck, v1, x1, s1), (striker, v2, x2, s2) = sorted(lines, key=lambda line: float(np.hypot(*line[1])))
        launch, gap = v2 - v1, x1 - x2
        speed = float(np.hypot(*launch))
        offset = float(launch[1] * gap[0] - launch[0] * gap[1]) / (speed * diameter)
        speed_std = float(np.hypot(s1, s2))
        drift, drift_std = parts[0]
        excess = apart[inside:end] - diameter
        parting = measure_first_parting(excess, noise) / float(np.median(np.diff(time)))
        back = 2 * usual_friction * GRAVITY if may_roll else 0.0  # the striker gets faster, and the struck ball slower
        hidden = float(np.sqrt(2 * back * limit_hidden_bounce(excess, noise)))
        leave = all(v > parting_sigma * std for v, std in parts)
        yield StayingPair(
            struck=struck,
            striker=striker,
            first=int(frames[inside]),
            last=int(frames[end - 1]),
            time=float(time[early].mean() + (apart[early].mean() - diameter) / abs(closing)),
            speed=speed,
            speed_std=speed_std,
            offset=offset,
            offset_std=float(np.hypot(noise / np.sqrt(len(early)), speed_std / speed * np.hypot(*gap)) / diameter),
            r_std=float(np.linalg.norm([drift, drift_std, parting, hidden]) / abs(closing)),
            bounces=leave or parting > limit or leave_contact(excess, noise, diameter),
        )


def _find_approach(
    tracks: Sequence[BallTrack], frames: Ints, apart: Array, begin: int, noise: float
) -> tuple[Index, float] | None:
    """Rows (n,) before a touch that show an approach, as few as do, and the rate of the separation, m/s, under 0.

    frames (n,), apart (n,): those in which both balls are seen, and their distances, m. Rows up to the last kink of
    either ball, such as a hit at a wall or by a cue, do not count.
    """
    least_sigma, min_frames = 5.0, 3
    if begin < min_frames:
        return None
    time = tracks[0].time[np.isin(tracks[0].frame, frames)]
    since = max(_find_last_kink(track.where(np.isin(track.frame, frames[:begin]))) for track in tracks)
    first = int(np.searchsorted(time, since, side="right"))
    for count in (8, 16, 32):
        early = np.arange(max(begin - count, first), begin)
        if len(early) < min_frames:
            return None
        closing, std = fit_slope(time[early], apart[early], noise)
        if closing < -least_sigma * std:
            return early, closing
    return None


def _find_last_kink(track: BallTrack) -> float:
    """Find when the path of a ball before a touch kinks last, s, with the margin of a kink; -inf if it does not."""
    longest_history = 64  # positions
    track = track.where(np.arange(len(track)) >= len(track) - longest_history)
    noise, found = float(np.sqrt(np.trace(np.median(track.cov, axis=0)) / 2)), [-np.inf]
    for positions in (4, 8, 16):  # the more, the smaller the kinks that noise does not hide
        cutter = replace(CUTTER, kink_positions=positions, kink_sigma=5.0)
        kinks = cutter.find_kinks(track.time, cutter.measure_kinks(track.time, track.position, noise))
        found += [time + cutter.margin_frames * float(np.median(np.diff(track.time))) for time in kinks]
    return max(found)


def measure_first_parting(excess: Array, noise: float) -> float:
    """Measure how fast balls that end up staying together part first, as rolling ones of r near .4 do, m per frame.

    Tape swings out for as long as the balls were nearer than a diameter. Plate friction takes longer to stop balls that
    part, and their separation grows all the while. It is 0 if the separation only swings, or grows no more than the
    noise. excess: of the separation over the diameter from the touch on, m.
    """
    smoothed_frames = 5  # over which the separation is averaged
    mean = np.convolve(excess, np.ones(3) / 3, "valid")
    within = int(np.argmax(mean > 0)) if (mean > 0).any() else len(mean)
    outside = excess[within:]
    if len(outside) < smoothed_frames:
        return 0.0
    smooth = np.convolve(outside, np.ones(smoothed_frames) / smoothed_frames, "valid")
    swing = int(np.argmax(smooth < 0)) if (smooth < 0).any() else len(outside)
    first = max(3, within)
    if swing <= 2 * within + 3 or len(outside) <= first:
        return 0.0
    rises = smooth[: max(swing, 1)] - outside[:first].mean()
    rise = float(rises.max())
    if not rise > 4 * noise * np.sqrt(1 / smoothed_frames + 1 / first):
        return 0.0
    return rise / (1 + int(np.argmax(rises > 0.9 * rise)))  # later frames may only be noise


def limit_hidden_bounce(excess: Array, noise: float) -> float:
    """Measure how far apart a bounce may have taken the balls, m: further than tape swings, or by as much as the noise.

    excess: as for `measure_first_parting`.
    """
    smoothed_frames = min(5, len(excess))
    smooth = np.convolve(excess, np.ones(smoothed_frames) / smoothed_frames, "valid")
    farthest = int(np.argmax(smooth))
    seen = smooth[farthest] + smooth[: farthest + 1].min()
    return max(float(seen), 0.0) + noise / float(np.sqrt(smoothed_frames))


def leave_contact(excess: Array, noise: float, diameter: float) -> bool:
    """Decide whether balls lie apart in the end, or swing out by more than they were nearer, as no tape does.

    excess: as for `measure_first_parting`.
    """
    smoothed_frames = 5  # over which the separation is averaged
    largest_fault = 0.005  # of the given diameter, as a share
    late = excess[len(excess) // 2 :]
    if late.mean() > max(largest_fault * diameter, 5 * noise / np.sqrt(len(late))):
        return True
    if len(excess) < smoothed_frames:
        return False
    smooth = np.convolve(excess, np.ones(smoothed_frames) / smoothed_frames, "valid")
    farthest = int(np.argmax(smooth))
    return bool(smooth[farthest] + excess[: farthest + 1].min() > 4 * noise / np.sqrt(smoothed_frames))


def fit_slope(time: Array, apart: Array, noise: float) -> tuple[float, float]:
    """Fit a straight line to distances (n,), m, of balls near a contact: slope, and its error by noise or scatter."""
    t = time - time.mean()
    slope = float(t @ apart / (t @ t))
    rms = float(np.sqrt(((apart - apart.mean() - slope * t) ** 2).sum() / max(len(t) - 2, 1)))
    return slope, max(noise, rms) / float(np.sqrt(t @ t))
