"""A fit with one candidate more, from where its score leads or from realistic sizes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from discrepancy.fitting.gauss_newton import linearise, minimise_chi2, take_one_step, zero_unidentifiable_shapes
from discrepancy.fitting.jacobian import differentiate_all
from discrepancy.fitting.model_fit import ModelFit, WhitenedClips
from discrepancy.fitting.parameters import find_parameter, parameter_limits
from discrepancy.fitting.predict import predict_tracks
from discrepancy.select.scored import CandidateScore

KEPT = 0.5  # of the gain that the score promises
STARTS, FAR = (0.1, 0.3, 1.0), 2  # of a realistic size, where the way is too far for the score; that many are followed


def fit_with_candidate(
    evidence: WhitenedClips, fit: ModelFit, scored: CandidateScore, progress: Callable[[], None] = lambda: None
) -> ModelFit:
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
        tries += [minimise_chi2(evidence, start, progress, rough=True) for start in _far(evidence, fit, scored)]
    return min(tries, key=lambda f: f.chi2, default=fit)


def _from_here(
    evidence: WhitenedClips, fit: ModelFit, scored: CandidateScore, progress: Callable[[], None]
) -> ModelFit:
    candidate, model = scored.candidate, fit.model.replace(scored.shapes)
    strong = minimise_chi2(evidence, fit.extend(model, scored.strengths, scored.columns), progress, rough=True)
    if not candidate.shapes or all(strong.model.value(s) == 0 for s in scored.strengths):
        return strong
    here = predict_tracks(strong.model, strong.launches, evidence.clips)
    slopes = differentiate_all(strong.model, strong.launches, evidence.clips, candidate.shapes, here)
    columns = evidence.whiten([np.stack([s[k] for s in slopes], axis=-1) for k in range(len(here))])
    columns = zero_unidentifiable_shapes(strong.model, candidate.shapes, columns)
    return minimise_chi2(evidence, strong.extend(strong.model, candidate.shapes, columns), progress, rough=True)


def _far(evidence: WhitenedClips, fit: ModelFit, scored: CandidateScore) -> list[ModelFit]:
    """The FAR best starts with the candidate's single strength at a realistic size, all else adapted by one step."""
    candidate = scored.candidate
    if len(candidate.strengths) > 1:
        return []
    name = candidate.strengths[0]
    size, (low, high) = find_parameter(fit.model, name).typical, parameter_limits(fit.model, name)
    begun: list[ModelFit] = []
    for shapes in candidate.grid(fit.model):
        for value in (sign * share * size for share in STARTS for sign in (1, -1)):
            if low <= value <= high:
                start = take_one_step(evidence, fit, fit.model.replace({**shapes, name: value}))
                begun += [start] if start else []
    best = sorted(begun, key=lambda f: f.chi2)[:FAR]
    names = (*fit.names, name, *candidate.shapes)
    return [linearise(evidence, f.model, names, f.launches) for f in best]
