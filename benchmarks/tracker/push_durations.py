"""Durations of contacts of bodies on air: do their errors hold for any law of the force, and is an instant one?

python -m benchmarks.tracker.push_durations [--hits 120] [--seed 1] [--kind KIND] [--support SUPPORT]

Kinds of hits:

- pushes: tracks of discs are integrated. Contacts last 8 to 30 ms, at 250 and 500 frames a second, with r .4 to .95,
  noise of .02 to .08 mm, and friction between the rims. They follow the five laws of `lasting_contacts`. Air slows each
  disc at a rate of its own before the contact and after it.
- instants: the same, but with impacts that take no time.
- balls, discs, pucks, dry pucks: impacts of `local_estimates`.

Printed are the contacts with a duration, z = error / standard error of these, and those by law. --support is that of
the camera file: "none" leaves it out.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from functools import partial
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.harness import ROOT
from benchmarks.real.hits import measure_hit
from benchmarks.real.recordings import RecordedHit
from benchmarks.tracker.local_estimates import KINDS, draw_one
from synthcam_shared.job_result import JobValue
from synthcam_shared.jobs import run_jobs

sys.path.insert(0, str(ROOT / "tests" / "helpers"))
contacts: Any = importlib.import_module("tracker_contacts")
Floats = NDArray[np.float64]


def draw_push(rng: np.random.Generator, instant: bool = False) -> tuple[RecordedHit, float, str]:
    """Draw a hit of discs that push each other: its tracks, the duration of the force, s, and its law."""
    fps, law = float(rng.choice([250.0, 500.0])), str(rng.choice(contacts.LAWS))
    hit = contacts.SoftHit(
        duration=0.0 if instant else rng.uniform(0.008, 0.03),
        r=rng.uniform(0.5 if law == "dents" else 0.4, 0.95),
        v0=rng.uniform(0.15, 0.6),
        b=rng.uniform(-0.6, 0.6),
        rub=rng.uniform(0.0, 0.2),
        fps=fps,
        before=int(0.25 * fps),
        after=int(0.25 * fps),
        noise=2e-5 * 4 ** rng.uniform(0, 1),
        heading=rng.uniform(0, 2 * np.pi),
        law=law,
    )
    lasts = float(hit.end_of_force()[0])
    return RecordedHit(law, slow_down(hit.tracks(rng), hit, lasts / 2, rng), make_camera(hit)), lasts, law


def make_camera(hit: Any) -> dict[str, Any]:
    """The camera file of a hit."""
    keys: dict[str, Any] = hit.camera | {"size": [1000, 1000], "scale": 1e-3, "exposure": 0.0}
    return keys


def slow_down(tracks: pd.DataFrame, hit: Any, middle: float, rng: np.random.Generator) -> pd.DataFrame:
    """Add what air does to tracks: a constant acceleration of up to 1 m/s^2 on either side of the contact."""
    since = tracks["frame"].to_numpy() / hit.fps - hit.before / hit.fps - middle
    lost = np.zeros((len(tracks), 2))
    for particle in (0, 1):
        for side in (-1, 1):
            if particle == 0 and side < 0:  # it rests
                continue
            rows = ((tracks["particle"] == particle) & (side * since > 0)).to_numpy()
            lost[rows] = since[rows, None] ** 2 / 2 * rng.normal(0, 0.4, 2)
    return tracks.assign(x=tracks["x"] + lost[:, 0], y=tracks["y"] + lost[:, 1])


def measure_number(number: int, seed: int, kind: str, support: str) -> dict[str, Any]:
    """Measure the hit of a number: its duration, law, and the columns of its estimate."""
    rng = np.random.default_rng([seed, number])
    if kind in KINDS:
        hit, lasts, law = draw_one(kind, number, seed)[0], 0.0, kind
    else:
        hit, lasts, law = draw_push(rng, kind == "instants")
    row = measure_hit(hit, support)
    out = {"number": number, "law": law, "lasts": lasts, "r": row["r_local"], "motion": row["motion_local"]}
    value, std = row["contact_duration_local"], row["contact_duration_local_std"]
    return out | {"value": value, "std": std, "z": (value - lasts) / std, "share": std / max(lasts, 1e-9)}


def summarise(table: pd.DataFrame) -> str:
    """The number of hits, of those with a duration, and their scores, in one line."""
    z = table["z"].dropna().to_numpy()
    if len(z) == 0:
        return f"{len(table)} hits, 0 with a duration"
    rms, error = float(np.sqrt(np.mean(z**2))), 1 / np.sqrt(2 * len(z))
    return (
        f"{len(table)} hits, {len(z)} with a duration; z mean {z.mean():.2f}({1 / np.sqrt(len(z)):.2f}), "
        f"rms {rms:.2f}({error:.2f}), largest {np.abs(z).max():.1f}; within 1 and 1.96 errors "
        f"{np.mean(np.abs(z) < 1):.2f}, {np.mean(np.abs(z) < 1.96):.2f}; median error {table['share'].median():.3f}"
    )


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hits", type=int, default=120)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", choices=["pushes", "instants", *KINDS], default="pushes")
    parser.add_argument("--support", default="air")
    parser.add_argument("--workers", type=int, default=0)
    given = parser.parse_args()
    support = "" if given.support == "none" else given.support
    job = partial(measure_number, seed=given.seed, kind=given.kind, support=support)
    found = [done.value for done in run_jobs(job, range(given.hits), given.workers) if isinstance(done, JobValue)]
    table = pd.DataFrame(found).sort_values("number")
    print(f"all: {summarise(table)}")
    for law, part in table.groupby("law"):
        print(f"{law}: {summarise(part)}")
    glide = table["motion"] == "glide"
    print(f"{int(glide.sum())} glide by their estimates")
    print(table[table["z"].abs() > 3].to_string(index=False))


if __name__ == "__main__":
    main()
