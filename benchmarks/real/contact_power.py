"""Power study of billiard contacts: can they show a hop, or friction between balls that falls with the speed?

python -m benchmarks.real.contact_power CLONE [--draws 8] [--only WORD] [-o out/contact_power.json]
make bench-contact-power CLONES=CLONE

CLONE is a clone of github.com/erdo100/3cushiontool. The first table compares laws of the friction on its contacts, by
the likelihood and on contacts kept out, with and without an unseen spin of the strikers. For each law it has the size
of a hop over the predicted one. `benchmarks.real.contact_laws` explains the fits. Then comes what the search names.

Then each hit is simulated by known laws: the same launches, impact parameters and frames, and the scatter and errors
that docs/real_tracks.md gives. The tracker measures these hits, and the search chooses the laws of their contacts, as
of the real ones. A line for each law and draw has what the search names, and by how much the true law is likelier than
a simpler one. docs/background/contact_laws.md has both tables. A run that was stopped continues.
"""

from __future__ import annotations

import argparse
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, fields
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from benchmarks.harness import ROOT, keep, save
from benchmarks.real.contact_laws import (
    LAWS,
    HopFit,
    fit_friction,
    fit_loss_beside_masses,
    predict_held_out,
    predict_vertical,
)
from benchmarks.real.hits import measure_hit
from benchmarks.real.recordings import RecordedHit, read_billiards
from benchmarks.real.simulated_hits import (
    PUBLISHED_FALL,
    ContactTruth,
    HitDesign,
    draw_waves,
    read_design,
    simulate_hit,
)
from discrepancy.data.contacts import Contacts
from discrepancy.select.contact_effects import select_contact_laws
from discrepancy.select.unseen_spin import COULOMB, FALLING
from discrepancy.wording import describe_contacts
from synthcam.model import Model
from synthcam_shared.arrays import Array
from synthcam_shared.report.numbers import format_with_error
from tracker.measurement.local.local_columns import calibrate_set

SIDE_SPIN = 0.75  # R w over the speed: the width that the real contacts show
ROUGH = {"mu": 0.085}  # the friction that they show
STEEP = {"mu": 0.05, "rise": 0.54, "fall": PUBLISHED_FALL["fall"]}  # five times the published curve
TRUTHS = {
    "Coulomb": ContactTruth(ROUGH, False, SIDE_SPIN),
    "published fall": ContactTruth(PUBLISHED_FALL, False, SIDE_SPIN),
    "Coulomb, hop": ContactTruth(ROUGH, True, SIDE_SPIN),
    "published fall, hop": ContactTruth(PUBLISHED_FALL, True, SIDE_SPIN),
    "steep fall, hop": ContactTruth(STEEP, True, SIDE_SPIN),
    "Coulomb, no spin": ContactTruth(ROUGH, False),
    "published fall, no spin": ContactTruth(PUBLISHED_FALL, False),
    "Coulomb, hop, no spin": ContactTruth(ROUGH, True),
    "published fall, hop, no spin": ContactTruth(PUBLISHED_FALL, True),
}


def measure_set(hits: Sequence[RecordedHit]) -> tuple[list[dict[str, Any]], Contacts]:
    """Measure a set of hits: the rows of their local estimates, and their contacts."""
    rows = calibrate_set([measure_hit(hit, "cloth") | {"clip": k} for k, hit in enumerate(hits)])
    for row in rows:
        row["striker"] = "a" if row.get("particle2") == 0 else "b"
    return rows, Contacts.of(rows)


def select_with_friction(contacts: Contacts) -> Contacts:
    """The contacts that show a friction and a recoil."""
    return contacts.select(np.isfinite(contacts.friction + contacts.friction_std + contacts.recoil))


def draw_set(truth: ContactTruth, designs: Sequence[HitDesign], draw: int) -> dict[str, Any]:
    """Simulate and measure all hits: their contacts and the bias of the set, as plain lists."""
    waves = draw_waves(np.random.default_rng(draw))
    hits = [simulate_hit(one, truth, np.random.default_rng([draw, k]), waves).hit for k, one in enumerate(designs)]
    rows, contacts = measure_set(hits)
    lists = {f.name: getattr(contacts, f.name).tolist() for f in fields(contacts)}
    return {"contacts": lists, "bias": next(row["local_bias"] for row in rows if np.isfinite(row["local_bias"]))}


def judge_set(drawn: Mapping[str, Any]) -> dict[str, Any]:
    """Search a drawn set for laws, and fit the laws of the friction and a hop to it."""
    contacts = Contacts(**{name: np.array(values) for name, values in drawn["contacts"].items()})
    out: dict[str, Any] = {"bias": drawn["bias"], "contacts": len(contacts)}
    for claim in select_contact_laws(contacts):
        out[claim.quantity] = asdict(claim)
    known = select_with_friction(contacts)
    fits = {law.name: fit_friction(law, known, True) for law in LAWS[1:]}
    out["costs"] = {name: fit.cost for name, fit in fits.items()}
    out["held-out gain of a change"] = predict_held_out(COULOMB, known, True) - predict_held_out(FALLING, known, True)
    vertical = predict_vertical(fits[COULOMB.name], known)
    for kind, shared in (("hop", False), ("hop with shared errors", True)):
        out[kind] = vars(HopFit.of(known, vertical, shared=shared))
    return out


