"""docs/format.md against what the commands really write, those of the README with fewer and smaller clips."""

import json
import re
import shlex
import shutil
import sys
import tarfile
from contextlib import nullcontext
from pathlib import Path

import pandas as pd
import pytest
from discrepancy_clips import only
from report_pages import undrawn
from repository import ROOT
from tracker_noisy import without_local

import discrepancy.cli
import synthcam.cli
import tracker.cli
from synthcam import Scene
from synthcam.library import library

PAGE = (ROOT / "docs" / "format.md").read_text()
PROGRAMS = {"synthcam": synthcam.cli.main, "tracker": tracker.cli.main, "discrepancy": discrepancy.cli.main}


def run(program: str, *words: str, cwd: Path) -> None:
    """A command in this process; a search knows two effects and one free law only."""
    with pytest.MonkeyPatch.context() as patch, undrawn():
        only(patch, ("force_place",), **{name: library()[name] for name in ("plate_tilt", "rolling_quadratic")})
        patch.chdir(cwd)
        patch.setattr(sys, "argv", [program, *words])
        with pytest.raises(SystemExit) as left:
            PROGRAMS[program]()
    assert left.value.code == 0


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run the README's commands with fewer and smaller clips, and make a dataset with its results and score."""
    folder = tmp_path_factory.mktemp("format")
    blocks = re.findall(r"^```(\w*)\n(.*?)^```$", (ROOT / "README.md").read_text(), re.S | re.M)
    readme = [line for kind, block in blocks for line in block.splitlines() if kind == "sh"]
    assert [line.split()[:2] for line in readme] == [
        ["synthcam", "generate"],
        ["tracker", "track"],
        ["discrepancy", "find"],
    ]
    small = "--set camera.size=[384,288] --set timing.frames=48"
    scored = [
        f"synthcam generate scenes/benchmark.yaml -o out/benchmark --clips 1 {small}",
        "tracker track out/benchmark -o out/benchmark_results --no-pages",
        "tracker score out/benchmark_results --truth out/benchmark -o out/score",
        "tracker measure crowd.csv --camera crowd.json -o out/crowd",
    ]
    crowd = Scene.read("tray", timing={"frames": 12}).draw(seed=1)
    crowd.tracks[["frame", "particle"]].assign(x=crowd.tracks.x_mean_px, y=crowd.tracks.y_mean_px).to_csv(
        folder / "crowd.csv", index=False
    )
    (folder / "crowd.json").write_text(json.dumps(crowd.camera_json))
    (folder / "scenes").symlink_to(ROOT / "scenes")
    for commands, local in ((readme, without_local), (scored, nullcontext)):  # the search takes no local estimates
        for command in commands:
            fewer = command.replace("--clips 20", f"--clips 6 {small}")  # a search needs 6
            fewer = fewer.replace("tracker track", "tracker track --workers 1")
            with local():
                run(*shlex.split(fewer, comments=True), cwd=folder)
    return folder / "out"


def listed(name: str) -> list[str]:
    """The names that follow **name** on the page, up to the end of the sentence."""
    text = re.search(rf"\*\*{re.escape(name)}\*\*:(.*?)(?:\.\s|\.$|\n\n)", PAGE, re.S)
    assert text, f"docs/format.md does not tell of {name}"
    return re.sub(r"\([^)]*\)", "", " ".join(text[1].split())).replace(",", " ").split()


@pytest.mark.parametrize(
    ("name", "path"),
    [
        ("truth/clips.parquet", "benchmark/truth/clips.parquet"),
        ("truth/tracks.parquet", "benchmark/clips/000000/truth/tracks.parquet"),
        ("truth/events.parquet", "benchmark/clips/000000/truth/events.parquet"),
        ("motion.parquet", "benchmark_results/clips/000000/motion.parquet"),
        ("contacts.parquet", "crowd/contacts.parquet"),
    ],
)
def test_columns_stand_on_the_page_in_order(made: Path, name: str, path: str) -> None:
    assert pd.read_parquet(made / path).columns.tolist() == listed(name)


def test_tracks_have_the_columns_of_the_page(made: Path) -> None:
    columns = pd.read_parquet(made / "benchmark_results/clips/000000/tracks.parquet").columns.tolist()
    names = listed("tracks")
    assert columns[: len(names)] == names
    assert pd.read_csv(made / "benchmark_results/clips/000000/tracks.csv").columns.tolist() == columns


