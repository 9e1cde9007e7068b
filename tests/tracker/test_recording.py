"""One recording in memory: the numbers that the commands write, to the last bit."""

import json
import sys
from dataclasses import replace

import cv2
import numpy as np
import pandas as pd
import pytest
import tifffile
from matplotlib.figure import Figure
from threadpoolctl import threadpool_info, threadpool_limits
from tracker_discs import disc
from tracker_film import spot

import synthcam
import tracker
from synthcam.dataset.generate import GenerationPlan, generate_dataset
from synthcam_shared.errors import InputError
from tracker import cli, pipeline, recording
from tracker.detection.choose import DISCS, GLINTS, SelectedDetector
from tracker.detection.diagnose import LooseEnds
from tracker.notes import COLOUR_TO_GREY, NO_CAMERA_FILE, NoteKind

SCENE = synthcam.Scene.read(
    "painter_behringer", camera={"size": [200, 160], "scale": 3e-4}, timing={"frames": 60, "contact_frame": 20}
)
SEED = 3


@pytest.fixture(scope="module")
def clip():
    return SCENE.draw(1, SEED)


@pytest.fixture(scope="module")
def film(clip):
    return clip.film()


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """A dataset of two clips and what `tracker track` makes of it."""
    folder = tmp_path_factory.mktemp("recording")
    assert generate_dataset(GenerationPlan((SCENE,), 2, SEED), folder / "data", 1, lambda done, of: None).failed == ()
    command("track", folder / "data", "-o", folder / "results", "--workers", "1")
    return folder


@pytest.fixture(scope="module")
def result(clip, film):
    return tracker.track(film, clip.camera_json, number=1)


def command(*words):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["tracker", *map(str, words)])
        cli.app(standalone_mode=False)


def own(folder, number):
    """Tracks, motion and estimates of a clip of RESULTS."""
    position = folder / f"clips/{number:06d}"
    estimates = pd.read_parquet(folder / "estimates.parquet")
    return (
        pd.read_parquet(position / "tracks.parquet"),
        pd.read_parquet(position / "motion.parquet"),
        estimates[estimates["clip"] == number].reset_index(drop=True),
    )


def same(result, folder, number=1):
    for got, wanted in zip((result.tracks, result.motion, result.estimates), own(folder, number), strict=True):
        pd.testing.assert_frame_equal(got, wanted, check_exact=True)


def test_from_memory_as_from_a_dataset_to_the_last_bit(result, folders):
    same(result, folders / "results")
    assert result.estimates["status"].tolist() == ["ok"]


def test_by_way_of_a_path_a_list_a_generator_and_a_camera(clip, film, folders):
    position = folders / "data/clips/000001"
    camera = tracker.Camera.read(position / "camera.json")
    for given, known in (
        (position, None),
        (str(position / "frames.tif"), position / "camera.json"),
        (list(film), camera),
        (clip.pictures(), clip.camera),
    ):
        same(tracker.track(given, known, number=1), folders / "results")


@pytest.mark.usefixtures("not_local")
def test_colour_is_taken_as_a_file_of_it_is(clip, film, tmp_path):
    colour = np.repeat(film[..., None], 3, axis=-1) // np.array([1, 2, 3], np.uint8)
    tifffile.imwrite(tmp_path / "c.tif", colour, photometric="rgb")
    one, other = (tracker.track(given, clip.camera_json) for given in (colour, tmp_path / "c.tif"))
    pd.testing.assert_frame_equal(one.tracks, other.tracks, check_exact=True)
    assert one.notes == other.notes == (COLOUR_TO_GREY,)


def film_flickering_specks_and_one_ball():
    """A dark ball that crosses a bright ground in a sixth of the frames, and three specks that flicker all along."""
    rng = np.random.default_rng(8)
    spots = [spot((160, 200), x, y, 1.0) for x, y in rng.uniform(20, 140, (3, 2))]
    lit = np.repeat(rng.random((3, 15)) < 0.5, 6, axis=1)
    way = np.linspace([8.0, 40.0], [192.0, 110.0], 15)
    frames = []
    for k in range(90):
        frame = 120 + sum(400 * on[k] * one for on, one in zip(lit, spots, strict=True)) + rng.normal(0, 1, (160, 200))
        if 40 <= k < 55:
            frame = frame - 80 * disc(way[k - 40])
        frames.append(np.clip(np.rint(frame), 0, 255).astype(np.uint8))
    return np.array(frames), way


