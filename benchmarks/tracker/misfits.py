"""Collisions whose laws the tied fit does not contain. Do the error bars hold, whatever the status?

python -m benchmarks.tracker.misfits [--clips 30] [--seed 1] [--seeds 1] [-o FILE]    # or make bench-misfits

Each law is hidden in so many collisions at random speeds and offsets, of each seed. The tracks are true centres with
noise of .015 px. Rows with the status misfit count by their free fit, rows with the status ok by their tied fit. The
tables have a row for each quantity:

- the number of values with an error;
- mean and rms of z = error / standard error, each |z| at most 5, and the sampling error of the rms;
- the share within 1 and 1.96 errors.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import synthcam
from benchmarks.harness import ROOT, save
from benchmarks.regression.error_bars import SHAKEN, follow_centres
from synthcam_shared.job_result import JobValue
from synthcam_shared.jobs import run_jobs
from tracker.camera.camera import Camera
from tracker.measurement.estimate import measure

LAWS: dict[str, dict[str, dict[str, float]]] = {
    "a slope of 1 mrad": {"plate_tilt": {"x": 1e-3}},
    "friction of the two balls differs by 20 %": {"friction_mismatch": {"excess": 0.2}},
    "friction that grows with the slip speed": {"viscous_friction": {"k": 0.5}},
    "rolling losses of the two balls differ": {"rolling_mismatch": {"drag": 0.05}},
    "a ball heavier by 10 %": {"mass_mismatch": {"excess": 0.1}},
    "none": {},
}
# without friction and spin transfer, which have no one true value under some of these laws
QUANTITIES = "v0 b t_c r s tau1 tau2 v1f v2f energy_fraction momentum_fraction final_angle".split()
MAX_Z = 5.0


def measure_clip(number: int, clips: int, seed: int) -> list[dict[str, Any]]:
    """A row of z for each collision of one clip."""
    law = list(LAWS)[number // clips]
    clip = synthcam.Scene.build("misfit", **SHAKEN, effects=LAWS[law]).draw(number, seed)
    rows = measure(follow_centres(clip, np.random.default_rng([seed, number])), Camera.of(clip.camera_json))
    names = [name for name in QUANTITIES if name in clip.truth]
    return [
        {"law": law, "clip": number, "seed": seed, "status": row["status"], "chi2": row["chi2"] / max(row["dof"], 1)}
        | {"chi2_free": row["chi2_free"] / max(row["dof_free"], 1), "adequate_free": bool(row["adequate_free"])}
        | {name: (row[f"{name}_free"] - clip.truth[name]) / row[f"{name}_free_std"] for name in names}
        | {f"{name}_tied": (row[name] - clip.truth[name]) / row[f"{name}_std"] for name in (*names, "mu_k")}
        for row in rows
    ]


def summarise(table: pd.DataFrame, suffix: str = "") -> pd.DataFrame:
    """A row for each quantity; suffix: "_tied" for the tied fit."""
    rows = []
    for name in (*QUANTITIES, "mu_k"):
        if f"{name}{suffix}" not in table:
            continue
        z = np.clip(table[f"{name}{suffix}"].to_numpy(float), -MAX_Z, MAX_Z)
        z = z[np.isfinite(z)]
        if len(z):
            row = {"quantity": name, "n": len(z), "mean": z.mean(), "rms": float(np.sqrt((z**2).mean()))}
            size = np.abs(z)
            row |= {"+-": 1 / np.sqrt(2 * len(z)), "in 1": np.mean(size < 1), "in 1.96": np.mean(size < 1.96)}
            rows.append(row)
    return pd.DataFrame(rows)


def main() -> None:
    """Measure all collisions, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=int, default=30, help="collisions of each law")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seeds", type=int, default=1, help="so many seeds from that one on")
    parser.add_argument("--workers", type=int, default=0)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "misfits.json")
    asked = parser.parse_args()
    found: list[dict[str, Any]] = []
    for seed in range(asked.seed, asked.seed + asked.seeds):
        work = partial(measure_clip, clips=asked.clips, seed=seed)
        answers = run_jobs(work, range(asked.clips * len(LAWS)), asked.workers)
        found += [row for answer in answers if isinstance(answer, JobValue) for row in answer.value]
    table = pd.DataFrame(found).sort_values(["seed", "clip"], ignore_index=True)
    print(table.groupby(["law", "status"]).size().unstack(fill_value=0).to_string())
    for status, suffix, fit in (("misfit", "", "free"), ("ok", "_tied", "tied")):
        rows = table[table["status"] == status]
        for law, part in [*rows.groupby("law"), ("all laws", rows)]:
            print(f"\n{law}: {len(part)} rows {status}, {fit} fit")
            print(summarise(part, suffix).to_string(index=False, float_format="%.2f"))
    save(asked.output, table.to_dict("records"))


if __name__ == "__main__":
    main()
