"""Effect of a wrong camera file on each quantity: the same films, tracked with one wrong value at a time.

    wrong_camera.py [--clips 100] [-o out/wrong_camera]
    wrong_camera.py --scene scenes/other_camera.yaml --faults "diameter +1 %,bare"    only those faults

For each quantity of the tied fit the table gives its mean shift, in percent of the result with the right file. In
brackets is the root mean square of z, which is 1 where the error bars remain correct. b, t_c and the angle may be zero,
so their shifts are in their own units. chi^2 per degree of freedom and the share of measured clips tell whether a clip
reveals the fault. The program prints a table in Markdown and writes it as JSON.
"""

from __future__ import annotations

import argparse
import copy
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.harness import ROOT, run, save

QUANTITIES = "v0 b t_c r s mu_k C tau1 tau2 v1f v2f energy_fraction momentum_fraction final_angle drag decel".split()
ABSOLUTE = {"b": (1e3, "e-3"), "t_c": (1e6, "us"), "final_angle": (1e3, "mrad")}  # times this, unit
Known = dict[str, Any]


def scaled(known: Known) -> None:
    known["scale"] *= 1.01
    for row in (0, 1):
        known["K"][row][row] /= 1.01


def moved(axis: int) -> Callable[[Known], None]:
    def fault(known: Known) -> None:
        known["lamp"]["position"][axis] += 0.02

    return fault


def blurred(factor: float) -> Callable[[Known], None]:
    def fault(known: Known) -> None:
        known["psf"]["sigma_px"] *= factor

    return fault


def without_psf(known: Known) -> None:
    del known["psf"]


def gained(factor: float) -> Callable[[Known], None]:
    def fault(known: Known) -> None:
        known["sensor"]["gain"] *= factor

    return fault


def widened(known: Known) -> None:
    known["ball_diameter"] *= 1.01


def bare(known: Known) -> None:
    """Keep only the keys that a collision needs."""
    for key in set(known) - {"size", "fps", "exposure", "scale", "ball_diameter", "striker"}:
        del known[key]


FAULTS: dict[str, Callable[[Known], None]] = {
    "right": lambda known: None,
    "scale +1 %": scaled,
    "lamp 2 cm aside": moved(0),
    "lamp 2 cm up": moved(2),
    "PSF +30 %": blurred(1.3),
    "PSF -30 %": blurred(0.7),
    "no PSF": without_psf,
    "gain +30 %": gained(1.3),
    "gain -30 %": gained(0.7),
    "diameter +1 %": widened,
    "bare": bare,
}


def tracked(film: Path, folder: Path, name: str, known: Known) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Estimates and tracks of the film by one camera file."""
    slug = "_".join(name.replace("+", "plus_").replace("-", "minus_").replace("%", "percent").split())
    camera, out = folder / f"{slug}.json", folder / slug
    camera.write_text(json.dumps(known))
    shutil.rmtree(out, ignore_errors=True)  # another version of the tracker may have made it
    run("tracker", "track", str(film), "--camera", str(camera), "-o", str(out))
    paths = sorted(out.glob("clips/*/tracks.parquet"))
    tracks = pd.concat(pd.read_parquet(p).assign(clip=int(p.parent.name)) for p in paths)
    return pd.read_parquet(out / "estimates.parquet"), tracks


def figures(found: pd.DataFrame, right: pd.DataFrame, truth: pd.DataFrame) -> dict[str, Any]:
    """Shift against the right file and sd of z per quantity; chi^2 per degree of freedom; share of clips measured."""
    table = truth.merge(found.drop_duplicates("clip"), on="clip", how="left", suffixes=("_true", ""))
    best = truth[["clip"]].merge(right.drop_duplicates("clip"), on="clip", how="left")
    out: dict[str, Any] = {}
    for name in QUANTITIES:
        shift = table[name] - best[name]
        if name in ABSOLUTE:
            change = float(shift.mean()) * ABSOLUTE[name][0]
        else:
            change = 100 * float(shift.mean() / best[name].mean())
        z = (table[name] - table[f"{name}_true"]) / table[f"{name}_std"]
        out[name] = {"shift": change, "z_mean": float(z.mean()), "z_std": float(np.sqrt((z**2).mean()))}
    out["chi2"] = float((table["chi2"] / table["dof"]).median())
    out["measured"] = float((table["status"] == "ok").mean())
    return out


def positions(tracks: pd.DataFrame, right: pd.DataFrame) -> dict[str, float]:
    """How far the places move, px, root mean square, and what errors are claimed for them."""
    both = tracks.merge(right, on=["clip", "frame", "particle"], suffixes=("", "_right"))
    off = both[["x", "y"]].to_numpy() - both[["x_right", "y_right"]].to_numpy()
    return {"moved_px": float(np.sqrt((off**2).mean())), "x_std": float(tracks["x_std"].median())}


def markdown(rows: dict[str, dict[str, Any]]) -> str:
    names = list(rows)
    lines = ["| | " + " | ".join(names) + " |", "|---" * (len(names) + 1) + "|"]
    for name in QUANTITIES:
        unit = ABSOLUTE[name][1] if name in ABSOLUTE else "%"
        cells = [f"{rows[n][name]['shift']:+.2g} ({rows[n][name]['z_std']:.2g})" for n in names]
        lines.append(f"| {name}, {unit} | " + " | ".join(cells) + " |")
    for key, what in (("chi2", "chi^2 / dof"), ("measured", "clips measured"), ("moved_px", "positions moved, px")):
        lines.append(f"| {what} | " + " | ".join(f"{rows[n][key]:.3g}" for n in names) + " |")
    lines.append("| error claimed, px | " + " | ".join(f"{rows[n]['x_std']:.2g}" for n in names) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description="The effect of a wrong camera file on each quantity.")
    parser.add_argument("--clips", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--scene", default="scenes/benchmark.yaml")
    parser.add_argument("--faults", default=",".join(FAULTS), help="names of faults, with commas between them")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "wrong_camera")
    options = parser.parse_args()
    film = options.output / "film"
    size = ("--clips", str(options.clips), "--seed", str(options.seed))
    run("synthcam", "generate", options.scene, "-o", str(film), *size)
    truth = pd.read_parquet(film / "truth" / "clips.parquet").drop(columns="striker")
    known = json.loads((film / "clips" / "000000" / "camera.json").read_text())
    rows: dict[str, dict[str, Any]] = {}
    reference: tuple[pd.DataFrame, pd.DataFrame] | None = None
    for name, fault in FAULTS.items():
        if name not in ["right", *options.faults.split(",")]:
            continue
        wrong = copy.deepcopy(known)
        fault(wrong)
        found, tracks = tracked(film, options.output, name, wrong)
        reference = reference or (found, tracks)
        rows[name] = figures(found, reference[0], truth) | positions(tracks, reference[1])
    print(markdown(rows))
    save(options.output / "wrong_camera.json", rows)


if __name__ == "__main__":
    main()
