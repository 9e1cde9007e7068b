"""A fit with one candidate more, from where its score leads or from realistic sizes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from discrepancy.fitting.gauss_newton import identifiable, linearised, nudged, settle
from discrepancy.fitting.jacobian import derivatives
from discrepancy.fitting.model_fit import Evidence, Fit
from discrepancy.fitting.parameters import limits_of, parameter_of
from discrepancy.fitting.predict import forecast
from discrepancy.selection.scored import CandidateScore

KEPT = 0.5  # of the gain that the score promises
STARTS, FAR = (0.1, 0.3, 1.0), 2  # of a realistic size, where the way is too far for the score; that many are followed


def fit_with_candidate(
    evidence: Evidence, fit: Fit, scored: CandidateScore, progress: Callable[[], None] = lambda: None
) -> Fit:
    """Fit a candidate's strengths, then its shape parameters, together with all that a fit has already.

    The descent starts where the score test leads, and where that gains less than KEPT of what the test promised, from
    realistic sizes as well. For a base parameter held at zero it starts from realistic sizes only.

    Parameters
    ----------
    evidence : Evidence
    fit : Fit
        Without the candidate.
    scored : CandidateScore
        The candidate and its score test beside `fit`.
    progress : callable
        Told of progress.

    Returns
    -------
    Fit
        The best of those descents, roughly settled; `fit` itself where none can start.
    """
    tries = [] if scored.candidate.kind is None else [_from_here(evidence, fit, scored, progress)]
    if not tries or tries[0].chi2 > fit.chi2 - KEPT * scored.gain:
        tries += [settle(evidence, start, progress, rough=True) for start in _far(evidence, fit, scored)]
    return min(tries, key=lambda f: f.chi2, default=fit)


def _from_here(evidence: Evidence, fit: Fit, scored: CandidateScore, progress: Callable[[], None]) -> Fit:
    candidate, model = scored.candidate, fit.model.replace(scored.shapes)
    strong = settle(evidence, fit.extended(model, scored.strengths, scored.columns), progress, rough=True)
    if not candidate.shapes or all(strong.model.value(s) == 0 for s in scored.strengths):
        return strong
    here = forecast(strong.model, strong.launches, evidence.clips)
    slopes = derivatives(strong.model, strong.launches, evidence.clips, candidate.shapes, here)
    columns = evidence.white([np.stack([s[k] for s in slopes], axis=-1) for k in range(len(here))])
    columns = identifiable(strong.model, candidate.shapes, columns)
    return settle(evidence, strong.extended(strong.model, candidate.shapes, columns), progress, rough=True)


def _far(evidence: Evidence, fit: Fit, scored: CandidateScore) -> list[Fit]:
    """The FAR best starts with the candidate's single strength at a realistic size, all else adapted by one step."""
    candidate = scored.candidate
    if len(candidate.strengths) > 1:
        return []
    name = candidate.strengths[0]
    size, (low, high) = parameter_of(fit.model, name).typical, limits_of(fit.model, name)
    begun: list[Fit] = []
    for shapes in candidate.grid(fit.model):
        for value in (sign * share * size for share in STARTS for sign in (1, -1)):
            if low <= value <= high:
                start = nudged(evidence, fit, fit.model.replace({**shapes, name: value}))
                begun += [start] if start else []
    best = sorted(begun, key=lambda f: f.chi2)[:FAR]
    names = (*fit.names, name, *candidate.shapes)
    return [linearised(evidence, f.model, names, f.launches) for f in best]
