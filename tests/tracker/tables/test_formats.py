"""One clip as other programs write it: whatever the format, the same is measured."""

import numpy as np
import pandas as pd
import pytest
from tracker_tables import (
    MIDDLE,
    SCALE,
    SIZE,
    mot,
    osp_marks,
    osp_table,
    plain,
    ptc,
    trackmate_csv,
    trackmate_model,
    trackmate_tracks,
)

import synthcam
import tracker
from synthcam_shared.errors import InputError
from tracker.tables.read import read_frame, read_tracks
from tracker.tables.table_options import TableOptions

SCENE = synthcam.Scene.read(
    "painter_behringer", camera={"size": list(SIZE), "scale": SCALE}, timing={"frames": 60, "contact_frame": 20}
)
QUANTITIES = ["v0", "b", "r", "mu_k", "t_c"]
NOISE = 0.02  # px


@pytest.fixture(scope="module")
def clip():
    return SCENE.draw(1, 3)


@pytest.fixture(scope="module")
def rows(clip):
    truth, rng = clip.tracks, np.random.default_rng(0)
    x, y = (truth[name] + NOISE * rng.standard_normal(len(truth)) for name in ("x_mean_px", "y_mean_px"))
    return list(zip(truth["frame"].tolist(), truth["particle"].tolist(), x.tolist(), y.tolist(), strict=True))


@pytest.fixture(scope="module")
def camera(clip):
    return clip.camera_json


@pytest.fixture(scope="module")
def measured(rows, camera):
    return tracker.measure(pd.DataFrame(rows, columns=["frame", "particle", "x", "y"]), camera).estimates


def metres(rows, unit=1.0):
    lines = ["POS_X;POS_Y;FRAME;TRACK_ID"]
    for f, b, x, y in rows:
        place = f"{(x - MIDDLE[0]) * SCALE / unit:.12g};{(MIDDLE[1] - y) * SCALE / unit:.12g}"
        lines.append(f"{place};{f};ball {b}")
    return "\n".join(lines).replace(".", ",")


FORMATS = {
    "commas": (plain, {}),
    "semicolons": (lambda rows: plain(rows, ";"), {}),
    "decimal commas": (lambda rows: plain(rows, ";", ","), {}),
    "tabs": (lambda rows: plain(rows, "\t"), {}),
    "UTF-8 with a mark": (lambda rows: "\ufeff" + plain(rows), {}),
    "TrackMate's CSV": (trackmate_csv, {}),
    "TrackMate's old CSV": (lambda rows: trackmate_csv(rows, 1), {}),
    "TrackMate's model": (trackmate_model, {}),
    "TrackMate's tracks": (trackmate_tracks, {}),
    "Particle Tracking Challenge": (ptc, {}),
    "MOTChallenge": (mot, {}),
    "Tracker's marks": (osp_marks, {}),
    "Tracker's table": (osp_table, {}),
    "Tracker's table, local": (lambda rows: osp_table(rows, ";", ","), {}),
    "Tracker's table, spaces": (lambda rows: osp_table(rows, ","), {}),
    "Tracker's table, mm": (lambda rows: osp_table(rows, scale=1e3 * SCALE), {"unit": "mm"}),
    "Tracker's table, no scale": (lambda rows: osp_table(rows, scale=1.0), {"unit": "px"}),
    "named columns": (
        lambda rows: plain(rows).replace("frame,particle,x,y", "f,id,u,v"),
        {"columns": "frame=f,track=id,x=u,y=v"},
    ),
}


@pytest.mark.usefixtures("not_local")
@pytest.mark.parametrize("name", FORMATS)
def test_the_same_is_measured(name, rows, camera, measured, tmp_path):
    write, wishes = FORMATS[name]
    path = tmp_path / "tracks.any"
    path.write_text(write(rows), encoding="utf-8")
    tracks, _ = read_tracks(path, camera, TableOptions(**wishes)).clips[0]
    places = sorted((frame, *place) for frame, _, *place in rows)
    assert np.allclose(sorted(zip(tracks.frame, tracks.x, tracks.y, strict=True)), places, rtol=0, atol=1e-5)
    found = tracker.measure(path, camera, **wishes).estimates
    assert found["status"].tolist() == ["ok"]
    assert np.allclose(found[QUANTITIES], measured[QUANTITIES], rtol=1e-5, atol=1e-7)
    stds = [f"{name}_std" for name in QUANTITIES]
    assert np.allclose(found[stds], measured[stds], rtol=1e-3)


