"""The gap that the truth itself would leave on the clips kept out, beside what the search left there."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthcam.model import Model, build
from tracker.camera.camera import Camera

from .boxes import NOISES, Truth, camera_of, model_of, scene_of
from .fisher import NUDGES, Rows, where

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Held:
    """A clip kept out of every fit: where it has measurements, and what whitens them, (2n, 2n)."""

    rows: Rows
    xy: Array
    root: Array


def held(path: Path, truth: Truth, camera: Camera) -> list[Held]:
    """What the analysis kept out; whitened by the true noise, or by what the tracker claims."""
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
        out.append(Held(rows, xy, np.linalg.inv(np.linalg.cholesky(whole))))
    return out


def chi2(model: Model, clips: list[Held]) -> float:
    """Sum of whitened squares with each clip's launch fitted and all physics frozen."""
    places, many = np.array([c.rows.launch for c in clips]), np.concatenate([np.diag(NUDGES), -np.diag(NUDGES)])
    rows, n = [c.rows for c in clips], len(clips)

    def left(at: Array) -> list[Array]:
        there = where(model, at, rows)
        return [c.root @ (c.xy - p).ravel() for c, p in zip(clips, there, strict=True)]

    now = left(places)
    for _ in range(8):
        moved = where(model, (places[None] + many[:, None]).reshape(-1, 6), rows * 12)
        steps = []
        for k, c in enumerate(clips):
            slopes = [(moved[j * n + k] - moved[(j + 6) * n + k]).ravel() / (2 * NUDGES[j]) for j in range(6)]
            steps.append(np.linalg.lstsq(c.root @ np.stack(slopes, axis=-1), now[k], rcond=None)[0])
        gained, places = sum(float(x @ x) for x in now), places + np.array(steps)
        now = left(places)
        gained -= sum(float(x @ x) for x in now)
        if abs(gained) < 1e-3:
            break
    return sum(float(x @ x) for x in now)


def gap(truth: Truth, answer: dict[str, Any], folder: Path) -> dict[str, float]:
    """chi^2 on the clips kept out of the fitted base model, of the augmented one and of the truth; {} without.

    None of a fault or a world where one model does not hold all clips.
    """
    path = folder / "kept_out.npz"
    if (
        not path.exists() or truth["defect"] or truth["kind"] in ("ordinary", "hostile")
    ):  # one model does not hold all its clips
        return {}
    clips = held(path, truth, camera_of(truth))
    models = {"base": build(answer["base"]), "augmented": build(answer["model"]), "oracle": model_of(truth)}
    found = {"points": 2.0 * sum(map(_n, clips))}
    for name, model in models.items():
        try:
            found[name] = chi2(model, clips)
        except ValueError:  # no motion: such a model closes nothing
            if name != "augmented":
                return {}
            found[name] = found["base"]
    return found


def _n(clip: Held) -> int:
    return len(clip.xy)
