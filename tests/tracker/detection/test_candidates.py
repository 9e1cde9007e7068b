"""The first search for glints, in frames drawn here."""

import numpy as np
import pytest

from tracker.detection.candidates import CandidateSearch, EmptyPlate

SIZE = (120, 160)
PLACES = [(40, 30), (100, 90)]


def drawn(level, seed=0):
    """A plate of a level (h, w), read out with a noise of .3 counts, and two glints on it."""
    picture = level + np.random.default_rng(seed).normal(0, 0.3, SIZE)
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    for column, row in PLACES:
        picture += 60 * np.exp(-((x - column) ** 2 + (y - row) ** 2) / 2)
    return np.rint(picture).astype(np.uint8)


def half(by):
    level = np.full(SIZE, 8.0)
    level[:, SIZE[1] // 2 :] += by
    return level


@pytest.mark.parametrize("by", [0, 1, 2])
def test_glints_are_found_where_an_encoder_shifts_the_plate(by):
    """By a count or two, in all of the picture or in half of it, as H.264 does from one group of frames to the next."""
    search = CandidateSearch(EmptyPlate(np.full(SIZE, 8, np.uint8), 0.3), 1.0, apart=10.0)
    for level in (half(by), np.full(SIZE, 8.0 + by)):
        found = search(drawn(level))
        assert set(zip(found.column[:2].tolist(), found.row[:2].tolist(), strict=True)) == set(PLACES)
        assert len(found.row) < 20


def test_a_picture_full_of_light_is_crowded():
    search = CandidateSearch(EmptyPlate(np.full(SIZE, 8, np.uint8), 0.3), 1.0, apart=10.0)
    found = search(drawn(np.full(SIZE, 40.0)))
    assert found.crowded
    assert len(found.row) == 0


@pytest.mark.parametrize("sigma", [1.0, 1.6])
def test_candidates_in_bytes_are_those_in_words(sigma):
    """Bytes are summed in a faster way. Glints touch the rim, and the sums of some exceed 255."""
    level = np.full(SIZE, 8.0)
    level[:2, 50:53] = level[70:73, -1] = 30
    picture = drawn(level, seed=1)
    one, two = (
        CandidateSearch(EmptyPlate(np.full(SIZE, 8, kind), 0.3), sigma, 10.0)(picture.astype(kind))
        for kind in (np.uint8, np.uint16)
    )
    assert len(one.row) >= 4
    for name in ("column", "row", "strength"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


@pytest.mark.parametrize("shape", [(90, 104), (91, 97)])
def test_candidates_are_the_strongest_of_all_box_sums_in_their_order(shape):
    """Found again by sums over each box and by comparing all with all."""
    rng, level, apart, kept = np.random.default_rng(sum(shape)), 10, 9.0, 4
    frame = (level + rng.integers(0, 3, shape)).astype(np.uint8)
    for row, column in rng.integers(0, shape, (5, 2)):
        frame[row, column] += 60
    frame[:30, :20] = level  # equal sums, of which the first counts
    frame[[10, 19, -1], [10, 10, -1]] += 100  # two in one column at the distance, and one at the end
    search = CandidateSearch(EmptyPlate(np.full(shape, level, np.uint8), 1.0), 1.0, apart, most=kept)
    found = search(frame)
    lifted = np.pad(frame.astype(int) - search.floor, 1, mode="symmetric")
    sums = np.lib.stride_tricks.sliding_window_view(lifted, (3, 3)).sum(axis=(2, 3))
    wanted = []
    for at in sorted(zip(*np.nonzero(sums > search.threshold), strict=True), key=lambda at: (-sums[at], at)):
        if len(wanted) < kept and all(np.hypot(at[0] - row, at[1] - column) > apart for row, column in wanted):
            wanted.append(at)
    assert list(zip(found.row, found.column, strict=True)) == wanted
    assert len(wanted) == kept
    assert np.array_equal(found.strength, [sums[at] - search.base for at in wanted])


@pytest.mark.parametrize("sigma", [1.0, 1.6])
def test_frames_that_are_searched_together_have_the_candidates_of_each_alone(sigma):
    """Glints anywhere, also across the rim; empty frames, a lighter plate and a crowded one are among them."""
    rng, level = np.random.default_rng(3), np.full(SIZE, 8, np.uint8)
    frames = [drawn(level, seed) for seed in range(4)]
    for frame, by in zip(frames, rng.uniform(-3, 3, 4), strict=True):
        frame[:] = np.roll(frame, rng.integers(0, SIZE), axis=(0, 1))
        frame[:, :] += np.uint8(by > 0)
    frames[1:1] = [level, drawn(np.full(SIZE, 10.0)), drawn(np.full(SIZE, 40.0)), level]
    plate = EmptyPlate(level, 0.3)
    together = CandidateSearch(plate, sigma, 10.0).search_together(frames)
    assert [len(found.row) > 0 for found in together] == [True, False, True, False, False, True, True, True]
    for frame, found in zip(frames, together, strict=True):
        alone = CandidateSearch(plate, sigma, 10.0)._search_thoroughly(frame)
        assert found.crowded == alone.crowded
        for name in ("column", "row", "strength"):
            np.testing.assert_array_equal(getattr(found, name), getattr(alone, name))


@pytest.mark.parametrize("column", [*range(24), *range(150, 160)])
def test_a_glint_is_found_wherever_it_lies_in_a_word_of_pixels(column):
    frame = np.full(SIZE, 8, np.uint8)
    frame[50:53, column] = (20, 60, 20)
    found = CandidateSearch(EmptyPlate(np.full(SIZE, 8, np.uint8), 0.3), 1.0, 10.0)(frame)
    assert found.row.tolist() == [51]
    corner = np.roll(frame, (-51, 0), axis=(0, 1))  # the first columns, and the last word
    assert CandidateSearch(EmptyPlate(np.full(SIZE, 8, np.uint8), 0.3), 1.0, 10.0)(corner).row.min() == 0
    assert abs(found.column[0] - column) <= 1


@pytest.mark.parametrize("sigma", [1.0, 1.6])
def test_the_quick_search_finds_all_that_sums_over_every_box_do(sigma):
    """In pictures of any size, on uneven plates, of bodies anywhere, in some of one to five frames."""
    rng, count = np.random.default_rng(4), 0
    for _ in range(20):
        shape = tuple(rng.integers(30, 140, 2))
        level = rng.integers(0, 30, shape).astype(np.uint8)
        search, frames = CandidateSearch(EmptyPlate(level, rng.uniform(0.5, 1.0)), sigma, 7.0), []
        for _ in range(rng.integers(1, 6)):
            picture = level + np.rint(rng.normal(0, 0.3, shape)).astype(int)
            for row, column in rng.integers(0, shape, (rng.integers(0, 6), 2)):
                picture[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2] += rng.integers(5, 120)
            frames.append(np.clip(picture, 0, 255).astype(np.uint8))
        for frame, found in zip(frames, search.search_together(frames), strict=True):
            every = search._search_thoroughly(frame)
            for name in ("row", "column", "strength"):
                np.testing.assert_array_equal(getattr(found, name), getattr(every, name))
        assert search.few is not None
        count += search.few.is_quick
    assert count > 15
