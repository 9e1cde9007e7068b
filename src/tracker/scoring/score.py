"""Scoring of results against the truth: each clip with its truth and bounds, the keys of score.json, and a summary."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from synthcam_shared.errors import InputError
from synthcam_shared.jobs import run_all_jobs, yield_in_order
from synthcam_shared.json_values import replace_non_finite
from synthcam_shared.report.numbers import format_number, format_with_error
from tracker.camera.camera import Camera
from tracker.measurement.collision.adequacy import MEASURED, MISFIT
from tracker.measurement.collision.derived import QUANTITY_NAMES
from tracker.report.quantities import QUANTITIES
from tracker.results import write_json
from tracker.scoring.error_bars import compute_true_parameters, quantity_bounds, score_quantities
from tracker.scoring.localisation import MatchedDetections, PositionSums, find_required_rows, match, position_bounds
from tracker.scoring.tracking_metrics import GATE_PX, TrackingCounts, TrackPoints

JUDGED = ("r", "mu_k", "tau1", "tau2")  # quantities of the summary
NO_TRACKS = pd.DataFrame({"frame": [], "particle": [], "x": [], "y": []}).astype({"frame": int, "particle": int})
ClipSums = tuple[PositionSums, TrackingCounts, dict[str, float]]  # of one clip; the last: bounds of its quantities


@dataclass(frozen=True)
class DetectorScore:
    """Scores of one set of results.

    table: a row per clip with each quantity Q, its truth Q_true and bound Q_bound. note: a likely mistake, or ''.
    """

    suite: str
    detector: str
    localisation: dict[str, float]
    tracking: dict[str, float]
    quantities: dict[str, dict[str, float]]
    statuses: dict[str, int]
    ms_per_frame: float | None
    table: pd.DataFrame = field(repr=False)
    note: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return the contents of score.json: plain numbers, None for unknown values."""
        parts = {name: getattr(self, name) for name in ("localisation", "tracking", "quantities")}
        parts |= {"clips": self.statuses, "ms_per_frame": self.ms_per_frame}
        whole: dict[str, Any] = replace_non_finite({"suite": self.suite, "detectors": {self.detector: parts}})
        return whole

    def write(self, report: Path | str) -> Path:
        """Write REPORT/score.json and return its path."""
        folder = Path(report)
        folder.mkdir(parents=True, exist_ok=True)
        write_json(folder / "score.json", self.to_dict())
        return folder / "score.json"


def score(
    results: Path | str,
    dataset: Path | str,
    detector: str = "default",
    ms_per_frame: float | None = None,
    scheduler: str = "",
) -> DetectorScore:
    """Score RESULTS of `tracker track` against the truth of a dataset.

    Clips of the truth without results count as missed. `detector` and `ms_per_frame`, the processing time per frame, go
    into score.json. `scheduler` is the address of a Dask scheduler, whose workers see the same folders and score the
    clips. Raises InputError where a file or a column is missing.
    """
    results, dataset = Path(results), Path(dataset)
    if scheduler:  # the workers may stand elsewhere
        results, dataset = results.resolve(), dataset.resolve()
    scalars = _scalars(dataset)
    estimates = _table(results / "estimates.parquet", "results of tracker track", "clip collision status")
    task = partial(_score_clip, results, dataset)
    numbers = [int(clip) for clip in scalars["clip"]]
    positions, tracking, limits = PositionSums.none(), TrackingCounts.none(), []
    for errors, counts, bounds in yield_in_order(run_all_jobs(task, numbers, 1, results, scheduler), numbers):
        positions, tracking = positions + errors, tracking + counts
        limits.append(bounds)
    table = join_truth(scalars, estimates, pd.DataFrame(limits).assign(clip=numbers))
    glints_not_centres = (
        "the positions are those of the glints, not of the balls' centres;"
        " measure and score such a table with --point glint"
    )
    return DetectorScore(
        suite="+".join(sorted(scalars["scene"].astype(str).unique())) if "scene" in scalars else "",
        detector=detector,
        localisation=positions.statistics(),
        tracking=tracking.scores(),
        quantities=score_quantities(drop_unclaimed(table)),
        statuses={"n": len(scalars)} | {str(k): int(v) for k, v in table["status"].value_counts().items()},
        ms_per_frame=ms_per_frame,
        table=table,
        note=glints_not_centres if positions.are_glints else "",
    )


def check_same_dataset(verdict: DetectorScore, results: Path, dataset: Path) -> None:
    """Check that results and truth are of one dataset: raise InputError if positions are near true ones by chance only.

    By chance, one position in a hundred is near a ball, or some more where all films have their balls in the middle.
    Such pairs are as far apart as the gate lets them be: by half of it along each axis.
    """
    paired, false = (int(verdict.localisation[name]) for name in ("n", "false"))
    is_random = paired < 0.25 * false and verdict.localisation["rmse_px"] > 0.3 * GATE_PX
    if paired < 0.02 * false or is_random:
        raise InputError(
            f"{results}: {paired} of {paired + false} positions are within {GATE_PX:g} px of a true one of {dataset};"
            " expected the dataset that was tracked"
        )


def _scalars(dataset: Path) -> pd.DataFrame:
    """True quantities of all clips; each process reads them once."""
    path = dataset / "truth" / "clips.parquet"
    return _read_scalars(path, path.stat().st_mtime_ns if path.is_file() else 0)


@lru_cache(maxsize=1)
def _read_scalars(path: Path, changed: int) -> pd.DataFrame:
    return _table(path, "the truth of a dataset", "clip v0 b t_c r mu_k C drag decel")


