"""The cost in chi^2 by which models are compared: one rule for every effect of the library and every free law."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from discrepancy.fitting.model_fit import ModelFit
from discrepancy.fitting.parameters import find_parameter, find_tried_range
from discrepancy.free_laws.library import count_laws
from discrepancy.free_laws.marginal_likelihood import cost_of_choice, cost_of_strengths
from synthcam.library import library
from synthcam_shared.arrays import Array


def law_choice_cost() -> float:
    """The cost of choosing one law to leave free, in chi^2."""
    return cost_of_choice(count_laws())


def compute_cost(fit: ModelFit, base: ModelFit) -> float:
    """The chi^2 of a fit plus the cost of each effect that the base lacks.

    The cost of an effect has three parts. Base parameters cost nothing.

    - The choice among the effects of the library.
    - The freedom of its strengths, with its shape parameters as known (`marginal_likelihood.cost_of_strengths`).
    - Each shape parameter: twice the logarithm of its search range over the width of its likelihood.
    """
    paid, chosen = fit.chi2, cost_of_choice(len(library()))
    for names in fit.added_names(base).values():
        own = {n: find_parameter(fit.model, n) for n in names if "." in n}
        if not own:
            continue
        paid += chosen
        strengths, shapes = ([n for n, p in own.items() if p.fixed == fixed] for fixed in (False, True))
        size = np.array([own[n].typical or 1.0 for n in strengths])
        information = _information(fit, strengths + shapes)[: len(size), : len(size)] * np.outer(size, size)
        moved = (fit.values(strengths) - base.values(strengths)) / size
        paid += cost_of_strengths(information, moved)
        span = np.array([find_tried_range(own[n]) * (fit.model.value(n) if own[n].low > 0 else 1.0) for n in shapes])
        known = _information(fit, shapes) * np.outer(span, span) / (2 * np.pi)
        paid += np.linalg.slogdet(np.eye(len(span)) + known)[1]
    return float(paid)


def _information(fit: ModelFit, names: Sequence[str]) -> Array:
    """The information (k, k) on these parameters with all others fitted: the inverse of their covariance."""
    if not names:
        return np.zeros((0, 0))
    rows = fit.columns_of(names)
    covariance = fit.covariance[np.ix_(rows, rows)]
    std = np.sqrt(np.diag(covariance))
    std = np.where(std > 0, std, 1.0)
    return np.asarray(np.linalg.pinv(covariance / np.outer(std, std), hermitian=True) / np.outer(std, std))
