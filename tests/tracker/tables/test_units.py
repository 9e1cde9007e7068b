"""Lengths in another unit than px, and decimals misread: refused with the option that helps, before any fit."""

import numpy as np
import pandas as pd
import pytest

import tracker
from synthcam_shared.errors import InputError
from tracker.detection import contact_distance
from tracker.notes import NoteKind
from tracker.tables.read import read_frame, read_tracks
from tracker.tables.table_options import TableOptions

SCALE, DIAMETER = 1.6e-4, 2.4e-3  # m/px; m: 15 px
CAMERA = {"fps": 250.0, "size": [640, 480], "scale": SCALE, "ball_diameter": DIAMETER}


def table(factor=1.0, nearest=15.2, clips=1):
    """A ball passes another one that rests, px times a factor."""
    frame = np.arange(40)
    passing = np.column_stack([100 + 10.0 * frame, np.full(40, 240.0 + nearest)])
    resting = np.tile([300.0, 240.0], (40, 1))
    xy = factor * np.concatenate([resting, passing])
    rows = pd.DataFrame({"frame": np.tile(frame, 2), "particle": np.repeat([0, 1], 40), "x": xy[:, 0], "y": xy[:, 1]})
    return pd.concat([rows.assign(clip=clip) for clip in range(clips)])


def written(rows, tmp_path):
    rows.to_csv(tmp_path / "t.csv", index=False)
    return tmp_path / "t.csv"


@pytest.mark.parametrize(("unit", "metre"), [("mm", 1e-3), ("cm", 1e-2), ("um", 1e-6)])
def test_other_units_are_named_at_once(unit, metre, tmp_path):
    path = written(table(SCALE / metre), tmp_path)
    with pytest.raises(InputError, match=f"positions look like {unit}: .*`tracker measure --unit {unit}` reads them"):
        read_tracks(path, CAMERA)
    with pytest.raises(InputError, match=f"look like {unit}"):
        tracker.measure(table(SCALE / metre), CAMERA)
    assert read_tracks(path, CAMERA, TableOptions(unit=unit)).camera.metric
    assert len(read_tracks(path, CAMERA, TableOptions(unit="px")).clips[0][0]) == 80


@pytest.mark.parametrize("nearest", [15.2, 13.0, 60.0, 200.0])
def test_pixels_are_pixels(nearest, tmp_path):
    """At a hit, with a scale that is a little wrong, and of balls that pass far from each other."""
    read = read_tracks(written(table(nearest=nearest), tmp_path), CAMERA)
    assert len(read.clips[0][0]) == 80
    assert read.notes == ()


