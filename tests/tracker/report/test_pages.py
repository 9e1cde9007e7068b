"""The page of a recording stands alone, says what was measured, and steps through the frames."""

import base64
import html
import json
import re
from dataclasses import replace

import cv2
import numpy as np
import pandas as pd
import pytest
from tracker_film import CAMERA, film

import tracker
from synthcam_shared.report.page import PageFigure
from tracker.camera.film_in_memory import wrap_frames
from tracker.measurement.local.recommendation import find_recommended_suffix
from tracker.report.collision_figures import draw_speeds
from tracker.report.pages import PAGE, RecordingPage


def paths():
    """Two balls that collide head-on, to be filmed: px, frame by frame."""
    t = np.arange(60)
    striker = np.where(t < 25, 40 + 2.0 * t, 90 + 0.3 * (t - 25))
    struck = np.where(t < 25, 104.9, 104.9 + 1.4 * (t - 25))
    return np.stack([np.stack([striker, 0 * t + 80.0], 1), np.stack([struck, 0 * t + 80.3], 1)], 1)


@pytest.fixture(scope="module")
def recorded():
    pictures = film(np.random.default_rng(1), paths())
    result = tracker.track(pictures, CAMERA)
    frames = wrap_frames(pictures)
    motion, rows = result.motion, [dict(row) for row in result.rows]
    return RecordingPage("a <b>bold</b> name", result.camera, result.found, rows, motion, frames, ("it is assumed",))


@pytest.fixture(scope="module")
def written(recorded, tmp_path_factory):
    page = recorded.write(tmp_path_factory.mktemp("page"), "tracker track film.avi")
    return page, page.read_text(encoding="utf-8")


def test_it_stands_alone(written):
    page, text = written
    assert sorted(p.name for p in page.parent.iterdir()) == [PAGE, "overlay.mp4"]
    assert not re.search(r'(?:src|href)\s*=\s*["\'](?!data:)', text)
    assert "http" not in re.sub(r"base64,[A-Za-z0-9+/=]*", "", text)
    assert "<b>bold" not in text
    assert "a &lt;b&gt;bold" in text
    assert re.search(r"Made 20\d\d-\d\d-\d\d \d\d:\d\d UTC by synthcam .*: <code>tracker track film.avi</code>", text)
    assert "it is assumed" in text


def test_its_numbers_are_those_measured(written, recorded):
    words = re.sub(r"<[^>]*>", " ", html.unescape(written[1]))
    (row,) = recorded.rows
    assert row["status"] in ("ok", "misfit")
    assert f"{row['chi2'] / row['dof']:.3g}" in words
    said = re.search(r"restitution in a scene\)\s+(-?[\d.]+)\((\d+)\)?\s", words) or re.search(
        r"restitution in a scene\)\s+(-?[\d.]+)", words
    )
    assert float(said[1]) == pytest.approx(row[f"r{find_recommended_suffix(row)}"], abs=5e-3)


def test_its_film_has_every_frame_and_plays(written, tmp_path):
    page, text = written
    data = base64.b64decode(re.search(r'src="data:video/mp4;base64,([^"]*)"', text)[1])
    assert data == (page.parent / "overlay.mp4").read_bytes()
    film = cv2.VideoCapture(str(page.parent / "overlay.mp4"))
    count = 0
    while film.grab():
        count += 1
    assert count == len(paths())


def test_it_steps_through_the_frames(written, recorded):
    steps = json.loads(re.search(r"const steps = (\[.*?\]), rate", written[1])[1])
    assert [s["frame"] for s in steps] == list(range(len(paths())))
    for step in steps:
        balls = {ball[0]: ball for ball in step["balls"]}
        for row in np.flatnonzero(recorded.tracks.frame == step["frame"]):
            ball = balls[int(recorded.tracks.particle[row])]
            assert float(ball[1]) == pytest.approx(recorded.tracks.x[row], abs=6e-4)
            assert float(ball[2]) == pytest.approx(recorded.tracks.y[row], abs=6e-4)


def test_tracks_without_a_film_and_without_a_collision_have_a_page(recorded, tmp_path):
    first = recorded.tracks.particle == recorded.tracks.particle[0]
    table = tracker.Result(0, recorded.camera, recorded.tracks, (), recorded.motion).tracks[first]
    alone = tracker.measure(table, recorded.camera)
    bare = RecordingPage("tracks", alone.camera, alone.found, alone.rows, alone.motion)
    text = bare.write(tmp_path, "tracker measure").read_text(encoding="utf-8")
    assert "came without a film" in text
    assert "no ball rolls freely" in text
    assert [p.name for p in tmp_path.iterdir()] == [PAGE]


def test_an_empty_recording_has_a_page(recorded, tmp_path):
    camera, blank = recorded.camera, np.full((5, 160, 200), 8, np.uint8)
    result = tracker.track(blank, CAMERA)
    frames = wrap_frames(blank)
    empty = RecordingPage("nothing", camera, result.found, result.rows, result.motion, frames)
    text = empty.write(tmp_path, "tracker track").read_text(encoding="utf-8")
    assert "Not measured: nothing moves" in text
    pixels = replace(empty, camera=tracker.track(blank).camera)
    assert "frame" in pixels.write(tmp_path / "pixels", "tracker track").read_text(encoding="utf-8")


@pytest.mark.parametrize("count", [1, 12, 40])
def test_the_speeds_of_many_particles_fit_into_their_figure(count):
    """A legend higher than the figure leaves no room for the axes, of which matplotlib warns."""
    rows = [(0.004 * k, particle, 0.1, 0.1) for particle in range(count) for k in range(3)]
    motion = pd.DataFrame(rows, columns=["t_s", "particle", "vx", "vy"])
    assert "svg" in PageFigure.of(draw_speeds(motion, [0.004]), "speed").address
