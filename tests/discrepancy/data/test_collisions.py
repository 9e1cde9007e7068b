"""Measured collisions: the same from a table as from results, in metres, and nothing doubtful taken along."""

import contextvars
import dataclasses
import json
import pickle
import shutil

import numpy as np
import pandas as pd
import pytest
from discrepancy_files import NOISE, record

from discrepancy.data import reading
from discrepancy.data.first_guess import build_collision
from discrepancy.data.launch import T_C, V0, B, X, Y
from discrepancy.data.notes import SearchNote, SearchNoteKind
from discrepancy.data.reading import read_collisions
from synthcam_shared.errors import InputError
from tracker.results import read_clip


@pytest.fixture(scope="module")
def recorded():
    return record()


@pytest.fixture(scope="module")
def clips(recorded):
    return read_collisions(recorded / "results")[0]


def read_table(recorded, tmp_path, change):
    """The collisions of the table after a change of it, for the first two clips."""
    changed = change(pd.read_csv(recorded / "tracks.csv").query("clip < 2"))
    changed.to_csv(tmp_path / "t.csv", index=False)
    return read_collisions(tmp_path / "t.csv", recorded / "camera.json")


def test_first_guesses_are_near_the_truth(recorded, clips):
    truth = pd.read_parquet(recorded / "dataset/truth/clips.parquet").set_index("clip")
    for clip in clips:
        true = truth.loc[clip.clip]
        _, _, t_c, v0, _, b = clip.launch
        assert [t_c, v0, b] == pytest.approx([true["t_c"], true["v0"], true["b"]], rel=0.02, abs=2e-3)
        assert clip.slide_ends - t_c == pytest.approx([true["tau1"], true["tau2"]], rel=0.1)
        assert clip.striker == true["striker"]
        free = [np.flatnonzero((clip.phases() == 0) & (clip.ball == k))[-8:] for k in (0, 1)]
        met = [np.polynomial.Polynomial.fit(clip.frame[r], clip.xy[r, k], 1) for r in free for k in (0, 1)]
        x1, y1, x2, y2 = (line(t_c * clip.fps) for line in met)
        assert clip.launch[[X, Y]] == pytest.approx([(x1 + x2) / 2, (y1 + y2) / 2], abs=2e-4)


def test_ball_1_rests_until_it_is_struck(clips):
    for clip in clips:
        early = clip.phases() == 0
        spread = [np.ptp(clip.xy[early & (clip.ball == k)], axis=0).max() for k in (0, 1)]
        assert spread[0] < 2e-5 < spread[1]


def test_places_are_in_metres(recorded, clips):
    for clip in clips:
        path = recorded / f"dataset/clips/{clip.clip:06d}/truth/tracks.parquet"
        true = pd.read_parquet(path).set_index(["particle", "frame"])
        mid = true.loc[list(zip(clip.ball.tolist(), clip.frame.tolist(), strict=True)), ["x", "y"]].to_numpy()
        off = clip.xy - mid
        assert np.sqrt((off**2).mean()) == pytest.approx(1.6e-4 * NOISE, rel=0.25)
        assert np.allclose(np.sqrt(clip.covariance[:, 0, 0]), 1.6e-4 * NOISE, rtol=1e-3)


def test_no_exposure_with_an_event_counts_to_a_phase(clips):
    for clip in clips:
        opens = clip.frame / clip.fps
        for event, balls in ((clip.launch[T_C], (0, 1)), (clip.slide_ends[0], (0,)), (clip.slide_ends[1], (1,))):
            inside = (opens < event) & (event < opens + clip.exposure) & np.isin(clip.ball, balls)
            assert np.all(clip.phases()[inside] == -1)


def test_a_table_gives_what_results_give(recorded, clips, monkeypatch):
    """Whichever process measures which clip, by the same policy; here the last one is the first to end."""

    def run_elsewhere(work, numbers, workers, where):
        there = pickle.loads(pickle.dumps(work))
        return [contextvars.Context().run(there, number) for number in reversed(numbers)]

    monkeypatch.setattr(reading, "run_all_jobs", run_elsewhere)
    again, left_out = read_collisions(recorded / "tracks.csv", recorded / "camera.json", workers=2)
    assert left_out == []
    for one, other in zip(clips, again, strict=True):
        assert np.allclose(one.xy, other.xy, rtol=0, atol=1e-12)
        assert np.allclose(one.launch, other.launch, rtol=1e-6, atol=1e-9)
        assert (one.clip, one.striker) == (other.clip, other.striker)


