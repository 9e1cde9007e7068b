"""Marks of films of others, on drawn frames whose balls are known."""

from __future__ import annotations

import numpy as np
import pandas as pd

from benchmarks.real.films import (
    Frames,
    MarkedFilm,
    compare,
    find_repeated,
    is_dark,
    is_orange,
    mark_largest,
    mark_single_discs,
    number_frames,
)

ORANGE, GREY, WHITE = (230, 140, 20), (100, 100, 100), (255, 255, 255)


def draw(discs: list[tuple[float, float]], radius: float, colour: tuple[int, int, int]) -> Frames:
    """One frame (100, 160, 3) of discs on white."""
    rows, columns = np.mgrid[:100, :160]
    frame = np.full((100, 160, 3), WHITE, np.int16)
    for x, y in discs:
        frame[np.hypot(columns - x, rows - y) < radius] = colour
    return frame


def test_the_largest_orange_region_is_marked_and_a_repeated_frame_is_not() -> None:
    frames = np.array([draw([(x, 50.0)], 9, ORANGE) for x in (30.0, 45.0, 45.0, 60.0, 75.0)])
    assert find_repeated(frames).tolist() == [False, False, True, False, False]
    centres = [marks.centres.tolist() for marks in mark_largest(is_orange, 100, repeats=True)(frames)]
    assert centres == [[[30, 50]], [[45, 50]], [], [[60, 50]], [[75, 50]]]


def test_discs_that_touch_or_are_cut_by_the_rim_have_no_mark_and_a_line_divides_none() -> None:
    frame = draw([(30, 30), (80, 50), (99, 50), (158, 80)], 10, GREY)
    frame[:, 28] = WHITE
    (marks,) = mark_single_discs(is_dark)(frame[None])
    assert np.allclose(marks.centres, [[30, 30]], atol=0.3)
    assert marks.unmarked[50, 80]
    assert marks.unmarked[80, 157]


def test_positions_are_counted_by_the_numbers_of_the_frames() -> None:
    frames = np.array([draw([(30.0 + 15 * k, 50.0)], 9, ORANGE) for k in range(4)])
    film = MarkedFilm("", "", "", mark_largest(is_orange, 100))
    numbers = np.array([0, 1, 3, 4])  # a frame is missing by the time stamps
    rows = [(0, 30.0, 50.0), (1, 48.0, 54.0), (3, 100.0, 20.0), (4, 75.0, 50.0), (4, 10.0, 10.0)]
    found = compare(pd.DataFrame(rows, columns=["frame", "x", "y"]), film, frames, numbers)
    assert (found["marks"], found["found"], found["missed"], found["false"]) == (4, 3, 1, 2)
    assert np.isclose(found["rms_px"], np.sqrt(25 / 3))
    shifted = compare(pd.DataFrame(rows, columns=["frame", "x", "y"]), film, frames, np.arange(4))
    assert shifted["found"] == 2


def test_frames_are_numbered_by_time_stamps_that_are_rounded_and_have_gaps() -> None:
    times = np.round(34.5e-3 * np.array([0, 1, 2, 3, 5, 6, 9]), 3)
    assert number_frames(times).tolist() == [0, 1, 2, 3, 5, 6, 9]
    long = np.round(34.5e-3 * np.arange(200), 3)
    assert number_frames(long).tolist() == list(range(200))
