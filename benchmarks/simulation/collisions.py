"""Two-ball collisions a second: one at a time and thousands together, base and with each effect, beside pooltool.

python -m benchmarks.simulation.collisions [--count 2000] [-o out/collisions.json]

A collision lasts 0.4 s, with approach, impact, slides, rolls and the time of every event. It is timed twice:

- solved;
- solved and evaluated at 100 frames. pooltool does this by continuize. One at a time gives all states. Together gives
  the centres averaged over exposures that the fits use.

The goals are for evaluated collisions, which every user needs; the ratio of the solving alone is printed beside them.
pooltool and the runs one at a time start from the same states before the contact; the runs together start from
launches. The figures are CPU seconds of one core, turn by turn, the best of them.

pooltool (PyPI pooltool-billiards) is timed where it is installed, on a table too large for cushions. Its 0.6 asks for a
panda3d that is not on PyPI; for this, pip install --no-deps with any panda3d does.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: its matrices here are too small to share out

import numpy as np

from benchmarks.harness import ROOT, save
from synthcam.dynamics.batch import solve_collisions
from synthcam.dynamics.kinematics import rolling_state
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.library import library
from synthcam.model import Model

END, FPS, FRAMES, EXPOSURE = 0.4, 250.0, 100, 5e-4  # s, 1/s, frames, s
AWAY = 0.1  # s before the contact, nearly
ONE, BASE, EFFECT = 10, 300, 50  # times pooltool: the goals
PAIRS = "together, magnetic_attraction"  # two balls to a problem: no goal
Work = Callable[[], Any]


def launches(count: int) -> np.ndarray:
    """(count, 6) as in the paper's experiment."""
    rng = np.random.default_rng(0)
    place = rng.uniform(-0.02, 0.02, (count, 2))
    v0, heading, b = rng.uniform(0.1, 0.6, count), rng.uniform(0, 2 * np.pi, count), rng.uniform(-0.5, 0.5, count)
    return np.column_stack([place, np.full(count, AWAY), v0, heading, b])


def pair(v0: float, b: float, radius: float) -> np.ndarray:
    """States (2, 9) of a ball at rest and of one that will hit it about AWAY later."""
    places = np.array([[0.5, 0.5], [0.5 - AWAY * v0 - 2 * radius, 0.5 + 2 * radius * b]])
    return rolling_state(places, np.array([[0, 0], [v0, 0]]), 0.0, np.full(2, radius))


def rates(works: dict[str, tuple[Work, int]], seconds: float = 2.0) -> dict[str, float]:
    """Collisions a CPU second of each work, done in turn for `seconds` each, three times at least."""
    best = dict.fromkeys(works, np.inf)
    spent, turns = dict.fromkeys(works, 0.0), 0
    while turns < 3 or any(s < seconds for s in spent.values()):
        turns += 1
        for name, (work, count) in works.items():
            if turns > 3 and spent[name] > seconds:
                continue
            started = time.process_time()
            work()
            took = time.process_time() - started
            best[name], spent[name] = min(best[name], took / count), spent[name] + took
    return {name: float(1 / t) for name, t in best.items()}


def realistic(name: str) -> Model:
    """The model with one effect of realistic size, pushes small enough for a ball to rest."""
    kind = library()[name]
    small = 0.3 if "push" in kind.laws else 1.0
    return Model().replace({f"{name}.{p.name}": p.typical * (1.0 if p.fixed else small) for p in kind.parameters()})


def one_by_one(model: Model, count: int) -> dict[str, tuple[Work, int]]:
    bodies, times = model.bodies("ab"), np.arange(FRAMES) / FPS
    starts = [Launch(0.0, pair(row[3], row[5], model.ball.radius), bodies) for row in launches(count)]
    return {
        "solved": (lambda: [solve(model, s, 0.0, END) for s in starts], count),
        "seen": (lambda: [solve(model, s, 0.0, END).at(times) for s in starts], count),
    }


