"""A row of estimates.parquet: its columns where nothing is measured, and covariances as text."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tracker.measurement.collision.collision_model import SPIN
from tracker.measurement.collision.derived import QUANTITY_NAMES
from tracker.measurement.energy_momentum import BEFORE

if TYPE_CHECKING:
    from tracker.camera.camera import Camera

Floats = NDArray[np.float64]


def empty_row(camera: Camera, status: str, index: int = 0) -> dict[str, Any]:
    """A row in which nothing is measured."""
    row: dict[str, Any] = {"collision": index, "striker": camera.striker, "status": status}
    for name in QUANTITY_NAMES:
        for kind in ("", "_free", "_paper"):
            row[f"{name}{kind}"] = row[f"{name}{kind}_std"] = np.nan
    row |= dict.fromkeys(("particle1", "particle2", "frame_first", "frame_last"), -1)
    row |= {"cov": "{}", "heading": np.nan, "x1": np.nan, "y1": np.nan}
    row |= dict.fromkeys((*BEFORE, *(f"{name}_std" for name in BEFORE[: len(SPIN)])), np.nan)
    row |= {"noise": "given", "noise_px": np.nan, "noise_ratio": np.nan}
    row |= {"noise_rho": 0.0, "adequate": np.nan, "adequate_free": np.nan, "agree": np.nan, "flags": ""}
    for suffix in ("", "_free"):
        row |= {f"chi2{suffix}": np.nan, f"dof{suffix}": 0, f"dropped{suffix}": 0}
    return row


def covariances(blocks: dict[str, Floats], names: tuple[str, ...], shared: dict[str, Any]) -> str:
    """Covariances by fit as JSON, in the order of `names`; seven digits, which keeps them positive definite enough.

    With a part that several rows share, which may be by far the larger one, all digits.
    """
    out: dict[str, Any] = {"names": list(names)}
    digits = 17 if shared else 7
    for fit, cov in blocks.items():
        out[fit] = [[float(f"{v:.{digits}g}") if np.isfinite(v) else None for v in line] for line in cov]
    return json.dumps(out | ({"shared": shared} if shared else {}), separators=(",", ":"))