def test_a_lost_worker_names_the_clip(recorded, monkeypatch):
    def lose(work, numbers, workers, where):
        raise InputError(f"{where}: clip {numbers[1]}")

    monkeypatch.setattr(reading, "run_all_jobs", lose)
    table = pd.read_csv(recorded / "tracks.csv").query("clip < 2").assign(clip=lambda t: t["clip"] + 40)
    with pytest.raises(InputError, match=r"^tracks: clip 41$"):
        read_collisions(table, recorded / "camera.json", workers=2)


def test_rows_without_a_place_are_left_out(recorded, tmp_path, clips):
    read, _ = read_table(recorded, tmp_path, lambda t: t.assign(x=t["x"].where(t["frame"] != 40)))
    assert all(40 not in c.frame for c in read)
    assert len(read[0].frame) == len(clips[0].frame) - 2


def test_tracks_that_claim_no_error_get_one(recorded, tmp_path):
    read, _ = read_table(recorded, tmp_path, lambda t: t.drop(columns=["x_std", "y_std", "cov_xy"]))
    assert np.allclose(np.sqrt(read[0].covariance[:, 0, 0]), 1.6e-4 * 0.01, rtol=1e-3)


def test_a_negative_error_is_refused(recorded, tmp_path):
    with pytest.raises(InputError, match=r"x_std: expected standard errors from 0 to"):
        read_table(recorded, tmp_path, lambda t: t.assign(x_std=-t["x_std"]))


def test_what_a_ball_at_rest_has_alike_in_every_frame_is_kept_apart(recorded, tmp_path, clips):
    results = shutil.copytree(recorded / "results", tmp_path / "results")
    for path in (results / "clips").glob("*/tracks.parquet"):
        table = pd.read_parquet(path)
        table.assign(x_fixed_std=0.006, y_fixed_std=0.006, cov_xy_fixed=0.0).to_parquet(path)
    for one, other in zip(clips, read_collisions(results)[0], strict=True):
        rests = (one.phases() == 0) & (one.ball == 0)
        assert (one.offset, other.offset) == (0, pytest.approx(1.6e-4 * 0.006, rel=1e-3))
        assert np.sqrt(other.covariance[rests, 0, 0]) == pytest.approx(1.6e-4 * np.sqrt(NOISE**2 - 0.006**2), rel=1e-3)
        assert np.array_equal(other.covariance[~rests], one.covariance[~rests])


def test_a_speck_that_never_moves_is_no_ball(recorded, tmp_path, clips):
    speck = pd.DataFrame({"frame": np.arange(100), "particle": 7, "x": 20.0, "y": 20.0, "x_std": 0.01, "y_std": 0.01})
    both = [speck.assign(clip=k, cov_xy=0.0) for k in (0, 1)]
    read, _ = read_table(recorded, tmp_path, lambda t: pd.concat([t, *both]))
    for one, other in zip(clips, read, strict=False):
        assert np.allclose(one.xy, other.xy, rtol=0, atol=1e-12)


def test_what_cannot_be_used_is_left_out_and_said(recorded, tmp_path):
    def alone(t):
        return t[(t["clip"] > 0) | ((t["particle"] == 1) & (t["frame"] < 15))]

    read, left_out = read_table(recorded, tmp_path, alone)
    assert [c.clip for c in read] == [1]
    assert [str(n) for n in left_out] == ["clip 0: no_collision"]


def test_a_recording_of_several_collisions_is_left_out(recorded, tmp_path):
    results = shutil.copytree(recorded / "results", tmp_path / "results")
    table = pd.read_parquet(results / "estimates.parquet")
    pd.concat([table, table[table["clip"] == 3].assign(collision=1)]).to_parquet(results / "estimates.parquet")
    read, left_out = read_collisions(results)
    assert 3 not in [c.clip for c in read]
    assert [str(n) for n in left_out] == ["clip 3: 2 collisions in one recording"]


