"""The gap of real billiard hits by model: how chi^2 per degree of freedom falls as a model of the hits grows.

python -m benchmarks.real.hit_gap CLONE [-o out/hit_gap.json]
make bench-hit-gap CLONES=CLONE

CLONE is a clone of github.com/erdo100/3cushiontool. Each line is a model that adds one cause to an earlier one. Causes
are the motion of the striker, noise, a warp of the camera's map, laws of the impact, and scatters from hit to hit. A
line has the median of chi^2 per degree of freedom of a hit, and the share of hits under 2. Both are given for hits that
were fitted, and for hits kept out.

- An eighth of the hits is kept out in turn. The numbers that all hits share, the scatters, the noise beside the contact
  and the map come from the others. Launches and random effects are those of the hit itself.
- Positions have errors of 0.3 mm. From the line "noise beside the contact" on, those within 1.5 frames of it have the
  error that fits without a law of the impact show.
- `gain` compares a line with the one that it adds to, on hits kept out. It is twice the change of the log density,
  summed over hits. The errors of each hit have an unknown factor. `sigma` is the gain over its standard error, which
  the scatter of the gain from hit to hit shows.

`hit_models` has the laws, `hit_fits` the fits.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from benchmarks.harness import ROOT, add_clones, save
from benchmarks.real.hit_fits import (
    HitFit,
    HitModel,
    fit_model,
    guess_numbers,
    make_errors,
    measure_near_noise,
    roll_throughout,
)
from benchmarks.real.hit_models import OWN, SHARED, Common, HitLaws, HitPositions
from benchmarks.real.hits import correct_map
from benchmarks.real.recordings import RecordedHit, read_billiards
from synthcam_shared.arrays import Array, Flags, Ints
from tracker.calibration.camera_warp import VALIDATION_FOLDS

NEAR_FRAMES = 1.5
SCATTER_TURNS = 30  # of fits that have scatters
START = dict.fromkeys(SHARED, 0.0) | {"cloth": 0.2, "loss": 0.04, "drag": 0.01, "r": 0.96, "friction": 0.08}
STARTING_SCATTERS = {"spin": 0.5, "r": 0.05, "friction": 0.03, "turn": 0.01, "distance": 1e-3, "cloth": 0.04}
STARTING_SCATTERS |= {"kick": 0.01}


@dataclass(frozen=True)
class Line:
    """A line of the table. independent_median: of another analysis; adds_to: the line that it is compared with."""

    name: str
    model: HitModel
    adds_to: str = ""
    near: bool = True
    warp: bool = True
    independent_median: float | None = None


def list_lines() -> list[Line]:
    """List the lines: up to the warp, then without and with an unseen spin, and fuller models without a cause."""
    base = ("cloth", "loss", "drag", "r", "friction")
    share = HitModel(HitLaws(coulomb=False), base)
    lines = [
        Line("both balls roll throughout", _change(share, striker="rolls", slides_after=False), "", False, False),
        Line("they slide after the hit", _change(share, striker="rolls"), "", False, False, 299),
        Line("the striker rolls or slides up to the hit", _change(share, striker="state"), "", False, False, 43),
        Line("it slides, then rolls", share, "", False, False, 18),
        Line("noise beside the contact", share, "", True, False, 15),
        Line("warp of the map", share, "", independent_median=11),
        Line("Coulomb friction, no spin", HitModel(HitLaws(), base), ""),
        Line("no spin; changes with ln(slip)", HitModel(HitLaws(), (*base, "fall_per_ln_slip")), ""),
        Line("no spin; hop", HitModel(HitLaws(), (*base, "fall_per_ln_slip", "hop")), ""),
        Line("a share of the slip, unseen spin", replace(share, scatters=("spin",)), "warp of the map"),
        Line("Coulomb friction, unseen spin", HitModel(HitLaws(), base, ("spin",)), independent_median=8.3),
    ]
    for name, shared, scatters, median in [
        ("friction that changes with ln(slip)", ("fall_per_ln_slip",), (), 6.2),
        ("hop", ("hop",), (), 5.3),
        ("r and friction of each hit", (), ("r", "friction"), 3.9),
        ("line of centres and distance of each hit", ("distance",), ("turn", "distance"), 2.8),
        ("friction of the cloth of each stretch", (), ("cloth",), 2.3),
        ("scatter of velocities after the hit", (), ("kick",), 1.6),
    ]:
        model = lines[-1].model
        model = replace(model, shared=(*model.shared, *shared), scatters=(*model.scatters, *scatters))
        lines.append(Line(name, model, independent_median=median))
    scattered, last = lines[-4], lines[-1]
    lines.append(Line("no law of the impact", HitModel(HitLaws(), ("cloth", "loss", "drag"), free=True)))
    for full in (scattered, last):
        for lost, word in (("fall_per_ln_slip", "a change with ln(slip)"), ("hop", "a hop")):
            model = replace(full.model, shared=tuple(name for name in full.model.shared if name != lost))
            end = ", all scatters" if full is last else ", scatter of r and friction"
            lines.append(Line(f"without {word}{end}", model, full.name))
    return [
        replace(one, adds_to=one.adds_to or before.name) for before, one in zip(lines[:1] + lines, lines, strict=False)
    ]


def _change(model: HitModel, **laws: Any) -> HitModel:
    return replace(model, laws=replace(model.laws, **laws))


@dataclass
class HitGap:
    """Fits of all lines to the positions of hits, as recorded and with the corrected map."""

    positions: dict[bool, HitPositions]  # by whether the map is corrected
    folds: Ints
    near_m: dict[bool, list[float]] = field(default_factory=dict)  # of all hits, and of those outside each fold

    @classmethod
    def of(cls, hits: Sequence[RecordedHit], corrected: Sequence[RecordedHit]) -> HitGap:
        """Read positions, find the instants of the contacts and the noise beside them, by fits without a law."""
        out = cls({}, np.arange(len(hits)) % VALIDATION_FOLDS)
        for warp, each in ((False, hits), (True, corrected)):
            whole = HitPositions.of(each)
            out.positions[warp] = whole
            fit = out._fit_free(warp, make_errors(whole), guess_numbers(whole), out.list_counted()[0])
            out.positions[warp] = HitPositions.of(each, whole.contact + fit.own[:, OWN.index("t_c")])
            out._measure_noise(warp)
        return out

    def list_counted(self) -> list[Flags]:
        """The hits that count for the shared numbers: all, and those outside each fold."""
        return [np.ones(len(self.folds), dtype=bool), *(self.folds != k for k in np.unique(self.folds))]

    def find_errors(self, line: Line, part: int) -> Array:
        """Errors of coordinates, m, for the hits of one of `list_counted`."""
        hits = self.positions[line.warp]
        if not line.near:
            return make_errors(hits)
        return make_errors(hits, hits.tell_near(NEAR_FRAMES), self.near_m[line.warp][part])

    def fit(self, line: Line, before: Array | None) -> tuple[HitFit, HitFit]:
        """Fit a line to all hits, and to hits kept out; before: numbers of an earlier line as a start."""
        hits = self.positions[line.warp]
        starts = guess_numbers(hits)
        if line.model.laws.striker == "rolls":
            starts = roll_throughout(starts)
        elif line.model.laws.striker == "state":
            starts = np.concatenate([roll_throughout(starts), starts[:, 1:]], axis=1)
        if before is not None:
            starts = np.concatenate([starts, before[:, None]], axis=1)
        scatters = {name: STARTING_SCATTERS[name] for name in line.model.scatters}
        turns = SCATTER_TURNS if scatters else 15
        fits = list[HitFit]()
        for part, counted in enumerate(self.list_counted()):
            common = fits[0].common if fits else Common(START, scatters)
            starts = fits[0].own[:, None] if fits else starts
            fits.append(fit_model(hits, self.find_errors(line, part), line.model, common, starts, counted, turns=turns))
        own, cost, volume = (
            np.array([getattr(fits[1 + fold], name)[k] for k, fold in enumerate(self.folds)])
            for name in ("own", "cost", "log_volume")
        )
        return fits[0], replace(fits[0], own=own, cost=cost, log_volume=volume)

    def find_density(self, line: Line, held_out: HitFit) -> Array:
        """Log density (n,) of each hit that is kept out."""
        errors = np.array([self.find_errors(line, 1 + fold)[k] for k, fold in enumerate(self.folds)])
        return held_out.log_densities(errors)

    def _fit_free(self, warp: bool, errors: Array, starts: Array, counted: Flags, turns: int = 8) -> HitFit:
        model = HitModel(HitLaws(), ("cloth", "loss", "drag"), free=True)
        return fit_model(self.positions[warp], errors, model, Common(START), starts, counted, turns=turns)

    def _measure_noise(self, warp: bool) -> None:
        """Measure the noise beside the contact, by all hits and by those outside each fold."""
        hits = self.positions[warp]
        near, starts, near_m = hits.tell_near(NEAR_FRAMES), guess_numbers(hits), 1e-3
        self.near_m[warp] = []
        for part, counted in enumerate(self.list_counted()):
            near_m = self.near_m[warp][0] if part else near_m
            for _ in range(3 if part else 8):
                errors = make_errors(hits, near, near_m)
                fit = self._fit_free(warp, errors, starts, counted, turns=2)
                near_m, starts = measure_near_noise(hits, fit, errors, near, counted), fit.own[:, None]
            self.near_m[warp].append(near_m)


def run(hits: Sequence[RecordedHit], corrected: Sequence[RecordedHit], lines: Sequence[Line]) -> dict[str, Any]:
    """Fit all lines, and print each."""
    gap, out = HitGap.of(hits, corrected), dict[str, Any]()
    out["noise beside the contact, mm"] = {
        f"warp {w}": np.round(1e3 * np.array(x), 3).tolist() for w, x in gap.near_m.items()
    }
    print(out, flush=True)
    densities, before = dict[str, Array](), None
    for line in lines:
        fit, held_out = gap.fit(line, before)
        before = fit.own if line.model.laws.striker == "slides, then rolls" and not line.model.free else None
        densities[line.name] = gap.find_density(line, held_out)
        gains = 2 * (densities[line.name] - densities.get(line.adds_to, densities[line.name]))
        error = float(np.std(gains, ddof=1) * np.sqrt(len(gains)))
        out[line.name] = {
            "independent_median": line.independent_median,
            **summarise(fit.ratio),
            "held out": summarise(held_out.ratio),
            "adds to": line.adds_to,
            "gain": float(gains.sum()),
            "sigma": float(gains.sum()) / error if error else 0.0,
            "numbers": {name: fit.common.numbers[name] for name in line.model.shared},
            "scatters": {name: fit.common.scatters[name] for name in line.model.scatters},
            "ratios held out": np.round(held_out.ratio, 3).tolist(),
        }
        print(show_line(line.name, out[line.name]), flush=True)
    return out


def summarise(ratio: Array) -> dict[str, float]:
    """Summarise chi^2 per degree of freedom (n,): its median, and the share under 2."""
    return {"median": float(np.median(ratio)), "under 2": float(np.mean(ratio < 2))}


def show_line(name: str, found: dict[str, Any]) -> str:
    """A line of the table as text."""
    text = f"{name:58}{found['independent_median'] or '-':>6}"
    for one in (found, found["held out"]):
        text += f"{one['median']:8.2f}{100 * one['under 2']:5.0f} %"
    text += f"  gain {found['gain']:7.0f}, {found['sigma']:5.1f} sigma  "
    numbers = found["numbers"] | {f"scatter of {name}": value for name, value in found["scatters"].items()}
    return text + ", ".join(f"{name} {value:.4f}" for name, value in numbers.items())


def main() -> None:
    """Read the hits, correct the map, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_clones(parser)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out/hit_gap.json")
    given = parser.parse_args()
    clone = next((one for one in given.clones if "3cushiontool" in str(one)), None)
    if clone is None:
        raise SystemExit("expected the path to a clone of 3cushiontool")
    hits = read_billiards(clone)
    save(given.output, run(hits, correct_map(hits), list_lines()))


if __name__ == "__main__":
    main()
