"""Many bodies: events a second beside pooltool, the cost of an event by the number of bodies, and a tray that cools.

python -m benchmarks.simulation.many_bodies [-o out/many_bodies] [--pooltool PYTHON]

- A nine-ball break between cushions, by this program and by pooltool in turn, in CPU seconds of one core. pooltool is
  warm; its compilation is not counted. PYTHON is an interpreter that has it: see pooltool_shots.py of the tests.
- Trays of 10 to 10,000 steel balls at 30 % of the area: CPU time per event. 100 balls for 10 s.
- Trays of 100 balls: granular temperature, what takes the energy, and how long balls slide between their contacts,
  with the plate's friction and without. Without it and with a constant restitution the temperature falls as
  (1 + t/t0)^-2 (Haff, J. Fluid Mech. 134 (1983) 401).
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from benchmarks.harness import ROOT, save
from synthcam.dynamics.contacts.walls import StraightWall, Wall
from synthcam.dynamics.kinematics import rolling_state
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.dynamics.tabletop import Table
from synthcam.dynamics.trajectory import Trajectory
from synthcam.effects.ball_friction import BallFriction
from synthcam.model import Bodies, Model

REFERENCE = ROOT / "tests" / "synthcam" / "dynamics"
GRAVITY, TURNS, TRAYS = 9.81, 5, 8
PEER = """
import json, sys, time
sys.path.insert(0, sys.argv[1])
from pooltool_break import engine, pt, system
own = engine()
pt.simulate(system(), engine=own)
times = []
for _ in range(int(sys.argv[2])):
    table = system()
    began = time.process_time()
    done = pt.simulate(table, engine=own, inplace=True)
    times.append(time.process_time() - began)
print(json.dumps({"events": len(done.events), "seconds": min(times)}))
"""


def box(
    width: float, height: float, restitution: float, friction: float, nose: float | None = None
) -> tuple[Wall, ...]:
    """Four walls about a rectangle from the origin, m."""
    corners = [(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)]
    sides = itertools.pairwise([*corners, corners[0]])
    return tuple(StraightWall(restitution, friction, 0.0, nose, start=a, end=b) for a, b in sides)


def like(count: int, radius: float, mass: float) -> Bodies:
    full = np.ones(count)
    return Bodies(radius * full, mass * full, 0 * full, 0.4 * full)


def break_balls() -> tuple[int, float]:
    """Events and CPU seconds of the break of pooltool_break.json, until all balls rest."""
    given = json.loads((REFERENCE / "pooltool_break.json").read_text(encoding="utf-8"))
    states = np.array(given["start"])
    states[:, 2], (width, height) = given["radius"], given["size"]
    model = Model(
        restitution=given["e_b"],
        sliding_friction=given["u_s"],
        spin_transfer=0.0,
        rolling_drag=0.0,
        rolling_decel=given["u_r"] * GRAVITY,
    )
    table = Table(box(width, height, given["e_c"], given["f_c"], given["height"]))
    launch = Launch(0.0, states, like(len(states), given["radius"], given["mass"]))
    seconds, events = math.inf, 0
    for _ in range(TURNS):
        began = time.process_time()
        events = len(solve(model, launch, 0.0, 30.0, table=table).events)
        seconds = min(seconds, time.process_time() - began)
    return events, seconds


def fill_tray(model: Model, count: int, speed: float, share: float = 0.3, seed: int = 1) -> tuple[Launch, float]:
    """Balls that roll about at a share of the area; also the side of the tray, m."""
    radius, rng = model.ball.radius, np.random.default_rng(seed)
    side, columns = math.sqrt(count * math.pi * radius**2 / share), math.ceil(math.sqrt(count))
    free = side / columns / 2 - radius
    cells = np.stack(np.divmod(np.arange(count), columns), axis=1)
    places = (cells + 0.5) * side / columns + rng.uniform(-0.98, 0.98, (count, 2)) * free
    states = rolling_state(places, rng.normal(0, speed / math.sqrt(2), (count, 2)), 0.0, radius)
    return Launch(0.0, states, model.bodies("b" * count)), side


def time_tray(count: int, lasts: float) -> dict[str, float]:
    """CPU time of a tray, s, and of each of its events."""
    launch, side = fill_tray(Model(), count, 0.3)
    table, began = Table(box(side, side, 0.8, 0.1), (), 1e-5), time.process_time()
    motion = solve(Model(), launch, 0.0, lasts, False, table)
    spent = time.process_time() - began
    row = {"balls": count, "events": len(motion.events), "us_per_event": 1e6 * spent / len(motion.events)}
    print(f"{count:6d} balls {lasts:5.2f} s  {row['events']:6d} events  {row['us_per_event']:6.0f} us each", flush=True)
    return row | {"seconds": spent}


def time_trays() -> list[dict[str, float]]:
    """CPU time per event of trays with ever more balls, some four events a ball."""
    return [time_tray(count, 0.05) for count in (10, 30, 100, 300, 1000, 3000, 10_000)]


def cool(model: Model, lasts: float) -> dict[str, Any]:
    """Trays of 100 balls: sinks of energy of the first, and means of all with their standard errors. The means are of
    the square speed, the time of Haff's law, and the time for which balls slide."""
    motions = []
    for seed in range(1, TRAYS + 1):
        launch, side = fill_tray(model, 100, 0.3, seed=seed)
        motions.append(solve(model, launch, 0.0, lasts, False, Table(box(side, side, 1.0, 0.0), (), 1e-5)))
    times = np.linspace(0, lasts, 41)
    trays = np.array([temperature(one.at(times)) for one in motions])
    each = np.array([fit_haff(times, tray)["haff_time"] for tray in trays])
    found = {"t": times.tolist(), "temperature": trays.mean(axis=0).tolist(), **share_losses(motions[0], launch.bodies)}
    found |= fit_haff(times, trays.mean(axis=0))
    found["haff_time_error"] = float(each.std(ddof=1)) / math.sqrt(TRAYS)
    return found | {"sliding": average_rows([compare_slides(one, lasts) for one in motions])}