def _table(path: Path, what: str, columns: str) -> pd.DataFrame:
    """Read a table. Raises InputError where one of `columns` is missing."""
    if not path.is_file():
        raise InputError(f"{path}: no such file, expected {what}")
    try:
        table = pd.read_parquet(path)
    except Exception as error:  # readers raise their own kinds
        reason = " ".join(str(error).split())[:120]
        raise InputError(f"{path}: damaged, expected {what} ({reason})") from None
    if missing := [name for name in columns.split() if name not in table]:
        raise InputError(f"{path}: no column {', '.join(missing)}, expected {what}")
    return table


def _score_clip(results: Path, dataset: Path, clip: int) -> tuple[int, ClipSums]:
    truth, found, camera = _read_clip(results, dataset, clip)
    matched = match(truth, found, GATE_PX, camera.diameter_px)
    cov = position_bounds(matched, camera)
    scalars = _scalars(dataset)
    tied = compute_true_parameters(truth, scalars[scalars["clip"] == clip].iloc[0])
    counts = TrackingCounts.of(*to_track_points(matched))
    return clip, (PositionSums.of(matched, cov), counts, quantity_bounds(matched, cov, tied, camera))


def _read_clip(results: Path, dataset: Path, clip: int) -> tuple[pd.DataFrame, pd.DataFrame, Camera]:
    """True tracks, tracks, camera."""
    name = f"{clip:06d}"
    columns = "frame t_s particle visible x y z vx vy vz glint_x_px glint_y_px x_mean_px y_mean_px"
    truth = _table(dataset / "clips" / name / "truth" / "tracks.parquet", "true tracks", columns)
    path = results / "clips" / name / "tracks.parquet"
    found = _table(path, "tracks", "frame particle x y") if path.is_file() else NO_TRACKS
    cameras = (dataset / "clips" / name, results / "clips" / name, results)
    known = next((c / "camera.json" for c in cameras if (c / "camera.json").is_file()), None)
    if known is None:
        raise InputError(f"{results / 'camera.json'}: no such file, expected the camera of clip {clip}")
    return truth, found, Camera.read(known)


def to_track_points(matched: MatchedDetections) -> tuple[TrackPoints, TrackPoints]:
    """Make the tracks that are scored, of balls that have to be found and of the detections that count."""
    truth = matched.truth[find_required_rows(matched.truth)]
    found = matched.found[matched.counted]
    tables = ((truth, ["x_mean_px", "y_mean_px"]), (found, ["x", "y"]))
    one, other = (
        TrackPoints.of(t["frame"].to_numpy(np.int64), t["particle"].to_numpy(np.int64), t[xy].to_numpy(np.float64))
        for t, xy in tables
    )
    return one, other


def join_truth(scalars: pd.DataFrame, estimates: pd.DataFrame, limits: pd.DataFrame) -> pd.DataFrame:
    """Join one row per clip: its first measured collision, the truth and the bounds."""
    bad = ~estimates["status"].isin(MEASURED)
    order = estimates.assign(_bad=bad).sort_values(["clip", "_bad", "collision"], kind="stable")
    first = order.drop_duplicates("clip").drop(columns="_bad")
    names = [n for n in QUANTITY_NAMES if n in scalars]
    truth = scalars[["clip", *names]].rename(columns={n: f"{n}_true" for n in names})
    table = truth.merge(first, on="clip", how="left").merge(limits, on="clip", how="left")
    return table.assign(status=table["status"].fillna("no result"))


def drop_unclaimed(table: pd.DataFrame) -> pd.DataFrame:
    """Set to NaN what a row does not claim: without a collision all but the rolling loss, and a misfit's tied fit."""
    held = table.copy()
    other = [f"{n}{kind}" for n in QUANTITY_NAMES if n not in ("drag", "decel") for kind in ("", "_free", "_paper")]
    held.loc[~held["status"].isin(MEASURED), [c for c in other if c in held]] = np.nan
    held.loc[held["status"] == MISFIT, [n for n in QUANTITY_NAMES if n in held]] = np.nan
    return held


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

    max_lost: share of balls missed, or of false detections, up to which tracks are good.
    near_bound: rmse over bound up to which a fit uses nearly all information in the pictures.
    significance: standard errors by which a spread of z, or a ratio, must be over its limit.
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
            f"Good enough to measure with: the standard errors agree with the truth. But the errors of {worst} are "
            f"{far[worst]:.2g} times as large as the noise of the sensor requires."
        )
    if any(x > near_bound for x in ratio.values()):
        return (
            "Good enough to measure with: the standard errors agree with the truth. "
            "With so few clips it is unknown whether they could be smaller."
        )
    return (
        "Good enough to measure with: the standard errors agree with the truth, "
        "and are about as small as the noise of the sensor allows."
    )


def _format_errors(values: Mapping[str, float], factor: float) -> str:
    """Columns of rmse, ratio to the bound, and spread of z."""
    rmse, spread = format_number(values["rmse"] * factor, 2), format_number(values["z_std"], 2)
    return f"{rmse:>12} {format_ratio(values):>10} {spread:>7}"


def format_ratio(scores: Mapping[str, Any], coordinates: int = 1) -> str:
    """Format a ratio for the summary of a score: rmse over bound with its sampling error, for n independent values."""
    ratio, values = scores["ratio"], coordinates * max(scores["n"], 1)
    return format_with_error(ratio, None if ratio is None else ratio / np.sqrt(2 * values))
