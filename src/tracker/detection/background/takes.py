"""Finds the takes of a film (its parts between two cuts), its repeated frames, and the noise of a pixel."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracker.detection.candidates import ROUNDING_NOISE_COUNTS, estimate_noise_at_rest


@dataclass(frozen=True, eq=False)
class FilmTakes:
    """Result of one pass over a film."""

    spans: tuple[tuple[int, int], ...]  # first and last frame of each take
    scenes: tuple[int, ...]  # a number for each take: takes of one number show the same scene
    repeated: frozenset[int]
    """Frames that nearly show the previous one again, beside the copies that the reader of the film leaves out."""
    noise: float  # standard deviation of one pixel in one frame, counts

    def describe(self) -> list[str]:
        """Notes for the user on cuts and repeated frames."""
        notes = []
        if len(self.spans) > 1:
            cut = ", ".join(f"{a} to {b}" for a, b in self.spans[:12]) + (", ..." if len(self.spans) > 12 else "")
            notes.append(f"the film has {len(self.spans)} takes, each tracked on its own: frames {cut}")
        if self.repeated:
            first, less = min(self.repeated), "the previous one, with less than a fifth of the usual change,"
            notes.append(
                f"{len(self.repeated)} frames nearly repeat {less} and are left out, frame {first} first"
                if len(self.repeated) > 1
                else f"frame {first} nearly repeats {less} and is left out"
            )
        return notes

    def scene_of_frames(self) -> dict[int, int]:
        """The scene of each frame that lies in a take and is not repeated."""
        both = zip(self.spans, self.scenes, strict=True)
        every = {k: scene for (a, b), scene in both for k in range(a, b + 1)}
        return {k: scene for k, scene in every.items() if k not in self.repeated}


def find_takes(frames: Sequence[Any]) -> FilmTakes:
    """Find the takes in one pass over the frames, (h, w) arrays, of a film.

    A cut is where half of all pixels change by more than 3 counts and by more than 6 times the usual change. Pieces of
    less than 8 frames do not count, and neither do those that never change by a tenth of the usual change.
    """
    step = max(1, int(np.sqrt(np.prod(np.shape(frames[0])) / 16_000)))  # 16,000 pixels of each frame are compared
    half, mean, spread, previous = [], [], [], None
    for frame in frames:
        thin = np.asarray(frame)[step // 2 :: step, step // 2 :: step].astype(np.float32)
        if previous is not None:
            change = np.abs(thin - previous)
            half.append(float(np.median(change)))
            mean.append(float(change.mean()))
            spread.append(estimate_noise_at_rest(thin - previous))
        previous = thin
    changes, means = np.array(half), np.array(mean)
    # a repeated frame changes by less than a fifth of the three frames on either side
    firsts = [max(min(k - 3, len(means) - 7), 0) for k in range(len(means))]
    repeated = [k + 1 for k, at in enumerate(firsts) if means[k] < 0.2 * np.quantile(means[at : at + 7], 0.8)]
    usual = float(np.median(np.delete(changes, [k - 1 for k in repeated])))
    starts = [0, *(np.flatnonzero(changes > max(6.0 * usual, 3.0)) + 1).tolist(), len(frames)]
    lively = 0.1 * float(np.median(means))
    spans = [
        (a, b - 1) for a, b in pairwise(starts) if len(starts) == 2 or (b - a >= 8 and means[a : b - 1].max() > lively)
    ] or [(0, len(frames) - 1)]
    fresh = np.delete(np.array(spread), [k - 1 for k in repeated])
    noise = max(float(np.median(fresh)) / np.sqrt(2), ROUNDING_NOISE_COUNTS)
    middles = [np.asarray(frames[(a + b) // 2])[::step, ::step].astype(np.float32) for a, b in spans]
    # Two pictures of one scene differ by noise, about the usual change, and by 2 counts of the encoder.
    scenes = _number_scenes(middles, 2.0 + 4 * usual)
    return FilmTakes(tuple(spans), scenes, frozenset(repeated), noise)


def _number_scenes(pictures: list[NDArray[np.float32]], tolerance: float) -> tuple[int, ...]:
    """A number for each take, the same where nine tenths of the pixels agree apart from the brightness of all."""
    kinds: list[NDArray[np.float32]] = []
    numbers = []
    for picture in pictures:
        level = picture - np.median(picture)
        same = [k for k, other in enumerate(kinds) if float(np.quantile(np.abs(level - other), 0.9)) < tolerance]
        if not same:
            kinds.append(level)
        numbers.append(same[0] if same else len(kinds) - 1)
    return tuple(numbers)
