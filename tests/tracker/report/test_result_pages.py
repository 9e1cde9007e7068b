"""Pages of results: by default where there is one recording, those missing on a second run, each one reachable."""

import re

import pytest
from tracker_noisy import BENCHMARK, dataset, results
from typer.testing import CliRunner

from tracker.cli import app
from tracker.results import clip_folder

CLIPS = 2
pytestmark = pytest.mark.usefixtures("undrawn")


def run(*words):
    outcome = CliRunner().invoke(app, list(map(str, words)), catch_exceptions=False)
    assert outcome.exit_code == 0, outcome.output
    return outcome.output


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    """Tracks of two clips in one table, and the camera of them."""
    import pandas as pd

    data = dataset(tmp_path_factory.mktemp("pages") / "data", BENCHMARK, CLIPS, seed=6)
    found = results(tmp_path_factory.mktemp("found"), data, CLIPS)
    parts = [pd.read_parquet(clip_folder(found, n) / "tracks.parquet").assign(clip=n) for n in range(CLIPS)]
    path = found / "all.csv"
    pd.concat(parts).to_csv(path, index=False)
    parts[0].to_csv(found / "one.csv", index=False)
    return path, found / "one.csv", data / "clips" / "000000" / "camera.json"


def test_one_recording_has_its_page_and_several_have_none(tables, tmp_path):
    several, one, camera = tables
    said = run("measure", one, "--camera", camera, "-o", tmp_path / "one")
    assert f"{tmp_path / 'one' / 'index.html'}" in said
    assert (tmp_path / "one" / "index.html").is_file()
    run("measure", several, "--camera", camera, "-o", tmp_path / "several")
    run("measure", one, "--camera", camera, "-o", tmp_path / "none", "--no-pages")
    assert not list((tmp_path / "several").rglob("*.html"))
    assert not list((tmp_path / "none").rglob("*.html"))


def test_a_second_run_writes_the_pages_that_are_missing(tables, tmp_path):
    several, _, camera = tables
    words = ("measure", several, "--camera", camera, "-o", tmp_path / "out")
    run(*words)
    before = {p: p.read_bytes() for p in (tmp_path / "out").rglob("*") if p.is_file()}
    run(*words, "--pages")
    assert {p: p.read_bytes() for p in before} == before
    overview = (tmp_path / "out" / "index.html").read_text()
    linked = re.findall(r'href="([^"]*)"', overview)
    assert len(linked) == CLIPS
    assert all((tmp_path / "out" / place).is_file() for place in linked)
    kept = tmp_path / "out" / linked[1]
    written = kept.stat().st_mtime_ns
    (tmp_path / "out" / linked[0]).unlink()
    run(*words, "--pages")
    assert (tmp_path / "out" / linked[0]).is_file()
    assert kept.stat().st_mtime_ns == written