def average_rows(tables: list[list[dict[str, float]]]) -> list[dict[str, float]]:
    """Average the numbers of tables with the same rows; `NAME_error` is the standard error of the mean."""
    out = []
    for rows in zip(*tables, strict=True):
        values = {name: np.array([row[name] for row in rows]) for name in rows[0]}
        errors = {f"{name}_error": float(v.std(ddof=1)) / math.sqrt(len(v)) for name, v in values.items() if len(v) > 1}
        out.append({name: float(v.mean()) for name, v in values.items()} | errors)
    return out


def compare_slides(motion: Trajectory, lasts: float) -> list[dict[str, float]]:
    """Return, in ten intervals of time, how long a ball slides at a stretch, the time between its contacts, and the
    share of time for which balls slide."""
    edges, rows = np.linspace(0, lasts, 11), []
    hits = np.array([e.t for e in motion.events if e.kind == "contact"])
    slides = np.array([(leg.t0, leg.t1) for legs in motion.legs for leg in legs if leg.motion == "slide"])
    for low, high in itertools.pairwise(edges):
        contacts = 2 * np.count_nonzero((hits >= low) & (hits < high)) / len(motion.legs)  # of each ball
        parts = np.clip(slides, low, high) if len(slides) else np.zeros((0, 2))
        spent = float(np.diff(parts, axis=1).sum()) / len(motion.legs)
        begun = np.count_nonzero((slides[:, 0] >= low) & (slides[:, 0] < high)) if len(slides) else 0
        rows.append(
            {
                "t": float((low + high) / 2),
                "slide_ms": 1e3 * spent * len(motion.legs) / begun if begun else math.nan,
                "between_ms": 1e3 * (high - low) / contacts if contacts else math.nan,
                "share": spent / (high - low),
            }
        )
    return rows


def fit_haff(times: NDArray[np.float64], temperature: NDArray[np.float64]) -> dict[str, float]:
    """Fit T0 (1 + t/t0)^-2: the root mean square of ln T about it, T0, and t0, s."""

    def deviate(numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.log(temperature) - numbers[0] + 2 * np.log1p(times * np.exp(numbers[1])))

    times, temperature = times[temperature > 0], temperature[temperature > 0]
    best = least_squares(deviate, [math.log(temperature[0]), 0.0])
    start, time = np.exp(best.x * [1, -1]).tolist()
    return {"haff": float(np.sqrt(np.mean(best.fun**2))), "haff_start": start, "haff_time": time}


def temperature(states: NDArray[np.float64]) -> list[float]:
    """Mean square velocity of states (balls, times, 9), m^2/s^2."""
    return list(np.mean((states[..., 3:5] ** 2).sum(axis=-1), axis=0))


def share_losses(motion: Trajectory, bodies: Bodies) -> dict[str, Any]:
    """Shares of the lost energy, translation and spin, that went in contacts of balls, in walls, and by what to the
    plate."""

    def energy(states: NDArray[np.float64], own: Bodies) -> float:
        spin = own.inertia * own.radius**2 * (states[..., 6:9] ** 2).sum(axis=-1)
        return float((own.mass / 2 * ((states[..., 3:6] ** 2).sum(axis=-1) + spin)).sum())

    lost = dict.fromkeys(("contact", "wall", "slide", "roll"), 0.0)
    for event in motion.events:
        if event.kind in lost:
            own = bodies[[event.i, event.j] if event.kind == "contact" else [event.i]]
            lost[event.kind] += energy(np.asarray(event.before), own) - energy(np.asarray(event.after), own)
    for ball, legs in enumerate(motion.legs):
        for leg in legs:
            if leg.motion in lost:
                ends = leg.at(np.array([leg.t0, leg.t1]))
                lost[leg.motion] += energy(ends[0], bodies[[ball]]) - energy(ends[1], bodies[[ball]])
    first, last = (energy(motion.at(t)[:, 0], bodies) for t in (motion.t0, motion.t1))
    return {"lost": first - last, "shares": {k: v / (first - last) for k, v in lost.items()}}


