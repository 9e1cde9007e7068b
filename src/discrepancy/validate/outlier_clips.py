"""Find clips that deviate from all others, because one bad recording must not make a discovery."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from discrepancy.data.collisions import MeasuredCollision
from discrepancy.data.notes import SearchNote, SearchNoteKind
from discrepancy.fitting.model_fit import ModelFit
from discrepancy.fitting.significance import chi2_to_sigma
from discrepancy.policy import current_policy
from synthcam_shared.arrays import Array


def find_outlier_clips(
    clips: Sequence[MeasuredCollision], base: ModelFit, best: ModelFit, removed: int = 0, are_held_out: bool = False
) -> dict[int, SearchNote]:
    """Find outlier clips, which deviate from all others, to leave out before a search is repeated.

    A clip is an outlier in one of two cases.

    - Its chi^2 is far above that of the others, both in the base fit and in the best fit. The base fit may miss all
      clips: then it is enough that the claims change the clip's chi^2 little. For held-out clips, which are to refute
      claims, it is not enough.
    - Its shared parameters contradict those of all others, and the others agree without it. This is Chow's test
      (Econometrica 28 (1960) 591).

    If the others do not agree, or if more than one clip in ten is an outlier, the model lacks something. Then no
    clip is removed.

    base, best: the fits of these clips, without and with all claims. removed: the number of clips that were left out
    earlier. Returns notes that say why, by the clip's index in `clips`.
    """
    most = max((len(clips) + removed) // current_policy().outlier_clips_one_in, 1) - removed
    out: dict[int, SearchNote] = {}
    is_unchanged = np.abs(_log_chi2(best) - _log_chi2(base)) < 1  # to within a factor of e
    far = np.minimum(_deviations(best), np.where(is_unchanged & (not are_held_out), np.inf, _deviations(base)))
    for k in np.flatnonzero(far > current_policy().outlier_clip_spreads).tolist():
        chi2 = float(best.residuals[k] @ best.residuals[k]) / len(best.residuals[k])
        out[k] = SearchNote(SearchNoteKind.UNLIKE_OTHERS, clips[k].clip, values={"chi2": chi2, "held_out": ""})
    if len(out) > most or not best.names:
        return out if len(out) <= most else {}
    information, pulls = _information_by_clip(best)
    for _ in range(most - len(out) + 1):
        kept = [k for k in range(len(clips)) if k not in out]
        sigma, worst = max((_contradiction(information, pulls, k, kept), k) for k in kept)
        if sigma < current_policy().outlier_clip_sigma:
            return out
        values = {"sigma": sigma, "held_out": ""}
        out[worst] = SearchNote(SearchNoteKind.CONTRADICTS_OTHERS, clips[worst].clip, values=values)
    return {}


def _log_chi2(fit: ModelFit) -> Array:
    return np.log([float(r @ r) / len(r) for r in fit.residuals])


def _deviations(fit: ModelFit) -> Array:
    """Each clip's log chi^2 per point less the median, in spreads of clips or of chance: effects act by factors."""
    points, above = np.array([len(r) for r in fit.residuals]), _log_chi2(fit)
    above -= np.median(above)
    spread = 1.4826 * float(np.median(np.abs(above)))
    return np.asarray(above / np.maximum(spread, np.sqrt(2 / points)))


def _information_by_clip(fit: ModelFit) -> tuple[Array, Array]:
    """Each clip's own information on the shared parameters, (clips, S, S), and its pull on them, (clips, S)."""
    cleaned = fit.profiled_slopes
    size = np.sqrt(sum((c**2).sum(axis=0) for c in cleaned))
    unit = [c / np.where(size > 0, size, 1) for c in cleaned]
    pulls = np.array([c.T @ r for c, r in zip(unit, fit.residuals, strict=True)])
    return np.array([c.T @ c for c in unit]), pulls


def _contradiction(
    information: Array, pulls: Array, k: int, kept: Sequence[int], min_information: float = 1e-9
) -> float:
    """Sigma of the decrease of chi^2 if clip k has its own shared parameters; directions with less do not count."""
    rest = [i for i in kept if i != k]
    chi2, freedom = 0.0, 0
    for sign, group in ((1, [k]), (1, rest), (-1, [*rest, k])):
        values, axes = np.linalg.eigh(information[group].sum(axis=0))
        seen = values > min_information
        chi2 += sign * float((((axes.T @ pulls[group].sum(axis=0))[seen]) ** 2 / values[seen]).sum())
        freedom += sign * int(seen.sum())
    return chi2_to_sigma(max(chi2, 0.0), freedom) if freedom > 0 else 0.0
