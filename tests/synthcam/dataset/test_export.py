"""Each format read back by a reader of its own, written after the format's description."""

import configparser
import gzip
import importlib.util
import json
import resource
import xml.etree.ElementTree as ET

import cv2
import numpy as np
import pandas as pd
import pytest
from synthcam_stub import SCENE, make

from synthcam.dataset.export import export, list_export_formats
from synthcam_shared.errors import InputError

CLIPS = 3


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        return make(tmp_path_factory.mktemp("export") / "d", patch, clips=CLIPS)


@pytest.fixture(scope="module")
def leaving(tmp_path_factory):
    """Balls so fast and a picture so small that they leave it."""
    scene = SCENE | {"launch": {"v0": 2.0, "b": 0.2}}
    with pytest.MonkeyPatch.context() as patch:
        return make(tmp_path_factory.mktemp("leaving") / "d", patch, clips=1, scene=scene)


def done(dataset, kind, tmp_path, **more):
    assert export(dataset, kind, tmp_path / "out", lambda done, total: None, **more) == CLIPS
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
    return tmp_path / "out"


def truth(dataset, number):
    return pd.read_parquet(dataset / f"clips/{number:06d}/truth/tracks.parquet")


def xy(table, ball):
    return table.loc[table.particle == ball, ["x_mean_px", "y_mean_px"]].to_numpy()


def test_formats_are_found():
    assert set(list_export_formats()) >= {"mot", "ptc", "trackmate", "zarr", "ffv1", "gltf"}
    assert list_export_formats()["mot"].startswith("MOTChallenge: ")


def test_mot(dataset, tmp_path):
    """As evaluation kits do: pixels less one, the picture's corner then being (0, 0)."""
    out = done(dataset, "mot", tmp_path)
    info = configparser.ConfigParser()
    info.optionxform = str
    info.read(out / "clip-000001/seqinfo.ini")
    sequence = dict(info["Sequence"])
    assert sequence == {
        "name": "clip-000001",
        "imDir": "img1",
        "frameRate": "250",
        "seqLength": "20",
        "imWidth": "128",
        "imHeight": "64",
        "imExt": ".png",
    }
    frames = sorted((out / "clip-000001" / sequence["imDir"]).glob(f"*{sequence['imExt']}"))
    assert [f.stem for f in frames] == [f"{k:06d}" for k in range(1, 21)]
    picture = cv2.imread(str(frames[7]), cv2.IMREAD_UNCHANGED)
    stack = cv2.imreadmulti(str(dataset / "clips/000001/frames.tif"), flags=cv2.IMREAD_UNCHANGED)[1]
    np.testing.assert_array_equal(picture, stack[7])

    rows = np.loadtxt(out / "clip-000001/gt/gt.txt", delimiter=",")
    assert rows.shape[1] == 9
    assert (rows[:, 0].min(), rows[:, 0].max(), set(rows[:, 1])) == (1, 20, {1, 2})
    assert set(rows[:, 7]) == {1}
    for ball in (0, 1):
        own = rows[rows[:, 1] == ball + 1]
        middle = own[:, 2:4] - 1 + own[:, 4:6] / 2 - 0.5  # from the picture's corner to its first pixel's centre
        np.testing.assert_allclose(middle, xy(truth(dataset, 1), ball), atol=1e-3)
    np.testing.assert_allclose(rows[:, 4:6], 2.38e-3 / 3e-4, atol=1e-4)


def test_mot_at_the_edge(leaving, tmp_path):
    export(leaving, "mot", tmp_path / "out", lambda done, total: None)
    rows = np.loadtxt(tmp_path / "out/clip-000000/gt/gt.txt", delimiter=",")
    table = truth(leaving, 0)
    assert len(rows) < len(table)
    assert ((rows[:, 8] > 0) & (rows[:, 8] <= 1)).all()
    whole = {(f + 1, p + 1) for f, p, v in table[["frame", "particle", "visible"]].to_numpy() if v}
    assert {(int(r[0]), int(r[1])) for r in rows if r[6]} == whole
    cut = rows[rows[:, 8] < 0.999]
    assert len(cut)
    for row in cut:  # the box's share within the picture, counted in hundredths of its side
        x, y = (row[2 + k] - 1 + (np.arange(100) + 0.5) * row[4 + k] / 100 for k in (0, 1))
        inside = np.outer((y > 0) & (y < 64), (x > 0) & (x < 128)).mean()
        assert row[8] == pytest.approx(inside, abs=0.02)


