"""A table of any program held to one of any program, from files, by the command."""

import json
import shlex
import sys

import numpy as np
import pytest

from synthcam_shared.errors import InputError
from tracker.cli import main
from tracker.scoring.external_tables import score_table

TRUE = [(f, k, 10.0 + 8 * f, 20.0 + 30 * k) for f in range(6) for k in (0, 1)]
FOUND = [(f, 5 + k, x + 0.3, y - 0.4) for f, k, x, y in TRUE if (f, k) != (3, 1)] + [(2, 9, 100.0, 100.0)]


def as_csv(rows):
    return "frame,particle,x,y\n" + "".join(f"{f},{k},{x},{y}\n" for f, k, x, y in rows)


def as_mot(rows):
    """Boxes of 10 x 10 px; the corner of the picture is (1, 1) in frames counted from 1."""
    return "".join(f"{f + 1},{k + 1},{x - 5 + 1.5},{y - 5 + 1.5},10,10,1,-1,-1,-1\n" for f, k, x, y in rows)


def as_ptc(rows):
    tracks = {}
    for f, k, x, y in rows:
        tracks.setdefault(k, []).append(f'<detection t="{f}" x="{x}" y="{y}" z="0"/>')
    inner = "".join(f"<particle>{''.join(points)}</particle>" for points in tracks.values())
    return f'<root><TrackContestISBI2012 snr="1" density="low" scenario="x">{inner}</TrackContestISBI2012></root>'


def as_trackmate(rows):
    inner = as_ptc(rows).partition("<particle>")[2].rpartition("</TrackContest")[0]
    return f'<Tracks nTracks="2" spaceUnits="pixel" frameInterval="1" timeUnits="frame"><particle>{inner}</Tracks>'


FORMATS = {"csv": as_csv, "txt": as_mot, "xml": as_ptc, "trackmate.xml": as_trackmate}


@pytest.mark.parametrize("other", FORMATS)
@pytest.mark.parametrize("one", FORMATS)
def test_figures_by_hand_from_any_two_formats(tmp_path, one, other):
    truth, found = tmp_path / f"gt.{one}", tmp_path / f"found.{other}"
    truth.write_text(FORMATS[one](TRUE))
    found.write_text(FORMATS[other](FOUND))
    got = score_table(found, truth, gate=5.0)
    assert (got.localisation["n"], got.localisation["missed"], got.localisation["false"]) == (11, 1, 1)
    assert got.localisation["rmse"] == pytest.approx(np.sqrt(0.5 * 0.25))
    t = got.tracking
    assert t["mota"] == pytest.approx(1 - 2 / 12)
    assert t["motp"] == pytest.approx(1 - 0.5 / 10)
    assert t["idf1"] == pytest.approx(2 * 11 / 24)
    assert t["alpha"] == pytest.approx(1 - (11 * 0.5 + 5) / 60)
    assert t["beta"] == pytest.approx((60 - (11 * 0.5 + 5)) / (60 + 5))
    assert t["jsc"] == pytest.approx(11 / 13)
    assert t["jsc_theta"] == pytest.approx(2 / 3)
    assert t["swaps"] == 0


def test_boxes_are_compared_by_their_overlap(tmp_path):
    truth, found = tmp_path / "gt.txt", tmp_path / "found.txt"
    truth.write_text(as_mot(TRUE))
    found.write_text(as_mot([(f, k, x + 2, y) for f, k, x, y in TRUE]))
    got = score_table(found, truth)
    assert "overlap" in got.by
    assert got.tracking["motp"] == pytest.approx(8 / 12)  # 8 x 10 of 12 x 10 px
    assert got.tracking["hota"] == pytest.approx(13 / 19)  # the levels up to .65
    found.write_text(as_mot([(f, k, x + 4, y) for f, k, x, y in TRUE]))
    assert score_table(found, truth).tracking["mota"] == pytest.approx(-1)  # 6 of 14: under half
    assert score_table(found, truth, gate=5.0).tracking["mota"] == 1


def typed(monkeypatch, capsys, line):
    monkeypatch.setattr(sys, "argv", shlex.split(line))
    with pytest.raises(SystemExit) as stopped:
        main()
    return stopped.value.code, *capsys.readouterr()


