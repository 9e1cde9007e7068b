"""Progress within one long film, and films that are decoded no more often than needed."""

from collections import Counter

import numpy as np
import pandas as pd
import pytest
import tifffile
from tracker_discs import film

from tracker.camera.camera import Camera
from tracker.camera.frames import Frames, spread_frames
from tracker.detection.choose import choose_detector
from tracker.measurement.crowd.crowd_rows import estimate_contacts
from tracker.pipeline import measure_tables, run


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
    survey, rest = said[: -12 * (films == 1)], said[-12 * (films == 1) :]
    assert rest == [(k, of) for k in range(1 if films == 1 else 0, of + 1)]
    assert [done for done, _ in survey] == list(range(1, len(survey) + 1))
    if films == 1:  # the survey looks at 12 frames for the radii, and at 12 for the background, some of them twice
        assert len(survey) == survey[-1][1] in (24, 36)


def test_progress_within_one_clip_of_a_crowd_counts_its_contacts(tmp_path, monkeypatch):
    monkeypatch.setitem(estimate_contacts.__kwdefaults__, "at_once", 2)
    rng, frame, parts = np.random.default_rng(1), np.arange(80), []
    hit = 33.3
    for pair in range(3):  # a ball of 40 px gives its speed to another
        late = 3 * np.clip(frame - hit, 0, None)
        for ball, x in enumerate((200 + late, 60 + 3 * frame - late)):
            noise = rng.normal(0, 0.02, (2, 80))
            at = {"x": x + noise[0], "y": 60 + 70 * pair + noise[1], "x_std": 0.02, "y_std": 0.02}
            parts.append(pd.DataFrame({"frame": frame, "particle": 2 * pair + ball, **at}))
    pd.concat(parts).to_csv(tmp_path / "tracks.csv", index=False)
    (tmp_path / "camera.json").write_text('{"size": [400, 300], "fps": 250, "scale": 5e-4, "ball_diameter": 0.02}')
    said = []
    paths = (tmp_path / name for name in ("tracks.csv", "out", "camera.json"))
    outcome = measure_tables(*paths, progress=lambda *done: said.append(done))
    assert outcome.estimates["status"].tolist() == ["crowd"] * 3
    # In parts of two contacts, those that show the friction first. Three are too few for that, so none is fitted again.
    assert said == [(0, 1), (0, 6), (2, 6)]
