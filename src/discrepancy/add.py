"""Add a suspected effect to a model, and fit it with all other parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.outlier_points import note_removed_points, remove_outliers
from discrepancy.fitting.base_fit import check_clips, fit_base_model, remove_outliers_beside_model
from discrepancy.fitting.gauss_newton import minimise_chi2
from discrepancy.fitting.model_fit import ModelFit, WhitenedClips
from discrepancy.fitting.significance import chi2_to_sigma
from discrepancy.noise.model import estimate_noise
from discrepancy.policy import current_policy
from discrepancy.select.effect_claim import EffectClaim, profile_std
from discrepancy.select.library_fits import fit_with_candidate
from discrepancy.select.score_test import ScoreTests
from discrepancy.time_left import Progress, in_stage, report_progress, showing_stages
from discrepancy.wording import describe_claim
from synthcam.library import library
from synthcam.model import Model
from synthcam_shared.errors import InputError
from synthcam_shared.settings import did_you_mean


@dataclass(frozen=True)
class AddedEffect:
    """An effect fitted with all other parameters."""

    # the fit to all clips without and with it
    before: ModelFit
    fit: ModelFit
    named: EffectClaim
    left_out: tuple[str, ...] = ()  # a line for each clip with removed outliers

    @property
    def chi2(self) -> tuple[float, float]:
        """chi^2 per degree of freedom, without and with the effect."""
        one, other = (f.chi2 / (f.points - f.parameters) for f in (self.before, self.fit))
        return one, other

    def sentence(self) -> str:
        """Its strength, and the change of chi^2."""
        one, other = self.chi2
        poor = ""
        if other > current_policy().poor_chi2_per_dof:
            poor = "; the model still lacks something, so its error is too small"
        return (
            f"{describe_claim(self.named, self.before.model)}; chi^2 per degree of freedom falls from {one:.4g} to "
            f"{other:.4g} on the fitted collisions{poor}"
        )

    def document(self) -> dict[str, Any]:
        """The result for other programs. Parameters have their short names; std is None if there is none."""
        n = self.named
        std = {k: None if n.at_limit(k) or not np.isfinite(x) else x for k, x in (n.std | n.shape_std).items()}
        return {
            "effect": n.effect,
            "parameters": {k.rpartition(".")[2]: x for k, x in (n.values | n.shapes).items()},
            "std": {k.rpartition(".")[2]: x for k, x in std.items()},
            "sigma": n.sigma,
            "chi2": dict(zip(("before", "after"), self.chi2, strict=True)),
        }


def check_effect(effect: str) -> None:
    """Check the effect that is to be added: raise InputError if the library has none of that name."""
    if effect not in library():
        known = did_you_mean(effect, library()) or f"; there are {', '.join(library())}"
        raise InputError(f"{effect}: no such effect{known}")


def add(
    clips: Sequence[MeasuredCollision], model: Model, effect: str, progress: Progress = lambda stage: None
) -> AddedEffect:
    """Add an effect to the model, and fit it to all clips with all other parameters.

    Raises InputError if no such effect exists, if these collisions cannot identify it, or if `check_clips` refuses
    them.
    """
    check_effect(effect)
    given = check_clips(clips, model)
    with showing_stages(progress), in_stage("noise"):
        report_progress()
        clips, _ = remove_outliers_beside_model(remove_outliers(given), [], model)
        noise = estimate_noise(clips)
        evidence, base = WhitenedClips.of(clips, noise), fit_base_model(clips, model, noise)
        if any(n.startswith(f"{effect}.") for n in base.names):
            raise InputError(f"{effect}: the model declares it free; run `discrepancy find` to see its fitted value")
        with in_stage("search"):
            fit, claim = _fit_effect(evidence, base, effect)
    return AddedEffect(base, fit, claim, tuple(map(str, note_removed_points(given, clips))))


def _fit_effect(evidence: WhitenedClips, base: ModelFit, effect: str) -> tuple[ModelFit, EffectClaim]:
    """Fit an effect with everything in the base fit. Raises InputError where it is not identifiable."""
    tests = ScoreTests.of(evidence, base)
    scored = next((c for c in tests.ranking() if c.effect == effect), None)
    if scored is None or not scored.identifiable:
        far, why = base.chi2 / (base.points - base.parameters), ""
        if far > current_policy().poor_chi2_per_dof:
            why = f"; without it chi^2 per degree of freedom is {far:.3g}: a larger effect is missing"
        raise InputError(f"{effect}: not identifiable from these collisions: absorbed by the fit, or too small{why}")
    candidate = scored.candidate
    fit = minimise_chi2(evidence, fit_with_candidate(evidence, base, tests.sharper(evidence, scored)))
    sigma = chi2_to_sigma(base.chi2 - fit.chi2, len(candidate.strengths), tests.trials_factors[effect])
    std = fit.std | profile_std(evidence, base, fit, candidate)
    return fit, EffectClaim.of(candidate, fit, std, sigma)