def test_the_command(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "gt.csv").write_text(as_csv(TRUE))
    (tmp_path / "found.txt").write_text(as_mot(FOUND))
    code, out, err = typed(monkeypatch, capsys, "tracker score found.txt --truth gt.csv -o report")
    assert (code, err) == (0, "")
    assert "11 found, 1 missed, 1 false (points, up to 5 px apart)" in out
    told = json.loads((tmp_path / "report" / "score.json").read_text())
    assert told["detectors"]["found"]["tracking"]["idf1"] == pytest.approx(11 / 12)
    assert "geometric mean of detection and association" in (tmp_path / "report" / "index.html").read_text()
    for line, said in (
        ("tracker score found.txt --truth gt.csv --gate -1 -o new", "--gate -1: expected a distance over 0"),
        ("tracker score found.txt --truth . --gate 3 -o new", "--gate: expected a true table behind --truth"),
        ("tracker score none.txt --truth gt.csv -o new", "none.txt: no such file"),
    ):
        code, out, err = typed(monkeypatch, capsys, line)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert said in err
        assert not (tmp_path / "new").exists()


def test_two_units_and_a_particle_twice_are_refused(tmp_path):
    truth, found = tmp_path / "gt.csv", tmp_path / "found.xml"
    truth.write_text(as_csv(TRUE))
    found.write_text(as_trackmate(FOUND).replace("pixel", "micron"))
    with pytest.raises(InputError, match=r"lengths in um, those of .*gt\.csv in px; expected one unit"):
        score_table(found, truth)
    truth.write_text(as_csv([*TRUE, TRUE[0]]))
    with pytest.raises(InputError, match="frame 0: particle 0 twice"):
        score_table(truth, truth)


@pytest.mark.parametrize("confidence", [0, 0.0, 0.4])
def test_confidence_of_a_result_marks_nothing(tmp_path, confidence):
    """Many trackers write 0; only the truth of MOTChallenge marks ignored rows by it."""
    (tmp_path / "gt.txt").write_text(as_mot(TRUE))
    (tmp_path / "found.txt").write_text(as_mot(TRUE).replace("10,10,1,", f"10,10,{confidence},"))
    got = score_table(tmp_path / "found.txt", tmp_path / "gt.txt")
    assert (got.localisation["n"], got.localisation["missed"]) == (12, 0)
    assert got.tracking["hota"] == 1


def test_zero_marks_ignored_rows_of_the_truth(tmp_path):
    lines = as_mot(TRUE).splitlines()
    lines[3] = lines[3].replace("10,10,1,", "10,10,0,")
    (tmp_path / "gt.txt").write_text("\n".join(lines))
    (tmp_path / "found.txt").write_text(as_mot([row for k, row in enumerate(TRUE) if k != 3]))
    got = score_table(tmp_path / "found.txt", tmp_path / "gt.txt")
    assert (got.localisation["n"], got.localisation["missed"], got.localisation["false"]) == (11, 0, 0)
    assert "1 of 12 rows have confidence 0" in str(got.notes[0])


def test_frames_from_0_are_the_same_frames(tmp_path):
    (tmp_path / "gt.txt").write_text(as_mot(TRUE))
    (tmp_path / "found.txt").write_text(as_mot([(f - 1, k, x, y) for f, k, x, y in TRUE]))
    got = score_table(tmp_path / "found.txt", tmp_path / "gt.txt")
    assert got.tracking["hota"] == 1
    assert "frames count from 0" in str(got.notes[0])


@pytest.mark.parametrize("text", ["", "\n\n", "frame,particle,x,y\n"])
@pytest.mark.parametrize("truth", [as_mot, as_csv])
def test_an_empty_result_has_no_detection(tmp_path, text, truth):
    (tmp_path / "gt.txt").write_text(truth(TRUE))
    (tmp_path / "found.txt").write_text(text)
    got = score_table(tmp_path / "found.txt", tmp_path / "gt.txt")
    assert (got.localisation["n"], got.localisation["missed"], got.localisation["false"]) == (0, 12, 0)
    assert got.tracking["hota"] == got.tracking["mota"] == 0


def test_rows_without_a_particle_are_told(tmp_path):
    (tmp_path / "gt.csv").write_text(as_csv(TRUE))
    (tmp_path / "found.csv").write_text(as_csv([*TRUE, (3, -1, 5.0, 5.0)]))
    got = score_table(tmp_path / "found.csv", tmp_path / "gt.csv")
    assert got.tracking["hota"] == 1
    assert "1 of 13 rows have no particle" in str(got.notes[0])
