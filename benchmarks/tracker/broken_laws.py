"""Recommended estimates where laws of the tied fit are broken, in short tables: do their errors hold?

python -m benchmarks.tracker.broken_laws [--tables 120] [--seed 1] [-o out/broken_laws.json]

Each table has 5 to 15 positions of each ball on either side of a hit. r, friction, spin transfer, speed, size of the
balls, frame rate and noise are drawn for each. A slide lasts 4 to 20 frames. Each cause of CAUSES acts in as many
tables; `several` are three of the others, and `none` is the control. Half of the tables claim the errors of their
positions.

The table gives for each cause how often each estimate is recommended. By estimate it then gives, for r, v0 and
energy_fraction:

- the number of values with an error;
- the shares with |z| over 3 and over 4.5, where z is the deviation over the standard error;
- the rms of z, each |z| at most 5;
- the median error.
"""

from __future__ import annotations

import argparse
import os
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pandas as pd

import tracker
from benchmarks.harness import save
from synthcam.dynamics.contacts.lasting import ContactSpring
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.dynamics.tabletop import Table
from synthcam.dynamics.trajectory import Trajectory
from synthcam.model import as_model
from synthcam_shared.arrays import Array
from tracker.measurement.local.recommendation import FREE, LOCAL, NONE, SUFFIXES, TIED

Rng = np.random.Generator
POSITIONS = (5, 16)  # of each ball on either side, at least and below
QUANTITIES = ("r", "v0", "energy_fraction")
# each draws effects of the model by their names, or other changes by the names that `draw_table` knows
CAUSES: dict[str, Callable[[Rng], dict[str, Any]]] = {
    "none": lambda rng: {},
    "side spin": lambda rng: {"side": rng.uniform(-1, 1)},
    "Coulomb friction": lambda rng: {"ball_friction": {"mu": rng.uniform(0.02, 0.3)}},
    "hop": lambda rng: {"hop": {"share": rng.uniform(0.2, 1)}},
    "striker slides": lambda rng: {"slip": rng.uniform(-0.8, 0.8)},
    "sprung contact": lambda rng: {"frames": rng.uniform(0.3, 3)},
    "friction differs": lambda rng: {"friction_mismatch": {"excess": rng.uniform(-0.4, 0.4)}},
    "drag": lambda rng: {"rolling_mismatch": {"decel": rng.uniform(0, 0.2), "drag": rng.uniform(0, 0.2)}},
    "masses": lambda rng: {"mass_mismatch": {"excess": rng.uniform(-0.2, 0.2)}},
    "noise beside": lambda rng: {"noise": rng.uniform(2, 5)},
    "wrong diameter": lambda rng: {"diameter": rng.uniform(-0.05, 0.05)},
}
SEVERAL = "several"


def draw_cause(cause: str, rng: Rng) -> dict[str, Any]:
    """Draw what breaks the laws of one table."""
    names = rng.choice(list(CAUSES)[1:], 3, replace=False) if cause == SEVERAL else [cause]
    changes = {key: value for name in names for key, value in CAUSES[name](rng).items()}
    if "hop" in changes:  # the simulation has no hop after a contact that lasts
        changes.pop("frames", None)
    return changes


def draw_table(cause: str, rng: Rng) -> tuple[pd.DataFrame, dict[str, Any], dict[str, float]]:
    """Draw a table of positions, m, with its camera file and the truth."""
    changes, radius = draw_cause(cause, rng), float(rng.choice([1.19e-3, 0.01, 0.03]))
    friction, v0 = rng.uniform(0.12, 0.32), rng.uniform(1, 5) * float(np.sqrt(9.81 * radius))
    fps = rng.uniform(4, 20) * 3.5 * friction * 9.81 / v0
    numbers = {"restitution": rng.uniform(0.6, 0.98), "spin_transfer": rng.uniform(0.05, 0.36)}
    numbers |= {"sliding_friction": friction, "rolling_drag": 0.1, "rolling_decel": rng.uniform(0.01, 0.1)}
    if "ball_friction" in changes:
        numbers["spin_transfer"] = 0.0
    own = {"slip", "side", "frames", "noise", "diameter"}
    effects = {name: value for name, value in changes.items() if name not in own}
    model = as_model({"ball": {"diameter": 2 * radius}, "model": numbers, "effects": effects})
    spin = v0 * np.array([changes.get("slip", 0.0), 0.0, changes.get("side", 0.0)])
    launch = Launch.pair(model.bodies("ab"), 0.0, v0, rng.uniform(-0.7, 0.7), rng.uniform(0, 6.28), [0.0, 0.0], spin)
    spring = ContactSpring(duration=changes["frames"] / fps) if "frames" in changes else None
    early, late = rng.integers(*POSITIONS, 2)
    time = (np.arange(-early, late) + rng.uniform(0, 1)) / fps
    motion = solve(model, launch, float(time[0]) - 1e-6, float(time[-1]) + 1e-6, table=Table(spring=spring))
    noise = radius * float(np.exp(rng.uniform(*np.log([0.001, 0.02]))))
    size = noise * np.where(abs(time * fps) < 1.5, changes.get("noise", 1.0), 1.0)
    xy = motion.at(time)[..., :2] + size[:, None] * rng.normal(size=(2, len(time), 2))
    frame = np.arange(len(time))
    parts = [pd.DataFrame({"frame": frame, "particle": k, "x": xy[k, :, 0], "y": xy[k, :, 1]}) for k in (0, 1)]
    table = pd.concat(parts, ignore_index=True)
    if rng.uniform() < 0.5:
        table = table.assign(x_std=noise, y_std=noise)
    camera = {"size": [2000, 2000], "fps": fps, "scale": radius / 30, "exposure": 0.0}
    camera["ball_diameter"] = 2 * radius * (1 + changes.get("diameter", 0.0))
    return table, camera, find_truth(motion, launch)


