"""Tracks for other programs: what is written reads back, here and there, as does what synthcam writes of the truth."""

import json
import sys
import xml.etree.ElementTree as ET

import numpy as np
import pandas as pd
import pytest
from tracker_film import CAMERA, write_dataset
from tracker_noisy import without_fits

import synthcam
from synthcam.dataset import export as truth_export
from synthcam.dataset.generate import GenerationPlan
from synthcam.dataset.generate import generate_dataset as generate
from synthcam_shared.errors import InputError
from tracker import cli, pipeline
from tracker.export import export
from tracker.tables.read import list_table_formats, read_tracks

SMALL = {"camera": {"size": [200, 160], "scale": 3e-4}, "timing": {"frames": 30, "contact_frame": 10}}
WRITTEN = sorted(name for name, one in list_table_formats().items() if hasattr(one, "write"))


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("export")
    write_dataset(folder / "data", np.random.default_rng(0))
    write_dataset(folder / "one", np.random.default_rng(0), clips=1)
    with without_fits():
        pipeline.run(folder / "data", folder / "results", "maximum_likelihood", 1)
        pipeline.run(folder / "one", folder / "single", "maximum_likelihood", 1)
    return folder


@pytest.mark.parametrize("kind", WRITTEN)
def test_round_trip(kind, results, tmp_path):
    assert export(results / "single", kind, tmp_path / "tracks.out") == 1
    table = pd.read_parquet(results / "single/clips/000000/tracks.parquet")
    back = read_tracks(tmp_path / "tracks.out", CAMERA)
    tracks, _ = back.clips[0]
    assert back.camera.fps == CAMERA["fps"]
    assert not any("fps" in note for note in map(str, back.notes))
    assert tracks.frame.tolist() == table["frame"].tolist()
    assert np.unique(tracks.particle).size == 2
    assert np.abs(tracks.xy - table[["x", "y"]].to_numpy()).max() < 1e-4


def test_own_columns_keep_everything(results, tmp_path):
    export(results / "single", "csv", tmp_path / "tracks.csv")
    assert (tmp_path / "tracks.csv").read_bytes() == (results / "single/clips/000000/tracks.csv").read_bytes()


def test_several_clips_are_a_folder(results, tmp_path, monkeypatch, capsys):
    words = ["tracker", "export", results / "results", "--format", "mot", "-o", tmp_path / "out", "--json"]
    monkeypatch.setattr(sys, "argv", [str(word) for word in words])
    cli.app(standalone_mode=False)
    said = json.loads(capsys.readouterr().out)
    assert said == {"exported": str(tmp_path / "out"), "format": "mot", "clips": 2}
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["000000.txt", "000001.txt"]
    assert list(tmp_path.iterdir()) == [tmp_path / "out"]
    for clip in ("000000", "000001"):  # each file has the tracks of its own clip
        own = pd.read_parquet(results / f"results/clips/{clip}/tracks.parquet").sort_values(["frame", "particle"])
        boxes = np.loadtxt(tmp_path / f"out/{clip}.txt", delimiter=",")
        assert np.allclose(boxes[:, 2:4] + boxes[:, 4:6] / 2, own[["x", "y"]] + 1.5, atol=2e-4)


def test_trackpy_takes_its_table(results, tmp_path):
    """trackpy's own mean square displacement of the file."""
    trackpy = pytest.importorskip("trackpy")
    export(results / "single", "trackpy", tmp_path / "tracks.csv")
    table = pd.read_csv(tmp_path / "tracks.csv")
    own = pd.read_parquet(results / "single/clips/000000/tracks.parquet")
    mean = trackpy.msd(table[table["particle"] == 1], 1, 1, max_lagtime=1)["msd"]
    steps = np.diff(own.loc[own["particle"] == 1, ["x", "y"]].to_numpy(), axis=0)
    assert np.allclose(mean, (steps**2).sum(axis=1).mean())
    assert np.allclose(
        table["ep"] ** 2, (table.merge(own, on=["frame", "particle"])[["x_std", "y_std"]] ** 2).mean(axis=1)
    )


