"""The shift of each measured quantity by each defect of a tracker, which is put alone into true tracks.

The true tracks have the noise of the Cramér-Rao bound. It is the same for all trackers and defects, so every difference
is due to the defect. The defects:

- locking: the error as a function of the phase of the glint within its pixel, as in the tracks of this tracker
- glint: the share of the vector from centre to glint by which its own positions are off, before the camera file
  corrects them; 1 for a tracker that takes the glint for the centre of the ball
- lost: the frames in which it missed a ball are removed
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from synthcam_shared.arrays import Array
from tracker.benchmark.judging.position_errors import PositionMatches, fit_pixel_locking
from tracker.benchmark.suite.definition import Suite, SuitePart, covariances
from tracker.camera.camera import Camera
from tracker.measurement.collision.adequacy import MEASURED
from tracker.recording import measure_clip
from tracker.settings import FitSettings
from tracker.tables.rows import to_tracks

TrueTracks = tuple[pd.DataFrame, Camera, Mapping[str, Any]]  # tracks, camera, and what is measured in these tracks
DEFECTS = ("locking", "glint", "lost")


def glint_share(pairs: pd.DataFrame, min_lever_px: float = 0.05) -> float:
    """The share of the vector from centre to glint that a tracker leaves; NaN where its rms is under this limit."""
    lever = pairs[["lever_x", "lever_y"]].to_numpy(np.float64).ravel()
    own = pairs[["own_x", "own_y"]].to_numpy(np.float64).ravel()
    use = np.isfinite(lever) & np.isfinite(own)
    weight = float((lever[use] ** 2).sum())
    return float((lever[use] * own[use]).sum()) / weight if weight > min_lever_px**2 * max(use.sum(), 1) else np.nan


def measure_shifts_by_defects(held: PositionMatches, base: Mapping[int, TrueTracks]) -> dict[str, Any]:
    """Measure how far each defect alone moves each quantity.

    `base` has, by clip, the value of `simulate_at_bound`. Returns `size`: of locking (px, peak to peak), of glint (the
    share), of lost (the share of the balls); and by defect and quantity, tied and free: n, bias (mean shift), rms, and
    in_errors, the rms shift over the bound; `unmeasured`, the number of clips that cannot be measured any more.
    """
    waves, peak = fit_pixel_locking(held.pairs)
    share = glint_share(held.pairs)
    missed = sum(len(rows) for rows in held.lost.values())
    size = {"locking": peak, "glint": share, "lost": missed / max(missed + len(held.pairs), 1)}
    disturb: dict[str, Callable[[int, pd.DataFrame], pd.DataFrame]] = {
        "locking": lambda clip, table: _lock_to_pixels(table, waves),
        "glint": lambda clip, table: _shift(table, np.nan_to_num(share) * _lever(table)),
        "lost": lambda clip, table: _drop_lost(table, held.lost.get(clip)),
    }
    out: dict[str, Any] = {"size": size}
    for name, change in disturb.items():
        changed = {clip: change(clip, table) for clip, (table, _, _) in base.items() if clip in held.lost}
        rows = {  # what changes nothing is not measured again
            clip: base[clip][2] if table is base[clip][0] else measure_collision(table, base[clip][1])
            for clip, table in changed.items()
        }
        out[name] = _shifts(rows, {clip: one[2] for clip, one in base.items()})
    return out


def simulate_at_bound(suite: Suite, part: SuitePart, clip: int, seed: int = 21) -> TrueTracks:
    """Simulate a clip without a defect: true tracks with the noise of the bound, camera, and measurement."""
    camera = suite.camera(part.film, clip)
    truth = suite.tracks(part.truth, clip)
    truth = truth[truth["visible"].to_numpy(bool) & np.isfinite(truth["xx"].to_numpy(float))].reset_index(drop=True)
    rng = np.random.default_rng([seed, clip])
    cov = covariances(truth)
    noise = np.einsum("nij,nj->ni", np.linalg.cholesky(cov), rng.standard_normal((len(truth), 2)))
    table = truth.assign(
        x=truth["x_mean_px"] + noise[:, 0],
        y=truth["y_mean_px"] + noise[:, 1],
        x_std=np.sqrt(cov[:, 0, 0]),
        y_std=np.sqrt(cov[:, 1, 1]),
        cov_xy=cov[:, 0, 1],
    )
    return table, camera, measure_collision(table, camera)


def measure_collision(table: pd.DataFrame, camera: Camera) -> Mapping[str, Any]:
    """Measure the first collision in tracks with or without a defect; an empty row where there is none."""
    columns = ["frame", "particle", "x", "y", "x_std", "y_std", "cov_xy"]
    rows, _ = measure_clip(to_tracks(table[columns], "true tracks"), camera, FitSettings(local_window_s=0))
    return next((row for row in rows if row["status"] in MEASURED), {})


def _lever(table: pd.DataFrame) -> Array:
    """Vector from centre to glint, px."""
    glint, centre = table[["glint_x_px", "glint_y_px"]], table[["x_px", "y_px"]]
    by: Array = glint.to_numpy(np.float64) - centre.to_numpy(np.float64)
    return by


def _shift(table: pd.DataFrame, by: Array) -> pd.DataFrame:
    return table.assign(x=table["x"] + by[:, 0], y=table["y"] + by[:, 1])


def _lock_to_pixels(table: pd.DataFrame, waves: Array) -> pd.DataFrame:
    phase = table[["glint_x_px", "glint_y_px"]].to_numpy(np.float64) * 2 * np.pi
    parts = [np.cos(phase), np.sin(phase), np.cos(2 * phase), np.sin(2 * phase)]
    by: Array = np.sum([part * waves[:, k] for k, part in enumerate(parts)], axis=0)
    return _shift(table, by)


def _drop_lost(table: pd.DataFrame, lost: pd.DataFrame | None) -> pd.DataFrame:
    if lost is None or not len(lost):
        return table
    gone = pd.MultiIndex.from_frame(lost)
    return table[~pd.MultiIndex.from_frame(table[["frame", "particle"]]).isin(gone)].reset_index(drop=True)


def _shifts(rows: Mapping[int, Mapping[str, Any]], base: Mapping[int, Mapping[str, Any]]) -> dict[str, Any]:
    known = [clip for clip in rows if base[clip]]
    out: dict[str, Any] = {"unmeasured": sum(not rows[clip] for clip in known), "clips": len(known)}
    quantities = ("r", "tau1", "energy_fraction")
    for name in (f"{quantity}{kind}" for quantity in quantities for kind in ("", "_free")):
        pairs = [(rows[c].get(name, np.nan), base[c][name], base[c][f"{name}_std"]) for c in known if rows[c]]
        values = np.array(pairs, dtype=np.float64).reshape(-1, 3)
        values = values[np.isfinite(values).all(axis=1)]
        out[name] = {"n": len(values)} | dict.fromkeys(("bias", "rms", "in_errors"), np.nan)
        if len(values):
            shift = values[:, 0] - values[:, 1]
            rms, bound = (float(np.sqrt((x**2).mean())) for x in (shift, values[:, 2]))
            out[name] |= {"bias": float(shift.mean()), "rms": rms, "in_errors": rms / bound}
    return out
