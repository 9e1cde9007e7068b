"""Each effect of the library hidden alone, at a realistic size, in measured tracks: what does the search say?

Tracks are those of `synthcam generate --no-video` with noise, measured by the tracker's own fits.

    benchmarks/hidden.py [--effects hop,stribeck] [--clips 20] [--times 1.0] [-o out/hidden.json]
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console
from rich.table import Table

from synthcam.effect import Effect, library

ROOT = Path(__file__).resolve().parent.parent
NOISE_PX = 0.009
MODEL = "scenes/painter_behringer.yaml"


def run(*command: str) -> str:
    program = Path(sys.executable).with_name(command[0])
    done = subprocess.run([program, *command[1:]], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(done.stderr.strip() or f"{command[0]} ended with status {done.returncode}")
    return done.stdout


def settings(effect: type[Effect], times: float) -> list[str]:
    """--set words for every strength at `times` its realistic size."""
    words = []
    for p in effect.strengths():
        words += ["--set", f"effects.{effect.name()}.{p.name}={min(times * p.scale, p.high):.9e}"]
    return words


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


def trial(name: str, clips: int, times: float, seed: int) -> dict[str, object]:
    """One search, `name` hidden ("none": nothing)."""
    with tempfile.TemporaryDirectory(prefix="hidden-") as temporary:
        folder = Path(temporary)
        words = [] if name == "none" else settings(library()[name], times)
        film, seeds = str(folder / "film"), ("--clips", str(clips), "--seed", str(seed))
        run("synthcam", "generate", "scenes/oblique.yaml", "-o", film, *seeds, "--no-video", *words)
        tracks = noisy_tracks(folder / "film", clips, seed)
        camera = str(folder / "film/clips/000000/camera.json")
        run("tracker", "measure", str(tracks), "--camera", camera, "-o", str(folder / "measured"))
        started = time.monotonic()
        run("discrepancy", "find", str(folder / "measured"), "--model", MODEL, "-o", str(folder / "search"))
        seconds = time.monotonic() - started
        found = json.loads((folder / "search/discrepancy.json").read_text())
    return {
        "hidden": name,
        "verdict": found["verdict"],
        "named": [n["effect"] for n in found["named"]],
        "aliases": found["aliases"],
        "sigma": found["ranking"][0]["sigma"],
        "closure": found["gap"]["closure"],
        "after": found["gap"]["after"],
        "seconds": round(seconds, 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description="Each effect hidden alone.")
    searched = [n for n, e in library().items() if "measure" not in e.laws and n != "clock_error"]
    parser.add_argument("--effects", default=",".join(["none", *searched]))
    parser.add_argument("--clips", type=int, default=20)
    parser.add_argument("--times", type=float, default=1.0, help="of the realistic size")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "hidden.json")
    options = parser.parse_args()
    options.output.parent.mkdir(parents=True, exist_ok=True)
    results = []
    for name in options.effects.split(","):
        try:
            results.append(trial(name, options.clips, options.times, options.seed))
        except RuntimeError as e:
            results.append({"hidden": name, "verdict": f"failed: {e}", "named": [], "aliases": []})
        print(json.dumps(results[-1]), flush=True)
        options.output.write_text(json.dumps(results, indent=1) + "\n")
    table = Table("hidden", "verdict", "named", "alias classes", "gap closed", "s")
    for r in results:
        closure = r.get("closure")
        closed = "-" if closure is None else f"{closure:.4f}"
        table.add_row(
            str(r["hidden"]),
            str(r["verdict"]),
            ", ".join(r["named"]),
            str(r["aliases"] or ""),
            closed,
            str(r.get("seconds")),  # type: ignore[arg-type]
        )
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
