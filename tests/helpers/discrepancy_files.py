"""Measured collisions as files, for the tests of the search: filmed by nobody, tracked with noise of 0.01 px."""

import sys
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pandas as pd
import pytest
from repository import ROOT
from tracker_noisy import without_local

from discrepancy import cli
from synthcam.dataset.generate import GenerationPlan, generate_dataset
from synthcam.scene.scene import read_scene
from tracker.pipeline import measure_tables

SCENE = "scenes/painter_behringer.yaml"
TRUTH = 0.1  # velocity_restitution.e
NOISE = 0.01


def table(dataset):
    """True centres with noise, in the columns of TRACKS."""
    rng, parts = np.random.default_rng(2), []
    for folder in sorted((dataset / "clips").iterdir()):
        true = pd.read_parquet(folder / "truth" / "tracks.parquet").query("visible")
        xy = true[["x_mean_px", "y_mean_px"]].to_numpy() + NOISE * rng.standard_normal((len(true), 2))
        part = pd.DataFrame({"clip": int(folder.name), "frame": true["frame"], "particle": true["particle"]})
        parts.append(part.assign(x=xy[:, 0], y=xy[:, 1], x_std=NOISE, y_std=NOISE, cov_xy=0.0))
    return pd.concat(parts, ignore_index=True)


@cache
def record():
    """dataset/, tracks.csv, camera.json and results/ of six collisions with a restitution that falls with speed.

    They are made once a process, for reading.
    """
    folder = Path(mkdtemp())
    plan = GenerationPlan((read_scene(ROOT / SCENE, (f"effects.velocity_restitution.e={TRUTH}",)),), 6, 4, False)
    generate_dataset(plan, folder / "dataset", 1, lambda done, of: None)
    table(folder / "dataset").to_csv(folder / "tracks.csv", index=False)
    camera = folder / "camera.json"
    camera.write_bytes((folder / "dataset/clips/000000/camera.json").read_bytes())
    with without_local():
        measure_tables(folder / "tracks.csv", folder / "results", camera)
    return folder


def command(*words):
    """Exit status of a discrepancy command, in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["discrepancy", *map(str, words)])
        with pytest.raises(SystemExit) as left:
            cli.main()
    return left.value.code
