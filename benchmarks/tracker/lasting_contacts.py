"""Contacts that take time: whether the error bars of restitution and duration hold, and whether tape is recognised.

python -m benchmarks.tracker.lasting_contacts [--clips 100] [--seed 1] [-o out/lasting_contacts.json]

The tracks are those of springs with dashpots that scipy integrates: 0 to 30 ms, 250 to 1,000 frames a second, r .2 to
.95, noise of .05 to .5 px (1 px = .4 mm), discs without friction and balls that slide and roll, head-on and oblique. A
fifth of the clips are of bodies that stay together.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pandas as pd

import tracker
from benchmarks.harness import ROOT

sys.path.insert(0, str(ROOT / "tests" / "helpers"))
contacts: Any = importlib.import_module("tracker_contacts")


def measure_clip(seed: int, clip: int) -> dict[str, Any]:
    """Measure one clip: its truth, status and scores."""
    rng = np.random.default_rng([seed, clip])
    hit = contacts.draw_hit(rng)
    if clip % 5 == 4:
        hit = replace(hit, sticky=True, duration=float(rng.uniform(0.005, 0.015)), friction=0.0, r=0.0)
    begin = time.perf_counter()
    row = tracker.measure(hit.tracks(rng), hit.camera, unit="m").estimates.iloc[0]
    truths = {"r": hit.r, "r_free": hit.r, "r_paper": hit.r, "contact_duration_s": hit.duration}
    scores = {f"z_{name}": (row[name] - true) / row[f"{name}_std"] for name, true in truths.items()}
    kind = "tape" if hit.sticky else "instant" if hit.duration == 0 else "balls" if hit.friction else "discs"
    took = time.perf_counter() - begin
    return {"clip": clip, "kind": kind, "status": row["status"], "r_std": row["r_std"], "s": took} | scores


def summarise(table: pd.DataFrame) -> pd.DataFrame:
    """A row for each kind: counts by status, and number, rms and largest of the scores."""
    rows = []
    for kind, part in table.groupby("kind"):
        counts = {status: int((part["status"] == status).sum()) for status in ("ok", "misfit", "stay_together")}
        row = {"kind": kind, "clips": len(part)} | counts | {"no value": len(part) - sum(counts.values())}
        for name in ("r", "r_free", "r_paper", "contact_duration_s"):
            z = part[f"z_{name}"].to_numpy(float)
            z = z[np.isfinite(z)]
            row |= {f"{name} n": len(z)}
            row |= {f"{name} rms z": float(np.sqrt((z**2).mean())) if len(z) else np.nan}
            row |= {f"{name} max z": float(np.abs(z).max(initial=0.0))}
        rows.append(row | {"median s": float(part["s"].median())})
    return pd.DataFrame(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/lasting_contacts.json"))
    args = parser.parse_args()
    table = pd.DataFrame([measure_clip(args.seed, clip) for clip in range(args.clips)])
    summary = summarise(table)
    print(summary.T.to_string(header=False, float_format="{:.2f}".format))
    wild = table[(table["status"] == "ok") & (table["z_r"].abs() > 4)]
    print(f"ok with |z| of r over 4: {len(wild)} {wild[['clip', 'kind', 'z_r']].to_dict('records')}")
    args.output.parent.mkdir(parents=True, exist_ok=True)
    args.output.write_text(json.dumps({"summary": summary.to_dict("records"), "clips": table.to_dict("records")}))


if __name__ == "__main__":
    main()
