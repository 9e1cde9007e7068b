"""Seeds of the noise of many frames at once, the same that numpy's `SeedSequence` gives for each alone.

`SeedSequence` mixes the words of a seed one after the other into a pool of four words. The frame's number comes last.
So the words before it are mixed once for all frames, and the numbers of many frames in one array. Numpy keeps this
algorithm in all versions. Its author: M. E. O'Neill, "Developing a seed_seq alternative", pcg-random.org (2015).
"""

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.random.bit_generator import ISeedSequence
from numpy.typing import DTypeLike, NDArray

FRAMES_AT_ONCE = 128
POOL_WORDS, STATE_WORDS = 4, 3  # of 32 bits, and of 64 bits, from which SFC64 starts
MASK = 0xFFFFFFFF


class FrameSeed(ISeedSequence):
    """The start of the random numbers of one frame, as numpy's SFC64 takes it."""

    def __init__(self, state: NDArray[np.uint64]) -> None:
        self._state = state

    def generate_state(self, n_words: int, dtype: DTypeLike = np.uint64) -> Any:
        if (n_words, np.dtype(dtype)) != (STATE_WORDS, np.dtype(np.uint64)):
            raise ValueError(f"expected {STATE_WORDS} words of 64 bits, as SFC64 asks for, not {n_words} of {dtype}")
        return self._state


def make_frame_seed(root_seed: int, key: tuple[int, ...], frame: int) -> FrameSeed:
    """Make what SeedSequence(root_seed, spawn_key=(*key, frame)) is to SFC64. frame: below 2^32."""
    block, row = divmod(frame, FRAMES_AT_ONCE)
    return FrameSeed(_list_states(root_seed, key, block)[row])


@lru_cache(maxsize=16)
def _list_states(root_seed: int, key: tuple[int, ...], block: int) -> NDArray[np.uint64]:
    """List the states (FRAMES_AT_ONCE, STATE_WORDS) of the frames of a block."""
    seed = _split(root_seed)
    before = seed + [0] * (POOL_WORDS - len(seed)) + [word for number in key for word in _split(number)]
    frames = np.arange(block * FRAMES_AT_ONCE, (block + 1) * FRAMES_AT_ONCE, dtype=np.uint32)
    mixer = _Hash(0x43B0D7E5, 0x931E8875)
    pool: list[Any] = [mixer(word) for word in before[:POOL_WORDS]]
    for source in range(POOL_WORDS):
        for k in range(POOL_WORDS):
            if k != source:
                pool[k] = _mix(pool[k], mixer(pool[source]))
    for word in (*before[POOL_WORDS:], frames):
        pool = [_mix(each, mixer(word)) for each in pool]
    draw = _Hash(0x8B51F9DD, 0x58F38DED)
    words = np.stack([draw(pool[k % POOL_WORDS]) for k in range(2 * STATE_WORDS)], axis=1)
    return words.astype("<u4").view("<u8").astype(np.uint64)


class _Hash:
    """A hash of words of 32 bits, numbers or arrays, by a factor that changes from one word to the next."""

    def __init__(self, value: int, factor: int) -> None:
        self.value, self.factor = value, factor

    def __call__(self, word: Any) -> Any:
        word = word ^ self.value
        self.value = self.value * self.factor & MASK
        word = word * self.value & MASK
        return word ^ word >> 16


def _mix(one: Any, other: Any) -> Any:
    mixed = (0xCA01F9DD * one & MASK) - (0x4973F715 * other & MASK) & MASK
    return mixed ^ mixed >> 16


def _split(number: int) -> list[int]:
    """Split a number into words of 32 bits, the lowest first."""
    words = [number & MASK]
    while number := number >> 32:
        words.append(number & MASK)
    return words