def compare_laws(contacts: Contacts) -> Iterator[dict[str, Any]]:
    """Compare all laws of the friction, without and with an unseen spin, each without and with a hop."""
    for law in LAWS:
        for spins in (False, True) if law.name != "none" else (False,):
            fit = fit_friction(law, contacts, spins)
            line: dict[str, Any] = {"law": law.name, "spins": spins, "cost": fit.cost}
            line |= {"held_out": predict_held_out(law, contacts, spins), "numbers": fit.numbers.tolist()}
            line |= {"scatter": fit.scatter, "width": fit.width}
            if law.name != "none":
                vertical = predict_vertical(fit, contacts)
                line["hop"] = vars(HopFit.of(contacts, vertical, shared=False))
                line["hop with shared errors"] = vars(HopFit.of(contacts, vertical, shared=True))
            yield line


def show_law(line: Mapping[str, Any]) -> str:
    """A law of the friction as a line of the table."""
    numbers = ", ".join(f"{number:.3f}" for number in line["numbers"])
    text = f"{line['law']:49}{'spin' if line['spins'] else '':6}{line['cost']:8.1f}{line['held_out']:8.1f}"
    text += f"  numbers {numbers or '-'}, scatter {line['scatter']:.3f}, spin {line['width']:.2f}"
    if "hop" in line:
        hop, shared = line["hop"], line["hop with shared errors"]
        text += f"; loss {hop['size']:.2f}({hop['std']:.2f}) times mu J, gains {hop['gain']:.1f}"
        text += f", {shared['gain']:.1f} with shared errors"
    return text


def summarise_draws(judged: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Count what the search names in the draws of one truth; means and ranges of what the fits gain."""
    costs = [one["costs"] for one in judged]
    coulomb = np.array([each[COULOMB.name] for each in costs])
    rivals = [name for name in costs[0] if name != COULOMB.name]
    loss = np.array([one["hop"]["size"] for one in judged])
    bias = np.array([one["bias"] for one in judged])
    return {
        "draws": len(judged),
        "friction": dict(Counter(one["friction"]["law"] for one in judged)),
        "causes of the friction": dict(Counter(" or ".join(one["friction"]["causes"]) for one in judged)),
        "a fall is a cause": sum("falling ball_friction" in one["friction"]["causes"] for one in judged),
        "hop is a cause": sum("hop" in one["recoil"]["causes"] for one in judged),
        "friction sigma": _show_spread(np.array([one["friction"]["sigma"] for one in judged])),
        "friction left-out sigma": _show_spread(np.array([one["friction"]["left_out_sigma"] for one in judged])),
        "gain over Coulomb": {
            name: _show_spread(coulomb - np.array([each[name] for each in costs])) for name in rivals
        },
        "held-out gain of a change": _show_spread(np.array([one["held-out gain of a change"] for one in judged])),
        "loss over mu J": _show_spread(loss),
        **{
            f"{quantity} of the loss, {kind}": _show_spread(np.array([one[kind][quantity] for one in judged]))
            for kind in ("hop", "hop with shared errors")
            for quantity in ("gain", "left_out_sigma")
        },
        "bias, %": _show_spread(100 * bias),
    }


def _show_spread(values: Array) -> str:
    return f"{values.mean():.2f} ({values.min():.2f} to {values.max():.2f})"


def main() -> None:
    """Compare laws on the real contacts, draw simulated ones, and print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clones", nargs="*", type=Path, default=[Path(p) for p in os.environ.get("CLONES", "").split()])
    parser.add_argument("--draws", type=int, default=5, help="of each truth; 0: real contacts only")
    parser.add_argument("--first", type=int, default=1, help="seed of the first draw")
    parser.add_argument("--only", default="", help="only truths with this word in their name")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out/contact_power.json")
    given = parser.parse_args()
    clone = next((one for one in given.clones if "3cushiontool" in str(one)), None)
    if clone is None:
        raise SystemExit("expected the path to a clone of 3cushiontool")
    hits = read_billiards(clone)
    rows, contacts = measure_set(hits)
    out: dict[str, Any] = {"laws": []}
    for line in compare_laws(select_with_friction(contacts)):
        out["laws"].append(line)
        print(show_law(line), flush=True)
    out["named"] = [asdict(claim) for claim in select_contact_laws(contacts)]
    print("named:", *describe_contacts(select_contact_laws(contacts), Model()), sep="\n  ")
    balls = np.array([hits[clip].balls for clip in contacts.clip])
    loss = fit_loss_beside_masses(contacts, balls)
    out["loss beside masses"] = [loss.coefficients.tolist(), loss.std.tolist()]
    print("loss beside the masses of the balls:", *map(format_with_error, *out["loss beside masses"]))
    designs = [read_design(hits[clip], rows[clip]) for clip in contacts.clip]
    for name, truth in TRUTHS.items():
        if given.only not in name:
            continue
        judged = []
        for draw in range(given.first, given.first + given.draws):
            drawn = partial(draw_set, truth, designs, draw)
            judged.append(judge_set(keep(given.output.with_suffix(".jsonl"), f"{name} {draw}", drawn)))
        if judged:
            out[name] = summarise_draws(judged)
            print(f"{name}: {out[name]}", flush=True)
    save(given.output, out)


if __name__ == "__main__":
    main()