@pytest.mark.parametrize(("unit", "metre"), [("m", 1.0), ("mm", 1e-3), ("cm", 1e-2)])
def test_tables_in_metres(unit, metre, rows, camera, measured, tmp_path):
    """They are on the plate, y upwards; names of balls may be words."""
    path = tmp_path / "tracks.txt"
    path.write_text(metres(rows, metre), encoding="latin-1")
    wishes = {"columns": "x=POS_X,y=POS_Y,frame=FRAME,track=TRACK_ID", "unit": unit}
    found = tracker.measure(path, camera, **wishes).estimates
    assert np.allclose(found[QUANTITIES], measured[QUANTITIES], rtol=1e-5, atol=1e-7)


def test_metres_need_no_picture(rows, camera, measured, tmp_path):
    path = tmp_path / "tracks.txt"
    path.write_text(osp_table(rows))
    found = tracker.measure(path, {"fps": camera["fps"], "ball_diameter": camera["ball_diameter"]})
    assert np.allclose(found.estimates[["v0", "b", "r"]], measured[["v0", "b", "r"]], rtol=1e-3)


def test_lengths_of_another_unit_are_named(rows, tmp_path):
    path = tmp_path / "tracks.txt"
    path.write_text(osp_table(rows, scale=1e2))
    with pytest.raises(InputError, match=r"m, expected positions on a plate; --unit says"):
        read_tracks(path, {"fps": 250})


def test_what_was_read_is_told(rows, camera, tmp_path):
    path = tmp_path / "tracks.xml"
    path.write_text(trackmate_model(rows))
    assert "tracks.xml: read as TrackMate's XML, lengths in um" in map(str, tracker.measure(path, camera).notes)
    slow = map(str, tracker.measure(path, camera | {"fps": 240.0, "exposure": 0.0}).notes)
    assert "fps: 240 in the camera file, 250 in tracks.xml; the camera file's is used" in slow
    path.write_text(osp_table(rows))
    exported = "tracks.xml: read as Tracker (OSP): exported table, lengths in m; argument unit if not so"
    assert exported in map(str, tracker.measure(path, camera).notes)


def test_printed_times_are_evened_out(rows, camera, measured, tmp_path):
    """Here up to a thirteenth of a frame off, as at 250 frames a second where the fourth digit is the last."""
    path = tmp_path / "tracks.txt"
    path.write_text(osp_table(rows, late=lambda frame: 3e-4 * (frame % 3 - 1)))
    found = tracker.measure(path, camera).estimates
    assert np.allclose(found[QUANTITIES], measured[QUANTITIES], rtol=1e-5, atol=1e-7)
    slow = camera | {"fps": 125.0}  # frames at twice the time of the camera file's: the table's times are those used
    found = tracker.measure(path, slow).estimates
    assert np.allclose(found[QUANTITIES], measured[QUANTITIES], rtol=1e-3)


def test_uneven_times_stay(rows, camera, measured, tmp_path):
    path = tmp_path / "tracks.txt"
    path.write_text(osp_table(rows, late=lambda frame: 2e-3 * (frame > 40)))
    tracks, _ = read_tracks(path, camera).clips[0]
    given = [frame / 250 + 2e-3 * (frame > 40) for frame, *_ in sorted(rows, key=lambda row: row[1::-1])]
    assert np.allclose(tracks.time, given, rtol=0, atol=1e-9)


