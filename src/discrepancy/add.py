"""A person's own suspect, fitted with everything else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from discrepancy import policy
from discrepancy.data.collisions import Measured
from discrepancy.data.outlier_points import taken_out, without_spikes
from discrepancy.fitting.base_fit import Tick, base_fit, check, noise_of, smoothed
from discrepancy.fitting.gauss_newton import settle
from discrepancy.fitting.model_fit import Evidence, Fit
from discrepancy.fitting.significance import sigmas
from discrepancy.selection.extend import grown
from discrepancy.selection.named import Named
from discrepancy.selection.profile_errors import spread
from discrepancy.selection.score_test import Contest
from synthcam.library import library
from synthcam.model import Model
from tracker.camera.camera import InputError


@dataclass(frozen=True)
class Added:
    """A suspect fitted with everything else. before, now: the fits without and with it, all clips in both.

    left_out: a line for each clip of which some places had no part in them.
    """

    before: Fit
    now: Fit
    named: Named
    left_out: tuple[str, ...] = ()

    @property
    def chi2(self) -> tuple[float, float]:
        """A degree of freedom: without and with it."""
        one, other = (f.chi2 / (f.points - f.parameters) for f in (self.before, self.now))
        return one, other

    def sentence(self) -> str:
        """Its strength, and how far chi^2 falls."""
        one, other = self.chi2
        poor = "; more is missing, and its error holds only if nothing is" if other > policy.POOR_CHI2 else ""
        return (
            f"{self.named.said(self.before.model)}; chi^2 a degree of freedom goes from {one:.4g} to {other:.4g} on "
            f"the collisions fitted{poor}"
        )

    def document(self) -> dict[str, Any]:
        """For other programs; parameters by their own names. std: None where there is none to give."""
        n = self.named
        std = {k: None if n.at_limit(k) or not np.isfinite(x) else x for k, x in (n.std | n.shape_std).items()}
        return {
            "effect": n.effect,
            "parameters": {k.rpartition(".")[2]: x for k, x in (n.values | n.shapes).items()},
            "std": {k.rpartition(".")[2]: x for k, x in std.items()},
            "sigma": n.sigma,
            "chi2": dict(zip(("before", "after"), self.chi2, strict=True)),
        }


def add(clips: Sequence[Measured], model: Model, effect: str, tick: Tick = lambda stage: None) -> Added:
    """`effect` added to the model and fitted to all clips with everything else.

    Raises InputError: no such effect, what `check` refuses, or these collisions cannot tell it.
    """
    if effect not in library():
        raise InputError(f"{effect}: no such effect; there are {', '.join(library())}")
    check(clips, model)
    tick("noise")
    given, (clips, _) = clips, smoothed(without_spikes(clips), [], model, tick)
    noise = noise_of(clips)
    evidence, base = Evidence.of(clips, noise), base_fit(clips, model, noise, tick)
    if any(n.startswith(f"{effect}.") for n in base.names):
        raise InputError(f"{effect}: the model calls it free, so that every fit has it; `discrepancy find` shows it")
    contest = Contest.of(evidence, base, lambda: tick("search"))
    candidate = next((c for c in contest.ranking() if c.effect == effect), None)
    if candidate is None or not candidate.telling:
        far = base.chi2 / (base.points - base.parameters)
        why = (
            f"; without it chi^2 is {far:.3g} a degree of freedom: something larger is missing"
            if far > policy.POOR_CHI2
            else ""
        )
        raise InputError(f"{effect}: these collisions cannot tell it: the fit absorbs it, or it hardly shows{why}")
    suspect, best = candidate.suspect, contest.sharper(evidence, candidate)
    now = settle(evidence, grown(evidence, base, best, lambda: tick("search")), lambda: tick("search"))
    sigma = sigmas(base.chi2 - now.chi2, len(suspect.strengths), contest.looks[effect])
    std = now.std | spread(evidence, base, now, suspect)
    return Added(base, now, Named.of(suspect, now, std, sigma), tuple(taken_out(given, clips)))