@pytest.mark.usefixtures("undrawn")
def test_specks_leave_the_film_to_the_other_detector(tmp_path):
    """Python and the command take the other detector alike, with one note, and run.json has its name."""
    frames, way = film_flickering_specks_and_one_ball()
    tifffile.imwrite(tmp_path / "film.tif", frames)
    result = tracker.track(frames)
    assert result.detector == "discs"
    assert np.abs(result.tracks[["x", "y"]] - way[result.tracks.frame - 40]).to_numpy().max() < 0.3
    (note,) = (note for note in result.notes if note.kind is NoteKind.DETECTOR)
    assert note.text.startswith("detector: discs, because maximum_likelihood finds specks and no collision (")
    outcome = pipeline.run(tmp_path / "film.tif", tmp_path / "out", None, 1)
    same(result, tmp_path / "out", 0)
    assert note.text.replace("argument ", "--") in map(str, outcome.notes)
    run = json.loads((tmp_path / "out/run.json").read_text())
    assert (run["detector"], run["other_detectors"]) == ("maximum_likelihood", {"0": "discs"})
    assert pipeline.run(tmp_path / "film.tif", tmp_path / "out", None, 1).fresh == 0
    assert tracker.track(frames[:8], detector="maximum_likelihood").detector == "maximum_likelihood"


def test_specks_after_a_search_for_bodies_do_not_advise_that_search(monkeypatch):
    """Where the film asks for bodies and shows none, specks are followed; the note says that bodies were tried."""
    ends = LooseEnds(count=8, ends=8, resumed=0)
    specks = recording.TrackedClip(np.zeros(8), None, "", (), ends, LooseEnds.HINT_AT_BODIES)
    found = {DISCS: replace(specks, tracks=np.zeros(0), reason="no body", hint=""), GLINTS: specks}
    monkeypatch.setattr(recording, "track_clip", lambda _, name, __: found[name])
    chosen, tracked = recording._track_by_choice(None, SelectedDetector(DISCS), None)
    assert (chosen.name, tracked.hint) == (GLINTS, LooseEnds.NO_BODIES)


@pytest.mark.usefixtures("unfitted", "not_local")
@pytest.mark.parametrize(("rate", "said"), [(25.0, True), (250.0, False), (249.0, False)])
def test_a_video_that_claims_another_frame_rate_is_said(clip, film, tmp_path, rate, said):
    path = tmp_path / "film.mkv"
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"FFV1"), rate, (200, 160), False)
    if not writer.isOpened():
        pytest.skip("this OpenCV cannot write FFV1")
    for frame in film:
        writer.write(frame)
    writer.release()
    known = tracker.Camera.from_dict(clip.camera_json)
    notes = [note for note in map(str, tracker.track(path, known).notes) if note.startswith("fps")]
    text = "fps: 250 in the camera file, 25 by the film's own times, a factor of 10; the camera file's is used; "
    assert notes == [text + "argument times file takes the film's"] * said


@pytest.mark.usefixtures("unfitted", "not_local")
def test_without_a_camera_there_are_pixels(film):
    result = tracker.track(film)
    assert NO_CAMERA_FILE in result.notes
    assert len(result.tracks) > 90


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("point", ["centre", "glint"])
def test_measured_as_the_command_measures(result, clip, tmp_path, point):
    table = result.tracks.assign(clip=1)
    if point == "glint":
        table = table.assign(x=table["glint_x"], y=table["glint_y"])
    table.to_parquet(tmp_path / "tracks.parquet")
    (tmp_path / "camera.json").write_text(json.dumps(clip.camera_json))
    command("measure", tmp_path / "tracks.parquet", "--camera", tmp_path / "camera.json", "-o", tmp_path / "out",
            "--point", point)  # fmt: skip
    again = tracker.measure(table.sample(frac=1, random_state=1), clip.camera_json, point=point)
    same(again, tmp_path / "out")
    same(tracker.measure(tmp_path / "tracks.parquet", tmp_path / "camera.json", point=point), tmp_path / "out")


FILM = np.zeros((5, 160, 200), np.uint8)


@pytest.mark.parametrize(
    ("film", "said"),
    [
        (FILM[:1], "film: one frame only"),
        (FILM[:0], "film: no frames"),
        (FILM[0], r"film: pictures of shape \(200,\)"),
        (FILM.astype(float), "film: float pixels"),
        (FILM.astype(np.int32), "film: pixels of type int32"),
        (FILM[:, :80], "film: frames are 200x80, expected 200x160 by size in camera"),
        ([FILM[0], FILM[0, :80]], "film: frame 1 is 200x80 uint8, expected 200x160"),
        (FILM[..., None].repeat(5, 3), "film: pictures of shape"),
        (7, "film: of type int"),
        (np.uint8(7), "film: of type uint8"),
        (np.array(7), "film: of type ndarray"),
        (None, "film: of type NoneType"),
        ("nowhere.tif", "nowhere.tif: no such file"),
        ([[[1, 2], [3]], [[1, 2], [3]]], "film: frame 0 cannot be read"),
    ],
)
def test_what_is_no_film_is_one_line(clip, film, said):
    with pytest.raises(tracker.InputError, match=said) as error:
        tracker.track(film, clip.camera_json)
    assert "\n" not in str(error.value)