def test_errors_of_trackpy_are_used(rows, camera, tmp_path):
    table = pd.DataFrame(rows, columns=["frame", "particle", "x", "y"]).assign(ep=NOISE)
    row = tracker.measure(table.assign(x_std=NOISE, y_std=NOISE), camera).estimates.iloc[0]
    table.to_csv(tmp_path / "trackpy.csv")
    by_ep = tracker.measure(tmp_path / "trackpy.csv", camera).estimates.iloc[0]
    assert by_ep["noise"] == row["noise"] == "given"
    assert by_ep["r_std"] == pytest.approx(row["r_std"])
    table.assign(ep=-1.0).to_csv(tmp_path / "unknown.csv")
    assert tracker.measure(tmp_path / "unknown.csv", camera).estimates["noise"][0] == "scatter"


def test_one_mass_alone(tmp_path, camera):
    """Tracker 5: the mass's name with no delimiter, one mass a file; positions that are missing are left out."""
    path = tmp_path / "cm_A.txt"
    path.write_text("cm_A\nt\tx\ty\n0.000E0\t1.2E-3\t-1.5E-3\n4.0E-3\t\t\n8.0E-3\t1.4E-3\t-1.1E-3\n")
    tracks, _ = read_tracks(path, camera).clips[0]
    assert tracks.frame.tolist() == [0, 2]
    assert np.allclose(tracks.x, MIDDLE[0] + np.array([1.2, 1.4]) / 0.3)
    assert np.allclose(tracks.y, MIDDLE[1] + np.array([1.5, 1.1]) / 0.3)


WRONG = {
    "<TrackMate/>": "without <Model>",
    "<kml/>": "XML of <kml>, expected one of TrackMate's XML",
    '<Tracks spaceUnits="pixel"><particle><detection t="0" x="1"/></particle></Tracks>': "<detection> without y",
    '<Tracks spaceUnits="pixel"><particle><detection t="0" x="one" y="1"/></particle></Tracks>': "x: expected a number",
    '<Tracks spaceUnits="parsec"/>': "'parsec': expected a unit of length",
    '<Tracks spaceUnits="pixel"><particle>': "damaged XML",
    '<?xml version="1.0" encoding="klingon"?><Tracks/>': "damaged XML",
    '<?xml version="1.0" encoding="UTF-8"?><Tracks spaceUnits="\xb5m"/>': "damaged XML",
    '<Tracks spaceUnits="pixel"><particle><detection t="1e99" x="1" y="1"/></particle></Tracks>': "frame: expected",
    '<Tracks spaceUnits="pixel"><particle><detection t="0" x="1e300" y="1"/></particle></Tracks>': "positions in px",
    '<Tracks spaceUnits="pixel"><particle><detection t="NaN" x="1" y="1"/></particle></Tracks>': "frame: expected",
    "<!DOCTYPE a [<!ENTITY b 'c'>]><Tracks>&b;</Tracks>": "a document type",
    '<!DOCTYPE a SYSTEM "file:///etc/passwd"><Tracks/>': "a document type",
    "<a>" * 100000: "nested too deeply",
    "1,1,10,10,0,5,1,-1,-1,-1": "width, height",
    "1,-1,10,10,5,5,1,-1,-1,-1": "these are detections",
    "LABEL,ID,TRACK_ID,POSITION_X\na,1,2,3": "without FRAME, POSITION_Y",
    "LABEL,ID,TRACK_ID,POSITION_X,POSITION_Y,FRAME\na,b,c,d,e,f": "FRAME: expected numbers, not 'f'",
    "mass A\nt\tx\ty\n1\t2\t3\n": "a time in s",
    "mass A\nt\tx\ty\nfour\t2\t3\n": "t: expected numbers",
    "u,v\n1,2\n": "--columns x=NAME",
    "PK\3\4": "an archive",
    "PAR1": "cannot be read",
}


@pytest.mark.parametrize("text", WRONG, ids=range(len(WRONG)))
def test_what_is_wrong_is_one_line(text, tmp_path, camera):
    path = tmp_path / "tracks.xml"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError) as error:
        read_tracks(path, camera)
    assert str(error.value).startswith(str(path))
    assert WRONG[text] in str(error.value)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 400


