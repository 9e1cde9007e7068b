"""Computes a model's residuals, and their derivatives by shared parameters and launches: a fit to first order."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from discrepancy.arrays import Array
from discrepancy.data.launch import MAX_SPIN_TO_SPEED, V0, WITH_SPIN
from discrepancy.fitting.jacobian import differentiate_all, differentiate_launches
from discrepancy.fitting.model_fit import Linearisation, ModelFit, WhitenedClips
from discrepancy.fitting.parameters import find_parameter, find_tried_range
from synthcam.dynamics.batch import LAUNCH_COLUMNS
from synthcam.model import Model


def linearise(
    whitened: WhitenedClips, model: Model, names: tuple[str, ...], launches: Array, exact: bool = False
) -> ModelFit:
    """Compute the residuals of a model and their derivatives, at given values and launches, without a fit.

    exact: count the push between balls in all derivatives; see `jacobian.differentiate_all`.
    Raises ValueError where the model has no motion for a launch.
    """
    expected, own = differentiate_launches(model, launches, whitened.clips)
    shared = differentiate_all(model, launches, whitened.clips, names, expected, exact)
    residuals = whitened.whiten([c.xy - e for c, e in zip(whitened.clips, expected, strict=True)])
    if names:
        slopes = whitened.whiten([np.stack([s[k] for s in shared], axis=-1) for k in range(len(expected))])
        slopes = zero_unidentifiable_shapes(model, names, slopes)
    else:
        slopes = tuple(np.zeros((len(r), 0)) for r in residuals)
    own_slopes = _zero_unidentifiable_spins(launches, whitened.whiten(own))
    return ModelFit(model, names, launches, residuals, Linearisation(model, names, launches, slopes, own_slopes))


def zero_unidentifiable_shapes(model: Model, names: Sequence[str], slopes: tuple[Array, ...]) -> tuple[Array, ...]:
    """Set to zero the derivatives (2n, S) of a linearised fit by shape parameters that are not identifiable.

    Such a parameter moves the tracks by less than one sigma over its whole range. Without derivatives no step carries
    it away; a dropped frame, for example, may be anywhere between two frames.
    """
    shapes = [find_parameter(model, n) if "." in n else None for n in names]
    spans = np.array(
        [
            find_tried_range(p) * (model.value(n) if p.low > 0 else 1.0) if p and p.fixed else np.inf
            for n, p in zip(names, shapes, strict=True)
        ]
    )
    silent = np.sqrt(sum((s**2).sum(axis=0) for s in slopes)) < 1 / spans
    return tuple(np.where(silent, 0.0, s) for s in slopes) if silent.any() else slopes


def _zero_unidentifiable_spins(launches: Array, slopes: tuple[Array, ...]) -> tuple[Array, ...]:
    """Set to zero the derivatives (2n, p) by spins that move the tracks by less than one sigma at any possible size.

    Without friction and spin transfer the tracks do not depend on a striker's spin; its derivative is rounding.
    """
    if launches.shape[1] != WITH_SPIN:
        return slopes
    sizes = np.array([np.linalg.norm(s[:, len(LAUNCH_COLUMNS) :], axis=0) for s in slopes])
    silent = np.pad(sizes * MAX_SPIN_TO_SPEED * launches[:, [V0]] < 1, ((0, 0), (len(LAUNCH_COLUMNS), 0)))
    return tuple(np.where(none, 0.0, s) for none, s in zip(silent, slopes, strict=True)) if silent.any() else slopes
