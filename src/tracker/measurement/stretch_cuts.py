"""The one rule by which commands cut tracks into free stretches: what is a contact, and what lies beside it.

The local estimate, `tracker warp` and `discrepancy find --stretches` cut by it.

- A contact is one that the tracker measured, a position at which another ball may be touched, or a kink.
- A kink is a change of the velocity that friction and noise cannot make. The noise is the scatter of third
  differences.
- A position within the margin of a contact, before or after it, is beside it. Trackers and bodies are less regular
  there, so stretches leave it out. The local estimate has few positions, and gives those larger errors instead.
- A ball that was not seen for many frames may have hit something.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d

from synthcam_shared.arrays import Array, Flags, Ints
from tracker.measurement.positions import BallTrack, measure_separation


@dataclass(frozen=True)
class StretchCutter:
    """Finds contacts in tracks and cuts them there."""

    margin_frames: float = 1.5  # from a contact, within which positions are beside it
    max_gap_frames: int = 10
    near_diameters: float = 1.15  # distance of centres at which another ball may be touched
    max_acceleration: float = 3.5  # m/s^2, of a ball that slides; what changes the velocity faster is a contact
    kink_positions: int = 4  # to either side, from which a velocity is read
    kink_sigma: float = 6.0  # standard errors by which the velocity changes at a contact
    rest_sigma: float = 5.0  # standard errors of a velocity within which a ball may rest

    def is_beside(self, time: Array, first: float, last: float, frame_s: float) -> Flags:
        """Tell which positions (n,) are beside a contact that lasts from `first` to `last`, s."""
        margin = self.margin_frames * frame_s * (1 + 1e-9)
        return np.asarray((time >= first - margin) & (time <= last + margin))

    def cut(self, time: Array, frame: Ints, contacts: Array, frame_s: float) -> Iterator[Ints]:
        """Iterate over the rows of the stretches between contacts and gaps; positions beside contacts are left out."""
        free = np.ones(len(time), dtype=bool)
        for at in contacts:
            free &= ~self.is_beside(time, at, at, frame_s)
        ends = ~free[1:] | ~free[:-1] | (np.diff(frame) > self.max_gap_frames)
        for part in np.split(np.arange(len(time)), np.flatnonzero(ends) + 1):
            if len(part) and free[part].all():
                yield part

    def find_touches(self, ball: BallTrack, balls: Sequence[BallTrack], diameter: float) -> Array:
        """Find the times at which another ball is so near that it may touch this one; diameter: m, or NaN."""
        found = [np.empty(0)]
        for other in balls if np.isfinite(diameter) else ():
            if other is ball:
                continue
            _, apart, mine, _ = measure_separation(ball, other)
            step = np.abs(np.diff(apart, prepend=apart[:1]))
            found.append(ball.time[mine][apart < self.near_diameters * diameter + step])
        return np.concatenate(found)

    def measure_kinks(self, time: Array, position: Array, noise: float) -> Array:
        """Measure the change of the velocity before each position (n,), over what friction and noise can make."""
        k, out = self.kink_positions, np.zeros(len(time))
        if len(time) < 2 * k or not np.isfinite(noise):
            return out
        slide = np.lib.stride_tricks.sliding_window_view
        when, where = slide(time, k), slide(position, k, axis=0)  # (n - k + 1, k), (n - k + 1, 2, k)
        middle = when.mean(axis=1)
        since = when - middle[:, None]
        spread = (since**2).sum(axis=1)
        velocity = (where @ since[:, :, None])[..., 0] / spread[:, None]
        change = np.hypot(*(velocity[k:] - velocity[:-k]).T)
        error = noise * np.sqrt(1 / spread[k:] + 1 / spread[:-k])
        # of a path that bends all along, as of bodies that stick and turn: twice the least change of it elsewhere
        least = np.full(len(change) + 2 * k, np.inf)
        least[k:-k] = change
        before, after = np.minimum.accumulate(least), np.minimum.accumulate(least[::-1])[::-1]
        elsewhere = np.minimum(before[: -2 * k], after[2 * k :])
        usual = np.where(np.isfinite(elsewhere), 2 * elsewhere, 0.0)
        limit = self.max_acceleration * (middle[k:] - middle[:-k]) + self.kink_sigma * error + usual
        out[k : len(time) - k + 1] = change / limit
        return out

    def find_kinks(self, time: Array, changes: Array) -> Array:
        """Find the times of the kinks, from their sizes (n,)."""
        largest = maximum_filter1d(changes, 2 * self.kink_positions - 1) if len(changes) else changes
        at = np.flatnonzero((changes > 1) & (changes == largest))
        return np.asarray((time[at - 1] + time[at]) / 2)

    def moves(self, time: Array, position: Array, noise: float) -> bool:
        """Decide whether a ball moves, by a straight line through its positions."""
        since = time - time.mean()
        spread = float(since @ since)
        return bool(np.hypot(*(since @ position)) > self.rest_sigma * noise * np.sqrt(spread))


CUTTER = StretchCutter()


NOISE_OF_THIRD_DIFFERENCES = 1.4826 / np.sqrt(20)
"""Standard deviation of normal noise over the median size of its third differences, x_0 - 3 x_1 + 3 x_2 - x_3."""


def measure_path_noise(paths: Iterable[tuple[Ints, Array]]) -> float:
    """Measure the noise of paths, beside which a cut must be clear: from third differences, m; NaN without any.

    paths: frames (n,) and positions (n, 2) of each ball.
    """
    sizes = np.concatenate([np.empty((0, 2)), *(_compute_third_differences(frame, xy) for frame, xy in paths)])
    known = sizes[np.isfinite(sizes)]
    return float(NOISE_OF_THIRD_DIFFERENCES * np.median(known)) if len(known) else float("nan")


def measure_largest_noise(frame: Ints, position: Array, length: int = 12) -> float:
    """Measure the largest noise of a path's parts of so many positions, each half in the next; NaN without any.

    As `measure_path_noise` of each part, all at once: most of the time is that of numpy's calls.
    """
    sizes = _compute_third_differences(frame, position)
    if not len(sizes):
        return float("nan")
    parts = np.lib.stride_tricks.sliding_window_view(sizes, min(length - 3, len(sizes)), axis=0)[:: length // 2]
    known = parts.reshape(len(parts), -1)
    known = known[np.isfinite(known).any(axis=1)]
    return float(NOISE_OF_THIRD_DIFFERENCES * np.nanmedian(known, axis=1).max()) if len(known) else float("nan")


def _compute_third_differences(frame: Ints, position: Array) -> Array:
    """Sizes of third differences, (n - 3, 2), m; NaN where frames are missing or nothing moves."""
    sizes = np.abs(np.diff(position, 3, axis=0))
    sizes[(np.diff(frame, 3) != 0) | (sizes.sum(axis=1) == 0)] = np.nan
    return sizes
