"""What one film of a crowd shows: a heavier ball, friction between the balls that falls with speed, or a tilted plate.

python -m benchmarks.search.crowd_laws KIND [--films 6] [--first 1] [-o out/crowd_laws.json]
KIND: heavier, equal, falling, coulomb, coulomb_heavier, coulomb_tilted, transfer, tilted, level

No film is rendered. Positions are true ones with 0.05 px noise, at 1,000 frames a second. `heavier`: thirty balls in a
tray for 0.5 s, and the first ball has 1.3 times the mass of the others; `equal`: none has. `falling`: 36 balls for
0.3 s with a friction of 0.03 + 0.4 exp(-u / 0.12 m/s) between them; `coulomb`: it is 0.1; `coulomb_heavier`,
`coulomb_tilted`: and the first ball has 1.3 times the mass, or the plate is tilted by 1 mrad; `transfer`: each contact
stops the same share of the slip.

Each line has the law of the recoil or of the friction that `discrepancy find` names, its sigma and its numbers. The
last line counts the films that are right:

- a heavier ball is named, without a rival;
- friction that falls is named as such, not only as a rival;
- friction that does not fall is not said to fall, not even as a rival.

A line of `falling` also has a bound. It takes the true slips as known, and the claimed errors of the friction. The
bound is by how many sigma the true friction then differs from the best constant one.

`tilted` and `level` search the free stretches of the scene `crowd`, on a plate that is tilted by 1 mrad or not at all.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import discrepancy
import tracker
from benchmarks.harness import ROOT, keep, save
from benchmarks.tracker.crowd_contacts import measure_true_positions, name_balls
from discrepancy.data.contacts import read_contacts
from discrepancy.data.slips import trace_slips
from discrepancy.select.contact_effects import select_contact_laws
from synthcam.scene.clip import Clip
from synthcam.scene.scene import Scene

REACH_S = 0.008  # within which a measured contact is a true one
EXCESS = 0.3  # of the mass of the heavier ball
FALLING = {"mu": 0.03, "rise": 0.4, "fall": 0.12}
COULOMB = {"mu": 0.1}
TILT = 1e-3
OF_FRICTION: dict[str, dict[str, Any]] = {
    "falling": {"ball_friction": FALLING},
    "coulomb": {"ball_friction": COULOMB},
    "coulomb_heavier": {"ball_friction": COULOMB},
    "coulomb_tilted": {"ball_friction": COULOMB, "plate_tilt": {"x": TILT}},
    "transfer": {},
}
KINDS = ("heavier", "equal", *OF_FRICTION, "tilted", "level")


def make_tray(
    excess: float = 0.0, *, balls: int = 30, frames: int = 500, effects: dict[str, Any] | None = None
) -> Scene:
    """Steel balls in a tray of 50 x 36 mm, of which the first has so much more mass than the others."""
    corners = [[-0.025, -0.018], [0.025, -0.018], [0.025, 0.018], [-0.025, 0.018]]
    usual = {"gap": 4e-4, "rms_speed": 0.25}
    mass = (1 + excess) * 7800 * np.pi / 6 * 0.00238**3
    law: dict[str, Any] = {"effects": effects} if effects else {}
    return Scene.build(
        "tray",
        groups=[
            {"count": 1, "size": [0.004, 0.004], "body": {"mass": mass}, **usual},
            {"count": balls - 1, "size": [0.044, 0.03], **usual},
        ],
        walls=[
            {"start": a, "end": b, "restitution": 0.8, "friction": 0.2}
            for a, b in zip(corners, corners[1:] + corners[:1], strict=True)
        ],
        timing={"frames": frames, "fps": 1000},
        **law,
    )


def search_stretches(kind: str, seed: int) -> dict[str, Any]:
    """The effects that the free stretches of one film show, with their numbers, and whether they are the true ones."""
    effects = {"plate_tilt": {"x": TILT}} if kind == "tilted" else {}
    level = Scene.read("crowd").draw(seed=seed)
    clip = Scene.read("crowd", effects=effects).draw(seed=seed)
    found = discrepancy.find([measure_true_positions(clip, seed)], level.model, stretches=True)
    return {
        "law": " and ".join(claim.effect for claim in found.named) or "nothing",
        "right": [claim.effect for claim in found.named] == list(effects),
        "sigma": max((claim.sigma for claim in found.named), default=0.0),
        "numbers": [[value, claim.std[name]] for claim in found.named for name, value in claim.values.items()],
    }


def read_true_slips(clip: Clip) -> pd.DataFrame:
    """The true contacts of two balls: t_s, i, j, slip (m/s), its share in the plane, and the friction that stops it."""
    motion, radius = clip.solve(), clip.model.ball.diameter / 2
    events = motion.events[motion.events["kind"] == "contact"].reset_index(drop=True)
    at, count = events["t_s"].to_numpy(), len(motion.at([0.0]))
    before = motion.at(np.maximum(at - 1e-9, 0)).sort_values(["particle", "t_s"])
    state = before[["x", "y", "z", "vx", "vy", "vz", "wx", "wy", "wz"]].to_numpy().reshape(count, len(at), 9)
    one, other = (state[events[k].to_numpy(), np.arange(len(at))] for k in "ij")
    normal = other[:, :3] - one[:, :3]
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    approach = one[:, 3:6] - other[:, 3:6]
    slip = approach + radius * np.cross(one[:, 6:] + other[:, 6:], normal)
    along = (approach * normal).sum(axis=1)
    slip -= (slip * normal).sum(axis=1)[:, None] * normal
    size, across = np.linalg.norm(slip, axis=1), np.abs(slip[:, 1] * normal[:, 0] - slip[:, 0] * normal[:, 1])
    sticks = 2 / 7 * across / ((1 + clip.model.restitution) * np.abs(along))
    return events[["t_s", "i", "j"]].assign(slip=size, share=across / size, sticks=sticks)


def bound_fall(clip: Clip, result: tracker.Result) -> dict[str, float]:
    """How many measured contacts a film has, and by how many sigma their friction falls if all slips are known."""
    true, names, rows = read_true_slips(clip), name_balls(clip, result), result.estimates.to_dict("records")
    by_number = {row["collision"]: row for row in rows if not row["misfit_local"]}
    found = list[dict[str, float]]()
    for number, traced in trace_slips(rows, result.contacts, result.camera.ball_diameter).items():
        if number not in by_number:
            continue
        row = by_number[number]
        balls = sorted(names[row[name]] for name in ("particle1", "particle2"))
        same = (np.sort(true[["i", "j"]].to_numpy(), axis=1) == balls).all(axis=1)
        late = np.where(same, np.abs(true["t_s"] - row["t_c_local"]), np.inf)
        if late.min() < REACH_S:
            found.append(dict(true.iloc[late.argmin()]) | {"std": traced.friction_std})
    table = pd.DataFrame(found)
    share, sticks, std, slip = (table[name].to_numpy(float) for name in ("share", "sticks", "std", "slip"))
    falling = FALLING["mu"] + FALLING["rise"] * np.exp(-slip / FALLING["fall"])
    differs, tried = np.minimum(falling * share, sticks), np.linspace(0.0, 0.5, 501)[:, None]
    off = (differs - np.minimum(tried * share, sticks)) / std
    return {"bound_contacts": len(table), "bound_sigma": float(np.sqrt((off**2).sum(axis=1).min()))}


def _describe_film(kind: str) -> dict[str, Any]:
    return {"balls": 36, "frames": 300, "effects": OF_FRICTION[kind]} if kind in OF_FRICTION else {}


def search_film(kind: str, seed: int) -> dict[str, Any]:
    """The law of one film, with its numbers, and whether it is the true one."""
    if kind in ("tilted", "level"):
        return search_stretches(kind, seed)
    excess, of_friction = EXCESS if "heavier" in kind else 0.0, kind in OF_FRICTION
    clip = make_tray(excess, **_describe_film(kind)).draw(seed=seed)
    result: tracker.Result = measure_true_positions(clip, seed)
    quantity = "friction" if of_friction else "recoil"
    claims = [one for one in select_contact_laws(read_contacts([result])) if one.quantity == quantity]
    if not claims:
        return {"law": "too few contacts", "right": False, "sigma": 0.0, "numbers": []}
    (claim,) = claims
    heavy = next((k for k, ball in name_balls(clip, result).items() if ball == 0), -1)
    truth = {"heavier": f"ball {heavy} is heavier by a share", "equal": "as the masses say"}
    truth |= {"falling": "Coulomb friction that falls with the slip speed"}
    right = claim.law == truth[kind] if kind in truth else "falling ball_friction" not in claim.causes
    right = right and not (kind == "heavier" and claim.rivals)
    return {
        "law": claim.law,
        "causes": list(claim.causes),
        "right": right,
        "contacts": claim.contacts,
        "sigma": claim.sigma,
        "numbers": [[number.value, number.std] for number in claim.numbers],
    } | (bound_fall(clip, result) if kind == "falling" else {})


def main() -> None:
    """Search all films and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("--films", type=int, default=6)
    parser.add_argument("--first", type=int, default=1, help="seed of the first film")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out/crowd_laws.json")
    given = parser.parse_args()
    found = dict[str, Any]()
    for seed in range(given.first, given.first + given.films):
        part = f"{given.kind} {seed}"
        one = found[part] = keep(given.output.with_suffix(".jsonl"), part, partial(search_film, given.kind, seed))
        numbers = ", ".join(f"{value:.4g}({std:.2g})" for value, std in one["numbers"])
        print(f"{part}: {one['law']}, {one['sigma']:.1f} sigma, {numbers}; contacts: {one.get('contacts')}", flush=True)
        if "bound_sigma" in one:
            print(f"  bound by {one['bound_contacts']} contacts: {one['bound_sigma']:.1f} sigma", flush=True)
    save(given.output, found)
    print(f"{sum(one['right'] for one in found.values())} of {len(found)} films are right")


if __name__ == "__main__":
    main()
