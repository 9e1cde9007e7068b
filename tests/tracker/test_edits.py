"""Corrections by hand: each action on small tracks, files that are wrong, and what a run makes of them."""

import json
import shutil

import numpy as np
import pandas as pd
import pytest
import tifffile
import yaml
from repository import ROOT
from tracker_film import CAMERA

from synthcam_shared.errors import InputError
from tracker import results
from tracker.camera.camera import Camera
from tracker.edits import BY_HAND, TrackEdits
from tracker.measurement.estimate import measure
from tracker.notes import NoteKind
from tracker.pipeline import measure_tables, run
from tracker.recording import measure_all
from tracker.tables.rows import to_tracks

POINT = {"action": "remove_point", "ball": 1, "frame": 2}
TRACK = {"action": "remove_track", "ball": 0}
EXCHANGE = {"action": "exchange", "ball": 0, "other": 1, "frame": 2}
ADDED = {"action": "add_point", "ball": 1, "frame": 4, "x": 7.5, "y": 8.0, "error": 0.3}
CONTACT = {"action": "mark_contact", "ball": 0, "other": 1, "frame": 2}


def three_frames(times=False):
    """Ball 0 in frames 1 to 3, ball 1 in frames 1, 2, 3, 5; x tells all apart."""
    table = {
        "frame": [1, 2, 3, 1, 2, 3, 5],
        "particle": [0, 0, 0, 1, 1, 1, 1],
        "x": np.arange(7.0),
        "y": np.arange(7.0),
    }
    table |= {"x_std": 0.1, "y_std": 0.1, "cov_xy": 0.0}
    return to_tracks(pd.DataFrame(table | ({"t_s": [1, 2, 3, 1, 2, 3, 7]} if times else {})), "table")


def change(*edits, tracks=None, clip=0):
    return TrackEdits.of({"edits": list(edits)}).apply(tracks or three_frames(), clip)


def rows(edited):
    tracks = edited.tracks
    return list(zip(tracks.particle.tolist(), tracks.frame.tolist(), tracks.x.tolist(), strict=True))


WHOLE = [(0, 1, 0.0), (0, 2, 1.0), (0, 3, 2.0), (1, 1, 3.0), (1, 2, 4.0), (1, 3, 5.0), (1, 5, 6.0)]


@pytest.mark.parametrize(
    ("edits", "left"),
    [
        ([], WHOLE),
        ([POINT], [row for row in WHOLE if row[:2] != (1, 2)]),
        ([TRACK], WHOLE[3:]),
        ([EXCHANGE], [(0, 1, 0.0), (0, 2, 4.0), (0, 3, 5.0), (0, 5, 6.0), (1, 1, 3.0), (1, 2, 1.0), (1, 3, 2.0)]),
        ([EXCHANGE, EXCHANGE], WHOLE),
        ([EXCHANGE | {"other": 7}], [WHOLE[0], *WHOLE[3:], (7, 2, 1.0), (7, 3, 2.0)]),  # cuts a track in two
        ([EXCHANGE | {"ball": 7}], [*WHOLE[:4], (7, 2, 4.0), (7, 3, 5.0), (7, 5, 6.0)]),
        ([ADDED], [*WHOLE[:6], (1, 4, 7.5), WHOLE[6]]),
        ([POINT, ADDED | {"frame": 2}], [*WHOLE[:4], (1, 2, 7.5), *WHOLE[5:]]),  # a point is moved
        ([POINT | {"clip": 1}], WHOLE),
        ([CONTACT], WHOLE),
    ],
)
def test_each_action_on_the_rows_of_a_table(edits, left):
    assert rows(change(*edits)) == left


def test_an_added_point_has_its_error_a_flag_and_a_time():
    tracks = change(ADDED, tracks=three_frames(times=True)).tracks
    (row,) = np.flatnonzero(tracks.flags == BY_HAND)
    assert tracks.cov[row].tolist() == [[0.3**2, 0], [0, 0.3**2]]
    assert tracks.time[row] == 5.0  # between 3 s of frame 3 and 7 s of frame 5


def test_a_point_may_be_moved_in_the_last_frame_and_added_wherever_the_film_has_one():
    moved = change(POINT | {"frame": 5}, ADDED | {"frame": 5})
    assert rows(moved)[-1] == (1, 5, 7.5)
    edits = TrackEdits.of({"edits": [ADDED | {"frame": 8}]})
    assert rows(edits.apply(three_frames(), 0, np.arange(9)))[-1] == (1, 8, 7.5)
    with pytest.raises(InputError, match="expected 0 to 7"):
        edits.apply(three_frames(), 0, np.arange(8))


