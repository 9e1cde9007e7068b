"""Inelastic collapse of a line of balls, and how momentum that goes to the plate prevents it.

python -m benchmarks.simulation.collapse [-o out/collapse]

- Lines of 3 and of 5 balls, each moving as a whole over the plate. A collision takes a share of the momentum of both
  balls (Dutt et al. 1999, as Painter & Behringer cite them). The number of collisions, by that share, up to a limit.
  Gaps and relative velocities are variables of their own here, so no digits are lost as they go to zero.
  The known limit for three balls is r = 7 - 4 sqrt(3) = 0.0718 (McNamara & Young, Phys. Fluids A 4 (1992) 496).
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import ROOT, save

Array = NDArray[np.float64]
LIMIT = 2000  # collisions; without loss, intervals reach the smallest numbers before
SHARES = (0.0, *np.logspace(-15, -1, 15))
LINES = {"3 balls, r = 0.03": (3, 0.03), "5 balls, r = 0.1": (5, 0.1)}
STARTS = 40


def count_collisions(gaps: Array, u: Array, first: float, restitution: float, share: float) -> int:
    """Count the collisions of a line until no two balls approach, at most LIMIT.

    gaps: between neighbours. u: velocity of each less that of the one before; first: that of the first. share: of the
    momentum of two balls that goes to the plate when they collide.
    """
    gaps, u = gaps.copy(), u.copy()
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


def scan_line(count: int, restitution: float) -> list[int]:
    """Return the most collisions over random starts, for each share."""
    rng = np.random.default_rng(1)
    starts = []
    for _ in range(STARTS):
        velocities = np.sort(rng.uniform(-1, 1, count))[::-1]  # all approach
        starts.append((rng.uniform(0.5, 1.5, count - 1), np.diff(velocities), 3.0 + velocities[0]))
    return [max(count_collisions(*start, restitution, share) for start in starts) for share in SHARES]


def draw(found: dict[str, Any], path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.4, 3.6), layout="constrained")
    ax = figure.subplots()
    for (name, counts), style in zip(found["lines"].items(), ("ko-", "ks--"), strict=True):
        ax.loglog(SHARES[1:], counts[1:], style, ms=4, label=name)
    ax.set(xlabel="share of the momentum lost in a collision", ylabel="collisions", ylim=(1, LIMIT))
    ax.legend(fontsize="small", loc="lower left")
    figure.savefig(path, dpi=150)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "collapse")
    args = parser.parse_args()
    found: dict[str, Any] = {"shares": list(SHARES), "lines": {}}
    for name, line in LINES.items():
        counts = found["lines"][name] = scan_line(*line)
        print(f"{name}: {counts[0]} collisions with nothing lost (the limit is {LIMIT}); by share lost:")
        print("  " + ", ".join(f"{share:.0e} {n}" for share, n in zip(SHARES[1:], counts[1:], strict=True)))
    known = np.tan(np.pi / 12) ** 2  # 7 - 4 sqrt(3)
    found["threshold"] = {f"{known + by:.4f}": scan_line(3, known + by)[0] for by in (-0.003, 0.003)}
    print("collisions of three balls with nothing lost, by restitution:", found["threshold"])
    save(args.output / "figures.json", found)
    draw(found, args.output / "collapse.png")
    print(args.output / "collapse.png")


if __name__ == "__main__":
    main()
