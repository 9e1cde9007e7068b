"""Times of frames by the film's own clock: time stamps, numbers of pictures, repeated frames."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from synthcam_shared.arrays import Array, Ints
from tracker.camera.frames import Frames


@dataclass(frozen=True, eq=False)
class FilmClock:
    """The time of each stored frame: its number and, where frames are uneven, its seconds."""

    numbers: Ints  # (n,) frame times after the first frame: consecutive where no frame is missing
    fps: float = 0.0  # frames a second by this clock; 0 if unknown
    seconds: Array | None = None  # (n,) time of each frame, s; None where frames are evenly spaced by their numbers
    notes: tuple[str, ...] = ()  # missing frames and uneven times

    def set(self, frames: Frames) -> None:
        """Give the frames of a film their numbers and times, and the notes on them."""
        frames.numbers, frames.seconds, frames.fps = self.numbers, self.seconds, self.fps
        frames.faults += self.notes


def read_clock(ticks: Sequence[float] | Array, tick: float, source: str) -> FilmClock | None:
    """Read the times of frames; None of less than three, or of times that do not grow.

    ticks: time of each frame.
    tick: their unit, s.
    source: where they come from, for notes.
    """
    given = np.asarray(ticks, dtype=np.float64)
    if len(given) < 3 or not np.isfinite(given).all() or not (np.diff(given) > 0).all() or not tick > 0:
        return None
    times = (given - given[0]) * tick
    steps = np.diff(times)
    # Times may be rounded more coarsely than their unit, as milliseconds in ticks of 1/90000 s.
    whole = np.rint(np.diff(given)).astype(np.int64)
    coarse = float(np.gcd.reduce(whole)) * tick if np.array_equal(whole, np.diff(given)) else tick
    usual = float(np.median(steps))
    multiples = steps / usual
    numbers = np.arange(len(times))
    # 0.2 % of a step is what a moving ball may be off before that shows: 0.02 px at 10 px a frame
    tolerance = max(1.01 * coarse if coarse < 0.7 * usual else 0.0, 0.002 * usual)
    if np.abs(multiples - np.rint(multiples)).max() > 1e-6 and _off_line(numbers, times)[0] <= tolerance:
        return FilmClock(numbers, 1 / _off_line(numbers, times)[1])
    step = usual if coarse < 0.1 * usual else float(steps[steps < 1.5 * usual].mean())
    numbers = np.concatenate([[0], np.cumsum(np.maximum(np.rint(steps / step), 1))]).astype(np.int64)
    off, step = _off_line(numbers, times)
    lost = describe_missing(numbers, 1 / step, source)
    if off <= tolerance:
        return FilmClock(numbers, 1 / step, notes=lost)
    low, high = (1e3 * float(np.quantile(steps, share)) for share in (0.02, 0.98))
    spread = f"{low:.4g} to {high:.4g} ms apart"
    if f"{low:.4g}" == f"{high:.4g}":  # few steps differ
        spread = f"up to {1e3 * off:.2g} ms off a spacing of {low:.4g} ms"
    uneven = f"frame times are uneven, {spread} by {source}; each frame has its own (t_s)"
    return FilmClock(numbers, 1 / usual, times, (uneven, *lost))


def _off_line(numbers: Ints, times: Array) -> tuple[float, float]:
    """How far times are at most from even ones, s, and the step of those."""
    step, first = np.polyfit(numbers, times, 1)
    return float(np.abs(first + step * numbers - times).max()), float(step)


def describe_missing(numbers: Ints, fps: float, source: str) -> tuple[str, ...]:
    """A note on frames that are missing, with frames and times (fps 0: without times)."""
    steps, usual = np.diff(numbers), find_frame_stride(numbers)
    gaps = np.flatnonzero(steps > usual)
    if not len(gaps):
        return ()
    lost = int((steps[gaps] // usual - 1).sum())
    after = [int(numbers[k]) // usual for k in gaps[:8]]
    places = ", ".join(f"{k} ({_write_time(k * usual / fps)})" if fps else f"{k}" for k in after)
    more = f" and {len(gaps) - 8} more" if len(gaps) > 8 else ""
    are = "frames are" if lost > 1 else "frame is"
    return (f"{lost} {are} missing by {source}, after frame {places}{more}; frame numbers and times allow for that",)


def _write_time(seconds: float) -> str:
    """A time in a film, in ms below 10 s."""
    return f"{1e3 * seconds:.4g} ms" if seconds < 10 else f"{seconds:.2f} s"


def drop_copies(frames: Frames, pieces: Sequence[Callable[[int], Any]]) -> Frames:
    """Drop from a film without loss the frames that copy the previous one; the others keep their numbers.

    pieces: functions that give a part of a frame, the quickest first; the next is asked only if the last is the same.
    """
    count = len(frames)
    changes, known = np.ones(max(count - 1, 0)), [(-1, None)] * len(pieces)

    def get(level: int, k: int) -> Any:
        if known[level][0] != k:
            known[level] = (k, pieces[level](k))
        return known[level][1]

    for k in range(1, count):
        changes[k - 1] = 0.0 if all(get(n, k - 1) == get(n, k) for n in range(len(pieces))) else 1.0
    return drop_repeated(frames, changes)


def drop_equal_pictures(frames: Frames, fetch: Callable[[int], Any]) -> Frames:
    """The same of frames that a function fetches, which are compared by their middle rows first."""
    middle = frames.shape[1] // 2
    return drop_copies(frames, (lambda k: fetch(k)[middle].tobytes(), lambda k: fetch(k).tobytes()))


def find_repeated(changes: Array, tolerance: float = 0.0) -> Ints:
    """Find the frames that repeat the previous one, though the picture changes shortly before and after.

    changes: sum of squares of the change from each frame to the next. tolerance: the most that a single copy changes
    after an encoder with loss; 0: copies are exact. Runs of more than three frames are a picture where nothing moves.
    """
    reach, share, longest = 8, 0.04, 3  # frames; a fifth of the change, squared; frames
    if not tolerance and changes.all():
        return np.zeros(0, dtype=np.int64)
    usual = 0.2 * float(np.median(changes[changes > tolerance])) if (changes > tolerance).any() else np.inf
    still = np.zeros(len(changes) + 1, dtype=bool)
    for k, change in enumerate(changes):
        near = (changes[max(k - reach, 0) : k], changes[k + 1 : k + 1 + reach])
        least = min((float(side.max()) for side in near if len(side)), default=0.0)
        still[k + 1] = least >= usual and change <= (share * least if tolerance else 0.0)
    for period in (2, 3, 4):
        for phase in range(period):
            fresh = np.arange(len(still)) % period == phase
            inner = slice(period, -period)  # nothing is known beyond the ends
            copied, new = (still[inner][rows[inner]] for rows in (~fresh, fresh))
            if len(still) >= 4 * period and copied.mean() >= 0.9 and new.mean() <= 0.02:
                return np.flatnonzero(~fresh)
    frames = np.flatnonzero(still & (np.append(0.0, changes) <= tolerance))
    if not set(frames.tolist()) - {1, len(changes)}:
        return frames[:0]  # an encoder may repeat the first frame, where nothing else is repeated
    runs = np.split(frames, np.flatnonzero(np.diff(frames) > 1) + 1)
    return np.concatenate([run for run in runs if len(run) <= longest] or [frames[:0]])


def drop_repeated(frames: Frames, changes: Array) -> Frames:
    """Drop from a film the frames that repeat the previous one; the others keep their numbers."""
    # A copy in video with loss: .02 counts^2 a pixel, a twentieth of what a small moving ball makes in 640 x 480 pixels
    again = find_repeated(changes, 0.02 * frames.shape[1] * frames.shape[2] if frames.lossy else 0.0)
    if not len(again) or len(frames) - len(again) < 2:
        return frames
    kept = np.setdiff1d(np.arange(len(frames)), again)
    shown = ", ".join(str(frames.numbers[k]) for k in again[:6]) + (", ..." if len(again) > 6 else "")
    note = f"{len(again)} frames repeat the previous one and are left out: {shown}"
    out = frames.take(kept)
    out.faults = (*frames.faults, note)
    return out


def find_frame_stride(numbers: Ints) -> int:
    """The number of frame times between neighbours where all frames are whole multiples of it apart."""
    steps = np.diff(numbers)
    return max(int(np.gcd.reduce(steps)), 1) if len(steps) else 1


def rates_agree(one: float, other: float, tolerance: float = 0.01) -> bool:
    """True for frame rates of a film and a clock that are the same: 29.97 counts as 30."""
    return other > 0 and math.isfinite(one) and abs(one / other - 1) < tolerance
