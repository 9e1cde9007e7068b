"""Errors of estimates: bias, scatter, correctness of the error bars, and ratio to the Cramér-Rao bound."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from synthcam_shared.arrays import Array
from tracker.detection.likelihood.cramer_rao import localisation_bound_fixed
from tracker.measurement.collision.collision_model import TARGET, tied_to_free
from tracker.measurement.collision.derived import QUANTITY_NAMES, derive_from_free, derive_from_tied
from tracker.measurement.collision.least_squares import BallPair, WhitenedResiduals, covariance
from tracker.measurement.positions import BallTrack
from tracker.scoring.localisation import MatchedDetections

if TYPE_CHECKING:
    from tracker.camera.camera import Camera


def score_quantities(table: pd.DataFrame) -> dict[str, dict[str, float]]:
    """Score the errors of each quantity Q by each method ("", "_free", "_local", "_paper"), as in score.json.

    table: one row per clip with Q, Q_std, the truth Q_true and the bound Q_bound. Rows without an estimate or a truth
    do not count, and z counts only where an error is claimed. bound: root mean square over the rows that count; that of
    a local estimate is not known.
    """
    out = {}
    for name in QUANTITY_NAMES:
        for kind in ("", "_free", "_local", "_paper"):
            if f"{name}{kind}" in table:
                columns = (f"{name}{kind}", f"{name}{kind}_std", f"{name}_true", f"{name}{kind}_bound")
                value, std, true, bound = (
                    table[c].to_numpy(float) if c in table else np.full(len(table), np.nan) for c in columns
                )
                out[f"{name}{kind}"] = compute_error_statistics(value, std, true, bound)
    return out


def compute_error_statistics(value: Array, std: Array, true: Array, bound: Array) -> dict[str, float]:
    """Compute the statistics of a quantity's errors over clips (n,); NaN marks values not claimed or not known."""
    use = np.isfinite(value) & np.isfinite(true)
    names = ("bias", "rmse", "bound", "ratio", "z_mean", "z_std", "cover68", "cover95")
    out: dict[str, float] = {"n": int(use.sum())} | dict.fromkeys(names, np.nan)
    if not use.any():
        return out
    off = value[use] - true[use]
    claimed = np.isfinite(std[use]) & (std[use] > 1e-12 * np.maximum(np.abs(true[use]), 1e-12))
    z = off[claimed] / std[use][claimed]
    rmse, limit = float(np.sqrt((off**2).mean())), float(np.sqrt((bound[use] ** 2).mean()))
    out |= {"bias": float(off.mean()), "rmse": rmse, "bound": limit, "ratio": rmse / limit if limit > 0 else np.nan}
    if len(z):
        cover68, cover95 = (float((np.abs(z) < width).mean()) for width in (1, 1.959964))
        out |= {"z_mean": float(z.mean()), "z_std": float(z.std()), "cover68": cover68, "cover95": cover95}
    return out


def compute_true_parameters(truth: pd.DataFrame, scalars: Mapping[str, Any] | pd.Series) -> Array | None:
    """Compute the true parameters (16,) of a tied fit, for its bound; None unless both balls are tracked before.

    Positions and velocities are those of the last frame before it, extrapolated by less than a frame.
    scalars: the row of the clip in truth/clips.parquet.
    """
    t_c = float(scalars["t_c"])
    early = truth[truth["t_s"] < t_c] if np.isfinite(t_c) else truth.iloc[:0]
    first, second = (early[early["particle"] == k] for k in (0, 1))
    if not (len(first) and len(second)):
        return None
    w, v = (ball[["vx", "vy"]].iloc[-1].to_numpy(float) for ball in (first, second))
    x, y = first[["x", "y"]].iloc[-1].to_numpy(float) + w * (t_c - float(first["t_s"].iloc[-1]))
    b = float(np.clip(scalars["b"], -0.9999, 0.9999))
    heading = np.arctan2(*(v - w)[::-1])
    launch = [t_c, x, y, heading, np.arcsin(b), scalars["v0"], scalars["drag"], scalars["decel"]]
    tied = np.array([*launch, scalars["r"], np.log(scalars["mu_k"]), scalars["C"], 0, 0, 0, *w], dtype=np.float64)
    return tied if np.isfinite(tied).all() else None


def quantity_bounds(matched: MatchedDetections, cov: Array, tied: Array | None, camera: Camera) -> dict[str, float]:
    """Compute the Cramér-Rao bounds Q_bound and Q_free_bound of both fits at the true motion, for the positions found.

    cov (n, 2, 2) px^2: the bound of each position, not the error that the tracker claims. The error that a resting ball
    shares between frames is included. tied (16,): the true parameters, from `compute_true_parameters`.
    """
    if tied is None or len(cov) == 0 or not np.isfinite(cov).all():
        return {}
    balls = _tracks_at_bound(matched, cov, camera)
    if not all(len(course) for course in balls):
        return {}
    moving = bool(tied[-len(TARGET) :].any())
    free = np.asarray(tied_to_free(tied), dtype=np.float64)
    out: dict[str, float] = {}
    for kind, at, reading in (("", tied, derive_from_tied), ("_free", free, derive_from_free)):
        problem = WhitenedResiduals(BallPair(balls[0], balls[1], camera.ball_diameter, moving), kind == "")
        whole = problem.whole_cov(covariance(problem.slope(at[problem.index])))
        values = reading(at, whole, camera.ball_diameter)
        out |= {f"{n}{kind}_bound": float(s) for n, s in zip(QUANTITY_NAMES, values.std, strict=True)}
    return out


def _tracks_at_bound(matched: MatchedDetections, cov: Array, camera: Camera) -> list[BallTrack]:
    """Both balls' true tracks with the errors of the localisation bound; px to m at each position."""
    rows = matched.truth.iloc[matched.pairs[:, 0]]
    _, slope = camera.unproject(rows[["x_mean_px", "y_mean_px"]].to_numpy(float))
    found, fixed = matched.found.iloc[matched.pairs[:, 1]], np.zeros_like(cov)
    if "flux" in found and camera.sigma is not None:
        fixed = localisation_bound_fixed(
            camera, found["flux"].to_numpy(float), rows[["glint_x_px", "glint_y_px"]].to_numpy(float)
        )
    metres, shared = (slope @ c @ np.swapaxes(slope, 1, 2) for c in (cov, fixed))
    width = (camera.sigma or 0.0) * camera.scale
    balls = []
    for particle in (0, 1):
        mine = (rows["particle"] == particle).to_numpy()
        frame = rows["frame"].to_numpy(np.int64)[mine]
        position = rows[["x", "y"]].to_numpy(float)[mine]  # only how they depend on the motion matters
        start = frame / camera.fps
        balls.append(BallTrack(particle, frame, start, position, metres[mine], camera.exposure, shared[mine], width))
    return balls
