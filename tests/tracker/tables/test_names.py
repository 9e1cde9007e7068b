"""Names of balls and clips in place of numbers, tables in memory as other programs give them, and who strikes."""

import numpy as np
import pandas as pd
import pytest

import synthcam
import tracker
from synthcam_shared.errors import InputError
from tracker.notes import NoteKind
from tracker.tables.read import find_first_mover, read_frame, read_tracks
from tracker.tables.table_options import TableOptions

CAMERA = {"fps": 250.0, "size": [640, 480], "scale": 1.6e-4, "ball_diameter": 2.4e-3}


def clip(striker, number=0, noise=0.05):
    """Ball `striker`, 0 or 1, runs into the other one, which then rolls on; px."""
    rng, frame = np.random.default_rng(number), np.arange(40)
    moving = 100 + 9.0 * np.minimum(frame, 20) + 4.0 * np.maximum(frame - 20, 0)
    struck = 295 + 5.0 * np.maximum(frame - 20, 0)
    x = np.concatenate([moving, struck] if striker == 0 else [struck, moving])
    rows = pd.DataFrame({"frame": np.tile(frame, 2), "particle": np.repeat([0, 1], 40), "x": x, "y": 240.0})
    rows[["x", "y"]] += rng.normal(0, noise, (80, 2))
    return rows.assign(clip=number)


def table(strikers=(0, 1, 1, 0)):
    return pd.concat([clip(striker, k) for k, striker in enumerate(strikers)], ignore_index=True)


def strikers(given):
    return [striker for _, (_, striker) in sorted(given.clips.items())]


@pytest.mark.parametrize("names", [("a", "b"), ("blue", "red"), ("ball 9", "ball 10")])
def test_named_balls_say_who_strikes(names, tmp_path):
    rows = table()
    rows["particle"] = np.array(names)[rows["particle"]]
    for given in (read_frame(rows, CAMERA), read_tracks(written(rows, tmp_path), CAMERA)):
        assert strikers(given) == ["a", "b", "b", "a"]
        assert NoteKind.STRIKER not in [note.kind for note in given.notes]
        assert f"{names[0]} (ball a) strikes in 2 clips, {names[1]} (ball b) strikes in 2 clips" in str(given.notes[-1])


def written(rows, tmp_path):
    rows.to_csv(tmp_path / "t.csv", index=False)
    return tmp_path / "t.csv"


def test_numbers_that_change_roles_are_asked_about():
    """Programs number balls anew in each clip, so that a number is no body."""
    given = read_frame(table(), CAMERA)
    assert strikers(given) == [None] * 4
    (note,) = (note for note in given.notes if note.kind is NoteKind.STRIKER)
    assert "no column striker, so that ball b counts" in str(note)
    assert "particle 0 strikes in 2 clips and particle 1 in 2" in str(note)
    assert "write a and b in the column particle" in str(note)


def test_a_column_of_strikers_and_the_camera_file_go_before():
    rows = table()
    rows["particle"] = np.array(["a", "b"])[rows["particle"]]
    assert strikers(read_frame(rows.assign(striker="b"), CAMERA)) == ["b"] * 4
    assert strikers(read_frame(rows, CAMERA | {"striker": "b"})) == [None] * 4


def test_who_moves_first_is_not_guessed():
    """Two balls that roll towards each other, balls at rest, and one ball alone."""
    rows, tracks = clip(0), lambda rows: next(iter(read_frame(rows, CAMERA).clips.values()))[0]
    assert find_first_mover(tracks(rows)) == 0
    both = rows.assign(x=np.where(rows["particle"] == 1, rows["x"] + 5.0 * (20 - rows["frame"]), rows["x"]))
    assert find_first_mover(tracks(both)) is None
    assert find_first_mover(tracks(rows[rows["particle"] == 0])) is None
    named = pd.concat([clip(0), both.assign(clip=1)]).assign(particle=lambda t: np.array(["a", "b"])[t["particle"]])
    given = read_frame(named, CAMERA)
    assert strikers(given) == [None, None]
    assert [note.kind for note in given.notes if note.kind is NoteKind.STRIKER] == [NoteKind.STRIKER]


def test_clips_may_have_names():
    rows = table((0, 1, 0))
    rows["clip"] = np.array(["run10", "run2", "run1"])[rows["clip"]]
    given = read_frame(rows, CAMERA)
    assert sorted(given.clips) == [0, 1, 2]
    assert any("column clip has names: 0 is run1, 1 is run2, 2 is run10" in str(note) for note in given.notes)
    expected = clip(0, 2)["x"].sum()
    assert given.clips[0][0].x.sum() == pytest.approx(expected)


