"""Errors of the positions in a part of a suite, also against the phase within the pixel and the gap between balls."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pandas as pd

from synthcam_shared.arrays import Array
from tracker.benchmark.judging.tracker_results import TrackerResults
from tracker.benchmark.suite.definition import Suite, SuitePart, covariances
from tracker.scoring.localisation import MatchedDetections, match, score_positions
from tracker.scoring.score import to_track_points
from tracker.scoring.tracking_metrics import GATE_PX, score_tracks


@dataclass(frozen=True)
class PositionMatches:
    """Positions of a tracker in a part of a suite, paired with the truth.

    statistics: errors of positions, and tracking measures.
    pairs: a row for each position found.
    lost: by clip, frame and particle of the balls wholly in view that were missed.
    """

    statistics: dict[str, float]
    pairs: pd.DataFrame
    lost: dict[int, pd.DataFrame]


def match_positions(suite: Suite, tracked: TrackerResults, part: SuitePart) -> PositionMatches:
    """Pair the positions of a tracker with the truth of a part.

    Columns of `pairs`: clip, frame, particle; track (of the tracker); off_x, off_y (px, found - true); std_x, std_y
    (claimed); own_x, own_y (px, off of what the tracker itself found, before glints are taken to centres); lever_x,
    lever_y (px, from centre to glint); phase_x, phase_y (of the glint within the pixel, -.5 to .5); moving_x, moving_y;
    gap (diameters) and along (px, towards the other ball) in films of two balls; bound (px).
    """
    clips, dots, rows, lost = [], [], [], {}
    for clip in tracked.sample.of(part):
        camera = suite.camera(part.film, clip)
        truth, (found, _) = suite.tracks(part.truth, clip), tracked.of(part.film, clip)
        near = match(truth, found, GATE_PX, camera.diameter_px)
        cov = covariances(truth)[near.pairs[:, 0]]
        clips.append((near, cov))
        dots.append(to_track_points(near))
        rows.append(_pairs(near, cov, camera.diameter_px, tracked.own).assign(clip=clip))
        missed = truth["visible"].to_numpy(bool, copy=True)
        missed[near.pairs[:, 0]] = False
        lost[clip] = truth.loc[missed, ["frame", "particle"]]
    pairs = pd.concat(rows, ignore_index=True)
    figures = score_positions(clips)
    whole, n = figures["n"] + figures["missed"], figures["n"]
    figures["clips"] = len(clips)
    figures["found"] = n / whole if whole else np.nan
    figures["jaccard"] = n / (whole + figures["false"]) if whole else np.nan
    figures["phase_bias_px"] = fit_pixel_locking(pairs)[1]
    z = pairs[["off_x", "off_y"]].to_numpy() / pairs[["std_x", "std_y"]].to_numpy()
    z = z[np.isfinite(z)]
    figures["z"] = float(np.sqrt((z**2).mean())) if len(z) else np.nan  # 1 where the claimed errors are correct
    figures["efficiency"] = compute_efficiency(figures)
    tracking = score_tracks(dots)
    measures = ("alpha", "beta", "jsc", "jsc_theta", "mota", "idf1", "hota", "swaps")
    return PositionMatches(figures | {name: tracking[name] for name in measures}, pairs, lost)


def compute_efficiency(figures: Mapping[str, float]) -> float:
    """Efficiency: 1 where every ball is found at its bound and nothing else is; NaN without a bound."""
    if not figures["n"]:
        return 0.0
    return float(figures["jaccard"] / max(figures["ratio"], 1.0)) if np.isfinite(figures["ratio"]) else np.nan


def _pairs(near: MatchedDetections, cov: Array, ball_px: float, point: str) -> pd.DataFrame:
    true, found = near.truth.iloc[near.pairs[:, 0]], near.found.iloc[near.pairs[:, 1]]
    out = true[["frame", "particle"]].reset_index(drop=True)
    out["track"] = found["particle"].to_numpy()
    centre = true[["x_mean_px", "y_mean_px"]].to_numpy(np.float64)
    lever = true[["glint_x_px", "glint_y_px"]].to_numpy(np.float64) - true[["x_px", "y_px"]].to_numpy(np.float64)
    own = near.off
    if point == "glint" and "glint_x" in found:
        raw = found[["glint_x", "glint_y"]].to_numpy(np.float64) - centre
        own = np.where(np.isfinite(raw), raw, own)
    moving = near.moving
    bright = centre + np.where(np.isfinite(lever), lever, 0.0)
    for k, axis in enumerate("xy"):
        std = found[f"{axis}_std"].to_numpy(np.float64) if f"{axis}_std" in found else np.full(len(out), np.nan)
        out[f"off_{axis}"], out[f"std_{axis}"], out[f"own_{axis}"] = near.off[:, k], std, own[:, k]
        out[f"lever_{axis}"], out[f"moving_{axis}"] = lever[:, k], moving[:, k]
        out[f"phase_{axis}"] = bright[:, k] - np.rint(bright[:, k])
    gap, along = _about_the_other(near.truth, true, near.off)
    bound = np.sqrt(np.trace(cov, axis1=1, axis2=2) / 2)
    return out.assign(gap=gap / ball_px - 1.0, along=along, bound=bound)


def _about_the_other(truth: pd.DataFrame, true: pd.DataFrame, off: Array) -> tuple[Array, Array]:
    """Distance to the other ball and error towards it, px; NaN where there is no other ball."""
    place = truth.set_index(["frame", "particle"])[["x_mean_px", "y_mean_px"]]
    wanted = pd.MultiIndex.from_arrays([true["frame"], 1 - true["particle"]])
    way = place.reindex(wanted).to_numpy(np.float64) - true[["x_mean_px", "y_mean_px"]].to_numpy(np.float64)
    length = np.hypot(*way.T)
    return length, np.asarray((off * way).sum(axis=1) / length, dtype=np.float64)


def fit_pixel_locking(pairs: pd.DataFrame, min_errors: int = 20) -> tuple[Array, float]:
    """Fit the error of moving balls as a function of the phase of the glint within its pixel.

    Returns by axis (2, 4), px, cosine and sine with one and with two periods per pixel. The second result is the
    peak-to-peak amplitude of the first period, px, corrected for noise, of the worse axis. Axes with fewer than
    `min_errors` errors are left out: zero, and NaN where there is no other.
    """
    waves, worst = np.zeros((2, 4)), np.nan
    for k, axis in enumerate("xy"):
        use = pairs[f"moving_{axis}"].to_numpy(bool)
        phase, off = (pairs[f"{name}_{axis}"].to_numpy(np.float64)[use] for name in ("phase", "off"))
        if len(off) < min_errors:
            continue
        by = [wave(n * phase * 2 * np.pi) for n in (1, 2) for wave in (np.cos, np.sin)]
        fit = np.linalg.lstsq(np.column_stack([*by, np.ones_like(phase)]), off, rcond=None)[0]
        waves[k] = fit[:4]
        noise = 4 * off.var() / len(off)
        worst = np.fmax(worst, 2 * np.sqrt(max(fit[0] ** 2 + fit[1] ** 2 - noise, 0.0)))
    return waves, float(worst)


def compute_phase_curve(pairs: pd.DataFrame, bins: int = 16, min_errors: int = 5) -> list[list[float | None]]:
    """Phase, mean error (px) and its standard error by bins of the phase, for both axes of moving balls."""
    phase, off = (
        np.concatenate([pairs[f"{name}_{a}"].to_numpy(float)[pairs[f"moving_{a}"].to_numpy(bool)] for a in "xy"])
        for name in ("phase", "off")
    )
    edges = np.linspace(-0.5, 0.5, bins + 1)
    return [
        [float(middle), float(part.mean()), float(part.std() / np.sqrt(len(part)))]
        for low, high in pairwise(edges)
        if len(part := off[(phase >= low) & (phase < high)]) >= min_errors
        for middle in [(low + high) / 2]
    ]


def compute_gap_curve(pairs: pd.DataFrame, min_positions: int = 5) -> list[dict[str, float]]:
    """Rmse over bound, and mean error towards the other ball (px), by the gap between the balls (diameters)."""
    out = []
    for low, high in pairwise((0.0, 0.06, 0.15, 0.3, 0.6, 1.2, 2.4)):
        part = pairs[(pairs["gap"] >= low) & (pairs["gap"] < high)]
        if len(part) >= min_positions:
            rmse = float(np.sqrt((part[["off_x", "off_y"]].to_numpy() ** 2).mean()))
            bound = float(np.sqrt((part["bound"] ** 2).mean()))
            middle = float(part["gap"].mean())
            out.append({"gap": middle, "n": len(part), "rmse_px": rmse, "ratio": rmse / bound,
                        "towards_px": float(part["along"].mean())})  # fmt: skip
    return out
