"""Tables as programs write them: whatever the dialect, the same positions are read."""

import numpy as np
import pandas as pd
import pytest
from tracker_dialects import (
    list_dialects,
    write_deeplabcut,
    write_late_decimals,
    write_lines,
    write_missing,
    write_mot,
    write_qualisys,
    write_trackmate_xml,
)

from synthcam_shared.errors import InputError
from tracker.tables.read import read_tracks
from tracker.tables.table_options import TableOptions

CAMERA = {"fps": 250.0, "size": [640, 480], "scale": 1.6e-4, "ball_diameter": 2.4e-3}
# two balls; the digits are such that each number is written in full by three decimals
ROWS = [(f, b, 300.125 + 2.5 * f * b, 200.625 + 40.25 * b + 0.875 * f) for f in range(12) for b in (0, 1)]
WHOLE = [(f, b, round(x), round(y)) for f, b, x, y in ROWS]


DIALECTS = {"decimals late": write_late_decimals((*WHOLE[:4], *ROWS[4:])), **list_dialects(ROWS)}
PARSEC = write_trackmate_xml(ROWS, "parsec")


def lines(rows=ROWS, *args, **kwargs):
    return write_lines(rows, *args, **kwargs)


def read(text, tmp_path, **wishes):
    path = tmp_path / "tracks.any"
    path.write_text(text)
    given = read_tracks(path, CAMERA, TableOptions(**wishes))
    return given.clips[0][0], [str(note) for note in given.notes]


def assert_all_read(tracks, rows=ROWS, atol=1e-9):
    got = sorted(zip(tracks.frame.tolist(), tracks.x, tracks.y, strict=True))
    want = sorted((f, x, y) for f, _, x, y in rows)
    assert len(got) == len(want)
    assert np.allclose(got, want, rtol=0, atol=atol)
    for ball in np.unique(tracks.particle):
        assert len(set(tracks.frame[tracks.particle == ball].tolist())) == 12
    assert len(np.unique(tracks.particle)) == 2


@pytest.mark.parametrize("name", DIALECTS)
def test_every_dialect_gives_the_same_positions(name, tmp_path):
    tracks, _ = read(DIALECTS[name], tmp_path)
    atol = 0.5 if name == "decimals late" else 1e-9
    assert_all_read(tracks, atol=atol)
    late = tracks.frame > 2
    assert np.allclose(tracks.x[late] % 0.125, 0, atol=1e-9)


def test_missing_values_are_left_out(tmp_path):
    tracks, _ = read(write_missing(ROWS), tmp_path)
    assert len(tracks) == 24 - 7
    assert set(tracks.frame[tracks.particle == 1].tolist()) == {0, 1, 9, 10, 11}


BIG = [(f, b, 10 * x, 10 * y) for f, b, x, y in ROWS]


@pytest.mark.parametrize(
    ("text", "factor"),
    [
        (lines([(f, b, 1000 * x, 1000 * y) for f, b, x, y in ROWS], ";", digits=",.0f"), 1e3),  # 300,125: in doubt
        (lines(BIG, ";", digits=",.2f"), 10),
        (lines([(f, b, 10 * x, 10 * y) for f, b, x, y in ROWS], ";", digits="_.2f").replace("_", " "), 10),
        (lines(BIG, ";", digits="_.2f").replace("_", "'"), 10),
        (lines(BIG, ";", digits=",.2f").translate(str.maketrans(",.", ".,")), 10),
    ],
    ids=["doubt", "comma, point", "blank", "Swiss", "German"],
)
def test_thousands(text, factor, tmp_path):
    doubt = factor == 1e3
    tracks, notes = read(text, tmp_path, unit="px", **({"decimal": "."} if doubt else {}))
    assert_all_read(tracks, [(f, b, factor * x, factor * y) for f, b, x, y in ROWS], atol=1e-2)
    if doubt:
        _, notes = read(text, tmp_path, unit="px")
        assert any("line 2: 300,125 read as 300.125; --decimal ." in note for note in notes)


def test_columns_by_number(tmp_path):
    text = "".join(f"{y},{x},{b},{f},{f * 4}\n" for f, b, x, y in ROWS)
    tracks, _ = read(text, tmp_path, columns="x=2,y=1,frame=4,track=3")
    assert_all_read(tracks)


def test_columns_that_are_guessed_are_told(tmp_path):
    _, notes = read(DIALECTS["no names, trackpy"], tmp_path)
    assert any("frame=7,track=8,x=2,y=3" in note for note in notes)


def test_the_user_overrides_an_unknown_unit(tmp_path):
    tracks, _ = read(PARSEC, tmp_path, unit="px")
    assert_all_read(tracks)


def test_millimetres_in_the_names(tmp_path):
    """On the plate, y upwards: the camera file's scale makes pixels of them."""
    rows = [(f, b, (x - 319.5) * 0.16, (239.5 - y) * 0.16) for f, b, x, y in ROWS]
    tracks, _ = read(lines(rows, head="frame,particle,x (mm),y (mm)", digits=".9f"), tmp_path)
    assert_all_read(tracks, atol=1e-6)