def test_boxes_are_the_balls(results, tmp_path):
    """As wide as a ball is seen; the picture's corner is (1, 1)."""
    export(results / "single", "mot", tmp_path / "tracks.txt")
    boxes = np.loadtxt(tmp_path / "tracks.txt", delimiter=",")
    own = pd.read_parquet(results / "single/clips/000000/tracks.parquet").sort_values(["frame", "particle"])
    side = CAMERA["ball_diameter"] / CAMERA["scale"]
    assert np.allclose(boxes[:, 4:6], side, atol=1e-4)
    assert np.allclose(boxes[:, 2:4] - 1 + side / 2, own[["x", "y"]] + 0.5, atol=2e-4)
    assert np.allclose(boxes[:, :2] - 1, own[["frame", "particle"]])


def test_the_simple_xml_has_trackmates_attributes(results, tmp_path):
    export(results / "single", "trackmate", tmp_path / "tracks.xml")
    root = ET.parse(tmp_path / "tracks.xml").getroot()
    assert {"nTracks", "spaceUnits", "frameInterval", "timeUnits", "from"} <= set(root.attrib)
    assert [particle.get("nSpots") for particle in root] == [str(len(particle)) for particle in root]


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    folder = tmp_path_factory.mktemp("truth")
    scene = synthcam.Scene.read("painter_behringer", **SMALL)
    assert generate(GenerationPlan((scene,), 1, 3), folder / "data", 1, lambda done, of: None).failed == ()
    return folder / "data"


@pytest.mark.parametrize(
    ("kind", "file"), [("mot", "clip-000000/gt/gt.txt"), ("ptc", "000000.xml"), ("trackmate", "000000_Tracks.xml")]
)
def test_what_synthcam_writes_is_read(kind, file, truth, tmp_path):
    truth_export.export(truth, kind, tmp_path / "out", lambda done, of: None)
    back = read_tracks(tmp_path / "out" / file, truth / "clips/000000/camera.json")
    tracks, _ = back.clips[0]
    table = pd.read_parquet(truth / "clips/000000/truth/tracks.parquet")
    table = table[table["visible"]].sort_values(["particle", "frame"])
    assert len(tracks) == len(table)
    assert np.abs(tracks.xy - table[["x_mean_px", "y_mean_px"]].to_numpy()).max() < 2e-4
    assert tracks.frame.tolist() == table["frame"].tolist()


def test_trackeval_takes_its_boxes(truth, tmp_path):
    """TrackEval's own readers of both sides and its HOTA; it brings an OpenCV of its own, so it is in no extra."""
    trackeval = pytest.importorskip("trackeval")
    truth_export.export(truth, "mot", tmp_path / "gt", lambda done, of: None)
    pipeline.run(truth, tmp_path / "results", "maximum_likelihood", 1)
    (tmp_path / "trackers/own/data").mkdir(parents=True)
    export(tmp_path / "results", "mot", tmp_path / "trackers/own/data/clip-000000.txt")
    folders = {"GT_FOLDER": str(tmp_path / "gt"), "TRACKERS_FOLDER": str(tmp_path / "trackers"), "SKIP_SPLIT_FOL": True}
    which = {"TRACKERS_TO_EVAL": ["own"], "SEQ_INFO": {"clip-000000": None}, "DO_PREPROC": False, "PRINT_CONFIG": False}
    dataset = trackeval.datasets.MotChallenge2DBox(folders | which)
    raw = dataset.get_raw_seq_data("own", "clip-000000")
    found = trackeval.metrics.HOTA().eval_sequence(dataset.get_preprocessed_seq_data(raw, "pedestrian"))
    assert found["HOTA"].min() == 1
    assert found["LocA"].mean() > 0.99


@pytest.mark.parametrize(
    ("kind", "source", "output", "said"),
    [
        ("trackmat", "single", "new", "there are csv, mot, ptc, trackmate, trackpy; did you mean trackmate?"),
        ("tracker_osp", "single", "new", "no such format"),
        ("csv", "data", "new", "expected RESULTS"),
        ("csv", "nowhere", "new", "expected RESULTS"),
        ("csv", "single", "data", "exists, expected a new file"),
        ("csv", "results", "data", "exists, expected a new folder"),
    ],
)
def test_wrong_exports(kind, source, output, said, results):
    before = sorted(results.rglob("*"))
    with pytest.raises(InputError) as error:
        export(results / source, kind, results / output)
    assert said in str(error.value)
    assert "\n" not in str(error.value)
    assert sorted(results.rglob("*")) == before
