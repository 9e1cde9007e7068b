"""Local estimates of the hits of other laboratories: yield, and the balance of momentum on hits kept out.

python -m benchmarks.real.hits CLONE [CLONE ...] [--tied] [--warp] [-o out/real_hits.json]
make bench-hits CLONES="CLONE ..."

Each CLONE is a clone of one of the repositories that `recordings` reads; its folder's name must contain that of the
repository. The table gives for each laboratory:

- hits, those whose bodies stay together (r is 0), and those with a local r, and with an error below .05;
- the median of r, with the median of its errors, and the scatter from hit to hit;
- the share of hits whose balance of momentum is within 1 and 1.96 errors, along and across the line of centres. Errors
  are by the prior of one recording, fitted to all hits, or fitted to the other half of the hits, over eight random
  splits.

With --tied the tied and free fits are made too, some five seconds a hit, and the recommendations are counted. With
--warp each eighth of the hits is corrected by the camera's map that the free motion in all others shows. The balance of
momentum has no part in that map, so it tests the correction.
"""

from __future__ import annotations

import argparse
import os
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from tracker.tables.table_options import TableOptions

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

import tracker
from benchmarks.harness import add_clones, save
from benchmarks.real.recordings import RecordedHit, read_balls, read_billiards, read_discs, read_pucks
from synthcam_shared.errors import InputError
from tracker.calibration.camera_warp import VALIDATION_FOLDS, fit_camera_warp
from tracker.calibration.free_stretches import find_free_stretches
from tracker.camera.camera import Camera
from tracker.measurement.collision.adequacy import TOGETHER
from tracker.measurement.collision.contacts import find_contacts, prepare_contact
from tracker.measurement.collision.staying_together import find_staying_pairs
from tracker.measurement.local.local_columns import apply_errors, calibrate_rows, calibrate_set, make_local_columns
from tracker.measurement.local.local_estimate import estimate_locally
from tracker.measurement.local.recommendation import recommend
from tracker.measurement.positions import to_ball_tracks
from tracker.settings import FitSettings
from tracker.tables.read import read_frame

READERS: dict[str, tuple[str, Callable[[Path], list[RecordedHit]]]] = {
    "3cushiontool": ("cloth", read_billiards),
    "TIF083-Expfys1A": ("air", read_pucks),
    "TIF083A": ("air", read_discs),
}


def find_laboratory(clone: Path) -> str:
    """Find the name in `READERS` of a clone, by its path; ends the benchmark if it has none."""
    name = next((name for name in READERS if name in str(clone)), None)
    if name is None:
        raise SystemExit(f"{clone}: expected a clone of {', '.join(READERS)}")
    return name


def measure_hit(hit: RecordedHit, support: str, tied: bool = False) -> dict[str, Any]:
    """Measure one hit: the columns of its local estimate, and with `tied` the row of its first collision."""
    keys = hit.camera | ({"support": support} if support else {})
    masses = keys.get("ball_masses", [1.0, 1.0])
    if tied:
        return {"name": hit.name} | dict(tracker.measure(hit.tracks, keys, unit="m").rows[0])
    given = read_frame(hit.tracks, keys, TableOptions(unit="m"))
    ((tracks, _),) = given.clips.values()
    camera = Camera.of(keys)
    balls = to_ball_tracks(tracks, camera)
    if any(not stay.bounces for stay in find_staying_pairs(balls[0], balls[1], camera.ball_diameter)):
        return {"name": hit.name, "status": TOGETHER} | make_local_columns("the bodies stay together")
    found = find_contacts(balls, camera.ball_diameter) or find_contacts(balls, 1.5 * camera.ball_diameter, 2.0)
    empty = {"name": hit.name, "status": "misfit"}
    if not found:
        return empty | make_local_columns("no contact")
    contact = prepare_contact(found[0], camera.ball_diameter, {}, FitSettings())
    if contact.reason:
        return empty | make_local_columns(contact.reason)
    particles = contact.pair.struck.particle, contact.pair.striker.particle
    one, two = (masses[k] for k in particles)
    local = estimate_locally(contact, camera, (one, two))
    row = empty | {"particle1": particles[0], "particle2": particles[1], "true_ratio": one / two}
    return row | make_local_columns(local, "ball_masses" in keys)


