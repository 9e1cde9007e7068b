"""The gap that the true model leaves on held-out clips, to compare with the gap of the search's model."""

from __future__ import annotations

import dataclasses
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from discrepancy.data.launch import find_free_launch_columns as launch_numbers
from synthcam.model import Model, build_model
from tracker.camera.camera import Camera

from .boxes import NOISES, Truth, camera_of, model_of, scene_of
from .fisher import NUDGES, SPUN, Rows, predict_positions

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class HeldOutClip:
    """A held-out clip: its measured rows, and the matrix (2n, 2n) that whitens them."""

    rows: Rows
    xy: Array
    root: Array


def read_held_out(path: Path, truth: Truth, camera: Camera) -> list[HeldOutClip]:
    """Read the clips that the analysis held out, whitened by the true noise or by the claimed errors."""
    scene, arrays, out = scene_of(truth, effects=False), np.load(path), []
    for number in sorted({int(k.partition("/")[0]) for k in arrays.files}):
        frame, ball, xy, covariance, launch = (
            arrays[f"{number}/{k}"] for k in ("frame", "ball", "xy", "covariance", "launch")
        )
        rows = Rows(scene.draw(number, truth["seed"]).drawn["launch"]["striker"], camera, frame, ball, launch)
        if truth["noise"] in NOISES:
            whole = np.kron(NOISES[truth["noise"]].covariance(rows), np.eye(2))
        else:
            whole = np.zeros((2 * len(frame),) * 2)
            for k, block in enumerate(covariance):
                whole[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = block
        out.append(HeldOutClip(rows, xy, np.linalg.inv(np.linalg.cholesky(whole))))
    return out


def chi2(model: Model, clips: list[HeldOutClip]) -> float:
    """Return the sum of whitened squares, with the launch of each clip fitted and all physics fixed.

    If the search has spinning strikers, each clip counts with a spinning or a rolling one, whichever fits better.
    """
    launches = np.array([c.rows.launch for c in clips])
    ways = [launches] if launches.shape[1] == len(NUDGES) else [launches, launches[:, : len(NUDGES)]]
    found = []
    for way in ways:
        with suppress(ValueError):
            found.append(_fit_launches(model, way, clips))
    if not found:
        raise ValueError("no motion")
    return float(np.min(found, axis=0).sum())


def _fit_launches(model: Model, places: Array, clips: list[HeldOutClip]) -> Array:
    """Fit the launches, (n, p) at the start; return the whitened squares of each clip, (n,). Raises ValueError."""
    rows, n, size = [c.rows for c in clips], len(clips), places.shape[1]
    nudges, free = SPUN[:size], launch_numbers(places)
    many = np.concatenate([np.diag(nudges), -np.diag(nudges)])

    def left(at: Array) -> list[Array]:
        there = predict_positions(model, at, rows)
        return [c.root @ (c.xy - p).ravel() for c, p in zip(clips, there, strict=True)]

    now = left(places)
    for _ in range(8):
        moved = predict_positions(model, (places[None] + many[:, None] * free).reshape(-1, size), rows * (2 * size))
        steps = np.zeros((n, size))
        for k, c in enumerate(clips):
            slopes = [(moved[j * n + k] - moved[(j + size) * n + k]).ravel() / (2 * nudges[j]) for j in range(size)]
            slope = c.root @ np.stack(slopes, axis=-1)[:, free[k]]
            steps[k, free[k]] = np.linalg.lstsq(slope, now[k], rcond=None)[0]
        gained, places = sum(float(x @ x) for x in now), places + steps
        now = left(places)
        gained -= sum(float(x @ x) for x in now)
        if abs(gained) < 1e-3:
            break
    return np.array([float(x @ x) for x in now])


def gap(truth: Truth, answer: dict[str, Any], folder: Path) -> dict[str, float]:
    """chi^2 on the clips kept out of the fitted base model, of the augmented one and of the truth; {} without.

    None of a fault or a world where one model does not hold all clips.
    """
    path = folder / "kept_out.npz"
    if (
        not path.exists() or truth["defect"] or truth["kind"] in ("ordinary", "hostile")
    ):  # one model does not hold all its clips
        return {}
    clips = read_held_out(path, truth, camera_of(truth))
    models = {"base": build_model(answer["base"]), "augmented": build_model(answer["model"]), "oracle": model_of(truth)}
    found = {"points": 2.0 * sum(map(_n, clips))}
    for name, model in models.items():
        try:
            found[name] = chi2(model, clips)
        except ValueError:  # no motion: such a model closes nothing
            if name != "augmented":
                return {}
            found[name] = found["base"]
    return found


def _n(clip: HeldOutClip) -> int:
    return len(clip.xy)
