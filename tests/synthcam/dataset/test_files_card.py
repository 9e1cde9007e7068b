"""The lines of a dataset's card do what the card says, as they stand in it."""

import importlib.util
import re
import warnings

import numpy as np
import pandas as pd
import pytest
import tifffile
from synthcam_stub import make


def readers(folder):
    """{what for: code} of the card's table."""
    rows = re.findall(r"^\| (.+?) \| `(.+)` \|$", (folder / "README.md").read_text(), re.MULTILINE)
    return dict(rows)


@pytest.fixture
def dataset(tmp_path, monkeypatch):
    made = make(tmp_path / "d", monkeypatch, clips=2)
    monkeypatch.chdir(made)
    return made


def result(code):
    space = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        exec(code, space)
    return space[re.search(r"(\w+) = ", code)[1]]


def test_all_readers_are_there(dataset):
    assert list(readers(dataset)) == [
        "NumPy",
        "trackpy, pims",
        "OpenCV",
        "ImageJ, Fiji (macro)",
        "the camera",
        "pandas, a row a clip",
        "the balls' true positions, in trackpy's columns",
        "contacts, slide ends",
    ]


@pytest.mark.parametrize("what", ["NumPy", "OpenCV", "trackpy, pims"])
def test_frames(dataset, what):
    if "pims" in what and importlib.util.find_spec("pims") is None:
        pytest.skip("pims is not installed")
    truth = np.fromfile(dataset / "clips/000000/frames.tif", np.uint8, 20 * 64 * 128, offset=offset(dataset))
    frames = result(readers(dataset)[what])
    np.testing.assert_array_equal(np.array(frames), truth.reshape(20, 64, 128))
    if "pims" in what:
        frames.close()


def offset(dataset):
    """Find where ImageJ starts to read: it takes the first page's position and the number of images in its text."""
    with tifffile.TiffFile(dataset / "clips/000000/frames.tif") as tif:
        return tif.pages[0].dataoffsets[0]


def test_imagej(dataset):
    """ImageJ's own reader needs its text in the first page, one uncompressed strip, and frames in a row."""
    assert readers(dataset)["ImageJ, Fiji (macro)"] == 'open("clips/000000/frames.tif");'
    with tifffile.TiffFile(dataset / "clips/000000/frames.tif") as tif:
        text = dict(line.split("=", 1) for line in tif.pages[0].description.splitlines() if "=" in line)
        assert text["ImageJ"]
        assert (text["images"], text["frames"]) == ("20", "20")
        assert float(text["fps"]) == 250
        assert tif.pages[0].compression == 1
        assert len(tif.pages[0].dataoffsets) == 1


def test_camera(dataset):
    assert result(readers(dataset)["the camera"])["size"] == [128, 64]


def test_tables(dataset):
    lines = readers(dataset)
    assert result(lines["pandas, a row a clip"])["clip"].tolist() == [0, 1]
    assert result(lines["contacts, slide ends"])["kind"].iloc[0] == "contact"
    tracks = result(lines["the balls' true positions, in trackpy's columns"])
    assert list(tracks.columns) == ["frame", "particle", "x", "y"]
    raw = pd.read_parquet(dataset / "clips/000000/truth/tracks.parquet")
    np.testing.assert_array_equal(tracks[["x", "y"]], raw[["x_mean_px", "y_mean_px"]])


def test_trackpy_takes_the_tracks(dataset):
    trackpy = pytest.importorskip("trackpy")
    tracks = result(readers(dataset)["the balls' true positions, in trackpy's columns"])
    moved = trackpy.motion.msd(tracks[tracks.particle == 1], mpp=3e-4, fps=250)
    assert moved["msd"].iloc[0] > 0


def test_a_challenge_gives_nothing_away(tmp_path, monkeypatch):
    scene = {"name": "painter", "effects": {"plate_tilt": {"x": 1e-4}}, "camera": {"size": [64, 48], "scale": 1.6e-3}}
    make(tmp_path / "d", monkeypatch, tmp_path / "t", clips=2, seed=123456789, scene=scene)
    said = (tmp_path / "d/README.md").read_text()
    assert "A challenge: 2 clips" in said
    for secret in ("painter", "123456789", "truth/clips.parquet", "plate_tilt"):
        assert secret not in said
    for file in (p for p in (tmp_path / "d").rglob("*") if p.is_file()):
        assert b"123456789" not in file.read_bytes()
    assert "123456789" in (tmp_path / "t/README.md").read_text()
    lines = readers(tmp_path / "t")
    monkeypatch.chdir(tmp_path / "t")
    assert len(result(lines["pandas, a row a clip"])) == 2


def test_a_name_is_no_html_and_no_markdown(tmp_path, monkeypatch):
    name = "<script>alert(1)</script>\n# [x](http://x) `rm` " + 300 * "n"
    make(tmp_path / "d", monkeypatch, clips=1, video=False, scene={"name": name})
    said = (tmp_path / "d/README.md").read_text()
    assert said.startswith("# &lt;script&gt;alert(1)&lt;/script&gt; \\# \\[x\\](http://x) \\`rm\\` nnn")
    assert "<script" not in said
    assert len(said.splitlines()[0]) < 300