def test_qualisys(tmp_path):
    """Millimetres, z up; 0, 0, 0 where a marker is lost."""
    for names in (False, True):
        text = write_qualisys(ROWS, CAMERA["size"], names, lost=(5, 1))
        tracks, notes = read(text, tmp_path)
        assert len(tracks) == 23
        truth = {(f, b): (x, y) for f, b, x, y in ROWS}
        want = [truth[f, b] for f, b in zip(tracks.frame.tolist(), tracks.particle.tolist(), strict=True)]
        assert np.allclose(tracks.xy, want, atol=1e-4)
        assert "lengths in mm" in " ".join(notes)


def test_low_likelihood_is_not_seen(tmp_path):
    text = write_deeplabcut(ROWS).replace("200.625,0.99", "200.625,0.02", 1)
    tracks, notes = read(text, tmp_path)
    assert len(tracks) == 23
    assert any("1 points have a likelihood under 0.6" in note for note in notes)


def test_binary_tables(tmp_path):
    table = pd.DataFrame(ROWS, columns=["frame", "particle", "x", "y"])
    table.to_feather(tmp_path / "t.feather")
    table.to_parquet(tmp_path / "t.parquet")
    for name in ("t.feather", "t.parquet"):
        assert_all_read(read_tracks(tmp_path / name, CAMERA).clips[0][0])


def test_excel(tmp_path):
    pytest.importorskip("openpyxl")
    pd.DataFrame(ROWS, columns=["frame", "particle", "x", "y"]).to_excel(tmp_path / "t.xlsx", index=False)
    assert_all_read(read_tracks(tmp_path / "t.xlsx", CAMERA).clips[0][0])


def test_trackpy_store(tmp_path):
    pytest.importorskip("tables")
    table = pd.DataFrame(ROWS, columns=["frame", "particle", "x", "y"])
    with pd.HDFStore(tmp_path / "t.h5", "w") as store:
        for frame, rows in table.groupby("frame"):
            store.put(f"Frame_{frame}", rows, format="table", track_times=False)
    assert_all_read(read_tracks(tmp_path / "t.h5", CAMERA).clips[0][0])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (lines().replace("5,1,312.625", "5,1,3l2.625"), "line 13, x: expected numbers, not '3l2.625'"),
        ("# one\n\n" + lines().replace("5,1,312.625", "5,1,3l2.625"), "line 15, x: expected numbers, not '3l2.625'"),
        (lines().replace("\n5,1,", "\n5.5,1,"), "line 13, frame: expected whole numbers from 0 to 2147483647, not 5.5"),
        (lines().replace("\n5,1,", "\n,1,"), "line 13, frame: expected whole numbers"),
        (lines().replace("\n5,1,", "\n5,0,"), "line 13: particle 0 is twice in frame 5"),
        (lines().replace("5,1,312.625", "5,1,7,312.625"), "line 13: 5 cells, expected 4; --columns"),
        (lines().replace("5,1,312.625", "5,1,1e9"), "line 13, x: expected positions in px, not 1e+09; --unit"),
        (lines(head="a,b,c,d"), "--columns x=NAME"),
        ("".join(f"{f} {b} {1 - b} {x} {y}\n" for f, b, x, y in ROWS), "--columns frame=1,track=2,x=3,y=4"),
        (lines().replace(",0,", ",-1,").replace(",1,", ",-1,"), "these are detections, expected tracks"),
        (PARSEC, "'parsec': expected a unit of length, one of px, m, cm, mm, um, nm, in; --unit says"),
        (write_mot(ROWS, 1).replace("2 1 296.625", "2 1 x"), "line 3, left: expected numbers, not 'x'"),
        (write_mot(ROWS, 1).replace("10 10 0", "10 0 0", 1), "line 1: MOTChallenge's boxes: width, height"),
    ],
    ids=range(13),
)  # fmt: skip
def test_a_refusal_names_line_column_value_and_remedy(text, said, tmp_path):
    with pytest.raises(InputError) as error:
        read(text, tmp_path)
    assert said in str(error.value)
    assert "tracks.any" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_large_table_is_read_fast_enough_to_wait_for(tmp_path):
    """The dialect is found from samples and by one search of the text."""
    frame = np.repeat(np.arange(20000), 2)
    table = pd.DataFrame(
        {
            "frame": frame,
            "particle": np.tile([0, 1], 20000),
            "x": frame * 1e-3,
            "y": frame * 2e-3 + np.tile([9, 39], 20000),
        }
    )
    table.to_csv(tmp_path / "t.csv", index=False)
    tracks = read_tracks(tmp_path / "t.csv", CAMERA).clips[0][0]
    assert len(tracks) == 40000
    assert tracks.y[-1] == pytest.approx(39 + 19999 * 2e-3)
