"""Masses put into real tracks: does recoil show that a camera file states the mass of one body wrongly?

python -m benchmarks.real.masses CLONE [CLONE ...] [-o out/masses.json]
make bench-masses CLONES="CLONE ..."

Each CLONE is a clone of one of the repositories that `benchmarks.real.recordings` reads. A set has all hits in which
one body takes part, which is ball a of its camera files: either disc, the struck puck, or one of three billiard balls.
Its mass is stated too large or too small, all hits are measured again, and the search chooses a law of the recoil.

The detection limit is the share that the hits with the right masses show with 5 sigma. If the body strikes in some hits
and is struck in others, recoil distinguishes its mass from an error that all hits share. Else that error counts, as
large as usual. Strengths are 5 and 10 times the limit, of both signs, but at most `LARGEST`. `size` is the logarithm of
the mass that recoil shows over the stated one, `own` that of the set with the right masses, and `z` the deviation of
the size, less own, in its standard errors.
"""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from benchmarks.harness import add_clones, save
from benchmarks.real.hits import READERS, find_laboratory, measure_hit
from benchmarks.real.recordings import RecordedHit
from discrepancy.data.contacts import Contacts
from discrepancy.select.contact_effects import ContactClaim, select_contact_laws
from tracker.measurement.collision.adequacy import USUAL_BIAS
from tracker.measurement.local.local_columns import calibrate_set
from tracker.measurement.random_effects import fit_random_effects

TIMES = (5.0, 10.0)  # strengths, in detection limits
LARGEST = 0.2  # logarithm of a mass over the right one; beyond it all contacts of the pucks lose their estimates


@dataclass(frozen=True)
class MassSet:
    """Hits in which one body takes part, which is particle 0 of each."""

    name: str
    support: str
    hits: Sequence[RecordedHit]

    def measure(self, wrong: float = 0.0) -> Contacts:
        """Measure the hits with a mass of ball a whose logarithm is stated too large by `wrong`."""
        given = []
        for hit in self.hits:
            one, two = hit.camera.get("ball_masses", [1.0, 1.0])
            given.append(replace(hit, camera=hit.camera | {"ball_masses": [one * math.exp(wrong), two]}))
        rows = calibrate_set([measure_hit(hit, self.support) | {"clip": k} for k, hit in enumerate(given)])
        for row in rows:
            row["striker"] = "a" if row.get("particle2") == 0 else "b"
        masses = [hit.camera["ball_masses"] for hit in given]
        return Contacts.of(rows, {k: one / two for k, (one, two) in enumerate(masses)})


def make_sets(laboratory: str, hits: Sequence[RecordedHit]) -> Iterator[MassSet]:
    """Make the sets of a laboratory: one for each billiard ball of a match, one of all hits elsewhere."""
    support = READERS[laboratory][0]
    balls = sorted({ball for hit in hits for ball in hit.balls})
    if len(balls) == 2:
        yield MassSet(laboratory, support, hits)
        return
    for ball in balls:
        yield MassSet(
            f"{laboratory}, ball {ball}", support, [_put_first(hit, ball) for hit in hits if ball in hit.balls]
        )


def _put_first(hit: RecordedHit, ball: int) -> RecordedHit:
    """Make a ball of a recording its particle 0."""
    if hit.balls[0] == ball:
        return hit
    return replace(hit, tracks=hit.tracks.assign(particle=1 - hit.tracks["particle"]), balls=hit.balls[::-1])


def try_masses(given: MassSet) -> Iterator[dict[str, Any]]:
    """Search a set with the right masses, and with wrong ones of both signs: a line for each."""
    right = given.measure()
    own, std = measure_own(right)
    claim, strikes = find_recoil(right), int(right.a_strikes.sum())
    line: dict[str, Any] = {"set": given.name, "hits": claim.contacts, "strikes": strikes, "limit": 5 * std, "own": own}
    yield line | {"times": 0.0, "wrong": 0.0, "law": claim.law, "causes": claim.causes, "sigma": claim.sigma}
    for strength in dict.fromkeys(min(5 * times * std, LARGEST) for times in TIMES):
        for wrong in (strength, -strength):
            claim = find_recoil(given.measure(wrong))
            one = line | {"times": strength / (5 * std), "wrong": wrong, "law": claim.law, "causes": claim.causes}
            one |= {"sigma": claim.sigma}
            if "mass_mismatch" in claim.causes:
                number = claim.numbers[0]
                size = -number.value if "struck" in claim.law and strikes == claim.contacts else number.value
                one |= {"size": size, "std": number.std, "z": (size - own + wrong) / number.std}
            yield one


def measure_own(contacts: Contacts) -> tuple[float, float]:
    """Measure what recoil adds to the stated mass of ball a, as a logarithm, and its standard error.

    A loss of momentum in all hits has the same effect where ball a never strikes, or always. Then the error is that of
    the largest bias that is usual.
    """
    known = contacts.select(np.isfinite(contacts.recoil) & np.isfinite(contacts.recoil_std))
    design = np.where(known.a_strikes, -1.0, 1.0)[:, None]
    fit = fit_random_effects(known.recoil, *known.split_errors("recoil"), design)
    usual = 2 * USUAL_BIAS / (1 + float(np.median(known.restitution))) if len(set(known.a_strikes)) == 1 else 0.0
    return float(fit.coefficients[0]), max(float(fit.std[0]), usual)


def find_recoil(contacts: Contacts) -> ContactClaim:
    """Choose the law of the recoil."""
    return next(claim for claim in select_contact_laws(contacts) if claim.quantity == "recoil")


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_clones(parser)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/masses.json"))
    given = parser.parse_args()
    names = {clone: find_laboratory(clone) for clone in given.clones}
    if not names:
        raise SystemExit(f"expected paths to clones of {', '.join(READERS)}")
    lines = []
    for clone, name in names.items():
        for one in make_sets(name, READERS[name][1](clone)):
            for line in try_masses(one):
                lines.append(line)
                print(show(line), flush=True)
    save(given.output, {"lines": lines})


def show(line: dict[str, Any]) -> str:
    """Show a line: the mass stated over the right one, the law, and the size with its error."""
    text = f"{line['set']:24}{line['hits']:4} hits, strikes in {line['strikes']:2}  limit {line['limit']:5.1%}  "
    text += f"stated {math.exp(line['wrong']):5.3f} of the right mass  {line['law']:42}{line['sigma']:5.1f} sigma"
    if "size" in line:
        text += f"  size {line['size']:+.3f}({line['std']:.3f}), own {line['own']:+.3f}, z {line['z']:+.1f}"
    return text


if __name__ == "__main__":
    main()
