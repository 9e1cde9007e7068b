"""What other shapes of a named effect the data allow: how chi^2 bends at one minimum says nothing of the next.

A law with a kink, as slip and stick, has several, and the strength is another at each.
"""

from __future__ import annotations

import numpy as np

from discrepancy.fitting.model_fit import Evidence, Fit
from discrepancy.fitting.parameters import Suspect, limits_of
from discrepancy.fitting.predict import forecast
from discrepancy.fitting.shape_scan import MANY, scannable
from discrepancy.selection.score_test import Contest, tried
from synthcam.dynamics.solve import uncoupled
from synthcam.model import Model

GAINED = 2.0  # of chi^2, by other shapes: less is not worth another fit
LIKELY = 3.0  # sigma: shapes that are less likely say nothing of an interval of one or two


def spread(evidence: Evidence, reduced: Fit, now: Fit, suspect: Suspect) -> dict[str, float]:
    """Standard deviations of a suspect's strengths and shapes: what `now` says, or more if likely shapes lie further.

    reduced: the fit without the suspect. A parabola as wide as chi^2 to first order wherever shapes are tried, where
    few are. An effect so strong that first order is far off says nothing of them.
    """
    std = {n: s for n, s in now.std.items() if n in suspect.strengths + suspect.shapes}
    tries = list(suspect.grid(reduced.model))
    if len(tries) < 2 or (len(tries) >= MANY and scannable(suspect, tries)):
        return std
    found = {s: now.model.value(s) for s in suspect.shapes}
    plain = uncoupled(reduced.model)
    here = forecast(plain, reduced.launches, evidence.clips)
    if len(found) > 1:  # along a valley that runs between the places of a coarse grid
        near = [found | {s: shapes[s]} for s in found for shapes in tries]
        tries += [shapes for k, shapes in enumerate(near) if shapes not in near[:k]]
    trials = [tried(evidence, plain, reduced.launches, suspect, shapes, here) for shapes in (*tries, found)]
    contest = Contest(reduced, tuple(trials))
    *others, (_, most, strengths) = contest.estimates()
    middle = dict(zip(suspect.strengths, strengths, strict=True)) | found
    if any(gain - most > GAINED for _, gain, _ in others) or abs(contest.chi2() - most - now.chi2) > LIKELY**2:
        return std
    for shapes, gain, strengths in others:
        values = dict(zip(suspect.strengths, strengths, strict=True)) | shapes
        if most - gain > LIKELY**2 or any(not _inside(now.model, n, values[n]) for n in suspect.strengths):
            continue
        for name in std:
            away = abs(values[name] - middle[name])
            std[name] = max(std[name], float(away / np.sqrt(max(most - gain, 1.0))))
    return std


def _inside(model: Model, name: str, value: float) -> bool:
    """Whether a parameter may have a value."""
    low, high = limits_of(model, name)
    return low <= value <= high
