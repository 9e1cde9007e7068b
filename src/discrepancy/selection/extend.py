"""A fit with one suspect more, from where its score leads or from realistic sizes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from discrepancy.fitting.gauss_newton import linearised, nudged, settle, telling
from discrepancy.fitting.jacobian import derivatives
from discrepancy.fitting.model_fit import Evidence, Fit
from discrepancy.fitting.parameters import limits_of, parameter_of
from discrepancy.fitting.predict import forecast
from discrepancy.selection.candidate import Candidate

KEPT = 0.5  # of the gain that the score promises
STARTS, FAR = (0.1, 0.3, 1.0), 2  # of a realistic size, where the way is too far for the score; that many are followed


def grown(evidence: Evidence, now: Fit, candidate: Candidate, tick: Callable[[], None] = lambda: None) -> Fit:
    """The fit with a candidate's strengths, and its shapes once they mean something, fitted too; roughly settled.

    From where the score leads; if that keeps less than it promised, from realistic sizes as well. A base parameter held
    at zero is far from there.
    """
    tries = [] if candidate.suspect.kind is None else [_from_here(evidence, now, candidate, tick)]
    if not tries or tries[0].chi2 > now.chi2 - KEPT * candidate.gain:
        tries += [settle(evidence, start, tick, rough=True) for start in _far(evidence, now, candidate)]
    return min(tries, key=lambda f: f.chi2, default=now)


def _from_here(evidence: Evidence, now: Fit, candidate: Candidate, tick: Callable[[], None]) -> Fit:
    suspect, model = candidate.suspect, now.model.replace(candidate.shapes)
    strong = settle(evidence, now.extended(model, candidate.strengths, candidate.columns), tick, rough=True)
    if not suspect.shapes or all(strong.model.value(s) == 0 for s in candidate.strengths):
        return strong
    here = forecast(strong.model, strong.launches, evidence.clips)
    slopes = derivatives(strong.model, strong.launches, evidence.clips, suspect.shapes, here)
    columns = evidence.white([np.stack([s[k] for s in slopes], axis=-1) for k in range(len(here))])
    columns = telling(strong.model, suspect.shapes, columns)
    return settle(evidence, strong.extended(strong.model, suspect.shapes, columns), tick, rough=True)


def _far(evidence: Evidence, now: Fit, candidate: Candidate) -> list[Fit]:
    """Places to start from with a single strength at realistic sizes: those that fit best when the rest gives way."""
    suspect = candidate.suspect
    if len(suspect.strengths) > 1:
        return []
    name = suspect.strengths[0]
    size, (low, high) = parameter_of(now.model, name).typical, limits_of(now.model, name)
    looks: list[Fit] = []
    for shapes in suspect.grid(now.model):
        for value in (sign * share * size for share in STARTS for sign in (1, -1)):
            if low <= value <= high:
                look = nudged(evidence, now, now.model.replace({**shapes, name: value}))
                looks += [look] if look else []
    best = sorted(looks, key=lambda f: f.chi2)[:FAR]
    names = (*now.names, name, *suspect.shapes)
    return [linearised(evidence, f.model, names, f.launches) for f in best]
