"""A free law that was found, as a table in the model, with all else fitted again beside it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np

from discrepancy.arrays import Array
from discrepancy.fitting.gauss_newton import linearise, minimise_chi2
from discrepancy.fitting.model_fit import ModelFit
from discrepancy.free_laws.credible_band import NormalMixture
from discrepancy.free_laws.fitted_law import FittedLaw
from synthcam.model import BASE_PARAMETERS, Model, build, settings_of
from synthcam.tabulated_law import TabulatedLaw, kind_of

PLACES, TURN, SIDE = 81, 73, 25  # of a table: of a curve, of one over all directions, along each side of a map


def tabulate_and_refit(fitted_law: FittedLaw, progress: Callable[[], None] = lambda: None) -> ModelFit | None:
    """Put a free law into the model as a table and fit all else that is fitted again.

    The smooth curve and the one that may have a step are tried; the one that leaves less is taken.

    Parameters
    ----------
    fitted_law : FittedLaw
    progress : callable
        Told of progress.

    Returns
    -------
    Fit or None
        None where no model can hold such a law, or none with it has a motion.
    """
    law, found = fitted_law.law, []
    try:
        kind_of(law.name)
    except KeyError:
        return None
    x = _grid(fitted_law)
    for curve in (fitted_law.curve(*x)[0], NormalMixture.of(fitted_law, *x).quantile(0.0)):
        with suppress(ValueError):
            model = _with_table(fitted_law.model_without_law, law.name, x, curve)
            start = linearise(fitted_law.evidence, model, fitted_law.fit.names, fitted_law.fit.launches)
            found.append(minimise_chi2(fitted_law.evidence, start, progress))
    best = min(found, key=lambda fit: fit.chi2, default=None)
    return replace(best, model=build(settings_of(best.model), best.model.free)) if best else None  # as a file has it


def _grid(fitted_law: FittedLaw) -> tuple[Array, ...]:
    axes = fitted_law.law.axes
    if len(axes) == 1:
        return (axes[0].grid(TURN if axes[0].kind == "circle" else PLACES),)
    return tuple(side.ravel() for side in np.meshgrid(*(a.grid(SIDE) for a in axes), indexing="ij"))


def _with_table(plain: Model, name: str, x: tuple[Array, ...], curve: Array) -> Model:
    """The model with the law as a table, in place of an earlier one of that name. Raises ValueError."""
    kind, _ = kind_of(name)
    y = np.clip(curve, kind.low, kind.high)
    places = x[0] if len(x) == 1 else np.stack(x, axis=-1)
    table = TabulatedLaw.of(name, _short(places), _short(y[:, 0] if kind.parts == 1 else y), _numbers(plain))
    others = tuple(e for e in plain.effects if not (isinstance(e, TabulatedLaw) and e.law == name))
    return replace(plain, effects=(*others, table))


def _numbers(model: Model) -> dict[str, float]:
    return {name: model.value(name) for name in BASE_PARAMETERS}


def _short(values: Array) -> Array:
    """To nine digits: a file is to be read."""
    return np.asarray(np.vectorize(lambda v: float(f"{v:.9g}"))(values))
