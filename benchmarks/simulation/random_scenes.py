"""Thousands of random runs with random effects, several at once: no crash, no overlap, no energy from nowhere.

python -m benchmarks.simulation.random_scenes [--runs 10000] [--seed 0] [-o out/random_scenes.json]

A ValueError may refuse a run and say why (a ball that cannot rest, balls that stay in contact). All else is a failure.
Energy is the balls' kinetic energy, rolling and height included; it may rise only where an effect other than the drag
of air pushes. Prints a line for each failure, with the seed that repeats it.
"""

from __future__ import annotations

import argparse
import collections
import json
import multiprocessing
import os
import signal
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: its matrices here are too small to share out

import numpy as np

from benchmarks.harness import ROOT, save
from synthcam.dynamics.kinematics import rolling_state
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.dynamics.trajectory import Trajectory
from synthcam.effects.air_drag import AirDrag
from synthcam.library import library
from synthcam.model import Model

MOST = 4  # effects at once
LONGEST = 60.0  # CPU s, for one run
OVERLAP = 1e-9  # of a radius
MOTION = ("camera", "clock", "exposure", "measure")


def draw(rng: np.random.Generator) -> tuple[Model, Launch, float]:
    """A model within its limits, a launch (a pair at contact, or balls anywhere), and how long to run."""
    model = Model(
        restitution=rng.uniform(0.4, 1),
        sliding_friction=rng.uniform(0.05, 0.6),
        spin_transfer=rng.uniform(0, 5 / 7),
        rolling_drag=rng.choice([0, rng.uniform(0, 0.5)]),
        rolling_decel=rng.choice([0, rng.uniform(0, 0.05)], p=[0.1, 0.9]),
    )
    physical = [n for n, k in library().items() if not set(k.laws) <= set(MOTION)]
    for name in rng.choice(physical, rng.integers(0, MOST + 1), replace=False):
        for p in library()[name].parameters():
            size = (
                p.typical * (rng.uniform(0.2, 2) if p.fixed else rng.normal(0, 1.5)) + (p.typical == 0) * rng.normal()
            )
            if "push" in library()[name].laws and not p.fixed:
                size *= 0.3  # or hardly a ball could rest
            model = model.replace({f"{name}.{p.name}": float(np.clip(size, p.low, p.high))})
    end = rng.uniform(0.1, 2.0)
    labels = rng.choice(["ab", "ba"])
    if rng.random() < 0.6:
        bodies = model.bodies(labels)
        widest = 2 * np.sqrt(bodies.radius.prod()) / bodies.radius.sum()
        b = widest * rng.choice([rng.uniform(-0.999, 0.999), 0.0, 1 - 10 ** rng.uniform(-12, -1)])
        place, v0 = rng.normal(0, 0.02, 2), 10 ** rng.uniform(-2, 0)
        return model, Launch.pair(bodies, rng.uniform(0, 0.1), v0, b, rng.uniform(0, 7), place), end
    count = rng.integers(2, 5)
    bodies = model.bodies([rng.choice(["a", "b"]) for _ in range(count)])
    places = np.array([[3e-3 * k + rng.uniform(0, 4e-4), rng.uniform(0, 4e-3)] for k in range(count)])
    speed, heading = rng.uniform(0, 0.5, count) * (rng.random(count) < 0.6), rng.uniform(0, 7, count)
    velocity = speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    states = rolling_state(rng.permutation(places), velocity, rng.normal(0, 50, count), bodies.radius)
    slides = rng.random(count) < 0.4
    states[slides, 6:8] += rng.normal(0, 100, (slides.sum(), 2))
    return model, Launch(0.0, states, bodies), end


def energy(model: Model, launch: Launch, states: np.ndarray) -> np.ndarray:
    """Kinetic and of height, J: (m,)."""
    mass, radius = launch.bodies.mass[:, None], launch.bodies.radius[:, None]
    each = mass * ((states[..., 3:6] ** 2).sum(-1) / 2 + 0.2 * radius**2 * (states[..., 6:9] ** 2).sum(-1))
    return np.asarray((each + mass * model.gravity * (states[..., 2] - radius)).sum(axis=0))