def test_entities_that_grow_are_not_read(tmp_path, camera):
    """Ten levels of ten: a file of 800 bytes that would fill the memory."""
    levels = "".join(f'<!ENTITY a{k + 1} "{f"&a{k};" * 10}">' for k in range(10))
    bomb = f'<!DOCTYPE a [<!ENTITY a0 "ball">{levels}]><Tracks spaceUnits="&a10;"/>'
    path = tmp_path / "tracks.xml"
    path.write_text(bomb)
    with pytest.raises(InputError, match="a document type"):
        read_tracks(path, camera)


@pytest.mark.parametrize("write", [trackmate_csv, trackmate_model, mot, osp_marks, osp_table, plain])
def test_damaged_files_end_in_one_line(write, rows, camera, tmp_path):
    rng, path = np.random.default_rng(0), tmp_path / "tracks.any"
    text, said = write(rows[:24]).encode(), []
    for _ in range(60):
        at, many = rng.integers(0, len(text), 3), rng.integers(1, 40, 3)
        odd = rng.choice([b"9" * 20, b"nan", b"-inf", b"\n", b",", b";", b"<", b"1e999", b"\xff", b"e9"])
        damaged = bytearray(text)
        damaged[at[0] : at[0]] = odd
        del damaged[at[1] : at[1] + many[1]]
        damaged[at[2] : at[2]] = text[at[0] : at[0] + many[2]]
        path.write_bytes(damaged)
        try:
            read_tracks(path, camera)
        except InputError as error:
            said.append(str(error))
    assert len(said) > 5
    assert all(line.startswith(str(path)) and "\n" not in line for line in said)


def test_microns_of_which_one_is_missing(rows, camera, tmp_path):
    path = tmp_path / "tracks.csv"
    path.write_text(trackmate_csv(rows).replace("(micron),(micron),(micron),(sec)", ",(micron),(micron),(sec)"))
    with pytest.raises(InputError, match="positions look like um"):
        read_tracks(path, camera)
    assert "lengths in px" in str(read_tracks(path, camera, TableOptions(unit="px")).notes[0])


@pytest.mark.parametrize("cut", [0.1, 0.5, 0.9, 0.999])
@pytest.mark.parametrize("write", [trackmate_model, ptc, osp_marks])
def test_files_cut_short(write, cut, rows, camera, tmp_path):
    text = write(rows)
    path = tmp_path / "tracks.xml"
    path.write_text(text[: int(cut * len(text))])
    with pytest.raises(InputError, match="damaged XML"):
        read_tracks(path, camera)


def test_edges_that_lead_nowhere(rows, camera, tmp_path):
    path = tmp_path / "tracks.xml"
    path.write_text(trackmate_model(rows).replace('SPOT_TARGET_ID="1"', 'SPOT_TARGET_ID="77777"'))
    with pytest.raises(InputError, match="names spot 77777, which there is not"):
        read_tracks(path, camera)


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ("x=a,y=b", "by --columns: no column frame, particle"),
        ("x=a,y=b,frame=c,track=e", "no column e, as --columns says; found a, b, c, d"),
        ("z=a", "--columns: 'z': expected NAME=COLUMN of frame"),
        ("x", "--columns: 'x': expected NAME=COLUMN of frame"),
        ("x=a,y=b,frame=c,partcle=d", "did you mean particle?"),
    ],
)
def test_wrong_names_of_columns(columns, said, tmp_path, camera):
    path = tmp_path / "tracks.csv"
    path.write_text("a,b,c,d\n1,2,0,0\n")
    with pytest.raises(InputError) as error:
        read_tracks(path, camera, TableOptions(columns=columns))
    assert said in str(error.value)


@pytest.mark.parametrize(("rate", "told"), [(240, ["240 by t_s in tracks; its times are used"]), (249, []), (None, [])])
def test_times_of_a_table_are_checked_against_the_frame_rate(rate, told, camera):
    rows = pd.DataFrame({"frame": np.arange(30), "particle": 0, "x": np.linspace(20, 150, 30), "y": 50.0})
    if rate:
        rows = rows.assign(t_s=np.arange(30) / rate)
    given = camera | {"fps": 250.0, "exposure": 0.0}
    notes = [str(note) for note in read_frame(rows, given).notes]
    assert notes == [f"fps: 250 in the camera file, {text}" for text in told]
