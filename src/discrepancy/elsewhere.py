"""What other shapes of a named effect the data allow: how chi^2 bends at one minimum says nothing of the next.

A law with a kink, as slip and stick, has several, and the strength is another at each.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from discrepancy.fit import Evidence, Fit
from discrepancy.forecast import forecast
from discrepancy.parameter import Suspect
from discrepancy.rank import Contest, tried
from synthcam.dynamics import uncoupled

LIKELY = 3.0  # sigma: shapes that are less likely say nothing of an interval of one or two


def spread(
    evidence: Evidence, reduced: Fit, now: Fit, suspect: Suspect, tick: Callable[[], None] = lambda: None
) -> dict[str, float]:
    """Standard deviations of a suspect's strengths and shapes: what `now` says, or more if likely shapes lie further.

    reduced: the fit without the suspect. A parabola as wide as chi^2 to first order wherever shapes are tried.
    """
    std = {n: s for n, s in now.std.items() if n in suspect.strengths + suspect.shapes}
    found = {s: now.model.value(s) for s in suspect.shapes}
    contest = Contest.of(evidence, reduced, tick, [suspect])
    if len(contest.trials) < 2:
        return std
    plain = uncoupled(reduced.model)
    here = forecast(plain, reduced.launches, evidence.clips)
    own = tried(evidence, plain, reduced.launches, suspect, found, here)
    seen = Contest(reduced, (*contest.trials, own)).estimates()
    most = max(gain for _, gain, _ in seen)
    for shapes, gain, strengths in seen:
        if most - gain > LIKELY**2:
            continue
        values = dict(zip(suspect.strengths, strengths, strict=True)) | shapes
        for name in std:
            away = abs(values[name] - now.model.value(name))
            std[name] = max(std[name], float(away / np.sqrt(max(most - gain, 1.0))))
    return std
