"""Trays that steel balls fill more and more: the density at which each tracker loses them.

python -m benchmarks.tracker.dense_trays [--frames 25] [--seed 1] [-o out/dense_trays]    # or make bench-dense-trays

Each film shows 64 balls at 0.15 m/s, on a triangular lattice at first. Equal discs cover 0.907 of a plane at most. All
trackers get the same films, and the scores are those of `tracker score`. The table gives HOTA, and the density at which
HOTA falls below 0.9, by a straight line between two films. Films, results and scores are kept in the output and used
again.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rich.console import Console
from rich.table import Table

from benchmarks.harness import ROOT, run, save

COVERED = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.75, 0.8, 0.82)
BALLS, DIAMETER_M, SPEED_M_S = 64, 2.38e-3, 0.15
MARGIN_PX = 15
SCALE_M_PX = 1e-4
HOTA_LIMIT = 0.9
DETECTORS = {
    "synthcam": "",
    "synthcam+laptrack": "maximum_likelihood+laptrack",
    "trackpy": "trackpy_locate",
    "OpenCV": "opencv_components",
}


def make_scene(covered: float, frames: int) -> dict[str, Any]:
    """A scene whose balls cover a share of a tray. Eight rows of eight fill a tray of its shape best."""
    shape = np.array([8.5, 1 + 7 * math.sqrt(0.75)])
    sides = shape * math.sqrt(BALLS * math.pi / 4 * DIAMETER_M**2 / covered / shape.prod())
    x, y = (sides / 2).tolist()
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    ends = zip(corners, corners[1:] + corners[:1], strict=True)
    inside, pixels = sides - 1.001 * DIAMETER_M, np.ceil(sides / SCALE_M_PX) + 2 * MARGIN_PX
    return {
        "name": f"dense_{100 * covered:.0f}",
        "groups": [
            {"count": BALLS, "arrangement": "lattice", "size": inside.tolist(), "gap": 1e-6, "rms_speed": SPEED_M_S}
        ],
        "walls": [{"start": [*a], "end": [*b], "restitution": 0.8, "friction": 0.2} for a, b in ends],
        "timing": {"frames": frames},
        "camera": {"size": pixels.astype(int).tolist(), "scale": SCALE_M_PX},
    }


def score_film(covered: float, frames: int, seed: int, folder: Path) -> dict[str, dict[str, float]]:
    """Scores of all trackers on one film, by name."""
    scene, film = folder / f"{covered:g}.yaml", folder / f"{covered:g}"
    scene.write_text(yaml.safe_dump(make_scene(covered, frames)))
    if not film.exists():
        run("synthcam", "generate", scene, "-o", film, "--seed", str(seed), "--workers", "1", quiet=True)
    return {name: score_tracker(detector, film, folder / f"{film.name}-{name}") for name, detector in DETECTORS.items()}


def score_tracker(detector: str, film: Path, tracks: Path) -> dict[str, float]:
    """HOTA, and the share of balls that are found, of one tracker; '': the detector that the film decides."""
    scores = tracks.with_name(f"{tracks.name}-score")
    if not scores.exists():
        option = ["--detector", detector] if detector else []
        run("tracker", "track", film, "-o", tracks, *option, "--no-pages", quiet=True, alone=True)
        run("tracker", "score", tracks, "--truth", film, "-o", scores, quiet=True)
    (score,) = json.loads((scores / "score.json").read_text())["detectors"].values()
    found = score["localisation"]["n"] / (score["localisation"]["n"] + score["localisation"]["missed"])
    return {"hota": score["tracking"]["hota"], "found": found}


def find_crossing(covered: list[float], hota: list[float]) -> float | None:
    """The density at which HOTA first falls below its limit; None if it never does, the first density if at once."""
    if hota[0] < HOTA_LIMIT:
        return covered[0]
    for (a, above), (b, below) in itertools.pairwise(zip(covered, hota, strict=True)):
        if below < HOTA_LIMIT:
            return a + (b - a) * (above - HOTA_LIMIT) / (above - below)
    return None


def main() -> None:
    """Make the films, score all trackers, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=25)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out/dense_trays")
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    films = [score_film(covered, given.frames, given.seed, given.output) for covered in COVERED]
    table = Table("tracker", *(f"{100 * covered:.0f} %" for covered in COVERED), f"HOTA under {HOTA_LIMIT} from")
    figures = {}
    for name in DETECTORS:
        hota = [film[name]["hota"] for film in films]
        crossing = find_crossing(list(COVERED), hota)
        figures[name] = {"hota": hota, "found": [film[name]["found"] for film in films], "crossing": crossing}
        table.add_row(
            name, *(f"{value:.3f}" for value in hota), "never" if crossing is None else f"{100 * crossing:.0f} %"
        )
    Console(width=120).print(table)
    save(given.output / "figures.json", {"covered": COVERED} | figures)


if __name__ == "__main__":
    main()
