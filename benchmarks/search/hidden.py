"""Each effect of the library hidden alone: is it named, is the gap closed, is the strength right?

    hidden.py [--effects hop,stribeck] [--clips 30] [--times 1.0] [-o out/hidden.json]
    hidden.py --video              from rendered film through the tracker, a list of ten and the paper's own

Without --video the tracks are those of `synthcam generate --no-video` with noise, measured by the tracker's own fits.
"none": nothing is hidden. "paper": the model lacks sliding friction and spin transfer, as a textbook collision does.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from rich.console import Console
from rich.table import Table

from synthcam.effect import Effect
from synthcam.library import library
from synthcam.model import Model

ROOT = Path(__file__).resolve().parents[2]
NOISE_PX = 0.009
SCENE, MODEL = "scenes/oblique.yaml", "scenes/painter_behringer.yaml"
VIDEO = (
    "none hop plate_tilt velocity_restitution stribeck air_drag rolling_quadratic lens_distortion clock_drift "
    "mass_mismatch paper"
).split()
LACKED = {"sliding_friction": Model().sliding_friction, "spin_transfer": Model().spin_transfer}


def run(*command: str) -> dict[str, float]:
    """Measure what the command took: processor and wall-clock time, s, and peak memory, MB."""
    program = Path(sys.executable).with_name(command[0])
    alone = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    began = time.monotonic()
    with tempfile.TemporaryFile("w+") as said:
        done = subprocess.Popen([program, *command[1:]], cwd=ROOT, stdout=subprocess.DEVNULL, stderr=said, env=alone)
        _, status, used = os.wait4(done.pid, 0)
        done.returncode = os.waitstatus_to_exitcode(status)
        if done.returncode:
            said.seek(0)
            why = said.read().strip().rpartition("\n")[2]
            raise RuntimeError(why or f"{command[0]} ended with {done.returncode}")
    most = used.ru_maxrss / (1024 if sys.platform == "linux" else 1024**2)
    took = {"cpu": used.ru_utime + used.ru_stime, "seconds": time.monotonic() - began, "MB": most}
    return {key: round(value, 1) for key, value in took.items()}


def hidden_in(name: str, times: float) -> dict[str, float]:
    """The strengths that are hidden, by dotted name."""
    if name == "none":
        return {}
    if name == "paper":
        return LACKED
    effect: type[Effect] = library()[name]
    return {f"{name}.{p.name}": min(times * p.typical, p.high) for p in effect.strengths()}


def noisy_tracks(folder: Path, clips: int, seed: int) -> Path:
    """One table of all clips' true centres with noise, as another program would hand in."""
    rng = np.random.default_rng(seed)
    truth, tables = pd.read_parquet(folder / "truth/clips.parquet"), []
    for number in range(clips):
        table = pd.read_parquet(folder / f"clips/{number:06d}/truth/tracks.parquet").query("visible")
        noisy = table[["x_mean_px", "y_mean_px"]].to_numpy() + NOISE_PX * rng.standard_normal((len(table), 2))
        columns = {"clip": number, "frame": table["frame"], "particle": table["particle"]}
        columns |= {"x": noisy[:, 0], "y": noisy[:, 1], "x_std": NOISE_PX, "y_std": NOISE_PX, "cov_xy": 0.0}
        tables.append(pd.DataFrame(columns | {"striker": truth["striker"][number]}))
    path = folder / "tracks.parquet"
    pd.concat(tables).to_parquet(path)
    return path


def results(folder: Path, words: list[str], options: argparse.Namespace) -> Path:
    """RESULTS of the tracker, on a film or on tracks."""
    film, measured = folder / "film", folder / "measured"
    size = ("--clips", str(options.clips), "--seed", str(options.seed))
    if options.video:
        run("synthcam", "generate", SCENE, "-o", str(film), *size, "--withhold-truth", str(folder / "truth"), *words)
        run("tracker", "track", str(film), "-o", str(measured))
        return measured
    run("synthcam", "generate", SCENE, "-o", str(film), *size, "--no-video", *words)
    tracks = noisy_tracks(film, options.clips, options.seed)
    run("tracker", "measure", str(tracks), "--camera", str(film / "clips/000000/camera.json"), "-o", str(measured))
    return measured