def challenge(path):
    """{track: (n, 4) of t, x, y, z}, as the challenge's scoring reads a file."""
    root = ET.parse(path).getroot()
    assert root.tag == "root"
    (contest,) = root
    assert contest.tag == "TrackContestISBI2012"
    assert {"snr", "density", "scenario"} <= set(contest.attrib)
    assert {p.tag for p in contest} == {"particle"}
    return [np.array([[float(d.get(k)) for k in "txyz"] for d in p.iter("detection")]) for p in contest]


def test_particle_tracking_challenge(dataset, tmp_path):
    out = done(dataset, "ptc", tmp_path)
    assert sorted(p.name for p in out.iterdir()) == [f"{k:06d}.xml" for k in range(CLIPS)]
    tracks = challenge(out / "000002.xml")
    assert len(tracks) == 2
    for ball, track in enumerate(tracks):
        np.testing.assert_array_equal(track[:, 0], np.arange(20))
        np.testing.assert_allclose(track[:, 1:3], xy(truth(dataset, 2), ball), atol=1e-5)
        assert not track[:, 3].any()


def test_tracks_end_with_the_picture(leaving, tmp_path):
    export(leaving, "ptc", tmp_path / "ptc", lambda done, total: None)
    export(leaving, "trackmate", tmp_path / "tm", lambda done, total: None)
    found = challenge(tmp_path / "ptc/000000.xml")
    assert sum(len(track) for track in found) < 40
    for track in found:
        assert ((track[:, 1:3] > -0.5) & (track[:, 1:3] < [127.5, 63.5])).all()
    again = trackmate(tmp_path / "tm/000000_Tracks.xml")[1]
    assert [len(t) for t in again] == [len(t) for t in found if len(t)]


def trackmate(path):
    """Read exported tracks as TrackMate's own MATLAB reader does."""
    root = ET.parse(path).getroot()
    assert root.tag == "Tracks"
    about = {k: root.get(k) for k in ("spaceUnits", "timeUnits", "frameInterval", "nTracks")}
    tracks = []
    for particle in root.findall("particle"):
        spots = particle.findall("detection")
        assert int(particle.get("nSpots")) == len(spots)
        tracks.append(np.array([[float(s.get(k)) for k in ("t", "x", "y", "z")] for s in spots]))
    return about, tracks


def test_trackmate(dataset, tmp_path):
    about, tracks = trackmate(done(dataset, "trackmate", tmp_path) / "000001_Tracks.xml")
    assert about == {"spaceUnits": "pixel", "timeUnits": "sec", "frameInterval": "0.004", "nTracks": "2"}
    for ball, track in enumerate(tracks):
        np.testing.assert_array_equal(track[:, 0], np.arange(20))
        np.testing.assert_allclose(track[:, 1:3], xy(truth(dataset, 1), ball), atol=1e-5)


