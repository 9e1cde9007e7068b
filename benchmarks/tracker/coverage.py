"""Test of the error bars and of the accuracy: 500 collisions, both fits, every quantity.

    python -m benchmarks.tracker.coverage [--clips 500] [--seed 0] [--scene scenes/benchmark.yaml] [-o out/coverage]
    python -m benchmarks.tracker.coverage --from-tracks      no video: true centres with noise at the localisation bound
    python -m benchmarks.tracker.coverage --scene scenes/dim.yaml      a dim scene; saturated.yaml is a clipped one
    python -m benchmarks.tracker.coverage --scene scenes/other_camera.yaml      another camera, lamp and sensor

The film is kept in the output and used again; it is tracked and measured in each run. The exit status is 1 where a
value misses its goal. For each quantity and fit the table gives

- the rmse over the Cramér-Rao bound of that fit on those positions, each clip relative to its own bound;
- the ratio of the two root mean squares, which the few slowest clips dominate, with its sampling error;
- mean and standard deviation of z = error / claimed standard error;
- the share of clips whose 68 and 95 % intervals contain the truth;
- the number of clips that claim a value, and their share of those whose bound is under 0.8 of the largest error that
  the fit may claim.
"""

from __future__ import annotations

import argparse
import json
import math
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console
from rich.table import Table

from benchmarks.harness import ROOT, run, save
from tracker.camera.camera import Camera
from tracker.detection.likelihood.cramer_rao import localisation_bound, localisation_bound_fixed
from tracker.measurement.estimate import largest_error
from tracker.measurement.noise.whitening import position_covariance
from tracker.scoring.localisation import find_true_glints
from tracker.scoring.score import score

JUDGED = "r s tau1 tau2 mu_k C v1f v2f energy_fraction momentum_fraction".split()
OTHERS = "v0 b t_c final_angle drag decel w1n w1t w2n w2t".split()  # shown, and tested for correct error bars alone
RATIO, ERRORS, SPREAD = 1.15, 3.5, 0.07  # of the bound; sampling errors; of the standard deviation of z
SHARE, EXEMPT = 0.6, ("s_free",)  # of the clips, at least, that claim a value
TOLD = 0.95  # at least, of the clips that can tell


def film_and_track(folder: Path, options: argparse.Namespace) -> tuple[Path, pd.DataFrame]:
    """Film a dataset and track it."""
    film, tracked = folder / "film", folder / "tracked"
    size = ("--clips", str(options.clips), "--seed", str(options.seed))
    run("synthcam", "generate", options.scene, "-o", str(film), *size)
    shutil.rmtree(tracked, ignore_errors=True)
    run("tracker", "track", str(film), "-o", str(tracked))
    paths = sorted(tracked.glob("clips/*/tracks.parquet"))
    return film, pd.concat(pd.read_parquet(p).assign(clip=int(p.parent.name)) for p in paths)


def simulate_tracks(folder: Path, options: argparse.Namespace) -> tuple[Path, pd.DataFrame]:
    """Dataset without pictures, and true centres with the errors that the best detector would make."""
    data = folder / "motion"
    size = ("--clips", str(options.clips), "--seed", str(options.seed), "--no-video")
    run("synthcam", "generate", options.scene, "-o", str(data), *size)
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(options.seed, spawn_key=(2,))))
    parts = [add_noise(p, rng).assign(clip=int(p.name)) for p in sorted((data / "clips").iterdir())]
    return data, pd.concat(parts)


def add_noise(clip: Path, rng: np.random.Generator) -> pd.DataFrame:
    """Tracks of one clip with noise of the bound; equal positions share the part that is due to the fixed pattern."""
    camera = Camera.read(clip / "camera.json")
    sigma = camera.sigma or 1.0
    peak = json.loads((clip / "truth" / "scene.json").read_text())["drawn"]["sensor"]["glint_peak"]
    whole = pd.read_parquet(clip / "truth" / "tracks.parquet").query("visible").sort_values(["particle", "frame"])
    parts = []
    for _, true in whole.groupby("particle"):
        (glint, blur), flux = find_true_glints(true, camera), np.full(len(true), peak * 2 * math.pi * sigma**2)
        cov, fixed = localisation_bound(camera, flux, glint, blur), localisation_bound_fixed(camera, flux, glint)
        root = np.linalg.cholesky(position_covariance(glint, cov, fixed, sigma))
        xy = true[["x_mean_px", "y_mean_px"]].to_numpy() + (root @ rng.standard_normal(len(root))).reshape(-1, 2)
        table = {"frame": true["frame"], "particle": true["particle"], "x": xy[:, 0], "y": xy[:, 1], "flux": flux}
        for end, part in (("", cov), ("_fixed", fixed)):
            table |= {f"x{end}_std": np.sqrt(part[:, 0, 0]), f"y{end}_std": np.sqrt(part[:, 1, 1])}
            table |= {f"cov_xy{end}": part[:, 0, 1]}
        parts.append(pd.DataFrame(table))
    return pd.concat(parts)


