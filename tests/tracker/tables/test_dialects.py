"""Tables as programs write them: whatever the dialect, the same positions are read."""

import numpy as np
import pandas as pd
import pytest

from synthcam_shared.errors import InputError
from tracker.tables.read import read_tracks
from tracker.tables.table_options import TableOptions

CAMERA = {"fps": 250.0, "size": [640, 480], "scale": 1.6e-4, "ball_diameter": 2.4e-3}
# two balls; the digits are such that each number is written in full by three decimals
ROWS = [(f, b, 300.125 + 2.5 * f * b, 200.625 + 40.25 * b + 0.875 * f) for f in range(12) for b in (0, 1)]
WHOLE = [(f, b, round(x), round(y)) for f, b, x, y in ROWS]


def lines(rows=ROWS, mark=",", point=".", head="frame,particle,x,y", digits=".3f"):
    def number(value):
        return format(value, digits).replace(".", point)

    body = [mark.join([f"{f}", f"{b}", number(x), number(y)]) for f, b, x, y in rows]
    return "\n".join([*([head.replace(",", mark)] if head else []), *body]) + "\n"


def late_decimals():
    """The first numbers are whole and written without decimals; the sixth line has the first decimal comma."""
    text = [f"{f};{b};{x:g};{y:g}".replace(".", ",") for f, b, x, y in (*WHOLE[:4], *ROWS[4:])]
    return "frame;particle;x;y\n" + "\n".join(text)


def savetxt(header="frame particle x y"):
    return f"# {header}\n" + "".join(f"{f:.18e} {b:.18e} {x:.18e} {y:.18e}\n" for f, b, x, y in ROWS)


def trackpy_without_header():
    """As DataFrame.to_csv(header=False, sep=tab, decimal=comma) of trackpy writes: index, x, y, mass, ..."""
    extra = [f"{1000.5 + k}\t4.17\t0.21" for k in range(len(ROWS))]
    rows = [f"{k}\t{x}\t{y}\t{extra[k]}\t{f}\t{b}" for k, (f, b, x, y) in enumerate(ROWS)]
    return "\n".join(rows).replace(".", ",")


def wide(head="seconds,x1,y1,x2,y2", mark=",", first=lambda f: f"{f / 250:g}"):
    by = {(f, b): f"{x}{mark}{y}" for f, b, x, y in ROWS}
    return (head + "\n" if head else "") + "".join(mark.join([first(f), by[f, 0], by[f, 1]]) + "\n" for f in range(12))


def deeplabcut(individuals=True):
    heads = ["scorer," + ",".join(["net"] * 6)]
    if individuals:
        heads.append("individuals,a,a,a,b,b,b")
        heads.append("bodyparts" + ",centre" * 6)
    else:
        heads.append("bodyparts,a,a,a,b,b,b")
    heads.append("coords,x,y,likelihood,x,y,likelihood")
    by = {(f, b): f"{x},{y},0.99" for f, b, x, y in ROWS}
    return "\n".join([*heads, *(f"{f},{by[f, 0]},{by[f, 1]}" for f in range(12))]) + "\n"


def trackmate_german(unit="(pixel)"):
    head = ["LABEL;ID;TRACK_ID;POSITION_X;POSITION_Y;FRAME", "Label;ID;Track;X;Y;Frame", "Label;ID;Track;X;Y;Frame"]
    rows = [f"ID{k};{k};{b};{x:.3f};{y:.3f};{f}".replace(".", ",") for k, (f, b, x, y) in enumerate(ROWS)]
    return "\n".join([*head, f";;;{unit};{unit};", *rows])


def trackmate_xml(unit):
    inner = ""
    for ball in (0, 1):
        own = "".join(f'<detection t="{f}" x="{x}" y="{y}" z="0"/>' for f, b, x, y in ROWS if b == ball)
        inner += f"<particle>{own}</particle>"
    return f'<Tracks nTracks="2" spaceUnits="{unit}" frameInterval="0.004" timeUnits="sec">{inner}</Tracks>'


def mot(first=0, confidence=0):
    return "".join(f"{f + first} {b + 1} {x - 5 + 1.5} {y - 5 + 1.5} 10 10 {confidence} -1 -1\n" for f, b, x, y in ROWS)


def quoted():
    body = [f'{f},{b},"{x}","{y}"'.replace(".", ",") for f, b, x, y in ROWS]
    return "\n".join(["frame,particle,x,y", *body])


def many_ids():
    return lines() + "3,-1,17.5,18.5\n4,-1,600.5,1.5\n"


