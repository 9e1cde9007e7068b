"""Pictures that no ball can be followed in get a reason that says what to change; three balls are three balls."""

import json
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
import tifffile
from tracker_film import CAMERA, collision, disc, expose, film, spot, write_clip

from tracker import cli, pipeline, recording
from tracker.camera.camera import Camera
from tracker.camera.recordings import Frames, Recording, open_source
from tracker.detection.detect import detect, make_view
from tracker.detection.link import link_into_tracks

SHAPE = (160, 200)


def status(tmp_path, frames, camera=CAMERA):
    """Track the frames, and return the status of each estimate."""
    write_clip(tmp_path / "clip", frames, camera)
    outcome = pipeline.run(tmp_path / "clip", tmp_path / "out", "maximum_likelihood", 1)
    return outcome.estimates["status"].tolist()


def noisy(rng, picture, count=12):
    return np.array([expose(rng, picture) for _ in range(count)])


def moving(rng, ground, draw, count=20):
    """Something drawn anew in each frame of a ground."""
    return np.array([expose(rng, np.full(SHAPE, ground) + draw(20.3 + 7.0 * k)) for k in range(count)])


def test_empty_frames(tmp_path):
    said = status(tmp_path, noisy(np.random.default_rng(0), np.full(SHAPE, 0.5)))
    assert said == ["no balls: nothing is brighter than the plate"]


def test_overexposed(tmp_path):
    rng = np.random.default_rng(1)
    frames = moving(rng, 300.0, lambda x: 500 * spot(SHAPE, x, 80.0, 1.0))
    assert status(tmp_path, frames) == ["overexposed: most of the picture is at the sensor's limit"]


def test_dark_balls_on_a_bright_ground(tmp_path):
    rng = np.random.default_rng(2)
    frames = moving(rng, 150.0, lambda x: -100.0 * (disc(SHAPE, x, 80.0, 7.44) > 0))
    assert status(tmp_path, frames) == [
        "dark balls on a bright ground: a glint brighter than the plate is needed; --detector discs follows dark bodies"
    ]


def test_dark_balls_with_a_bright_glint_are_followed():
    rng = np.random.default_rng(2)
    draw = lambda x: 1500 * spot(SHAPE, x, 80.0, 1.0) - 50.0 * (np.hypot(*np.ogrid[-80:80, -x : 200 - x]) < 7)  # noqa: E731
    frames = moving(rng, 60.0, draw)
    camera = Camera.from_dict({k: v for k, v in CAMERA.items() if k != "lamp"})
    clip = Recording(0, camera, Frames(len(frames), SHAPE, frames.dtype, lambda k: frames[k]))
    view = make_view(clip)
    tracks = link_into_tracks(detect(clip, view).glints, view.camera)
    assert len(tracks) == 20
    assert np.abs(tracks.x - (20.3 + 7.0 * np.arange(20))).max() < 0.1


def test_the_same_picture_again_and_again(tmp_path):
    frames = np.repeat(noisy(np.random.default_rng(3), np.full(SHAPE, 0.5), 1), 12, axis=0)
    assert status(tmp_path, frames) == ["nothing moves: all frames are the same picture"]


def test_light_that_changes(tmp_path):
    rng = np.random.default_rng(4)
    frames = np.array([expose(rng, np.full(SHAPE, 60.0 * (k % 4))) for k in range(24)])
    assert status(tmp_path, frames) == ["the light changes: most of the picture is brighter than the plate"]


def test_a_single_blink_is_counted(tmp_path):
    rng = np.random.default_rng(5)
    frames = noisy(rng, np.full(SHAPE, 0.5))
    frames[5] = expose(rng, np.full(SHAPE, 0.5) + 1200 * spot(SHAPE, 60.2, 70.4, 1.0))
    assert status(tmp_path, frames) == ["too few detections: 1 glints in 12 frames"]


def test_three_balls_are_three_tracks_and_the_hit_is_still_measured():
    rng = np.random.default_rng(6)
    pair = collision(50, contact=22.3, speed=3.0, centre=(95.0, 80.0))
    third = np.column_stack([30.0 + 2.5 * np.arange(50), np.full(50, 20.0)])[:, None]
    frames = film(rng, np.concatenate([pair, third], axis=1))
    camera = Camera.from_dict(CAMERA)
    clip = Recording(0, camera, Frames(len(frames), SHAPE, frames.dtype, lambda k: frames[k]))
    tracked = recording.track_clip(clip)
    tracks, reason = tracked.tracks, tracked.reason
    assert reason == ""
    assert np.bincount(tracks.particle).tolist() == [50, 50, 50]
    for path in (*pair.transpose(1, 0, 2), third[:, 0]):  # each track stays on its own ball
        near = [
            np.hypot(tracks.glint_x[own] - path[:, 0], tracks.glint_y[own] - path[:, 1]).max()
            for own in (tracks.particle == p for p in range(3))
        ]
        assert sorted(near)[0] < 0.6
        assert sorted(near)[1] > 5


