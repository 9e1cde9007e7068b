"""Matte balls in lossy video: do the error bars from residuals hold, for several codecs?

python -m benchmarks.tracker.lossy_discs [--films 6] [--seed 1]

Each film shows two balls of 19 px that roll, collide (r .7 to .95, mu_k .1 to .3) and slide. They are drawn by
supersampling, with a noise of 2 counts. It is encoded and tracked. A row for each codec gives the films by status. For
v0, r and mu_k it gives the rms of z = error / standard error with its sampling error, and the share within 1 and 2
errors.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pandas as pd

import tracker
from benchmarks.harness import ROOT
from benchmarks.tracker.codecs import CODECS, encode

sys.path.insert(0, str(ROOT / "tests" / "helpers"))
contacts: Any = importlib.import_module("tracker_contacts")
drawing: Any = importlib.import_module("tracker_discs")

NAMES = ("raw", "h264_18", "h264_23", "h264_28", "hevc_28", "mp4v_5", "mjpeg_3", "mjpeg_10")
SCALE, FPS, SIZE, DIAMETER = 1e-3, 120.0, (176, 320), 0.0186  # m/px; 1/s; px; m


def draw_film(rng: np.random.Generator) -> tuple[Any, Any]:
    """A hit, and its frames."""
    hit = contacts.SoftHit(
        0.0,
        r=rng.uniform(0.7, 0.95),
        v0=rng.uniform(0.2, 0.35),
        b=rng.uniform(-0.4, 0.4),
        friction=rng.uniform(0.1, 0.3),
        fps=FPS,
        diameter=DIAMETER,
    )
    t = (np.arange(-24, 44) + rng.uniform()) / FPS
    ways = hit.positions(t) / SCALE + np.array([130.3, 88.6]) + rng.uniform(-0.5, 0.5, 2)
    ground = drawing.plate(rng, 70.0, 40.0, SIZE)
    return hit, drawing.film(rng, ways, 210.0, 2.0, ground, DIAMETER / SCALE / 2)


def measure_film(seed: int, number: int, codec: str, folder: Path) -> dict[str, Any]:
    """Status and scores of an encoded film."""
    hit, frames = draw_film(np.random.default_rng([seed, number]))
    path = folder / f"{codec}-{number}.{CODECS[codec][0]}"
    encode(frames, path, codec, FPS)
    camera = {"fps": FPS, "scale": SCALE, "size": [SIZE[1], SIZE[0]], "ball_diameter": DIAMETER}
    row = tracker.track(path, camera).estimates.iloc[0]
    truths = {"v0": hit.v0, "r": hit.r, "mu_k": hit.friction}
    scores = {name: (row[name] - true) / row[f"{name}_std"] for name, true in truths.items()}
    return {"codec": codec, "status": row["status"], "noise_ratio": row["noise_ratio"], "r_std": row["r_std"]} | scores


def summarise(table: pd.DataFrame) -> pd.DataFrame:
    """A row for each codec, and one for all."""
    rows = []
    for codec, part in [*table.groupby("codec", sort=False), ("all", table)]:
        row: dict[str, Any] = {"codec": codec, "films": len(part), "ok": int((part["status"] == "ok").sum())}
        row |= {"misfit": int((part["status"] == "misfit").sum()), "r_std": part["r_std"].median()}
        for name in ("v0", "r", "mu_k"):
            z = part[name].to_numpy(float)
            z = z[np.isfinite(z)]
            row[f"z {name}"] = f"{np.sqrt((z**2).mean()):.2f}({100 / np.sqrt(2 * len(z)):.0f})" if len(z) else "-"
            row[f"{name} in 1, 2"] = f"{np.mean(np.abs(z) < 1):.2f} {np.mean(np.abs(z) < 2):.2f}" if len(z) else "-"
        rows.append(row)
    return pd.DataFrame(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--films", type=int, default=6)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        found = [measure_film(args.seed, k, codec, Path(folder)) for codec in NAMES for k in range(args.films)]
    print(summarise(pd.DataFrame(found)).to_string(index=False, float_format="{:.3g}".format))


if __name__ == "__main__":
    main()
