"""Clips that are unlike all others: one bad recording must not make a discovery."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from discrepancy.arrays import Array
from discrepancy.data.collisions import MeasuredCollision
from discrepancy.fitting.model_fit import ModelFit
from discrepancy.fitting.significance import chi2_to_sigma
from discrepancy.policy import current_policy

SEEN = 1e-9  # of a parameter's information: directions that show less count for nothing


def outlier_clips(clips: Sequence[MeasuredCollision], base: ModelFit, best: ModelFit, gone: int = 0) -> dict[int, str]:
    """Clips to leave out before a search is done again.

    Either a clip's chi^2 is far beyond the others' in the base fit and in the best fit alike; or it contradicts all
    others about the shared parameters of the best fit, and without it they agree. Where they do not, something is
    missing in the model, and no clip is to blame.

    Parameters
    ----------
    clips : sequence of Measured
    base, best : Fit
        Of these clips, before and after the search.
    gone : int
        How many clips have been left out already.

    Returns
    -------
    dict of int to str
        By the clip's place in `clips`, a line that says why.
    """
    most = max((len(clips) + gone) // current_policy().outlier_clips_one_in, 1) - gone
    out = {}
    far = np.minimum(_unlike(base), _unlike(best))
    for k in np.flatnonzero(far > current_policy().outlier_clip_spreads).tolist():
        chi2 = float(best.residuals[k] @ best.residuals[k]) / len(best.residuals[k])
        out[k] = f"clip {clips[k].clip}: chi^2 a point is {chi2:.3g}, unlike all others, whatever the model"
    if len(out) > most or not best.names:
        return out if len(out) <= most else {}
    told, pulls = _told(best)
    for _ in range(most - len(out) + 1):
        kept = [k for k in range(len(clips)) if k not in out]
        apart, worst = max((_apart(told, pulls, k, kept), k) for k in kept)
        if apart < current_policy().outlier_clip_sigma:
            return out
        out[worst] = f"clip {clips[worst].clip}: it contradicts all others by {apart:.0f} sigma"
    return {}


def _unlike(fit: ModelFit) -> Array:
    """How far the logarithm of each clip's chi^2 a point lies above the median, in spreads of the clips', or of chance.

    The logarithm, because an effect that is missing makes some clips worse than others by factors.
    """
    points = np.array([len(r) for r in fit.residuals])
    each = np.log([float(r @ r) / len(r) for r in fit.residuals])
    above = each - np.median(each)
    spread = 1.4826 * float(np.median(np.abs(above)))
    return np.asarray(above / np.maximum(spread, np.sqrt(2 / points)))


def _told(fit: ModelFit) -> tuple[Array, Array]:
    """What each clip alone says of the shared parameters: information (clips, S, S), its pull on them (clips, S)."""
    cleaned = fit.profiled_slopes
    size = np.sqrt(sum((c**2).sum(axis=0) for c in cleaned))
    unit = [c / np.where(size > 0, size, 1) for c in cleaned]
    pulls = np.array([c.T @ r for c, r in zip(unit, fit.residuals, strict=True)])
    return np.array([c.T @ c for c in unit]), pulls


def _apart(told: Array, pulls: Array, k: int, kept: Sequence[int]) -> float:
    """Sigma by which chi^2 falls when clip k has shared parameters of its own (Chow, Econometrica 28 (1960) 591)."""
    rest = [i for i in kept if i != k]
    chi2, freedom = 0.0, 0
    for sign, group in ((1, [k]), (1, rest), (-1, [*rest, k])):
        values, axes = np.linalg.eigh(told[group].sum(axis=0))
        seen = values > SEEN
        chi2 += sign * float((((axes.T @ pulls[group].sum(axis=0))[seen]) ** 2 / values[seen]).sum())
        freedom += sign * int(seen.sum())
    return chi2_to_sigma(max(chi2, 0.0), freedom) if freedom > 0 else 0.0
