"""The entry of a tracker: all its scores on a suite, as a file that can be compared with those of others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from synthcam_shared.json_values import replace_non_finite
from tracker.benchmark.judging.crowds import judge_crowds
from tracker.benchmark.judging.defects import measure_shifts_by_defects, simulate_at_bound
from tracker.benchmark.judging.position_errors import compute_gap_curve, compute_phase_curve, match_positions
from tracker.benchmark.judging.tracker_results import TrackerResults
from tracker.benchmark.suite.definition import Suite, SuitePart
from tracker.results import make_estimates_table
from tracker.scoring.error_bars import score_quantities
from tracker.scoring.score import drop_unclaimed, join_truth


def make_entry(
    suite: Suite, tracked: TrackerResults, about: Mapping[str, Any], max_physics_clips: int = 12
) -> dict[str, Any]:
    """Score a tracker on a suite with its truth; about: name of the tracker, and further facts about it.

    Returns tracker, suite, score, parts {part: figures}, phase {part: curve}, gap (curve), quantities {part: ...},
    defects, and crowds {part: figures} if the suite has crowds. They are plain values, None if not known.
    """
    chosen = suite.definition
    run = {name: part for name, part in suite.parts.items() if name not in chosen.crowds and tracked.sample.of(part)}
    held = {name: match_positions(suite, tracked, part) for name, part in run.items()}
    parts = {name: one.statistics for name, one in held.items()}
    defects: dict[str, Any] = {}
    for name in (name for name in chosen.parts_of("physics") if name in run):
        clips = tracked.sample.of(run[name])[:max_physics_clips]
        defects = measure_shifts_by_defects(
            held[name], {clip: simulate_at_bound(suite, run[name], clip) for clip in clips}
        )
    out: dict[str, Any] = {
        "tracker": dict(about),
        "suite": {key: suite.about[key] for key in ("version", "size", "split", "definition_sha256", "truth_sha256")},
        "score": compute_overall_score(
            parts, [name for name in chosen.headline if suite.has_bounds(suite.parts[name])]
        ),
        "parts": parts,
        "phase": {name: compute_phase_curve(held[name].pairs) for name in chosen.parts_of("phase") if name in run},
        "gap": [
            point for name in chosen.parts_of("near") if name in run for point in compute_gap_curve(held[name].pairs)
        ],
        "quantities": {n: judge_quantities(suite, tracked, run[n]) for n in chosen.parts_of("measured") if n in run},
        "defects": defects,
    }
    if chosen.crowds:
        out["crowds"] = judge_crowds(suite, tracked)
    whole: dict[str, Any] = replace_non_finite(out)
    return whole


def compute_overall_score(parts: Mapping[str, Mapping[str, float]], headline: list[str]) -> float:
    """Compute the overall score of an entry: 100 times the mean efficiency over its parts. NaN without parts."""
    values = [parts[name]["efficiency"] if name in parts else 0.0 for name in headline]
    return 100 * float(np.mean(values)) if values else float("nan")


def judge_quantities(suite: Suite, tracked: TrackerResults, part: SuitePart, min_collisions: int = 3) -> dict[str, Any]:
    """Score each quantity of the tied and of the free fit, for an entry.

    Returns `clips`, `measured` (clips with a collision that was measured), and by quantity the figures of score.json
    and two more. `published` is the mean error over all collisions, each weighted by the error bar that it claims.
    `published_std` is the error bar of that mean. Both are NaN for fewer than `min_collisions` collisions.
    """
    clips = tracked.sample.of(part)
    scalars = suite.scalars(part.truth)
    scalars = scalars[scalars["clip"].isin(clips)].reset_index(drop=True)
    rows = [{"clip": clip, "collision": 0, "status": "no result"} | dict(row)
            for clip in clips for row in tracked.of(part.film, clip)[1]]  # fmt: skip
    empty = pd.DataFrame({"clip": [], "collision": [], "status": []}).astype({"clip": int, "status": str})
    limits = suite.quantity_bounds(part.truth)
    if any((scalars.get(name, pd.Series(0.0)).abs() > 1e-6).any() for name in ("u2ix", "u2iy", "side2i")):
        limits = limits[["clip"]]
    table = drop_unclaimed(join_truth(scalars, make_estimates_table(rows).copy() if rows else empty, limits))
    out: dict[str, Any] = {"clips": len(clips), "measured": int((table["status"] == "ok").sum())}
    scores = score_quantities(table)
    names = ("r", "mu_k", "C", "tau1", "tau2", "energy_fraction")
    for name in (f"{name}{fit}" for name in names for fit in ("", "_free")):
        if name in scores:
            out[name] = dict(scores[name]) | _average_error(table, name, min_collisions)
    return out


def _average_error(table: pd.DataFrame, name: str, min_collisions: int) -> dict[str, float]:
    """Mean of the errors, weighted by the claimed error bars, and its error bar; NaN for few collisions."""
    value, std = (table[column].to_numpy(np.float64) for column in (name, f"{name}_std"))
    true = table[f"{name.removesuffix('_free')}_true"].to_numpy(np.float64)
    use = np.isfinite(value) & np.isfinite(true) & np.isfinite(std) & (std > 0)
    if use.sum() < min_collisions:
        return {"published": np.nan, "published_std": np.nan}
    weight = std[use] ** -2
    return {
        "published": float(((value - true)[use] * weight).sum() / weight.sum()),
        "published_std": float(weight.sum() ** -0.5),
    }