@pytest.mark.parametrize("bits", [8, 12])
def test_ffv1(tmp_path, monkeypatch, bits):
    film = make(tmp_path / "d", monkeypatch, clips=1, scene=SCENE | {"sensor": {"bits": bits}})
    export(film, "ffv1", tmp_path / "out", lambda done, total: None)
    reader = cv2.VideoCapture(str(tmp_path / "out/000000/frames.mkv"), cv2.CAP_FFMPEG, [cv2.CAP_PROP_CONVERT_RGB, 0])
    code = int(reader.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little")
    frames = []
    while (got := reader.read())[0]:
        frames.append(got[1].reshape(64, 128))
    assert code.upper() == b"FFV1"
    stack = cv2.imreadmulti(str(film / "clips/000000/frames.tif"), flags=cv2.IMREAD_UNCHANGED)[1]
    np.testing.assert_array_equal(np.array(frames), np.array(stack))
    assert json.loads((tmp_path / "out/000000/camera.json").read_text())["fps"] == 250


def zarr_array(folder):
    """An array of a Zarr v3 store, read by its specification: zarr.json and the chunks."""
    about = json.loads((folder / "zarr.json").read_text())
    assert (about["zarr_format"], about["node_type"]) == (3, "array")
    shape, chunk = about["shape"], about["chunk_grid"]["configuration"]["chunk_shape"]
    out = np.full(shape, about["fill_value"] if about["data_type"] != "bool" else False, about["data_type"])
    codecs = [c["name"] for c in about["codecs"]]
    assert codecs[0] == "bytes"
    assert about["chunk_key_encoding"] == {"name": "default", "configuration": {"separator": "/"}}
    for position in np.ndindex(*[-(-s // c) for s, c in zip(shape, chunk, strict=True)]):
        path = folder.joinpath("c", *map(str, position))
        if path.is_file():
            data = unpacked(path.read_bytes(), codecs[1:])
            whole = np.frombuffer(data, np.dtype(about["data_type"]).newbyteorder("<")).reshape(chunk)
            where = tuple(slice(p * c, min((p + 1) * c, s)) for p, c, s in zip(position, chunk, shape, strict=True))
            out[where] = whole[tuple(slice(0, w.stop - w.start) for w in where)]
    return out, about


def unpacked(data, codecs):
    for name in reversed(codecs):
        if name == "gzip":
            data = gzip.decompress(data)
        else:
            assert name == "zstd"
            data = __import__("numcodecs").zstd.Zstd().decode(data)
    return data


needs_zarr = pytest.mark.skipif(not importlib.util.find_spec("zarr"), reason="zarr is not installed: synthcam[zarr]")


@needs_zarr
def test_zarr(dataset, tmp_path):
    scene = done(dataset, "zarr", tmp_path) / "stub"
    frames, about = zarr_array(scene / "frames")
    assert frames.shape == (CLIPS, 20, 64, 128)
    assert about["dimension_names"] == ["clip", "frame", "y", "x"]
    stack = cv2.imreadmulti(str(dataset / "clips/000002/frames.tif"), flags=cv2.IMREAD_UNCHANGED)[1]
    np.testing.assert_array_equal(frames[2], np.array(stack))
    x, about = zarr_array(scene / "truth/x_mean_px")
    assert about["dimension_names"] == ["clip", "particle", "frame"]
    for number in range(CLIPS):
        for ball in (0, 1):
            np.testing.assert_array_equal(x[number, ball], xy(truth(dataset, number), ball)[:, 0])
    states, about = zarr_array(scene / "truth/state")
    names = np.array(about["attributes"]["states"])[states[1, 0]]
    table = truth(dataset, 1)
    assert names.tolist() == table.state[table.particle == 0].tolist()
    rows = pd.read_parquet(dataset / "truth/clips.parquet")
    np.testing.assert_array_equal(zarr_array(scene / "scalars/v0")[0], rows.v0)
    cameras = json.loads((scene / "zarr.json").read_text())["attributes"]["cameras"]
    own = json.loads((dataset / "clips/000001/camera.json").read_text())
    assert cameras[zarr_array(scene / "camera")[0][1]] == own


@pytest.mark.skipif(bool(importlib.util.find_spec("zarr")), reason="zarr is installed")
def test_without_zarr_it_says_so(dataset, tmp_path):
    with pytest.raises(InputError, match=r"type: pip install 'synthcam\[zarr\]'"):
        export(dataset, "zarr", tmp_path / "out", lambda done, total: None)
    assert not list(tmp_path.iterdir())


def test_withheld_truth_is_given_apart(dataset, tmp_path, monkeypatch):
    hidden = make(tmp_path / "d", monkeypatch, tmp_path / "t", clips=CLIPS)
    with pytest.raises(InputError, match=r"expected a dataset with its truth \(withheld: --truth TRUTH\)"):
        export(hidden, "ptc", tmp_path / "out", lambda done, total: None)
    export(hidden, "ptc", tmp_path / "out", lambda done, total: None, truth=tmp_path / "t")
    export(dataset, "ptc", tmp_path / "open", lambda done, total: None)
    for k in range(CLIPS):
        assert (tmp_path / f"out/{k:06d}.xml").read_bytes() == (tmp_path / f"open/{k:06d}.xml").read_bytes()


def test_bad_input(dataset, tmp_path):
    for folder, kind, message in (
        (dataset, "avi", "--format avi: no such format; there are coco, ctc, ffv1, gltf, h264, mjpeg, mot, ptc"),
        (tmp_path, "mot", r"clips\.parquet: no such file"),
    ):
        with pytest.raises(InputError, match=message):
            export(folder, kind, tmp_path / "out", lambda done, total: None)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/thesis.txt").write_text("ten years")
    with pytest.raises(InputError, match="mine: exists; expected a new or empty folder"):
        export(dataset, "mot", tmp_path / "mine", lambda done, total: None)


def test_stopped_it_leaves_nothing(dataset, tmp_path):
    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export(dataset, "mot", tmp_path / "out", stop)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["..", ".", "", "../../x", "/tmp/x", "__x", "zarr.json", "a\0b", "<b>&"])
def test_a_scenes_name_leads_nowhere(tmp_path, monkeypatch, name):
    kinds = ["ptc", "zarr"] if importlib.util.find_spec("zarr") else ["ptc"]
    short = SCENE | {"name": name, "timing": {"frames": 2, "contact_frame": 1}}
    data = make(tmp_path / "d", monkeypatch, clips=1, scene=short)
    for kind in kinds:
        assert export(data, kind, tmp_path / f"in/{kind}", lambda done, total: None) == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["d", "in"]
    assert sorted(p.name for p in (tmp_path / "in").iterdir()) == kinds
    if "zarr" in kinds:
        import zarr

        (group,) = zarr.open_group(tmp_path / "in/zarr", mode="r").groups()
        assert group[1]["frames"].shape[0] == 1


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("clips/000001/camera.json", "{"),
        ("clips/000001/camera.json", "5"),
        ("clips/000001/camera.json", '{"size": [1e400, 5]}'),
        ("clips/000001/camera.json", "[" * 200_000),
        ("clips/000001/truth/scene.json", "{}"),
        ("clips/000001/truth/tracks.parquet", "no table"),
        ("truth/clips.parquet", "no table"),
        ("clips/000001/frames.tif", "no pictures"),
    ],
)
def test_a_damaged_dataset_is_one_line(tmp_path, monkeypatch, file, text):
    data = make(tmp_path / "d", monkeypatch, clips=2)
    (data / file).write_text(text)
    with pytest.raises(InputError, match="damaged") as error:
        export(data, "mot", tmp_path / "out", lambda done, total: None)
    assert "\n" not in str(error.value)
    assert [p.name for p in tmp_path.iterdir()] == ["d"]


def test_a_film_on_a_full_disk_is_no_film(tmp_path, monkeypatch):
    """A limit on the size of files stands in for the disk: what `check_room` wants, and no more."""
    long = make(tmp_path / "d", monkeypatch, clips=1, scene=SCENE | {"timing": SCENE["timing"] | {"frames": 40}})
    usual = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 16, usual[1]))
    try:
        with pytest.raises(InputError, match="File too large"):
            export(long, "ffv1", tmp_path / "out", lambda done, total: None)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, usual)
    assert [path.name for path in tmp_path.iterdir()] == ["d"]


def test_the_same_film_has_the_same_bytes(dataset, tmp_path):
    one, two = (done(dataset, "ffv1", tmp_path / k) / "000000/frames.mkv" for k in "ab")
    assert one.read_bytes() == two.read_bytes()
