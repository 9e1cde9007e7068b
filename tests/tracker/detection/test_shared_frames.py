"""Frames that several processes share: the same detections as in one process, whoever examines which frames."""

import json
import pickle
from dataclasses import fields, replace

import numpy as np
import pandas as pd
import pytest
import tifffile
import tracker_discs
import tracker_film
from tracker_video import encode

from synthcam_shared.errors import InputError
from synthcam_shared.job_result import JobValue, LostJob
from tracker import pipeline
from tracker.camera.camera import Camera
from tracker.camera.recordings import HelperProcesses, RecordingSource, open_source
from tracker.detection import shared_frames
from tracker.detection.detect import detect, make_view
from tracker.detection.detectors.discs import Discs


def discs():
    return tracker_discs.film(np.random.default_rng(3), tracker_discs.apart(40)), tracker_discs.CAMERA


def glints():
    ways = np.stack(
        [np.linspace([40.0, 60.0], [150.0, 70.0], 40), np.linspace([60.0, 120.0], [70.0, 20.0], 40)], axis=1
    )
    return tracker_film.film(np.random.default_rng(3), ways), tracker_film.CAMERA


@pytest.mark.parametrize(("name", "drawn"), [("discs", discs), ("maximum_likelihood", glints)])
def test_other_processes_find_the_same(tmp_path, monkeypatch, name, drawn):
    """They get a pickled copy of the detector and open the film again; the last stretch is the first to end."""
    pictures, keys = drawn()
    tifffile.imwrite(tmp_path / "film.tif", pictures, photometric="minisblack")
    source = RecordingSource(tmp_path, ((0, tmp_path / "film.tif"),))
    (tmp_path / "camera.json").write_text(json.dumps(keys))
    clip, asked = source.open_clip(0), []

    def run_elsewhere(examiner, stretches, workers):
        asked.append(workers)
        there = pickle.loads(pickle.dumps(examiner))
        for k in reversed(stretches):
            yield JobValue(k, pickle.loads(pickle.dumps(there(k))))

    monkeypatch.setattr(shared_frames, "STRETCH_FRAMES", 8)
    monkeypatch.setattr(shared_frames, "run_jobs", run_elsewhere)
    alone, found = detect(clip, make_view(clip, name), name), []
    for workers in (1, 2):
        shared = replace(clip, helpers=HelperProcesses(source, 0, workers, clip.frames.contents))
        found.append(detect(shared, make_view(shared, name), name))
    assert asked == [2]
    assert len(alone.glints) == 80
    for other in found:
        assert other.notes == alone.notes
        if name == "discs":
            assert vars(other.outline_radius) == vars(alone.outline_radius)
        for column in fields(alone.glints):
            assert np.array_equal(getattr(other.glints, column.name), getattr(alone.glints, column.name))


@pytest.mark.gate
def test_real_processes_find_the_same_in_a_colour_of_a_video(tmp_path, monkeypatch):
    """The balls differ from the plate in colour alone: the other process has to read the same plane as this one."""
    rng, size, count = np.random.default_rng(5), (72, 104), 70
    paths = np.linspace([20.0, 20.0], [80.0, 24.0], count), np.linspace([80.0, 52.0], [20.0, 48.0], count)
    film = []
    for places in zip(*paths, strict=True):
        red = 128 + 90 * sum(tracker_discs.disc(place, 7.0, size=size) for place in places)
        film.append(np.stack([rng.normal(110, 2, size), np.full(size, 128), red]).clip(0, 255).astype(np.uint8))
    video, taken, run_jobs = encode(tmp_path / "film.mp4", film, fmt="yuv444p"), [], shared_frames.run_jobs

    def watch(examiner, stretches, workers):
        taken.append((len(stretches), workers))
        return run_jobs(examiner, stretches, workers)

    monkeypatch.setattr(shared_frames, "run_jobs", watch)
    camera = {"size": [*size[::-1]], "fps": 60.0, "scale": 1e-3, "ball_diameter": 0.014}
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    tables = []
    for workers in (1, 2):
        pipeline.run(replace(open_source(video), channel="red-green"), tmp_path / f"{workers}", "discs", workers)
        tables.append(pd.read_parquet(tmp_path / f"{workers}/clips/000000/tracks.parquet"))
    assert taken == [(3, 2)]  # the other process begins with two stretches
    assert len(tables[0]) == 2 * count
    pd.testing.assert_frame_equal(*tables)


def test_a_lost_process_is_reported_with_its_frames(monkeypatch):
    clip = tracker_discs.recorded(*discs()[:1], None)
    clip = replace(clip, helpers=HelperProcesses(None, 0, 2))
    monkeypatch.setattr(shared_frames, "run_jobs", lambda *_: iter([LostJob(1, "its worker was killed (SIGKILL)")]))
    with pytest.raises(InputError, match=r"frames 32 to 63: its worker was killed .* --workers 1 needs the least"):
        list(shared_frames.share_frames(clip, None, range(100)))


class Halved(Discs):
    """A user's detector, which inherits all that processes could share, and finds only every second ball."""

    def detect(self, frames):
        found = super().detect(frames)
        if not len(found.glints):
            raise TypeError("no balls")
        keep = np.arange(len(found.glints)) % 2 == 0
        return replace(found, glints=found.glints.take(keep))


def test_the_subclass_of_a_user_is_asked_itself(monkeypatch):
    monkeypatch.setattr(shared_frames, "run_jobs", lambda *_: pytest.fail("shared"))
    pictures, keys = discs()
    clip = tracker_discs.recorded(pictures, Camera.from_dict(keys))
    shared = replace(clip, helpers=HelperProcesses(None, 0, 2))
    assert len(detect(shared, make_view(shared, Halved), Halved).glints) == 40


def test_a_fault_of_a_user_that_needs_all_frames_is_one_line():
    pictures, keys = discs()
    empty = tracker_discs.recorded(np.full_like(pictures, 60), Camera.from_dict(keys))
    with pytest.raises(InputError, match=r"detector Halved: .*test_shared_frames.py, line \d+: TypeError: no balls"):
        detect(empty, make_view(empty, Halved), Halved)
