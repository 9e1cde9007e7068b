"""Progress within one long film, and films that are decoded no more often than needed."""

from collections import Counter

import numpy as np
import pytest
import tifffile
from tracker_discs import film

from tracker.camera.camera import Camera
from tracker.camera.frames import Frames, spread_frames
from tracker.detection.choose import choose_detector
from tracker.pipeline import run


def counted(count=100, shape=(40, 50)):
    """Frames of which each says its number, and how often each was fetched."""
    fetched = Counter()

    def fetch(k):
        fetched[k] += 1
        return np.full(shape, k, np.uint8)

    return Frames(count, shape, np.uint8, fetch), fetched


def test_remembered_frames_are_fetched_once_in_their_order():
    frames, fetched = counted()
    frames.remember([70, 5, 30, 5])
    assert list(fetched) == [5, 30, 70]
    assert [int(frames[k][0, 0]) for k in (70, 5, 30, -30, 6)] == [70, 5, 30, 70, 6]
    assert fetched == {5: 1, 30: 1, 70: 1, 6: 1}


def test_nothing_is_remembered_beyond_the_memory_allowed():
    frames, fetched = counted()
    frames.remember([1, 2], most_bytes=2 * 40 * 50 - 1)
    assert not fetched
    frames.remember([1, 2], most_bytes=2 * 40 * 50)
    assert fetched == {1: 1, 2: 1}


def test_the_choice_of_a_detector_fetches_each_frame_once():
    frames, fetched = counted()
    choose_detector(frames, Camera.unknown((50, 40), 8))
    assert set(fetched.values()) == {1}
    assert set(spread_frames(frames, 31)) <= set(fetched)


@pytest.mark.parametrize("films", [1, 2])
def test_progress_counts_the_frames_of_one_film_and_the_clips_of_several(tmp_path, films):
    rng, ways = np.random.default_rng(2), np.stack([[[40.0 + 3 * k, 60.0] for k in range(12)]])
    for number in range(films):
        folder = tmp_path / "films" / "clips" / f"{number:06}"
        folder.mkdir(parents=True)
        tifffile.imwrite(folder / "frames.tif", film(rng, ways), photometric="minisblack")
        (folder / "camera.json").write_text('{"size": [200, 160], "fps": 60, "scale": 1e-3, "ball_diameter": 0.0186}')
    said = []
    run(tmp_path / "films", tmp_path / "out", "discs", 1, lambda *done: said.append(done))
    of = 12 if films == 1 else 2
    assert said == [(k, of) for k in range(1 if films == 1 else 0, of + 1)]