def draw(found: dict[str, Any], path: Path) -> None:
    """Plot the cost of an event by the number of balls."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.5, 3.6), layout="constrained")
    ax, rows = figure.subplots(), found["trays"]
    ax.loglog([r["balls"] for r in rows], [r["us_per_event"] for r in rows], "ko-", label="one core")
    ax.set(xlabel="balls", ylabel="processor time per event (µs)", ylim=(10, 3000))
    ax.legend(fontsize="small")
    figure.savefig(path, dpi=150)


def draw_cooling(found: dict[str, Any], path: Path) -> None:
    """Plot temperatures, what takes the energy, and how long balls slide."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 3.6), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    names = list(found)
    for (name, one), style in zip(found.items(), ("k-", "k--"), strict=True):
        left.loglog(one["t"][1:], one["temperature"][1:], style, label=name)
    smooth = found[names[1]]
    late = np.array(smooth["t"][1:])
    law = smooth["haff_start"] * (1 + late / smooth["haff_time"]) ** -2
    left.loglog(late, law, "r:", label="Haff's law, no friction")
    left.set(xlabel="time (s)", ylabel="mean square velocity (m²/s²)")
    kinds = {"contact": "contacts", "slide": "sliding", "roll": "rolling"}
    bottom = np.zeros(len(names))
    for (kind, label), shade in zip(kinds.items(), ("0.25", "0.6", "0.9"), strict=True):
        values = np.array([100 * one["shares"][kind] for one in found.values()])
        middle.bar(names, values, bottom=bottom, color=shade, edgecolor="k", width=0.5, label=label)
        bottom += values
    middle.set(ylabel="share of the energy lost (%)", ylim=(0, 135), yticks=range(0, 101, 20))
    rows = found[names[0]]["sliding"]
    t = [1e3 * r["t"] for r in rows]
    right.set_yscale("log")
    for name, style, label in (
        ("slide_ms", "ko-", "sliding at a stretch"),
        ("between_ms", "ks--", "between contacts of a ball"),
    ):
        errors = [r[f"{name}_error"] for r in rows]
        right.errorbar(t, [r[name] for r in rows], errors, fmt=style, ms=4, capsize=2, label=label)
    right.set(xlabel="time (ms)", ylabel="duration (ms)", ylim=(0.2, 150), title=names[0])
    left.legend(fontsize="small", loc="lower left")
    middle.legend(fontsize="small", ncols=4, loc="upper center")
    right.legend(fontsize="small")
    figure.savefig(path, dpi=150)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "many_bodies")
    parser.add_argument("--pooltool", type=Path, help="a Python interpreter that has pooltool")
    args = parser.parse_args()
    events, seconds = break_balls()
    found: dict[str, Any] = {"break": {"events": events, "seconds": seconds}}
    print(f"break: {events} events, {1e3 * seconds:.1f} ms, {events / seconds:.0f} events a second")
    if args.pooltool:
        command = [args.pooltool, "-c", PEER, REFERENCE, str(TURNS)]
        peer = json.loads(
            subprocess.run(command, stdout=subprocess.PIPE, check=True, text=True).stdout.splitlines()[-1]
        )
        found["pooltool"] = peer
        ratio = events / seconds / (peer["events"] / peer["seconds"])
        print(
            f"pooltool: {peer['events']} events, {1e3 * peer['seconds']:.1f} ms; ratio of events a second {ratio:.1f}"
        )
    found["trays"], found["long"] = time_trays(), time_tray(100, 10.0)
    smooth = Model(rolling_drag=0.0, rolling_decel=0.0, sliding_friction=1e-9, spin_transfer=0.0)
    found["cooling"] = {
        "the paper's plate": cool(Model(effects=(BallFriction(mu=0.15),)), 0.5),
        "no friction": cool(smooth, 2.0),
    }
    for name, one in found["cooling"].items():
        shares = ", ".join(f"{k} {v:.1%}" for k, v in one["shares"].items())
        t0 = f"{1e3 * one['haff_time']:.1f} +- {1e3 * one['haff_time_error']:.1f} ms"
        print(f"{name}: {shares} of the loss; t0 of Haff's law {t0}, rms of ln T about it {one['haff']:.3f}")
    save(args.output / "figures.json", found)
    draw(found, args.output / "many_bodies.png")
    draw_cooling(found["cooling"], args.output / "cooling.png")
    print(args.output / "many_bodies.png")


if __name__ == "__main__":
    main()
