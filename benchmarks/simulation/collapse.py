"""Inelastic collapse of a line of balls: what momentum that goes to the plate, and friction of the plate, do to it.

python -m benchmarks.simulation.collapse [-o out/collapse]

- Lines of 3 and of 5 balls, each moving as a whole over a plate without friction. A contact takes a share of the
  momentum of both balls: our reading of Dutt et al. 1999, as Painter & Behringer cite them. The number of contacts by
  that share, by the event loop of this program, and by a loop in one dimension. There gaps and relative velocities are
  variables of their own, so no digits are lost as they go to zero. The event loop refuses balls that approach at less
  than a nanometre a second. The known limit for three balls is r = 7 - 4 sqrt(3) = 0.0718 (McNamara & Young, Phys.
  Fluids A 4 (1992) 496).
- The event loop alone shows how many of the lines end in a contact that lasts, by restitution. It runs them on a plate
  without friction and on that of the paper. A contact duration bounds the number of contacts, which the study counts
  too.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import ROOT, save
from synthcam.dynamics.kinematics import rolling_state
from synthcam.dynamics.launch import Launch
from synthcam.dynamics.solve import solve
from synthcam.dynamics.tabletop import Table
from synthcam.model import Model

Array = NDArray[np.float64]
Start = tuple[Array, Array, float]  # gaps, relative velocities, velocity of the first
LIMIT = 2000  # collisions; without loss, intervals reach the smallest numbers before
SHARES = (0.0, *np.logspace(-15, -1, 15))
RESOLVED = 1e-7  # smallest share whose last contacts the event loop resolves
LINES = {"3 balls, r = 0.03": (3, 0.03), "5 balls, r = 0.1": (5, 0.1)}
STARTS, ALONG = 40, 3.0  # velocity of a whole line over the spread of those of its balls
RESTITUTIONS = (0.02, 0.03, 0.05, 0.065, 0.08, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
GAP_M, SPREAD_M_S, DURATION_S, LASTS_S = 1e-3, 0.1, 1e-5, 0.2
SMOOTH = Model(rolling_drag=0.0, rolling_decel=0.0, sliding_friction=1e-13, spin_transfer=0.0)


def draw_starts(count: int, along: float) -> list[Start]:
    """Draw lines in which all balls approach their neighbours, with gaps and velocities of the order of one."""
    rng, starts = np.random.default_rng(1), []
    for _ in range(STARTS):
        velocities = np.sort(rng.uniform(-1, 1, count))[::-1]
        starts.append((rng.uniform(0.5, 1.5, count - 1), np.diff(velocities), along + velocities[0]))
    return starts


def count_collisions(start: Start, restitution: float, share: float) -> int:
    """Count the collisions of a line in one dimension until no two balls approach, at most LIMIT.

    share: of the momentum of two balls that goes to the plate when they collide.
    """
    gaps, u, first = start[0].copy(), start[1].copy(), start[2]
    for number in range(LIMIT):
        times = np.where(u < 0, gaps / np.where(u < 0, -u, 1.0), np.inf)
        k = int(times.argmin())
        if times[k] == np.inf:
            return number
        gaps += u * times[k]
        gaps[k] = 0.0
        mean = first + u[:k].sum() + u[k] / 2
        lost, bounce = share * mean, (1 + restitution) * u[k] / 2
        if k > 0:
            u[k - 1] += bounce - lost
        else:
            first += bounce - lost
        if k + 1 < len(u):
            u[k + 1] += bounce + lost
        u[k] *= -restitution
    return LIMIT


def run_line(start: Start, model: Model, table: Table, spread: float = SPREAD_M_S, lasts: float = LASTS_S) -> int:
    """Count the contacts of a line of balls that roll, by the event loop; -1 where balls stay in contact.

    spread: by which the start's velocities are multiplied, m/s.
    """
    gaps, u, first = start
    radius = model.ball.radius
    places = np.concatenate([[0.0], np.cumsum(2 * radius + GAP_M * gaps)])
    velocities = spread * (first + np.concatenate([[0.0], np.cumsum(u)]))
    rows = np.stack([places, 0 * places], axis=1), np.stack([velocities, 0 * places], axis=1)
    launch = Launch(0.0, rolling_state(*rows, 0.0, radius), model.bodies("b" * len(places)))
    try:
        motion = solve(model, launch, 0.0, lasts, False, table, max_events=5 * LIMIT)
    except ValueError as error:
        return 5 * LIMIT if "does not settle" in str(error) else -1
    return sum(event.kind == "contact" for event in motion.events)


def scan_line(count: int, restitution: float) -> list[int]:
    """Return the most collisions over random starts in one dimension, for each share."""
    return [max(count_collisions(s, restitution, share) for s in draw_starts(count, ALONG)) for share in SHARES]


def compare_loops(count: int, restitution: float) -> dict[str, list[int]]:
    """Return the most contacts by the event loop, for shares that it resolves, and how many lines agree."""
    model, out = replace(SMOOTH, restitution=restitution), dict[str, list[int]](counts=[], agree=[])
    for share in SHARES:
        if share >= RESOLVED:
            table = Table(plate_share=share)
            starts = draw_starts(count, ALONG)
            found = [run_line(start, model, table, 1.0, 10.0) for start in starts]
            out["counts"].append(max(found))
            own = [count_collisions(start, restitution, share) for start in starts]
            out["agree"].append(sum(a == b for a, b in zip(found, own, strict=True)))
    return out


def scan_restitution(count: int, along: float, plate: Model) -> dict[str, list[float]]:
    """Return by restitution: the share of lines that end in a contact that lasts, and contacts with a bound."""
    out = dict[str, list[float]](lasting=[], most=[])
    for restitution in RESTITUTIONS:
        model, starts = replace(plate, restitution=restitution), draw_starts(count, along)
        out["lasting"].append(sum(run_line(start, model, Table()) < 0 for start in starts) / STARTS)
        bounded = [run_line(start, model, Table(contact_duration=DURATION_S)) for start in starts[::8]]
        out["most"].append(max(bounded))
    return out


def draw(found: dict[str, Any], path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.5, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    resolved = [share for share in SHARES if share >= RESOLVED]
    for (name, counts), style in zip(found["lines"].items(), ("k-", "k--"), strict=True):
        left.loglog(SHARES[1:], counts[1:], style, label=f"{name}, one dimension")
        left.loglog(resolved, found["event loop"][name]["counts"], "ko", ms=4, mfc="w")
    left.loglog([], [], "ko", ms=4, mfc="w", label="event loop")
    left.set(xlabel="share of the momentum lost in a contact", ylabel="contacts", ylim=(1, LIMIT))
    left.legend(fontsize="small", loc="lower left")
    for (name, one), style in zip(found["plates"].items(), ("ko-", "ks--", "k^:"), strict=True):
        right.semilogx(RESTITUTIONS, [100 * share for share in one["lasting"]], style, ms=4, label=name)
    right.axvline(np.tan(np.pi / 12) ** 2, color="0.7", lw=0.8)
    right.set(xlabel="restitution", ylabel="lines that end in a lasting contact (%)")
    right.set(ylim=(-5, 155), yticks=range(0, 101, 20), title="3 balls")
    right.legend(fontsize="small", loc="upper right")
    figure.savefig(path, dpi=150)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "collapse")
    args = parser.parse_args()
    found: dict[str, Any] = {"shares": list(SHARES), "lines": {}, "event loop": {}, "plates": {}}
    for name, line in LINES.items():
        counts = found["lines"][name] = scan_line(*line)
        print(f"{name}: {counts[0]} collisions with nothing lost (the limit is {LIMIT}); by share lost:")
        print("  " + ", ".join(f"{share:.0e} {n}" for share, n in zip(SHARES[1:], counts[1:], strict=True)))
        one = found["event loop"][name] = compare_loops(*line)
        print(f"  event loop from {RESOLVED:.0e} on: {one['counts']}, as many as in one dimension in")
        print(f"  {one['agree']} of {STARTS} lines")
    known = np.tan(np.pi / 12) ** 2  # 7 - 4 sqrt(3)
    found["threshold"] = {f"{known + by:.4f}": scan_line(3, known + by)[0] for by in (-0.003, 0.003)}
    print("collisions of three balls with nothing lost, by restitution:", found["threshold"])
    print("restitution:", *RESTITUTIONS)
    plates = (
        ("no friction", 0.0, SMOOTH),
        ("the paper's plate", 0.0, Model()),
        ("the same, line moves", ALONG, Model()),
    )
    for name, along, plate in plates:
        ends = found["plates"][name] = scan_restitution(3, along, plate)
        print(f"{name}, 3 balls: lasting contacts in", *(f"{share:.0%}" for share in ends["lasting"]))
        print(f"  most contacts with a contact duration of {DURATION_S:g} s, in {LASTS_S:g} s:", *ends["most"])
    save(args.output / "figures.json", found)
    draw(found, args.output / "collapse.png")
    print(args.output / "collapse.png")


if __name__ == "__main__":
    main()