def test_estimates_hold_every_quantity_four_ways(made: Path) -> None:
    table = pd.read_parquet(made / "benchmark_results/estimates.parquet")
    assert {"clip", "collision", "striker", "status", "cov"} <= set(table.columns)
    text = re.search(r"for each of (.*?): NAME", " ".join(PAGE.split()))
    assert text
    names = text[1].split()
    assert len(names) == 20
    missing = [n + s + e for n in names for s in ("", "_free", "_local", "_paper") for e in ("", "_std")]
    assert [m for m in missing if m not in table.columns] == []


def test_camera_file_holds_what_the_page_lists(made: Path) -> None:
    camera = json.loads((made / "benchmark/clips/000000/camera.json").read_text())
    text = re.search(r"\*\*camera\.json\*\*:(.*?)Needed are", PAGE, re.S)
    assert text
    named = set(re.findall(r"`(\w+)`", text[1]))
    assert set(camera) <= named
    assert set(camera["sensor"]) <= named
    assert {"K", "R", "t", "size", "fps", "exposure", "scale", "lamp", "psf", "sensor", "striker"} <= set(camera)


def test_score_and_search_hold_their_keys(made: Path) -> None:
    score = json.loads((made / "score/score.json").read_text())
    found = next(iter(score["detectors"].values()))
    assert set(found["localisation"]) == {"n", "missed", "false", "rmse_px", "bound_px", "ratio", "phase_bias_px"}
    tracking = {"alpha", "beta", "jsc", "jsc_theta", "mota", "motp", "idf1", "hota", "deta", "assa", "swaps"}
    assert set(found["tracking"]) == tracking
    quantity = {"n", "bias", "rmse", "bound", "ratio", "z_mean", "z_std", "cover68", "cover95"}
    assert set(found["quantities"]["r_free"]) == quantity
    search = json.loads((made / "search/discrepancy.json").read_text())
    keys = {"verdict", "named", "aliases", "outside", "where", "ranking", "gap", "experiment", "withdrawn"}
    assert keys <= set(search)
    assert (search["verdict"], [named["effect"] for named in search["named"]]) == ("named", ["plate_tilt"])
    part = {"before", "after", "floor", "before_um", "after_um", "floor_um"}
    assert set(search["gap"]) == part | {"closure", "by_phase", "by_claim", "outliers"}
    assert all(set(p) == part for p in search["gap"]["by_phase"].values())
    for page in ("score/index.html", "search/index.html"):
        assert "http" not in re.sub(r"http://www.w3.org\S*", "", (made / page).read_text())


def test_streams_hold_what_the_page_lists(made: Path) -> None:
    small = "--set camera.size=[96,64] --set camera.scale=3e-4 --set timing.frames=2 --set timing.contact_frame=1"
    command = f"stream scenes/oblique.yaml -o out/stream --clips 1 {small}"
    run("synthcam", *shlex.split(command), "--workers", "1", cwd=made.parent)
    text = PAGE.partition("**Streams.**")[2].partition("**Reproducibility.**")[0]
    about = json.loads((made / "stream/stream.json").read_text())
    listed_keys = re.search(r"stream\.json +(.*?) \(null", text)
    assert listed_keys
    assert list(about) == listed_keys[1].split(", ")
    with tarfile.open(made / "stream/shard-000000.tar") as tar:
        assert tar.getnames() == [f"000000-{k:06d}.{end}" for k in (0, 1) for end in ("png", "labels.png", "json")]
        file = tar.extractfile("000000-000001.json")
        assert file
        sample = json.loads(file.read())
    row = re.search(r"\| \.json \| (.*?) \|", text)
    assert row
    assert set(re.findall(r"\w+", row[1].partition(" and `camera`")[0])) == {*sample, *sample["balls"][0]} - {"camera"}


def test_results_without_any_truth_are_the_same_bytes(made: Path, tmp_path: Path) -> None:
    """The tracker opens frames and camera.json only."""
    bare = tmp_path / "benchmark"
    shutil.copytree(made / "benchmark", bare, ignore=shutil.ignore_patterns("truth"))
    assert not list(bare.rglob("truth"))
    run("tracker", "track", "benchmark", "-o", "results", "--workers", "1", "--no-pages", cwd=tmp_path)
    whole = made / "benchmark_results"
    files = [p.relative_to(whole) for p in sorted(whole.rglob("*")) if p.is_file()]
    assert {"tracks.parquet", "tracks.csv", "motion.parquet", "estimates.json", "estimates.parquet", "fit.json"} <= {
        file.name for file in files
    }
    for name in files:
        if name.name != "run.json":
            assert (tmp_path / "results" / name).read_bytes() == (whole / name).read_bytes(), name
