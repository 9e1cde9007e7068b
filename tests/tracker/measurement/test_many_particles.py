"""Many particles: pairs that cannot meet are left out, and more than can be measured in time is refused."""

import itertools
import json
import sys

import numpy as np
import pandas as pd
import pytest
from tracker_film import CAMERA

import tracker
from synthcam_shared.errors import InputError
from tracker import cli, pipeline
from tracker.measurement.collision import contacts
from tracker.measurement.positions import to_ball_tracks
from tracker.tables.read import to_pixels
from tracker.tables.table import TrackTable

PLAIN = {k: CAMERA[k] for k in ("scale", "fps", "ball_diameter")}


def wander(count, frames, size, rng, kicks=0.0):
    """A table of particles that roll, lose sight now and then, and change direction."""
    place, speed, rows = rng.uniform(0, size, (count, 2)), rng.normal(0, 3, (count, 2)), []
    for k in range(frames):
        if k % 9 == 0:
            speed = speed + kicks * rng.normal(0, 1, (count, 2)) * (rng.random((count, 1)) < 0.3)
        place = place + speed
        seen = np.flatnonzero(rng.random(count) > 0.1)
        rows += [(k, i, *(place[i] + rng.normal(0, 0.02, 2))) for i in seen]
    return pd.DataFrame(rows, columns=["frame", "particle", "x", "y"])


@pytest.mark.parametrize("seed", range(4))
def test_near_pairs_hold_every_contact(seed):
    table = wander(25, 36, 500, np.random.default_rng(seed), kicks=3.0)
    given = to_pixels(TrackTable(table), "tracks", PLAIN | {"size": [500, 500]})
    balls, diameter = to_ball_tracks(given.clips[0][0], given.camera), given.camera.ball_diameter

    def contacts_of(pairs):
        return [(k, a.particle, b.particle) for a, b in pairs for k in contacts._contact_frames(a, b, diameter, 0.75)]

    near = list(contacts.find_near_pairs(balls, diameter, 0.75))
    assert contacts_of(near) == contacts_of(itertools.combinations(balls, 2))
    assert len(near) < 0.5 * len(balls) * (len(balls) - 1) / 2


def test_of_hundreds_of_balls_few_pairs_are_looked_at():
    """All 79,800 pairs of 400 balls took 16 s."""
    table = wander(400, 10, 4000, np.random.default_rng(0))
    given = to_pixels(TrackTable(table), "tracks", PLAIN | {"size": [4000, 4000]})
    balls = to_ball_tracks(given.clips[0][0], given.camera)
    assert len(list(contacts.find_near_pairs(balls, given.camera.ball_diameter, 0.75))) < 1500


def test_too_many_particles_are_refused_with_the_option(tmp_path, monkeypatch, capsys):
    rows = {"frame": np.tile([0, 1], 3000), "particle": np.repeat(np.arange(3000), 2)}
    table = pd.DataFrame(rows).assign(x=lambda t: 40.0 * (t.particle % 60), y=lambda t: 40.0 * (t.particle // 60))
    with pytest.raises(InputError, match=r"clip 0: 3000 particles, expected at most 2000; .*max_particles: 3000"):
        tracker.measure(table, PLAIN | {"size": [4000, 4000]})
    table.to_csv(tmp_path / "tracks.csv", index=False)
    (tmp_path / "camera.json").write_text(json.dumps(PLAIN | {"size": [4000, 4000]}))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", "tracker measure tracks.csv --camera camera.json -o new".split())
    with pytest.raises(SystemExit) as ended:
        cli.main()
    err = capsys.readouterr().err
    assert (ended.value.code, err.count("\n")) == (2, 1)
    assert "--settings" in err
    assert not (tmp_path / "new").exists()
    assert not (tmp_path / "new.partial").exists()


@pytest.mark.parametrize(("most", "written"), [(100, True), (10, False)])
def test_a_long_recording_has_a_page_if_asked(most, written, tmp_path, monkeypatch, capsys):
    wander(1, 40, 500, np.random.default_rng(0)).to_csv(tmp_path / "tracks.csv", index=False)
    (tmp_path / "camera.json").write_text(json.dumps(PLAIN | {"size": [500, 500]}))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cli, "MAX_ROWS_OF_A_PAGE", most)
    monkeypatch.setattr(sys, "argv", "tracker measure tracks.csv --camera camera.json -o new".split())
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 0
    assert (tmp_path / "new/index.html").exists() == written
    assert ("--pages writes it" in capsys.readouterr().err) != written


def test_measuring_clips_of_a_table_counts_them(tmp_path):
    wander(1, 9, 500, np.random.default_rng(0)).to_csv(tmp_path / "one.csv", index=False)
    one = pd.read_csv(tmp_path / "one.csv")
    pd.concat([one.assign(clip=clip) for clip in (3, 4, 7)]).to_csv(tmp_path / "tracks.csv", index=False)
    (tmp_path / "camera.json").write_text(json.dumps(PLAIN | {"size": [500, 500]}))
    said = []
    pipeline.measure_tables(
        tmp_path / "tracks.csv", tmp_path / "new", tmp_path / "camera.json", progress=lambda *done: said.append(done)
    )
    assert said == [(0, 3), (1, 3), (2, 3)]
