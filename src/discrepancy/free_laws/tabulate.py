"""Put a fitted free law into the model as a table, and fit all other parameters again."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np

from discrepancy.arrays import Array
from discrepancy.fitting.gauss_newton import minimise_chi2
from discrepancy.fitting.linearise import linearise
from discrepancy.fitting.model_fit import ModelFit
from discrepancy.free_laws.credible_band import NormalMixture
from discrepancy.free_laws.fitted_law import FittedLaw
from synthcam.model import BASE_PARAMETERS, Model, build_model, list_model_settings
from synthcam.tabulated_law import TabulatedLaw, kind_of


def tabulate_and_refit(fitted_law: FittedLaw, progress: Callable[[], None] = lambda: None) -> ModelFit | None:
    """Put a free law into the model as a table, and fit all other parameters again.

    The table is the smooth curve or the curve that may have a step, whichever leaves the smaller chi^2. Returns None if
    no model can hold such a law, or if no motion exists with it.
    """
    law, found = fitted_law.law, []
    try:
        kind_of(law.name)
    except KeyError:
        return None
    x = law.grid(73 if law.axes[0].kind == "circle" else 81, side=25)  # 73: every five degrees
    for curve in (fitted_law.curve(*x)[0], NormalMixture.of(fitted_law, *x).quantile(0.0)):
        with suppress(ValueError):
            model = _with_table(fitted_law.model_without_law, law.name, x, curve)
            start = linearise(fitted_law.evidence, model, fitted_law.fit.names, fitted_law.fit.launches)
            found.append(minimise_chi2(fitted_law.evidence, start, progress))
    best = min(found, key=lambda fit: fit.chi2, default=None)
    if best is None:
        return None
    return replace(best, model=build_model(list_model_settings(best.model), best.model.free))  # as a file has it


def _with_table(plain: Model, name: str, x: tuple[Array, ...], curve: Array) -> Model:
    """The model with the law as a table, which replaces an earlier one of that name. Raises ValueError."""
    kind, _ = kind_of(name)
    y = np.clip(curve, kind.low, kind.high)
    points = x[0] if len(x) == 1 else np.stack(x, axis=-1)
    base = {parameter: plain.value(parameter) for parameter in BASE_PARAMETERS}
    table = TabulatedLaw.of(name, _round(points), _round(y[:, 0] if kind.parts == 1 else y), base)
    others = tuple(e for e in plain.effects if not (isinstance(e, TabulatedLaw) and e.law == name))
    return replace(plain, effects=(*others, table))


def _round(values: Array) -> Array:
    """Round to nine digits, so that a file stays readable."""
    return np.asarray(np.vectorize(lambda v: float(f"{v:.9g}"))(values))