def summarise(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Summarise the rows of one laboratory."""
    known = [row for row in rows if np.isfinite(row["r_local"])]
    if not known:
        return {"hits": len(rows), "known": 0}
    r, std = (np.array([row[name] for row in known]) for name in ("r_local", "r_local_std"))
    out: dict[str, Any] = {"hits": len(rows), "together": sum(row["status"] == TOGETHER for row in rows)}
    out |= {"known": len(known), "r_under_0.05": int((std < 0.05).sum())}
    out |= {"r": round(float(np.median(r)), 4), "r_std": round(float(np.median(std)), 4)}
    out["r_scatter"] = round(float(1.48 * np.median(np.abs(r - np.median(r)))), 4)
    for axis in "nt":
        z = np.array([abs(row[f"balance_{axis}_local"] / row[f"balance_{axis}_local_std"]) for row in known])
        out[f"balance_{axis}"] = [round(float(np.mean(z < limit)), 2) for limit in (1.0, 1.96)]
    names = ("bias", "factor", "error_n", "error_t")
    return out | {name: round(float(np.mean([row[f"local_{name}"] for row in known])), 4) for name in names}


def keep_halves_out(rows: Sequence[dict[str, Any]], splits: int = 8, seed: int = 0) -> dict[str, Any]:
    """Give the hits of each half the errors that the other half shows; the summary is the mean over random splits."""
    rng, summaries = np.random.default_rng(seed), []
    for _ in range(splits):
        order, out = rng.permutation(len(rows)), list[dict[str, Any]]()
        for half in (0, 1):
            errors = calibrate_rows([rows[k] for k in order[1 - half :: 2]])
            kept = (rows[k] for k in order[half::2])
            out += [row | (apply_errors(row, errors) if errors is not None else {}) for row in kept]
        summaries.append(summarise(out))
    means = {key: np.mean([one[key] for one in summaries if key in one], axis=0) for key in summaries[0]}
    return {key: np.round(mean, 4).tolist() for key, mean in means.items()} | {"splits": splits}


def correct_map(hits: Sequence[RecordedHit]) -> list[RecordedHit]:
    """Correct each eighth of the hits by the warp that the free stretches of all others show, if they show one."""
    cameras = [Camera.of(hit.camera) for hit in hits]
    read = [read_balls(hit, camera) for hit, camera in zip(hits, cameras, strict=True)]
    stretches = [find_free_stretches(balls, c.ball_diameter) for balls, c in zip(read, cameras, strict=True)]
    corrected = list(hits)
    for fold in range(VALIDATION_FOLDS):
        others = [one for k, one in enumerate(stretches) if k % VALIDATION_FOLDS != fold]
        try:
            found = fit_camera_warp(cameras[0], others)
        except InputError as error:
            print(error, flush=True)
            continue
        print(*found.summary(), sep="\n", flush=True)
        warp = {"warp": found.to_dict()["warp"]}
        corrected[fold::VALIDATION_FOLDS] = [
            replace(hit, camera=hit.camera | warp) for hit in hits[fold::VALIDATION_FOLDS]
        ]
    return corrected


def run(clones: Sequence[Path], tied: bool, warp: bool = False) -> dict[str, Any]:
    """Measure the hits of all clones."""
    out: dict[str, Any] = {}
    for clone in clones:
        name = find_laboratory(clone)
        support, read = READERS[name]
        hits = correct_map(read(clone)) if warp else read(clone)
        rows = [measure_hit(hit, support, tied) for hit in hits]
        fitted = calibrate_set(rows)
        out[name] = {"prior": summarise(rows), "set": summarise(fitted), "held out": keep_halves_out(rows)}
        if tied:
            out[name]["recommended"] = dict(Counter(row["recommended"] for row in fitted))
        else:
            used = Counter(recommend(row)["recommended"] for row in fitted)
            out[name]["usable"] = used["local"]
        ratios = [
            (row["name"], row["true_ratio"], row["mass_ratio"], row["mass_ratio_std"])
            for row in fitted
            if "true_ratio" in row
        ]
        out[name]["mass ratios"] = [list(line) for line in ratios if line[1] != 1]
        for kind, summary in out[name].items():
            if kind != "mass ratios":
                print(f"{name:18}{kind:12}{summary}", flush=True)
    return out


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_clones(parser)
    parser.add_argument("--tied", action="store_true")
    parser.add_argument("--warp", action="store_true")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/real_hits.json"))
    given = parser.parse_args()
    if not given.clones:
        raise SystemExit(f"expected paths to clones of {', '.join(READERS)}")
    save(given.output, run(given.clones, given.tied, given.warp))


if __name__ == "__main__":
    main()
