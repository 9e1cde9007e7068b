"""Places at uneven times are moved to where the same motion is at even ones."""

import json

import numpy as np
import pandas as pd
import pytest
from discrepancy_files import NOISE, SCENE
from repository import ROOT

from discrepancy.data.reading import read_collisions
from discrepancy.data.track_checks import detect_processing
from synthcam.dataset.generate import GenerationPlan, generate_dataset
from synthcam.scene.scene import read_scene
from synthcam_shared.errors import InputError

FINER = 5  # times the frame rate of 250, at which the motion is solved
CLIPS = 4


@pytest.fixture(scope="module")
def fine(tmp_path_factory):
    """True tracks at 1250 frames a second, no noise, and a camera file that says 250."""
    folder = tmp_path_factory.mktemp("fine")
    timing = {"fps": 1250, "exposure": 0.0004, "frames": 600, "contact_frame": 101}
    changes = [f"timing.{name}={value}" for name, value in timing.items()] + ["effects={}"]
    generate_dataset(
        GenerationPlan((read_scene(ROOT / SCENE, changes),), CLIPS, 4, False), folder / "data", 1, lambda done, of: None
    )
    parts = []
    for clip in sorted((folder / "data/clips").iterdir()):
        true = pd.read_parquet(clip / "truth/tracks.parquet").query("visible")
        parts.append(true.assign(clip=int(clip.name), x=true["x_mean_px"], y=true["y_mean_px"]))
    camera = json.loads((folder / "data/clips/000000/camera.json").read_text())
    (folder / "camera.json").write_text(json.dumps(camera | {"fps": 250.0}))
    return folder, pd.concat(parts)[["clip", "frame", "particle", "x", "y"]]


def read(fine, late, start=0.0):
    """The clips of a table whose frames are late by so many fifths of a frame, each: (frames,). start: frame 0, s."""
    folder, rows = fine
    wanted = pd.DataFrame({"number": range(len(late)), "frame": FINER * np.arange(len(late)) + late})
    table = rows.merge(wanted, on="frame")
    table = table.assign(t_s=start + table["frame"] / 1250, frame=table["number"], x_std=NOISE, y_std=NOISE, cov_xy=0.0)
    table.drop(columns="number").to_csv(folder / "t.csv", index=False)
    return read_collisions(folder / "t.csv", folder / "camera.json")


def test_places_are_those_of_even_times(fine):
    """Balls that move by up to 1 mm in .4 frames are found within 3 um, which is less than the noise of a position."""
    late = np.random.default_rng(3).integers(-2, 3, 110)
    late[0] = 0
    even, uneven = read(fine, 0 * late)[0], read(fine, late)[0]
    assert len(even) == len(uneven) == CLIPS
    assert detect_processing(even) == ()
    assert "up to 0.4 frames off an even rate" in str(detect_processing(uneven)[0])
    for one, other in zip(even, uneven, strict=True):
        whole = {(b, f): xy for b, f, xy in zip(one.ball, one.frame, one.xy, strict=True)}
        off = np.array([xy - whole[b, f] for b, f, xy in zip(other.ball, other.frame, other.xy, strict=True)])
        assert len(whole) - 4 <= len(off) <= len(whole)
        assert np.abs(off).max() < 3e-6
        assert np.sqrt(np.mean(off**2)) < 4e-7
        assert (one.max_shift_frames, other.max_shift_frames) == (0, pytest.approx(0.4))
        assert other.launch[:6] == pytest.approx(one.launch[:6], abs=2e-4)


def test_a_clock_may_start_anywhere(fine):
    """Times from 100 s on, with frames from 0 on, are those of the frames."""
    even, later = read(fine, np.zeros(110, int))[0], read(fine, np.zeros(110, int), start=100.001)[0]
    assert len(later) == CLIPS
    for one, other in zip(even, later, strict=True):
        np.testing.assert_array_equal(one.xy, other.xy)
        assert other.launch == pytest.approx(one.launch, abs=1e-7)


def test_times_of_another_frame_are_left_out(fine):
    with pytest.raises(InputError, match=r"clip 0: its times are up to 0\.4 frames off an even rate of 250 per second"):
        read(fine, np.where(np.arange(110) % 3, 0, 4))
