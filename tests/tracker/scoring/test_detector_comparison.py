"""Detectors beside each other: one report of all, made once, each scored as `score` does."""

import json
import sys

import numpy as np
import pandas as pd
import pytest
import tifffile
from tracker_film import film
from tracker_noisy import dataset

from synthcam_shared.errors import InputError
from tracker.camera.recordings import open_source
from tracker.detection.detect import list_detectors, make_view
from tracker.scoring import detector_comparison as module
from tracker.scoring.detector_comparison import compare, make_comparison_tables
from tracker.scoring.score import score


@pytest.fixture(scope="module")
def filmed(tmp_path_factory):
    """A dataset of one short clip, its truth synthcam's, its pictures drawn here from the true glints."""
    folder = tmp_path_factory.mktemp("compare") / "data"
    settings = {
        "launch": {"v0": 0.3, "b": 0.1, "heading": 0.3},
        "timing": {"frames": 40, "contact_frame": 18},
        "camera": {"size": [320, 240]},
    }
    dataset(folder, settings, 1)
    home = folder / "clips" / "000000"
    truth = pd.read_parquet(home / "truth" / "tracks.parquet")
    positions = truth.pivot(index="frame", columns="particle", values=["glint_x_px", "glint_y_px"])
    paths = np.stack([positions["glint_x_px"].to_numpy(), positions["glint_y_px"].to_numpy()], axis=-1)
    frames = film(np.random.default_rng(0), paths, shape=(240, 320), peak=500.0, profile=0.0)
    tifffile.imwrite(home / "frames.tif", frames, imagej=True)
    return folder


@pytest.fixture(scope="module")
def compared(filmed, tmp_path_factory):
    report = tmp_path_factory.mktemp("report") / "compared"
    return report, compare(filmed, ["maximum_likelihood", "centroid"], report)


def test_every_detector_has_its_scores_and_its_time(filmed, compared):
    report, whole = compared
    assert list(whole["detectors"]) == ["maximum_likelihood", "centroid"]
    assert json.loads((report / "score.json").read_text()) == whole
    for name, found in whole["detectors"].items():
        assert found["ms_per_frame"] > 0
        alone = score(report / "results" / name, filmed, name).to_dict()["detectors"][name]
        assert found | {"ms_per_frame": None} == alone | {"ms_per_frame": None}
    ratios = [d["localisation"]["ratio"] for d in whole["detectors"].values()]
    assert ratios[0] < 1.2 < ratios[1]  # the glints are clipped


def test_the_page_shows_every_detector_and_asks_for_nothing(compared):
    page = (compared[0] / "index.html").read_text()
    for word in ("maximum_likelihood", "centroid", "rmse / px", "hota", "mu_k"):
        assert word in page
    assert "http" not in page
    for table in make_comparison_tables(compared[1]["detectors"]):
        assert [len(row) for row in table.rows] == [len(table.heads)] * 2


def test_asked_again_it_tracks_nothing_again(filmed, compared, monkeypatch):
    report, whole = compared
    real = module.run

    def counted(*words):
        outcome = real(*words)
        assert outcome.fresh == 0
        return outcome

    monkeypatch.setattr(module, "run", counted)
    assert compare(filmed, ["maximum_likelihood", "centroid"], report) == whole


def test_a_folder_of_anything_else_is_left_alone(filmed, tmp_path):
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(InputError, match="holds something else"):
        compare(filmed, ["centroid"], tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_peer_that_is_not_installed_is_one_line(filmed, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "trackpy", None)
    assert "trackpy_locate" in list_detectors()
    with pytest.raises(InputError, match="trackpy is not installed") as error:
        compare(filmed, ["trackpy_locate"], tmp_path / "report")
    assert "\n" not in str(error.value)


# scikit-image's blob_log answers in whole pixels: up to .71 px off, and .29 px in each axis by its own account.
PEERS = [
    ("trackpy_locate", 0.15, 0.2),
    ("opencv_components", 0.15, 0.2),
    ("skimage_regionprops", 0.15, 0.2),
    ("skimage_blob_log", 0.75, 0.3),
]


@pytest.mark.parametrize(("name", "furthest", "claimed"), PEERS)
def test_peers_find_the_same_balls(filmed, name, furthest, claimed):
    if name == "trackpy_locate":
        pytest.importorskip("trackpy")
    clip = open_source(filmed).open_clip(0)
    finder = list_detectors()[name](make_view(clip))
    truth = pd.read_parquet(filmed / "clips/000000/truth/tracks.parquet")
    whole = truth[truth["visible"]].groupby("frame")["particle"].size()
    for k in whole.index[whole == 2][[0, 5, -1]]:
        found = finder(clip.frames[k])
        true = truth.loc[truth["frame"] == k, ["glint_x_px", "glint_y_px"]].to_numpy()
        assert len(found) == 2
        off = np.sort(np.hypot(*(found.xy[:, None] - true).transpose(2, 0, 1)), axis=1)[:, 0]
        assert off.max() < furthest
        assert (np.sqrt(found.cov[:, 0, 0]) < claimed).all()


def test_two_libraries_weigh_the_same_regions_alike(filmed):
    clip = open_source(filmed).open_clip(0)
    view = make_view(clip)
    for k in (0, 20, 39):
        opencv, skimage = (
            list_detectors()[name](view)(clip.frames[k]) for name in ("opencv_components", "skimage_regionprops")
        )
        order = [np.lexsort((found.x, found.y)) for found in (opencv, skimage)]
        for name in ("x", "y", "cov", "flux", "flags"):
            one, two = (getattr(found, name)[rows] for found, rows in zip((opencv, skimage), order, strict=True))
            np.testing.assert_allclose(one, two, rtol=1e-9, atol=1e-12 if name == "cov" else 0)