DIALECTS = {
    "decimals late": late_decimals(),
    "sep=": "sep=;\n" + lines(mark=";"),
    "comments": "# made by lab software 3.1\n% fps 250\n" + lines(),
    "comment between": lines().replace("\n3,", "\n# paused\n\n3,", 1),
    "blanks": lines(mark=", "),
    "names with units": lines(head='frame,particle,"x, px","y, px"'),
    "names in brackets": lines(head="Frame,Particle,X (px),Y [px]"),
    "other names": lines(head="frame_number,track_id,pos_x,pos_y"),
    "quoted": lines(head='"frame","particle","x","y"'),
    "savetxt": savetxt(),
    "savetxt, no names": savetxt("fps 250"),
    "padded columns": "frame particle x y\n" + "".join(f"{f:6d}{b:6d}{x:14.3f}{y:14.3f}\n" for f, b, x, y in ROWS),
    "no names": lines(head="", mark="\t"),
    "no names, trackpy": trackpy_without_header(),
    "pipes": lines(mark=" | "),
    "blanks, decimal comma": lines(mark=" ", point=","),
    "quoted decimal comma": quoted(),
    "trailing delimiters": lines().replace("\n", ",\n"),
    "trailing delimiters but names": lines().replace("\n", ",\n").replace("y,\n", "y\n", 1),
    "row numbers without a name": lines().replace("\n", "\n7,").removesuffix("7,"),
    "ids of -1": many_ids(),
    "names of balls": lines().replace(",0,", ",left,").replace(",1,", ",right,"),
    "wide": wide(),
    "wide, idTracker": wide("X1\tY1\tX2\tY2", "\t", lambda f: "").replace("\n\t", "\n"),
    "wide, named": wide("frame,red_x,red_y,blue_x,blue_y", first=str),
    "DeepLabCut": deeplabcut(),
    "DeepLabCut, one animal": deeplabcut(individuals=False),
    "German TrackMate": trackmate_german(),
    "TrackMate without unit": trackmate_german("()"),
    "TrackMate, unit": trackmate_xml("unit"),
    "TrackMate, a.u.": trackmate_xml("a.u."),
    "TrackMate, no unit": trackmate_xml(""),
    "MOT from 0": mot(0),
    "MOT, confidence 0": mot(1),
}  # fmt: skip


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
    text = lines()
    for f, mark in ((2, "-"), (3, ""), (4, "NA"), (5, "--"), (6, "nan"), (7, "None"), (8, "?")):
        text = "\n".join(f"{f},1,{mark},{mark}" if line.startswith(f"{f},1,") else line for line in text.split("\n"))
    tracks, _ = read(text, tmp_path)
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
    tracks, _ = read(trackmate_xml("parsec"), tmp_path, unit="px")
    assert_all_read(tracks)


def test_millimetres_in_the_names(tmp_path):
    """On the plate, y upwards: the camera file's scale makes pixels of them."""
    rows = [(f, b, (x - 319.5) * 0.16, (239.5 - y) * 0.16) for f, b, x, y in ROWS]
    tracks, _ = read(lines(rows, head="frame,particle,x (mm),y (mm)", digits=".9f"), tmp_path)
    assert_all_read(tracks, atol=1e-6)


def test_qualisys(tmp_path):
    """Millimetres, z up; 0, 0, 0 where a marker is lost."""
    by = {(f, b): f"{(x - 319.5) * 0.16:.6f}\t{(239.5 - y) * 0.16:.6f}\t1.190" for f, b, x, y in ROWS}
    by[5, 1] = "0.000\t0.000\t0.000"
    head = "NO_OF_FRAMES\t12\nNO_OF_MARKERS\t2\nFREQUENCY\t250\nDATA_INCLUDED\t3D\nMARKER_NAMES\tA\tB\n"
    for names, first in (("", False), ("Frame\tTime\tA X\tA Y\tA Z\tB X\tB Y\tB Z\n", True)):
        text = head + names + "".join(
            (f"{f + 1}\t{f / 250:.5f}\t" if first else "") + f"{by[f, 0]}\t{by[f, 1]}\n" for f in range(12)
        )  # fmt: skip
        tracks, notes = read(text, tmp_path)
        assert len(tracks) == 23
        truth = {(f, b): (x, y) for f, b, x, y in ROWS}
        want = [truth[f, b] for f, b in zip(tracks.frame.tolist(), tracks.particle.tolist(), strict=True)]
        assert np.allclose(tracks.xy, want, atol=1e-4)
        assert "lengths in mm" in " ".join(notes)


def test_low_likelihood_is_not_seen(tmp_path):
    text = deeplabcut().replace("200.625,0.99", "200.625,0.02", 1)
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
        (trackmate_xml("parsec"), "'parsec': expected a unit of length, one of px, m, cm, mm, um, nm, in; --unit says"),
        (mot(1).replace("2 1 296.625", "2 1 x"), "line 3, left: expected numbers, not 'x'"),
        (mot(1).replace("10 10 0", "10 0 0", 1), "line 1: MOTChallenge's boxes: width, height"),
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
