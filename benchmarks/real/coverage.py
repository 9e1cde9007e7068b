"""Coverage of the local estimate on simulated billiard hits with all that the real ones show.

python -m benchmarks.real.coverage CLONE [--draws 4] [--seed 1] [-o out/real_coverage.json]

CLONE is a clone of github.com/erdo100/3cushiontool. Each of its hits is simulated with its own launch, impact parameter
and frames (`benchmarks.real.simulated_hits`). Balls rub by Coulomb friction, the striker has an unseen side spin, and
both balls may hop. Restitution scatters from hit to hit, the friction of the cloth and the loss from stretch to
stretch. Positions beside the contact have larger errors, and the map of the camera is bent.

For each quantity the table gives the number with an error, the rms of z = error / standard error, and the shares within
1 and 1.96 errors: as if each hit were the only recording, and with the errors that the balances of its set show.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from benchmarks.harness import save
from benchmarks.real.contact_power import TRUTHS, measure_set
from benchmarks.real.hits import measure_hit
from benchmarks.real.recordings import read_billiards
from benchmarks.real.simulated_hits import draw_hits, read_design
from benchmarks.tracker.local_estimates import cover, show_cover
from tracker.measurement.local.local_columns import calibrate_set

LAWS = ("Coulomb", "Coulomb, hop")


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clone", type=Path)
    parser.add_argument("--draws", type=int, default=4, help="sets of each law")
    parser.add_argument("--seed", type=int, default=1, help="of the first set")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/real_coverage.json"))
    given = parser.parse_args()
    hits = read_billiards(given.clone)
    rows, _ = measure_set(hits)
    designs = [read_design(hit, row) for hit, row in zip(hits, rows, strict=True) if np.isfinite(row["b_local"])]
    out: dict[str, Any] = {}
    for law in LAWS:
        alone, of_sets = list[dict[str, Any]](), list[dict[str, Any]]()
        for draw in range(given.seed, given.seed + given.draws):
            measured = [
                measure_hit(one.hit, "cloth") | {f"{name}_true": value for name, value in one.find_truth().items()}
                for one in draw_hits(designs, TRUTHS[law], draw)
            ]
            alone += measured
            of_sets += calibrate_set(measured)
            print(f"{law}, set {draw}: measured", flush=True)
        out[law] = {"alone": cover(alone), "sets": cover(of_sets)}
        for kind, table in out[law].items():
            show_cover(f"{law}, {kind}", table)
    save(given.output, out)


if __name__ == "__main__":
    main()