def test_what_was_done_is_noted():
    edited = change(POINT, POINT | {"frame": 3}, CONTACT)
    assert [str(note) for note in edited.notes] == ["edited by hand: 2 positions removed, 1 contact marked"]
    assert edited.notes[0].kind is NoteKind.EDIT
    assert edited.contacts == ((0, 1, 2),)


@pytest.mark.parametrize(
    ("edits", "said"),
    [
        ([POINT | {"frame": 9}], "edits.0 (remove_point): ball 1 has no position in frame 9"),
        ([TRACK, TRACK], "edits.1 (remove_track): ball 0 has no position"),
        ([EXCHANGE | {"other": 0}], "expected two different balls"),
        ([EXCHANGE | {"frame": 6}], "one of them seen from frame 6 on"),
        ([ADDED | {"frame": 5}], "ball 1 has a position in frame 5; remove that one before"),
        ([CONTACT | {"frame": 3}], "seen before and after the frame"),
        ([CONTACT | {"other": 0}], "expected two"),
        ([CONTACT, POINT, CONTACT | {"ball": 1, "other": 0}], "edits.2 (mark_contact): edits.0 marks this contact, in"),
        ([ADDED | {"frame": 6}], "edits.0.frame: expected 1 to 5, found 6"),
        ([ADDED | {"frame": 0}], "edits.0.frame: expected 1 to 5, found 0"),
        ([CONTACT, TRACK], "edits.0 (mark_contact): ball 0 has no position"),
        ([{"action": "remove"}], "expected tags"),
        ([POINT | {"size": 1}], "size: unknown key"),
        ([POINT | {"ball": -1}], "0 or more"),
        ([POINT | {"frame": 2.0}], "expected a whole number"),
        ([ADDED | {"error": 0.0}], "above 0"),
        ([ADDED | {"x": float("nan")}], "finite"),
        ([{"action": "exchange", "ball": 1, "frame": 2}], "other: required key is missing"),
        (7, "edits: edits: expected a list, found 7"),
    ],
)
def test_edits_that_are_wrong(edits, said):
    with pytest.raises(InputError) as error:
        TrackEdits.of({"edits": edits}).apply(three_frames(), 0)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_a_file_is_read_as_it_was_written(tmp_path):
    edits = [POINT, TRACK, EXCHANGE, ADDED | {"clip": 3}, CONTACT]
    text = TrackEdits.of({"edits": edits}).write()
    assert yaml.safe_load(text) == {"edits": edits}
    assert text.splitlines()[1] == "- {action: remove_point, ball: 1, frame: 2}"
    (tmp_path / "edits.yaml").write_text(text)
    assert TrackEdits.of(tmp_path / "edits.yaml").to_keys() == {"edits": edits}
    assert yaml.safe_load(TrackEdits().write()) == {"edits": []}


def test_the_page_of_formats_has_every_action():
    page = (ROOT / "docs/format.md").read_text().partition("## Edits")[2]
    example = yaml.safe_load(page.partition("```text\n")[2].partition("```")[0])
    actions = [edit["action"] for edit in TrackEdits.of(example).to_keys()["edits"]]
    assert actions == [edit["action"] for edit in (POINT, TRACK, EXCHANGE, ADDED, CONTACT)]


def test_clips_have_to_be_named_where_there_are_several():
    TrackEdits.of({"edits": [POINT]}).check_clips([4])
    for edit, numbers in ((POINT, [0, 1]), (POINT | {"clip": 2}, [0, 1])):
        with pytest.raises(InputError, match=r"edits\.0"):
            TrackEdits.of({"edits": [edit]}).check_clips(numbers)


def glancing_balls():
    """Two balls on parallel lines that come within a diameter, without a change of velocity."""
    frames, diameter_px = np.arange(40), CAMERA["ball_diameter"] / CAMERA["scale"]
    lines = [(60.0 + 1.5 * frames, 60.0 + 0 * frames), (60.0 + 0.1 * frames, 60.0 + diameter_px + 0 * frames)]
    noise = np.random.default_rng(0).normal(0, 0.02, (2, 2, len(frames)))
    parts = [
        pd.DataFrame({"frame": frames, "particle": k, "x": x + noise[k, 0], "y": y + noise[k, 1]})
        for k, (x, y) in enumerate(lines)
    ]
    return pd.concat(parts).assign(x_std=0.02, y_std=0.02, cov_xy=0.0)