def gains(model: Model) -> bool:
    """May an effect add to the balls' energy? Air only takes."""
    pushed = any(e.active and "push" in e.laws and not isinstance(e, AirDrag) for e in model.effects)
    eccentric = model.value("eccentric_mass.c") or model.value("eccentric_mass.d")
    return bool(pushed or eccentric or model.value("rolling_quadratic.K") < 0)


def examine(model: Model, launch: Launch, motion: Trajectory) -> dict[str, float]:
    """The deepest overlap over the smallest radius, and the largest rise of energy over the first energy."""
    events = np.array([e.t for e in motion.events if e.t <= motion.t1])
    near = np.concatenate([events + d for d in (-1e-6, -1e-9, 0, 1e-9, 1e-6, 1e-4)]) if len(events) else events
    times = np.unique(np.clip([*np.linspace(motion.t0, motion.t1, 400), *near], motion.t0, motion.t1))
    states, radius = motion.at(times), launch.bodies.radius
    deepest = 0.0
    for i in range(len(radius)):
        for j in range(i):
            gap = np.linalg.norm(states[i, :, :3] - states[j, :, :3], axis=1) - radius[i] - radius[j]
            deepest = max(deepest, float(-gap.min() / radius.min()))
    rise = 0.0
    if not gains(model):
        e = energy(model, launch, states)
        rise = float(np.maximum(np.diff(e), 0).max(initial=0.0) / max(e[0], 1e-300))
    return {"overlap": deepest, "rise": rise, "events": len(motion.events), "finite": float(np.isfinite(states).all())}


def _too_long(*_: Any) -> None:
    raise TimeoutError(f"not solved within {LONGEST:g} CPU s")


def one(seed: int) -> dict[str, Any]:
    """Run number `seed`."""
    model, launch, end = draw(np.random.default_rng(seed))
    about = {"seed": seed, "effects": [e.name() for e in model.effects if e.active], "balls": len(launch.states)}
    return about | run(model, launch, end)


def run(model: Model, launch: Launch, end: float) -> dict[str, Any]:
    """The outcome of a run, refused, crashed or examined, and its CPU time."""
    started = time.process_time()
    signal.signal(signal.SIGVTALRM, _too_long)
    signal.setitimer(signal.ITIMER_VIRTUAL, LONGEST)
    try:
        motion = solve(model, launch, 0.0, end)
    except ValueError as e:
        return {"refused": str(e), "seconds": time.process_time() - started}
    except Exception as e:  # whatever it is, it is what we look for
        return {"crash": repr(e), "seconds": time.process_time() - started}
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
    return examine(model, launch, motion) | {"seconds": time.process_time() - started}


def wrong(row: dict[str, Any]) -> bool:
    if "refused" in row:
        return "could not be integrated" in row["refused"] or "overlap" in row["refused"]
    return "crash" in row or row["overlap"] > OVERLAP or row["rise"] > 1e-11 or not row["finite"]


def main() -> None:
    parser = argparse.ArgumentParser(description="Random runs with random effects.")
    parser.add_argument("--runs", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "random_scenes.json")
    options = parser.parse_args()
    rows = []
    with ProcessPoolExecutor(options.workers, multiprocessing.get_context("spawn")) as pool:
        for row in pool.map(one, range(options.seed, options.seed + options.runs), chunksize=20):
            rows.append(row)
            if wrong(row):
                print(row, flush=True)
    solved = [r for r in rows if "overlap" in r]
    said = collections.Counter(" ".join(r["refused"].split()[:6]) for r in rows if "refused" in r)
    summary = {
        "runs": len(rows),
        "solved": len(solved),
        "wrong": sum(wrong(r) for r in rows),
        "deepest overlap, radii": max((r["overlap"] for r in solved), default=0.0),
        "largest rise of energy": max((r["rise"] for r in solved), default=0.0),
        "most events": max((r["events"] for r in solved), default=0),
        "slowest, CPU s": max(r["seconds"] for r in rows),
        "refused": dict(said.most_common()),
        "seeds that went wrong": [r["seed"] for r in rows if wrong(r)],
        "slow seeds": [r["seed"] for r in sorted(rows, key=lambda r: -r["seconds"])[:5]],
    }
    print(json.dumps(summary, indent=1))
    save(options.output, summary)
    sys.exit(int(summary["wrong"] > 0))


if __name__ == "__main__":
    main()
