"""Errors of a named effect by profile likelihood over its shape parameters.

How chi^2 bends at one minimum says nothing of the next. A law with a kink, as slip and stick, has several, and the
strength is another at each.
"""

from __future__ import annotations

import numpy as np

from discrepancy.fitting.jacobian import decouple
from discrepancy.fitting.model_fit import ModelFit, WhitenedClips
from discrepancy.fitting.parameters import Candidate, parameter_limits
from discrepancy.fitting.shape_scan import MANY, can_scan
from discrepancy.select.score_test import ScoreTests, derive_trial
from synthcam.model import Model

GAINED = 2.0  # of chi^2, by other shapes: less is not worth another fit
LIKELY = 3.0  # sigma: values that are less likely say nothing of an interval of one or two


def profile_std(evidence: WhitenedClips, reduced: ModelFit, fit: ModelFit, candidate: Candidate) -> dict[str, float]:
    """Standard deviations of a candidate's strengths and shape parameters, by profile likelihood.

    Those of `fit`, or more if likely values lie further: a parabola as wide as chi^2 to first order wherever values are
    tried, where few are. An effect so strong that first order is far off says nothing of them.

    Parameters
    ----------
    evidence : Evidence
    reduced, fit : Fit
        Without the candidate and with it.
    candidate : Candidate

    Returns
    -------
    dict of str to float
        By dotted name.
    """
    std = {n: s for n, s in fit.std.items() if n in candidate.strengths + candidate.shapes}
    tries = list(candidate.grid(reduced.model))
    if len(tries) < 2 or (len(tries) >= MANY and can_scan(candidate, tries)):
        return std
    found = {s: fit.model.value(s) for s in candidate.shapes}
    plain, here = decouple(reduced.model, reduced.launches, evidence.clips)
    if len(found) > 1:  # along a valley that runs between the places of a coarse grid
        near = [found | {s: shapes[s]} for s in found for shapes in tries]
        tries += [shapes for k, shapes in enumerate(near) if shapes not in near[:k]]
    trials = [derive_trial(evidence, plain, reduced.launches, candidate, shapes, here) for shapes in (*tries, found)]
    tests = ScoreTests(reduced, tuple(trials))
    *others, (_, most, strengths) = tests.estimates()
    middle = dict(zip(candidate.strengths, strengths, strict=True)) | found
    if any(gain - most > GAINED for _, gain, _ in others) or abs(tests.chi2() - most - fit.chi2) > LIKELY**2:
        return std
    for shapes, gain, strengths in others:
        values = dict(zip(candidate.strengths, strengths, strict=True)) | shapes
        if most - gain > LIKELY**2 or any(not _inside(fit.model, n, values[n]) for n in candidate.strengths):
            continue
        for name in std:
            away = abs(values[name] - middle[name])
            std[name] = max(std[name], float(away / np.sqrt(max(most - gain, 1.0))))
    return std


def _inside(model: Model, name: str, value: float) -> bool:
    """Whether a parameter may have a value."""
    low, high = parameter_limits(model, name)
    return low <= value <= high
