"""The entry of a tracker: all its scores on a suite, as a file that can be compared with those of others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tracker.benchmark.judging.defects import measure_defects, simulate_at_bound
from tracker.benchmark.judging.positions import gap_curve, match_positions, phase_curve
from tracker.benchmark.judging.quantities import judge_quantities
from tracker.benchmark.judging.tracker_results import TrackerResults
from tracker.benchmark.suite.folder import Suite
from tracker.results import finite


def make_entry(
    suite: Suite, tracked: TrackerResults, about: Mapping[str, Any], max_physics_clips: int = 12
) -> dict[str, Any]:
    """Score a tracker on a suite with its truth; about: name of the tracker, and further facts about it.

    Returns tracker, suite, score, parts {part: figures}, phase {part: curve}, gap (curve), quantities {part: ...} and
    defects as plain values; None for what is not known.
    """
    chosen = suite.definition
    run = {name: part for name, part in suite.parts.items() if tracked.sample.of(part)}
    held = {name: match_positions(suite, tracked, part) for name, part in run.items()}
    parts = {name: one.statistics for name, one in held.items()}
    defects: dict[str, Any] = {}
    for name in (name for name in chosen.parts_of("physics") if name in run):
        clips = tracked.sample.of(run[name])[:max_physics_clips]
        defects = measure_defects(held[name], {clip: simulate_at_bound(suite, run[name], clip) for clip in clips})
    out: dict[str, Any] = {
        "tracker": dict(about),
        "suite": {key: suite.about[key] for key in ("version", "size", "split", "definition_sha256", "truth_sha256")},
        "score": overall_score(parts, [name for name in chosen.headline if suite.has_bounds(suite.parts[name])]),
        "parts": parts,
        "phase": {name: phase_curve(held[name].pairs) for name in chosen.parts_of("phase") if name in run},
        "gap": [point for name in chosen.parts_of("near") if name in run for point in gap_curve(held[name].pairs)],
        "quantities": {n: judge_quantities(suite, tracked, run[n]) for n in chosen.parts_of("measured") if n in run},
        "defects": defects,
    }
    whole: dict[str, Any] = finite(out)
    return whole


def overall_score(parts: Mapping[str, Mapping[str, float]], headline: list[str]) -> float:
    """Compute 100 times the mean efficiency over these parts; a part that was not run counts 0. NaN without parts."""
    values = [parts[name]["efficiency"] if name in parts else 0.0 for name in headline]
    return 100 * float(np.mean(values)) if values else float("nan")