@pytest.mark.parametrize(
    ("pixels", "said"),
    [
        (np.zeros((1, 32, 32), np.uint8), "one frame only"),
        (np.full((5, 32, 32), np.nan, np.float32), "cannot hold NaN"),
        (np.zeros((5, 32, 32), np.int32), "expected uint8 or uint16"),
        (np.zeros((0, 32, 32), np.uint8), "truncated or damaged"),
    ],
)
def test_stacks_that_are_none(tmp_path, pixels, said, monkeypatch, capsys):
    if pixels.size:
        tifffile.imwrite(tmp_path / "bad.tif", pixels)
    else:
        (tmp_path / "bad.tif").write_bytes(b"II*\0\x08\0\0\0\0\0")
    monkeypatch.setattr(sys, "argv", ["tracker", "track", str(tmp_path / "bad.tif"), "-o", str(tmp_path / "out")])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    err = capsys.readouterr().err
    assert stop.value.code == 2
    assert said in err
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def write_sparse_clip(folder, count, shape):
    """A clip folder of a black film, which takes no room on the disk, with one glint that moves."""
    folder = write_clip(folder, np.zeros((2, 8, 8), np.uint8), {**CAMERA, "size": [*shape[::-1]]})
    with tifffile.TiffWriter(folder / "frames.tif", bigtiff=True) as writer:
        writer.write(shape=(count, *shape), dtype=np.uint8, photometric="minisblack")
    movie = tifffile.memmap(folder / "frames.tif")
    step = min(0.4, (shape[1] - 80) / count)
    for k in range(count):
        x = 40 + step * k
        column = round(x)
        movie[k, 190:211, column - 10 : column + 11] = np.rint(1200 * spot((21, 21), 10 + x - column, 10.3, 1.0))
    del movie
    return folder


@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are Linux's")
@pytest.mark.gate
def test_a_stack_ten_times_the_memory_allowed(tmp_path):
    """1 GB of frames, a sparse file with a glint in each, tracked and measured with 100 MB more than at start."""
    count = 1300
    folder = write_sparse_clip(tmp_path, count, (768, 1024))
    script = (
        "import resource, sys\n"
        "from tracker.camera.recordings import open_source\n"
        "from tracker.recording import track_clip, measure_clip\n"
        "import tracker.detection.detectors.maximum_likelihood, tracker.measurement.estimate\n"
        "held = next(line for line in open('/proc/self/status') if line.startswith('VmData'))\n"
        "limit = (int(held.split()[1]) << 10) + (100 << 20)\n"
        "resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))\n"
        "tracked = track_clip(open_source(sys.argv[1]).open_clip(0))\n"
        "print(len(tracked.tracks), measure_clip(tracked.tracks, tracked.camera)[0][0]['status'])\n"
    )
    done = subprocess.run([sys.executable, "-c", script, folder], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [str(count), "no_collision"]


def peak_memory(*clips):
    """List the positions and the MB that a process has taken at most after it has tracked each clip in turn."""
    script = (
        "import sys\n"
        "from tracker.recording import track_clip\n"
        "from tracker.camera.recordings import open_source\n"
        "from tracker.settings import DetectionSettings, TrackerSettings\n"
        "blocks = TrackerSettings(detection=DetectionSettings(block_windows=100))\n"
        "for clip in sys.argv[1:]:\n"
        "    tracks = track_clip(open_source(clip).open_clip(0), settings=blocks).tracks\n"
        "    peak = next(line for line in open('/proc/self/status') if line.startswith('VmHWM'))\n"
        "    print(len(tracks), int(peak.split()[1]) / 1024)\n"
    )
    done = subprocess.run([sys.executable, "-c", script, *clips], capture_output=True, text=True, check=True)
    return [(int(found), float(size)) for found, size in map(str.split, done.stdout.splitlines())]


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_memory_does_not_grow_with_the_length_of_a_clip(tmp_path):
    """The 400 frames more are 31 MB. Small blocks of glints are full in the short clip already."""
    clips = [write_sparse_clip(tmp_path / f"{count}", count, (240, 320)) for count in (120, 520)]
    (few, little), (many, much) = peak_memory(*clips)
    assert (few, many) == (120, 520)
    assert much - little < 4  # MB


def test_reasons_reach_the_files(tmp_path):
    write_clip(tmp_path / "clip", noisy(np.random.default_rng(9), np.full(SHAPE, 0.5)))
    pipeline.run(tmp_path / "clip", tmp_path / "out", "maximum_likelihood", 1)
    table = pd.read_parquet(tmp_path / "out" / "estimates.parquet")
    assert table["status"].tolist() == ["no balls: nothing is brighter than the plate"]
    rows = json.loads((tmp_path / "out/clips/000000/estimates.json").read_text())
    assert rows[0]["status"] == table["status"][0]
    assert len(open_source(tmp_path / "clip")) == 1