def test_a_marked_contact_is_measured_where_nothing_shows_one():
    tracks, camera = to_tracks(glancing_balls(), "table"), Camera.from_dict(CAMERA)
    assert [row["status"] for row in measure(tracks, camera)] == ["no_collision"]
    edited = change(CONTACT | {"frame": 1}, tracks=tracks)
    (row,) = measure(edited.tracks, camera, marked=edited.contacts)
    assert {row["particle1"], row["particle2"]} == {0, 1}
    assert row["status"] != "no_collision"


def test_a_run_applies_a_file_and_notes_it(tmp_path):
    glancing_balls().to_csv(tmp_path / "tracks.csv", index=False)
    (tmp_path / "camera.json").write_text(json.dumps(CAMERA))
    (tmp_path / "edits.yaml").write_text(TrackEdits.of({"edits": [TRACK]}).write())
    made = measure_tables(
        tmp_path / "tracks.csv", tmp_path / "out", tmp_path / "camera.json", edits=tmp_path / "edits.yaml"
    )
    assert any("1 track removed" in str(note) for note in made.notes)
    assert set(results.read_clip(tmp_path / "out", 0)[0].particle) == {1}
    assert json.loads((tmp_path / "out/run.json").read_text())["edits"] == [TRACK]
    with pytest.raises(InputError, match=r"another run \(edits\)"):
        measure_tables(tmp_path / "tracks.csv", tmp_path / "out", tmp_path / "camera.json")


def test_all_edits_are_checked_before_anything_is_measured(tmp_path, monkeypatch):
    tables = pd.concat([glancing_balls().assign(clip=clip) for clip in (1, 2)])
    edits = {"edits": [TRACK | {"clip": 1}, POINT | {"clip": 2, "frame": 99}]}
    monkeypatch.setattr("tracker.recording.measure_clip", pytest.fail)
    with pytest.raises(InputError, match=r"edits\.1 \(remove_point\): ball 1 has no position in frame 99"):
        measure_all(tables, CAMERA, edits=edits)
    tables.to_csv(tmp_path / "tracks.csv", index=False)
    (tmp_path / "camera.json").write_text(json.dumps(CAMERA))
    with pytest.raises(InputError, match=r"edits\.1 \(remove_point\)"):
        measure_tables(tmp_path / "tracks.csv", tmp_path / "out", tmp_path / "camera.json", edits=edits)


def test_a_film_is_searched_in_the_clips_with_edits_first(tmp_path, monkeypatch):
    """An edit outside the film is found before; one that fits no track, before the clips without edits."""
    for clip in range(3):
        folder = tmp_path / f"films/clips/{clip:06d}"
        folder.mkdir(parents=True)
        tifffile.imwrite(folder / "frames.tif", np.zeros((9, 160, 200), np.uint8))
        (folder / "camera.json").write_text(json.dumps(CAMERA))
    tracked = []

    def note(clip, *_):
        tracked.append(clip.number)
        raise InputError("enough")

    monkeypatch.setattr("tracker.pipeline.track_and_measure", note)
    for edit, order, said in (
        (POINT | {"clip": 2}, [2], "enough"),
        (POINT | {"clip": 0, "frame": 9}, [], r"edits\.0\.frame: expected 0 to 8, found 9"),
    ):
        with pytest.raises(InputError, match=said):
            run(tmp_path / "films", tmp_path / "out", "discs", 1, edits={"edits": [edit]})
        assert tracked == order
        tracked.clear()
        shutil.rmtree(tmp_path / "out.partial", ignore_errors=True)


def test_an_interrupted_run_takes_other_edits_of_the_clips_that_it_lacks(tmp_path, monkeypatch):
    table, out = glancing_balls(), tmp_path / "out"
    pd.concat([table.assign(clip=1), table.assign(clip=2)]).to_csv(tmp_path / "tracks.csv", index=False)
    (tmp_path / "camera.json").write_text(json.dumps(CAMERA))

    def measure_with(*edits):
        return measure_tables(tmp_path / "tracks.csv", out, tmp_path / "camera.json", edits={"edits": list(edits)})

    track, good, write = TRACK | {"clip": 1}, POINT | {"clip": 2}, results.write_clip_results

    def write_one(partial, number, *values):
        if number == 2:
            raise KeyboardInterrupt
        write(partial, number, *values)

    monkeypatch.setattr(results, "write_clip_results", write_one)
    with pytest.raises(KeyboardInterrupt):
        measure_with(track)
    monkeypatch.setattr(results, "write_clip_results", write)
    with pytest.raises(InputError, match=r"of other options or files \(edits\)"):
        measure_with(good)  # clip 1 is measured with an edit
    measure_with(track, good)
    assert json.loads((out / "run.json").read_text())["edits"] == [track, good]