def find_truth(motion: Trajectory, launch: Launch) -> dict[str, float]:
    """Find the true values of the quantities of one contact at the time 0."""
    end, mass = motion.first("contact_end"), launch.bodies.mass
    before, after = launch.states, motion.at([0.0 if end is None else end.t])[:, 0]
    early, late = (float((s[0, 3:5] - s[1, 3:5]) @ (s[0, :2] - s[1, :2])) for s in (before, after))
    rolls = [[leg for leg in legs if leg.t0 > 0 and leg.motion == "roll"] for legs in motion.legs]
    times = [legs[0].t0 if legs else motion.t1 for legs in rolls]  # the motion ends with the last slide
    final = np.array([motion.at_one(ball, np.array([t]))[0, 3:5] for ball, t in enumerate(times)])
    start, left = (float(mass @ (v**2).sum(axis=1)) for v in (before[:, 3:5], final))
    return {"r": -late / early, "v0": float(np.hypot(*before[1, 3:5])), "energy_fraction": left / start}


def measure_tables(tables: int, seed: int) -> list[dict[str, Any]]:
    """Measure tables: the first row of each, with its cause and the truth as NAME_true."""
    out, causes = [], [*CAUSES, SEVERAL]
    for number in range(tables):
        rng, cause = np.random.default_rng([seed, number]), causes[number % len(causes)]
        table, camera, truth = draw_table(cause, rng)
        row = dict(tracker.measure(table, camera, unit="m").rows[0])
        out.append(row | {"cause": cause} | {f"{name}_true": value for name, value in truth.items()})
    return out


def find_deviations(rows: Sequence[dict[str, Any]], name: str) -> tuple[Array, Array]:
    """Find z and the standard errors of a quantity by the recommended estimates that give it."""
    columns = [(row, f"{name}{SUFFIXES[row['recommended']]}") for row in rows if row["recommended"] != NONE]
    found = np.array([(row[c] - row[f"{name}_true"], row[f"{c}_std"]) for row, c in columns]).reshape(-1, 2)
    off, std = found[np.isfinite(found).all(axis=1)].T
    return off / std, std


def summarise(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Summarise rows: how often each estimate is recommended, and by estimate how far each quantity is off."""
    out: dict[str, Any] = {"recommended": dict(Counter(row["recommended"] for row in rows))}
    for kind in (TIED, FREE, LOCAL):
        for name in QUANTITIES:
            z, std = find_deviations([row for row in rows if row["recommended"] == kind], name)
            if len(z):
                shares = [round(float(np.mean(abs(z) > limit)), 3) for limit in (3.0, 4.5)]
                rms = round(float(np.sqrt(np.mean(np.minimum(z**2, 25.0)))), 2)
                out[f"{kind} {name}"] = [len(z), *shares, rms, float(f"{np.median(std):.2g}")]
    return out


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tables", type=int, default=120)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/broken_laws.json"))
    given = parser.parse_args()
    rows = measure_tables(given.tables, given.seed)
    out = {cause: summarise([row for row in rows if row["cause"] == cause]) for cause in (*CAUSES, SEVERAL)}
    out["all"] = summarise(rows)
    for cause, summary in out.items():
        print(f"{cause}: {summary.pop('recommended')}; number, shares over 3 and 4.5 errors, rms z, median error")
        for name, line in summary.items():
            print(f"  {name:24}{line}")
    save(given.output, out)


if __name__ == "__main__":
    main()
