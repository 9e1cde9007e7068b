"""Faults that trackers of other programs make, put into tracks whose truth is known."""

import numpy as np
import pandas as pd
import pytest

import tracker
from tracker.camera.camera import Camera
from tracker.detection.link import Tracks
from tracker.measurement.track_repair import repair_tracks
from tracker.notes import NoteKind

DIAMETER, FRAMES, CONTACT = 15.0, 40, 18.3
KEYS = {"fps": 250.0, "size": [640, 480], "scale": 2.4e-3 / DIAMETER, "ball_diameter": 2.4e-3}
CAMERA = Camera.from_dict(KEYS)


def collide(speed=0.7, b=0.4, r=0.85, seed=0):
    """Two discs without friction: straight paths before and after, px. The striker is number 1."""
    n = np.array([np.sqrt(1 - b * b), b])
    v, t = np.array([speed * DIAMETER, 0.0]), np.arange(FRAMES)[:, None] - CONTACT
    kick = (1 + r) / 2 * (v @ n) * n
    target = np.array([300.0, 240.0]) + np.where(t < 0, 0, t * kick)
    striker = np.array([300.0, 240.0]) - DIAMETER * n + np.where(t < 0, t * v, t * (v - kick))
    xy = np.concatenate([target, striker]) + 0.03 * np.random.default_rng(seed).standard_normal((2 * FRAMES, 2))
    return np.tile(np.arange(FRAMES), 2), np.repeat([0, 1], FRAMES), xy


def as_tracks(frame, particle, xy, rows=slice(None)):
    frame, particle, xy = frame[rows], particle[rows], xy[rows]
    order = np.lexsort((frame, particle))
    none = np.full(len(frame), np.nan)
    return Tracks(
        frame=frame[order],
        particle=particle[order],
        x=xy[order, 0],
        y=xy[order, 1],
        cov=np.full((len(frame), 2, 2), np.nan),
        flux=none,
        flags=np.full(len(frame), ""),
        glint_x=none,
        glint_y=none,
    )


def swapped(particle, rows):
    return np.where(rows, 1 - particle, particle)


def assert_same(repaired, truth):
    for name in ("frame", "particle", "x", "y"):
        assert np.array_equal(getattr(repaired.tracks, name), getattr(truth, name)), name


@pytest.mark.parametrize("speed", [0.1, 0.7, 1.4])
def test_true_tracks_stay_as_they_are(speed):
    for seed in range(20):
        rng = np.random.default_rng(seed)
        f, p, xy = collide(speed, rng.uniform(-0.9, 0.9), rng.uniform(0.2, 1), seed)
        truth = as_tracks(f, p, xy, rng.random(len(f)) > 0.15)
        repaired = repair_tracks(truth, CAMERA)
        assert repaired.tracks is truth
        assert repaired.notes == ()


@pytest.mark.parametrize("speed", [0.1, 0.7, 1.4])
@pytest.mark.parametrize("first", [2, 10, 18, 19, 20, 30])
@pytest.mark.parametrize("last", [0, 2, 99])
def test_exchanges_are_undone(speed, first, last):
    """In one frame, in three, for good; before, at and after the hit."""
    f, p, xy = collide(speed)
    wrong = swapped(p, (f >= first) & (f <= first + last))
    repaired = repair_tracks(as_tracks(f, wrong, xy), CAMERA, clip=7)
    assert_same(repaired, as_tracks(f, p, xy))
    (note,) = repaired.notes
    ends = (first,) if first + last >= FRAMES - 1 else (first, first + last + 1)
    assert (note.kind, note.clip, note.frames) == (NoteKind.REPAIR, 7, ends)


@pytest.mark.parametrize("mark", [(0.0, 0.0), (-1.0, -1.0), (639.0, 479.0)])
@pytest.mark.parametrize(
    "lost",
    [[(0, 5)], [(1, 0)], [(1, 1)], [(0, 39)], [(0, 18), (1, 18)], [(1, k) for k in range(25, 40)], [(1, 3), (1, 5)]],
)  # fmt: skip
def test_lost_points_are_left_out(mark, lost):
    f, p, xy = collide()
    gone = np.array([pair in lost for pair in zip(p.tolist(), f.tolist(), strict=True)])
    wrong = np.where(gone[:, None], mark, xy)
    repaired = repair_tracks(as_tracks(f, p, wrong), CAMERA)
    assert_same(repaired, as_tracks(f, p, xy, ~gone))
    (note,) = repaired.notes
    assert note.frames == tuple(sorted({frame for _, frame in lost}))