def verdict(name: str, row: dict[str, float], clips: int, claims: float) -> list[str]:
    """What a quantity misses."""
    n = max(row["n"], 1)
    missed = []
    if abs(row["z_mean"]) > ERRORS / math.sqrt(n):
        missed.append("z mean")
    if abs(row["z_std"] - 1) > max(SPREAD, ERRORS / math.sqrt(2 * n)):
        missed.append("z sd")
    for key, share in (("cover68", 0.6827), ("cover95", 0.95)):
        if abs(row[key] - share) > ERRORS * math.sqrt(share * (1 - share) / n):
            missed.append(key)
    if name.removesuffix("_free") in JUDGED:
        if not row["by_clip"] < RATIO:
            missed.append("ratio")
        if row["n"] < SHARE * clips and name not in EXEMPT:
            missed.append("n")
        if claims < TOLD:
            missed.append("told")
    return missed


def share_of_claims(table: pd.DataFrame, name: str, kind: str) -> float:
    """The share of clips with a claim, among those whose bound is well under the limit of a claim."""
    limit = largest_error(name, table[f"{name}_true"].to_numpy(float), bool(kind))
    able = table[f"{name}{kind}_bound"] < 0.8 * limit
    if name == "s":  # a ratio by b: the hit must be oblique enough
        able &= table["b_true"].abs() > 12 * table[f"b{kind}_bound"]
    if kind:  # without both slide ends in view there is nothing to be free about
        end = table["t_c_true"] + table[["tau1_true", "tau2_true"]].max(axis=1)
        able &= end < 0.5 * (end + table["last_s"]) - 0.02
    return float(np.isfinite(table.loc[able, f"{name}{kind}"]).mean()) if able.any() else math.nan


def over_bound(table: pd.DataFrame, name: str, kind: str) -> dict[str, float]:
    """RMSE over bound clip by clip, and the sampling error of the ratio of root mean squares."""
    off = table[f"{name}{kind}"] - table[f"{name}_true"]
    bound = table[f"{name}{kind}_bound"].where(off.notna())
    error = 0.5 * math.sqrt(2 * (bound**4).sum()) / (bound**2).sum()
    return {"by_clip": math.sqrt(((off / bound) ** 2).mean()), "ratio_error": error}


def judge(table: pd.DataFrame, quantities: dict[str, dict[str, float]]) -> dict[str, dict[str, Any]]:
    """Every quantity of both fits: its figures, and what it misses."""
    out = {}
    for name in (*JUDGED, *OTHERS):
        for kind in ("", "_free"):
            row = quantities[f"{name}{kind}"]
            if not np.isfinite(row["z_std"]):
                continue  # w1n of the tied fit: zero by the model
            claims = share_of_claims(table, name, kind)
            row = row | over_bound(table, name, kind)
            out[f"{name}{kind}"] = row | {"told": claims, "missed": verdict(f"{name}{kind}", row, len(table), claims)}
    return out


def make_table(rows: dict[str, dict[str, Any]]) -> Table:
    heads = "quantity,n,told,bias,rmse,bound,ratio,by clip,z mean,z sd,68 %,95 %,misses"
    table = Table(*heads.split(","))
    for name, row in rows.items():
        ratio = f"{row['ratio']:.2f} ± {row['ratio_error']:.2f}"
        cells = [f"{row[k]:.3g}" for k in ("told", "bias", "rmse", "bound")]
        cells += [ratio, *(f"{row[k]:.3g}" for k in ("by_clip", "z_mean", "z_std", "cover68", "cover95"))]
        table.add_row(name, str(row["n"]), *cells, ", ".join(row["missed"]))
    return table


def last_seen(tracks: pd.DataFrame, table: pd.DataFrame, fps: float) -> pd.Series:
    """Time, s, until which both balls of each clip are seen."""
    last = tracks.groupby(["clip", "particle"])["frame"].max().groupby("clip").min()
    return table["clip"].map(last) / fps


def main() -> None:
    parser = argparse.ArgumentParser(description="Coverage of the tracker's error bars, and its RMSE over the bound.")
    parser.add_argument("--clips", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--scene", default="scenes/benchmark.yaml")
    parser.add_argument("--from-tracks", action="store_true", help="no video: noise at the localisation bound")
    parser.add_argument("-o", "--output", type=Path, help="default: out/coverage, and _SCENE for others")
    options = parser.parse_args()
    kin = Path(options.scene).stem.replace("benchmark", "")
    options.output = options.output or ROOT / "out" / "_".join(filter(None, ["coverage", kin]))
    options.output.mkdir(parents=True, exist_ok=True)
    way = simulate_tracks if options.from_tracks else film_and_track
    data, tracks = way(options.output, options)
    mode = "drawn" if options.from_tracks else "filmed"
    path, measured = options.output / f"tracks_{mode}.parquet", options.output / f"measured_{mode}"
    tracks.to_parquet(path)
    shutil.rmtree(measured, ignore_errors=True)
    camera = data / "clips/000000/camera.json"
    run("tracker", "measure", str(path), "--camera", str(camera), "-o", str(measured))

    found = score(measured, data, mode)
    fps = json.loads(camera.read_text())["fps"]
    table = found.table.assign(last_s=last_seen(tracks, found.table, fps))
    table.to_parquet(options.output / f"table_{mode}.parquet")
    rows = judge(table, found.quantities)
    Console(width=150).print(make_table(rows))
    position = found.localisation
    print(f"{len(table)} clips, status {found.statuses}; rmse of a place over its bound {position['ratio']:.3f}")
    missed = [name for name, row in rows.items() if row["missed"]]
    report = {"clips": len(table), "mode": mode, "localisation": position, "quantities": rows}
    save(options.output / f"coverage_{mode}.json", report)
    print(f"{len(rows) - len(missed)} of {len(rows)} within their limits" + f"; not {missed}" * bool(missed))
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    main()
