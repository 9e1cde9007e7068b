"""Neighbours of glints against all pairs of distances."""

import numpy as np

from tracker.detection.glints import Glints, PositionFlag
from tracker.detection.likelihood.neighbours import find_isolated, find_repeated


def test_neighbours_are_found_among_many_balls_in_any_order():
    """Thirty balls a frame, the nearest one anywhere in the list; a ball alone in its frame has none."""
    rng = np.random.default_rng(2)
    frame = np.append(np.repeat(np.arange(4), 30), 4)
    xy = rng.uniform(0, 300, (len(frame), 2))
    xy[1] = xy[0]  # two candidates at one place
    apart = np.hypot(*(xy[:, None] - xy).transpose(2, 0, 1))
    apart[(frame[:, None] != frame) | np.eye(len(frame), dtype=bool)] = np.inf
    nearest = apart.min(axis=1)
    for distance in (1.0, 10.0, 20.0, 40.0):
        assert (find_isolated(frame, xy, distance) == (nearest >= distance)).all()
    assert find_isolated(frame[:1], xy[:1], 1e4).all()


def test_of_glints_at_one_place_the_best_is_kept():
    """Three in a row, 4 px apart, of which the middle one describes its pixels; one alone in the next frame."""
    glints = Glints.at([10.0, 14.0, 18.0, 14.0], 5.0, [0.1, 0.2, 0.1, 0.3])
    glints.frame[:] = [0, 0, 0, 1]
    assert find_repeated(glints, 5.0).tolist() == [False, True, False, False]
    glints.flags[[0, 2]] = PositionFlag.MISFIT
    assert find_repeated(glints, 5.0).tolist() == [True, False, True, False]
    assert not find_repeated(glints, 3.0).any()
    assert len(find_repeated(Glints.none(), 5.0)) == 0