def test_no_clip_of_use(recorded, tmp_path):
    with pytest.raises(InputError, match="no clip with a measured collision; clip 0: no_collision"):
        read_table(recorded, tmp_path, lambda t: t[(t["particle"] == 1) & (t["frame"] < 15)])


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (1.6e-4, "x, y: expected pixels, not metres"),
        (0.16, "x, y: positions look like mm: the balls touch at .* expected px"),
        (160.0, "x, y: positions look like um: the balls touch at .* expected px"),
    ],
)
def test_places_that_are_not_in_pixels_are_refused(recorded, tmp_path, factor, said):
    with pytest.raises(InputError, match=f"t.csv: {said}"):
        read_table(recorded, tmp_path, lambda t: t.assign(x=factor * t["x"], y=factor * t["y"]))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"fps": 1000.0, "exposure": 0.0}, r"balls move at .* m/s \(median\); check scale and fps"),
        ({"scale": 1000.0}, "ball_diameter: expected a ball that the picture can show, not one of 0.0149 px"),
    ],
)
def test_a_camera_with_wrong_units_is_refused(recorded, tmp_path, change, said):
    camera = json.loads((recorded / "camera.json").read_text())
    camera |= {name: factor * camera[name] for name, factor in change.items()}
    if "scale" in change:
        del camera["K"], camera["dist"]
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    pd.read_csv(recorded / "tracks.csv").query("clip < 2").to_csv(tmp_path / "t.csv", index=False)
    with pytest.raises(InputError, match=said):
        read_collisions(tmp_path / "t.csv", tmp_path / "camera.json")


@pytest.mark.parametrize("frame", [8, 39, 45, 70])  # measured nevertheless, that at 39 would divide by zero
def test_balls_that_exchange_names_are_exchanged_back(recorded, tmp_path, frame):
    def swap(t):
        late = (t["clip"] == 0) & (t["frame"] >= frame)
        return t.assign(particle=t["particle"].where(~late, 1 - t["particle"]))

    plain, _ = read_table(recorded, tmp_path, lambda t: t)
    read, (note,) = read_table(recorded, tmp_path, swap)
    assert [c.clip for c in read] == [0, 1]
    assert np.array_equal(read[0].xy, plain[0].xy)
    assert (note.kind, note.clip, note.frames) == (SearchNoteKind.REPAIRED, 0, (frame,))
    assert str(note).startswith(f"clip 0: balls exchange their numbers in frame {frame}; exchanged back")


def test_places_that_are_no_numbers_do_no_harm(recorded, tmp_path, clips):
    def holed(t):
        x = t["x"].where((t["frame"] + t["particle"]) % 9 != 4)
        return t.assign(x=x.where(t["frame"] != 50), x_std=t["x_std"].where(t["frame"] != 30))

    read, left_out = read_table(recorded, tmp_path, holed)
    assert left_out == []
    for one, other in zip(clips, read, strict=False):
        assert np.all(np.isfinite(other.xy))
        assert np.all(np.isfinite(other.covariance))
        assert other.launch == pytest.approx(one.launch, rel=2e-3, abs=2e-5)


@pytest.mark.parametrize(("speed", "refused"), [(15.0, False), (25.0, True)])
def test_no_ball_is_launched_faster_than_twenty_metres_a_second(recorded, tmp_path, speed, refused):
    results = shutil.copytree(recorded / "results", tmp_path / "results")
    table = pd.read_parquet(results / "estimates.parquet")
    table.assign(v0=speed).to_parquet(results / "estimates.parquet")
    if refused:
        with pytest.raises(InputError, match=r"move at 25 m/s \(median\); check scale and fps of the camera"):
            read_collisions(results)
    else:
        assert read_collisions(results)[0][0].launch[V0] == speed


@pytest.mark.parametrize(("frames", "approach"), [(2, False), (3, True)])
def test_with_less_than_three_frames_before_the_contact_the_launch_is_read_from_what_follows(
    recorded, frames, approach
):
    rows = pd.read_parquet(recorded / "results/estimates.parquet").sort_values("v0").to_dict("records")
    row = rows[-1]  # the fastest: it slides for longest
    tracks, camera = read_clip(recorded / "results", row["clip"])
    early = tracks.frame / camera.fps + camera.exposure <= row["t_c"]
    kept = tracks.frame > tracks.frame[early].max() - frames
    some = {f.name: getattr(tracks, f.name) for f in dataclasses.fields(tracks)}
    some = {k: v[kept] if isinstance(v, np.ndarray) and len(v) == len(kept) else v for k, v in some.items()}
    some = dataclasses.replace(tracks, **some)
    whole, found = build_collision(tracks, row, camera).launch, build_collision(some, row, camera).launch
    assert bool(found[V0] == whole[V0]) is approach
    assert found[[V0, B]] == pytest.approx(whole[[V0, B]], abs=0.03)
    short = {f.name: getattr(some, f.name) for f in dataclasses.fields(some)}
    short = {k: v[some.frame < 30] if isinstance(v, np.ndarray) else v for k, v in short.items()}
    left = build_collision(dataclasses.replace(some, **short), row, camera)
    assert (left == SearchNote(SearchNoteKind.TOO_FEW_FRAMES, row["clip"], values={"least": 3})) is not approach
