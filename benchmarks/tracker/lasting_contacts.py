"""Contacts that take time: do error bars hold for any law of the contact, and is tape recognised?

python -m benchmarks.tracker.lasting_contacts [--clips 400] [--seed 1] [--longest-ms 30] [-o out/lasting_contacts.json]

The tracks are integrated. Contacts last 0 to 30 ms, at 250, 500 and 1,000 frames a second, with r .2 to .95 and noise
of .03 to .3 px (1 px = .4 mm). Discs have no friction, balls slide and roll; hits are head-on and oblique. The contacts
follow five laws: a linear spring with a dashpot, in two forms; Hertz springs with two kinds of dashpot; bodies that
keep a dent. A fifth of the clips are of bodies that stay together. Balls whose restitution is under .4 touch again.

z = error / standard error of each value that has an error. The tables give their number, mean, rms with its sampling
error, and the share within 1 and 2 errors (.68 and .95 for normal errors).
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pandas as pd

import tracker
from benchmarks.harness import ROOT
from synthcam_shared.job_result import JobValue
from synthcam_shared.jobs import run_jobs

sys.path.insert(0, str(ROOT / "tests" / "helpers"))
contacts: Any = importlib.import_module("tracker_contacts")
STATUSES = ("ok", "misfit", "stay_together")


def measure_clip(clip: int, seed: int, longest: float) -> dict[str, Any]:
    """Measure one clip: its truth, status and scores; longest contact in s."""
    rng = np.random.default_rng([seed, clip])
    hit = contacts.draw_hit(rng)
    hit = replace(hit, duration=hit.duration * longest / 0.03)
    if clip % 5 == 4:
        hit = replace(hit, sticky=True, duration=float(rng.uniform(0.005, 0.015)), friction=0.0, r=0.0)
    begin = time.perf_counter()
    table = tracker.measure(hit.tracks(rng), hit.camera, unit="m").estimates
    row = table.iloc[0]
    truths = {"r": hit.r, "contact_duration_s": hit.time_within, "v0": hit.v0, "mu_k": hit.friction or np.nan}
    truths |= {"b": -hit.b, "r_free": hit.r, "r_paper": hit.r, "v0_paper": hit.v0}
    scores = {f"z_{name}": (row[name] - true) / row[f"{name}_std"] for name, true in truths.items()}
    kind = "tape" if hit.sticky else "instant" if hit.duration == 0 else "balls" if hit.friction else "discs"
    found = {"clip": clip, "kind": kind, "law": hit.law, "status": row["status"], "flags": row["flags"]}
    given = {name: getattr(hit, name) for name in ("duration", "r", "v0", "b", "friction", "fps", "noise")}
    took = time.perf_counter() - begin
    return found | {"collisions": len(table), "r_std": row["r_std"], "s": took} | scores | given


def summarise(table: pd.DataFrame, by: Sequence[str]) -> pd.DataFrame:
    """A row for each group and quantity with scores."""
    rows = []
    for key, part in table.groupby(list(by)):
        for column in table.columns[table.columns.str.startswith("z_")]:
            z = part[column].to_numpy(float)
            z = z[np.isfinite(z)]
            if len(z) == 0:
                continue
            rms = float(np.sqrt((z**2).mean()))
            row: dict[str, Any] = dict(zip(by, key, strict=True)) | {"quantity": column[2:], "n": len(z)}
            row |= {"mean": z.mean(), "rms": rms, "+-": 1 / np.sqrt(2 * len(z)), "max": np.abs(z).max()}
            rows.append(row | {"in 1": np.mean(np.abs(z) < 1), "in 2": np.mean(np.abs(z) < 2)})
    return pd.DataFrame(rows)


def count_statuses(table: pd.DataFrame) -> pd.DataFrame:
    """Clips by kind and status; every other status is a reason why nothing is measured."""
    status = table["status"].where(table["status"].isin(STATUSES), "no value")
    return pd.crosstab(table["kind"], status)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--longest-ms", type=float, default=30.0)
    parser.add_argument("--workers", type=int, default=0)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/lasting_contacts.json"))
    args = parser.parse_args()
    job = partial(measure_clip, seed=args.seed, longest=args.longest_ms / 1e3)
    found = [done.value for done in run_jobs(job, range(args.clips), args.workers) if isinstance(done, JobValue)]
    table = pd.DataFrame(found).sort_values("clip")
    print(count_statuses(table).to_string(), end="\n\n")
    every = table.assign(kind="all")
    for part, by in ((every, ["kind"]), (table, ["kind"]), (table[table["kind"].isin(["balls", "discs"])], ["law"])):
        print(summarise(part, by).to_string(index=False, float_format="{:.2f}".format), end="\n\n")
    wild = table[table[["z_r", "z_r_free", "z_contact_duration_s"]].abs().max(axis=1) > 4]
    print(f"|z| over 4: {len(wild)}")
    print(wild.drop(columns=["s", "collisions"]).to_string(index=False, float_format="{:.3g}".format))
    args.output.parent.mkdir(parents=True, exist_ok=True)
    args.output.write_text(table.to_json(orient="records", indent=1))


if __name__ == "__main__":
    main()
