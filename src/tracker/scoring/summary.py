"""Summary of a score in a few lines, with a verdict on what the tracks are good enough for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from synthcam_shared.report.numbers import format_number, format_with_error
from tracker.report.quantities import QUANTITIES
from tracker.scoring.score import DetectorScore

JUDGED = ("r", "mu_k", "tau1", "tau2")


def summarise_score(score: DetectorScore) -> Iterator[str]:
    """Yield lines for a terminal; the last one says what the tracks are good enough for."""
    where, swaps = score.localisation, score.tracking["swaps"]
    yield f"{score.statuses['n']} clips: " + ", ".join(f"{v} {k}" for k, v in score.statuses.items() if k != "n")
    yield (
        f"positions: {format_number(where['rmse_px'], 2)} px rmse, {format_ratio(where, 2)} times the bound; "
        f"{where['missed']:.0f} missed, {where['false']:.0f} false, {swaps:.0f} identity swaps"
    )
    yield f"{'':<10}{'tied: rmse':>12}{'/ bound':>11}{'z sd':>8}{'free: rmse':>14}{'/ bound':>11}{'z sd':>8}"
    for name in JUDGED:
        quantity = QUANTITIES[name]
        tied, free = (_format_errors(score.quantities[f"{name}{fit}"], quantity.factor) for fit in ("", "_free"))
        yield f"{f'{name} {quantity.unit}':<10}{tied}  {free}"
    yield describe_fitness(score)


def describe_fitness(score: DetectorScore, min_clips: int = 20) -> str:
    """Say in a sentence of the summary what the results are good enough for, and warn if there are few clips."""
    few = f" Fewer than {min_clips} clips: the spread of z is uncertain." if score.statuses["n"] < min_clips else ""
    return _judge(score) + few


def _judge(score: DetectorScore, max_lost: float = 0.01, near_bound: float = 1.5, significance: float = 3.0) -> str:
    """Judge the tracks, then the error bars, then the size of the errors.

    max_lost: share of balls missed, or of false detections, up to which tracks are good. near_bound: rmse over bound up
    to which a fit uses nearly all information in the pictures. significance: standard errors by which a spread of z, or
    a ratio, must be over its limit.
    """
    where, swaps = score.localisation, score.tracking["swaps"]
    lost = max(where["missed"], where["false"]) / max(where["n"] + where["missed"], 1)
    if lost > max_lost or swaps:
        return (
            f"Not good enough to track these balls: {100 * lost:.2g} % missed or false, {swaps:.0f} identity swaps. "
            "Check the tracks before you use the quantities."
        )
    found = {n: q for n in JUDGED if (q := score.quantities[n])["n"] and np.isfinite(q["z_std"])}
    if not found:
        return "Good enough to track these balls. No collision was measured with an error that the truth could test."
    spread = {n: float(np.hypot(q["z_mean"], q["z_std"])) for n, q in found.items()}
    allowed = {n: 1 + significance / np.sqrt(2 * q["n"]) for n, q in found.items()}
    if too_wide := {n: z for n, z in spread.items() if z > allowed[n]}:
        worst = max(too_wide, key=lambda n: too_wide[n])
        return (
            f"Not good enough for error bars: the errors of {worst} are {too_wide[worst]:.2g} times its standard "
            "errors. The values themselves are accurate to the rmse above."
        )
    ratio = {n: q["ratio"] for n, q in found.items() if np.isfinite(q["ratio"])}
    if far := {n: x for n, x in ratio.items() if x > near_bound * allowed[n]}:
        worst = max(far, key=lambda n: far[n])
        return (
            f"Good enough to measure with: the standard errors are correct. But the errors of {worst} are "
            f"{far[worst]:.2g} times as large as the noise of the sensor requires."
        )
    if any(x > near_bound for x in ratio.values()):
        return (
            "Good enough to measure with: the standard errors are correct. "
            "With so few clips it is unknown whether they could be smaller."
        )
    return (
        "Good enough to measure with: the standard errors are correct, "
        "and about as small as the noise of the sensor allows."
    )


def _format_errors(values: Mapping[str, float], factor: float) -> str:
    """Columns of rmse, ratio to the bound, and spread of z."""
    rmse, spread = format_number(values["rmse"] * factor, 2), format_number(values["z_std"], 2)
    return f"{rmse:>12} {format_ratio(values):>10} {spread:>7}"


def format_ratio(scores: Mapping[str, Any], coordinates: int = 1) -> str:
    """Format a ratio for the summary of a score: rmse over bound with its sampling error, for n independent values."""
    ratio, values = scores["ratio"], coordinates * max(scores["n"], 1)
    return format_with_error(ratio, None if ratio is None else ratio / np.sqrt(2 * values))