def test_a_dataset_is_no_recording(folders):
    with pytest.raises(tracker.InputError, match=r"holds 2 clips, expected one, as .*000000; `tracker track` takes"):
        tracker.track(folders / "data")


def test_bad_cameras_tables_and_detectors_are_one_line(clip, result):
    with pytest.raises(tracker.InputError, match="camera: fps: expected frames per second, it is missing"):
        tracker.track(FILM, {"size": [200, 160], "scale": 1e-4})
    with pytest.raises(tracker.InputError, match="no detector 'eye'"):
        tracker.track("nowhere.tif", detector="eye")
    with pytest.raises(tracker.InputError, match="tracks: no column x, y"):
        tracker.measure(result.tracks[["frame", "particle"]], clip.camera_json)
    with pytest.raises(tracker.InputError, match=r"2 clips \(0, 4\), expected 1; tracker\.measure_all"):
        tracker.measure(pd.concat([result.tracks.assign(clip=k) for k in (0, 4)]), clip.camera_json)
    with pytest.raises(tracker.InputError, match="point: expected centre or glint"):
        tracker.measure(result.tracks, clip.camera_json, point="middle")
    with pytest.raises(tracker.InputError, match="camera: expected a camera"):
        tracker.measure(result.tracks, None)


def test_the_repr_gives_values_with_errors(result):
    row = result.estimates.iloc[0]
    first, second = repr(result).splitlines()
    assert first == "Clip 1: 2 balls tracked in 60 frames"
    digits = 1 - int(np.floor(np.log10(row["r_std"])))
    assert f"r {row['r']:.{digits}f}({row['r_std'] * 10**digits:.0f})" in second
    page = result._repr_html_()
    assert page.count("<tr") == 21  # a head and the 20 quantities
    assert "final_angle (rad)" in page


def test_a_film_of_nothing_says_why():
    noise = np.random.default_rng(1).integers(6, 11, (12, 160, 200), dtype=np.uint8)
    result = tracker.track(noise, SCENE.draw().camera_json)
    assert repr(result).splitlines()[1].startswith("  collision 0 no balls")
    assert "<table" not in result._repr_html_()


def test_the_plot_is_the_picture(result):
    ax = Figure().subplots()
    assert result.plot(ax) is ax
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x (px)", "y (px)")
    assert ax.get_ylim() == (159.5, -0.5)
    drawn = np.concatenate([line.get_xydata() for line in ax.lines])
    np.testing.assert_array_equal(drawn, result.tracks[["x", "y"]])


def test_a_clip_and_its_camera_are_cameras_as_their_keys_are(clip, film, result):
    for camera in (clip.camera, clip):
        other = tracker.track(film, camera, number=1)
        pd.testing.assert_frame_equal(other.estimates, result.estimates, check_exact=True)
    table = clip.tracks[["frame", "particle"]].assign(x=clip.tracks.x_mean_px, y=clip.tracks.y_mean_px)
    measured = [tracker.measure(table, camera).estimates for camera in (clip.camera, clip.camera_json)]
    pd.testing.assert_frame_equal(*measured, check_exact=True)


@pytest.mark.parametrize("camera", [5, object(), [1.0]])
def test_what_is_no_camera_is_one_line(film, camera):
    with pytest.raises(tracker.InputError, match=r"^camera: of type .*, expected the keys of camera\.json, a path"):
        tracker.track(film, camera)


def test_linear_algebra_stays_in_one_thread(clip, film, monkeypatch):
    seen = []

    def count_threads(*given, **more):
        seen.append({pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"})
        raise InputError("seen")

    monkeypatch.setattr(recording, "track_and_measure", count_threads)
    monkeypatch.setattr(recording, "measure_tracks", count_threads)
    table = clip.tracks[["frame", "particle", "x_px", "y_px"]].rename(columns={"x_px": "x", "y_px": "y"})
    with threadpool_limits(2, "blas"):
        for work in (
            lambda: tracker.track(film, clip.camera_json),
            lambda: tracker.measure(table, clip.camera_json),
        ):
            with pytest.raises(InputError, match="seen"):
                work()
        assert seen == [{1}, {1}]
        assert all(pool["num_threads"] == 2 for pool in threadpool_info() if pool["user_api"] == "blas")
