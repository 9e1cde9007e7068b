"""Two-ball collisions a second: one at a time and thousands together, base and with each effect, beside pooltool.

benchmarks/collisions.py [--count 2000] [-o out/collisions.json]

A collision is all of 0.4 s: the approach, the impact, slides and rolls. pooltool (PyPI pooltool-billiards) is timed in
the same run where it is installed, on a table too large for cushions.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: its matrices here are too small to share out

import numpy as np

from synthcam.batch import collisions
from synthcam.dynamics import solve
from synthcam.effect import library
from synthcam.launch import Launch
from synthcam.model import Model

ROOT = Path(__file__).resolve().parent.parent
END = 0.4  # s


def launches(count: int) -> np.ndarray:
    """(count, 6) as in the paper's experiment."""
    rng = np.random.default_rng(0)
    place = rng.uniform(-0.02, 0.02, (count, 2))
    v0, heading, b = rng.uniform(0.1, 0.6, count), rng.uniform(0, 2 * np.pi, count), rng.uniform(-0.5, 0.5, count)
    return np.column_stack([place, np.full(count, 0.1), v0, heading, b])


def rate(work: Callable[[], Any], count: int, seconds: float = 1.0) -> float:
    """Collisions a second: the best of as many turns as fit into `seconds`, three at least."""
    best, spent, turns = np.inf, 0.0, 0
    while spent < seconds or turns < 3:
        started = time.perf_counter()
        work()
        took = time.perf_counter() - started
        best, spent, turns = min(best, took), spent + took, turns + 1
    return float(count / best)


def realistic(name: str) -> Model:
    """The model with one effect of realistic size, pushes small enough for a ball to rest."""
    kind = library()[name]
    small = 0.3 if "push" in kind.laws else 1.0
    return Model().replace({f"{name}.{p.name}": p.scale * (1.0 if p.fixed else small) for p in kind.parameters()})


def one_by_one(model: Model, count: int) -> float:
    rows = launches(count)
    starts = [Launch.pair(model.bodies("ab"), r[2], r[3], r[5], r[4], r[:2]) for r in rows]
    return rate(lambda: [solve(model, s, 0.0, END) for s in starts], count)


def together(model: Model, count: int) -> float:
    rows = launches(count)
    return rate(lambda: collisions(model, rows, 0.0, END), count)


def pooltool(count: int) -> float | None:
    """Shots a second of pooltool, None where it is not installed."""
    here = str(Path(__file__).resolve().parent)
    sys.path[:] = [p for p in sys.path if p != here]  # numba asks for a `coverage`, and must not find ours
    try:
        import attrs
        import pooltool as pt
        from pooltool.physics.resolve.ball_ball.friction import AverageBallBallFriction
        from pooltool.physics.resolve.ball_ball.frictional_inelastic import FrictionalInelastic
        from pooltool.physics.resolve.resolver import default_resolver
    except ImportError:
        return None
    model, radius = Model(), Model().ball.radius
    impact = FrictionalInelastic(friction=AverageBallBallFriction())
    engine = pt.physics.PhysicsEngine(resolver=attrs.evolve(default_resolver(), ball_ball=impact))
    numbers = {"m": model.ball.mass, "R": radius, "u_s": model.sliding_friction, "u_b": 0.5, "e_b": model.restitution}
    numbers |= {"u_r": model.rolling_decel / model.gravity, "g": model.gravity}

    def shot(row: np.ndarray) -> Any:
        balls = {name: pt.Ball(name, params=pt.BallParams(**numbers)) for name in "ab"}
        v0, b = row[3], row[5]
        balls["a"].state.rvw[0] = [0.5, 0.5, radius]
        balls["b"].state.rvw[0] = [0.5 - 0.1 * v0 - 2 * radius, 0.5 + 2 * radius * b, radius]
        balls["b"].state.rvw[1:] = [[v0, 0, 0], [0, v0 / radius, 0]]
        balls["b"].state.s = 3  # rolling
        return pt.System(cue=pt.Cue(cue_ball_id="b"), table=pt.Table.default(), balls=balls)

    shots = [shot(row) for row in launches(count)]
    pt.simulate(shots[0], engine=engine, t_final=END)  # compiles
    return rate(lambda: [pt.simulate(s, engine=engine, t_final=END) for s in shots], count)


def figures(count: int) -> dict[str, float | None]:
    out: dict[str, float | None] = {"pooltool, one at a time": pooltool(50)}
    out["one at a time"] = one_by_one(Model(), 50)
    out["one at a time, with a tilt"] = one_by_one(realistic("plate_tilt"), 20)
    out["together"] = together(Model(), count)
    for name, kind in library().items():
        if not set(kind.laws) <= {"camera", "clock", "exposure", "measure"}:
            out[f"together, {name}"] = together(realistic(name), 50 if "other" in kind.laws.get("push", ()) else count)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description="Collisions a second.")
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "collisions.json")
    options = parser.parse_args()
    found = figures(options.count)
    peer = found["pooltool, one at a time"]
    for name, value in found.items():
        times = f"   {value / peer:8.1f} x pooltool" if peer and value else ""
        print(f"{name:40s} {'not installed' if value is None else f'{value:10.0f} a second'}{times}")
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