def test_millimetres_are_named_if_few_frames_show_the_hit(tmp_path):
    """The balls move by two diameters in a frame, so that no frame shows them as near as one."""
    rows = table(SCALE / 1e-3, nearest=20.0)
    rows = rows[rows.frame % 3 == 1].assign(frame=lambda t: t.frame // 3)
    with pytest.raises(InputError, match=r"look like mm: the balls come as near as 3\.2;"):
        tracker.measure(rows, CAMERA)


@pytest.mark.parametrize("scale", [0.7e-3, 0.8e-3, 1.2e-3, 1.5e-3, 3e-3])
def test_millimetres_of_about_a_pixel_are_noted(scale, tmp_path):
    """A number in mm is then possible as one in px, too; the note names the unit in which the balls would touch."""
    rows, camera = table(SCALE / 1e-3), CAMERA | {"scale": scale}
    (note,) = read_tracks(written(rows, tmp_path), camera).notes
    assert f"as near as 2.43; expected px, and {DIAMETER / scale:.3g} of them" in str(note)
    assert "Either positions are in mm, and `tracker measure --unit mm` reads them" in str(note)
    assert f"and scale is about 0.000987 m/px rather than {scale:.3g}" in str(note)
    assert read_tracks(tmp_path / "t.csv", camera, TableOptions(unit="px")).notes == ()


def hit(noise=0.02, clips=1):
    """A ball of 24 mm hits another one in the middle, by elastic impact, mm: it stops, and the other one goes on."""
    rng, frame = np.random.default_rng(4), np.arange(40)
    since = 12.3 * (frame - 20.37)
    striker, struck = np.minimum(since, 0), np.maximum(since, 0) + 24.0
    rows = []
    for clip in range(clips):
        for ball, along in enumerate((struck, striker)):
            x, y = np.array([[200.0], [150.0]]) + np.outer([0.8, 0.6], along) + rng.normal(0, noise, (2, 40))
            rows.append(pd.DataFrame({"clip": clip, "frame": frame, "particle": ball, "x": x, "y": y}))
    return pd.concat(rows)


BALL = CAMERA | {"ball_diameter": 0.024}


@pytest.mark.parametrize("scale", [0.96e-3, 0.985e-3, 1.01e-3, 1.05e-3])
def test_where_px_and_mm_are_near_both_are_named(scale):
    """A table in mm or in px of about 1 mm, which nothing can distinguish."""
    (note,) = read_frame(hit(), BALL | {"scale": scale}).notes
    expected = f"the balls touch at 24, which is a diameter both in px ({0.024 / scale:.3g}) and in mm (24)"
    assert str(note) == f"{expected}; --unit px or --unit mm says which it is"
    assert read_frame(hit(), BALL | {"scale": 1e-3}).notes == ()  # the same lengths either way


@pytest.mark.parametrize("scale", [0.85e-3, 1.15e-3])
def test_a_scale_that_is_wrong_is_named_beside_the_unit(scale):
    (note,) = read_frame(hit(), BALL | {"scale": scale}).notes
    assert "in mm, and `tracker measure --unit mm` reads them; or they are in px, and scale is about 0.001 " in str(
        note
    )


def test_a_diameter_that_is_wrong_is_no_unit():
    """At 0.16 mm/px, balls of 24 mm and not of 4.8 mm would touch at 30 mm, about the distance in px."""
    rows, camera = hit(), CAMERA | {"ball_diameter": 24 * SCALE}
    assert read_frame(rows, camera).notes == ()
    (note,) = read_frame(rows, camera | {"ball_diameter": 5 * 24 * SCALE}).notes
    wrong = "Either scale is about 0.0008 m/px rather than 0.00016, or ball_diameter 0.00384 m rather than 0.0192"
    assert str(note).endswith(f"no unit explains that. {wrong}")


def test_tracks_longer_than_the_picture_are_in_another_unit():
    """Balls pass at 15.2 px, which would be about a diameter in mm, but 390 mm are four times the picture."""
    (note,) = read_frame(table(), CAMERA | {"ball_diameter": 5 * DIAMETER}).notes
    assert "as near as 15.2; expected px, and 75 of them, a diameter; check scale and ball_diameter" in str(note)


@pytest.mark.parametrize("last", [20, 39])
def test_exchanged_numbers_are_no_wrong_unit(last):
    """Numbers jump to the other ball in some frames, or from the contact on: in between the balls do not pass."""
    rows = table()
    exchanged = rows.frame.between(20, last)
    rows.loc[exchanged, "particle"] = 1 - rows.particle[exchanged]
    assert read_frame(rows, CAMERA).notes == ()


def test_balls_that_overlap_are_noted_with_what_to_check(tmp_path):
    """One ball found twice, or a wrong scale: no unit explains it."""
    read = read_tracks(written(table(nearest=1.0), tmp_path), CAMERA)
    assert len(read.clips[0][0]) == 80
    (note,) = read.notes
    assert "as near as 1; expected px, and 15 of them, a diameter; check scale and ball_diameter" in str(note)


@pytest.mark.parametrize(("side", "overlap"), [(100.0, True), (600.0, False)])
def test_a_crowd_of_balls_that_overlap_is_noted(side, overlap):
    """Forty balls in 100 px x 100 px, where six times six have room; the scale is too small."""
    rng = np.random.default_rng(0)
    start = rng.uniform(0, side, (40, 2)) if overlap else 40 + 80 * np.stack(np.divmod(np.arange(40), 7), 1)
    xy = np.concatenate([start + k * rng.normal(0, 0.1, (40, 2)) for k in range(5)])
    rows = pd.DataFrame(
        {"frame": np.repeat(range(5), 40), "particle": np.tile(range(40), 5), "x": xy.T[0], "y": xy.T[1]}
    )
    notes = [str(note) for note in read_frame(rows, CAMERA, TableOptions(unit="px")).notes]
    assert len(notes) == overlap
    assert not overlap or "balls overlap: 8" in notes[0]


def test_thousands_beside_whole_numbers_are_thousands(tmp_path):
    rows = table(3).assign(x=lambda t: t["x"].map("{:,.0f}".format), y=lambda t: t["y"].map("{:,.0f}".format))
    rows.to_csv(tmp_path / "t.csv", index=False, sep=";")
    tracks = read_tracks(tmp_path / "t.csv", CAMERA, TableOptions(unit="px")).clips[0][0]
    assert np.allclose(tracks.xy, table(3)[["x", "y"]], atol=0.5)


def test_a_thousands_separator_read_as_a_decimal_point_is_refused(tmp_path):
    rows = table(25).assign(x=lambda t: (1.0 * t["x"]).map("{:,.0f}".format), y=lambda t: t["y"].map("{:,.0f}".format))
    rows[rows["x"].str.contains(",")].to_csv(tmp_path / "t.csv", index=False, sep=";")
    with pytest.raises(InputError, match=r"all balls lie within 9.*--decimal the decimal mark"):
        read_tracks(tmp_path / "t.csv", CAMERA)


def test_positions_far_outside_the_picture_are_refused(tmp_path):
    with pytest.raises(InputError, match="beyond twice the picture of 640 px; --unit"):
        read_tracks(written(table(7), tmp_path), CAMERA)


def test_who_strikes_is_asked_at_once(tmp_path):
    def kinds(rows, camera=CAMERA):
        return [note.kind for note in read_tracks(written(rows, tmp_path), camera).notes]

    assert kinds(table(clips=3)) == [NoteKind.STRIKER]
    (note,) = read_tracks(tmp_path / "t.csv", CAMERA).notes
    assert "no column striker, so that ball b counts" in str(note)
    assert "add a column striker (a or b" in str(note)
    assert kinds(table(clips=1)) == []
    assert kinds(table(clips=3).assign(striker="a")) == []
    assert kinds(table(clips=3), CAMERA | {"striker": "b"}) == []


@pytest.mark.usefixtures("not_local")
@pytest.mark.parametrize("factor", [0.02, *(pytest.param(k, marks=pytest.mark.gate) for k in (0.05, 0.1)), 0.3])
def test_ok_is_never_without_a_value(factor):
    """Whatever the unit is taken for: `ok` has at least one of v0, b, r, mu_k, C."""
    import synthcam

    small = {"size": [200, 160], "scale": 3e-4}
    clip = synthcam.Scene.read("painter_behringer", camera=small, timing={"frames": 60, "contact_frame": 20}).draw(1)
    rows = clip.tracks[["frame", "particle"]].assign(x=clip.tracks.x_mean_px, y=clip.tracks.y_mean_px)
    noise = np.random.default_rng(0).normal(0, 0.02, (2, len(rows)))
    rows = rows.assign(x=factor * rows.x + noise[0], y=factor * rows.y + noise[1])
    (row,) = tracker.measure(rows, clip.camera_json, unit="px").estimates.to_dict("records")
    values = [row[f"{name}{kind}"] for name in ("v0", "b", "r", "mu_k", "C") for kind in ("", "_free")]
    assert row["status"] != "ok" or np.isfinite(values).any()


def test_the_nearest_approaches_of_a_long_table_show_the_contact(monkeypatch):
    """A hit, before which the balls go round side by side: noise alone makes hundreds of approaches."""
    looked = []
    monkeypatch.setattr(
        contact_distance, "_touch", lambda *given, whole=contact_distance._touch: looked.append(0) or whole(*given)
    )
    rows, count = hit(), 12000
    frame, rng = np.arange(count), np.random.default_rng(1)
    for ball in (0, 1):
        way = 300 * np.array([np.cos(frame / 25), np.sin(frame / 25)]) + [[350.0], [350.0 + 100 * ball]]
        x, y = way + rng.normal(0, 0.02, (2, count))
        before = pd.DataFrame({"clip": 0, "frame": frame - count - 20, "particle": ball, "x": x, "y": y})
        rows = pd.concat([rows, before])
    rows["frame"] += count + 20
    (note,) = read_frame(rows, BALL | {"scale": 0.85e-3}).notes
    assert "the balls touch at 24;" in str(note)
    assert "and scale is about 0.001 " in str(note)
    assert len(looked) <= 100