def trial(name: str, options: argparse.Namespace) -> dict[str, Any]:
    """One search, `name` hidden."""
    hidden = hidden_in(name, options.times)
    words = [w for k, v in hidden.items() if "." in k for w in ("--set", f"effects.{k}={v:.9e}")]
    with tempfile.TemporaryDirectory(prefix="hidden-") as temporary:
        folder, model = Path(temporary), MODEL
        if name == "paper":
            model = str(folder / "textbook.yaml")
            Path(model).write_text(yaml.safe_dump({"model": dict.fromkeys(LACKED, 0.0)}))
        measured = results(folder, words, options)
        took = run("discrepancy", "find", str(measured), "--model", model, "-o", str(folder / "search"))
        found = json.loads((folder / "search/discrepancy.json").read_text())
    aliases: list[list[str]] = found["aliases"]
    claimed = {n["effect"]: next((a for a in aliases if n["effect"] in a), []) for n in found["named"]}
    wanted = list(LACKED) if name == "paper" else [name] * (name != "none")
    classes = all(any(w in {n, *a} for n, a in claimed.items()) for w in wanted) and len(claimed) == len(wanted)
    gap = found["gap"]
    return {
        "hidden": name,
        "verdict": found["verdict"],
        "named": list(claimed),
        "right": "name" if sorted(claimed) == sorted(wanted) else "class" if classes else "no",
        "aliases": found["aliases"],
        "sigma": found["ranking"][0]["sigma"] if found["ranking"] else None,
        "closure": gap["closure"],
        "after over floor": gap["after"] / gap["floor"],
        "z": z_of(found["named"], hidden),
    } | took


def z_of(named: list[dict[str, Any]], hidden: dict[str, float]) -> dict[str, float]:
    """The error of each hidden strength over its claimed standard deviation."""
    out = {}
    for n in named:
        for key, value in n["parameters"].items():
            std = (n["std"] or {}).get(key)
            if key in hidden and std:
                out[key] = round((value - hidden[key]) / std, 2)
    return out


def row(r: dict[str, Any]) -> list[str]:
    """A line of the table."""

    def number(key: str) -> str:
        value = r.get(key)
        return "-" if value is None or not math.isfinite(value) else f"{value:.4f}"

    z = ", ".join(f"{k.rpartition('.')[2]} {v:+.1f}" for k, v in r.get("z", {}).items())
    classes = "; ".join(" / ".join(a) for a in r.get("aliases", []))
    named = ", ".join(r.get("named", []))
    front = [r["hidden"], r["verdict"], named, str(r.get("right", "no")), classes]
    took = [str(r.get(key, "")) for key in ("cpu", "seconds", "MB")]
    return [*front, number("closure"), number("after over floor"), z, *took]


def main() -> None:
    parser = argparse.ArgumentParser(description="Each effect hidden alone.")
    searched = [n for n, e in library().items() if "measure" not in e.laws and n != "clock_error"]
    parser.add_argument("--video", action="store_true", help="film, track, search")
    parser.add_argument("--effects", help="separated by commas; default all, with --video a list of ten")
    parser.add_argument("--clips", type=int, default=30)
    parser.add_argument("--times", type=float, default=1.0, help="of the realistic size")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", "--output", type=Path, help="default out/hidden.json, out/hidden_video.json")
    options = parser.parse_args()
    output = options.output or ROOT / "out" / ("hidden_video.json" if options.video else "hidden.json")
    output.parent.mkdir(parents=True, exist_ok=True)
    names = options.effects.split(",") if options.effects else VIDEO if options.video else ["none", *searched]
    done = []
    for name in names:
        try:
            done.append(trial(name, options))
        except RuntimeError as e:
            done.append({"hidden": name, "verdict": f"failed: {e}"})
        print(json.dumps(done[-1]), flush=True)
        output.write_text(json.dumps(done, indent=1) + "\n")
    table = Table("hidden", "verdict", "named", "right", "class", "gap closed", "after/floor", "z", "CPU s", "s", "MB")
    for r in done:
        table.add_row(*row(r))
    Console(width=160).print(table)


if __name__ == "__main__":
    main()
