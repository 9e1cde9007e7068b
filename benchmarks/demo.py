"""Demo of the public commands: film, track and score the collision of the paper; then search for a hidden tilt."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.harness import ROOT, run

DEMO = ROOT / "demo"
SCENE = "scenes/painter_behringer.yaml"
SHOWN = "v0 b r s mu_k C tau1 tau2 v1f v2f energy_fraction momentum_fraction".split()
TILT = ("effects.plate_tilt.x=1.0e-3", "effects.plate_tilt.y=-0.5e-3")


def quantities(score: Path) -> Table:
    """Bias, rmse and z of the tied fit's quantities."""
    detectors = json.loads(score.read_text())["detectors"]
    rows = next(iter(detectors.values()))["quantities"]
    table = Table("quantity", "clips", "bias", "rmse", "z mean", "z sd", title="Tied fit against the truth (SI)")
    for column in table.columns[1:]:
        column.justify = "right"
    for name in SHOWN:
        q = rows[name]
        numbers = [f"{q[k]:.2g}" if q[k] is not None else "-" for k in ("bias", "rmse", "z_mean", "z_std")]
        table.add_row(name, str(q["n"]), *numbers)
    return table


def main() -> None:
    shutil.rmtree(DEMO, ignore_errors=True)
    DEMO.mkdir()
    run("synthcam", "preview", SCENE, "-o", "demo/frame.png", quiet=True)
    run("synthcam", "generate", SCENE, "-o", "demo/paper", "--clips", "12", quiet=True)
    run("tracker", "track", "demo/paper", "-o", "demo/tracked", quiet=True)
    run("tracker", "score", "demo/tracked", "--truth", "demo/paper", "-o", "demo/score", quiet=True)
    tilted = [x for value in TILT for x in ("--set", value)]
    run("synthcam", "generate", SCENE, "-o", "demo/hidden", "--clips", "12", "--seed", "1", *tilted, quiet=True)
    run("tracker", "track", "demo/hidden", "-o", "demo/hidden_tracked", quiet=True)
    said = run("discrepancy", "find", "demo/hidden_tracked", "--model", SCENE, "-o", "demo/search", quiet=True)
    console = Console(width=100)
    console.print(quantities(DEMO / "score" / "score.json"))
    console.print(said.splitlines()[0], style="bold", highlight=False)
    for name in ("frame.png", "score/index.html", "search/index.html"):
        console.print(DEMO / name, highlight=False)
    console.print("The result over its films: .venv/bin/tracker open demo/hidden_tracked", highlight=False)


if __name__ == "__main__":
    main()
