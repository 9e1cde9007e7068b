"""Is a named effect the same in all collisions? One that is not stands for another law, which it resembles.

With the model complete its residuals are noise, whatever they are held against; so they are against the effect's own
signature times what changes from place to place, from clip to clip and with time. Had the strength been another there,
that is what would be left, to first order: a score test of each such change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from discrepancy.arrays import Array
from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.launch import HEADING, T_C, V0, B
from discrepancy.fitting.jacobian import differentiate
from discrepancy.fitting.model_fit import ModelFit, WhitenedClips
from discrepancy.fitting.significance import chi2_to_sigma
from discrepancy.policy import current_policy

SINCE = 0.1  # s, of time since the hit
SEEN = 1e-8  # of the columns' own size: what the fit leaves less of shows nothing


@dataclass(frozen=True)
class StrengthVariation:
    """What strengths change with, and by how many sigma, corrected for all that was tried."""

    against: str
    sigma: float

    def refuses(self, own: float) -> str:
        """Why a claim of `own` sigma is withdrawn; empty where it is as good as the same everywhere."""
        if self.sigma > max(current_policy().unexplained_sigma, current_policy().max_strength_variation * own):
            return f"it is another with the {self.against} ({self.sigma:.0f} sigma)"
        return ""


def find_variation(evidence: WhitenedClips, fit: ModelFit, strengths: Sequence[str]) -> StrengthVariation:
    """What the strengths of an effect change with most.

    Parameters
    ----------
    evidence : Evidence
    fit : Fit
        The whole model, in this evidence.
    strengths : sequence of str
        Of the effect, dotted names.

    Returns
    -------
    Change
    """
    features = [_features(*each) for each in zip(evidence.clips, range(len(fit.launches)), fit.launches, strict=True)]
    own = [differentiate(fit.model, fit.launches, evidence.clips, name) for name in strengths]
    moves = [np.stack(each, axis=-1)[..., None] for each in zip(*own, strict=True)]  # (n, 2, strengths, 1)
    best = StrengthVariation("", 0.0)
    for against in features[0]:
        columns = [
            (m * f[against][:, None, None]).reshape(*m.shape[:2], -1) for m, f in zip(moves, features, strict=True)
        ]
        white = evidence.whiten(columns)
        information, pull = fit.information(white)
        values, axes = np.linalg.eigh(information)
        seen = values > SEEN * sum(float((c**2).sum()) for c in white)
        if not seen.any():
            continue  # it is the same in all clips, or the fit takes it up
        chi2 = float(((axes[:, seen].T @ pull) ** 2 / values[seen]).sum())
        found = StrengthVariation(against, chi2_to_sigma(chi2, int(seen.sum()), len(features[0])))
        best = max(best, found, key=lambda c: c.sigma)
    return best


def _features(clip: MeasuredCollision, number: int, launch: Array) -> dict[str, Array]:
    """By what it is, numbers (n, f) of each place of a clip, of size one or so."""
    since = np.maximum(clip.frame / clip.fps - launch[T_C], 0) / SINCE
    b, is_a = float(launch[B]), (clip.ball == int(clip.striker == "a")).astype(float)

    def alike(*values: float) -> Array:
        return np.broadcast_to(np.array(values), (len(clip.frame), len(values)))

    return {
        "order of the clips": alike(float(number)),
        "heading": alike(float(np.cos(launch[HEADING])), float(np.sin(launch[HEADING]))),
        "speed": alike(float(launch[V0])),
        "obliqueness of the hit": alike(abs(b)),
        "side of the hit": alike(b),
        "ball that strikes": alike(float(clip.striker == "a")),
        "ball": is_a[:, None],
        "place": np.asarray(clip.xy),
        "time since the hit": np.stack([since, since**2], axis=1),
    }