def together(model: Model, count: int) -> dict[str, tuple[Work, int]]:
    rows, times = launches(count), np.arange(FRAMES) / FPS
    return {
        "solved": (lambda: solve_collisions(model, rows, 0.0, END), count),
        "seen": (
            lambda: solve_collisions(model, rows, 0.0, END).average_centres(times, min(EXPOSURE, END - times[-1])),
            count,
        ),
    }


def pooltool(count: int) -> dict[str, tuple[Work, int]]:
    """The same of pooltool, empty where it is not installed."""
    try:
        import attrs
        import pooltool as pt
        from pooltool.physics.resolve.ball_ball.friction import AverageBallBallFriction
        from pooltool.physics.resolve.ball_ball.frictional_inelastic import FrictionalInelastic
        from pooltool.physics.resolve.resolver import default_resolver
    except ImportError:
        return {}
    model, radius = Model(), Model().ball.radius
    impact = FrictionalInelastic(friction=AverageBallBallFriction())
    engine = pt.physics.PhysicsEngine(resolver=attrs.evolve(default_resolver(), ball_ball=impact))
    numbers = {"m": model.ball.mass, "R": radius, "u_s": model.sliding_friction, "u_b": 0.5, "e_b": model.restitution}
    numbers |= {"u_r": model.rolling_decel / model.gravity, "g": model.gravity}

    def shot(row: np.ndarray) -> Any:
        balls = {name: pt.Ball(name, params=pt.BallParams(**numbers)) for name in "ab"}
        for ball, state in zip(balls.values(), pair(row[3], row[5], radius), strict=True):
            ball.state.rvw[:] = state.reshape(3, 3)
        balls["b"].state.s = 3  # rolling
        return pt.System(cue=pt.Cue(cue_ball_id="b"), table=pt.Table.default(), balls=balls)

    shots = [shot(row) for row in launches(count)]

    def simulate(s: Any) -> Any:
        return pt.simulate(s, engine=engine, t_final=END)

    pt.continuize(simulate(shots[0]), dt=1 / FPS, inplace=True)  # compiles
    return {
        "solved": (lambda: [simulate(s) for s in shots], count),
        "seen": (lambda: [pt.continuize(simulate(s), dt=1 / FPS, inplace=True) for s in shots], count),
    }


def figures(count: int) -> dict[str, dict[str, float]]:
    """Collisions a second: solved, and solved and seen."""
    works = {"pooltool, one at a time": pooltool(50), "one at a time": one_by_one(Model(), 50)}
    works["one at a time, with a tilt"] = one_by_one(realistic("plate_tilt"), 10)
    works["together"] = together(Model(), count)
    for name, kind in library().items():
        if not set(kind.laws) <= {"camera", "clock", "exposure", "measure"}:
            works[f"together, {name}"] = together(realistic(name), count)
    out = {}
    for name, both in works.items():
        out[name] = rates(both)
        print(f"{name:42s}" + "".join(f"{v:12.0f} {k}" for k, v in out[name].items()), flush=True)
    return {name: both for name, both in out.items() if both}


def verdicts(found: dict[str, dict[str, float]]) -> list[str]:
    """Each goal, and by how much it is met."""
    peer = found.get("pooltool, one at a time")
    if peer is None:
        return ["pooltool is not installed: no ratios"]
    ratio = {name: {kind: both[kind] / peer[kind] for kind in both} for name, both in found.items()}
    effects = sorted((n for n in ratio if n.startswith("together, ")), key=lambda n: ratio[n]["seen"])
    lines = ["solved and seen at 100 frames, times pooltool; in brackets solved only"]
    for name, goal in (("one at a time", ONE), ("together", BASE), *((n, EFFECT) for n in effects)):
        met = f"goal {goal}: " + ("met" if ratio[name]["seen"] >= goal else "MISSED")
        met = "no goal" if name == PAIRS else met
        lines.append(f"{name:42s}{ratio[name]['seen']:8.1f}, {met} ({ratio[name]['solved']:.1f})")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description="Collisions a second.")
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "collisions.json")
    options = parser.parse_args()
    print("collisions a CPU second")
    found = figures(options.count)
    print(*verdicts(found), sep="\n")
    save(options.output, found)


if __name__ == "__main__":
    main()