def test_lost_points_and_an_exchange_together():
    f, p, xy = collide()
    gone = (f == 7) | ((f == 30) & (p == 1))
    wrong = np.where(gone[:, None], 0.0, xy)
    repaired = repair_tracks(as_tracks(f, swapped(p, f >= 19), wrong), CAMERA)
    assert_same(repaired, as_tracks(f, p, xy, ~gone))
    assert len(repaired.notes) == 2


def test_a_number_that_is_reused_becomes_another():
    """The struck ball ends in frame 30; from 33 on its number is that of a ball that lies elsewhere."""
    f, p, xy = collide()
    late = (p == 0) & (f >= 33)
    xy = np.where(late[:, None], [60.0, 50.0] + 0.03 * xy % 0.1, xy)
    kept = ~((p == 0) & (f > 30) & (f < 33))
    repaired = repair_tracks(as_tracks(f, p, xy, kept), CAMERA)
    assert sorted(set(repaired.tracks.particle.tolist())) == [0, 1, 2]
    assert repaired.tracks.frame[repaired.tracks.particle == 2].tolist() == list(range(33, 40))
    assert "number 0 is far from its path in frames 33 to 39; there it becomes number 2" in str(repaired.notes[0])


def test_what_is_not_certain_is_told():
    """At three diameters a frame the paths of two balls may cross between frames."""
    f, p, xy = collide(3.0, b=0.1)
    wrong = as_tracks(f, swapped(p, f >= 10), xy)
    repaired = repair_tracks(wrong, CAMERA)
    assert len(repaired.tracks) == len(wrong)
    assert "may exchange their numbers in frame 10" in " ".join(map(str, repaired.notes))


def test_three_balls_exchange_in_a_ring():
    f, p, xy = collide()
    f, p = np.concatenate([f, f[:FRAMES]]), np.concatenate([p, np.full(FRAMES, 2)])
    xy = np.concatenate([xy, np.random.default_rng(1).normal(100.0, 0.03, (FRAMES, 2))])
    repaired = repair_tracks(as_tracks(f, np.where(f >= 12, (p + 1) % 3, p), xy), CAMERA)
    assert_same(repaired, as_tracks(f, p, xy))


def test_without_a_diameter_nothing_is_done():
    f, p, xy = collide()
    tracks = as_tracks(f, swapped(p, f == 9), xy)
    camera = Camera.from_dict({key: value for key, value in KEYS.items() if key != "ball_diameter"})
    assert repair_tracks(tracks, camera).tracks is tracks


@pytest.mark.parametrize("fault", ["one frame", "for good", "zeros"])
def test_the_measurement_is_that_of_the_true_tracks(fault):
    """Through tracker.measure: the same restitution as without the fault, within its error."""
    import synthcam

    small = {"size": [200, 160], "scale": 3e-4}
    clip = synthcam.Scene.read("painter_behringer", camera=small, timing={"frames": 60, "contact_frame": 20}).draw(1)
    table = clip.tracks[["frame", "particle"]].assign(x=clip.tracks.x_mean_px, y=clip.tracks.y_mean_px)
    table = table.assign(x=table.x + 0.02 * np.random.default_rng(0).standard_normal(len(table)))
    rows = {"one frame": table.frame == 30, "for good": table.frame >= 21, "zeros": table.frame.isin([4, 5, 33])}[fault]
    wrong = table.copy()
    if fault == "zeros":
        wrong.loc[rows & (wrong.particle == 1), ["x", "y"]] = 0.0
    else:
        wrong.loc[rows, "particle"] = 1 - wrong.particle[rows]
    got = tracker.measure(wrong, clip.camera_json)
    assert got.estimates["status"].tolist() == ["ok"]
    row = got.estimates.iloc[0]
    assert abs(row["r"] - clip.truth["r"]) < 4 * row["r_std"]
    assert [note.kind for note in got.notes if note.kind is NoteKind.REPAIR]
    assert isinstance(wrong, pd.DataFrame)