@pytest.mark.parametrize(
    "change",
    [
        lambda rows: rows.set_index(["frame", "particle"]),
        lambda rows: rows.set_index("frame", drop=False),
        lambda rows: rows.rename(columns={"frame": "Frame", "particle": "Track_ID", "x": "X (px)", "y": "Y (px)"}),
        lambda rows: rows.convert_dtypes(dtype_backend="pyarrow"),
        lambda rows: rows.astype(object),
        lambda rows: rows.assign(particle=np.array(["red", "blue"])[rows["particle"]]),
        lambda rows: rows.rename(columns={"frame": "f", "particle": "n"}),
    ],
    ids=["index", "index twice", "names", "arrow", "objects", "colours", "columns"],
)
def test_a_table_in_memory_is_read_as_its_file_would_be(change):
    rows = clip(0).drop(columns="clip")
    columns = "frame=f,track=n,x=x,y=y" if "f" in change(rows) else ""
    tracks, _ = read_frame(change(rows), CAMERA, TableOptions(columns=columns)).clips[0]
    assert len(tracks) == 80
    assert np.sort(tracks.x) == pytest.approx(np.sort(rows["x"]))


def test_a_clip_keeps_its_number_in_python():
    made = synthcam.Scene.read("painter_behringer").draw(seed=1)
    rows = made.tracks[["frame", "particle"]].assign(x=made.tracks.x_mean_px, y=made.tracks.y_mean_px)
    assert tracker.measure(rows.assign(clip=7), made.camera_json).estimates["clip"].tolist() == [7]
    assert tracker.measure(rows, made.camera_json, number=9).estimates["clip"].tolist() == [9]


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda t: tracker.measure([1, 2], CAMERA), "tracks: of type list, expected DataFrame | str | Path"),
        (lambda t: tracker.measure(t["x"], CAMERA), "tracks: of type Series, expected DataFrame"),
        (lambda t: tracker.measure(t, CAMERA, unit=3), "unit: of type int, expected str"),
        (lambda t: tracker.measure(t, CAMERA, unit="furlong"), "unit: 'furlong': expected a unit of length"),
        (lambda t: tracker.measure(t.assign(x=0.0, y=0.0), CAMERA), "not metres: .*; say argument unit m"),
        (lambda t: tracker.measure(t.drop(columns="x"), CAMERA), "argument columns x=NAME,y=NAME,... names others"),
        (lambda t: tracker.measure_all(t, CAMERA, columns="x=no"), "no column no, as argument columns says"),
        (lambda t: tracker.track(np.zeros((3, 9, 9), np.uint8), CAMERA, select=3), "select: of type int, expected str"),
        (lambda t: tracker.track(np.zeros((3, 9, 9), np.uint8), CAMERA, ball=[3]), "^ball: holds int, expected str"),
        (
            lambda t: tracker.measure(t, CAMERA, units="mm"),
            "^units: unknown, expected one of columns, decimal, point, u",
        ),
        (
            lambda t: tracker.track(np.zeros((3, 9, 9), np.uint8), CAMERA, balls="x"),
            "^balls: unknown, expected one of b",
        ),
        (lambda t: tracker.track(t, CAMERA), r"^film: a table, expected a film; tracker.measure\(tracks, camera\)"),
        (lambda t: tracker.track(np.zeros((3, 9, 9), np.uint8), CAMERA, times="x"), "^times: expected one of auto"),
        (lambda t: synthcam.Scene.read(3), "path: of type int, expected str | Path"),
        (lambda t: synthcam.Scene.build().draw(-1), "number: expected 0 or more, not -1"),
        (lambda t: synthcam.Scene.build().draw("x"), "number: of type str, expected int"),
        (lambda t: synthcam.add_effects(None), "folder: of type NoneType"),
        (lambda t: synthcam.open_dataset(3), "folder: of type int"),
        (lambda t: tracker.Camera.read(3), "path: of type int"),
    ],
)
def test_errors_in_python_name_arguments(call, said):
    """One line, an InputError and no other kind, and no option of a command."""
    with pytest.raises(InputError, match=said) as error:
        call(clip(0))
    assert "--" not in str(error.value)
    assert "\n" not in str(error.value)


def test_numbers_of_numpy_are_numbers():
    scene = synthcam.Scene.build(timing={"frames": 3, "contact_frame": 1})
    assert scene.draw(np.int64(2), np.int32(1)).number == 2
