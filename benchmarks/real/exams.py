"""Exams on tracks of others: what their authors or an independent analysis know, beside what the tracker finds.

python -m benchmarks.real.exams CLONE [CLONE ...] [-o out/exams.json]
make bench-exams CLONES="CLONE ..."

Each CLONE is a clone of one of the repositories that `recordings` reads. The printed table has a line for each exam:

- billiards (3cushiontool): r, its scatter, and the momentum that the balls lose;
- pucks (TIF083-Expfys1A): the mass ratio, r and its fall with the speed, and the inertia factor I/(m R^2). The tracker
  sees no rotation, so this factor tests its tangential velocities: it is their change over that of R times the spin,
  which markers on the pucks show;
- discs (TIF083A, series 5 to 7): mass ratios by recoil, r of taped discs, which stick, and how long contacts with
  springs last, beside those of the same discs without springs;
- all: the number of hits with an error of r below .05.

Expected values are those of scales, of theory and of an independent analysis. That analysis has no numbers for hits
with a small error of each laboratory.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.harness import add_clones, save
from benchmarks.real.hits import READERS, find_laboratory, measure_hit, summarise
from benchmarks.real.recordings import PUCK_HZ, RecordedHit, read_puck_angles
from synthcam_shared.report.numbers import format_with_error
from tracker.measurement.camera_errors import remove_shared, shared_effects
from tracker.measurement.collision.adequacy import TOGETHER
from tracker.measurement.local.local_columns import calibrate_set
from tracker.measurement.random_effects import RandomEffects, fit_random_effects

Floats = NDArray[np.float64]
RESTITUTION = "r_local", "r_local_std", "v0_local", "b_local"
PLAIN_DISCS_G = {5.9, 14.6, 27.7}  # of 50 mm: they hit each other in series 6, and the springs in series 7
VELOCITIES = [f"v{ball}{when}{axis}" for ball in (1, 2) for when in "io" for axis in "xy"]


@dataclass(frozen=True)
class MeasuredHits:
    """The hits of one laboratory, their local estimates with the errors of their set, and where they are from."""

    clone: Path
    hits: Sequence[RecordedHit]
    rows: Sequence[dict[str, Any]]

    @property
    def known(self) -> list[dict[str, Any]]:
        """The rows with an r and its error."""
        return [row for row in self.rows if np.isfinite(row["r_local_std"])]


@dataclass(frozen=True)
class Exam:
    """A line of the table."""

    laboratory: str
    exam: str
    expected: str
    found: str


def fit_restitution(rows: Sequence[dict[str, Any]], speed_powers: Sequence[int]) -> RandomEffects:
    """Fit r over hits as a polynomial of the normal speed, m/s, with the errors that all hits share."""
    r, std, v0, b = (
        np.array([row[name] for row in rows]) for name in ("r_local", "r_local_std", "v0_local", "b_local")
    )
    table = pd.DataFrame({"local_shared": [row["local_shared"] for row in rows], "fit": "local"})
    effects = shared_effects(table, ("r",))
    speed = v0 * np.sqrt(1 - b**2)
    design = np.column_stack([speed**power for power in speed_powers])
    return fit_random_effects(r, remove_shared(std, effects), effects[:, 0], design)


def show(fit: RandomEffects, number: int = 0) -> str:
    """A coefficient with its error."""
    return format_with_error(float(fit.coefficients[number]), float(fit.std[number]))


# --- Laboratories ---


def examine_billiards(given: MeasuredHits) -> Iterator[tuple[str, str, str]]:
    """Iterate over the exams of billiard balls."""
    fit = fit_restitution(given.known, [0])
    yield "r", "0.973(20)", show(fit)
    yield "scatter of r", "0.06", f"{fit.scatter:.3f}"
    yield "momentum along n over v_n", "-2.3 %", f"{100 * summarise(given.rows)['bias']:.1f} %"


def examine_pucks(given: MeasuredHits) -> Iterator[tuple[str, str, str]]:
    """Iterate over the exams of two pucks on air; the scales say 28.19 and 28.73 g, but not which strikes."""
    ratio, std = (np.array([row[name] for row in given.known]) for name in ("mass_ratio", "mass_ratio_std"))
    yield "mass of the struck puck over the other's", "0.983(3), scales 0.981", show(fit_random_effects(ratio, std))
    fit = fit_restitution(given.known, [0, 1])
    yield "r at no speed", "0.815(16)", show(fit)
    yield "slope of r, s/m", "-0.110(27)", show(fit, 1)
    yield "scatter of r about it", "0.04", f"{fit.scatter:.3f}"
    yield "inertia factor", "0.497(5), theory 0.5", show(measure_inertia(given))


def examine_discs(given: MeasuredHits) -> Iterator[tuple[str, str, str]]:
    """Iterate over the exams of discs that were weighed, or taped so that they stick."""
    ratio, std, true = (
        np.array([row[name] for row in given.known]) for name in ("mass_ratio", "mass_ratio_std", "true_ratio")
    )
    off, error = np.log(ratio / true), std / ratio
    yield "mass ratio within 2 % of the scales", f"{len(off)}", f"{np.sum(np.abs(off) < 0.02)}"
    shares = f"{np.sum(np.abs(off) < error)} and {np.sum(np.abs(off) < 1.96 * error)}"
    yield "mass ratio within 1 and 1.96 errors", f"{0.68 * len(off):.0f} and {0.95 * len(off):.0f}", shares
    yield "mean logarithm of the ratio over the scales'", "0", show(fit_random_effects(off, error))
    taped = [row for row in given.rows if str(row["name"]).startswith("S5")]
    apart = [row for row in taped if row["status"] != TOGETHER]
    found = [f"{len(taped) - len(apart)} stay together"]
    found += [f"r = {format_with_error(row['r_local'], row['r_local_std'])}" for row in apart]
    yield "r of discs with tape", f"0 in {len(taped)}", ", ".join(found)
    sprung = [row for row in given.rows if str(row["name"]).startswith("S7")]
    plain = [
        row
        for row, hit in zip(given.rows, given.hits, strict=True)
        if {round(1e3 * mass, 1) for mass in hit.camera["ball_masses"]} <= PLAIN_DISCS_G
    ]
    yield "duration of contacts with springs, ms", "longer than an instant", ", ".join(map(show_duration, sprung))
    yield "duration without springs, ms", "none", ", ".join(map(show_duration, plain))


def show_duration(row: dict[str, Any]) -> str:
    """How long a contact lasts by the local estimate, ms; "none" where the tracks do not show it."""
    found = [1e3 * row[f"contact_duration_local{end}"] for end in ("", "_std")]
    return format_with_error(*found) if np.isfinite(found[0]) else "none"


EXAMS: dict[str, Callable[[MeasuredHits], Iterator[tuple[str, str, str]]]] = {
    "3cushiontool": examine_billiards,
    "TIF083-Expfys1A": examine_pucks,
    "TIF083A": examine_discs,
}


def measure_inertia(given: MeasuredHits) -> RandomEffects:
    """Measure I/(m R^2) of pucks: the change of the tangential velocity over that of R times the spin.

    The impulse at the rims turns both pucks in the same direction, and pushes them in opposite ones.
    """
    angles, changes, errors, rims = read_puck_angles(given.clone), list[float](), list[float](), list[float]()
    for hit, row in zip(given.hits, given.rows, strict=True):
        if not np.isfinite(row["r_local_std"]):
            continue
        v = {name: row[f"{name}_local"] for name in VELOCITIES}
        normal = np.arctan2(v["v2iy"] - v["v1iy"], v["v2ix"] - v["v1ix"]) - np.arcsin(row["b_local"])
        tangent = np.array([-np.sin(normal), np.cos(normal)])
        for ball, sign in ((1, -1), (2, 1)):
            change = tangent @ [v[f"v{ball}o{axis}"] - v[f"v{ball}i{axis}"] for axis in "xy"]
            variance = tangent**2 @ [sum(row[f"v{ball}{when}{axis}_local_std"] ** 2 for when in "io") for axis in "xy"]
            spin = measure_spin_change(angles[hit.name][row[f"particle{ball}"]], row["t_c_local"])
            changes.append(sign * change)
            errors.append(float(np.sqrt(variance)))
            rims.append(hit.camera["ball_diameter"] / 2 * spin)
    return fit_random_effects(np.array(changes), np.array(errors), design=np.array(rims)[:, None])


def measure_spin_change(angle: Floats, contact_s: float, window_s: float = 0.1, apart_s: float = 0.006) -> float:
    """Measure the change of the spin at a contact, rad/s, by straight lines on either side of it."""
    since = np.arange(len(angle)) / PUCK_HZ - contact_s
    spins = []
    for side in (-1, 1):
        rows = (side * since > apart_s) & (side * since < window_s) & np.isfinite(angle)
        spins.append(float(np.polyfit(since[rows], angle[rows], 1)[0]))
    return spins[1] - spins[0]


def examine(clone: Path) -> list[Exam]:
    """Measure the hits of a clone, and compare them with what is known."""
    name = find_laboratory(clone)
    support, read = READERS[name]
    hits = read(clone)
    given = MeasuredHits(clone, hits, calibrate_set([measure_hit(hit, support) for hit in hits]))
    seen, summary = len(given.known), summarise(given.rows)
    out = [Exam(name, *line) for line in EXAMS[name](given)]
    return [*out, Exam(name, "hits with an error of r under 0.05", "", f"{summary['r_under_0.05']} of {seen}")]


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_clones(parser)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/exams.json"))
    given = parser.parse_args()
    if not given.clones:
        raise SystemExit(f"expected paths to clones of {', '.join(READERS)}")
    lines = [line for clone in given.clones for line in examine(clone)]
    for line in lines:
        print(f"{line.laboratory:16} | {line.exam:44} | {line.expected:22} | {line.found}", flush=True)
    save(given.output, {"exams": [asdict(line) for line in lines]})


if __name__ == "__main__":
    main()
