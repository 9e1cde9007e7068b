"""Tracks for the measuring tests: synthcam's own motion, with noise of known size, in the form of results."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from synthcam.dataset.generate import GenerationPlan, generate_dataset
from synthcam.scene.scene import check_scene
from tracker.camera.camera import Camera
from tracker.detection.link import Tracks
from tracker.measurement import estimate
from tracker.measurement.collision.derived import QUANTITY_NAMES
from tracker.measurement.estimate import fit_all_jointly, make_motion_table, measure

NOISE = 0.015  # px an axis
BENCHMARK = {
    "model": {
        "restitution": {"uniform": [0.75, 0.98]},
        "spin_transfer": {"uniform": [0.1, 0.36]},
        "sliding_friction": {"uniform": [0.12, 0.35]},
        "rolling_drag": {"uniform": [0.09, 0.2]},
        "rolling_decel": {"uniform": [0.006, 0.016]},
    },
    "launch": {"v0": {"uniform": [0.1, 0.6]}, "b": {"uniform": [-0.3, 0.3]}, "heading": {"uniform": [0, 6.2832]}},
    "timing": {"contact_frame": {"uniform": [20, 30]}},
}


def dataset(folder: Path, settings: dict, clips: int, seed: int = 1) -> Path:
    """A dataset without video."""
    generate_dataset(
        GenerationPlan((check_scene(settings, "test"),), clips, seed, video=False), folder, 1, lambda done, total: None
    )
    return folder


def truth_of(folder: Path, clip: int) -> tuple[pd.DataFrame, Camera]:
    home = folder / "clips" / f"{clip:06d}"
    return pd.read_parquet(home / "truth" / "tracks.parquet"), Camera.read(home / "camera.json")


def scalars_of(folder: Path) -> pd.DataFrame:
    return pd.read_parquet(folder / "truth" / "clips.parquet")


def noisy(truth: pd.DataFrame, rng: np.random.Generator, noise: float = NOISE, flux: float = 1250.0) -> Tracks:
    """Every whole ball, off by `noise` px; the tracks carry covariances that say so."""
    seen = truth[truth["visible"]].sort_values(["particle", "frame"])
    xy = seen[["x_mean_px", "y_mean_px"]].to_numpy() + rng.normal(0, noise, (len(seen), 2))
    n = len(seen)
    cov = np.broadcast_to(np.eye(2) * max(noise, 1e-6) ** 2, (n, 2, 2))
    frame, particle = (seen[c].to_numpy(np.int64) for c in ("frame", "particle"))
    return Tracks(frame, particle, xy[:, 0], xy[:, 1], cov, np.full(n, flux), np.full(n, ""), xy[:, 0], xy[:, 1])


def without(tracks: Tracks, drop: np.ndarray) -> Tracks:
    """Tracks less some rows."""
    return Tracks(**{name: value[~drop] for name, value in vars(tracks).items()})


@contextmanager
def without_local() -> Iterator[None]:
    """Within it, nothing is estimated locally, for tests of many tied and free fits."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(estimate, "estimate_locally", lambda *_: "not estimated")
        yield


@contextmanager
def without_fits() -> Iterator[None]:
    """Within it, collisions are found and not fitted, for tests of tracks."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("fit_collision", "fit_lasting_collision"):
            patch.setattr(estimate, name, lambda *_: "not fitted")
        yield


def measured(folder: Path, clips: int, noise: float = NOISE, seed: int = 0) -> pd.DataFrame:
    """One row a clip: the tied and the free fit, and the truth as NAME_true."""
    rng, rows, truths = np.random.default_rng(seed), [], scalars_of(folder)
    for clip in range(clips):
        truth, camera = truth_of(folder, clip)
        with without_local():
            (row,) = measure(noisy(truth, rng, noise), camera)
        rows.append(row | {"clip": clip} | {f"{n}_true": truths[n].iloc[clip] for n in QUANTITY_NAMES})
    return pd.DataFrame(rows)


def results(folder: Path, data: Path, clips: int, seed: int = 0, shift: float = 0.0, noise: float = NOISE) -> Path:
    """RESULTS as `tracker track` would leave them, from noisy truth."""
    rng, rows = np.random.default_rng(seed), []
    for clip in range(clips):
        truth, camera = truth_of(data, clip)
        tracks = noisy(truth, rng, noise)
        home = folder / "clips" / f"{clip:06d}"
        home.mkdir(parents=True)
        table = {"frame": tracks.frame, "particle": tracks.particle, "x": tracks.x + shift, "y": tracks.y}
        table |= {"x_std": noise, "y_std": noise, "cov_xy": 0.0, "flux": tracks.flux, "flags": ""}
        pd.DataFrame(table | {"glint_x": tracks.x, "glint_y": tracks.y}).to_parquet(home / "tracks.parquet")
        found = measure(tracks, camera)
        make_motion_table(tracks, camera, found[0]).to_parquet(home / "motion.parquet")
        (home / "camera.json").write_text(json.dumps(camera.to_dict()))
        rows += [row | {"clip": clip} for row in found]
    estimates = pd.DataFrame(rows)
    estimates.to_parquet(folder / "estimates.parquet")
    (folder / "fit.json").write_text(json.dumps(fit_all_jointly(estimates)))
    return folder
